"""How one source of a target reads another: by its family, or through the target."""

from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.design.proposals import SourceCandidate
from curricle.errors import CurriculumError
from curricle.tasks.task import generative_model, has_tables
from curricle.transfer.family_mapping import member_mappings
from curricle.transfer.mapping import ENDED, UNMAPPED, StateActionMapping, terminal_states

AGREES = 0.99
"""Share of the target's pairs for which a mapping through it must be one and the same."""


def mappings_between(
    target: Any, after: SourceCandidate, before: SourceCandidate
) -> tuple[Any, ...]:
    """Return how a source reads an earlier one: f(s', a') for the later source's pairs.

    Members of one family map onto each other as it declares. Other sources read each other through
    the target: a pair of the later one reads the pair of the earlier one that most of those target
    pairs read which read itself. Of several mappings those are taken by which the target's pairs
    agree, or the one by which they agree the most.

    Parameters
    ----------
    target : Task
        Whose pairs the mappings of both sources are from.
    after, before : SourceCandidate

    Raises
    ------
    CurriculumError
        When the sources are no members of one family, and have no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.relations import Relation
    >>> maze = GridWorld(["S....", ".....", ".....", ".....", "....T"])
    >>> small, large = (Relation("crop", share).source_of(maze) for share in (0.4, 0.8))
    >>> (mapping,) = mappings_between(maze, large, small)
    >>> print(mapping.coverage())
    20.0% of 60 target pairs mapped, 0.0% at the source's end, 80.0% unmapped; ...
    """
    own, other = after.member, before.member
    if own is not None and other is not None and own.family.factory is other.family.factory:
        return member_mappings(own, other, after.task, before.task)
    if not all(has_tables(task) for task in (target, after.task, before.task)):
        raise CurriculumError(
            "sources that build on each other must be members of one family, or have tables as "
            f"the target has: {after.name!r} and {before.name!r} do not"
        )
    reader = after.mappings[0].index
    found = [_through(reader, one.index, after.task, before.task) for one in before.mappings]
    best = max(agreement for agreement, _ in found)
    return tuple(
        StateActionMapping(after.task, before.task, index)
        for agreement, index in found
        if agreement >= min(best, AGREES)
    )


def _through(reader: IntArray, read: IntArray, after: Any, before: Any) -> tuple[float, IntArray]:
    """Return the most frequent pair that is read, (S', A'), and in how many it is that one."""
    shape = after.states.size, generative_model(after).actions.size
    known = (reader >= 0) & (read != UNMAPPED)
    index = np.full(shape[0] * shape[1], UNMAPPED, np.int64)
    if not known.any():
        return 0.0, index.reshape(shape)
    size = before.states.size * generative_model(before).actions.size - ENDED
    both = reader[known].astype(np.int64) * size + (read[known] - ENDED)
    pairs, counts = np.unique(both, return_counts=True)
    own, other = np.divmod(pairs, size)
    order = np.lexsort((other, -counts, own))  # of equal counts the first pair
    first = order[np.unique(own[order], return_index=True)[1]]
    index[own[first]] = other[first] + ENDED
    index = index.reshape(shape)
    index[terminal_states(after)] = ENDED
    return float(counts[first].sum() / counts.sum()), index
