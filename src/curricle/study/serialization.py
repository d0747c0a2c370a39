"""A learning result as plain arrays, to be sent and stored as files, and back again."""

import io
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from curricle.frozen_arrays import frozen
from curricle.learning.record import Snapshots
from curricle.learning.result import CURVES, TOTALS, LearningResult, lengthened
from curricle.learning.storage import SparseValues

Arrays = Mapping[str, npt.NDArray[Any]]
OTHERS = ("task", "learner", "seeds", "values", "visits", "snapshots")
PLAIN = tuple(field.name for field in fields(LearningResult) if field.name not in OTHERS)
"""The arrays of a result by seed, and ``steps``."""
RUN, VALUES, SNAPSHOTS = GROUPS = "run", "values", "snapshots"
"""Groups of a unit's arrays: curves and counts, what was learnt, values on the way."""

DECISION_SCHEMA = {
    "task": "string",
    "seed": "int64",
    "steps": "int64",
    "ends": "bool",
    "criterion": "string",
    **dict.fromkeys(("lowest", "level", "rise", "plateau"), "double"),
    "reason": "string",
}
"""Columns of a unit's decisions, and their types."""
DTYPES = {
    **dict.fromkeys(("steps", "seeds", "source_steps", "episodes", "snapshot_steps"), "int64"),
    **dict.fromkeys(("steps_used", "episodes_used", "evaluation_steps"), "int64"),
    **dict.fromkeys(("out_of_memory", "own_rewards"), "bool"),
    "snapshot_values": "float32",
}
"""Of the arrays of a unit that are not of float64."""
OWN = re.compile(r"(states|values)_(\d+)(/.*)?")
"""An array of one seed, by its row."""
SPENT, MOST_STEPS = ("source_steps", "steps_used"), 2**53
"""Steps that a number of double precision counts."""
LARGEST_TABLE = 2**28
"""Bytes of a table at most."""


class UnitResult(NamedTuple):
    """What training a unit returns."""

    arrays: Arrays
    """Those of the :class:`LearningResult` (:func:`arrays_of`), and by seed (K,) ``source_steps``,
    of them ``retraining_steps``, and ``scale``, ``shift`` and ``refusal`` if it was calibrated."""
    decisions: pa.Table
    """Why each seed went on or stopped, a row a checkpoint, of `DECISION_SCHEMA`."""


