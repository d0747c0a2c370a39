"""Potentials through mappings by name, prepared for compiled loops that read them on the fly."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from curricle.learning.potential import MappedPotential
from curricle.learning.reading import MAXIMUM, MEAN, MINIMUM, TOTAL, Reading
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, dynamics
from curricle.transfer.aggregation import Aggregate, maximum, mean, minimum, total
from curricle.transfer.by_name import ComponentMapping
from curricle.transfer.edge import Transfer

COMBINED: dict[Aggregate, int] = {
    minimum: MINIMUM,
    maximum: MAXIMUM,
    mean: MEAN,
    total: TOTAL,
}


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
    if function not in COMBINED or any(found is None for found in lookups):
        return None
    width = max(len(found) for found in lookups if found is not None)
    values, first, shares = list[npt.NDArray[np.float64]](), [0], [np.zeros(1, np.int64)]
    divisor, modulus, shares_at = (np.zeros((len(transfers), width), np.int64) for _ in range(3))
    divisor[...], modulus[...] = 1, 1
    for n, (transfer, given, found) in enumerate(
        zip(transfers, source_values, lookups, strict=True)
    ):
        assert found is not None
        values.append(_worth(transfer, given))
        first.append(first[-1] + values[-1].size)
        for c, (by, size, share) in enumerate(found):
            divisor[n, c], modulus[n, c] = by, size
            shares_at[n, c] = sum(len(part) for part in shares)
            shares.append(np.where(share < 0, -1, share * transfer.mapping.source.actions.size))
    reading = Reading(
        values=frozen(np.concatenate(values)),
        first=frozen(np.array(first[:-1])),
        unmapped=frozen(np.array([float(t.mapping.unmapped_value) for t in transfers])),
        divisor=frozen(divisor),
        modulus=frozen(modulus),
        shares_at=frozen(shares_at),
        shares=frozen(np.concatenate(shares)),
        action=frozen(np.stack([t.mapping.actions for t in transfers])),  # type: ignore[attr-defined]
        combine=COMBINED[function],
        initial=0.0,
    )
    return MappedPotential(task, reading)


def _worth(transfer: Transfer, source_values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return scale Q + shift of a source, flat, with Q = 0 where it is over."""
    source = transfer.mapping.source
    q = np.array(source_values, dtype=np.float64)
    ends = dynamics(source).terminal
    if ends is not None:
        q[ends] = 0.0
    return (transfer.scale * q + transfer.shift).ravel()
