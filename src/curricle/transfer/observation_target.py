"""Targets with observations, in which potentials are evaluated by rollouts."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import ROLLOUTS, Target
from curricle.tasks.observation_task import ObservationTask, is_observation_task
from curricle.transfer.observation_potential import ObservationPotential
from curricle.transfer.observation_rollouts import (
    greedy_episodes,
    mean_episode_return,
    random_episodes,
    stacked,
)

OBSERVATION_ROLLOUTS = 50
"""Episodes of which returns are the mean, unless another number is given."""
COVERAGE_EPISODES = 20
"""Episodes whose observations are the sample for a mapping's coverage."""


@dataclass(frozen=True, eq=False)
class ObservationTarget:
    """A target whose optimum is unknown; as :class:`Target` is for tasks with tables.

    Attributes
    ----------
    task : ObservationTask
    evaluation : GreedyEvaluation
        By rollouts.

    Examples
    --------
    >>> from curricle import observation_task
    >>> cart, summed = observation_task("CartPole-v1"), GreedyEvaluation(discounted=False)
    >>> target = target_of(cart, summed, episodes=20)
    >>> 15 < target.random_return < 30, target.optimum
    (True, nan)
    """

    task: ObservationTask
    evaluation: GreedyEvaluation
    solution: None = None
    typical_reward: float = float("nan")
    optimum: float = float("nan")

    @cached_property
    def random_return(self) -> float:
        """The mean return of the random policy."""
        found = random_episodes(self.task, episodes=self.episodes)
        return mean_episode_return(found, self.evaluation.discount(self.task.discount))

    @property
    def episodes(self) -> int:
        """Episodes of which returns are the mean."""
        return self.evaluation.episodes or OBSERVATION_ROLLOUTS

    def observations(self, potential: ObservationPotential) -> Any:
        """Return the observations of a potential's greedy rollouts, stacked; (n, ...).

        Those of random rollouts where it has no action values.
        """
        if potential.of_actions:
            found = greedy_episodes(potential, episodes=COVERAGE_EPISODES)
        else:
            found = random_episodes(self.task, episodes=COVERAGE_EPISODES)
        return stacked(self.task, [row for episode in found for row in episode.observations])


def target_of(
    task: Any, evaluation: GreedyEvaluation | None = None, *, episodes: int | None = None
) -> Target | ObservationTarget:
    """Return a task of either kind as a target.

    Parameters
    ----------
    task : Task or ObservationTask
    evaluation : GreedyEvaluation, optional
    episodes : int, optional
        Rollouts where returns are not exact; 1000, or 50 of a task with observations.
    """
    given = GreedyEvaluation() if evaluation is None else evaluation
    if is_observation_task(task):
        number = OBSERVATION_ROLLOUTS if episodes is None else episodes
        return ObservationTarget(task, replace(given, method="rollouts", episodes=number))
    return Target.of(task, given, episodes=ROLLOUTS if episodes is None else episodes)
