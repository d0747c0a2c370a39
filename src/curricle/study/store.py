"""The results store: a folder with a description of what its results depend on, and whole files."""

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from curricle.archives import Damaged, as_json, parsed_json, sealed, unsealed
from curricle.errors import StoreError
from curricle.files import (
    PART,
    Place,
    RemotePath,
    place_at,
    read_bounded,
    remove_folder,
    write_whole,
)
from curricle.study.dependencies import Dependencies
from curricle.study.description import differences, shown
from curricle.study.folders import (
    CHECKPOINTS,
    RUNS,
    STUDY,
    UNITS,
    check_ours,
    holds_study,
    locked,
    read_errors,
    write_errors,
)
from curricle.study.record import RunRecord, UnitRecord, plain, read_record
from curricle.study.serialization import GROUPS, UnitResult, as_parquet, of_seeds
from curricle.study.unit_file import (
    ENDING,
    UnitFile,
    checked_unit,
    opened_unit,
    place_of,
    unit_content,
)
from curricle.study.units import Unit, seed_ranges, seeds_in
from curricle.text_tables import counted

SCHEMA_VERSION = 3
"""Of the folder's layout; a folder of another version is refused."""
LARGEST_JSON = 2**26
"""Bytes of a JSON file at most: a study of 100,000 seeds has a hundredth of that."""
Result = TypeVar("Result")


@dataclass(frozen=True)
class StoredUnit:
    """A unit in the store: its file, its key and its seeds, all of which its place says."""

    path: Place
    key: str
    seeds: tuple[int, ...]

    @classmethod
    def at(cls, path: Place) -> "StoredUnit":
        """Return the unit of a file; StoreError where its name is cut and it cannot be read."""
        seeds = seeds_in(path.stem.removeprefix("seeds-"))
        if seeds is None:
            seeds = read_unit(path, UnitFile.about).seeds
        return cls(path, path.parent.name.rpartition("-")[2], seeds)

    @cached_property
    def about(self) -> UnitRecord:
        """What its file says of it; StoreError where that is damaged or of another unit."""
        found: UnitRecord = read_unit(self.path, UnitFile.about)
        if not self._is_place_of(found):
            raise damage(self.path)
        return found

    @property
    def whole(self) -> bool:
        """Whether it is as it was stored, all of it read; StoreError where it cannot be read.

        A file system that does not answer damages nothing: what is damaged is deleted.
        """
        try:
            with read_errors(self.path):
                return self._is_place_of(checked_unit(self.path))
        except (Damaged, ValueError):
            return False

    def _is_place_of(self, about: UnitRecord) -> bool:
        place = place_of(about.key, about.task, seed_ranges(about.seeds))
        return place == f"{self.path.parent.name}/{self.path.name}"

    @property
    def task(self) -> str:
        """The name of its task."""
        return self.about.task

    @property
    def dependencies(self) -> Dependencies:
        """What its key is a hash of."""
        return self.about.dependencies


def read_unit(path: Place, read: Callable[[UnitFile], Result]) -> Result:
    """Return what a function reads of a unit's file; StoreError where that cannot be."""
    try:
        with read_errors(path), opened_unit(path) as file:
            return read(file)
    except Damaged:
        raise damage(path) from None
    except ValueError as error:
        raise StoreError(f"{path} is not as Curricle writes it: {error}") from None


