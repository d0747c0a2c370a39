"""What ``save`` writes and ``load`` reads: one archive of arrays that says what it holds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy.typing as npt

from curricle.archives.array_archive import Damaged, archive_content, opened_whole
from curricle.archives.sealed_json import as_json, parsed_json
from curricle.errors import StoreError, reason
from curricle.files import local_file, write_whole

ABOUT, FORMAT = "about.json", 1
ENDING = ".npz"
LARGEST_ABOUT = 2**26
"""Bytes of ``about.json`` at most."""


class SavedFile(NamedTuple):
    """What a file holds."""

    path: Path
    arrays: dict[str, npt.NDArray[Any]]
    about: dict[str, Any]


def write_saved(
    path: str | Path, kind: str, arrays: Mapping[str, npt.NDArray[Any]], about: Mapping[str, Any]
) -> Path:
    """Write a file in one move, folders made if need be, and return its path, an ``.npz``.

    Parameters
    ----------
    path : path
        The ending is added where it is missing.
    kind : str
        The class whose ``load`` reads it.
    arrays : dict of str to array
    about : dict
        What JSON can hold.

    Raises
    ------
    StoreError
        When it cannot be written, as at a URL; what was there before stays.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> import numpy as np
    >>> file = write_saved(f"{mkdtemp()}/two", "Numbers", {"n": np.arange(2)}, {"unit": "steps"})
    >>> file.name, read_saved(file, "Numbers").arrays, read_saved(file, "Numbers").about["unit"]
    ('two.npz', {'n': array([0, 1])}, 'steps')
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
    """Return what a file holds; it may only hold arrays and JSON, and nothing in it is run.

    Raises
    ------
    StoreError
        When it cannot be read, is damaged, of another kind or no file that `save` wrote.
    """
    file = saved_path(path)
    try:
        with opened_whole(file) as archive:
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
    """Return the path of a file that is saved, with its ending."""
    file = local_file(path)
    return file if file.suffix == ENDING else file.with_name(f"{file.name}{ENDING}")
