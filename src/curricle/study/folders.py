"""Folders of results: what they are called, which ones may be written to, and errors of writing."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from curricle.errors import LostStoreError, StoreError, reason
from curricle.files import PART, Place

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
UNITS = "units"
PATIENCE = 0.3
"""Seconds in which a lock is asked for: whoever looks whether it is held has it for a moment."""
CHECKPOINTS = ".checkpoints"
"""Where networks in training are saved, to go on from."""


def check_ours(path: Place, resume: bool) -> None:
    """Raise StoreError if a path is a file, or a folder that holds other things than results."""
    if path.exists() and not path.is_dir():
        raise StoreError(f"results need a folder: {path} is a file")
    ours = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
    if not ours and any(one.suffix != PART and one.name != LOCK for one in path.iterdir()):
        raise StoreError(
            f"results need an empty folder or one of earlier results: {path} holds other files"
        )


@contextmanager
def locked(path: Place) -> Iterator[None]:
    """Lock a folder, made if need be, against other processes; StoreError when one holds it.

    The lock ends with the process, also when it is killed. There is none at a URL: two runs that
    write there store the same units, so that the last of each stays.
    """
    if not isinstance(path, Path):
        yield
        return
    with write_errors(path):
        path.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path / LOCK)
        try:
            lock.acquire(timeout=PATIENCE)
        except Timeout:
            raise StoreError(
                f"only one run at a time can write to a folder: another is at work on {path}"
            ) from None
    try:
        yield
    finally:
        lock.release()


def in_use(path: Place) -> bool | None:
    """Return whether a run holds a folder's lock; None where that cannot be told, as at a URL."""
    if not isinstance(path, Path):
        return None
    if not (path / LOCK).exists():
        return False
    try:
        with FileLock(path / LOCK).acquire(timeout=0):
            return False
    except Timeout:
        return True
    except OSError:  # a folder that may only be read
        return None


@contextmanager
def read_errors(path: Place) -> Iterator[None]:
    """Turn a failure to read into a StoreError."""
    try:
        yield
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {reason(error)}") from error


def holds_study(path: Place) -> bool:
    """Return whether a folder, which may not be there, holds a study; StoreError if unreadable."""
    with read_errors(path):
        return (path / STUDY).exists()


@contextmanager
def write_errors(path: Place) -> Iterator[None]:
    """Turn a failure to write into a StoreError that says what is safe."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"results cannot be written to {path} ({reason(error)}): what was stored before is "
            "whole, and a run with --resume goes on from there"
        ) from error


@contextmanager
def lost_errors() -> Iterator[None]:
    """Turn a failure to read or write, once that has gone well, into a LostStoreError."""
    try:
        yield
    except StoreError as error:
        if isinstance(error.__cause__, OSError):
            raise LostStoreError(str(error)) from error.__cause__
        raise