def arrays_in(
    stored: StoredUnit, *groups: str, most: int | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of some groups of a unit; see :meth:`StudyStore.arrays`."""
    return read_unit(stored.path, lambda file: file.arrays(*groups, most=most))


def written_unit(folder: Place, unit: Unit | UnitRecord, result: UnitResult) -> StoredUnit:
    """Write the result of a unit into a folder of results in one move, and return where it is."""
    about = UnitRecord(
        key=unit.key, dependencies=dict(unit.dependencies), task=unit.task, seeds=unit.seeds
    )
    place = f"{UNITS}/{place_of(unit.key, unit.task, seed_ranges(unit.seeds))}"
    _write(folder, place, unit_content(about, result))
    return StoredUnit(folder / place, unit.key, unit.seeds)


def _write(folder: Place, name: str, content: bytes) -> None:
    path = folder / name
    with write_errors(folder):
        if isinstance(path, Path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)


def damage(file: Place) -> StoreError:
    """Return the error that a file is damaged."""
    if file.name == STUDY:
        return StoreError(
            f"{file} is damaged, or not one that curricle wrote: where {UNITS} are beside it, "
            "delete it and run the study again with --resume"
        )
    how = "run" if file.suffix == ENDING else "delete it and run"
    return StoreError(
        f"{file} is damaged: its checksum does not fit; {how} the study again with --resume, "
        "which trains only what is missing or damaged"
    )


class StudyStore:
    """A folder of results and their description.

    Every file is written beside its place and moved there when it is complete and on disk, so that
    a run killed at any moment leaves whole files and whole units only. At a URL nothing is moved:
    checksums tell what is whole.

    Parameters
    ----------
    path : path or str
        Or a URL.

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

    def __init__(self, path: str | Place):
        self.path = place_at(path)
        with read_errors(self.path):
            if not (self.path / STUDY).exists():
                lacks = f"{self.path} has none"
                if isinstance(self.path, RemotePath) and not self.path.bucket.exists():
                    lacks = f"there is no {self.path.bucket}"
                raise StoreError(f"a folder of results holds a {STUDY}: {lacks}")
        self.description = self.read_sealed(STUDY)
        version = self.description.pop("schema_version", None)
        if version != SCHEMA_VERSION:
            found = "no schema version" if version is None else f"schema version {version}"
            raise StoreError(
                f"{self.path / STUDY} has {found} and this Curricle reads {SCHEMA_VERSION}: run "
                "the study again into a new folder, or read it with the version that wrote it"
            )

    def __repr__(self) -> str:
        return f"StudyStore({str(self.path)!r})"

    @classmethod
    @contextmanager
    def opened(
        cls,
        path: str | Place,
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
        path = place_at(path)
        with write_errors(path):
            check_ours(path, resume)
        with locked(path):
            yield cls._claimed(path, json.loads(json.dumps(description)), resume, check)

    @classmethod
    def _claimed(
        cls, path: Place, description: dict[str, Any], resume: bool, check: bool
    ) -> "StudyStore":
        if holds_study(path):
            store = cls(path)
            if check or "configuration" not in store.description:
                store.check(description)
            if not resume and (units := store.units()):
                raise StoreError(
                    f"{path} already holds results, {counted(len(units), 'file')} of units: go on "
                    "with --resume, or choose another folder"
                )
            if "configuration" in description:
                there, here = (one["configuration"] for one in (store.description, description))
                here["seeds"] = sorted({*there["seeds"], *here["seeds"]})
                description["record"]["seeds"] = here["seeds"]
        with write_errors(path):
            if isinstance(path, Path):
                for part in [*path.rglob(f".*{PART}")]:  # a killed run left it, incomplete
                    part.unlink(missing_ok=True)
            write_whole(path / STUDY, sealed({"schema_version": SCHEMA_VERSION, **description}))
        return cls(path)

    def redescribed(self, description: Mapping[str, Any]) -> "StudyStore":
        """Return the folder, which must be open, with another description of the same study."""
        return self._claimed(self.path, json.loads(json.dumps(description)), True, False)

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
        with read_errors(self.path / name):
            return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> None:
        """Write a file in one move; if that fails (StoreError), what was there stays."""
        _write(self.path, name, content)

    def write_json(self, name: str, content: Any) -> None:
        """Write a value as indented JSON."""
        self.write(name, as_json(content))

    def read_json(self, name: str) -> Any:
        """Return the value of a JSON file; StoreError if it is damaged."""
        return self.checked(name, lambda: parsed_json(self._bytes(name, LARGEST_JSON)))

    def read_sealed(self, name: str) -> dict[str, Any]:
        """Return what ``sealed`` was called on; StoreError if the file has changed since."""
        found = unsealed(self._bytes(name, LARGEST_JSON))
        if found is None:
            raise damage(self.path / name)
        return found

    def _bytes(self, name: str, most: int) -> bytes:
        with read_errors(self.path / name):
            return read_bounded(self.path / name, most)

    def write_table(self, name: str, columns: Mapping[str, npt.ArrayLike]) -> None:
        """Write a tidy table, a dict of column name to values of one length, as Parquet."""
        self.write(name, as_parquet(pa.table(dict(columns))))

    def add_run(self, run: RunRecord) -> None:
        """Add a run to the list of runs."""
        self.write_json(RUNS, [plain(one) for one in (*self.runs(), run)])

    def runs(self) -> list[RunRecord]:
        """Return the runs so far."""
        found = self.read_json(RUNS) if self.has(RUNS) else []
        if not isinstance(found, list):
            raise StoreError(f"{self.path / RUNS} must be a list of runs")
        return self.checked(RUNS, lambda: [read_record(RunRecord, one) for one in found])

    def checked(self, name: str | Place, read: Callable[[], Result]) -> Result:
        """Return what a function reads of a file; its ValueError becomes a StoreError with both."""
        try:
            return read()
        except ValueError as error:
            file = self.path / name if isinstance(name, str) else name
            raise StoreError(f"{file} is not as Curricle writes it: {error}") from None

    # -- units ---------------------------------------------------------------------------------

    def units(self) -> list[StoredUnit]:
        """Return the units in the store, by path."""
        with read_errors(self.path):
            found: list[Any] = [*self.path.glob(f"{UNITS}/*/*{ENDING}")]
        return [StoredUnit.at(path) for path in sorted(found)]

    def finished(self, without: Collection[Place] = ()) -> dict[str, dict[int, StoredUnit]]:
        """Return the unit that holds each seed, key -> seed -> unit, `without` some files."""
        found: dict[str, dict[int, StoredUnit]] = {}
        for stored in self.units():
            if stored.path not in without:
                found.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
        return found

    def damaged_units(self) -> list[Place]:
        """Return the files of units that are damaged; all are read."""
        return [stored.path for stored in self.units() if not stored.whole]

    def write_unit(self, unit: Unit | UnitRecord, result: UnitResult) -> StoredUnit:
        """Store the result of a unit in one move, and return where it is."""
        stored = written_unit(self.path, unit, result)
        remove_folder(self.checkpoints(unit))
        return stored

    def checkpoints(self, unit: Unit | UnitRecord) -> Place:
        """Return the folder for checkpoints of a unit's training until it is stored."""
        place = place_of(unit.key, "", seed_ranges(unit.seeds)).removesuffix(ENDING)
        root = self.path.resolve() if isinstance(self.path, Path) else self.path
        return root / CHECKPOINTS / place

    def remove_checkpoints(self) -> None:
        """Remove those of all units."""
        remove_folder(self.path / CHECKPOINTS)

    def arrays(
        self, stored: StoredUnit, *groups: str, most: int | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of some groups, such as ``run``, that a unit has.

        Snapshots may unpack to `most` bytes; StoreError names a file where they have more.
        """
        return arrays_in(stored, *groups, most=most)

    def decisions(self, stored: StoredUnit) -> pa.Table:
        """Return the table of a unit's decisions."""
        return read_unit(stored.path, lambda file: file.decisions(len(stored.seeds)))

    def result(
        self, stored: StoredUnit, seeds: Collection[int], most: int | None = None
    ) -> UnitResult:
        """Return the result of some of a unit's seeds; StoreError if any of it is damaged.

        `most` is as in :meth:`arrays`.
        """
        if not stored.whole:
            raise damage(stored.path)

        def read(file: UnitFile) -> tuple[dict[str, npt.NDArray[Any]], pa.Table]:
            return file.arrays(*GROUPS, most=most), file.decisions(len(stored.seeds))

        arrays, decisions = read_unit(stored.path, read)
        wanted = pc.is_in(decisions["seed"], pa.array(sorted(seeds), pa.int64()))
        return UnitResult(of_seeds(arrays, seeds), decisions.filter(wanted))
