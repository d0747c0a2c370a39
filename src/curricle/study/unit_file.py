"""The file of a unit: a sealed archive of its arrays that says what it is of."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt
import pyarrow as pa

from curricle.archives import (
    ArrayArchive,
    archive_content,
    as_json,
    digest_of,
    opened_archive,
    opened_whole,
    parsed_json,
)
from curricle.files import Place
from curricle.learning.saved_result import checkpoints_of
from curricle.study.record import UnitRecord, plain, read_record
from curricle.study.serialization import (
    DECISION_SCHEMA,
    GROUPS,
    SNAPSHOTS,
    UnitResult,
    as_parquet,
    group_of,
    read_parquet,
)

ABOUT, DECISIONS = "unit.json", "decisions.parquet"
"""Members of the archive beside its arrays."""
ENDING = ".npz"
LARGEST_ABOUT = 2**26
"""Bytes of ``unit.json`` at most: one of 100,000 seeds has a hundredth of that."""
LONGEST_NAME, KEPT = 200, 40
"""Characters of a unit's name, and those that are kept of a longer one."""


def unit_content(about: UnitRecord, result: UnitResult) -> bytes:
    """Return the content of a unit's file; equal results have equal bytes.

    Snapshots are compressed, other arrays are not.
    """
    each = result.arrays.items()
    ordered = {name: one for group in GROUPS for name, one in each if group_of(name) == group}
    others = {
        DECISIONS: as_parquet(result.decisions.combine_chunks()),
        ABOUT: as_json(plain(about)),
    }
    return archive_content(ordered, others, _snapshots_of(ordered))


def _snapshots_of(names: Iterable[str]) -> list[str]:
    return [name for name in names if group_of(name) == SNAPSHOTS]


@dataclass(frozen=True)
class UnitFile:
    """A unit's file that is open."""

    archive: ArrayArchive

    def about(self) -> UnitRecord:
        """Return what the unit is; ValueError if the archive does not say."""
        return read_record(UnitRecord, parsed_json(self.archive.content(ABOUT, LARGEST_ABOUT)))

    def arrays(self, *groups: str, most: int | None = None) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of some groups, without pickles.

        Snapshots may unpack to `most` bytes, and nothing else is compressed; ValueError otherwise.
        """
        names = [name for name in self.archive.names if group_of(name) in groups]
        return self.archive.read(*names, compressed=_snapshots_of(names), most=most)

    def decisions(self, seeds: int) -> pa.Table:
        """Return the table of decisions, one a seed and checkpoint; ValueError if it is another."""
        most = seeds * (1 + checkpoints_of(self.archive.read("steps")))
        member = self.archive.members.get(DECISIONS)
        size = 0 if member is None else member.file_size
        return read_parquet(self.archive.content(DECISIONS, size), DECISION_SCHEMA, most)


@contextmanager
def opened_unit(path: Place) -> Iterator[UnitFile]:
    """Open a unit's file to read some of it; it raises as :func:`opened_archive`."""
    with opened_archive(path) as archive:
        yield UnitFile(archive)


def checked_unit(path: Place) -> UnitRecord:
    """Return what a whole file is of; all of it is read once. It raises as :func:`opened_unit`."""
    with opened_whole(path) as archive:
        return UnitFile(archive).about()


def place_of(key: str, task: str, seeds: str) -> str:
    """Return a unit's place among the units, from the words for its seeds.

    Examples
    --------
    >>> place_of("0f", "my maze", "0-4")
    'my_maze-0f/seeds-0-4.npz'
    """
    name, words = f"seeds-{seeds}", re.sub(r"[^\w-]+", "_", task)[:KEPT]
    if len(name) >= LONGEST_NAME:
        name = f"{name[:KEPT]}_{digest_of(name.encode())}"
    return f"{words}-{key}/{name}{ENDING}"
