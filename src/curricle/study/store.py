"""A folder of results: one set of settings, files that are either whole or absent."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from curricle.errors import StoreError
from curricle.files import PART, write_whole

SETTINGS = "settings.json"

Columns = Mapping[str, npt.ArrayLike]
"""A tidy table: column name -> values, all of one length."""


class ResultsFolder:
    """A folder that holds the results of one set of settings and refuses those of others.

    Every file is written beside its place and moved there when complete, so that a run killed at
    any moment leaves whole files only, and the next run goes on from them.

    Parameters
    ----------
    path : str or Path
        Made if it does not exist.
    settings : dict
        What the results depend on; kept in ``settings.json``.

    Raises
    ------
    StoreError
        When the folder holds results of other settings, or files that are none of ours.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = ResultsFolder(place, {"seeds": 30})
    ...     folder.write_json("claims.json", [])
    ...     try:
    ...         ResultsFolder(place, {"seeds": 5})
    ...     except StoreError as error:
    ...         print(str(error).replace(place, "DIR"))
    DIR holds results of other settings: seeds is 30 there and 5 here; choose another folder
    """

    def __init__(self, path: str | Path, settings: Mapping[str, Any]):
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise StoreError(f"results need a folder: {self.path} is a file")
        if (self.path / SETTINGS).exists():
            self._check(settings)
        elif self.path.exists() and any(p.suffix != PART for p in self.path.iterdir()):
            raise StoreError(
                f"results need an empty folder or one of earlier results: {self.path} holds "
                "other files"
            )
        else:
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                self.write_json(SETTINGS, dict(settings))
            except OSError as error:
                raise StoreError(
                    f"results need a folder that can be written: {self.path} ({error.strerror})"
                ) from error

    def _check(self, settings: Mapping[str, Any]) -> None:
        there = self.read_json(SETTINGS)
        here = json.loads(json.dumps(dict(settings)))
        for name in sorted({*there, *here}):
            if there.get(name) != here.get(name):
                raise StoreError(
                    f"{self.path} holds results of other settings: {name} is {there.get(name)} "
                    f"there and {here.get(name)} here; choose another folder"
                )

    def has(self, name: str) -> bool:
        """Return whether a file is there (and so complete)."""
        return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> Path:
        """Write a file in one move and return its path."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
        return path

    def write_json(self, name: str, content: Any) -> None:
        """Write a value as indented JSON."""
        self.write(name, as_json(content))

    def read_json(self, name: str) -> Any:
        """Return the value of a JSON file, or raise StoreError if it is damaged."""
        return read_json(self.path / name)

    def write_table(self, name: str, columns: Columns) -> None:
        """Write a tidy table as Parquet."""
        self.write(name, as_parquet(pa.table(dict(columns))))


def as_json(content: Any) -> bytes:
    """Return a value as indented JSON."""
    return (json.dumps(content, indent=1) + "\n").encode()


def read_json(path: Path) -> Any:
    """Return the value of a JSON file, or raise StoreError if it is damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise StoreError(f"{path} must be JSON: {error}") from error


def as_parquet(table: pa.Table) -> bytes:
    """Return a table as the content of a Parquet file."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return bytes(sink.getvalue().to_pybytes())
