"""The results store: a folder of complete files and the settings on which its results depend."""

import errno
import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from filelock import FileLock, Timeout
from pydantic import TypeAdapter, ValidationError

from curricle.comparison.plan import Unit, seed_ranges
from curricle.curriculum.curriculum import Node
from curricle.curriculum.result import StoredValues
from curricle.errors import LostStoreError, StoreError, reason
from curricle.files import (
    PART,
    ArrayArchive,
    Damaged,
    Place,
    RemotePath,
    archive_content,
    as_json,
    digest_of,
    opened_archive,
    parsed_json,
    place_at,
    read_bounded,
    remove_folder,
    sealed,
    unsealed,
    write_whole,
)
from curricle.learning.result import LearningResult, arrays_of, joined_results
from curricle.learning.tabular_policy import Arrays, values_of
from curricle.study.record import (
    CurriculaRecord,
    Plain,
    UnitRecord,
    first_mistake,
    plain,
    read_record,
)
from curricle.study_file.schema import seeds_in_ranges
from curricle.tasks.mdp import generative_model
from curricle.text import counted

# -- In what two descriptions of results differ, so that their results may too ---------------------

MAY_CHANGE = ("name", "seeds", "seeds_per_unit", "threshold", "window")  # no result depends on it


def differences(first: Any, second: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys, with both values, by which two descriptions and so results may differ."""
    if isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        first, second = dict(enumerate(first)), dict(enumerate(second))
    if not (isinstance(first, dict) and isinstance(second, dict)):
        if first != second:
            yield name, (first, second)
        return
    for key in sorted({*first, *second}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        # The record follows from the configuration and the study's own functions.
        if not (name == "configuration" and key in MAY_CHANGE) and place != "record":
            yield from differences(first.get(key), second.get(key), place)


def shown(value: Any) -> str:
    """Return a value as text for a sentence, shortened if it is long."""
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


# -- Folders of results: what they are called, which ones may be written to, and errors of writing

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
UNITS = "units"
PATIENCE = 0.3  # seconds for a lock: whoever looks whether it is held has it for a moment
CHECKPOINTS = ".checkpoints"  # where networks in training are saved, to go on from


def check_ours(path: Place, resume: bool) -> None:
    """Raise StoreError if a path is a file, or a folder that holds other things than results."""
    if path.exists() and not path.is_dir():
        raise StoreError(f"results need a folder: {path} is a file")
    for entry in (*path.glob("*"), *path.glob("*/*")) if isinstance(path, Path) else ():
        # What is damaged in a folder that is a link would be deleted.
        if entry.is_symlink() and entry.is_dir() and entry.suffix != PART:
            raise StoreError(f"folders in one of results must be no links: delete {entry}")
    ours = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
    if not ours and any(entry.suffix != PART and entry.name != LOCK for entry in path.iterdir()):
        raise StoreError(
            f"results need an empty folder or one of earlier results: {path} holds other files"
        )


@contextmanager
def locked(path: Place) -> Iterator[None]:
    """Lock a folder, made if need be, against other processes; StoreError if it is locked."""
    # The lock ends with the process, also when it is killed. There is none at a URL: two runs that
    # write there store the same units, so that the last of each stays.
    if not isinstance(path, Path):
        yield
        return
    with write_errors(path):
        path.mkdir(parents=True, exist_ok=True)
        lock = _lock_of(path)
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


def _lock_of(path: Path) -> FileLock:
    """Return a folder's lock; OSError if it is a link, because opening that may empty a file."""
    if (path / LOCK).is_symlink():
        raise OSError(errno.ELOOP, f"its {LOCK} must be no link: delete it", str(path))
    return FileLock(path / LOCK)


def in_use(path: Place) -> bool | None:
    """Return whether a run holds a folder's lock; None if that is unknown, as at a URL."""
    if not isinstance(path, Path):
        return None
    if not (path / LOCK).exists():
        return False
    try:
        with _lock_of(path).acquire(timeout=0):
            return False
    except Timeout:
        return True
    except OSError:  # a folder that may only be read, or a link
        return None


@contextmanager
def read_errors(path: Place) -> Iterator[None]:
    """Turn a failure to read into a StoreError."""
    try:
        yield
    except OSError as error:
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
    except OSError as error:
        raise StoreError(
            f"results cannot be written to {path} ({reason(error)}): what was stored before is "
            "whole, and a run with --resume goes on from there"
        ) from error


@contextmanager
def lost_errors() -> Iterator[None]:
    """Turn a failure to read or write that worked before into a LostStoreError."""
    try:
        yield
    except StoreError as error:
        if isinstance(error.__cause__, OSError):
            raise LostStoreError(str(error)) from error.__cause__
        raise


# -- The arrays of a unit: by group, of some seeds, of several units as one; and its tables --------

RUN, VALUES, SNAPSHOTS = GROUPS = "run", "values", "snapshots"  # groups of arrays


class DecisionRow(NamedTuple):
    """Why a seed went on or ended at a checkpoint."""

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
OF_A_SEED = re.compile(r"(states|values)_(\d+)(/.*)?")  # an array of one seed, by its row
OF_UNITS = ("source_steps", "scale", "refusal", "initial_values")
"""Arrays by seed that a unit has beside those of its result: two if it was calibrated, another if Q
starts at a constant."""
LARGEST_DECISIONS = 2**26  # bytes of a unit's decisions at most: 300,000 of them


class UnitResult(NamedTuple):
    """The result of training a unit."""

    arrays: Arrays  # those of the `LearningResult` (`arrays_of`), and `OF_UNITS`
    decisions: Sequence[DecisionRow]  # by seed and checkpoint


def of_seeds(arrays: Arrays, seeds: Collection[int]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of some seeds; snapshots, of the first seed, stay if it is among them."""
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


def joined_units(parts: Sequence[UnitResult]) -> UnitResult:
    """Return the results of several units of a task as one result, seeds ascending."""
    # How the units were grouped does not change a byte.
    if len(parts) == 1:
        return parts[0]
    parts = sorted(parts, key=lambda part: part.arrays["seeds"][0])
    whole = joined_results([LearningResult.of_arrays(part.arrays) for part in parts])
    if whole.snapshots is not None and whole.snapshots.seed != whole.seeds[0]:
        whole = replace(whole, snapshots=None)
    arrays = arrays_of(whole)
    order = np.argsort(np.concatenate([part.arrays["seeds"] for part in parts]))
    for name in OF_UNITS:
        if name in parts[0].arrays:
            arrays[name] = np.concatenate([part.arrays[name] for part in parts])[order]
    decisions = chain.from_iterable(part.decisions for part in parts)
    return UnitResult(arrays, sorted(decisions, key=lambda row: row.seed))  # stable


def group_of(name: str) -> str:
    """Return the group of an array by its name: run, values, snapshots, ..."""
    if name.startswith("snapshot_"):
        return SNAPSHOTS
    return VALUES if re.match(r"values|states", name) else RUN


# -- The file of a unit: a sealed archive of its arrays that says what it is of --------------------

NamedArrays = dict[str, npt.NDArray[Any]]  # arrays by name
ABOUT, DECISIONS = "unit.json", "decisions.json"  # members of the archive beside its arrays
ENDING = ".npz"
LARGEST_ABOUT = 2**24  # bytes of unit.json at most: one of 100,000 seeds has a twentieth of that
LONGEST_NAME, KEPT = 200, 40  # characters of a unit's name, and those that are kept of a longer one


def unit_content(about: UnitRecord, result: UnitResult) -> bytes:
    """Return the content of a unit's file; equal results have equal bytes."""
    ordered = dict(sorted(result.arrays.items(), key=lambda item: GROUPS.index(group_of(item[0]))))
    decisions = json.dumps(result.decisions).encode()
    further_files = {DECISIONS: decisions, ABOUT: as_json(plain(about))}
    return archive_content(ordered, further_files, _snapshots_of(ordered))


def _snapshots_of(names: Iterable[str]) -> list[str]:
    return [name for name in names if group_of(name) == SNAPSHOTS]


def about_in(archive: ArrayArchive) -> UnitRecord:
    """Return the record of the unit in a file; ValueError if there is none."""
    return read_record(UnitRecord, parsed_json(archive.content(ABOUT, LARGEST_ABOUT)))


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

ROW_BYTES = 600  # of a decision in memory, about
MOST_KEPT = 2**28
"""Bytes of curves and decisions that are kept in memory: so a run, a table and a report read each
file once for them."""
SCHEMA_VERSION = 4  # of the folder's layout; a folder of another version is refused
LARGEST_JSON = 2**24
"""Bytes of a JSON file at most: in memory they are up to 25 times as many. A study of 100,000 seeds
has a twentieth."""
Result = TypeVar("Result")
Record = TypeVar("Record", bound=Plain)


@dataclass(frozen=True)
class StoredUnit:
    """A unit in the store: its file, and the key and seeds in the file's path."""

    path: Place
    key: str
    seeds: tuple[int, ...]

    @classmethod
    def at(cls, path: Place) -> "StoredUnit":
        """Return the unit of a file; StoreError if its name is shortened and it cannot be read."""
        seeds = tuple(seeds_in_ranges(path.stem.removeprefix("seeds-").replace("+", ",")))
        unit = cls(path, path.parent.name.rpartition("-")[2], seeds)
        if not seeds:
            with unit.opened() as archive:
                unit = replace(unit, seeds=about_in(archive).seeds)
        return unit

    @contextmanager
    def opened(self, *, whole: bool = False) -> Iterator[ArrayArchive]:
        """Yield its file, open to read a part or the `whole`; StoreError if it is damaged."""
        try:
            with read_errors(self.path), opened_archive(self.path, whole=whole) as archive:
                if whole:
                    self._check_place(about_in(archive))
                yield archive
        except Damaged:
            raise damage(self.path) from None
        except ValueError as error:
            raise StoreError(f"{self.path} is not as Curricle writes it: {error}") from None

    @cached_property
    def about(self) -> UnitRecord:
        """The record in its file; StoreError if that is damaged or of another unit."""
        with self.opened() as archive:
            about = about_in(archive)
            self._check_place(about)
        return about

    def _check_place(self, about: UnitRecord) -> None:
        place = place_of(about.key, about.task, seed_ranges(about.seeds))
        if place != f"{self.path.parent.name}/{self.path.name}":
            raise Damaged

    def arrays(self, *groups: str, most: int | None = None) -> NamedArrays:
        """Return the unit's arrays of some groups, such as ``run``, without pickles."""
        with self.opened() as archive:
            arrays = groups_in(archive, groups, most)
        return arrays

    def result(self, seeds: Collection[int], most: int | None = None) -> UnitResult:
        """Return the result of some of its seeds; StoreError if the file is damaged."""
        with self.opened(whole=True) as archive:
            arrays = groups_in(archive, GROUPS, most)
            decisions = decisions_in(archive)
        return UnitResult(of_seeds(arrays, seeds), [row for row in decisions if row.seed in seeds])


def written_unit(folder: Place, unit: Unit | UnitRecord, result: UnitResult) -> StoredUnit:
    """Write the result of a unit's seeds in one move, and return the stored unit."""
    seeds = tuple(result.arrays["seeds"].tolist())
    about = UnitRecord(
        key=unit.key, dependencies=dict(unit.dependencies), task=unit.task, seeds=seeds
    )
    path = folder / UNITS / place_of(unit.key, unit.task, seed_ranges(seeds))
    _write(folder, path, unit_content(about, result))
    return StoredUnit(path, unit.key, seeds)


def _write(folder: Place, path: Any, content: bytes) -> None:
    """Write a file in a folder in one move; StoreError if that fails, and the old file stays."""
    with write_errors(folder):
        if isinstance(folder, Path):
            (folder / STUDY).stat()  # or a folder that was moved would be made again
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)


def damage(file: Place) -> StoreError:
    """Return the error about a damaged file."""
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

    Every file is moved to its place when it is complete and on disk, so that a killed run leaves
    whole files only. At a URL nothing is moved: checksums tell what is whole. StoreError where the
    path or URL holds no results, or those of another version.

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

    def __init__(self, path: str | Place, description: dict[str, Any] | None = None):
        self.path = place_at(path)
        self._curves, self._decisions = dict[Place, NamedArrays](), dict[Place, list[DecisionRow]]()
        self._room = MOST_KEPT
        if description is not None:  # it has just been written
            self.description = description
            return
        self.require_there()
        self.description = self._unsealed(STUDY)
        version = self.description.pop("schema_version", None)
        if version != SCHEMA_VERSION:
            there = "no schema version" if version is None else f"schema version {version}"
            raise StoreError(
                f"{self.path / STUDY} has {there} and this Curricle reads {SCHEMA_VERSION}: run "
                "the study again into a new folder, or read it with the version that wrote it"
            )

    def require_there(self) -> None:
        """Raise StoreError unless the folder holds a study."""
        with read_errors(self.path):
            if not (self.path / STUDY).exists():
                lacks = f"{self.path} has none"
                if isinstance(self.path, RemotePath) and not self.path.bucket.exists():
                    lacks = f"there is no {self.path.bucket}"
                gone = FileNotFoundError(errno.ENOENT, "it is not there", str(self.path / STUDY))
                raise StoreError(f"a folder of results holds a {STUDY}: {lacks}") from gone

    def __repr__(self) -> str:
        return f"StudyStore({str(self.path)!r})"

    @classmethod
    @contextmanager
    def opened(
        cls, path: str | Place, description: Mapping[str, Any], *, resume: bool, check: bool = True
    ) -> Iterator["StudyStore"]:
        """Open a folder for results, made if need be, and lock it against other processes.

        Results depend on the `description`. With `resume` the folder may already hold units.
        StoreError when it is in use or holds other files; and, with `check` or if units do not
        record their dependencies, when its results have another description.
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
                there, here = (
                    described["configuration"] for described in (store.description, description)
                )
                if there.get("snapshots") != here["snapshots"] and store.units():
                    raise StoreError(
                        f"snapshots are kept while a unit is trained: {path} holds units with "
                        f"snapshots = {there.get('snapshots')}, and it is {here['snapshots']} "
                        "here; set it back, or choose another folder"
                    )
                here["seeds"] = sorted({*there["seeds"], *here["seeds"]})
                description["record"]["seeds"] = here["seeds"]
        with write_errors(path):
            if isinstance(path, Path):
                for part in [*path.rglob(f".*{PART}")]:  # a killed run left it, incomplete
                    part.unlink(missing_ok=True)
            write_whole(path / STUDY, sealed({"schema_version": SCHEMA_VERSION, **description}))
        return cls(path, description)

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

    def has(self, name: str) -> bool:
        """Return whether a file exists, and so is complete."""
        with read_errors(self.path / name):
            return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> None:
        """Write a file in one move; StoreError if that fails, and the old file stays."""
        _write(self.path, self.path / name, content)

    def remove(self, files: Iterable[Place]) -> None:
        """Delete some files."""
        with write_errors(self.path):
            for file in files:
                file.unlink(missing_ok=True)

    def write_json(self, name: str, content: Any) -> None:
        """Write a value as indented JSON."""
        self.write(name, as_json(content))

    def read_json(self, name: str) -> Any:
        """Return the value of a JSON file; StoreError if it is damaged."""
        return self.checked(name, lambda: parsed_json(self._bytes(name)))

    def write_record(self, name: str, record: Plain) -> None:
        """Write a record with its own checksum."""
        self.write(name, sealed(plain(record)))

    def record(self, name: str, model: type[Record]) -> Record:
        """Return the record that :meth:`write_record` wrote; StoreError if it is damaged."""
        content = self._unsealed(name)
        return self.checked(name, lambda: read_record(model, content))

    def _unsealed(self, name: str) -> dict[str, Any]:
        if (content := unsealed(self._bytes(name))) is None:
            raise damage(self.path / name)
        return content

    def _bytes(self, name: str) -> bytes:
        with read_errors(self.path / name):
            return read_bounded(self.path / name, LARGEST_JSON)

    def write_records(self, name: str, records: Iterable[Plain]) -> None:
        """Write a list of records as JSON."""
        self.write_json(name, [plain(record) for record in records])

    def records(self, name: str, model: type[Record]) -> list[Record]:
        """Return the records that :meth:`write_records` wrote; none if it was never called."""
        content = self.read_json(name) if self.has(name) else []
        rows = content if isinstance(content, list) else [content]
        return self.checked(name, lambda: [read_record(model, row) for row in rows])

    def checked(self, name: str | Place, read: Callable[[], Result]) -> Result:
        """Return what `read` returns of a file; its ValueError becomes a StoreError with path."""
        try:
            return read()
        except ValueError as error:
            file = self.path / name if isinstance(name, str) else name
            raise StoreError(
                f"{file} is not as Curricle writes it: {error}; delete it and run the study again "
                "with --resume"
            ) from None

    def units(self) -> list[StoredUnit]:
        """Return the units in the store, by path."""
        with read_errors(self.path):
            files: list[Any] = [*self.path.glob(f"{UNITS}/*/*{ENDING}")]
        return [StoredUnit.at(path) for path in sorted(files)]

    def finished(self, without: Collection[Place] = ()) -> dict[str, dict[int, StoredUnit]]:
        """Return the unit that holds each seed, as key -> seed -> unit, `without` some files."""
        finished: dict[str, dict[int, StoredUnit]] = {}
        for stored in self.units():
            if stored.path not in without:
                finished.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
        return finished

    def damaged_units(self) -> list[Place]:
        """Return the files of damaged units; it reads all files, and caches their curves."""
        return [stored.path for stored in self.units() if not self.is_whole(stored)]

    def is_whole(self, stored: StoredUnit) -> bool:
        """Return whether a unit is as it was stored; StoreError where it cannot be read."""
        try:
            with stored.opened(whole=True) as archive, suppress(ValueError):
                # Whoever needs what is wrong there says so.
                self._keep_curves(stored, groups_in(archive, (RUN,)))
                self._keep_decisions(stored, decisions_in(archive))
        except StoreError as error:
            if error.__cause__ is None:
                return False
            raise  # a file system that does not answer damages nothing: what is damaged is deleted
        return True

    def write_unit(self, unit: Unit | UnitRecord, result: UnitResult) -> StoredUnit:
        """Store the result of a unit in one move, and return the stored unit."""
        stored = written_unit(self.path, unit, result)
        self._curves.pop(stored.path, None)
        self._decisions.pop(stored.path, None)
        remove_folder(self.checkpoints(unit))
        return stored

    def checkpoints(self, unit: Unit | UnitRecord) -> Place:
        """Return the folder for checkpoints of a unit's training until it is stored."""
        place = place_of(unit.key, "", seed_ranges(unit.seeds)).removesuffix(ENDING)
        root = self.path.resolve() if isinstance(self.path, Path) else self.path
        return root / CHECKPOINTS / place

    def remove_checkpoints(self) -> None:
        """Remove the checkpoints of all units."""
        remove_folder(self.path / CHECKPOINTS)

    def arrays(self, stored: StoredUnit, *groups: str, most: int | None = None) -> NamedArrays:
        """Return the arrays of some groups, such as ``run``, of a unit, without pickles."""
        if groups != (RUN,):
            return stored.arrays(*groups, most=most)
        if stored.path not in self._curves:
            return self._keep_curves(stored, stored.arrays(RUN, most=most))
        return self._curves[stored.path]

    def decisions(self, stored: StoredUnit) -> Sequence[DecisionRow]:
        """Return a unit's decisions."""
        if stored.path not in self._decisions:
            with stored.opened() as archive:
                return self._keep_decisions(stored, decisions_in(archive))
        return self._decisions[stored.path]

    def _keep_curves(self, stored: StoredUnit, curves: NamedArrays) -> NamedArrays:
        """Keep a unit's curves where there is room for them; return them."""
        size = sum(array.nbytes for array in curves.values())
        if size <= self._room:
            self._room -= size
            self._curves[stored.path] = curves
        return curves

    def _keep_decisions(self, stored: StoredUnit, rows: list[DecisionRow]) -> list[DecisionRow]:
        """Keep a unit's decisions where there is room for them; return them."""
        if (size := ROW_BYTES * len(rows)) <= self._room:
            self._room -= size
            self._decisions[stored.path] = rows
        return rows


# -- What seeds learnt in a task, read from a store for the tasks that it is a source of -----------


class StoredSource(NamedTuple):
    """The stored results of a source that a unit reads."""

    units: Mapping[int, StoredUnit]  # by seed
    read: bool  # whether its values are needed


def stored_values(
    arrays_of: Callable[..., Mapping[str, Any]],
    done: Mapping[int, StoredUnit],
    seeds: Sequence[int],
    *,
    read: bool,
) -> StoredValues:
    """Return the results of seeds in a task; with values only if they are to be `read`."""
    groups = (RUN, VALUES) if read else (RUN,)
    files = dict.fromkeys(done[seed] for seed in seeds)
    arrays = {file.path: arrays_of(file, *groups) for file in files}
    rows = [(arrays[done[seed].path], done[seed].seeds.index(seed)) for seed in seeds]
    values: Any = [values_of(held, k) for held, k in rows]
    if any(of_seed is None for of_seed in values):
        values = None  # not needed, or not saved: training raises an error then
    elif isinstance(values[0], np.ndarray):
        values = np.stack(values)
    steps = np.array([held["steps_used"][k] for held, k in rows])
    scales = [float(held["scale"][k]) for held, k in rows if "scale" in held]
    return StoredValues(values, steps, scales)


# -- Small units of a task in one file -------------------------------------------------------------
#
# A unit of some kilobytes costs more to store and to read than to train. So those that end within a
# second are written together, and after a run each block of seeds is one file, whenever its units
# ended.

FULL = 2**22  # bytes of a file of several units, about: it is read in some milliseconds
NUMBER, TABLES, CURVES = 8, 2, 5  # bytes of a number; numbers a pair (S x A) and a checkpoint
BETWEEN = 1.0  # seconds between two writes of small units: as much as a killed run repeats
MOST_FILES = 32  # of a block of seeds until they are merged during a run
REMEMBERED = 8  # files of several units whose arrays are kept: more seeds are asked for next

Block = tuple[str, int]  # a unit's key, and the number of its block of seeds
Taken = tuple[Unit, UnitResult | StoredUnit]  # or its worker's file


def seeds_per_file(node: Node) -> int:
    """Return how many seeds of a task a file holds; 1 for networks and large tables."""
    return 1 if node.deep else max(1, FULL // bytes_a_seed(node))


def bytes_a_seed(node: Node) -> int:
    """Return the most bytes of a seed's tables and curves."""
    model = generative_model(node.task)
    tables = TABLES * model.states.size * model.actions.size
    checkpoints = node.most_steps // node.eval_freq + 1
    return NUMBER * (tables + CURVES * checkpoints)


def files_of(record: CurriculaRecord) -> dict[str, int]:
    """Return how many seeds a file of each key of a study holds."""
    nodes = (node for arm in record.arms.values() for node in arm.nodes.values())
    return {node.key: node.seeds_per_file for node in nodes}


class Packing:
    """The units of a run on their way into files."""

    def __init__(
        self, store: StudyStore, done: dict[str, dict[int, StoredUnit]], per_file: Mapping[str, int]
    ):
        self.store, self.done, self.per_file = store, done, per_file
        self._waiting = dict[Block, list[tuple[Unit, UnitResult]]]()
        self._receipts = list[tuple[Unit, StoredUnit]]()
        self._files = dict[Block, list[StoredUnit]]()  # those that this run has written
        self._large = False
        self._written = -BETWEEN
        self._remembered = lru_cache(REMEMBERED)(store.arrays)

    def arrays(self, stored: StoredUnit, *groups: str) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of some groups of a file, as :meth:`StudyStore.arrays`."""
        large = self.is_large(stored.key, stored.seeds)
        return (self.store.arrays if large else self._remembered)(stored, *groups)

    def is_large(self, key: str, seeds: Sequence[int]) -> bool:
        """Return whether a unit with so many seeds has a file for itself."""
        return self.per_file[key] <= len(seeds)

    def add(self, unit: Unit, result: UnitResult | StoredUnit) -> None:
        """Add a trained unit; StoreError if its worker wrote it to another place."""
        if isinstance(result, UnitResult):
            self._waiting.setdefault(_block(unit, self.per_file), []).append((unit, result))
        else:
            with read_errors(result.path):
                if not result.path.exists():
                    raise StoreError(
                        f"workers must write to the place of the run: {result.path} is not there"
                    )
            self._receipts.append((unit, result))
        self._large |= self.is_large(unit.key, unit.seeds)

    @property
    def seconds(self) -> float:
        """The seconds that added units may still wait; 0 for units with large tables."""
        left = 0.0 if self._large else self._written + BETWEEN - monotonic()
        return max(0.0, left)

    def write(self) -> list[Taken]:
        """Write the added units, and return them."""
        if not self:
            return []
        waiting, self._waiting, self._large = self._waiting, {}, False
        receipts, self._receipts = self._receipts, []
        for unit, stored in receipts:
            self.done.setdefault(unit.key, {}).update(dict.fromkeys(unit.seeds, stored))
        for block, taken in waiting.items():
            unit = taken[0][0]
            result = joined_units([result for _, result in taken])
            files = self._files.setdefault(block, [])
            files.append(self.store.write_unit(unit, result))
            if len(files) > MOST_FILES:
                files[:] = [merged_files(self.store, files)]
            self.done.setdefault(block[0], {}).update(dict.fromkeys(files[-1].seeds, files[-1]))
        self._written = monotonic()
        return [*receipts, *chain.from_iterable(waiting.values())]

    def __bool__(self) -> bool:
        return bool(self._waiting or self._receipts)


def pack(store: StudyStore, per_file: Mapping[str, int]) -> None:
    """Merge the files of each block of seeds in a folder into one; `per_file` is as `files_of`."""
    blocks = dict[Block, list[StoredUnit]]()
    for file in store.units():
        if file.key in per_file:
            blocks.setdefault(_block(file, per_file), []).append(file)
    for files in blocks.values():
        if len(files) > 1:
            merged_files(store, files)


def merged_files(store: StudyStore, files: Sequence[StoredUnit]) -> StoredUnit:
    """Write the units of some files of a block as one, delete the others and return it."""
    # A seed that several have, as after a run that was killed here, is taken once.
    parts, taken = list[UnitResult](), set[int]()
    for file in files:
        if new := set(file.seeds) - taken:
            parts.append(file.result(new))
            taken |= new
    merged = store.write_unit(files[0].about, joined_units(parts))
    store.remove(file.path for file in files if file.path != merged.path)
    return merged


def _block(unit: Any, per_file: Mapping[str, int]) -> Block:
    return unit.key, min(unit.seeds) // per_file[unit.key]
