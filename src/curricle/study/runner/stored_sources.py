"""What a study's folder holds: which seeds are trained, and what is known of them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.study.runner.folder import RUN, VALUES, Stored, StudyFolder
from curricle.study.runner.source_values import Knowledge


def finished(units: Iterable[Stored]) -> dict[str, dict[int, Stored]]:
    """Return what is trained, key -> seed -> where it is."""
    found: dict[str, dict[int, Stored]] = {}
    for stored in units:
        found.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
    return found


def stored_knowledge(
    folder: StudyFolder, done: Mapping[int, Stored], seeds: Sequence[int], *, read: bool
) -> Knowledge:
    """Return what a folder holds of a task, from wherever its seeds are stored.

    Parameters
    ----------
    folder : StudyFolder
    done : dict of int to Stored
        Seed -> the unit that holds it.
    seeds : sequence of K int
    read : bool
        Whether its values are wanted.

    Raises
    ------
    StoreError
        When a file is damaged.
    """
    where = [(done[seed], done[seed].seeds.index(seed)) for seed in seeds]
    units = {stored.path: stored for stored, _ in where}
    runs = {path: folder.read(stored, RUN) for path, stored in units.items()}
    tables = {path: folder.read(stored, VALUES) for path, stored in units.items()} if read else {}
    fitted = {path: folder.calibrations(stored) for path, stored in units.items()}
    each = [_values_of(tables.get(stored.path, {}), row) for stored, row in where]
    values: Any = None  # not wanted, or not kept: training says so
    if all(one is not None for one in each):
        values = np.stack(each) if isinstance(each[0], np.ndarray) else each
    spent = [
        runs[stored.path]["steps_used"][row] + runs[stored.path]["returned_steps"][row]
        for stored, row in where
    ]
    calibrated = [fitted[stored.path][row] for stored, row in where if fitted[stored.path]]
    scales = [(one["scale"], one["shift"]) for one in calibrated]
    return Knowledge(values, np.array(spent, dtype=np.int64), scales)


def _values_of(arrays: Mapping[str, npt.NDArray[Any]], row: int) -> Any:
    """Return one seed's table, or its network's parameters; None where neither is there."""
    if "values" in arrays:
        return arrays["values"][row]
    mine = f"values_{row}/"
    return {k.removeprefix(mine): v for k, v in arrays.items() if k.startswith(mine)} or None
