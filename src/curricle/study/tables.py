"""Tables of many units, written in parts: all of one at once may not fit in memory."""

from collections.abc import Iterable, Iterator

import pyarrow as pa
import pyarrow.parquet as pq

from curricle.study.store import StoredUnit

ROWS = 2**17
"""Of a group of rows in a Parquet file."""


def apart(units: Iterable[StoredUnit]) -> Iterator[list[StoredUnit]]:
    """Yield units by seed, in lists such that all seeds of one come before those of the next.

    Examples
    --------
    >>> from pathlib import Path
    >>> units = [StoredUnit(Path(), "0f", seeds) for seeds in ((4, 5), (1, 3), (0, 2))]
    >>> [[unit.seeds for unit in each] for each in apart(units)]
    [[(0, 2), (1, 3)], [(4, 5)]]
    """
    group, last = list[StoredUnit](), -1
    for unit in sorted(units, key=lambda one: min(one.seeds)):
        if group and min(unit.seeds) > last:
            yield group
            group = []
        group.append(unit)
        last = max(last, *unit.seeds)
    if group:
        yield group


def parquet_of(parts: Iterable[pa.Table]) -> bytes:
    """Return tables, at least one, as one Parquet file, which does not depend on how it was cut.

    Examples
    --------
    >>> table = pa.table({"seed": [0, 1, 2]})
    >>> parquet_of([table]) == parquet_of([table[:1], table[1:]])
    True
    """
    sink, writer, rest, rows = pa.BufferOutputStream(), None, list[pa.Table](), 0
    for part in parts:
        writer = writer or pq.ParquetWriter(sink, part.schema)
        rest.append(part)
        rows += len(part)
        if rows >= ROWS:
            whole = pa.concat_tables(rest).combine_chunks()
            full = len(whole) // ROWS * ROWS
            writer.write_table(whole[:full], row_group_size=ROWS)
            rest, rows = [whole[full:]], len(whole) - full
    assert writer is not None
    writer.write_table(pa.concat_tables(rest).combine_chunks())
    writer.close()
    return bytes(sink.getvalue().to_pybytes())
