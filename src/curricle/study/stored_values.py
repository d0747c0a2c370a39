"""What seeds learnt in a task, read from a store for the tasks that it is a source of."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from curricle.curriculum.sources import StoredValues
from curricle.learning.saved_result import values_of
from curricle.study.serialization import RUN, VALUES
from curricle.study.store import StoredUnit


class StoredSource(NamedTuple):
    """What the seeds of a unit learnt in a source, where it is stored."""

    units: Mapping[int, StoredUnit]
    """By seed."""
    read: bool
    """Whether its values are needed."""


def stored_values(
    arrays_of: Callable[..., Mapping[str, Any]],
    done: Mapping[int, StoredUnit],
    seeds: Sequence[int],
    *,
    read: bool,
) -> StoredValues:
    """Return what seeds learnt in a task, its values only if they are to be `read`.

    Parameters
    ----------
    arrays_of : callable
        As :meth:`StudyStore.arrays`.
    done : dict of int to StoredUnit
        The unit that holds each seed.
    seeds : sequence of int
    read : bool
    """
    units = {done[seed].path: done[seed] for seed in seeds}
    names = (RUN, VALUES) if read else (RUN,)
    arrays = {path: arrays_of(stored, *names) for path, stored in units.items()}
    rows = [(arrays[done[seed].path], done[seed].seeds.index(seed)) for seed in seeds]
    each = [values_of(found, k) for found, k in rows]
    values: Any = None  # not needed, or not saved: training raises an error then
    if all(one is not None for one in each):
        values = np.stack(each) if isinstance(each[0], np.ndarray) else each
    steps = np.array([found["steps_used"][k] for found, k in rows])
    scales = [float(found["scale"][k]) for found, k in rows if "scale" in found]
    return StoredValues(values, steps, scales)
