"""Potentials through mappings by name, prepared for compiled loops that read them on the fly."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.value_lookup import MAXIMUM, MEAN, MINIMUM, TOTAL, Reading
from curricle.tasks.simd import inverse_of
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, generative_model
from curricle.transfer.aggregation import Aggregate, aggregate, maximum, mean, minimum, total
from curricle.transfer.by_name import ComponentMapping
from curricle.transfer.edges import Transfer

COMBINED: dict[Aggregate, int] = {
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
    """Return the aggregated potential of transfers: read on the fly where it can be, or an array.

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
    """Return the aggregated potential of transfers, to be read on the fly; None if it cannot be.

    It can where all mappings go by name between whole boxes and the aggregate is one of the
    library's own.

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
    combine = next((code for known, code in COMBINED.items() if known is function), None)
    if combine is None or any(found is None for found in lookups):
        return None
    values, shares = list[npt.NDArray[np.float64]](), list[npt.NDArray[np.int64]]()
    first, nowhere, shares_at, actions = [], [], [], []
    for transfer, given, found in zip(transfers, source_values, lookups, strict=True):
        assert found is not None
        assert isinstance(transfer.mapping, ComponentMapping)
        worth, missing = _worth(transfer, given), transfer.mapping.actions < 0
        n_states, width = worth.shape
        first.append(sum(part.size for part in values))
        nowhere.append(first[-1] + (n_states - 1) * width)
        values.append(worth)
        actions.append(np.where(missing, width - 1, transfer.mapping.actions))
        shares_at.append(list[int]())
        for share in reversed(found):
            shares_at[-1].append(sum(len(part) for part in shares))
            shares.append(np.where(share < 0, -1, share * width))
    generative = generative_model(task)
    sizes = [part.size for part in reversed(generative.states.components)]
    reading = Reading(
        values=frozen(np.concatenate([part.ravel() for part in values])),
        first=frozen(np.array(first)),
        nowhere=frozen(np.array(nowhere)),
        size=frozen(np.array(sizes, np.uint64)),
        inverse=frozen(np.array([inverse_of(n, generative.states.size) for n in sizes], np.uint64)),
        shares_at=frozen(np.array(shares_at)),
        shares=frozen(np.concatenate(shares)),
        action=frozen(np.stack(actions)),
        combine=combine,
        initial=0.0,
    )
    return MappedPotential(task, reading)


def _worth(transfer: Transfer, source_values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return scale Q + shift of a source, with Q = 0 where it is over: (S' + 1, A' + 1).

    The last row and column are what a pair without counterpart is worth.
    """
    source = transfer.mapping.source
    q = np.array(source_values, dtype=np.float64)
    ends = generative_model(source).terminal
    if ends is not None:
        q[ends] = 0.0
    worth = np.full((q.shape[0] + 1, q.shape[1] + 1), float(transfer.mapping.unmapped_value))
    worth[:-1, :-1] = transfer.scale * q + transfer.shift
    return worth
