"""What the file of a saved result says of its task and its learner, in plain JSON."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import frozen
from curricle.errors import CurricleError, SettingError, StoreError
from curricle.files import SavedFile
from curricle.learning.learners import (
    SARSA,
    DoubleQLearning,
    ExpectedSARSA,
    Learner,
    OptimisticQLearning,
    QLearning,
)
from curricle.learning.schedules import Schedule
from curricle.learning.storage import SparseValues
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import is_observation_task

Arrays = Mapping[str, npt.NDArray[Any]]
LEARNERS: dict[str, type[Learner]] = {
    kind.__name__: kind
    for kind in (QLearning, SARSA, ExpectedSARSA, DoubleQLearning, OptimisticQLearning)
}
"""Those that a file may name; nothing else is made of what it says."""


def task_record(task: Any) -> dict[str, Any]:
    """Return what tells whether a task fits values: its spaces in words, and their sizes."""
    if task is None:
        return {}
    if is_observation_task(task):
        return {"spaces": f"observations {task.observations}, actions {task.actions}"}
    rules = generative_model(task)
    spaces = f"states {rules.states}, actions {rules.actions}"
    return {"spaces": spaces, "pairs": [rules.states.size, rules.actions.size]}


def pairs_of(saved: SavedFile, record: Any, task: Any) -> tuple[int, int] | None:
    """Return the states and actions of values that were saved, those of the task if it is given."""
    own_record, recorded = task_record(task), record if isinstance(record, Mapping) else {}
    if own_record and recorded and own_record["spaces"] != recorded.get("spaces"):
        raise SettingError(
            f"a result must be loaded with its own task: {saved.path} has "
            f"{recorded.get('spaces')}, the task has {own_record['spaces']}"
        )
    pairs = (own_record or recorded).get("pairs")
    return None if pairs is None else (int(pairs[0]), int(pairs[1]))


@contextmanager
def as_saved(saved: SavedFile) -> Iterator[None]:
    """Turn what reading a file's arrays and words may raise into a StoreError in one line."""
    try:
        yield
    except CurricleError:
        raise
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
        why = " ".join(f"{kind}{error}".split())
        raise StoreError(f"{saved.path} is not as save() writes it: {why}") from None


def learner_record(learner: Any) -> dict[str, Any]:
    """Return a learner as JSON holds it: its class, and the settings of Curricle's own."""
    kind = type(learner)
    if LEARNERS.get(kind.__name__) is not kind:
        return {"type": kind.__name__}
    settings = {setting.name: getattr(learner, setting.name) for setting in fields(learner)}
    return {
        "type": kind.__name__,
        "settings": {
            name: {"schedule": list(value)} if isinstance(value, Schedule) else value
            for name, value in settings.items()
        },
    }


def learner_of(record: Any) -> Learner | None:
    """Return the learner of a record; None where it is none of Curricle's. ValueError if wrong."""
    if not isinstance(record, Mapping) or "settings" not in record:
        return None
    kind = LEARNERS.get(record.get("type", ""))
    if kind is None or not isinstance(record["settings"], Mapping):
        raise ValueError(f"a learner must be one of {', '.join(LEARNERS)}: got {record}")
    try:
        settings = dict[str, Any]()
        for name, value in record["settings"].items():
            if isinstance(value, Mapping):
                shape, *numbers = value.get("schedule", ())
                value = Schedule(int(shape), *map(float, numbers))
            settings[name] = tuple(value) if isinstance(value, list) else value
        return kind(**settings)
    except (TypeError, CurricleError) as error:
        raise ValueError(f"a learner must have its own settings: {error}") from None


# -- arrays ----------------------------------------------------------------------------------------


class ResultField(NamedTuple):
    """An array of a result, as it is joined, checked, saved and shown."""

    axes: str  # K a seed, T a checkpoint
    dtype: str
    unit: str = ""  # of its column in a table
    held: bool = False  # whether a curve keeps its last value after a seed's end; else it is NaN


FIELDS = {
    "steps": ResultField("T", "int64", "steps in the task"),
    "training_return": ResultField("KT", "float64", "mean undiscounted return of an episode"),
    "greedy_return": ResultField("KT", "float64", "return of the greedy policy", held=True),
    "episodes": ResultField("KT", "int64", "episodes ended", held=True),
    "steps_used": ResultField("K", "int64"),
    "episodes_used": ResultField("K", "int64"),
    "evaluation_steps": ResultField("K", "int64"),
    "out_of_memory": ResultField("K", "bool"),
    "guard_share": ResultField("KT", "float64", "share of steps", held=True),
    "own_rewards": ResultField("K", "bool"),
}
"""The arrays of a :class:`LearningResult`, in the order in which files hold them."""
CURVES = tuple(
    sorted(
        (name for name, field in FIELDS.items() if field.axes == "KT"),
        key=lambda name: FIELDS[name].dtype == "int64",
    )
)
"""In the order of a table's columns: counts come last."""
TOTALS = tuple(name for name, field in FIELDS.items() if field.axes == "K")
FLOATS = "float64", "float32"  # of values that were learnt
MOST_STEPS = 2**53  # steps that a number of double precision counts


