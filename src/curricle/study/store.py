"""The results store: a folder of complete files, and the settings on which results depend."""

import errno
import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from filelock import FileLock, Timeout
from pydantic import TypeAdapter, ValidationError

from curricle.comparison.plan import Unit, seed_ranges
from curricle.curriculum.result import SourceValues
from curricle.errors import LostStoreError, StoreError, reason
from curricle.files import (
    PART,
    ArrayArchive,
    Damaged,
    Place,
    archive_content,
    as_json,
    bucket_of,
    digest_of,
    of_store,
    opened_archive,
    place_at,
    read_bounded,
    results_folder,
    sealed,
    unsealed,
    write_whole,
)
from curricle.learning.tabular_policy import Arrays, values_of
from curricle.study.record import (
    Plain,
    UnitRecord,
    first_mistake,
    read_record,
    record_in,
)
from curricle.study_file.schema import seeds_in_ranges
from curricle.text import counted

# -- The differences of two descriptions, by which their results may differ ------------------------

MAY_CHANGE = (
    "name",
    "seeds",
    "seeds_per_unit",
    "threshold",
    "window",
)  # no result depends on these


def differences(
    first: object, second: object, name: str = ""
) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys in which two descriptions differ, with both values; results may differ too."""
    if isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        first, second = dict(enumerate(first)), dict(enumerate(second))
    if not (isinstance(first, dict) and isinstance(second, dict)):
        if first != second:
            yield name, (first, second)
        return
    for key in sorted({*first, *second}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        # The plan is computed from the configuration and the user's functions.
        if not (name == "configuration" and key in MAY_CHANGE) and place != "plan":
            yield from differences(first.get(key), second.get(key), place)


def keys_of(description: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys of the units of a description's plan."""
    for arm in description["plan"]["arms"].values():
        yield from (node["key"] for node in arm["nodes"].values())


def shown(value: object) -> str:
    """Return a value as text for a sentence, shortened if it is long."""
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


# -- Folders of results: their files, their locks, and errors of reading and writing ---------------

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
TRIALS, CHOICE = "tuning", "choice"  # subfolders with the trials of a tuning, a choice
ANALYSIS = "analysis.json"
UNITS = "units"
PATIENCE = 0.3  # seconds to wait for a lock: a process that tests it holds it for a moment


def check_ours(path: Place, resume: bool) -> None:
    """Raise StoreError if a path is a file, or a folder that holds other things than results."""
    if path.exists() and not path.is_dir():
        raise StoreError(f"results need a folder: {path} is a file")
    for entry in (*path.glob("*"), *path.glob("*/*")) if isinstance(path, Path) else ():
        # Damaged files are deleted, and a linked folder may hold files of other programs.
        if entry.is_symlink() and entry.is_dir() and entry.suffix != PART:
            raise StoreError(f"folders in one of results must be no links: delete {entry}")
    results = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
    if not results and any(entry.suffix != PART and entry.name != LOCK for entry in path.iterdir()):
        raise StoreError(
            f"results need an empty folder or one of earlier results: {path} holds other files"
        )


@contextmanager
def locked(path: Place) -> Iterator[None]:
    """Lock a folder, created if missing, against other processes; StoreError if it is locked."""
    # The lock ends with the process, even if that is killed. A URL has no lock: two runs that write
    # there store equal units, and of each unit the last copy stays.
    if not isinstance(path, Path):
        yield
        return
    with write_errors(path):
        path.mkdir(parents=True, exist_ok=True)
        if (path / LOCK).is_symlink():  # opening a link may empty a file
            raise OSError(errno.ELOOP, f"its {LOCK} must be no link: delete it", str(path))
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


@contextmanager
def read_errors(path: Place) -> Iterator[None]:
    """Turn a failure to read into a StoreError."""
    try:
        yield
    except Exception as error:
        if not of_store(error):
            raise
        raise StoreError(f"{path} cannot be read: {reason(error)}") from error


def holds_study(path: Place) -> bool:
    """Return whether a folder exists and holds a study; StoreError if it cannot be read."""
    with read_errors(path):
        return (path / STUDY).exists()


@contextmanager
def write_errors(path: Place) -> Iterator[None]:
    """Turn a failure to write into a StoreError that says which results are safe."""
    try:
        yield
    except Exception as error:
        if not of_store(error):
            raise
        raise StoreError(
            f"results cannot be written to {path} ({reason(error)}): what was stored before is "
            "whole, and a run with --resume goes on from there"
        ) from error


