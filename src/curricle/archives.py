"""Files of arrays and JSON with their own checksums, without pickles.

An npz archive ends with two checksums: of its directory, and of all before the last. So a file is
whole or none, however it was written, and ``numpy.load`` reads its arrays.
"""

import hashlib
import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.errors import StoreError, reason
from curricle.files import READ_AT_ONCE, Place, local_file, opened_regular, write_whole

DIGEST_BYTES = 16


def sealed(value: Mapping[str, Any]) -> bytes:
    """Return JSON with its own checksum."""
    return as_json({**value, "digest": digest_of(as_json(value))})


def unsealed(content: bytes) -> dict[str, Any] | None:
    """Return the value that ``sealed`` wrote; None if the content has changed since."""
    try:
        value = json.loads(content)
        digest = value.pop("digest")
        whole = digest == digest_of(as_json(value))
    except (ValueError, AttributeError, TypeError, KeyError, IndexError, RecursionError):
        return None
    return dict(value) if whole else None


def parsed_json(content: bytes) -> Any:
    """Return the value of JSON; ValueError if it is no JSON, or deeply nested."""
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it must be JSON that is not nested deeply") from None
    except ValueError as error:
        raise ValueError(f"it must be JSON: {error}") from None


def as_json(value: Any) -> bytes:
    """Return indented JSON, with lists of numbers on one line."""
    text = json.dumps(value, indent=1)
    # Within a string there is no line break.
    text = re.sub(r"\[\n[-+.\deE,\s]+\]", lambda match: " ".join(match[0].split()), text)
    return f"{text}\n".encode()


def digest_of(content: bytes) -> str:
    """Return the checksum of a content."""
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).hexdigest()


DIGEST = len(digest_of(b""))
SEAL = 2 * DIGEST
"""Bytes of a checksum, and of both."""
ENCRYPTED = 1
"""The flag of a member that is encrypted."""
QUICK = 1
"""Level of compression: a third of the time of the default for a tenth more bytes."""
KINDS = "biufU"
"""Types of arrays: booleans, numbers, text."""
HELD = 256
"""Bytes of memory that a byte on disk may take: a file of holes would fill the memory."""
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError)


class Damaged(Exception):
    """A file has changed since it was sealed."""


def archive_content(
    arrays: Mapping[str, npt.NDArray[Any]],
    others: Mapping[str, bytes],
    compressed: Collection[str] = (),
) -> bytes:
    """Return an archive of arrays, then other members; equal arguments give equal bytes."""
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
    """Return an archive with its checksums; `directory` is the first byte of its directory."""
    content += digest_of(content[directory:]).encode()
    return content + digest_of(content).encode()