def arrays_of(result: Any) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a :class:`LearningResult` by name."""
    # With values, or of each seed k a sparse table (states_k, values_k) or a network's
    # (values_k/name), where they were saved.
    arrays = {name: getattr(result, name) for name in FIELDS}
    arrays["seeds"] = np.array(result.seeds, dtype=np.int64)
    arrays |= arrays_of_values(result.values)
    if result.snapshots is not None:
        arrays["snapshot_steps"] = result.snapshots.steps
        arrays["snapshot_values"] = result.snapshots.values
    return arrays


def arrays_of_values(values: Any) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of what K seeds learnt: a dense table, sparse ones, networks, or None."""
    if values is None:
        return {}
    if isinstance(values, np.ndarray):
        return {"values": values}
    arrays = dict[str, npt.NDArray[Any]]()
    for k, table in enumerate(values):
        if isinstance(table, SparseValues):
            arrays |= {f"states_{k}": table.states, f"values_{k}": table.values}
        else:
            named = table if isinstance(table, Mapping) else table.parameters()
            arrays |= {f"values_{k}/{name}": array for name, array in named.items()}
    return arrays


def all_values_of(arrays: Arrays, n_seeds: int) -> Any:
    """Return what :func:`arrays_of_values` was called on; networks are dicts of parameters."""
    if "values" in arrays:
        return frozen(arrays["values"])
    if "states_0" in arrays:
        return tuple(
            SparseValues(frozen(arrays[f"states_{k}"]), frozen(arrays[f"values_{k}"]))
            for k in range(n_seeds)
        )
    if values_of(arrays, 0) is None:
        return None
    return tuple(values_of(arrays, k) for k in range(n_seeds))


def values_of(arrays: Arrays, k: int) -> Any:
    """Return the k-th seed's table, or its network's parameters; None where neither is there."""
    if "values" in arrays:
        return arrays["values"][k]
    prefix = f"values_{k}/"
    return {
        name.removeprefix(prefix): v for name, v in arrays.items() if name.startswith(prefix)
    } or None


def checkpoints_of(arrays: Arrays) -> int:
    """Return how many checkpoints a result's arrays have; ValueError if they do not say."""
    if "steps" not in arrays:
        raise ValueError("it has no steps")
    return arrays["steps"].size


def check_result_arrays(
    arrays: Arrays,
    seeds: Sequence[int],
    pairs: tuple[int, int],
    counts: Sequence[str] = ("steps_used",),
) -> None:
    """Raise ValueError unless arrays are those of a result."""
    n, of_seeds = checkpoints_of(arrays), (len(seeds),)
    shapes: dict[str, tuple[int, ...]] = {"T": (n,), "K": of_seeds, "KT": (*of_seeds, n)}
    expected = {name: (shapes[field.axes], field.dtype) for name, field in FIELDS.items()}
    expected |= dict.fromkeys(("seeds", *counts), (of_seeds, "int64"))
    if "snapshot_steps" in arrays:
        moments = arrays["snapshot_steps"].size
        expected["snapshot_steps"] = (moments,), "int64"
        expected["snapshot_values"] = (moments, *pairs), "float32"
    for name, (shape, dtype) in expected.items():
        array = arrays.get(name)
        if array is None or array.shape != shape or not n:
            raise ValueError(f"{name} must be an array of shape {shape}")
        if array.dtype != dtype:
            raise ValueError(f"{name} must be an array of {dtype}: got {array.dtype}")
    if (np.diff(arrays["steps"], prepend=-1) <= 0).any():
        raise ValueError("steps must ascend from 0")
    if arrays["seeds"].tolist() != list(seeds):
        raise ValueError("seeds must be those of its unit")
    for name in counts:
        if not 0 <= arrays[name].min() <= arrays[name].max() <= MOST_STEPS:
            raise ValueError(f"{name} must be from 0 to {MOST_STEPS:,}")
    for name in expected.keys() & {*CURVES, "snapshot_values"}:
        if np.isinf(arrays[name]).any():
            raise ValueError(f"{name} must have finite numbers")


def check_value_arrays(arrays: Arrays, n_seeds: int, pairs: tuple[int, int] | None) -> None:
    """Raise ValueError unless the values among arrays are those of so many seeds."""
    # `pairs` are the states and actions of their task, None where that is not known; compiled loops
    # read tables without looking whether a state lies in them.
    table = arrays.get("values")
    if table is not None:
        fits = pairs is None or table.shape[-2:] == pairs
        if table.dtype not in FLOATS or table.ndim != 3 or len(table) != n_seeds or not fits:
            raise ValueError(f"values must be a table for each seed ({n_seeds}), {_size(pairs)}")
    for k in range(n_seeds if "states_0" in arrays else 0):
        states, values = (arrays.get(f"{name}_{k}") for name in ("states", "values"))
        if states is None or values is None or states.ndim != 1 or values.ndim != 2:
            raise ValueError(f"states_{k} and values_{k} must be a sparse table")
        ascend = states.dtype == "int64" and (np.diff(states, prepend=-1) > 0).all()
        within = pairs is None or (not len(states) or states[-1] < pairs[0])
        wide = len(values) == len(states) and (pairs is None or values.shape[1] == pairs[1])
        if not (ascend and within and wide and values.dtype in FLOATS):
            raise ValueError(f"states_{k} and values_{k} must be a sparse table, {_size(pairs)}")


def _size(pairs: tuple[int, int] | None) -> str:
    if pairs is None:
        return "one value for each state and action"
    return f"{pairs[0]:,} states x {pairs[1]:,} actions"