def remove_parts(path: Place, folders: str = "") -> None:
    """Delete the incomplete files that a killed run left in a folder, or in `folders` below."""
    if isinstance(path, Path):
        with write_errors(path):
            for part in [*path.glob(f"{folders}.*{PART}")]:
                part.unlink(missing_ok=True)


@contextmanager
def lost_errors() -> Iterator[None]:
    """Turn a failure to read or write during a run into a LostStoreError."""
    try:
        yield
    except StoreError as error:
        if of_store(error.__cause__):
            raise LostStoreError(str(error)) from error.__cause__
        raise


# -- The arrays and decisions of a unit: groups of arrays, and those of selected seeds -------------

RUN, VALUES, SNAPSHOTS = GROUPS = "run", "values", "snapshots"  # groups of arrays


class DecisionRow(NamedTuple):
    """The reason why training of a seed continued or ended at a checkpoint."""

    task: str
    seed: int
    steps: int
    ends: bool
    criterion: str
    lowest: float
    level: float
    rise: float
    settled: float
    reason: str


DECISION_ROWS = TypeAdapter(list[DecisionRow])
OF_A_SEED = re.compile(r"(states|values)_(\d+)(/.*)?")  # name of an array of the seed in this row
LARGEST_DECISIONS = 2**26  # most bytes of a unit's decisions: 300,000 decisions


class UnitContent(NamedTuple):
    """What training a unit gave, and its file holds."""

    # Of the `LearningResult` (`arrays_of`), source_steps, and initial_values of a constant.
    arrays: Arrays
    decisions: Sequence[DecisionRow]  # by seed and checkpoint


