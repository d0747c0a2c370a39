"""The results store: a folder with a description of what its results depend on, and whole files."""

import json
import os
import re
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy.typing as npt
import pyarrow as pa
from filelock import FileLock, Timeout

from curricle.errors import StoreError
from curricle.files import PART, part_in, read_bounded, write_whole
from curricle.study.dependencies import Dependencies
from curricle.study.description import differences, shown
from curricle.study.folders import (
    CHECKPOINTS,
    LOCK,
    MANIFEST,
    RUNS,
    STUDY,
    UNITS,
    check_ours,
    write_errors,
)
from curricle.study.record import RunRecord, UnitRecord, plain, read_record
from curricle.study.sealed_json import as_json, digest_of, sealed, unsealed
from curricle.study.serialization import (
    CURVES,
    DECISIONS,
    RUN,
    SCHEMAS,
    SNAPSHOTS,
    VALUES,
    UnitResult,
    as_parquet,
    checkpoints_of,
    files_of,
    of_seeds,
    read_npz,
    read_parquet,
)
from curricle.study.units import Unit, seed_ranges

SCHEMA_VERSION = 2
"""Of the folder's layout; a folder of another version is refused."""
LARGEST_JSON = 2**26
"""Bytes of a JSON file at most: a study of 100,000 seeds has a hundredth of that."""
Result = TypeVar("Result")


@dataclass(frozen=True)
class StoredUnit:
    """A unit in the store: its folder, its key, what that is a hash of, and its seeds."""

    path: Path
    key: str
    dependencies: Dependencies = field(hash=False, repr=False)
    task: str
    seeds: tuple[int, ...]


