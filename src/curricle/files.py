"""Files in a folder of this machine or at a URL, which are whole or absent."""

import errno
import hashlib
import io
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from operator import attrgetter
from os import PathLike
from pathlib import Path, PurePosixPath
from secrets import token_hex
from time import sleep
from typing import IO, TYPE_CHECKING, Any, TypeVar
from urllib.parse import parse_qsl, quote, unquote, urlsplit

from curricle.errors import StoreError

if TYPE_CHECKING:
    from pyarrow.fs import FileInfo, FileSystem


SECRETS = re.compile(r"access_key|secret|token|password|credential", re.IGNORECASE)
"""Options of a URL that must not be stored, shown and sent with it."""
FINAL = re.compile("ACCESS_DENIED|NO_SUCH_|NETWORK_CONNECTION|SIGNATURE|INVALID")
"""Errors of a server that the same request meets again, or that took long already."""
PAUSES = (0.1, 0.5, 2.0)
"""Seconds until a request is made again; pyarrow repeats most itself, but no short reads."""
READ_AT_ONCE = 2**24
"""Bytes of a file up to which one request reads it."""
Result = TypeVar("Result")
PLAIN = "/=+@,:;~!$&'()*"
"""Signs that need no escape in the path of a URL, beside letters, digits and -._."""


class RemotePath:
    """A file or a folder of a file system that pyarrow opens, such as S3 or Google Cloud Storage.

    A file is written in one request: there is no move of a whole file, and no lock.
    """

    def __init__(self, system: "FileSystem", key: str, root: str, options: str = ""):
        self.system, self.key = system, PurePosixPath(key)
        self._root, self._options = root, options  # the URL before the key, and after `?`

    @classmethod
    def of(cls, url: str) -> "RemotePath":
        """Return the folder at a URL; StoreError if it has a password or pyarrow does not open it.

        Options are those of ``pyarrow.fs.FileSystem.from_uri``.
        """
        parts = urlsplit(url)
        options = parse_qsl(parts.query)
        secret = next((key for key, value in options if SECRETS.search(key) or "@" in value), None)
        if "@" in parts.netloc or secret:
            raise StoreError(
                "a URL must have no password, key or token, since it is shown and stored: give "
                f"them as {parts.scheme} does, such as by the environment; got "
                f"{secret or 'one before @'}"
            )
        from pyarrow.fs import FileSystem  # a local folder does not need it

        try:
            system, key = FileSystem.from_uri(url)
            if not key.strip("/"):
                raise ValueError("it names no bucket or folder")
        except (OSError, ValueError, NotImplementedError) as error:
            raise StoreError(f"a URL must be one that pyarrow opens, not {url}: {error}") from None
        shown = f"{parts.scheme}://{parts.netloc}{unquote(parts.path)}".rstrip("/")
        return cls(system, key, shown.removesuffix(key.rstrip("/")), parts.query)

    def __str__(self) -> str:
        return f"{self._root}{quote(str(self.key), safe=PLAIN)}"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the URL to open on another machine, with the credentials there."""
        return RemotePath.of, (f"{self}?{self._options}" if self._options else str(self),)

    def __repr__(self) -> str:
        return f"RemotePath({str(self)!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemotePath) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(str(self))

    def __lt__(self, other: "RemotePath") -> bool:
        return str(self) < str(other)

    def __truediv__(self, name: str) -> "RemotePath":
        return self._at(str(self.key / name))

    def _at(self, key: str) -> "RemotePath":
        return RemotePath(self.system, key, self._root, self._options)

    @property
    def parent(self) -> "RemotePath":
        """As :attr:`pathlib.Path.parent`."""
        return self._at(str(self.key.parent))

    @property
    def bucket(self) -> "RemotePath":
        """The first part: on a server for objects, the bucket."""
        return self._at(self.key.parts[0])

    # As of pathlib.Path.
    name = property(attrgetter("key.name"))
    stem = property(attrgetter("key.stem"))
    suffix = property(attrgetter("key.suffix"))

    @property
    def _kind(self) -> str:
        """NotFound, File or Directory."""
        return str(self._retried(lambda: self.system.get_file_info(str(self.key))).type.name)

    def exists(self) -> bool:
        """Return whether a file or a folder is there."""
        return self._kind != "NotFound"

    def is_dir(self) -> bool:
        """Return whether a folder is there."""
        return self._kind == "Directory"

    def glob(self, pattern: str) -> Iterator["RemotePath"]:
        """Yield the files that match a pattern below here, by one listing."""
        before = pattern.partition("*")[0].rpartition("/")[0]
        for info in self._listed(str(self.key / before), recursive=True):
            if info.is_file and PurePosixPath(info.path).match(pattern):
                yield self._at(info.path)

    def iterdir(self) -> Iterator["RemotePath"]:
        """Yield the files and folders in the folder."""
        for info in self._listed(str(self.key), recursive=False):
            yield self._at(info.path)

    def _listed(self, key: str, *, recursive: bool) -> "list[FileInfo]":
        from pyarrow.fs import FileSelector  # a local folder does not need it

        selector = FileSelector(key, allow_not_found=True, recursive=recursive)
        infos: list[FileInfo] = self._retried(lambda: self.system.get_file_info(selector))
        return infos

    def unlink(self, missing_ok: bool = False) -> None:
        """Delete the file."""
        if not missing_ok or self.exists():
            self._retried(lambda: self.system.delete_file(str(self.key)))

    @contextmanager
    def opened(self) -> Iterator[tuple[IO[bytes], int]]:
        """Yield the file, open to read, and its size; one request reads a small file."""

        def content_of_small() -> bytes | None:
            with self.system.open_input_file(str(self.key)) as file:
                return bytes(file.read()) if file.size() <= READ_AT_ONCE else None

        content = self._retried(content_of_small)
        if content is not None:
            yield io.BytesIO(content), len(content)
            return
        with self.system.open_input_file(str(self.key)) as file:
            yield file, file.size()

    def write(self, content: bytes) -> None:
        """Write the file, and make its folders where the file system has any."""

        def put() -> None:
            with self.system.open_output_stream(str(self.key)) as file:
                file.write(content)

        try:
            self._retried(put)
        except FileNotFoundError:
            self.system.create_dir(str(self.key.parent), recursive=True)
            put()

    def _retried(self, action: Callable[[], Result]) -> Result:
        """Return the result of an action, tried again where a server is busy for a moment."""
        for pause in PAUSES if self.system.type_name != "local" else ():
            try:
                return action()
            except FileNotFoundError:
                raise
            except OSError as error:
                if FINAL.search(str(error)):
                    raise
            sleep(pause)
        return action()


Place = Path | RemotePath


def place_at(path: Any) -> Place:
    """Return the folder at a path of this machine or at a URL; StoreError where it is neither."""
    if isinstance(path, RemotePath):
        return path
    if not isinstance(path, str | PathLike):
        raise StoreError(f"a folder must be a path or a URL: got {path!r}")
    return RemotePath.of(path) if isinstance(path, str) and "://" in path else Path(path)


LONGEST_NAME = 100
"""Characters of a file's name before its checksum; file systems allow 255 bytes in all."""
PART = ".part"
"""Ending of a file while it is written; a killed run may leave such a file, which means nothing."""