def arrays_of(result: LearningResult) -> dict[str, npt.NDArray[Any]]:
    """Return a result's arrays by name.

    ``values`` are there if they were saved, or for each seed k the ``states_k`` and ``values_k`` of
    its sparse table, or the parameters of its network, ``values_k/name``; ``visits`` if they were
    counted; ``snapshot_steps`` and ``snapshot_values`` if there are snapshots.

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
    if result.visits is not None:
        found["visits"] = result.visits
    if result.snapshots is not None:
        found["snapshot_steps"] = result.snapshots.steps
        found["snapshot_values"] = result.snapshots.values
    return found


def result_of(arrays: Arrays, task: Any = None, learner: Any = None) -> LearningResult:
    """Return the result that :func:`arrays_of` was called on; without values if there are none.

    Those of a network are its parameters: :func:`source_values` makes networks of them.
    """
    seeds = tuple(arrays["seeds"].tolist())
    values: Any = arrays.get("values")
    if f"states_{len(seeds) - 1}" in arrays:
        values = tuple(
            SparseValues(arrays[f"states_{k}"], arrays[f"values_{k}"]) for k in range(len(seeds))
        )
    elif values is None and values_of(arrays, 0) is not None:
        values = tuple(values_of(arrays, k) for k in range(len(seeds)))
    snapshots = None
    if "snapshot_steps" in arrays:
        steps, tables = (frozen(arrays[f"snapshot_{name}"]) for name in ("steps", "values"))
        snapshots = Snapshots(seeds[0], steps, tables)
    plain: dict[str, Any] = {name: frozen(arrays[name]) for name in PLAIN}
    return LearningResult(
        task=task,
        learner=learner,
        seeds=seeds,
        values=frozen(values) if isinstance(values, np.ndarray) else values,
        visits=frozen(arrays["visits"]) if "visits" in arrays else None,
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
        own = OWN.fullmatch(name)
        of_first = name.startswith("snapshot_")
        if own and int(own[2]) in rows:
            found[f"{own[1]}_{rows.index(int(own[2]))}{own[3] or ''}"] = array
        elif name == "steps" or (of_first and 0 in rows):
            found[name] = array
        elif not own and not of_first:
            found[name] = array[rows]
    return found


def joined_units(parts: Sequence[UnitResult]) -> UnitResult:
    """Return the results of several units of a task as that of one, seeds ascending.

    Shorter curves are held to the longest, as by :func:`joined_results`. Snapshots stay if they are
    of the first seed of all. How the units were grouped does not change a byte.
    """
    if len(parts) == 1:
        return parts[0]
    parts = sorted(parts, key=lambda part: part.arrays["seeds"][0])
    steps = max((part.arrays["steps"] for part in parts), key=len)
    seeds = np.concatenate([part.arrays["seeds"] for part in parts])
    order = np.argsort(seeds)
    own = _own_arrays(parts, np.argsort(order).tolist())
    arrays = dict[str, npt.NDArray[Any]]()
    for name, first in parts[0].arrays.items():
        if name == "steps":
            arrays[name] = steps
        elif name.startswith("snapshot_"):
            arrays[name] = first
        elif OWN.fullmatch(name):
            arrays |= own  # in the place of the first of them
        else:
            each = [part.arrays[name] for part in parts]
            if name in CURVES:
                each = [lengthened(name, one, len(steps)) for one in each]
            arrays[name] = np.concatenate(each)[order]
    decisions = pa.concat_tables([part.decisions for part in parts])
    ascending = pc.sort_indices(decisions, [("seed", "ascending")])  # stable
    return UnitResult(arrays, decisions.take(ascending))


def _own_arrays(parts: Sequence[UnitResult], rows: Sequence[int]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays that each seed has for itself, by row; `rows` are those of the parts."""
    found, before = list[tuple[int, str, npt.NDArray[Any]]](), 0
    for part in parts:
        for name, array in part.arrays.items():
            if own := OWN.fullmatch(name):
                row = rows[before + int(own[2])]
                found.append((row, f"{own[1]}_{row}{own[3] or ''}", array))
        before += len(part.arrays["seeds"])
    return {name: array for _, name, array in sorted(found, key=lambda one: one[0])}


def checkpoints_of(arrays: Arrays) -> int:
    """Return how many checkpoints a unit's arrays have; ValueError if they do not say."""
    if "steps" not in arrays:
        raise ValueError("it has no steps")
    return arrays["steps"].size


def check_arrays(
    arrays: dict[str, npt.NDArray[Any]],
    seeds: Sequence[int],
    pairs: tuple[int, int],
) -> dict[str, npt.NDArray[Any]]:
    """Return a unit's arrays as they are; ValueError if they are not those of a result.

    `pairs` are the states and actions of its task.
    """
    n, n_seeds = checkpoints_of(arrays), len(seeds)
    shapes: dict[str, tuple[int, ...]] = {"steps": (n,)}
    shapes |= dict.fromkeys(CURVES, (n_seeds, n))
    shapes |= dict.fromkeys(("seeds", "source_steps", *TOTALS), (n_seeds,))
    if "snapshot_steps" in arrays:
        moments = arrays["snapshot_steps"].size
        shapes |= {"snapshot_steps": (moments,), "snapshot_values": (moments, *pairs)}
    for name, shape in shapes.items():
        found = arrays.get(name)
        if found is None or found.shape != shape or not n:
            raise ValueError(f"{name} must be an array of shape {shape}")
        if found.dtype != (kind := DTYPES.get(name, "float64")):
            raise ValueError(f"{name} must be an array of {kind}: got {found.dtype}")
    if (np.diff(arrays["steps"], prepend=-1) <= 0).any():
        raise ValueError("steps must ascend from 0")
    if arrays["seeds"].tolist() != list(seeds):
        raise ValueError("seeds must be those of its unit")
    for name in SPENT:
        if not 0 <= arrays[name].min() <= arrays[name].max() <= MOST_STEPS:
            raise ValueError(f"{name} must be from 0 to {MOST_STEPS:,}")
    for name in shapes.keys() & {*CURVES, "snapshot_values"}:
        if np.isinf(arrays[name]).any():
            raise ValueError(f"{name} must have finite numbers")
    return arrays


