"""A target seen through observations, as potentials are judged in it: by episodes."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from curricle.learning.evaluation import GreedyEvaluation
from curricle.learning.target import ROLLOUTS, Target
from curricle.tasks.observed import ObservedTask, is_observed
from curricle.transfer.observed_potential import ObservationPotential
from curricle.transfer.playing import (
    follow_observed,
    greedy_episodes,
    mean_return,
    observations_met,
    random_episodes,
)
from curricle.transfer.realism import Realism, along_its_way

EPISODES = 50
"""Episodes that a potential is followed for, unless told otherwise."""
LOOKED_AT = 20
"""Episodes whose observations a mapping's coverage is counted over."""
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class ObservedTarget:
    """A target of which nobody knows the optimum; what :class:`Target` is to tasks with tables.

    Attributes
    ----------
    task : ObservedTask
    evaluation : GreedyEvaluation
        By rollouts.

    Examples
    --------
    >>> from curricle import observed
    >>> target = target_of(observed("CartPole-v1"), GreedyEvaluation(discounted=False), episodes=20)
    >>> 15 < target.untaught < 30, target.optimum
    (True, nan)
    """

    task: ObservedTask
    evaluation: GreedyEvaluation
    solution: None = None
    typical_reward: float = NAN

    @property
    def optimum(self) -> float:
        """NaN: nobody knows."""
        return NAN

    @cached_property
    def untaught(self) -> float:
        """The mean return of acting at random."""
        met = random_episodes(self.task, episodes=self.episodes)
        return mean_return(met, self.evaluation.weight(self.task.discount))

    @property
    def episodes(self) -> int:
        """Episodes that returns are the mean of."""
        return self.evaluation.episodes or EPISODES

    def realism(self, potential: ObservationPotential, *, seed: int = 0) -> Realism:
        """Return how a potential compares with what its own greedy policy earns.

        All NaN where it tells no actions apart, and so has no policy.
        """
        if not potential.of_actions:
            return Realism(NAN, NAN, NAN, NAN, NAN, NAN, NAN, -1, exact=False)
        met = follow_observed(potential, episodes=self.episodes, seed=seed, stream="realism")
        first = np.cumsum(met.lengths) - met.lengths
        returns = met.earned[first] if self.evaluation.discounted else met.returns
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
) -> Target | ObservedTarget:
    """Return a target, whatever its kind.

    Parameters
    ----------
    task : Task or ObservedTask
    evaluation : GreedyEvaluation, optional
    episodes : int, optional
        Rollouts where returns are no exact ones; 1000, or 50 of a task seen through observations.
    """
    given = GreedyEvaluation() if evaluation is None else evaluation
    if is_observed(task):
        played = EPISODES if episodes is None else episodes
        return ObservedTarget(task, replace(given, method="rollouts", episodes=played))
    return Target.of(task, given, episodes=ROLLOUTS if episodes is None else episodes)
