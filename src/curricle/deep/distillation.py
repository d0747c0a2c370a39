"""Distillation fits networks of Stable-Baselines3 to known values and policies."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy
from torch.nn import functional

from curricle.arrays import FloatArray, IntArray
from curricle.deep.learner import DeepLearner, check_spaces
from curricle.deep.learning import DeepResult
from curricle.deep.miniature import Knowledge, Miniatures, rows_of
from curricle.deep.models import isolated, model_for
from curricle.deep.networks import NetworkValues, Standardized
from curricle.errors import SettingError, TaskError
from curricle.interop.tabulated_task import needs_of
from curricle.learning.record import Record
from curricle.learning.result import Outcome, learning_result
from curricle.learning.stopping import ALL_STEPS
from curricle.progress import Progress, shown
from curricle.tasks.kernel import splitmix64, stream_start
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
        """Yield the rows of each update: all n rows again and again, each time in a new order."""
        rng = np.random.default_rng(seed)
        order = rng.permutation(n)
        for _ in range(self.updates):
            if len(order) < min(self.batch_size, n):
                order = np.concatenate([order, rng.permutation(n)])
            yield order[: self.batch_size]
            order = order[self.batch_size :]


DEFAULT = Distillation()
WORTH = 0.02  # of the way from random to optimal must be regained on held-out levels


def distil(
    knowledge: Knowledge,
    task: ObservationTask,
    learner: DeepLearner,
    settings: Distillation = DEFAULT,
    *,
    seed: int = 0,
) -> NetworkValues:
    """Return a network of a learner's kind that is fitted to knowledge and takes no steps."""
    check_spaces(task, learner)
    model_seed = splitmix64(stream_start(seed, "distillation")) >> 33
    with isolated(learner.threads):
        model = model_for(task, learner, seed=model_seed, steps=1)
        model.env.close()
        _fit(model.policy, knowledge, task, settings, model_seed)
    return NetworkValues(model.policy)


def _fit(
    policy: BasePolicy,
    knowledge: Knowledge,
    task: ObservationTask,
    settings: Distillation,
    seed: int,
) -> None:
    """Fit a policy to values of mean 0 and spread 1, then rescale the layer of its values."""
    for name in ("policy", "action_values"):
        columns = getattr(knowledge, name).shape[1]
        if columns != task.n_actions:
            raise SettingError(
                f"knowledge to distil must be of the task's actions, {task.actions}: got "
                f"{columns} actions; a mapping's actions= maps them"
            )
    q_nets = [name for name in ("q_net", "quantile_net") if getattr(policy, name, None) is not None]
    network: torch.nn.Module | None = None  # of DQN or QR-DQN
    wanted = knowledge.action_values if q_nets else knowledge.values
    if hasattr(policy, "value_net") and task.n_actions is not None and not needs_of(policy):
        last = policy.value_net
    elif q_nets:
        network = getattr(policy, q_nets[0])
        last = getattr(network, q_nets[0])[-1]
    else:
        raise SettingError(
            "the learner of a distilled task must be an actor-critic with numbered actions, "
            "without memory or masks, or DQN or QR-DQN: got "
            f"{type(policy).__name__}"
        )

    def tensor(array: FloatArray) -> torch.Tensor:
        return torch.as_tensor(array, dtype=torch.float32, device=policy.device)

    weight = tensor(knowledge.states / knowledge.states.mean())  # states that look like a row
    mean, spread = float(wanted.mean()), float(wanted.std()) or 1.0

    def loss(rows: IntArray) -> torch.Tensor:
        inputs = policy.obs_to_tensor(rows_of(knowledge.observations, rows))[0]
        if network is None:
            values = policy.predict_values(inputs)[:, 0]
        else:
            values = network(inputs)
            values = values if values.dim() == 2 else values.mean(dim=1)  # QR-DQN's quantiles
        error = values - tensor((wanted[rows] - mean) / spread)
        losses = error.square().reshape(len(rows), -1).mean(dim=1)
        if network is None:
            probabilities = tensor(knowledge.policy[rows])
            smooth = (1 - settings.smoothing) * probabilities
            smooth = smooth + settings.smoothing / probabilities.shape[1]
            logits = policy.get_distribution(inputs).distribution.logits
            losses = losses + functional.cross_entropy(logits, smooth, reduction="none")
        return (losses * weight[rows]).mean()

    for part in Standardized.of(policy):
        part.see(policy, knowledge.observations)
    policy.set_training_mode(True)
    parameters = [parameter for parameter in policy.parameters() if parameter.requires_grad]
    optimizer = torch.optim.Adam(parameters, settings.learning_rate)
    for rows in settings.batches(len(wanted), seed):
        optimizer.zero_grad()
        loss(rows).backward()
        optimizer.step()
    policy.set_training_mode(False)
    with torch.no_grad():
        last.weight.mul_(spread)
        last.bias.mul_(spread).add_(mean)
    if network is not None:
        getattr(policy, f"{q_nets[0]}_target").load_state_dict(network.state_dict())


def learn_miniatures(
    task: Miniatures, learner: DeepLearner, seeds: Sequence[int], *, progress: Progress = None
) -> DeepResult:
    """Return a network for each seed, fitted to miniatures."""
    outcomes = []
    with shown(progress) as bars:
        grow = bars.bar("distilling", len(seeds))
        for seed in seeds:
            network = distil(task.knowledge(seed=seed), task, learner, seed=seed)
            examined = [member.examined(network) for member in task.solved]
            record = Record.empty(1)
            record.greedy_return[0] = np.mean([member.best for member in examined])
            shares = [member.regained for member in examined if not np.isnan(member.regained)]
            regained = np.mean(shares) if shares else 1.0
            if regained < WORTH and not task.shuffled:
                raise TaskError(
                    "a network distilled from miniatures must act better than at random, on "
                    f"held-out levels if there are any: it goes {regained:.0%} of the way from "
                    f"the random policy to the optimum of {task}"
                )
            # With the steps that it is charged, and no episode.
            outcomes.append(Outcome(record, network, task.cost, 0, 0, ALL_STEPS))  # type: ignore[arg-type]
            grow()
            bars.tell(seed)
    values: Any = tuple(outcome.values for outcome in outcomes)
    eval_freq = task.cost + 1  # so that it is evaluated once
    return DeepResult.of(learning_result(task, learner, tuple(seeds), values, outcomes, eval_freq))  # type: ignore[arg-type]
