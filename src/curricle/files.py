"""Files in a folder of this machine or at a URL, which are whole or absent, and archives of arrays.

Files of arrays and JSON carry checksums and have no pickles. An npz archive ends with two
checksums: of its directory, and of all before the last. So a reader notices a file that is not
whole, and ``numpy.load`` reads its arrays.
"""

import errno
import hashlib
import io
import json
import math
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from os import PathLike
from pathlib import Path
from secrets import token_hex
from typing import IO, TYPE_CHECKING, Any, NamedTuple, TypeAlias
from urllib.parse import quote, urlsplit
from urllib.request import url2pathname

import numpy as np
import numpy.typing as npt

from curricle.errors import StoreError, reason

if TYPE_CHECKING:
    from upath import UPath

    Place: TypeAlias = Path | UPath
else:
    Place = Path  # universal-pathlib is an extra

LISTINGS_KEPT = ("s3", "s3a", "gs", "gcs", "az", "abfs", "abfss")
"""Stores whose listings fsspec would keep, though other processes write there."""
CLIENTS = (
    "botocore",
    "aiobotocore",
    "aiohttp",
    "gcsfs",
    "google",
    "azure",
    "paramiko",
    "smbclient",
)
"""Packages of stores, whose errors are not all OSErrors."""
READ_AT_ONCE = 2**24  # bytes of a file up to which it is read whole


def place_at(path: object) -> Place:
    """Return the folder at a path of this machine or at a URL; StoreError where it is neither."""
    if hasattr(path, "storage_options"):  # of universal-pathlib
        place: Place = path
        return place
    if not isinstance(path, str | PathLike):
        raise StoreError(f"a folder must be a path or a URL: got {path!r}")
    return _at_url(path) if isinstance(path, str) and "://" in path else Path(path)


def _at_url(url: str) -> Place:
    """Return the folder at a URL, whose files universal-pathlib opens; StoreError if it cannot."""
    parts = urlsplit(url)
    if "@" in parts.netloc or parts.query:
        raise StoreError(
            "a URL must have no password, key or option, since it is shown and stored: give them "
            f"as {parts.scheme} does, such as by the environment"
        )
    if parts.scheme == "file":
        return Path(url2pathname(parts.path))
    try:
        from upath import UPath
    except ImportError:
        raise StoreError(
            'results at a URL need a package that is not installed: pip install "curricle[url]"'
        ) from None
    options = {"use_listings_cache": False} if parts.scheme in LISTINGS_KEPT else {}
    try:
        place = UPath(url, **options)
        _ = place.fs
        if not place.path.strip("/"):
            raise ValueError("it names no bucket or folder")
    except (ImportError, OSError, ValueError) as error:
        raise StoreError(f"a URL must be one that fsspec opens, not {url}: {error}") from None
    return place


def of_store(error: BaseException | None) -> bool:
    """Return whether an error is of a file system or a store, which may be no OSError."""
    client = type(error).__module__.partition(".")[0]
    return isinstance(error, OSError) or client in CLIENTS


def bucket_of(place: Place) -> Place:
    """Return the first folder above a place: at an object store the bucket."""
    return [place, *place.parents][-1]


def results_folder(study_file: str | PathLike[str]) -> str:
    """Return the name of the default folder of a study file's results, FILE-results."""
    return f"{Path(study_file).stem}-results"


LONGEST_NAME = 100  # characters before its checksum; file systems allow 255 bytes in all
PART = ".part"  # ends a file while it is written; a killed run may leave it, and it means nothing


def file_name(text: str) -> str:
    """Return a file name for a text, a different one for each; a long one ends with a checksum."""
    name = quote(text, safe=" ").replace(".", "%2E")
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}+{hashlib.blake2b(text.encode(), digest_size=24).hexdigest()}"


