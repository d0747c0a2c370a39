"""Files that are either whole or absent."""

import errno
import hashlib
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import IO
from urllib.parse import quote

from curricle.errors import StoreError
from curricle.remote_path import Place, RemotePath

LONGEST_NAME = 100
"""Characters of a file's name before its checksum; file systems allow 255 bytes in all."""
PART = ".part"
"""Ending of a file being written; a killed run may leave one, which means nothing."""


def file_name(text: str) -> str:
    """Return a file name that no other text has, whatever characters there are in it.

    A long text is cut, and told apart from others by its checksum.

    Examples
    --------
    >>> file_name("hunt 2"), file_name("../a")
    ('hunt 2', '%2E%2E%2Fa')
    >>> len(file_name("x" * 1000))
    149
    """
    name = quote(text, safe=" ").replace(".", "%2E")
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}+{hashlib.blake2b(text.encode(), digest_size=24).hexdigest()}"


def part_in(folder: Path) -> Path:
    """Return a new path in a folder for something that is being written.

    What is made there has the user's own permissions (umask), unlike what ``tempfile`` makes.
    """
    return folder / f".{token_hex(8)}{PART}"


def read_bounded(path: Place, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes.

    A pipe or a device in its place is not waited for.

    Raises
    ------
    OSError
        Whose ``strerror`` says what is wrong: it is no regular file, too large, or cannot be read.
    """
    with opened_regular(path) as (file, size):
        if size > most:
            raise OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
        return file.read(most)


def local_file(path: str | Path) -> Path:
    """Return the path of a file on this machine; StoreError where it is none.

    Examples
    --------
    >>> local_file("s3://maze.npz")
    Traceback (most recent call last):
    curricle.errors.StoreError: a file is saved on this machine, not at a URL: got 's3://maze.npz'
    """
    if not isinstance(path, str | os.PathLike):
        raise StoreError(f"a file must be a path: got {path!r}")
    if "://" in str(path):
        raise StoreError(f"a file is saved on this machine, not at a URL: got {str(path)!r}")
    if not Path(path).name:
        raise StoreError(f"a file needs a name: got {str(path)!r}")
    return Path(path)


def remove_folder(path: Place) -> None:
    """Delete a folder and all that is in it, as far as that can be done."""
    if isinstance(path, RemotePath):
        path.remove_folder()
    else:
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def opened_regular(path: Place) -> Iterator[tuple[IO[bytes], int]]:
    """Open a regular file to read it, and tell its bytes; OSError as :func:`read_bounded`."""
    if isinstance(path, RemotePath):
        with path.opened() as found:
            yield found
        return
    with open(path, "rb", opener=_at_once) as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        yield file, about.st_size


def _at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def write_whole(path: Place, content: bytes) -> None:
    """Write a file beside its place and move it there when it is complete; at a URL, at once.

    Raises
    ------
    OSError
        When it cannot be written, or a device, a pipe or a folder is in its place: that would be
        lost.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> place = Path(mkdtemp()) / "a.txt"
    >>> write_whole(place, b"whole")
    >>> place.read_bytes()
    b'whole'
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
