"""An npz archive of arrays and a few other members, sealed at its end.

It ends with two checksums: of the archive's directory, and of all before the last. So a file is
whole or none, however it was written, and ``numpy.load`` reads its arrays.
"""

import io
import math
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from curricle.archives.sealed_json import digest_of
from curricle.files import opened_regular
from curricle.remote_path import READ_AT_ONCE, Place

DIGEST = len(digest_of(b""))
SEAL = 2 * DIGEST
"""Bytes of a checksum, and of both."""
ENCRYPTED = 1
"""The flag of such a member."""
QUICK = 1
"""Level of compression: a third of the time of the default for a tenth more bytes."""
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError)


class Damaged(Exception):
    """A file has changed since it was sealed."""


def archive_content(
    arrays: Mapping[str, npt.NDArray[Any]],
    others: Mapping[str, bytes],
    compressed: Collection[str] = (),
) -> bytes:
    """Return the content of an archive; equal members in one order have equal bytes.

    Parameters
    ----------
    arrays : dict of str to array
        Each becomes the member ``name.npy``.
    others : dict of str to bytes
        Further members, after the arrays.
    compressed : collection of str
        The arrays that are compressed.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            if name in compressed:
                unpacked = io.BytesIO()
                np.lib.format.write_array(unpacked, np.asarray(array), allow_pickle=False)
                archive.writestr(member, unpacked.getbuffer(), zipfile.ZIP_DEFLATED, QUICK)
                continue
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
        for name, content in others.items():
            archive.writestr(zipfile.ZipInfo(name), content)
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


class ArrayArchive:
    """An archive that is open.

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

    @property
    def names(self) -> list[str]:
        """The names of its arrays."""
        files = (file for file in self.members if file.endswith(".npy"))
        return [file.removesuffix(".npy") for file in files]

    def read(
        self, *names: str, compressed: Collection[str] = (), most: int | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return those of some arrays that are there, without pickles.

        The `compressed` ones may be so, and unpack to `most` bytes; ValueError otherwise.
        """
        files = {name: f"{name}.npy" for name in names}
        wanted = {name: self.members[file] for name, file in files.items() if file in self.members}
        packed = [name for name, one in wanted.items() if one.compress_type]
        if not set(packed) <= {*compressed}:
            raise ValueError("its arrays must not be compressed, but for snapshots")
        if most is not None and sum(wanted[name].file_size for name in packed) > most:
            raise ValueError(f"its snapshots must have at most {most:,} bytes")
        found = dict[str, npt.NDArray[Any]]()
        for name, one in wanted.items():
            with self.archive.open(one) as file:
                found[name] = read_npy(file, one.file_size)
        return found

    def content(self, name: str, most: int) -> bytes:
        """Return a member as it is; ValueError if it is missing, compressed or too large."""
        member = self.members.get(name)
        if member is None or member.compress_type or member.file_size > most:
            raise ValueError(f"it must have {name}, uncompressed, of at most {most:,} bytes")
        return self.archive.read(member)


@contextmanager
def opened_archive(path: Place) -> Iterator[ArrayArchive]:
    """Open an archive to read some of it.

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
        with _archive_in(source, size) as found:
            yield found


@contextmanager
def opened_whole(path: Place) -> Iterator[ArrayArchive]:
    """Open an archive, all of which is read once; it raises as :func:`opened_archive`."""
    with opened_regular(path) as (file, size):
        content = file.read()
    if not _is_sealed(content):
        raise Damaged
    with _archive_in(io.BytesIO(content), size) as found:
        yield found


@contextmanager
def _archive_in(source: IO[bytes], size: int) -> Iterator[ArrayArchive]:
    try:
        with zipfile.ZipFile(source) as archive:
            if not _has_its_directory(archive, source):
                raise Damaged
            yield ArrayArchive(archive, size)
    except BROKEN:
        raise Damaged from None


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
