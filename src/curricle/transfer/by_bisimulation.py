"""Mappings by bisimulation: to pairs with the same Q*, and to the nearest pairs; without names."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.display import brief_repr
from curricle.errors import MappingError
from curricle.frozen_arrays import Frozen, frozen
from curricle.progress import SILENT, Bars, Progress, shown
from curricle.tasks.task import Task, tables
from curricle.transfer.bisimulation import (
    MOST_WORK,
    WIDEST,
    Blocks,
    Distances,
    Quotient,
    fixed_point,
    quotient,
    refined,
    work_of_a_round,
)
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.pair import Proposal, TaskPair, apart

LARGEST = 20_000_000
"""State-action pairs of both tasks up to which they are refined."""


def by_homomorphism(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of each target pair to an equivalent source pair, if any pair has one.

    Equivalent pairs have the same Q*. Refinement takes numbers that nearly agree as equal, so that
    only pairs whose Q* agree as closely as both are known are mapped. A pair of the target in a
    state that has an equivalent source state reads that state; others may still read a pair from
    which both tasks go on alike. Where several source pairs are equivalent, such as images under a
    symmetry, the first state's is taken.

    Raises
    ------
    MappingError
        When no pair has an equivalent one, or the tasks have more than 20 million pairs.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld(["S.P", "..T"])
    >>> tasks = TaskPair(maze, GridWorld(["T..", "P.S"]))  # turned by 180 degrees
    >>> next(by_homomorphism(tasks)).how
    'exact homomorphism: 100% of pairs have a source pair of the same Q*'
    """
    sizes = [mdp.outcome_row.size for mdp in (tasks.target_mdp, tasks.source_mdp)]
    if sum(sizes) > LARGEST:
        raise MappingError(
            f"tasks are refined together up to {LARGEST:,} pairs: these have {sum(sizes):,}"
        )
    own, other = refined(tasks.models)
    index = equivalent_pairs(own, other)
    solutions = tasks.target_solution, tasks.source_solution
    error = 2 * sum(solution.error_bound for solution in solutions)
    index = np.where(apart(index, *solutions) <= error, index, UNMAPPED)
    live = ~tasks.target_mdp.terminal
    share = float((index[live] >= 0).mean())
    if share == 0:
        raise MappingError("no pair of the target is equivalent to one of the source")
    how = f"exact homomorphism: {share:.0%} of pairs have a source pair of the same Q*"
    yield tasks.proposal(index, how)


def equivalent_pairs(own: Blocks, other: Blocks) -> IntArray:
    """Return for each target pair an equivalent source pair, or `UNMAPPED`, (S, A) int64."""
    most = int(max(own.pairs.max(), other.pairs.max())) + 2

    def keys(blocks: Blocks) -> IntArray:
        key = blocks.states[:, None] * most + blocks.pairs
        return np.where(blocks.pairs < 0, -1, key).ravel()

    index = _first_of(keys(other), keys(own))
    elsewhere = _first_of(other.pairs.ravel(), own.pairs.ravel())
    index = np.where(index == UNMAPPED, elsewhere, index)
    return np.where(own.pairs.ravel() < 0, UNMAPPED, index).reshape(own.pairs.shape)


def _first_of(keys: IntArray, wanted: IntArray) -> IntArray:
    """Return where each wanted key is found first, `UNMAPPED` where it is not or is negative."""
    known, first = np.unique(keys, return_index=True)
    place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    there = (known[place] == wanted) & (wanted >= 0)
    return np.where(there, first[place], UNMAPPED).astype(np.int64)


# -- nearest pairs ---------------------------------------------------------------------------------


TOLERANCE = 1e-3
"""How far below the fixed point distances may be, in units of the largest."""
LARGEST_PAIRS = 8_000_000
"""Pairs of a target's and a source's kinds of pairs up to which distances are computed."""

LARGEST_ROUND = MOST_WORK // 10
"""Pairs of their outcomes, so that there is time for ten rounds at least."""