class StudyStore:
    """A folder of results and their description.

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
        if not (self.path / STUDY).exists():
            raise StoreError(f"a folder of results holds a {STUDY}: {self.path} has none")
        self.description = self.read_sealed(STUDY)
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
        cls,
        path: str | Path,
        description: Mapping[str, Any],
        *,
        resume: bool,
        check: bool = True,
    ) -> Iterator["StudyStore"]:
        """Open a folder for results, made if need be, and lock it against other processes.

        The lock is released when the process ends, also when it is killed.

        Parameters
        ----------
        path : path
        description : dict
            What the results depend on.
        resume : bool
            Whether the folder may hold units already.
        check : bool
            Whether to refuse results of another description. A study needs no such check, since
            each unit says what it depends on: its description replaces that of an earlier one.

        Raises
        ------
        StoreError
            When the folder is in use, or holds results of another description or other files.
        """
        path = Path(path)
        with write_errors(path):
            check_ours(path, resume)
            path.mkdir(parents=True, exist_ok=True)
            lock = FileLock(path / LOCK)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise StoreError(
                    f"only one run at a time can write to a folder: another is at work on {path}"
                ) from None
        try:
            yield cls._claimed(path, json.loads(json.dumps(description)), resume, check)
        finally:
            lock.release()

    @classmethod
    def _claimed(
        cls, path: Path, description: dict[str, Any], resume: bool, check: bool
    ) -> "StudyStore":
        if (path / STUDY).exists():
            store = cls(path)
            if check or "configuration" not in store.description:
                store.check(description)
            if not resume and (units := store.units()):
                raise StoreError(
                    f"{path} already holds results, {len(units)} units: go on with --resume, or "
                    "choose another folder"
                )
            if "configuration" in description:
                there, here = (one["configuration"] for one in (store.description, description))
                here["seeds"] = sorted({*there["seeds"], *here["seeds"]})
                description["record"]["seeds"] = here["seeds"]
        for part in [*path.rglob(f".*{PART}")]:
            # A killed run left it; it is not complete.
            if part.is_dir() and not part.is_symlink():
                shutil.rmtree(part)
            else:
                part.unlink(missing_ok=True)
        with write_errors(path):
            write_whole(path / STUDY, sealed({"schema_version": SCHEMA_VERSION, **description}))
        return cls(path)

    def check(self, description: Mapping[str, Any]) -> None:
        """Raise StoreError if results of a description, as :meth:`opened` takes it, differ."""
        for name, (there, here) in differences(self.description, description):
            raise StoreError(
                f"{self.path} holds results of other settings: {name} is {shown(there)} there and "
                f"{shown(here)} here; choose another folder"
            )

    # -- files ---------------------------------------------------------------------------------

    def has(self, name: str) -> bool:
        """Return whether a file is there (and so complete)."""
        return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> None:
        """Write a file in one move; if that fails (StoreError), what was there stays."""
        path = self.path / name
        with write_errors(self.path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)

    def write_json(self, name: str, content: Any) -> None:
        """Write a value as indented JSON."""
        self.write(name, as_json(content))

    def read_json(self, name: str) -> Any:
        """Return the value of a JSON file; StoreError if it is damaged."""
        try:
            return json.loads(self._bytes(name, LARGEST_JSON))
        except RecursionError:
            raise StoreError(f"{self.path / name} must be JSON that is not nested deeply") from None
        except ValueError as error:
            raise StoreError(f"{self.path / name} must be JSON: {error}") from None

    def read_sealed(self, name: str) -> dict[str, Any]:
        """Return what ``sealed`` was called on; StoreError if the file has changed since."""
        found = unsealed(self._bytes(name, LARGEST_JSON))
        if found is None:
            raise self._damage(self.path / name)
        return found

    def _bytes(self, name: str, most: int) -> bytes:
        try:
            return read_bounded(self.path / name, most)
        except OSError as error:
            raise StoreError(f"{self.path / name} cannot be read: {error.strerror}") from None

    def write_table(self, name: str, columns: Mapping[str, npt.ArrayLike] | pa.Table) -> None:
        """Write a tidy table, a dict of column name to values of one length, as Parquet."""
        table = columns if isinstance(columns, pa.Table) else pa.table(dict(columns))
        self.write(name, as_parquet(table))

    def add_run(self, run: RunRecord) -> None:
        """Add a run to the list of runs."""
        self.write_json(RUNS, [plain(one) for one in (*self.runs(), run)])

    def runs(self) -> list[RunRecord]:
        """Return the runs so far."""
        found = self.read_json(RUNS) if self.has(RUNS) else []
        if not isinstance(found, list):
            raise StoreError(f"{self.path / RUNS} must be a list of runs")
        return self.checked(RUNS, lambda: [read_record(RunRecord, one) for one in found])

    def checked(self, name: str, read: Callable[[], Result]) -> Result:
        """Return what a function reads of a file; its ValueError becomes a StoreError with both."""
        try:
            return read()
        except ValueError as error:
            raise StoreError(f"{self.path / name} is not as Curricle writes it: {error}") from None

    # -- units ---------------------------------------------------------------------------------

    def units(self) -> list[StoredUnit]:
        """Return the units in the store, by path; StoreError names one that is damaged."""
        return [self._stored(manifest) for manifest in self._manifests()]

    def finished(self, without: Collection[Path] = ()) -> dict[str, dict[int, StoredUnit]]:
        """Return the unit that holds each seed, key -> seed -> unit, `without` some folders."""
        found: dict[str, dict[int, StoredUnit]] = {}
        for manifest in self._manifests():
            if manifest.parent not in without:
                stored = self._stored(manifest)
                found.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
        return found

    def damaged_units(self) -> dict[Path, Path]:
        """Return the folders of units that are damaged, each with a file that is; all are read."""
        found = dict[Path, Path]()
        for manifest in self._manifests():
            file = manifest
            try:
                for name in self._manifest(manifest).files:
                    file = manifest.parent / name
                    self._content(file)
            except StoreError:
                found[manifest.parent] = file
        return found

    def _manifests(self) -> list[Path]:
        found = self.path.glob(f"{UNITS}/*/*/{MANIFEST}")
        return sorted(path for path in found if not path.parent.name.endswith(PART))

    def _stored(self, manifest: Path) -> StoredUnit:
        found = self._manifest(manifest)
        for name, (size, _) in found.files.items():
            file = manifest.parent / name
            if not file.is_file() or file.stat().st_size != size:
                raise self._damage(file)
        return StoredUnit(manifest.parent, found.key, found.dependencies, found.task, found.seeds)

    def _manifest(self, path: Path) -> UnitRecord:
        found = self.read_sealed(self._name(path))
        return self.checked(self._name(path), partial(read_record, UnitRecord, found))

    def _damage(self, file: Path) -> StoreError:
        if file.name == STUDY:
            return StoreError(
                f"{file} is damaged, or not one that curricle wrote: where {UNITS} are beside it, "
                "delete it and run the study again with --resume"
            )
        how = "delete it and run" if file.parent == self.path else "run"
        return StoreError(
            f"{file} is damaged: its checksum does not fit; {how} the study again with --resume, "
            "which trains only what is missing or damaged"
        )

    def write_unit(self, unit: Unit | StoredUnit, result: UnitResult) -> StoredUnit:
        """Store the result of a unit in one move, and return where it is."""
        name = re.sub(r"[^\w-]+", "_", unit.task)[:40]
        place = self.path / UNITS / f"{name}-{unit.key}" / _short(unit.seeds)
        files = files_of(unit.task, result)
        sizes = {file: [len(content), digest_of(content)] for file, content in files.items()}
        about = {
            "key": unit.key,
            "task": unit.task,
            "seeds": unit.seeds,
            "files": sizes,
            "dependencies": unit.dependencies,
        }
        with write_errors(self.path):
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
        return StoredUnit(place, unit.key, unit.dependencies, unit.task, unit.seeds)

    def checkpoints(self, unit: Unit | StoredUnit) -> Path:
        """Return the folder for checkpoints of a unit's training until it is stored."""
        return self.path.resolve() / CHECKPOINTS / unit.key / _short(unit.seeds)

    def arrays(
        self, stored: StoredUnit, *names: str, most: int | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of those of some files, such as ``run.npz``, that a unit has.

        Those that are compressed may unpack to `most` bytes; StoreError names one that has more.
        """
        found = dict[str, npt.NDArray[Any]]()
        for file in (stored.path / name for name in names):
            if file.exists():
                content, packed = self._content(file), file.name == SNAPSHOTS
                found |= self.checked(
                    self._name(file), partial(read_npz, content, packed=packed, most=most)
                )
        return found

    def table(self, stored: StoredUnit, name: str) -> pa.Table:
        """Return a unit's Parquet table."""
        content, run = self._content(stored.path / name), self.arrays(stored, RUN)
        n = self.checked(self._name(stored.path / RUN), partial(checkpoints_of, run))
        read = partial(read_parquet, content, SCHEMAS[name], len(stored.seeds) * (1 + n))
        return self.checked(self._name(stored.path / name), read)

    def _content(self, file: Path) -> bytes:
        files = self._manifest(file.parent / MANIFEST).files
        size, digest = files.get(file.name, (0, ""))
        content = self._bytes(self._name(file), size)
        if digest_of(content) != digest:
            raise self._damage(file)
        return content

    def _name(self, file: Path) -> str:
        return str(file.relative_to(self.path))

    def result(
        self, stored: StoredUnit, seeds: Collection[int], most: int | None = None
    ) -> UnitResult:
        """Return the result of some of a unit's seeds; StoreError if any of it is damaged.

        `most` is as in :meth:`arrays`.
        """
        self._content(stored.path / CURVES)
        arrays = self.arrays(stored, RUN, VALUES, SNAPSHOTS, most=most)
        rows = self.table(stored, DECISIONS).to_pylist()
        return UnitResult(of_seeds(arrays, seeds), [row for row in rows if row["seed"] in seeds])


def _short(seeds: tuple[int, ...]) -> str:
    name = "seeds-" + seed_ranges(seeds)
    return name if len(name) < 60 else name[:40] + "-" + digest_of(name.encode())
