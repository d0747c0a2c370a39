"""What a store holds of sources: which seeds are trained, and their values."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.study.serialization import RUN, VALUES
from curricle.study.source_values import StoredValues
from curricle.study.store import StoredUnit, StudyStore


def finished(units: Iterable[StoredUnit]) -> dict[str, dict[int, StoredUnit]]:
    """Return the units of each key by seed: key -> seed -> unit."""
    found: dict[str, dict[int, StoredUnit]] = {}
    for stored in units:
        found.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
    return found


def stored_values(
    store: StudyStore, done: Mapping[int, StoredUnit], seeds: Sequence[int], *, read: bool
) -> StoredValues:
    """Return what a store holds of a task, from whichever units its seeds are in.

    Parameters
    ----------
    store : StudyStore
    done : dict of int to StoredUnit
        Seed -> the unit that holds it.
    seeds : sequence of K int
    read : bool
        Whether the values are needed.

    Raises
    ------
    StoreError
        When a file is damaged.
    """
    where = [(done[seed], done[seed].seeds.index(seed)) for seed in seeds]
    units = {stored.path: stored for stored, _ in where}
    runs = {path: store.arrays(stored, RUN) for path, stored in units.items()}
    tables = {path: store.arrays(stored, VALUES) for path, stored in units.items()} if read else {}
    fitted = {path: store.calibrations(stored) for path, stored in units.items()}
    each = [_values_of(tables.get(stored.path, {}), row) for stored, row in where]
    values: Any = None  # not needed, or not saved: training raises an error then
    if all(one is not None for one in each):
        values = np.stack(each) if isinstance(each[0], np.ndarray) else each
    steps = [
        runs[stored.path]["steps_used"][row] + runs[stored.path]["retraining_steps"][row]
        for stored, row in where
    ]
    calibrated = [fitted[stored.path][row] for stored, row in where if fitted[stored.path]]
    scales = [(one["scale"], one["shift"]) for one in calibrated]
    return StoredValues(values, np.array(steps, dtype=np.int64), scales)


def _values_of(arrays: Mapping[str, npt.NDArray[Any]], row: int) -> Any:
    """Return one seed's table, or its network's parameters; None where neither is there."""
    if "values" in arrays:
        return arrays["values"][row]
    mine = f"values_{row}/"
    return {k.removeprefix(mine): v for k, v in arrays.items() if k.startswith(mine)} or None