def read_bounded(path: Place, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes; OSError as for opening it."""
    with opened_regular(path) as (file, size):
        if size > most:
            raise OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
        return file.read(most)


def local_file(path: str | Path, ending: str = "") -> Path:
    """Return a path of a file on this machine, with an ending; StoreError for anything else."""
    if not isinstance(path, str | os.PathLike):
        raise StoreError(f"a file must be a path: got {path!r}")
    if "://" in str(path):
        raise StoreError(f"a file is saved on this machine, not at a URL: got {str(path)!r}")
    if not Path(path).name:
        raise StoreError(f"a file needs a name: got {str(path)!r}")
    file = Path(path)
    return file if not ending or file.suffix == ending else file.with_name(f"{file.name}{ending}")


@contextmanager
def opened_regular(path: Place) -> Iterator[tuple[IO[bytes], int]]:
    """Yield a regular file, open to read, and its size; else an OSError whose strerror says why."""
    if not isinstance(path, Path):
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            yield file, size
        return

    at_once = getattr(os, "O_NONBLOCK", 0)  # a pipe in the file's place is not waited for
    with open(path, "rb", opener=lambda path, flags: os.open(path, flags | at_once)) as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        yield file, about.st_size


def write_whole(path: Place, content: bytes) -> None:
    """Write a file under another name and rename it when it is complete; at a URL, as it can."""
    if not isinstance(path, Path):
        try:
            path.fs.pipe_file(path.path, content)
        except FileNotFoundError:
            if not bucket_of(path).exists():
                raise
            path.parent.mkdir(parents=True, exist_ok=True)
            path.fs.pipe_file(path.path, content)
        return
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it exists and is no regular file", str(path))
    # Unlike ``tempfile``, this gives the file the permissions that the user's umask says.
    temporary = path.parent / f".{token_hex(8)}{PART}"
    try:
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # the name must not come before the content
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


# -- JSON and archives of arrays, with checksums ---------------------------------------------------

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


def parsed_json(content: bytes) -> object:
    """Return the value of JSON; ValueError if it is no JSON, or deeply nested."""
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it must be JSON that is not nested deeply") from None
    except ValueError as error:
        raise ValueError(f"it must be JSON: {error}") from None


def as_json(value: object) -> bytes:
    """Return indented JSON, with lists of numbers on one line."""
    text = json.dumps(value, indent=1)
    # Within a string there is no line break.
    text = re.sub(r"\[\n[-+.\deE,\s]+\]", lambda match: " ".join(match[0].split()), text)
    return f"{text}\n".encode()


def short_digest(content: bytes) -> str:
    """Return a digest of 16 digits."""
    return hashlib.blake2b(content, digest_size=8).hexdigest()


def digest_of(content: bytes) -> str:
    """Return the checksum of a content."""
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).hexdigest()


DIGEST = len(digest_of(b""))
SEAL = 2 * DIGEST  # bytes of a checksum, and of both
ENCRYPTED = 1  # the flag of a member that is encrypted
QUICK = 1  # level of compression: a third of the time of the default for a tenth more bytes
KINDS = "biufU"  # types of arrays: booleans, numbers, text
HELD = 256  # bytes of memory that a byte on disk may take: a file of holes would fill the memory
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError)


class Damaged(Exception):
    """A file has changed since it was sealed."""


def archive_content(
    arrays: Mapping[str, npt.NDArray[Any]],
    members: Mapping[str, bytes],
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
        for name, content in members.items():
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
            raise ValueError("its members must have different names and bytes")
        if any(member.flag_bits & ENCRYPTED for member in self.members.values()):
            raise ValueError("its members must not be encrypted")

    @property
    def names(self) -> list[str]:
        """The names of its arrays."""
        return [file.removesuffix(".npy") for file in self.members if file.endswith(".npy")]

    def read(
        self, *names: str, compressed: Collection[str] = (), most: int | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays with these names that are there, at most `most` bytes unpacked."""
        files = {name: f"{name}.npy" for name in names}
        wanted = {name: self.members[file] for name, file in files.items() if file in self.members}
        packed = {name: member for name, member in wanted.items() if member.compress_type}
        if not set(packed) <= {*compressed}:
            raise ValueError("its arrays must not be compressed, but for snapshots")
        unpacked = sum(member.file_size for member in packed.values())
        if most is not None and unpacked > most:
            raise ValueError(f"its snapshots must have at most {most:,} bytes")
        check_held(sum(member.file_size for member in wanted.values()) - unpacked, self.held)
        return {name: read_npy(self.archive.read(member)) for name, member in wanted.items()}

    def content(self, name: str, most: int) -> bytes:
        """Return the bytes of a member; ValueError if it is missing, compressed or too large."""
        member = self.members.get(name)
        if member is None or member.compress_type or member.file_size > most:
            raise ValueError(f"it must have {name}, uncompressed, of at most {most:,} bytes")
        return self.archive.read(member)


def check_held(size: int, held: int) -> None:
    """Raise ValueError if a file states a `size` above the `held` bytes that it can hold."""
    if size > max(held, READ_AT_ONCE):
        raise ValueError(
            f"it must hold the {size:,} bytes that it states: most are not on the disk"
        )


@contextmanager
def opened_archive(path: Place, *, whole: bool = False) -> Iterator[ArrayArchive]:
    """Yield an archive, open to read some arrays or the `whole`; else Damaged or ValueError."""
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


BEFORE_HEADER = 10  # bytes of an array's file before its header, of which the last two say its size


def read_npy(content: bytes) -> npt.NDArray[Any]:
    """Return the array in the bytes of a file, without pickles; ValueError if it is malformed."""
    begin = BEFORE_HEADER + int.from_bytes(content[BEFORE_HEADER - 2 : BEFORE_HEADER], "little")
    shape, fortran, dtype = _npy_header(content[:begin])
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(content) - begin:
        raise ValueError(f"an array of shape {shape} does not fill its file")
    flat = np.frombuffer(content, dtype, offset=begin).copy()
    return flat.reshape(shape, order="F" if fortran else "C")


@lru_cache(maxsize=512)  # files of a folder have few headers, which are parsed as Python
def _npy_header(content: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, whether in Fortran's order, and type; ValueError if a header is malformed."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"its arrays must be of format 1.0: got {version}")
    try:
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    except Exception as error:  # of any kind
        raise ValueError(f"an array's header must be valid: {error}") from None
    if dtype.kind not in KINDS:
        raise ValueError("its arrays must hold numbers or text, and no Python objects or records")
    return shape, fortran, dtype


ABOUT, FORMAT = "about.json", 1
ENDING = ".npz"
LARGEST_ABOUT = 2**24  # bytes of ``about.json`` at most: in memory they are up to 25 times as many


class SavedFile(NamedTuple):
    """The content of a file that ``save`` wrote."""

    path: Path
    arrays: dict[str, npt.NDArray[Any]]
    about: dict[str, Any]


def write_saved(
    path: str | Path, kind: str, arrays: Mapping[str, npt.NDArray[Any]], about: Mapping[str, Any]
) -> Path:
    """Write a whole ``.npz`` file, make its folders, and return its path; StoreError."""
    file = local_file(path, ENDING)
    members = {ABOUT: as_json({"format": FORMAT, "kind": kind, **about})}
    write_in_folder(file, archive_content(arrays, members), f"a {kind}")
    return file


def write_in_folder(file: Path, content: bytes, noun: str) -> None:
    """Write a whole file and make its folders; StoreError says that the `noun` was not written."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, content)
    except OSError as error:
        raise StoreError(f"{noun} cannot be written to {file}: {reason(error)}") from None


def read_saved(path: str | Path, kind: str) -> SavedFile:
    """Return the arrays and the JSON of a file; StoreError unless `save` wrote it."""
    file = local_file(path, ENDING)
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
        held = about.get("kind") if isinstance(about, dict) else about
        raise StoreError(f"a {kind} must be loaded from a {kind}'s file: {file} holds a {held}")
    if about.get("format") != FORMAT:
        raise StoreError(
            f"{file} must have format {FORMAT}, which this version of Curricle reads: it has "
            f"{about.get('format')}"
        )
    return SavedFile(file, arrays, about)