def group_of(name: str) -> str:
    """Return the group of an array.

    Examples
    --------
    >>> group_of("steps"), group_of("values_0/net.weight"), group_of("snapshot_steps")
    ('run', 'values', 'snapshots')
    """
    if name.startswith("snapshot_"):
        return SNAPSHOTS
    return VALUES if re.match(r"values|states|visits", name) else RUN


def read_npy(file: IO[bytes], size: int) -> npt.NDArray[Any]:
    """Return an array of as many bytes as its file has left after the header, without pickles.

    ValueError where the header says something else.
    """
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"its arrays must be of format 1.0: got {version}")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    if dtype.hasobject:
        raise ValueError("its arrays must not hold Python objects, which are pickles")
    if math.prod(shape) * dtype.itemsize != size - file.tell():
        raise ValueError(f"an array of shape {shape} does not fill its file")
    flat = np.frombuffer(bytearray(file.read()), dtype)
    return flat.reshape(shape, order="F" if fortran else "C")


def read_parquet(content: bytes, schema: Mapping[str, str], most: int) -> pa.Table:
    """Return a Parquet table of `most` rows at most; ValueError if its columns are others.

    A text that rows share is stored once, so a small file may have large columns: they are measured
    before they are made.
    """
    texts = [name for name, kind in schema.items() if kind == "string"]
    try:
        with pq.ParquetFile(io.BytesIO(content)) as file:
            found = {field.name: str(field.type) for field in file.schema_arrow}
        if found != schema:
            raise ValueError(f"it must have the columns {', '.join(schema)}")
        with pq.ParquetFile(io.BytesIO(content), read_dictionary=texts) as file:
            about = file.metadata
            size = sum(about.row_group(n).total_byte_size for n in range(about.num_row_groups))
            if about.num_rows > most or size > LARGEST_TABLE:
                raise ValueError(f"it must have at most {most:,} rows, not {about.num_rows:,}")
            table = file.read()
        if any(column.null_count for column in table.columns):
            raise ValueError("it must have a value in each row of each column")
        if (size := sum(_text_size(table[name]) for name in texts)) > LARGEST_TABLE:
            raise ValueError(f"its texts must have at most {LARGEST_TABLE:,} bytes, not {size:,}")
        return table.cast(pa.schema(schema.items()))
    except (pa.ArrowException, OSError, MemoryError) as error:
        raise ValueError(f"it is no table: {error}") from None


def _text_size(column: pa.ChunkedArray) -> int:
    """Return the bytes of all texts of a dictionary-encoded column."""
    return sum(
        int(
            np.asarray(pc.binary_length(chunk.dictionary))[np.asarray(chunk.indices)].sum(dtype=int)
        )
        for chunk in column.chunks
    )


def without_snapshots(result: UnitResult) -> UnitResult:
    """Return a unit's result without snapshots."""
    kept = {name: one for name, one in result.arrays.items() if not name.startswith("snapshot_")}
    return result._replace(arrays=kept)


def curve_table(task: str, arrays: Arrays) -> pa.Table:
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