def of_seeds(arrays: Arrays, seeds: Collection[int]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of some seeds; snapshots belong to the first seed and stay with it."""
    rows = np.flatnonzero(np.isin(arrays["seeds"], list(seeds))).tolist()
    kept = dict[str, npt.NDArray[Any]]()
    for name, array in arrays.items():
        of_seed = OF_A_SEED.fullmatch(name)
        of_first = name.startswith("snapshot_")
        if of_seed and int(of_seed[2]) in rows:
            kept[f"{of_seed[1]}_{rows.index(int(of_seed[2]))}{of_seed[3] or ''}"] = array
        elif name == "steps" or (of_first and 0 in rows):
            kept[name] = array
        elif not of_seed and not of_first:
            kept[name] = array[rows]
    return kept


def group_of(name: str) -> str:
    """Return the group of an array by its name: run, values, snapshots, ..."""
    if name.startswith("snapshot_"):
        return SNAPSHOTS
    return VALUES if name.startswith(("values", "states")) else RUN


# -- The file of a unit: a sealed archive of its arrays and its record -----------------------------

NamedArrays = dict[str, npt.NDArray[Any]]  # arrays by name
ABOUT, DECISIONS = "unit.json", "decisions.json"  # members of the archive besides the arrays
ENDING = ".npz"
LARGEST_ABOUT = 2**24  # most bytes of unit.json: 100,000 seeds take a twentieth of that
LONGEST_NAME, KEPT = 200, 40  # most characters of a unit's name; characters kept of longer names


def unit_content(about: UnitRecord, result: UnitContent) -> bytes:
    """Return the content of a unit's file, which has equal bytes for equal results."""
    ordered = dict(sorted(result.arrays.items(), key=lambda item: GROUPS.index(group_of(item[0]))))
    decisions = json.dumps(result.decisions).encode()
    further_files = {DECISIONS: decisions, ABOUT: as_json(about.model_dump(mode="json"))}
    return archive_content(ordered, further_files, _snapshots_of(ordered))


def _snapshots_of(names: Iterable[str]) -> list[str]:
    return [name for name in names if group_of(name) == SNAPSHOTS]


def groups_in(
    archive: ArrayArchive, groups: Collection[str], most: int | None = None
) -> NamedArrays:
    """Return the arrays of some groups in a unit's file, without pickles."""
    names = [name for name in archive.names if group_of(name) in groups]
    return archive.read(*names, compressed=_snapshots_of(names), most=most)


def decisions_in(archive: ArrayArchive) -> list[DecisionRow]:
    """Return the decisions in a unit's file, by seed and checkpoint; ValueError if malformed."""
    content = archive.content(DECISIONS, LARGEST_DECISIONS)
    try:
        return DECISION_ROWS.validate_json(content, strict=True)
    except ValidationError as error:
        raise ValueError(first_mistake(error)) from None


def place_of(key: str, task: str, seeds: str) -> str:
    """Return the path of a unit's file below the folder of units."""
    name, prefix = f"seeds-{seeds}", re.sub(r"[^\w-]+", "_", task)[:KEPT]
    if len(name) >= LONGEST_NAME:
        name = f"{name[:KEPT]}_{digest_of(name.encode())}"
    return f"{prefix}-{key}/{name}{ENDING}"


# -- Units in the store, and the store -------------------------------------------------------------

ROW_BYTES = 600  # about the bytes of a decision in memory
MOST_KEPT = 2**28
"""Bytes of curves, snapshots and decisions to keep in memory, so that a run, its tables and a
report read each file once."""
LARGEST_KEPT = 2**20  # bytes of a unit's values up to which they are kept, too, for later tasks
SCHEMA_VERSION = 6  # version of the folder's layout; other versions are refused
LARGEST_JSON = 2**24
"""Most bytes of a JSON file, which takes up to 25 times as many in memory. The file of a study with
100,000 seeds has a twentieth of that."""
Result = TypeVar("Result")
Record = TypeVar("Record", bound=Plain)
Finished = dict[str, dict[int, "StoredUnit"]]  # key -> seed -> unit


class Kept(NamedTuple):
    """The content of a unit that is kept in memory."""

    groups: Collection[str]  # of its arrays
    task: str
    content: UnitContent

    @property
    def size(self) -> int:
        """About its bytes."""
        arrays, decisions = self.content
        return sum(array.nbytes for array in arrays.values()) + ROW_BYTES * len(decisions)


@dataclass(frozen=True)
class StoredUnit:
    """A unit in the store: its file, and the key and seeds in the path of the file."""

    path: Place
    key: str
    seeds: tuple[int, ...]

    @classmethod
    def at(cls, path: Place) -> "StoredUnit":
        """Return the unit of a file; StoreError if a shortened name's file cannot be read."""
        seeds = tuple(seeds_in_ranges(path.stem.removeprefix("seeds-").replace("+", ",")))
        unit = cls(path, path.parent.name.rpartition("-")[2], seeds)
        if not seeds:
            unit = replace(unit, seeds=unit.about.seeds)
        return unit

    @contextmanager
    def opened(self, *, whole: bool = False) -> Iterator[tuple[ArrayArchive, UnitRecord]]:
        """Yield the unit's file, open to read parts or the `whole`, and its record.

        StoreError if it is damaged, or says that it is another unit than its path says.
        """
        try:
            with read_errors(self.path), opened_archive(self.path, whole=whole) as archive:
                about = record_in(UnitRecord, archive.content(ABOUT, LARGEST_ABOUT))
                if self.seeds and (why := self._stranger(about)):
                    raise damage(self.path, why)
                yield archive, about
        except Damaged:
            raise damage(self.path) from None
        except ValueError as error:
            raise StoreError(f"{self.path} is not as Curricle writes it: {error}") from None

    def _stranger(self, about: UnitRecord) -> str:
        """Return a clause on the file's unit if it is another one; empty if it is this one."""
        place = place_of(about.key, about.task, seed_ranges(about.seeds))
        if place == f"{self.path.parent.name}/{self.path.name}":
            return ""
        return f"it holds {about.task!r}, seeds {seed_ranges(about.seeds)}, of key {about.key}"

    @cached_property
    def about(self) -> UnitRecord:
        """The record in the unit's file; StoreError if it is damaged or another unit's."""
        with self.opened() as (_, about):
            return about

    def content(self, task: str, groups: Collection[str], most: int | None = None) -> UnitContent:
        """Return the arrays of some groups of a unit of a task, and its decisions.

        StoreError if the file is damaged, or of another task; `most` bytes of snapshots are read.
        """
        with self.opened() as (archive, about):
            if about.task != task:
                raise damage(self.path, f"it is of task {about.task!r}, not {task!r}")
            return UnitContent(groups_in(archive, groups, most), decisions_in(archive))

    def result(self, seeds: Collection[int], most: int | None = None) -> UnitContent:
        """Return the result of some of the unit's seeds; StoreError if the file is damaged."""
        with self.opened(whole=True) as (archive, _):
            arrays = groups_in(archive, GROUPS, most)
            decisions = decisions_in(archive)
        return UnitContent(of_seeds(arrays, seeds), [row for row in decisions if row.seed in seeds])


def damage(file: Place, why: str = "its checksum does not fit") -> StoreError:
    """Return the error about a damaged file."""
    if file.name == STUDY:
        return StoreError(
            f"{file} is damaged, or not one that curricle wrote: where {UNITS} are beside it, "
            "delete it and run the study again with --resume"
        )
    how = "run" if file.suffix == ENDING else "delete it and run"
    return StoreError(
        f"{file} is damaged: {why}; {how} the study again with --resume, which trains only what "
        "is missing or damaged"
    )


class StudyStore:
    """A folder of results and their description.

    A file is moved to its place when it is complete and on disk, so that a killed run leaves only
    whole files. At a URL files are not moved: checksums tell whether they are whole. StoreError
    where the path or URL holds no results, or results of another version.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with StudyStore.opened(folder, {"seeds": 30}, resume=True):
    ...         pass
    ...     try:
    ...         with StudyStore.opened(folder, {"seeds": 5}, resume=True):
    ...             pass
    ...     except StoreError as error:
    ...         print(str(error).replace(folder, "DIR"))
    DIR holds results of other settings: seeds is 30 there and 5 here; choose another folder
    """

    def __init__(self, path: str | Place, description: dict[str, Any] | None = None):
        self.path = place_at(path)
        self._kept, self._room = dict[Place, Kept](), MOST_KEPT
        if description is not None:  # the folder has just been opened with it
            self.description = description
            return
        self.require_there()
        self.description = self._unsealed(STUDY)
        version = self.description.pop("schema_version", None)
        if version != SCHEMA_VERSION:
            stated = "no schema version" if version is None else f"schema version {version}"
            if isinstance(version, int) and version > SCHEMA_VERSION:
                stated += ", of a later Curricle,"
            raise StoreError(
                f"{self.path / STUDY} has {stated} and this Curricle reads {SCHEMA_VERSION}: run "
                "the study again into a new folder, or read it with the version that wrote it"
            )

    def require_there(self) -> None:
        """Raise StoreError unless the folder holds a study."""
        with read_errors(self.path):
            if not (self.path / STUDY).exists():
                lacks = f"{self.path} has none"
                if isinstance(self.path, Path) and self.path.suffix == ".toml":
                    lacks += f"; the results of a study's file are in {results_folder(self.path)}"
                bucket = bucket_of(self.path)
                if not isinstance(self.path, Path) and not bucket.exists():
                    lacks = f"there is no {str(bucket).rstrip('/')}"
                gone = FileNotFoundError(errno.ENOENT, "it is not there", str(self.path / STUDY))
                raise StoreError(f"a folder of results holds a {STUDY}: {lacks}") from gone

    def __repr__(self) -> str:
        return f"StudyStore({str(self.path)!r})"

    @classmethod
    @contextmanager
    def opened(
        cls, path: str | Place, description: Mapping[str, Any], *, resume: bool, check: bool = True
    ) -> Iterator["StudyStore"]:
        """Open a folder for results, created if missing, and lock it against other processes.

        Results depend on the `description`. With `resume` the folder may already hold units.
        StoreError when the folder is in use or holds other files; with `check`, or if units do not
        record their dependencies, also when its results have another description.
        """
        path = place_at(path)
        with write_errors(path):
            check_ours(path, resume)
        with locked(path):
            exists = holds_study(path)
            store = cls(path) if exists else cls(path, {})
            if exists and (check or "configuration" not in store.description):
                store.check(description)
            if exists and not resume and (units := store.units()):
                raise StoreError(
                    f"{path} already holds results, {counted(len(units), 'file')} of units: go on "
                    "with --resume, or choose another folder"
                )
            remove_parts(path, "**/")
            store.describe(description)
            yield store

    def describe(self, description: Mapping[str, Any]) -> None:
        """Describe the opened folder anew, as the same study with other settings or seeds.

        StoreError where its units cannot be those of a study so described.
        """
        description, before = dict(description), self.description
        if "configuration" in before and "configuration" in description:
            stored, wanted = before["configuration"], dict(description["configuration"])
            if stored["name"] != wanted["name"] and not self._serves(description):
                versions = [before["curricle"], description["curricle"]]
                of = "" if versions[0] == versions[1] else f" of Curricle {' and '.join(versions)}"
                raise StoreError(
                    f"another study cannot go on in a folder: {self.path} holds units of "
                    f"{stored['name']!r}, none of which {wanted['name']!r} can use{of}; choose "
                    "another folder"
                )
            if self.listed and stored.get("snapshots") != wanted["snapshots"]:
                raise StoreError(
                    f"snapshots are kept while a unit is trained: {self.path} holds units with "
                    f"snapshots = {stored.get('snapshots')}, and it is {wanted['snapshots']} here; "
                    "set it back, or choose another folder"
                )
            if self.listed:
                wanted["seeds"] = sorted({*stored["seeds"], *wanted["seeds"]})
                description["configuration"] = wanted
            tuning = wanted.get("tuned") or wanted.get("tune") or {}
            if both := sorted({*tuning.get("seeds", ())} & {*wanted["seeds"]}):
                raise StoreError(
                    f"seeds of tuning must be none of the study's: {both[0]} is one of those in "
                    f"{self.path}; change tune.seeds, or choose another folder"
                )
            if before["plan"]["arms"] != description["plan"]["arms"]:
                self.remove([self.path / ANALYSIS])  # of other arms
        if description != before or not self.has(STUDY):
            content = sealed({"schema_version": SCHEMA_VERSION, **description})
            with write_errors(self.path):
                write_whole(self.path / STUDY, content)
            self.description = description

    def _serves(self, description: Mapping[str, Any]) -> bool:
        """Return whether a study so described can use a unit, or the folder has none."""
        if held := {unit.key for unit in self.units()}:
            return bool(held & {*keys_of(description)})
        trials = [self.path / folder for folder in (TRIALS, CHOICE)]
        return not any(holds_study(path) and StudyStore(path).units() for path in trials)

    def check(self, description: Mapping[str, Any]) -> None:
        """Raise StoreError if results of another description may differ from the stored results."""
        for name, (old, new) in differences(self.description, description):
            raise StoreError(
                f"{self.path} holds results of other settings: {name} is {shown(old)} there and "
                f"{shown(new)} here; choose another folder"
            )

    def has(self, name: str) -> bool:
        """Return whether a file exists; existing files are complete."""
        with read_errors(self.path / name):
            return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> None:
        """Write a file in one move; if that fails, the old file stays (StoreError)."""
        file = self.path / name
        with write_errors(self.path):
            if isinstance(self.path, Path):
                (self.path / STUDY).stat()  # raises if the folder was moved, and makes no new one
                file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, content)

    def remove(self, files: Iterable[Place]) -> None:
        """Delete some files."""
        with write_errors(self.path):
            for file in files:
                file.unlink(missing_ok=True)
                self.listed.pop(file, None)

    def write_record(self, name: str, record: Plain) -> None:
        """Write a record with a checksum."""
        self.write(name, sealed(record.model_dump(mode="json")))

    def record(self, name: str, model: type[Record]) -> Record:
        """Return the record in a file, an empty one without it; StoreError if it is damaged."""
        content = self._unsealed(name) if self.has(name) else {}
        return self.checked(name, lambda: read_record(model, content))

    def _unsealed(self, name: str) -> dict[str, Any]:
        with read_errors(self.path / name):
            content = unsealed(read_bounded(self.path / name, LARGEST_JSON))
        if content is None:
            raise damage(self.path / name)
        return content

    def checked(self, name: str | Place, read: Callable[[], Result]) -> Result:
        """Return the result of `read`; its ValueError becomes a StoreError that names the file."""
        try:
            return read()
        except ValueError as error:
            file = self.path / name if isinstance(name, str) else name
            raise StoreError(
                f"{file} is not as Curricle writes it: {error}; delete it and run the study again "
                "with --resume"
            ) from None

    @cached_property
    def listed(self) -> dict[Place, StoredUnit]:
        """The units by their files: those that were there, which are listed once, and new ones."""
        with read_errors(self.path):
            files: list[Any] = [*self.path.glob(f"{UNITS}/*/*{ENDING}")]
        return {path: StoredUnit.at(path) for path in sorted(files)}

    def units(self) -> list[StoredUnit]:
        """Return the units in the store, by path."""
        return [self.listed[path] for path in sorted(self.listed)]

    def finished(self, without: Collection[Place] = ()) -> Finished:
        """Return key -> seed -> unit for all units except those in the files `without`."""
        finished: Finished = {}
        for stored in self.units():
            if stored.path in without:
                continue
            of_key = finished.setdefault(stored.key, {})
            if twice := sorted(of_key.keys() & {*stored.seeds}):
                raise StoreError(
                    f"a seed must be in one file: {of_key[twice[0]].path} and {stored.path} hold "
                    f"seed {twice[0]}; delete one of them"
                )
            of_key.update(dict.fromkeys(stored.seeds, stored))
        return finished

    def damaged_units(self) -> list[Place]:
        """Return the files of damaged units; reads all files, and keeps their curves."""
        return [stored.path for stored in self.units() if not self.is_whole(stored)]

    def is_whole(self, stored: StoredUnit) -> bool:
        """Return whether a unit's file is undamaged; StoreError if it cannot be read."""
        if stored.path in self._kept:  # read or written by this process
            return True
        try:
            with stored.opened(whole=True) as (archive, about), suppress(ValueError):
                # Malformed curves or decisions raise an error when they are needed.
                content = UnitContent(groups_in(archive, (RUN,)), decisions_in(archive))
                groups = {RUN} if _snapshots_of(archive.names) else {RUN, SNAPSHOTS}
                self._keep(stored, Kept(groups, about.task, content))
        except StoreError as error:
            if error.__cause__ is None:
                return False
            raise  # a file that cannot be read now is not damaged, and must not be deleted
        return True

    def write_unit(self, unit: Unit | UnitRecord, result: UnitContent) -> StoredUnit:
        """Store the result of a unit in one move, and return the stored unit."""
        seeds = tuple(result.arrays["seeds"].tolist())
        depends = dict(unit.dependencies)
        about = UnitRecord(key=unit.key, dependencies=depends, task=unit.task, seeds=seeds)
        name = f"{UNITS}/{place_of(unit.key, unit.task, seed_ranges(seeds))}"
        self.write(name, unit_content(about, result))
        stored = StoredUnit(self.path / name, unit.key, seeds)
        self.listed[stored.path] = stored
        self._keep(stored, Kept(GROUPS, unit.task, result))
        return stored

    def content(
        self, stored: StoredUnit, task: str, groups: Collection[str] = (RUN,), most: int = 0
    ) -> UnitContent:
        """Return the arrays of some groups and the decisions of a unit of a task.

        They are read once and kept in memory where there is room.
        """
        kept = self._kept.get(stored.path)
        if kept is not None and kept.task == task and {*groups} <= {*kept.groups}:
            arrays = kept.content.arrays.items()
            some = {name: array for name, array in arrays if group_of(name) in groups}
            return UnitContent(some, kept.content.decisions)
        content = stored.content(task, groups, most)
        self._keep(stored, Kept(groups, task, content))
        return content

    def _keep(self, stored: StoredUnit, kept: Kept) -> None:
        """Keep the content of a unit in memory if there is room; large values are not kept."""
        if (before := self._kept.pop(stored.path, None)) is not None:
            self._room += before.size
            arrays = {**before.content.arrays, **kept.content.arrays}
            groups = {*before.groups, *kept.groups}
            kept = kept._replace(groups=groups, content=kept.content._replace(arrays=arrays))
        values = [name for name in kept.content.arrays if group_of(name) == VALUES]
        if sum(kept.content.arrays[name].nbytes for name in values) > LARGEST_KEPT:
            arrays = {name: x for name, x in kept.content.arrays.items() if name not in values}
            groups = {*kept.groups} - {VALUES}
            kept = kept._replace(groups=groups, content=kept.content._replace(arrays=arrays))
        if kept.size <= self._room:
            self._room -= kept.size
            self._kept[stored.path] = kept

    def source_values(
        self, task: str, units: Mapping[int, StoredUnit], seeds: Sequence[int], *, read: bool
    ) -> SourceValues:
        """Return what seeds learnt in a task, which is left out; no values unless `read`."""
        files = dict.fromkeys(units[seed] for seed in seeds)
        groups = (RUN, VALUES) if read else (RUN,)
        arrays = {file: self.content(file, task, groups).arrays for file in files}
        rows = [(arrays[units[seed]], units[seed].seeds.index(seed)) for seed in seeds]
        values: Any = [values_of(of_unit, k) for of_unit, k in rows] if read else [None]
        if any(of_seed is None for of_seed in values):
            values = None  # not needed; or not saved, for which training raises an error
        elif isinstance(values[0], np.ndarray):
            values = np.stack(values)
        steps = np.array([of_unit["steps_used"][k] for of_unit, k in rows])
        return SourceValues(None, tuple(seeds), values, steps)
