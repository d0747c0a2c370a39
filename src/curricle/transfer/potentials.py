"""Potentials of transfers: looked up in the sources while learning, or as an array."""

from collections.abc import Sequence

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
    """Return the aggregated potential of transfers, as an array where it cannot be looked up.

    The arguments are those of :func:`mapped_potential`.

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
    """Return the aggregated potential of transfers, looked up while learning; None if it cannot be.

    It can where all mappings go by component names between whole boxes and the aggregate is one of
    the library's own.

    Parameters
    ----------
    task : Task
        The target.
    transfers : sequence of N Transfer
    source_values : sequence of N (S', A') float arrays
    function : callable

    Examples
    --------
    >>> from curricle import Pursuit, project
    >>> hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    >>> edge = Transfer("chase", "hunt", project(hunt, chase, predator="predator_2"))
    >>> phi = mapped_potential(hunt, [edge], [np.full((81, 5), -2.0)], minimum)
    >>> float(phi.values[1, 0])
    -2.0
    """
    lookups = [
        t.mapping.lookups() if isinstance(t.mapping, ComponentMapping) else None for t in transfers
    ]
    # By identity: an aggregate may be any object that can be called, also one without a hash.
    combine = next((code for known, code in COMPILED_AGGREGATES.items() if known is function), None)
    if combine is None or any(found is None for found in lookups):
        return None
    values, strides = list[npt.NDArray[np.float64]](), list[npt.NDArray[np.int64]]()
    first, unmapped_row, strides_at, actions = [], [], [], []
    for transfer, given, found in zip(transfers, source_values, lookups, strict=True):
        assert found is not None
        assert isinstance(transfer.mapping, ComponentMapping)
        table, action = _padded_table(transfer, given), transfer.mapping.actions
        n_states, width = table.shape
        first.append(sum(part.size for part in values))
        unmapped_row.append(first[-1] + (n_states - 1) * width)
        values.append(table)
        actions.append(np.where(action == MISSING, width - 1, action))
        strides_at.append(list[int]())
        for stride in reversed(found):
            strides_at[-1].append(sum(len(part) for part in strides))
            strides.append(np.where(stride == MISSING, -1, stride * width))
    states = generative_model(task).states
    sizes = [part.size for part in reversed(states.components)]
    lookup = ValueLookup(
        values=frozen(np.concatenate([part.ravel() for part in values])),
        first=frozen(np.array(first)),
        unmapped_row=frozen(np.array(unmapped_row)),
        size=frozen(np.array(sizes, np.uint64)),
        inverse=frozen(np.array([inverse_of(n, states.size) for n in sizes], np.uint64)),
        strides_at=frozen(np.array(strides_at)),
        strides=frozen(np.concatenate(strides)),
        action=frozen(np.stack(actions)),
        combine=combine,
        initial=0.0,
    )
    return MappedPotential(task, lookup)


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