class ArrayArchive:
    """An open archive of `size` bytes, of which at most `held` may be read into memory."""

    def __init__(self, archive: zipfile.ZipFile, size: int, held: int):
        self.archive, self.held = archive, held
        self.members = {member.filename: member for member in archive.infolist()}
        stored = sum(m.file_size for m in self.members.values() if not m.compress_type)
        if len(self.members) < len(archive.infolist()) or stored > size:
            raise ValueError("its members must differ, and have their own bytes of it")
        if any(member.flag_bits & ENCRYPTED for member in self.members.values()):
            raise ValueError("its members must not be encrypted")

    @property
    def names(self) -> list[str]:
        """The names of its arrays."""
        files = (file for file in self.members if file.endswith(".npy"))
        return [file.removesuffix(".npy") for file in files]

    def read(
        self, *names: str, compressed: Collection[str] = (), most: int | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays with these names, where there are any, without pickles.

        Those in `compressed` may be compressed, and unpack to at most `most` bytes in all;
        ValueError otherwise.
        """
        files = {name: f"{name}.npy" for name in names}
        wanted = {name: self.members[file] for name, file in files.items() if file in self.members}
        packed = {name: member for name, member in wanted.items() if member.compress_type}
        if not set(packed) <= {*compressed}:
            raise ValueError("its arrays must not be compressed, but for snapshots")
        unpacked = sum(member.file_size for member in packed.values())
        if most is not None and unpacked > most:
            raise ValueError(f"its snapshots must have at most {most:,} bytes")
        check_held(sum(member.file_size for member in wanted.values()) - unpacked, self.held)
        arrays = dict[str, npt.NDArray[Any]]()
        for name, member in wanted.items():
            with self.archive.open(member) as file:
                arrays[name] = read_npy(file, member.file_size)
        return arrays

    def content(self, name: str, most: int) -> bytes:
        """Return the bytes of a member; ValueError if it is missing, compressed or too large."""
        member = self.members.get(name)
        if member is None or member.compress_type or member.file_size > most:
            raise ValueError(f"it must have {name}, uncompressed, of at most {most:,} bytes")
        return self.archive.read(member)


def check_held(size: int, held: int) -> None:
    """Raise ValueError if `size` bytes are more than a file can hold that is no file of holes."""
    if size > max(held, READ_AT_ONCE):
        raise ValueError(
            f"it says that it has {size:,} bytes, and most of them are not on the disk"
        )


@contextmanager
def opened_archive(path: Place, *, whole: bool = False) -> Iterator[ArrayArchive]:
    """Yield an archive, open to read some arrays or the `whole`, which is then in memory at once.

    Damaged, also while it is read; ValueError where Curricle did not write it; OSError.
    """
    with opened_regular(path) as (file, size):
        source: IO[bytes] = file
        blocks = getattr(path.stat(), "st_blocks", size) if isinstance(path, Path) else size
        check_held(size if whole else 0, held := HELD * 512 * blocks)
        if whole or size <= READ_AT_ONCE:  # the members of a larger one have checksums too
            content = file.read()
            if digest_of(content[:-DIGEST]).encode() != content[-DIGEST:]:
                raise Damaged
            source = io.BytesIO(content)
        try:
            with zipfile.ZipFile(source) as archive:
                source.seek(archive.start_dir)
                directory = source.read()
                if digest_of(directory[:-SEAL]).encode() != directory[-SEAL:-DIGEST]:
                    raise Damaged
                yield ArrayArchive(archive, size, held)
        except BROKEN:
            raise Damaged from None


def read_npy(file: IO[bytes], size: int) -> npt.NDArray[Any]:
    """Return the array of a file of `size` bytes without pickles; ValueError if it is malformed."""
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"its arrays must be of format 1.0: got {version}")
    try:
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    except Exception as error:  # of any kind: the header is parsed as Python
        raise ValueError(f"an array's header makes no sense: {error}") from None
    if dtype.kind not in KINDS:
        raise ValueError("its arrays must hold numbers or text, and no Python objects or records")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != size - file.tell():
        raise ValueError(f"an array of shape {shape} does not fill its file")
    flat = np.frombuffer(bytearray(file.read()), dtype)
    return flat.reshape(shape, order="F" if fortran else "C")


ABOUT, FORMAT = "about.json", 1
ENDING = ".npz"
LARGEST_ABOUT = 2**24
"""Bytes of ``about.json`` at most: in memory they are up to 25 times as many."""


class SavedFile(NamedTuple):
    """The content of a file that ``save`` wrote."""

    path: Path
    arrays: dict[str, npt.NDArray[Any]]
    about: dict[str, Any]


def write_saved(
    path: str | Path, kind: str, arrays: Mapping[str, npt.NDArray[Any]], about: Mapping[str, Any]
) -> Path:
    """Write a whole ``.npz`` file, make its folders, and return its path; StoreError.

    `kind` is the class whose ``load`` reads it.
    """
    file = saved_path(path)
    others = {ABOUT: as_json({"format": FORMAT, "kind": kind, **about})}
    content = archive_content(arrays, others)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, content)
    except OSError as error:
        raise StoreError(f"a {kind} cannot be written to {file}: {reason(error)}") from None
    return file


def read_saved(path: str | Path, kind: str) -> SavedFile:
    """Return the arrays and the JSON of a file; StoreError unless `save` wrote it."""
    file = saved_path(path)
    try:
        with opened_archive(file, whole=True) as archive:
            arrays = archive.read(*archive.names)
            about = parsed_json(archive.content(ABOUT, LARGEST_ABOUT))
    except Damaged:
        raise StoreError(
            f"a saved {kind} must be as its save() wrote it: {file} was changed since, cut off, or "
            "written by something else"
        ) from None
    except ValueError as error:
        raise StoreError(f"{file} is not as {kind}.save() writes it: {error}") from None
    except OSError as error:
        raise StoreError(f"a saved {kind} cannot be read from {file}: {reason(error)}") from None
    if not isinstance(about, dict) or about.get("kind") != kind:
        there = about.get("kind") if isinstance(about, dict) else about
        raise StoreError(f"a {kind} is loaded from a file that holds one: {file} holds a {there}")
    if about.get("format") != FORMAT:
        raise StoreError(
            f"{file} must have format {FORMAT}, which this version of Curricle reads: it has "
            f"{about.get('format')}"
        )
    return SavedFile(file, arrays, about)


def saved_path(path: str | Path) -> Path:
    """Return the path of a saved file with its ending."""
    file = local_file(path)
    return file if file.suffix == ENDING else file.with_name(f"{file.name}{ENDING}")
