"""The arrays of a unit: by group, of some seeds, of several units as one; and its tables."""

import io
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from curricle.learning.result import LearningResult, joined_results
from curricle.learning.saved_result import Arrays, arrays_of

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
OF_A_SEED = re.compile(r"(states|values)_(\d+)(/.*)?")  # an array of one seed, by its row
OF_UNITS = ("source_steps", "scale", "refusal", "level", "level_base")
"""Arrays by seed that a unit has beside those of its result: two if it was calibrated, two if it is
a control that knows nothing."""
LARGEST_TABLE = 2**28  # bytes of a table at most


class UnitResult(NamedTuple):
    """What training a unit returns."""

    arrays: Arrays  # those of the `LearningResult` (`arrays_of`), and `OF_UNITS`
    decisions: pa.Table
    """Why each seed went on or stopped, a row a checkpoint, of `DECISION_SCHEMA`."""


def of_seeds(arrays: Arrays, seeds: Collection[int]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of some seeds; snapshots stay if their seed, the first, is one of them."""
    rows = np.flatnonzero(np.isin(arrays["seeds"], list(seeds))).tolist()
    kept = dict[str, npt.NDArray[Any]]()
    for name, array in arrays.items():
        of_seed = OF_A_SEED.fullmatch(name)
        of_first = name.startswith("snapshot_")
        if of_seed and int(of_seed[2]) in rows:
            kept[f"{of_seed[1]}_{rows.index(int(of_seed[2]))}{of_seed[3] or ''}"] = array
        elif name == "steps" or (of_first and 0 in rows):
            kept[name] = array
        elif not of_seed and not of_first:
            kept[name] = array[rows]
    return kept


def joined_units(parts: Sequence[UnitResult]) -> UnitResult:
    """Return the results of several units of a task as that of one, seeds ascending."""
    # Shorter curves are held to the longest. Snapshots stay if they are of the first seed of all.
    # How the units were grouped does not change a byte.
    if len(parts) == 1:
        return parts[0]
    parts = sorted(parts, key=lambda part: part.arrays["seeds"][0])
    whole = joined_results([LearningResult.of_arrays(part.arrays) for part in parts])
    if whole.snapshots is not None and whole.snapshots.seed != whole.seeds[0]:
        whole = replace(whole, snapshots=None)
    arrays = arrays_of(whole)
    order = np.argsort(np.concatenate([part.arrays["seeds"] for part in parts]))
    for name in OF_UNITS:
        if name in parts[0].arrays:
            arrays[name] = np.concatenate([part.arrays[name] for part in parts])[order]
    decisions = pa.concat_tables([part.decisions for part in parts])
    ascending = pc.sort_indices(decisions, [("seed", "ascending")])  # stable
    return UnitResult(arrays, decisions.take(ascending))


def group_of(name: str) -> str:
    """Return the group of an array by its name: run, values, snapshots, ..."""
    if name.startswith("snapshot_"):
        return SNAPSHOTS
    return VALUES if re.match(r"values|states", name) else RUN


def read_parquet(content: bytes, schema: Mapping[str, str], most: int) -> pa.Table:
    """Return a Parquet table of `most` rows at most; ValueError if its columns are others."""
    # A text that rows share is stored once, so a small file may have large columns: they are
    # measured before they are made.
    texts = [name for name, kind in schema.items() if kind == "string"]
    try:
        with pq.ParquetFile(io.BytesIO(content)) as file:
            columns = {field.name: str(field.type) for field in file.schema_arrow}
        if columns != schema:
            raise ValueError(f"it must have the columns {', '.join(schema)}")
        with pq.ParquetFile(io.BytesIO(content), read_dictionary=texts) as file:
            about = file.metadata
            groups = [about.row_group(n) for n in range(about.num_row_groups)]
            chunks = [group.column(n) for group in groups for n in range(group.num_columns)]
            rows = sum(group.num_rows for group in groups)
            size = sum(group.total_byte_size for group in groups)
            if not about.num_rows == rows <= most or size > LARGEST_TABLE:
                raise ValueError(
                    f"it must have at most {most:,} rows and {LARGEST_TABLE:,} bytes: got {rows:,} "
                    f"and {size:,}"
                )
            if not {chunk.compression for chunk in chunks} <= {"SNAPPY", "UNCOMPRESSED"}:
                raise ValueError("it must be compressed by SNAPPY")  # others unpack a thousandfold
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


def as_parquet(table: pa.Table) -> bytes:
    """Return a table as the content of a Parquet file."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return bytes(sink.getvalue().to_pybytes())
