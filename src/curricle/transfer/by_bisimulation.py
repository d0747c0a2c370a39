"""Mappings by bisimulation: to pairs with the same Q*, and to the nearest pairs; without names."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from curricle.arrays import FloatArray, Frozen, IntArray, frozen
from curricle.errors import MappingError
from curricle.progress import SILENT, Bars, Progress, shown
from curricle.tasks.mdp import Task, tables
from curricle.text import brief_repr
from curricle.transfer.bisimulation import (
    MOST_WORK,
    WIDEST,
    Blocks,
    fixed_point,
    quotient,
    refined,
)
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.pair import Proposal, TaskPair, apart

LARGEST = 20_000_000  # state-action pairs of both tasks up to which they are refined


def by_homomorphism(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of each target pair to an equivalent source pair, if any pair has one.

    Equivalent pairs have the same Q*, as closely as both are known. A target state reads an
    equivalent source state, if there is one; else its pairs read pairs from which both tasks go on
    alike. Of several the first is taken.

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
    target, source = refined(tasks.models)
    index = equivalent_pairs(target, source)
    solutions = tasks.target_solution, tasks.source_solution
    error = 2 * sum(solution.error_bound for solution in solutions)
    index = np.where(apart(index, *solutions) <= error, index, UNMAPPED)
    live = ~tasks.target_mdp.terminal
    share = float((index[live] >= 0).mean())
    if share == 0:
        raise MappingError("no pair of the target is equivalent to one of the source")
    how = f"exact homomorphism: {share:.0%} of pairs have a source pair of the same Q*"
    yield tasks.proposal(index, how)


def equivalent_pairs(target: Blocks, source: Blocks) -> IntArray:
    """Return for each target pair an equivalent source pair, or `UNMAPPED`, (S, A) int64."""
    most = int(max(target.pairs.max(), source.pairs.max())) + 2

    def keys(blocks: Blocks) -> IntArray:
        key = blocks.states[:, None] * most + blocks.pairs
        return np.where(blocks.pairs < 0, -1, key).ravel()

    index = _first_of(keys(source), keys(target))
    elsewhere = _first_of(source.pairs.ravel(), target.pairs.ravel())
    index = np.where(index == UNMAPPED, elsewhere, index)
    return np.where(target.pairs.ravel() < 0, UNMAPPED, index).reshape(target.pairs.shape)


def _first_of(keys: IntArray, wanted: IntArray) -> IntArray:
    """Return where each wanted key is found first, `UNMAPPED` where it is not or is negative."""
    known, first = np.unique(keys, return_index=True)
    place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    there = (known[place] == wanted) & (wanted >= 0)
    return np.where(there, first[place], UNMAPPED).astype(np.int64)


# -- nearest pairs ---------------------------------------------------------------------------------

TOLERANCE = 1e-3  # how far below the fixed point distances may be, in units of the largest
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
    solves the equation of the target's discount.

    Iteration ends at most `tolerance` below the fixed point, in units of the largest distance, and
    after some minutes at most; what is missing is added, so that the bounds hold in any case.
    `progress` counts the rounds if it is True; a function is called after each with the error.

    Raises
    ------
    TaskError
        When a task has no tables.
    MappingError
        When a discount is 1, the tasks are too large, or a pair has more than 120 outcomes.

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
        return _nearest(tasks, tolerance, bars)[0]


def by_lax_bisimulation(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping to the nearest pair, and that to the nearest state and its nearest pair.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S...T"), GridWorld("S.T"))
    >>> [proposal.how for proposal in by_lax_bisimulation(tasks)]
    ['lax bisimulation: nearest pair', 'lax bisimulation: nearest pair of the nearest state']
    """
    lax, by_state = _nearest(tasks, TOLERANCE)
    yield tasks.proposal(lax.nearest, "lax bisimulation: nearest pair")
    yield tasks.proposal(by_state, "lax bisimulation: nearest pair of the nearest state")


def _nearest(
    tasks: TaskPair, tolerance: float, bars: Bars = SILENT
) -> tuple[LaxBisimulation, IntArray]:
    """Return the distances between two tasks, and the nearest pair of the nearest state, (S, A)."""
    solutions, discount = (tasks.target_solution, tasks.source_solution), tasks.target_mdp.discount
    (target, blocks), (source, source_blocks) = (
        quotient(model, discount, solution.values)
        for model, solution in zip(tasks.models, solutions, strict=True)
    )
    if (size := len(target.reward) * len(source.reward)) > LARGEST_PAIRS:
        raise MappingError(
            f"lax bisimulation compares up to {LARGEST_PAIRS:,} pairs with pairs: these tasks have "
            f"{size:,}"
        )
    if (work := target.chance.size * source.chance.size) > LARGEST_ROUND:
        raise MappingError(
            f"lax bisimulation couples up to {LARGEST_ROUND:,} pairs of outcomes in a round: "
            f"these tasks have {work:,}"
        )
    if (widest := max(target.chance.shape[1], source.chance.shape[1])) > WIDEST:
        raise MappingError(
            f"lax bisimulation takes up to {WIDEST} outcomes of a pair: got {widest}"
        )
    of_states, of_pairs, error = fixed_point(target, source, discount, tolerance, bars)
    error += sum(solution.error_bound for solution in solutions)  # a source is rewritten by its V*
    known, at = np.unique(source_blocks.pairs.ravel(), return_index=True)
    first = np.full(len(source.reward), ENDED)  # pair of each kind, but of the end's
    first[known[known >= 0]] = at[known >= 0]
    live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)

    kind, distance = of_pairs.argmin(axis=1), of_pairs.min(axis=1)
    index = np.where(live, first[kind[pairs]], ENDED)
    bound = np.where(live, distance[pairs] + error, 0.0)
    bound = np.maximum(bound, np.where(live, apart(index, *solutions) + error, 0.0))
    states = of_states[blocks.states][:, source_blocks.states]
    apart_at_least = np.subtract.outer(*(solution.values for solution in solutions))
    states = np.maximum(states, abs(apart_at_least)) + error

    choices = source.pairs[of_states.argmin(axis=1)[blocks.states]]  # (S, A'')
    distances = of_pairs[pairs[:, :, None], np.maximum(choices, 0)[:, None, :]]
    distances = np.where(choices[:, None, :] >= 0, distances, np.inf)
    by_state = first[np.take_along_axis(choices, distances.argmin(axis=2), axis=1)]
    lax = LaxBisimulation(frozen(states), frozen(index), frozen(bound), error)
    return lax, np.where(live, by_state, ENDED)
