"""The results store: a folder with a description of what its results depend on, and whole files."""

import hashlib
import io
import json
import os
import re
import shutil
import zipfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from curricle.errors import StoreError
from curricle.files import PART, part_in, write_whole
from curricle.study.serialization import (
    CURVES,
    DECISIONS,
    RUN,
    SNAPSHOTS,
    VALUES,
    UnitResult,
    as_parquet,
    files_of,
    of_seeds,
    values_of,
)
from curricle.study.source_values import StoredValues
from curricle.study.units import Unit, seed_ranges

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
SCHEMA_VERSION = 1
"""Of the folder's layout; a folder of another version is refused."""
CHECKPOINTS = ".checkpoints"
"""Where networks in training are saved, to go on from."""
UNITS, MANIFEST = "units", "unit.json"
MAY_CHANGE = ("name", "seeds", "seeds_per_unit", "threshold", "window", "snapshots")
"""Keys of a study on which no stored result depends."""


class StoredUnit(NamedTuple):
    """A unit in the store: its folder, its key and its seeds."""

    path: Path
    key: str
    task: str
    seeds: tuple[int, ...]


class StudyStore:
    """A folder of results that all depend on one description; results of others are refused.

    Every file is written beside its place and moved there when it is complete and on disk, so that
    a run killed at any moment leaves whole files and whole units only.

    Parameters
    ----------
    path : path

    Raises
    ------
    StoreError
        When the folder holds no results, or results of another version.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with StudyStore.opened(folder, {"seeds": 30}, resume=True) as store:
    ...         store.write_json("claims.json", [])
    ...     try:
    ...         with StudyStore.opened(folder, {"seeds": 5}, resume=True):
    ...             pass
    ...     except StoreError as error:
    ...         print(str(error).replace(folder, "DIR"))
    DIR holds results of other settings: seeds is 30 there and 5 here; choose another folder
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not (self.path / STUDY).is_file():
            raise StoreError(f"a folder of results holds a {STUDY}: {self.path} has none")
        self.description = self._unsealed(self.path / STUDY)
        version = self.description.pop("schema_version", None)
        if version != SCHEMA_VERSION:
            found = "no schema version" if version is None else f"schema version {version}"
            raise StoreError(
                f"{self.path / STUDY} has {found} and this Curricle reads {SCHEMA_VERSION}: run "
                "the study again into a new folder, or read it with the version that wrote it"
            )

    @classmethod
    @contextmanager
    def opened(
        cls, path: str | Path, description: Mapping[str, Any], *, resume: bool
    ) -> Iterator["StudyStore"]:
        """Open a folder for results, made if need be, and lock it against other processes.

        The lock is released when the process ends, also when it is killed.

        Parameters
        ----------
        path : path
        description : dict
            What the results depend on.
        resume : bool
            Whether the folder may hold units of this description already.

        Raises
        ------
        StoreError
            When the folder is in use, or holds results of another description or other files.
        """
        path = Path(path)
        if path.exists() and not path.is_dir():
            raise StoreError(f"results need a folder: {path} is a file")
        ours = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
        if not ours and any(one.suffix != PART and one.name != LOCK for one in path.iterdir()):
            raise StoreError(
                f"results need an empty folder or one of earlier results: {path} holds other files"
            )
        lock = FileLock(path / LOCK)
        with _write_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise StoreError(
                    f"only one run at a time can write to a folder: another is at work on {path}"
                ) from None
        try:
            yield cls._claimed(path, json.loads(json.dumps(description)), resume)
        finally:
            lock.release()

    @classmethod
    def _claimed(cls, path: Path, description: dict[str, Any], resume: bool) -> "StudyStore":
        if (path / STUDY).exists():
            store = cls(path)
            store.check(description)
            if not resume and (units := store.units()):
                raise StoreError(
                    f"{path} already holds this study, {len(units)} units of it: go on "
                    "with --resume, or choose another folder"
                )
            if "configuration" in description:
                there, here = (one["configuration"] for one in (store.description, description))
                here["seeds"] = sorted({*there["seeds"], *here["seeds"]})
        for part in (*path.glob(f".*{PART}"), *path.glob(f"{UNITS}/*/.*{PART}")):
            # A killed run left it; it is not complete.
            shutil.rmtree(part) if part.is_dir() else part.unlink()
        with _write_errors(path):
            write_whole(path / STUDY, sealed({"schema_version": SCHEMA_VERSION, **description}))
        return cls(path)

    def check(self, description: Mapping[str, Any]) -> None:
        """Raise StoreError if results of a description, as :meth:`opened` takes it, differ."""
        for name, (there, here) in _differences(self.description, description):
            raise StoreError(
                f"{self.path} holds results of other settings: {name} is {_shown(there)} there and "
                f"{_shown(here)} here; choose another folder"
            )

    # -- files ---------------------------------------------------------------------------------

    def has(self, name: str) -> bool:
        """Return whether a file is there (and so complete)."""
        return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> None:
        """Write a file in one move; if that fails (StoreError), what was there stays."""
        path = self.path / name
        with _write_errors(self.path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)

    def write_json(self, name: str, content: Any) -> None:
        """Write a value as indented JSON."""
        self.write(name, _json(content))

    def read_json(self, name: str) -> Any:
        """Return the value of a JSON file; StoreError if it is damaged."""
        path = self.path / name
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise StoreError(f"{path} must be JSON: {error}") from error

    def write_table(self, name: str, columns: Mapping[str, npt.ArrayLike] | pa.Table) -> None:
        """Write a tidy table, a dict of column name to values of one length, as Parquet."""
        table = columns if isinstance(columns, pa.Table) else pa.table(dict(columns))
        self.write(name, as_parquet(table))

    def add_run(self, provenance: Mapping[str, Any]) -> None:
        """Add a run to the list of runs."""
        self.write_json(RUNS, [*self.runs(), provenance])

    def runs(self) -> list[dict[str, Any]]:
        """Return the versions, kind of machine, commit, file and seeds of each run so far."""
        found: list[dict[str, Any]] = self.read_json(RUNS) if self.has(RUNS) else []
        return found

    # -- units ---------------------------------------------------------------------------------

    def units(self) -> list[StoredUnit]:
        """Return the units in the store, by path; StoreError names one that is damaged."""
        manifests = self.path.glob(f"{UNITS}/*/*/{MANIFEST}")
        found = [path for path in manifests if not path.parent.name.endswith(PART)]
        return [self._stored(path) for path in sorted(found)]

    def finished(self) -> dict[str, dict[int, StoredUnit]]:
        """Return the unit that holds each seed: key -> seed -> unit."""
        found: dict[str, dict[int, StoredUnit]] = {}
        for stored in self.units():
            found.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
        return found

    def _stored(self, manifest: Path) -> StoredUnit:
        found = self._unsealed(manifest)
        for name, (size, _) in found["files"].items():
            file = manifest.parent / name
            if not file.is_file() or file.stat().st_size != size:
                raise self._damage(file)
        return StoredUnit(manifest.parent, found["key"], found["task"], tuple(found["seeds"]))

    def _damage(self, file: Path) -> StoreError:
        if file.name == STUDY:
            return StoreError(
                f"{file} is damaged, or not one that curricle wrote: where {UNITS} are beside it, "
                "delete it and run the study again with --resume"
            )
        return StoreError(
            f"{file} is damaged: its checksum does not fit; delete the folder {file.parent} and "
            "run the study again with --resume, which does only what is missing"
        )

    def write_unit(self, unit: Unit | StoredUnit, result: UnitResult) -> StoredUnit:
        """Store the result of a unit in one move, and return where it is."""
        name = re.sub(r"[^\w-]+", "_", unit.task)[:40]
        place = self.path / UNITS / f"{name}-{unit.key}" / _short(unit.seeds)
        files = files_of(unit.task, result)
        sizes = {file: [len(content), _digest(content)] for file, content in files.items()}
        about = {"key": unit.key, "task": unit.task, "seeds": unit.seeds, "files": sizes}
        with _write_errors(self.path):
            place.parent.mkdir(parents=True, exist_ok=True)
            part = part_in(place.parent)
            part.mkdir()
            try:
                for file, content in {**files, MANIFEST: sealed(about)}.items():
                    write_whole(part / file, content)
                shutil.rmtree(place, ignore_errors=True)  # without a manifest it is not complete
                os.replace(part, place)
                shutil.rmtree(self.checkpoints(unit), ignore_errors=True)
            except BaseException:
                shutil.rmtree(part, ignore_errors=True)
                raise
        return StoredUnit(place, unit.key, unit.task, unit.seeds)

    def checkpoints(self, unit: Unit | StoredUnit) -> Path:
        """Return the folder for checkpoints of a unit's training until it is stored."""
        return self.path.resolve() / CHECKPOINTS / unit.key / _short(unit.seeds)

    def arrays(self, stored: StoredUnit, *names: str) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of those of some files, such as ``run.npz``, that a unit has."""
        found = dict[str, npt.NDArray[Any]]()
        for file in (stored.path / name for name in names):
            if file.exists():
                try:
                    with np.load(io.BytesIO(self._content(file))) as arrays:
                        found |= arrays
                except (ValueError, OSError, zipfile.BadZipFile):
                    raise self._damage(file) from None
        return found

    def table(self, stored: StoredUnit, name: str) -> pa.Table:
        """Return a unit's Parquet table."""
        return pq.read_table(io.BytesIO(self._content(stored.path / name)))

    def _content(self, file: Path) -> bytes:
        content = file.read_bytes()
        if _digest(content) != self._unsealed(file.parent / MANIFEST)["files"][file.name][1]:
            raise self._damage(file)
        return content

    def result(self, stored: StoredUnit, seeds: Collection[int]) -> UnitResult:
        """Return the result of some of a unit's seeds; StoreError if any of it is damaged."""
        self._content(stored.path / CURVES)
        arrays = self.arrays(stored, RUN, VALUES, SNAPSHOTS)
        rows = self.table(stored, DECISIONS).to_pylist()
        return UnitResult(of_seeds(arrays, seeds), [row for row in rows if row["seed"] in seeds])

    def source_values(
        self, done: Mapping[int, StoredUnit], seeds: Sequence[int], *, read: bool
    ) -> StoredValues:
        """Return what seeds learnt in a task, its values only if they are to be `read`.

        `done` has the unit that holds each seed.
        """
        units = {done[seed].path: done[seed] for seed in seeds}
        names = (RUN, VALUES) if read else (RUN,)
        arrays = {path: self.arrays(stored, *names) for path, stored in units.items()}
        rows = [(arrays[done[seed].path], done[seed].seeds.index(seed)) for seed in seeds]
        each = [values_of(found, k) for found, k in rows]
        values: Any = None  # not needed, or not saved: training raises an error then
        if all(one is not None for one in each):
            values = np.stack(each) if isinstance(each[0], np.ndarray) else each
        steps = [found["steps_used"][k] + found["retraining_steps"][k] for found, k in rows]
        scales = [
            (float(found["scale"][k]), float(found["shift"][k]))
            for found, k in rows
            if "scale" in found
        ]
        return StoredValues(values, np.array(steps, dtype=np.int64), scales)

    def _unsealed(self, file: Path) -> dict[str, Any]:
        """Return what :func:`sealed` was called on; StoreError if the file has changed since."""
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
            digest = found.pop("digest")
        except (ValueError, AttributeError, TypeError, KeyError, IndexError):
            raise self._damage(file) from None
        if digest != _digest(_json(found)):
            raise self._damage(file)
        return dict(found)


@contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    """Turn a failure to write into a StoreError that says what is safe."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"results cannot be written to {path} ({error.strerror}): what was stored before is "
            "whole; run again with --resume when there is space"
        ) from error


def _differences(mine: Any, yours: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys, with both values, in which two descriptions differ and results may too."""
    if not (isinstance(mine, dict) and isinstance(yours, dict)):
        if mine != yours:
            yield name, (mine, yours)
        return
    for key in sorted({*mine, *yours}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        if not (name == "configuration" and key in MAY_CHANGE) and place != "folder":
            yield from _differences(mine.get(key), yours.get(key), place)


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


def _short(seeds: tuple[int, ...]) -> str:
    name = "seeds-" + seed_ranges(seeds)
    return name if len(name) < 60 else name[:40] + "-" + _digest(name.encode())


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def sealed(value: Mapping[str, Any]) -> bytes:
    """Return JSON with its own checksum."""
    return _json({**value, "digest": _digest(_json(value))})


def _json(value: Any) -> bytes:
    return (json.dumps(value, indent=1) + "\n").encode()
