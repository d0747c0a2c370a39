"""A learning result as plain arrays, to be sent and stored as files, and back again."""

import io
import re
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from curricle.curriculum.node import Node
from curricle.learning.record import Snapshots
from curricle.learning.result import LearningResult
from curricle.learning.storage import SparseValues
from curricle.tasks.spaces import frozen

Arrays = Mapping[str, npt.NDArray[Any]]
OTHERS = ("task", "learner", "seeds", "values", "snapshots")
PLAIN = tuple(field.name for field in fields(LearningResult) if field.name not in OTHERS)
"""The arrays of a result by seed, and ``steps``."""
RUN, VALUES, SNAPSHOTS = "run.npz", "values.npz", "snapshots.npz"
CURVES, DECISIONS = "curves.parquet", "decisions.parquet"
"""The files of a unit."""


class UnitResult(NamedTuple):
    """What training a unit returns."""

    arrays: Arrays
    """Those of the :class:`LearningResult` (:func:`arrays_of`), and by seed (K,) ``source_steps``,
    of them ``retraining_steps``, and ``scale``, ``shift`` and ``refusal`` if it was calibrated."""
    decisions: list[dict[str, Any]]
    """Why each seed went on or stopped, a row a checkpoint."""


def arrays_of(result: LearningResult) -> dict[str, npt.NDArray[Any]]:
    """Return a result's arrays by name.

    ``values`` are there if they were saved, or for each seed k the ``states_k`` and ``values_k`` of
    its sparse table, or the parameters of its network, ``values_k/name``; ``snapshot_steps`` and
    ``snapshot_values`` if there are snapshots.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> sorted(arrays_of(learn(GridWorld("S.T"), budget=100)))[-2:]
    ['training_return', 'values']
    """
    found = {name: getattr(result, name) for name in PLAIN}
    found["seeds"] = np.array(result.seeds, dtype=np.int64)
    if isinstance(result.values, np.ndarray):
        found["values"] = result.values
    elif result.values is not None:
        for k, one in enumerate(result.values):
            if isinstance(one, SparseValues):
                found |= {f"states_{k}": one.states, f"values_{k}": one.values}
            else:
                found |= {f"values_{k}/{name}": each for name, each in one.parameters().items()}
    if result.snapshots is not None:
        found["snapshot_steps"] = result.snapshots.steps
        found["snapshot_values"] = result.snapshots.values
    return found


def result_of(node: Node, arrays: Arrays) -> LearningResult:
    """Return the result that :func:`arrays_of` was called on; without values if there are none.

    Networks are left out: :func:`source_values` makes them anew.
    """
    seeds = tuple(arrays["seeds"].tolist())
    values: Any = arrays.get("values")
    if f"states_{len(seeds) - 1}" in arrays:
        values = tuple(
            SparseValues(arrays[f"states_{k}"], arrays[f"values_{k}"]) for k in range(len(seeds))
        )
    snapshots = None
    if "snapshot_steps" in arrays:
        steps, tables = (frozen(arrays[f"snapshot_{name}"]) for name in ("steps", "values"))
        snapshots = Snapshots(seeds[0], steps, tables)
    plain: dict[str, Any] = {name: frozen(arrays[name]) for name in PLAIN}
    return LearningResult(
        task=node.task,
        learner=node.learner,
        seeds=seeds,
        values=frozen(values) if isinstance(values, np.ndarray) else values,
        snapshots=snapshots,
        **plain,
    )


def values_of(arrays: Arrays, k: int) -> Any:
    """Return the k-th seed's table, or its network's parameters; None where neither is there."""
    if "values" in arrays:
        return arrays["values"][k]
    own = f"values_{k}/"
    return {name.removeprefix(own): v for name, v in arrays.items() if name.startswith(own)} or None


def of_seeds(arrays: Arrays, seeds: Collection[int]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of some seeds; snapshots stay if their seed, the first, is one of them."""
    rows = np.flatnonzero(np.isin(arrays["seeds"], list(seeds))).tolist()
    found = dict[str, npt.NDArray[Any]]()
    for name, array in arrays.items():
        own = re.fullmatch(r"(states|values)_(\d+)(/.*)?", name)
        of_first = name.startswith("snapshot_")
        if own and int(own[2]) in rows:
            found[f"{own[1]}_{rows.index(int(own[2]))}{own[3] or ''}"] = array
        elif name == "steps" or (of_first and 0 in rows):
            found[name] = array
        elif not own and not of_first:
            found[name] = array[rows]
    return found


def files_of(task: str, result: UnitResult) -> dict[str, bytes]:
    """Return a unit's files: curves and counts, values, snapshots, and tables as Parquet."""
    arrays: dict[str, dict[str, npt.NDArray[Any]]] = {}
    for name, array in result.arrays.items():
        values = VALUES if re.match(r"values|states", name) else RUN
        file = SNAPSHOTS if name.startswith("snapshot_") else values
        arrays.setdefault(file, {})[name] = array
    return {
        CURVES: as_parquet(_curve_table(task, result.arrays)),
        DECISIONS: as_parquet(pa.Table.from_pylist(result.decisions)),
        **{file: _npz(each, compressed=file == SNAPSHOTS) for file, each in arrays.items()},
    }


def _npz(arrays: Arrays, *, compressed: bool) -> bytes:
    buffer = io.BytesIO()
    save: Any = np.savez_compressed if compressed else np.savez
    save(buffer, **arrays)
    return buffer.getvalue()


def _curve_table(task: str, arrays: Arrays) -> pa.Table:
    """Return a unit's curves as a tidy table, each seed up to its own end."""
    steps = arrays["steps"]
    reached = steps[None, :] <= arrays["steps_used"][:, None]
    seed, checkpoint = np.nonzero(reached)
    columns = {
        "task": [task] * len(seed),
        "seed": arrays["seeds"][seed],
        "checkpoint": checkpoint,
        "steps": steps[checkpoint],
        "source_steps": arrays["source_steps"][seed],
    }
    for name in ("training_return", "greedy_return", "guard_share", "episodes"):
        columns[name] = arrays[name][reached]
    return pa.table(columns)


def as_parquet(table: pa.Table) -> bytes:
    """Return a table as the content of a Parquet file."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return bytes(sink.getvalue().to_pybytes())
