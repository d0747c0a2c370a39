"""Potentials of transfers: looked up in the sources while learning, or as an array."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.value_lookup import MAXIMUM, MEAN, MINIMUM, TOTAL, ValueLookup
from curricle.tasks.simd import inverse_of
from curricle.tasks.spaces import MISSING, frozen
from curricle.tasks.task import Task, generative_model
from curricle.transfer.aggregation import Aggregate, aggregate, maximum, mean, minimum, total
from curricle.transfer.component_mapping import ComponentMapping
from curricle.transfer.edges import Transfer
from curricle.transfer.mapping import ENDED, UNMAPPED, terminal_states, transferred

IntArray = npt.NDArray[np.int64]
COMPILED_AGGREGATES: dict[Aggregate, int] = {
    minimum: MINIMUM,
    maximum: MAXIMUM,
    mean: MEAN,
    total: TOTAL,
}


def combined_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
) -> MappedPotential | StateActionPotential:
    """Return the aggregated potential of N transfers, as an array where it cannot be looked up.

    `source_values` are N (S', A') float arrays.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> maze = GridWorld("S.T")
    >>> edges = [Transfer("a", "b", identity(maze), scale=c) for c in (1, 2)]
    >>> combined_potential(maze, edges, [np.ones((3, 4))] * 2, mean).values[0]
    array([1.5, 1.5, 1.5, 1.5])
    """
    mapped = mapped_potential(task, transfers, source_values, function)
    if mapped is not None:
        return mapped
    each = [edge.potential(q) for edge, q in zip(transfers, source_values, strict=True)]
    return StateActionPotential(task, aggregate(function, np.stack(each)))


def mapped_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
) -> MappedPotential | None:
    """Return the aggregated potential, looked up while learning; None if it cannot be.

    It can where all mappings go by component names between whole boxes and the aggregate is one of
    the library's own.
    """
    found = [t.mapping.lookups() for t in transfers if isinstance(t.mapping, ComponentMapping)]
    offsets = [one for one in found if one is not None]
    # By identity: an aggregate may be any object that can be called, also one without a hash.
    combine = next((code for known, code in COMPILED_AGGREGATES.items() if known is function), None)
    if combine is None or len(offsets) < len(transfers):
        return None
    tables = [_padded_table(edge, q) for edge, q in zip(transfers, source_values, strict=True)]
    actions, strides = list[IntArray](), list[IntArray]()
    for edge, table, of_components in zip(transfers, tables, offsets, strict=True):
        width, action = table.shape[1], edge.mapping.actions
        actions.append(np.where(action == MISSING, width - 1, action))
        strides += [np.where(one == MISSING, -1, one * width) for one in reversed(of_components)]
    first = _starts(tables)
    states = generative_model(task).states
    sizes = [part.size for part in reversed(states.components)]
    lookup = ValueLookup(
        values=frozen(np.concatenate([table.ravel() for table in tables])),
        first=frozen(first),
        unmapped_row=frozen(first + [table.size - table.shape[1] for table in tables]),
        size=frozen(np.array(sizes, np.uint64)),
        inverse=frozen(np.array([inverse_of(n, states.size) for n in sizes], np.uint64)),
        strides_at=frozen(_starts(strides).reshape(len(transfers), -1)),
        strides=frozen(np.concatenate(strides)),
        action=frozen(np.stack(actions)),
        combine=combine,
        initial=0.0,
    )
    return MappedPotential(task, lookup)


def _starts(arrays: Sequence[npt.NDArray[Any]]) -> IntArray:
    """Return where each array begins when they are put one after the other."""
    ends: IntArray = np.cumsum([array.size for array in arrays])
    return np.concatenate([[0], ends[:-1]])


def _padded_table(transfer: Transfer, source_values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return what a target reads of a source, (S' + 1, A' + 1).

    Pairs that are unmapped read the last row or column.
    """
    mapping = transfer.mapping
    q = np.pad(np.asarray(source_values, dtype=np.float64), (0, 1))
    index = np.zeros(q.shape, dtype=np.int64)
    index[:-1][terminal_states(mapping.source)] = ENDED
    index[-1], index[:, -1] = UNMAPPED, UNMAPPED
    return transferred(q, index, mapping.unmapped_value, transfer.scale, transfer.shift)
