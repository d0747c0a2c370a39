"""Distillation: a network of Stable-Baselines3 is fitted to what is known of observations."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from curricle.arrays import FloatArray, IntArray
from curricle.deep.checkpoint import isolated
from curricle.deep.knowledge import Knowledge, rows_of
from curricle.deep.learner import DeepLearner, check_spaces
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues
from curricle.errors import SettingError
from curricle.interop.tabulation.tabulated_task import needs_of
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask


@dataclass(frozen=True)
class Distillation:
    """How a network is fitted."""

    updates: int = 1_000  # steps of Adam
    batch_size: int = 512
    learning_rate: float = 1e-3
    # The share of each policy that is spread over all actions (label smoothing, Szegedy et al.
    # 2016): an actor that is sure outside its training levels neither explores nor unlearns. Chosen
    # on SimpleCrossing of one wall to two, LavaGap of sides 5 and 6 to 7, and DoorKey of side 5 to
    # 6: with 0.1 what is drawn from the actor returns .53, .25, .38 there, with 0 .42, .09, .09.
    smoothing: float = 0.1

    def batches(self, n: int, seed: int) -> Iterator[IntArray]:
        """Yield the rows of each update: all n in a new order, over and over."""
        rng = np.random.default_rng(seed)
        order = rng.permutation(n)
        for _ in range(self.updates):
            if len(order) < min(self.batch_size, n):
                order = np.concatenate([order, rng.permutation(n)])
            yield order[: self.batch_size]
            order = order[self.batch_size :]


DEFAULT = Distillation()


def distil(
    knowledge: Knowledge,
    task: ObservationTask,
    learner: DeepLearner,
    settings: Distillation = DEFAULT,
    *,
    seed: int = 0,
) -> NetworkValues:
    """Return a network of a learner's kind, fitted to what is known of observations.

    - An actor-critic's (PPO, A2C) critic by squared error to V, its actor by cross-entropy to the
      policy. Without a policy the critic alone.
    - DQN's and QR-DQN's network by squared error to Q.

    Errors of values are in units of their spread. No step of any environment is taken. The network
    has the task's spaces; `seed` draws its first weights and the batches.
    """
    check_spaces(task, learner)
    small = splitmix64(stream_start(seed, "distillation")) >> 33
    with isolated(learner.threads):
        model = model_for(task, learner, seed=small, steps=1)
        model.env.close()
        _fit_of(model.policy, knowledge, task).learn(settings, small)
    return NetworkValues(model.policy)


class _Fit:
    """What a policy of Stable-Baselines3 is to say of observations: V of an actor-critic, or Q."""

    def __init__(self, policy: Any, knowledge: Knowledge, wanted: FloatArray):
        self.policy, self.knowledge, self.wanted = policy, knowledge, wanted
        self.weight = self._tensor(knowledge.states / knowledge.states.mean())
        self.mean, self.spread = float(wanted.mean()), float(wanted.std()) or 1.0

    def learn(self, settings: Distillation, seed: int) -> None:
        """Fit the policy to values of mean 0 and spread 1, then rescale the layer of its values."""
        self.policy.set_training_mode(True)
        parameters = [one for one in self.policy.parameters() if one.requires_grad]
        optimizer = torch.optim.Adam(parameters, settings.learning_rate)
        for rows in settings.batches(len(self.wanted), seed):
            optimizer.zero_grad()
            self.loss(rows, settings.smoothing).backward()
            optimizer.step()
        self.policy.set_training_mode(False)
        last = self.last_layer()
        with torch.no_grad():
            last.weight.mul_(self.spread)
            last.bias.mul_(self.spread).add_(self.mean)

    def loss(self, rows: IntArray, smoothing: float) -> torch.Tensor:
        """Return the loss of some observations, each weighted by the states that look like it."""
        found, logits = self.outputs(rows)
        error = found - self._tensor((self.wanted[rows] - self.mean) / self.spread)
        each = error.square().reshape(len(rows), -1).mean(dim=1)
        if logits is not None:
            policy = self._tensor(np.asarray(self.knowledge.policy)[rows])
            smooth = (1 - smoothing) * policy + smoothing / policy.shape[1]
            each = each + functional.cross_entropy(logits, smooth, reduction="none")
        return (each * self.weight[rows]).mean()

    def outputs(self, rows: IntArray) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Return the values of some observations, and the logits of an actor."""
        raise NotImplementedError

    def last_layer(self) -> Any:
        """Return the layer that computes values."""
        raise NotImplementedError

    def _seen(self, rows: IntArray) -> Any:
        return self.policy.obs_to_tensor(rows_of(self.knowledge.observations, rows))[0]

    def _tensor(self, each: FloatArray) -> torch.Tensor:
        return torch.as_tensor(each, dtype=torch.float32, device=self.policy.device)


class _ActorCriticFit(_Fit):
    def last_layer(self) -> Any:
        return self.policy.value_net

    def outputs(self, rows: IntArray) -> tuple[torch.Tensor, torch.Tensor | None]:
        seen = self._seen(rows)
        values = self.policy.predict_values(seen)[:, 0]
        if self.knowledge.policy is None:
            return values, None
        return values, self.policy.get_distribution(seen).distribution.logits


class _QFit(_Fit):
    """Of DQN's network, or of QR-DQN's, whose value is the mean of its quantiles."""

    @property
    def name(self) -> str:
        """The policy's name for its network, and the network's for its layers."""
        return "quantile_net" if hasattr(self.policy, "quantile_net") else "q_net"

    def last_layer(self) -> Any:
        return getattr(getattr(self.policy, self.name), self.name)[-1]

    def learn(self, settings: Distillation, seed: int) -> None:
        super().learn(settings, seed)
        learnt = getattr(self.policy, self.name).state_dict()
        getattr(self.policy, f"{self.name}_target").load_state_dict(learnt)

    def outputs(self, rows: IntArray) -> tuple[torch.Tensor, torch.Tensor | None]:
        found = getattr(self.policy, self.name)(self._seen(rows))
        return (found if found.dim() == 2 else found.mean(dim=1)), None


def _fit_of(policy: Any, knowledge: Knowledge, task: ObservationTask) -> _Fit:
    """Return what a policy is to be fitted to; SettingError where it cannot be."""
    for name in ("policy", "action_values"):
        known = getattr(knowledge, name)
        if known is not None and known.shape[1] != task.n_actions:
            raise SettingError(
                f"knowledge to distil must be of the task's actions, {task.actions}: got "
                f"{known.shape[1]} of them; a mapping's actions= says which is which"
            )
    if hasattr(policy, "value_net") and task.n_actions is not None and not needs_of(policy):
        return _ActorCriticFit(policy, knowledge, knowledge.values)
    has_q = any(getattr(policy, name, None) is not None for name in ("q_net", "quantile_net"))
    if has_q and knowledge.action_values is not None:
        return _QFit(policy, knowledge, knowledge.action_values)
    raise SettingError(
        "a network to distil into must be an actor-critic of numbered actions without memory or "
        f"masks, or DQN's or QR-DQN's where action values are known: got {type(policy).__name__}"
    )