def file_name(text: str) -> str:
    """Return a file name for a text, a different one for each; a long one ends with a checksum."""
    name = quote(text, safe=" ").replace(".", "%2E")
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}+{hashlib.blake2b(text.encode(), digest_size=24).hexdigest()}"


def part_in(folder: Path) -> Path:
    """Return a new path in a folder for a file while it is written."""
    # Unlike ``tempfile``, this gives the file the permissions that the user's umask says.
    return folder / f".{token_hex(8)}{PART}"


def read_bounded(path: Place, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes; OSError as for opening it."""
    with opened_regular(path) as (file, size):
        if size > most:
            raise OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
        return file.read(most)


def local_file(path: str | Path) -> Path:
    """Return a path of a file on this machine; StoreError for anything else."""
    if not isinstance(path, str | os.PathLike):
        raise StoreError(f"a file must be a path: got {path!r}")
    if "://" in str(path):
        raise StoreError(f"a file is saved on this machine, not at a URL: got {str(path)!r}")
    if not Path(path).name:
        raise StoreError(f"a file needs a name: got {str(path)!r}")
    return Path(path)


def remove_folder(path: Place) -> None:
    """Delete a folder and its content as far as possible."""
    if isinstance(path, RemotePath):
        with suppress(OSError):
            path.system.delete_dir(str(path.key))
    else:
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def opened_regular(path: Place) -> Iterator[tuple[IO[bytes], int]]:
    """Yield a regular file, open to read, and its size; else an OSError whose strerror says why."""
    if isinstance(path, RemotePath):
        with path.opened() as file_and_size:
            yield file_and_size
        return

    def without_waiting(path: str, flags: int) -> int:  # for a pipe in the file's place
        return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))

    with open(path, "rb", opener=without_waiting) as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        yield file, about.st_size


def write_whole(path: Place, content: bytes) -> None:
    """Write a file under another name and rename it when it is complete; at a URL, at once.

    OSError where a device, a pipe or a folder is in its place: that would be lost.
    """
    if isinstance(path, RemotePath):
        path.write(content)
        return
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "what is there is no regular file", str(path))
    temporary = part_in(path.parent)
    try:
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # the name must not come before the content
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