@dataclass(frozen=True, eq=False)
class LaxBisimulation(Frozen):
    """Distances between two tasks that bound the difference of their values, in return units."""

    states: FloatArray  # (S, S') abs(V*(s) - V*(u)) is at most this
    nearest: IntArray  # (S, A) source pair s' * A' + a', `ENDED` at its end and in terminal states
    pairs: FloatArray  # (S, A) abs(Q*(s, a) - Q*(nearest pair)) is at most this, 0 in terminal ones
    error: float  # how far the distances may be above those of the fixed point: a part of them

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
    ends after some minutes of one core at most; `error` is larger then. States count as bisimilar
    where numbers agree to 1e-9 of the largest, and no distance is below the known difference of
    two values, so that the bound holds all the same.

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
        When a discount is 1, the tasks are too large, or a pair has more than 120 outcomes.
    SettingError
        When `progress` is none of what it may be.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> distances = lax_bisimulation(GridWorld("S.T"), GridWorld("T.S"))
    >>> float(distances.pairs.max()) < 1e-6
    True
    """
    tasks = TaskPair(target, source)
    if 1 in (tables(target).discount, tables(source).discount):
        raise MappingError(
            "distances need a discount below 1 in both tasks, at which they have a bound: got 1; "
            "FoundMapping.bound of find_mappings holds at 1 too"
        )
    with shown(progress) as bars:
        return _Fixed(tasks, tolerance, bars).bisimulation


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
    >>> [proposal.how for proposal in by_lax_bisimulation(tasks)]
    ['lax bisimulation: nearest pair', 'lax bisimulation: nearest pair of the nearest state']
    """
    fixed = _Fixed(tasks, TOLERANCE)
    yield tasks.proposal(fixed.bisimulation.nearest, "lax bisimulation: nearest pair")
    yield tasks.proposal(fixed.by_state, "lax bisimulation: nearest pair of the nearest state")


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
        if size > LARGEST_PAIRS:
            raise MappingError(
                f"lax bisimulation compares up to {LARGEST_PAIRS:,} pairs with pairs: these "
                f"tasks have {size:,}"
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
        discount = self.tasks.target_mdp.discount
        distances, error = fixed_point(own, other, discount, self.tolerance, self.bars)
        slack = self.tasks.target_solution.error_bound + self.tasks.source_solution.error_bound
        return distances, error + slack

    @cached_property
    def bisimulation(self) -> LaxBisimulation:
        """The distances between the tasks' own states and pairs."""
        (_, blocks), (other, source_blocks) = self.quotients
        between, error = self.solved
        kind, distance = between.pairs.argmin(axis=1), between.pairs.min(axis=1)
        live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)
        index = np.where(live, _first_pairs(source_blocks, len(other.reward))[kind[pairs]], ENDED)
        bound = np.where(live, distance[pairs] + error, 0.0)
        solutions = self.tasks.target_solution, self.tasks.source_solution
        bound = np.maximum(bound, np.where(live, apart(index, *solutions) + error, 0.0))
        states = between.states[blocks.states][:, source_blocks.states]
        apart_at_least = np.subtract.outer(*(solution.values for solution in solutions))
        states = np.maximum(states, abs(apart_at_least)) + error
        return LaxBisimulation(frozen(states), frozen(index), frozen(bound), error)

    @property
    def by_state(self) -> IntArray:
        """The nearest pair of the nearest state, (S, A)."""
        (_, blocks), (other, source_blocks) = self.quotients
        between, _ = self.solved
        state = between.states.argmin(axis=1)
        live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)
        choices = other.pairs[state[blocks.states]]  # (S, A'')
        distance = between.pairs[pairs[:, :, None], np.maximum(choices, 0)[:, None, :]]
        distance = np.where(choices[:, None, :] >= 0, distance, np.inf)
        kind = np.take_along_axis(choices, distance.argmin(axis=2), axis=1)
        return np.where(live, _first_pairs(source_blocks, len(other.reward))[kind], ENDED)


def _first_pairs(blocks: Blocks, kinds: int) -> IntArray:
    """Return the first pair of each kind, `ENDED` for the kind that has none: the end."""
    kind, first = np.unique(blocks.pairs.ravel(), return_index=True)
    pairs = np.full(kinds, ENDED)
    pairs[kind[kind >= 0]] = first[kind >= 0]
    return pairs
