"""How the greedy policy is judged while learning."""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from curricle.checks import one_of, whole_number
from curricle.errors import SettingError
from curricle.learning import general_loop
from curricle.planning.policy_evaluation import NO_ROOM, NO_STREAM, Exact, Off, Rollouts
from curricle.tasks.generative_models import table_model
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import Task, generative_model, has_tables, tables

Method = Literal["auto", "exact", "rollouts", "off"]
EPISODES, LIVE_EPISODES = 100, 5
"""Rollouts a checkpoint; fewer in a live task, whose steps are a hundred times dearer."""
LARGEST_EXACT = 20_000
"""Outcomes (S x A x O) up to which ``method="auto"`` follows the greedy policy exactly."""
NEGLIGIBLE = 1e-9
"""Probability (or discounted weight) of still being under way at which an evaluation stops."""


@dataclass(frozen=True)
class GreedyEvaluation:
    """How the greedy policy is judged at each checkpoint.

    It is the expected return of one episode from the start distribution, cut at the time limit,
    ties broken uniformly, in the task's own (unshaped) rewards.

    Parameters
    ----------
    method : {"auto", "exact", "rollouts", "off"}
        Exactly, by following the distribution over states; or as the mean of some episodes. "auto"
        is exact up to 20,000 outcomes (states x actions x outcomes of a pair). "off" judges
        nothing: greedy returns are NaN.
    episodes : int, optional
        Rollouts a checkpoint. 100 by default, 5 in a live task, where a hundred checkpoints cost
        as much as 500 training episodes.
    discounted : bool
        Whether rewards are discounted, as :func:`solve` does, or summed as the paper does.

    Examples
    --------
    >>> GreedyEvaluation(method="rollouts", episodes=10)
    GreedyEvaluation(method='rollouts', episodes=10, discounted=True)
    """

    method: Method = "auto"
    episodes: int | None = None
    discounted: bool = True

    def __post_init__(self) -> None:
        one_of("method", self.method, get_args(Method), SettingError)
        if self.episodes is not None:
            whole_number("episodes of an evaluation", self.episodes, 1, SettingError)

    def settings(self, task: Task) -> Exact | Rollouts | Off:
        """Return the evaluation of this task as the compiled loops read it."""
        if self.method == "off":
            return Off()
        horizon = self.horizon(task)
        weight = self.weight(generative_model(task).discount)
        if self.method == "exact" or (self.method == "auto" and _small(task)):
            return Exact(table_model(tables(task)), weight, horizon, NEGLIGIBLE, *NO_ROOM)
        return Rollouts(self.rollouts(task), weight, horizon, NO_STREAM)

    def weight(self, discount: float) -> float:
        """Return what a step later counts, of what a step counts: a task's discount, or 1."""
        return discount if self.discounted else 1.0

    def rollouts(self, task: Any) -> int:
        """Return the episodes that a rollout takes the mean of, in a task of any kind."""
        few = is_observation_task(task) or is_live(task)
        return self.episodes or (LIVE_EPISODES if few else EPISODES)

    def horizon(self, task: Task) -> int:
        """Return the steps after which an episode is cut off, or adds nothing to speak of."""
        generative = generative_model(task)
        if generative.time_limit is not None:
            return generative.time_limit
        if not self.discounted:
            raise SettingError(
                "an undiscounted evaluation needs a task with a time limit: none set"
            )
        if 0 < generative.discount < 1:
            return int(np.ceil(np.log(NEGLIGIBLE) / np.log(generative.discount)))
        return 1 if generative.discount == 0 else int(general_loop.NO_LIMIT)


def _small(task: Task) -> bool:
    """Return whether a task has tables small enough to follow the greedy policy exactly."""
    pairs = task.states.size * task.actions.size
    if pairs > LARGEST_EXACT or not has_tables(task):
        return False
    return bool(pairs * tables(task).probability.shape[1] <= LARGEST_EXACT)
