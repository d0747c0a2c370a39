"""A target seen through observations, as potentials are judged in it: by episodes."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from curricle.planning.evaluation import GreedyEvaluation
from curricle.planning.target import ROLLOUTS, Target
from curricle.tasks.observation_task import ObservationTask, is_observation_task
from curricle.transfer.observation_potential import ObservationPotential
from curricle.transfer.observation_rollouts import (
    greedy_episodes,
    greedy_observation_rollouts,
    mean_return,
    observations_met,
    random_episodes,
)
from curricle.transfer.quality import PotentialQuality, along_its_way

EPISODES = 50
"""Episodes that a potential is followed for, unless told otherwise."""
LOOKED_AT = 20
"""Episodes whose observations a mapping's coverage is counted over."""
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class ObservationTarget:
    """A target of which nobody knows the optimum; what :class:`Target` is to tasks with tables.

    Attributes
    ----------
    task : ObservationTask
    evaluation : GreedyEvaluation
        By rollouts.

    Examples
    --------
    >>> from curricle import observation_task
    >>> target = target_of(observation_task("CartPole-v1"), GreedyEvaluation(discounted=False), episodes=20)
    >>> 15 < target.random_return < 30, target.optimum
    (True, nan)
    """

    task: ObservationTask
    evaluation: GreedyEvaluation
    solution: None = None
    typical_reward: float = NAN

    @property
    def optimum(self) -> float:
        """NaN: nobody knows."""
        return NAN

    @cached_property
    def random_return(self) -> float:
        """The mean return of acting at random."""
        met = random_episodes(self.task, episodes=self.episodes)
        return mean_return(met, self.evaluation.weight(self.task.discount))

    @property
    def episodes(self) -> int:
        """Episodes that returns are the mean of."""
        return self.evaluation.episodes or EPISODES

    def potential_quality(
        self, potential: ObservationPotential, *, seed: int = 0
    ) -> PotentialQuality:
        """Return how a potential compares with what its own greedy policy earns.

        All NaN where it tells no actions apart, and so has no policy.
        """
        if not potential.of_actions:
            return PotentialQuality(NAN, NAN, NAN, NAN, NAN, NAN, NAN, -1, exact=False)
        met = greedy_observation_rollouts(
            potential, episodes=self.episodes, seed=seed, stream="realism"
        )
        first = np.cumsum(met.lengths) - met.lengths
        returns = met.return_to_go[first] if self.evaluation.discounted else met.returns
        return along_its_way(met, float(returns.mean()), seed)

    def met(self, potential: ObservationPotential) -> Any:
        """Return the observations that a potential's greedy policy meets, stacked; (n, ...).

        Those that acting at random meets where it tells no actions apart.
        """
        if potential.of_actions:
            return observations_met(self.task, greedy_episodes(potential, episodes=LOOKED_AT))
        return observations_met(self.task, random_episodes(self.task, episodes=LOOKED_AT))


def target_of(
    task: Any, evaluation: GreedyEvaluation | None = None, *, episodes: int | None = None
) -> Target | ObservationTarget:
    """Return a target, whatever its kind.

    Parameters
    ----------
    task : Task or ObservationTask
    evaluation : GreedyEvaluation, optional
    episodes : int, optional
        Rollouts where returns are no exact ones; 1000, or 50 of a task seen through observations.
    """
    given = GreedyEvaluation() if evaluation is None else evaluation
    if is_observation_task(task):
        played = EPISODES if episodes is None else episodes
        return ObservationTarget(task, replace(given, method="rollouts", episodes=played))
    return Target.of(task, given, episodes=ROLLOUTS if episodes is None else episodes)
