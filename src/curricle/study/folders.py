"""Folders of results: what they are called, which ones may be written to, and errors of writing."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from curricle.errors import StoreError
from curricle.files import PART

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
UNITS = "units"
CHECKPOINTS = ".checkpoints"
"""Where networks in training are saved, to go on from."""


def check_ours(path: Path, resume: bool) -> None:
    """Raise StoreError if a path is a file, or a folder that holds other things than results."""
    if path.exists() and not path.is_dir():
        raise StoreError(f"results need a folder: {path} is a file")
    ours = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
    if not ours and any(one.suffix != PART and one.name != LOCK for one in path.iterdir()):
        raise StoreError(
            f"results need an empty folder or one of earlier results: {path} holds other files"
        )


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn a failure to write into a StoreError that says what is safe."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"results cannot be written to {path} ({error.strerror}): what was stored before is "
            "whole, and a run with --resume goes on from there"
        ) from error
