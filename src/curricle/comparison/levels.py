"""How optimistic a potential is: its values over the pairs that learning can visit.

These are the pairs of the states that some policy can reach from a start and in which no episode
ends, each pair counted once, with what stands where no mapping knows anything: all that a learner
of the target can meet, and nothing that it cannot. Where a target has no dense tables, they are the
pairs of the states that rollouts of the uniformly random policy visit; with observations, those of
the policy that the potential gives, as a forecast reads it. No learner is charged for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.curriculum.curriculum import Curriculum
from curricle.learning.learners import Learner
from curricle.learning.shaping import LookAheadAdvice, QInitialisation, StateShaping
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.rollouts import random_rollouts
from curricle.tasks.mdp import reachable_states
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model, has_tables, tables
from curricle.text import brief_repr
from curricle.transfer.calibration import AnyPotential
from curricle.transfer.observation_rollouts import ObservationTarget
from curricle.transfer.potentials import ObservationPotential

EPISODES, LENGTH = 100, 1000
"""Random rollouts where there are no dense tables, and the longest of them in steps."""
SAME_AS_INITIAL_VALUE = (QInitialisation, LookAheadAdvice, StateShaping)
"""Shapings by which a constant potential does what a higher initial value does (Wiewiora 2003)."""


@dataclass(frozen=True, eq=False)
class Level:
    """What a control that knows nothing adds to every value, for K seeds."""

    values: FloatArray  # (K,): mean of its potential over the pairs that learning can visit
    # The learner's own initial value, to which it is added; None where the control is not the same
    # as another initial value.
    base: float | None
    constant: bool  # whether every pair has this value

    __repr__ = brief_repr

    @property
    def mean(self) -> float:
        """The mean over seeds."""
        return float(self.values.mean())

    @property
    def initial_value(self) -> float | None:
        """The initial value that is the same, on average over seeds; None if none is."""
        return None if self.base is None else self.base + self.mean

    def take(self, seeds: IntArray) -> "Level":
        """Return the level of the seeds in these rows, in this order."""
        return replace(self, values=self.values[seeds])


def concatenated_levels(levels: Sequence[Level]) -> Level:
    """Return the levels of several batches of seeds as one of all seeds."""
    return replace(levels[0], values=np.concatenate([level.values for level in levels]))


@dataclass(frozen=True, eq=False)
class VisitedPairs:
    """The pairs of a task that learning can visit."""

    task: Any
    dense: bool  # whether all that can be reached is counted, rather than what rollouts visit

    @classmethod
    def of(cls, curriculum: Curriculum) -> Self:
        """Return the pairs of a curriculum's target."""
        task = curriculum.tasks[curriculum.target]
        sparse = curriculum.setting("storage", curriculum.target).kind == "sparse"
        return cls(task, has_tables(task) and not sparse and not is_observation_task(task))

    @cached_property
    def states(self) -> IntArray:
        """Their states, each once, (n,) int64; the task must have numbered ones."""
        if self.dense:
            mdp = tables(self.task)
            return np.flatnonzero(reachable_states(mdp) & ~mdp.terminal)
        limit = min(generative_model(self.task).time_limit or LENGTH, LENGTH)
        found = random_rollouts(self.task, episodes=EPISODES, length=limit)
        return np.unique(found.states[:, :-1][found.taken])

    def values(self, phi: AnyPotential) -> FloatArray:
        """Return phi of these pairs, a float64 array with one value for each."""
        if not isinstance(phi, ObservationPotential):
            return np.asarray(phi.rows(self.states))
        seen = ObservationTarget(self.task, GreedyEvaluation()).observations(phi)
        return np.asarray(phi.pairs(seen) if phi.of_actions else phi.v(seen))


def initial_value_of(curriculum: Curriculum) -> float | None:
    """Return the initial value of the target's learner, if a constant potential is one more.

    None where a network learns, and where the shaping enters a constant otherwise.
    """
    name = curriculum.target
    learner, shaping = (curriculum.setting(which, name) for which in ("learner", "shaping"))
    same = isinstance(shaping, SAME_AS_INITIAL_VALUE)
    return learner.initial_value if same and isinstance(learner, Learner) else None
