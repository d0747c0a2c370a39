"""Mappings to the nearest pair by lax bisimulation, with a bound on what they are off.

No names are needed, and no exact correspondence (Taylor, Precup, Panangaden 2009; Castro, Precup
2010, who transfer policies along it).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.display import brief_repr
from curricle.errors import MappingError
from curricle.frozen_arrays import Frozen, frozen
from curricle.progress import SILENT, Bars, Progress, shown
from curricle.tasks.task import Task
from curricle.transfer.bisimulation_distance import (
    MOST_WORK,
    Distances,
    Quotient,
    fixed_point,
    quotient,
    work_of_a_round,
)
from curricle.transfer.mapping import ENDED
from curricle.transfer.partition_refinement import Blocks
from curricle.transfer.proposal import Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair
from curricle.transfer.transport import WIDEST

TOLERANCE = 1e-3
"""How far below the fixed point distances may be, in units of the largest."""
LARGEST = 8_000_000
"""Pairs of a target's and a source's kinds of pairs up to which distances are computed."""

LARGEST_ROUND = MOST_WORK // 10
"""Pairs of their outcomes, so that there is time for ten rounds at least."""


@dataclass(frozen=True, eq=False)
class LaxBisimulation(Frozen):
    """Distances between the states of two tasks that bound the difference of their values.

    Attributes
    ----------
    states : (S, S') float64
        abs(V*(s) - V*(u)) is at most this, in return units.
    nearest : (S, A) int64
        The nearest source pair of each target pair, s' * A' + a'; `ENDED` where that is the
        source's end, and in terminal states.
    pairs : (S, A) float64
        abs(Q*(s, a) - Q*(nearest pair)) is at most this; 0 in terminal states.
    error : float
        How far the distances may be above those of the fixed point; it is part of them.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards, solve
    >>> poorer = GridWorld("T.S", rewards=Rewards(treasure=190))
    >>> found = lax_bisimulation(GridWorld("S.T"), poorer)
    >>> found.nearest[1]  # west for east
    array([4, 7, 4, 5])
    >>> found.states.diagonal()[1].round(2), solve(poorer).values[1]
    (np.float64(10.0), np.float64(189.0))
    """

    states: FloatArray
    nearest: IntArray
    pairs: FloatArray
    error: float

    __repr__ = brief_repr


def lax_bisimulation(
    target: Task, source: Task, *, tolerance: float = TOLERANCE, progress: Progress = None
) -> LaxBisimulation:
    """Return the distances of lax bisimulation between two tasks with tables.

    The fixed point of d((s, a), (u, b)) = abs(r - r') + gamma W(P, P'; d), where W is the
    Kantorovich distance, and d(s, u) = max(max_a min_b d, max_b min_a d). Terminal states pay
    nothing for ever. Where discounts differ, the source's rewards are rewritten so that its V*
    solves the equation of the target's discount, which keeps the bound. Transport problems are
    solved exactly; the work grows with the number of states that are not bisimilar to others. It
    ends after some minutes of one core at most; `error` is larger then.

    Parameters
    ----------
    target, source : Task
    tolerance : float
        How far below the fixed point iteration may end, in units of the largest distance. What is
        missing is added, so that the bound holds.
    progress : bool or callable, optional
        True counts the rounds, as nobody knows how many there will be; a function is called after
        each with how far from the fixed point the distances may be, a float.

    Raises
    ------
    TaskError
        When a task has no tables.
    MappingError
        When the tasks are too large, or a pair has more than 120 outcomes.
    SettingError
        When `progress` is none of what it may be.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> found = lax_bisimulation(GridWorld("S.T"), GridWorld("T.S"))
    >>> float(found.pairs.max()) < 1e-6
    True
    """
    with shown(progress) as bars:
        return _Fixed(TaskPair(target, source), tolerance, bars).bisimulation


def by_lax_bisimulation(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping to the nearest pair, and that to the nearest state and its nearest pair.

    Raises
    ------
    MappingError
        As :func:`lax_bisimulation`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S...T"), GridWorld("S.T"))
    >>> [one.how for one in by_lax_bisimulation(tasks)]
    ['lax bisimulation: nearest pair', 'lax bisimulation: nearest pair of the nearest state']
    """
    fixed = _Fixed(tasks, TOLERANCE)
    for name, index, bound in (
        ("nearest pair", fixed.bisimulation.nearest, fixed.bisimulation.pairs),
        ("nearest pair of the nearest state", *fixed.by_state),
    ):
        how = f"lax bisimulation: {name}"
        mapping = SearchedMapping(tasks.target, tasks.source, index, how=how)
        yield Proposal(mapping, how, float(bound[tasks.judged].max()))


@dataclass(frozen=True, eq=False)
class _Fixed:
    """The fixed point on the quotients of two tasks, and what it says of the tasks."""

    tasks: TaskPair
    tolerance: float
    bars: Bars = SILENT

    @cached_property
    def quotients(self) -> tuple[tuple[Quotient, Blocks], tuple[Quotient, Blocks]]:
        """Both tasks up to bisimulation."""
        tasks, discount = self.tasks, self.tasks.target_mdp.discount
        own = quotient(tasks.models[0], discount, tasks.target_solution.values)
        other = quotient(tasks.models[1], discount, tasks.source_solution.values)
        size = len(own[0].reward) * len(other[0].reward)
        if size > LARGEST:
            raise MappingError(
                f"lax bisimulation compares up to {LARGEST:,} pairs with pairs: these tasks have "
                f"{size:,}"
            )
        work = work_of_a_round(own[0], other[0])
        if work > LARGEST_ROUND:
            raise MappingError(
                f"lax bisimulation couples up to {LARGEST_ROUND:,} pairs of outcomes in a round: "
                f"these tasks have {work:,}"
            )
        widest = max(own[0].chance.shape[1], other[0].chance.shape[1])
        if widest > WIDEST:
            raise MappingError(
                f"lax bisimulation takes up to {WIDEST} outcomes of a pair: got {widest}"
            )
        return own, other

    @cached_property
    def solved(self) -> tuple[Distances, float]:
        """The distances, and how far off they may be; so may a source rewritten by its V*."""
        (own, _), (other, _) = self.quotients
        tasks = self.tasks
        slack = tasks.target_solution.error_bound + tasks.source_solution.error_bound
        found, error = fixed_point(own, other, tasks.target_mdp.discount, self.tolerance, self.bars)
        return found, error + slack

    @cached_property
    def bisimulation(self) -> LaxBisimulation:
        """The distances between the tasks' own states and pairs."""
        (_, blocks), (other, source_blocks) = self.quotients
        found, error = self.solved
        kind, distance = found.pairs.argmin(axis=1), found.pairs.min(axis=1)
        live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)
        index = np.where(live, _first_pairs(source_blocks, len(other.reward))[kind[pairs]], ENDED)
        bound = np.where(live, distance[pairs] + error, 0.0)
        states = found.states[blocks.states][:, source_blocks.states] + error
        return LaxBisimulation(frozen(states), frozen(index), frozen(bound), error)

    @property
    def by_state(self) -> tuple[IntArray, FloatArray]:
        """The nearest pair of the nearest state, and its distance, (S, A) each."""
        (_, blocks), (other, source_blocks) = self.quotients
        found, error = self.solved
        state = found.states.argmin(axis=1)
        live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)
        choices = other.pairs[state[blocks.states]]  # (S, A'')
        distance = found.pairs[pairs[:, :, None], np.maximum(choices, 0)[:, None, :]]
        distance = np.where(choices[:, None, :] >= 0, distance, np.inf)
        best = distance.argmin(axis=2)
        kind = np.take_along_axis(choices, best, axis=1)
        index = np.where(live, _first_pairs(source_blocks, len(other.reward))[kind], ENDED)
        return index, np.where(live, distance.min(axis=2) + error, 0.0)


def _first_pairs(blocks: Blocks, kinds: int) -> IntArray:
    """Return the first pair of each kind, `ENDED` for the kind that has none: the end."""
    found, first = np.unique(blocks.pairs.ravel(), return_index=True)
    pairs = np.full(kinds, ENDED)
    pairs[found[found >= 0]] = first[found >= 0]
    return pairs
