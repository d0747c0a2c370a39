"""Distillation: a network is fitted to what is known of observations."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from curricle.array_types import FloatArray, IntArray
from curricle.checks import instance, number, whole_number
from curricle.deep.checkpoint import isolated
from curricle.deep.knowledge import Knowledge, rows_of
from curricle.deep.learner import DeepLearner
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues
from curricle.errors import SettingError
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask


@dataclass(frozen=True)
class Distillation:
    """How a network is fitted.

    Parameters
    ----------
    updates : int
        Steps of Adam.
    batch_size : int
        Observations of each.
    learning_rate : float
    smoothing : float
        Share of each policy that is spread over all actions (label smoothing, Szegedy et al. 2016).
        An actor that is sure where it was not taught neither explores nor unlearns. Chosen on
        SimpleCrossing of one wall to two, LavaGap of sides 5 and 6 to 7, and DoorKey of side 5 to
        6: with 0.1 what is drawn from the actor returns .53, .25 and .38 there, with 0 .42, .09 and
        .09.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Distillation(updates=200).batch_size
    512
    """

    updates: int = 1_000
    batch_size: int = 512
    learning_rate: float = 1e-3
    smoothing: float = 0.1

    def __post_init__(self) -> None:
        for name in ("updates", "batch_size"):
            whole_number(f"{name} of a distillation", getattr(self, name), 1, SettingError)
        number("learning_rate of a distillation", self.learning_rate, SettingError, low=0)
        number("smoothing of a distillation", self.smoothing, SettingError, low=0, high=1)

    def batches(self, n: int, seed: int) -> Iterator[IntArray]:
        """Yield the rows of each update: all n in a new order, over and over."""
        rng = np.random.default_rng(seed)
        order = rng.permutation(n)
        for _ in range(self.updates):
            if len(order) < min(self.batch_size, n):
                order = np.concatenate([order, rng.permutation(n)])
            yield order[: self.batch_size]
            order = order[self.batch_size :]


@dataclass(frozen=True, eq=False)
class Distilled:
    """A network that was fitted.

    Attributes
    ----------
    values : NetworkValues
        As those of a network that learnt by steps: values, and the policy of an actor-critic.
    value_error : float
        Root mean squared error of V, or of Q for DQN, over the states it was fitted to.
    agreement : float
        Share of those states in which the action it thinks best is one of the best that are known.
    seconds : float
        Processor time of the fit.
    """

    values: NetworkValues
    value_error: float
    agreement: float
    seconds: float


def distil(
    knowledge: Knowledge,
    task: ObservationTask,
    learner: DeepLearner | None = None,
    settings: Distillation | None = None,
    *,
    seed: int = 0,
) -> Distilled:
    """Return a network of a learner's kind, fitted to what is known of observations.

    - An actor-critic's (PPO, A2C) critic by squared error to V, its actor by cross-entropy to the
      policy. Without a policy the critic alone.
    - DQN's and QR-DQN's network by squared error to Q.

    Errors of values are in units of their spread. No step of any environment is taken.

    Parameters
    ----------
    knowledge : Knowledge
    task : ObservationTask
        Whose spaces the network has.
    learner : DeepLearner, optional
        By default PPO.
    settings : Distillation, optional
    seed : int
        Of the first weights and of the batches.

    Raises
    ------
    SettingError
        When a number is out of range, the learner's networks are of another kind, or what is known
        is of other observations or actions than the task's.

    Examples
    --------
    >>> import curricle as cr
    >>> task = cr.observation_task("CartPole-v1")
    >>> carts = np.random.default_rng(0).normal(size=(100, 4)).astype(np.float32)
    >>> upright = Knowledge.of(carts, np.stack([-carts[:, 2], carts[:, 2]], axis=1))
    >>> distilled = distil(upright, task, settings=Distillation(updates=300, batch_size=50))
    >>> distilled.agreement > 0.9
    True
    """
    learner = DeepLearner("PPO") if learner is None else learner
    settings = Distillation() if settings is None else settings
    instance("knowledge to distil", knowledge, Knowledge, SettingError)
    began = time.process_time()
    with isolated(learner.threads):
        small = splitmix64(stream_start(seed, "distillation")) >> 33
        model = model_for(task, learner, seed=small, steps=1)
        model.env.close()
        lesson = _lesson_for(model.policy, knowledge, task)
        lesson.learn(settings, small)
        error, agreement = lesson.errors()
    return Distilled(NetworkValues(model.policy), error, agreement, time.process_time() - began)


class _Lesson:
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

    def errors(self) -> tuple[float, float]:
        """Return the root mean squared error, and the share of states with a best action."""
        rows = np.arange(len(self.wanted))
        parts = np.array_split(rows, -(-len(rows) // 4096))
        with torch.no_grad():
            found = [self.outputs(part) for part in parts]
        values = torch.cat([one for one, _ in found]).cpu().numpy()
        weight = self.knowledge.states / self.knowledge.states.sum()
        squared = ((values - self.wanted) ** 2).reshape(len(rows), -1).mean(axis=1)
        error = float(np.sqrt(weight @ squared))
        policy = self.knowledge.policy
        if policy is None:
            return error, float("nan")
        ranks = [one if logits is None else logits for one, logits in found]
        chosen = torch.cat(ranks).argmax(dim=1).cpu().numpy()
        right = policy[rows, chosen] >= policy.max(axis=1) - 1e-12
        return error, float(weight @ right)

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


class _ActorCriticLesson(_Lesson):
    def last_layer(self) -> Any:
        return self.policy.value_net

    def outputs(self, rows: IntArray) -> tuple[torch.Tensor, torch.Tensor | None]:
        seen = self._seen(rows)
        values = self.policy.predict_values(seen)[:, 0]
        if self.knowledge.policy is None:
            return values, None
        return values, self.policy.get_distribution(seen).distribution.logits


class _QLesson(_Lesson):
    def last_layer(self) -> Any:
        return self.policy.q_net.q_net[-1]

    def learn(self, settings: Distillation, seed: int) -> None:
        super().learn(settings, seed)
        self.policy.q_net_target.load_state_dict(self.policy.q_net.state_dict())

    def outputs(self, rows: IntArray) -> tuple[torch.Tensor, torch.Tensor | None]:
        return self.policy.q_net(self._seen(rows)), None


class _QuantileLesson(_Lesson):
    def last_layer(self) -> Any:
        return self.policy.quantile_net.quantile_net[-1]

    def learn(self, settings: Distillation, seed: int) -> None:
        super().learn(settings, seed)
        self.policy.quantile_net_target.load_state_dict(self.policy.quantile_net.state_dict())

    def outputs(self, rows: IntArray) -> tuple[torch.Tensor, torch.Tensor | None]:
        return self.policy.quantile_net(self._seen(rows)).mean(dim=1), None


def _lesson_for(policy: Any, knowledge: Knowledge, task: ObservationTask) -> _Lesson:
    """Return what a policy is to be fitted to; SettingError where it cannot be."""
    seen = knowledge.observations
    if isinstance(seen, np.ndarray) and seen.shape[1:] != task.observations.shape:
        raise SettingError(
            f"knowledge to distil must be of the task's observations, {task.observations}: got "
            f"arrays of shape {seen.shape[1:]}"
        )
    for name in ("policy", "action_values"):
        known = getattr(knowledge, name)
        if known is not None and known.shape[1] != task.n_actions:
            raise SettingError(
                f"knowledge to distil must be of the task's actions, {task.actions}: got "
                f"{known.shape[1]} of them; a mapping's actions= says which is which"
            )
    if hasattr(policy, "value_net") and task.n_actions is not None:
        return _ActorCriticLesson(policy, knowledge, knowledge.values)
    kinds = {"q_net": _QLesson, "quantile_net": _QuantileLesson}
    for kind, lesson in kinds.items():
        if getattr(policy, kind, None) is not None and knowledge.action_values is not None:
            return lesson(policy, knowledge, knowledge.action_values)
    raise SettingError(
        "a network to distil into must be an actor-critic of numbered actions, or DQN's or "
        f"QR-DQN's where action values are known: got a {type(policy).__name__}"
    )
