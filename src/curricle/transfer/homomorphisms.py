"""Mappings that are proofs: homomorphisms found by refining both tasks together.

No names are needed: states and actions may be numbered in any way, actions anew in every state
(Ravindran, Barto 2004; refinement as in Givan, Dean, Greig 2003).
"""

from collections.abc import Iterator

import numpy as np

from curricle.array_types import IntArray
from curricle.errors import MappingError
from curricle.transfer.mapping import UNMAPPED
from curricle.transfer.partition_refinement import Blocks, refined
from curricle.transfer.proposal import Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair

LARGEST = 20_000_000
"""State-action pairs of both tasks up to which they are refined."""


def by_homomorphism(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of each target pair to an equivalent source pair, if any pair has one.

    Equivalent pairs have the same Q*, which is the proof. A pair of the target in a state that has
    an equivalent source state reads that state; others may still read a pair from which both
    tasks go on alike. Where several source pairs are equivalent, such as images under a symmetry,
    the first state's is taken.

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
    live = ~tasks.target_mdp.terminal
    share = float((index[live] >= 0).mean())
    if share == 0:
        raise MappingError("no pair of the target is equivalent to one of the source")
    how = f"exact homomorphism: {share:.0%} of pairs have a source pair of the same Q*"
    mapping = SearchedMapping(tasks.target, tasks.source, index, how=how)
    error = tasks.target_solution.error_bound + tasks.source_solution.error_bound
    yield Proposal(mapping, how, error)


def equivalent_pairs(own: Blocks, other: Blocks) -> IntArray:
    """Return for each target pair an equivalent source pair, or `UNMAPPED`, (S, A) int64.

    Examples
    --------
    >>> own = Blocks(np.array([1, 0]), np.array([[4, 5], [-1, -1]]))
    >>> other = Blocks(np.array([0, 1]), np.array([[-1, -1], [5, 4]]))
    >>> equivalent_pairs(own, other)
    array([[ 3,  2],
           [-1, -1]])
    """
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
    found = (known[place] == wanted) & (wanted >= 0)
    return np.where(found, first[place], UNMAPPED).astype(np.int64)
