"""The results store: a folder of complete files, and the settings on which results depend."""

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
from curricle.curriculum.result import SourceValues
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
    results_folder,
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

# -- The differences of two descriptions, by which their results may differ ------------------------

MAY_CHANGE = (
    "name",
    "seeds",
    "seeds_per_unit",
    "threshold",
    "window",
)  # no result depends on these


def differences(first: Any, second: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys in which two descriptions differ, with both values; results may differ too."""
    if isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        first, second = dict(enumerate(first)), dict(enumerate(second))
    if not (isinstance(first, dict) and isinstance(second, dict)):
        if first != second:
            yield name, (first, second)
        return
    for key in sorted({*first, *second}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        # The record is computed from the configuration and the user's functions.
        if not (name == "configuration" and key in MAY_CHANGE) and place != "record":
            yield from differences(first.get(key), second.get(key), place)


def shown(value: Any) -> str:
    """Return a value as text for a sentence, shortened if it is long."""
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."


# -- Folders of results: their files, their locks, and errors of reading and writing ---------------

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
ANALYSIS = "analysis.json"
UNITS = "units"
PATIENCE = 0.3  # seconds to wait for a lock: a process that tests it holds it for a moment
CHECKPOINTS = ".checkpoints"  # folder where networks are saved during training, to resume it


def check_ours(path: Place, resume: bool) -> None:
    """Raise StoreError if a path is a file, or a folder that holds other things than results."""
    if path.exists() and not path.is_dir():
        raise StoreError(f"results need a folder: {path} is a file")
    for entry in (*path.glob("*"), *path.glob("*/*")) if isinstance(path, Path) else ():
        # Damaged files are deleted, and a linked folder may hold files of other programs.
        if entry.is_symlink() and entry.is_dir() and entry.suffix != PART:
            raise StoreError(f"folders in one of results must be no links: delete {entry}")
    ours = (path / STUDY).exists() or not path.exists() or (resume and (path / UNITS).is_dir())
    if not ours and any(entry.suffix != PART and entry.name != LOCK for entry in path.iterdir()):
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
    """Return a folder's lock; OSError if it is a link, because opening a link may empty a file."""
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
    except OSError:  # the folder is read-only, or its lock is a link
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
    """Turn a failure to read or write during a run into a LostStoreError."""
    try:
        yield
    except StoreError as error:
        if isinstance(error.__cause__, OSError):
            raise LostStoreError(str(error)) from error.__cause__
        raise


# -- The arrays and decisions of a unit: groups of arrays, selected seeds, joined units ------------

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
OF_UNITS = ("source_steps", "scale", "refusal", "initial_values")
"""Arrays by seed that a unit has besides its result's: two if it was calibrated, another if Q
starts at a constant."""
LARGEST_DECISIONS = 2**26  # most bytes of a unit's decisions: 300,000 decisions


class UnitResult(NamedTuple):
    """The result of training a unit."""

    arrays: Arrays  # arrays of the `LearningResult` (`arrays_of`), and of `OF_UNITS`
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


def joined_units(parts: Sequence[UnitResult]) -> UnitResult:
    """Return the results of several units of a task as one result, seeds ascending."""
    # The result does not depend, to the byte, on how seeds were divided into units.
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
    return UnitResult(arrays, sorted(decisions, key=lambda row: row.seed))  # a stable sort


def group_of(name: str) -> str:
    """Return the group of an array by its name: run, values, snapshots, ..."""
    if name.startswith("snapshot_"):
        return SNAPSHOTS
    return VALUES if re.match(r"values|states", name) else RUN


# -- The file of a unit: a sealed archive of its arrays and its record -----------------------------

NamedArrays = dict[str, npt.NDArray[Any]]  # arrays by name
ABOUT, DECISIONS = "unit.json", "decisions.json"  # members of the archive besides the arrays
ENDING = ".npz"
LARGEST_ABOUT = 2**24  # most bytes of unit.json: 100,000 seeds take a twentieth of that
LONGEST_NAME, KEPT = 200, 40  # most characters of a unit's name; characters kept of longer names


def unit_content(about: UnitRecord, result: UnitResult) -> bytes:
    """Return the content of a unit's file, which has equal bytes for equal results."""
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

ROW_BYTES = 600  # about the bytes of a decision in memory
MOST_KEPT = 2**28
"""Bytes of curves and decisions to keep in memory, so that a run, its tables and a report read each
file once."""
SCHEMA_VERSION = 5  # version of the folder's layout; other versions are refused
LARGEST_JSON = 2**24
"""Most bytes of a JSON file, which takes up to 25 times as many in memory. The file of a study with
100,000 seeds has a twentieth of that."""
Result = TypeVar("Result")
Record = TypeVar("Record", bound=Plain)


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
            with unit.opened() as archive:
                unit = replace(unit, seeds=about_in(archive).seeds)
        return unit

    @contextmanager
    def opened(self, *, whole: bool = False) -> Iterator[ArrayArchive]:
        """Yield the unit's file, open to read parts or the `whole`; StoreError if damaged."""
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
        """The record in the unit's file; StoreError if it is damaged or another unit's."""
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
        """Return the result of some of the unit's seeds; StoreError if the file is damaged."""
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
    """Write a file in a folder in one move; if that fails, the old file stays (StoreError)."""
    with write_errors(folder):
        if isinstance(folder, Path):
            (folder / STUDY).stat()  # raises if the folder was moved, instead of creating it again
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

    A file is moved to its place when it is complete and on disk, so that a killed run leaves only
    whole files. At a URL files are not moved: checksums tell whether they are whole. StoreError
    where the path or URL holds no results, or results of another version.

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
        self._kept, self._room = dict[tuple[Place, str], Any](), MOST_KEPT
        if description is not None:  # the folder has just been opened with it
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
                if isinstance(self.path, Path) and self.path.suffix == ".toml":
                    lacks += f"; the results of a study's file are in {results_folder(self.path)}"
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
        """Open a folder for results, created if missing, and lock it against other processes.

        Results depend on the `description`. With `resume` the folder may already hold units.
        StoreError when the folder is in use or holds other files; with `check`, or if units do not
        record their dependencies, also when its results have another description.
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
                if store.units():
                    here["seeds"] = sorted({*there["seeds"], *here["seeds"]})
                    description["record"]["seeds"] = here["seeds"]
                tuning = here.get("tuned") or here.get("tune") or {}
                if both := sorted({*tuning.get("seeds", ())} & {*here["seeds"]}):
                    raise StoreError(
                        f"seeds of tuning must be none of the study's: {both[0]} is one of "
                        f"those in {path}; change tune.seeds, or choose another folder"
                    )
                if store.description["record"]["arms"] != description["record"]["arms"]:
                    store.remove([path / ANALYSIS])  # of other arms
        with write_errors(path):
            if isinstance(path, Path):
                for part in [*path.rglob(f".*{PART}")]:  # incomplete files of a killed run
                    part.unlink(missing_ok=True)
            write_whole(path / STUDY, sealed({"schema_version": SCHEMA_VERSION, **description}))
        return cls(path, description)

    def redescribed(self, description: Mapping[str, Any]) -> "StudyStore":
        """Return this opened folder with another description of the same study."""
        return self._claimed(self.path, json.loads(json.dumps(description)), True, False)

    def check(self, description: Mapping[str, Any]) -> None:
        """Raise StoreError if results of another description may differ from the stored results."""
        for name, (there, here) in differences(self.description, description):
            raise StoreError(
                f"{self.path} holds results of other settings: {name} is {shown(there)} there and "
                f"{shown(here)} here; choose another folder"
            )

    def has(self, name: str) -> bool:
        """Return whether a file exists; existing files are complete."""
        with read_errors(self.path / name):
            return (self.path / name).exists()

    def write(self, name: str, content: bytes) -> None:
        """Write a file in one move; if that fails, the old file stays (StoreError)."""
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
        """Write a record with a checksum."""
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
        """Return the result of `read`; its ValueError becomes a StoreError that names the file."""
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
        """Return key -> seed -> unit for all units except those in the files `without`."""
        finished: dict[str, dict[int, StoredUnit]] = {}
        for stored in self.units():
            if stored.path not in without:
                finished.setdefault(stored.key, {}).update(dict.fromkeys(stored.seeds, stored))
        return finished

    def damaged_units(self) -> list[Place]:
        """Return the files of damaged units; reads all files, and caches their curves."""
        return [stored.path for stored in self.units() if not self.is_whole(stored)]

    def is_whole(self, stored: StoredUnit) -> bool:
        """Return whether a unit's file is undamaged; StoreError if it cannot be read."""
        try:
            with stored.opened(whole=True) as archive, suppress(ValueError):
                # Malformed curves or decisions raise an error when they are needed.
                self._keep(stored, RUN, groups_in(archive, (RUN,)))
                self._keep(stored, DECISIONS, decisions_in(archive))
        except StoreError as error:
            if error.__cause__ is None:
                return False
            raise  # a file that cannot be read now is not damaged, and must not be deleted
        return True

    def write_unit(self, unit: Unit | UnitRecord, result: UnitResult) -> StoredUnit:
        """Store the result of a unit in one move, and return the stored unit."""
        stored = written_unit(self.path, unit, result)
        for part in (RUN, DECISIONS):
            self._kept.pop((stored.path, part), None)
        remove_folder(self.checkpoints(unit))
        return stored

    def checkpoints(self, unit: Unit | UnitRecord) -> Place:
        """Return the folder for checkpoints of a unit's training, used until the unit is stored."""
        place = place_of(unit.key, "", seed_ranges(unit.seeds)).removesuffix(ENDING)
        root = self.path.resolve() if isinstance(self.path, Path) else self.path
        return root / CHECKPOINTS / place

    def remove_checkpoints(self) -> None:
        """Remove the checkpoints of all units."""
        remove_folder(self.path / CHECKPOINTS)

    def arrays(self, stored: StoredUnit, *groups: str, most: int | None = None) -> NamedArrays:
        """Return the arrays of some groups, such as ``run``, of a unit, without pickles."""
        if groups == (RUN,) and (stored.path, RUN) in self._kept:
            curves: NamedArrays = self._kept[stored.path, RUN]
            return curves
        arrays = stored.arrays(*groups, most=most)
        return self._keep(stored, RUN, arrays) if groups == (RUN,) else arrays

    def decisions(self, stored: StoredUnit) -> Sequence[DecisionRow]:
        """Return a unit's decisions."""
        if (stored.path, DECISIONS) not in self._kept:
            with stored.opened() as archive:
                return self._keep(stored, DECISIONS, decisions_in(archive))
        rows: list[DecisionRow] = self._kept[stored.path, DECISIONS]
        return rows

    def _keep(self, stored: StoredUnit, part: str, content: Result) -> Result:
        """Return a unit's curves or decisions; keep them in memory if there is room."""
        parts: Any = content
        size = sum(x.nbytes for x in parts.values()) if part == RUN else ROW_BYTES * len(parts)
        if size <= self._room:
            self._room -= size
            self._kept[stored.path, part] = content
        return content


# -- The stored results of a source, for the tasks that build on it --------------------------------


def stored_values(
    arrays_of: Callable[..., Mapping[str, Any]],
    done: Mapping[int, StoredUnit],
    seeds: Sequence[int],
    *,
    read: bool,
) -> SourceValues:
    """Return the values of seeds in a task, which is left out; None for values unless `read`."""
    groups = (RUN, VALUES) if read else (RUN,)
    files = dict.fromkeys(done[seed] for seed in seeds)
    arrays = {file.path: arrays_of(file, *groups) for file in files}
    rows = [(arrays[done[seed].path], done[seed].seeds.index(seed)) for seed in seeds]
    values: Any = [values_of(held, k) for held, k in rows]
    if any(of_seed is None for of_seed in values):
        values = None  # not needed; or not saved, for which training raises an error
    elif isinstance(values[0], np.ndarray):
        values = np.stack(values)
    steps = np.array([held["steps_used"][k] for held, k in rows])
    scales = [float(held["scale"][k]) for held, k in rows if "scale" in held]
    return SourceValues(None, tuple(seeds), values, steps, scales=scales)


# -- Small units of a task in one file -------------------------------------------------------------
#
# A unit of some kilobytes takes longer to store and to read than to train. So small units that end
# within a second are written into one file, and after a run all units of a block of seeds are
# merged into one file.

FULL = 2**22  # about the bytes of a file of several units, read in some milliseconds
NUMBER, TABLES, CURVES = 8, 2, 5  # bytes of a number; numbers a pair (S x A); numbers a checkpoint
BETWEEN = 1.0  # seconds between two writes of small units, which a killed run loses
MOST_FILES = 32  # most files of a block of seeds; more are merged during the run
REMEMBERED = 8  # files of several units whose arrays stay in memory, for their next seeds

Block = tuple[str, int]  # a unit's key, and the number of its block of seeds
Taken = tuple[Unit, UnitResult | StoredUnit]  # a result, or the file that a worker wrote


def seeds_per_file(node: Node) -> int:
    """Return how many seeds of a task a file holds; 1 for networks and large tables."""
    if node.deep:
        return 1
    model = generative_model(node.task)
    tables = TABLES * model.states.size * model.actions.size
    checkpoints = node.most_steps // node.eval_freq + 1
    return max(1, FULL // (NUMBER * (tables + CURVES * checkpoints)))  # most bytes of a seed


def files_of(record: CurriculaRecord) -> dict[str, int]:
    """Return key -> the number of seeds in a file, for all keys of a study."""
    nodes = (node for arm in record.arms.values() for node in arm.nodes.values())
    return {node.key: node.seeds_per_file for node in nodes}


class Packing:
    """Collects the trained units of a run and writes them into files."""

    def __init__(
        self, store: StudyStore, done: dict[str, dict[int, StoredUnit]], per_file: Mapping[str, int]
    ):
        self.store, self.done, self.per_file = store, done, per_file
        self._waiting = dict[Block, list[tuple[Unit, UnitResult]]]()
        self._receipts = list[tuple[Unit, StoredUnit]]()
        self._files = dict[Block, list[StoredUnit]]()  # files that this run has written
        self._large = False
        self._written = -BETWEEN
        self._remembered = lru_cache(REMEMBERED)(store.arrays)

    def arrays(self, stored: StoredUnit, *groups: str) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of some groups of a file, like :meth:`StudyStore.arrays`."""
        large = self.is_large(stored.key, stored.seeds)
        return (self.store.arrays if large else self._remembered)(stored, *groups)

    def is_large(self, key: str, seeds: Sequence[int]) -> bool:
        """Return whether a unit with these seeds fills a file alone."""
        return self.per_file[key] <= len(seeds)

    def add(self, unit: Unit, result: UnitResult | StoredUnit) -> None:
        """Add a trained unit; StoreError if its worker wrote the result to another place."""
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
        """The seconds that added units may still wait for a write; 0 if one of them is large."""
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
    """Merge the files of each block of seeds into one file; `files_of` returns `per_file`."""
    blocks = dict[Block, list[StoredUnit]]()
    for file in store.units():
        if file.key in per_file:
            blocks.setdefault(_block(file, per_file), []).append(file)
    for files in blocks.values():
        if len(files) > 1:
            merged_files(store, files)


def merged_files(store: StudyStore, files: Sequence[StoredUnit]) -> StoredUnit:
    """Merge files of a block into one file, delete the files merged, and return the new unit."""
    # Several files may hold a seed, if a run was killed here; the seed is taken once.
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
