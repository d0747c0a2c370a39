"""The file of a unit: an npz archive of its arrays that says what it is of, sealed at its end.

It ends with two checksums: of the archive's directory, and of all before the last. So a file is
whole or none, however it was written, and ``numpy.load`` reads its arrays.
"""

import io
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from curricle.files import opened_regular
from curricle.remote_path import READ_AT_ONCE, Place
from curricle.study.record import UnitRecord, plain, read_record
from curricle.study.sealed_json import as_json, digest_of, parsed_json
from curricle.study.serialization import (
    DECISION_SCHEMA,
    GROUPS,
    SNAPSHOTS,
    UnitResult,
    as_parquet,
    checkpoints_of,
    group_of,
    read_npy,
    read_parquet,
)

ABOUT, DECISIONS = "unit.json", "decisions.parquet"
"""Members of the archive beside its arrays."""
ENDING = ".npz"
DIGEST = len(digest_of(b""))
SEAL = 2 * DIGEST
"""Bytes of a checksum, and of both."""
ENCRYPTED = 1
"""The flag of such a member."""
LARGEST_ABOUT = 2**26
"""Bytes of ``unit.json`` at most: one of 100,000 seeds has a hundredth of that."""
LONGEST_NAME, KEPT = 200, 40
"""Characters of a unit's name, and those that are kept of a longer one."""
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError)


class Damaged(Exception):
    """A file has changed since it was sealed."""


def unit_content(about: UnitRecord, result: UnitResult) -> bytes:
    """Return the content of a unit's file; equal results have equal bytes.

    Snapshots are compressed, other arrays are not.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for group in GROUPS:
            for name in (one for one in result.arrays if group_of(one) == group):
                member = zipfile.ZipInfo(f"{name}.npy")
                if group == SNAPSHOTS:
                    member.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(member, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asarray(result.arrays[name]))
        decisions = as_parquet(result.decisions.combine_chunks())
        archive.writestr(zipfile.ZipInfo(DECISIONS), decisions)
        archive.writestr(zipfile.ZipInfo(ABOUT), as_json(plain(about)))
        archive.comment = bytes(SEAL)
    return sealed_archive(buffer.getvalue()[:-SEAL], archive.start_dir)


def sealed_archive(content: bytes, directory: int) -> bytes:
    """Return an archive with its checksums; its directory begins at a byte."""
    content += digest_of(content[directory:]).encode()
    return content + digest_of(content).encode()


def _is_sealed(content: bytes) -> bool:
    return digest_of(content[:-DIGEST]).encode() == content[-DIGEST:]


def _has_its_directory(archive: zipfile.ZipFile, file: IO[bytes]) -> bool:
    file.seek(archive.start_dir)
    directory = file.read()
    return digest_of(directory[:-SEAL]).encode() == directory[-SEAL:-DIGEST]


class UnitFile:
    """A unit's file that is open.

    Parameters
    ----------
    archive : zipfile.ZipFile
    size : int
        Bytes of the file.
    """

    def __init__(self, archive: zipfile.ZipFile, size: int):
        self.archive = archive
        self.members = {one.filename: one for one in archive.infolist()}
        stored = [one for one in self.members.values() if not one.compress_type]
        if len(self.members) < len(archive.infolist()) or sum(o.file_size for o in stored) > size:
            raise ValueError("its members must differ, and have their own bytes of it")
        if any(one.flag_bits & ENCRYPTED for one in self.members.values()):
            raise ValueError("its members must not be encrypted")

    def about(self) -> UnitRecord:
        """Return what the unit is; ValueError if the archive does not say."""
        return read_record(UnitRecord, parsed_json(self._content(ABOUT, LARGEST_ABOUT)))

    def arrays(self, *groups: str, most: int | None = None) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of some groups, without pickles.

        Snapshots may unpack to `most` bytes, and nothing else is compressed; ValueError otherwise.
        """
        files = (file for file in self.members if file.endswith(".npy"))
        names = [file.removesuffix(".npy") for file in files]
        return self._read(*(name for name in names if group_of(name) in groups), most=most)

    def _read(self, *names: str, most: int | None = None) -> dict[str, npt.NDArray[Any]]:
        """Return those of some arrays that are there; for `most` see :meth:`arrays`."""
        files = {name: f"{name}.npy" for name in names}
        wanted = {name: self.members[file] for name, file in files.items() if file in self.members}
        packed = [name for name, one in wanted.items() if one.compress_type]
        if [name for name in packed if group_of(name) != SNAPSHOTS]:
            raise ValueError("its arrays must not be compressed, but for snapshots")
        if most is not None and sum(wanted[name].file_size for name in packed) > most:
            raise ValueError(f"its snapshots must have at most {most:,} bytes")
        found = dict[str, npt.NDArray[Any]]()
        for name, one in wanted.items():
            with self.archive.open(one) as file:
                found[name] = read_npy(file, one.file_size)
        return found

    def decisions(self, seeds: int) -> pa.Table:
        """Return the table of decisions, one a seed and checkpoint; ValueError if it is another."""
        most = seeds * (1 + checkpoints_of(self._read("steps")))
        member = self.members.get(DECISIONS)
        size = 0 if member is None else member.file_size
        return read_parquet(self._content(DECISIONS, size), DECISION_SCHEMA, most)

    def _content(self, name: str, most: int) -> bytes:
        member = self.members.get(name)
        if member is None or member.compress_type or member.file_size > most:
            raise ValueError(f"it must have {name}, uncompressed, of at most {most:,} bytes")
        return self.archive.read(member)


@contextmanager
def opened_unit(path: Place) -> Iterator[UnitFile]:
    """Open a unit's file to read some of it.

    Raises
    ------
    Damaged
        Also while it is read.
    ValueError
        When it is not as Curricle writes it.
    OSError
        When it cannot be read.
    """
    with opened_regular(path) as (file, size):
        source: IO[bytes] = file
        if size <= READ_AT_ONCE:  # of a larger one, the members that are read have checksums too
            content = file.read()
            if not _is_sealed(content):
                raise Damaged
            source = io.BytesIO(content)
        with _unit_in(source, size) as found:
            yield found


def checked_unit(path: Place) -> UnitRecord:
    """Return what a whole file is of; all of it is read once. It raises as :func:`opened_unit`."""
    with opened_regular(path) as (file, size):
        content = file.read()
    if not _is_sealed(content):
        raise Damaged
    with _unit_in(io.BytesIO(content), size) as found:
        return found.about()


@contextmanager
def _unit_in(source: IO[bytes], size: int) -> Iterator[UnitFile]:
    try:
        with zipfile.ZipFile(source) as archive:
            if not _has_its_directory(archive, source):
                raise Damaged
            yield UnitFile(archive, size)
    except BROKEN:
        raise Damaged from None


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
