"""The results store: a folder with a description of what its results depend on, and whole files."""

import errno
import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from filelock import FileLock, Timeout

from curricle.curriculum.result import StoredValues
from curricle.errors import (
    CurricleError,
    EngineError,
    LostStoreError,
    StoreError,
    StudyError,
    in_words,
    reason,
)
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
from curricle.learning.saved_result import checkpoints_of, values_of
from curricle.statistics.curves import SCRATCH
from curricle.study.dependencies import differences, shown
from curricle.study.record import Plain, RunRecord, UnitRecord, plain, read_record
from curricle.study.serialization import (
    DECISION_SCHEMA,
    GROUPS,
    RUN,
    SNAPSHOTS,
    VALUES,
    UnitResult,
    as_parquet,
    group_of,
    of_seeds,
    read_parquet,
)
from curricle.study.units import Unit, seed_ranges, seeds_in
from curricle.text import counted

# -- Folders of results: what they are called, which ones may be written to, and errors of writing

STUDY, RUNS, LOCK = "study.json", "runs.json", ".lock"
UNITS = "units"
PATIENCE = 0.3
"""Seconds in which a lock is asked for: whoever looks whether it is held has it for a moment."""
CHECKPOINTS = ".checkpoints"
"""Where networks in training are saved, to go on from."""


def check_ours(path: Place, resume: bool) -> None:
    """Raise StoreError if a path is a file, or a folder that holds other things than results.

    A folder in it that is a link is refused: what is damaged there would be deleted.
    """
    if path.exists() and not path.is_dir():
        raise StoreError(f"results need a folder: {path} is a file")
    for one in (*path.glob("*"), *path.glob("*/*")) if isinstance(path, Path) else ():
        if one.is_symlink() and one.is_dir() and one.suffix != PART:
            raise StoreError(f"folders in one of results must be no links: delete {one}")
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
    """Return a folder's lock; OSError where a link is in its place: to open it may empty a file."""
    if (path / LOCK).is_symlink():
        raise OSError(errno.ELOOP, f"its {LOCK} must be no link: delete it", str(path))
    return FileLock(path / LOCK)


def in_use(path: Place) -> bool | None:
    """Return whether a run holds a folder's lock; None where that cannot be told, as at a URL."""
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


# -- The file of a unit: a sealed archive of its arrays that says what it is of --------------------

NamedArrays = dict[str, npt.NDArray[Any]]
"""Arrays by name."""
ABOUT, DECISIONS = "unit.json", "decisions.parquet"
"""Members of the archive beside its arrays."""
ENDING = ".npz"
LARGEST_ABOUT = 2**24
"""Bytes of ``unit.json`` at most: one of 100,000 seeds has a twentieth of that."""
LONGEST_NAME, KEPT = 200, 40
"""Characters of a unit's name, and those that are kept of a longer one."""


def unit_content(about: UnitRecord, result: UnitResult) -> bytes:
    """Return the content of a unit's file; equal results have equal bytes.

    Snapshots are compressed, other arrays are not.
    """
    each = result.arrays.items()
    ordered = {name: one for group in GROUPS for name, one in each if group_of(name) == group}
    others = {
        DECISIONS: as_parquet(result.decisions.combine_chunks()),
        ABOUT: as_json(plain(about)),
    }
    return archive_content(ordered, others, _snapshots_of(ordered))


def _snapshots_of(names: Iterable[str]) -> list[str]:
    return [name for name in names if group_of(name) == SNAPSHOTS]


def about_in(archive: ArrayArchive) -> UnitRecord:
    """Return what the unit of a file is; ValueError if the file does not say."""
    return read_record(UnitRecord, parsed_json(archive.content(ABOUT, LARGEST_ABOUT)))


def groups_in(archive: ArrayArchive, groups: Collection[str], most: int | None) -> NamedArrays:
    """Return the arrays of some groups in a unit's file, without pickles.

    Snapshots may unpack to `most` bytes, and nothing else is compressed; ValueError otherwise.
    """
    names = [name for name in archive.names if group_of(name) in groups]
    return archive.read(*names, compressed=_snapshots_of(names), most=most)


def decisions_in(archive: ArrayArchive, seeds: int) -> pa.Table:
    """Return the decisions in a unit's file, one a seed and checkpoint; ValueError if wrong."""
    most = seeds * (1 + checkpoints_of(archive.read("steps")))
    member = archive.members.get(DECISIONS)
    size = 0 if member is None else member.file_size
    return read_parquet(archive.content(DECISIONS, size), DECISION_SCHEMA, most)


def place_of(key: str, task: str, seeds: str) -> str:
    """Return a unit's place among the units, from the words for its seeds."""
    name, words = f"seeds-{seeds}", re.sub(r"[^\w-]+", "_", task)[:KEPT]
    if len(name) >= LONGEST_NAME:
        name = f"{name[:KEPT]}_{digest_of(name.encode())}"
    return f"{words}-{key}/{name}{ENDING}"


# -- The results store: a folder with a description of what its results depend on, and whole files

SCHEMA_VERSION = 3
"""Of the folder's layout; a folder of another version is refused."""
LARGEST_JSON = 2**24
"""Bytes of a JSON file at most: in memory they are up to 25 times as many. A study of 100,000 seeds
has a twentieth."""
Result = TypeVar("Result")
Record = TypeVar("Record", bound=Plain)


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
            seeds = read_unit(path, about_in).seeds
        return cls(path, path.parent.name.rpartition("-")[2], seeds)

    @cached_property
    def about(self) -> UnitRecord:
        """What its file says of it; StoreError where that is damaged or of another unit."""
        found: UnitRecord = read_unit(self.path, about_in)
        if not self._is_place_of(found):
            raise damage(self.path)
        return found

    @property
    def whole(self) -> bool:
        """Whether it is as it was stored, all of it read; StoreError where it cannot be read.

        A file system that does not answer damages nothing: what is damaged is deleted.
        """
        try:
            with read_errors(self.path), opened_archive(self.path, whole=True) as archive:
                return self._is_place_of(about_in(archive))
        except (Damaged, ValueError):
            return False

    def _is_place_of(self, about: UnitRecord) -> bool:
        place = place_of(about.key, about.task, seed_ranges(about.seeds))
        return place == f"{self.path.parent.name}/{self.path.name}"


def read_unit(path: Place, read: Callable[[ArrayArchive], Result]) -> Result:
    """Return what a function reads of a unit's file; StoreError where that cannot be."""
    try:
        with read_errors(path), opened_archive(path) as archive:
            return read(archive)
    except Damaged:
        raise damage(path) from None
    except ValueError as error:
        raise StoreError(f"{path} is not as Curricle writes it: {error}") from None


def arrays_in(stored: StoredUnit, *groups: str, most: int | None = None) -> NamedArrays:
    """Return the arrays of some groups, such as ``run``, that a unit has.

    Snapshots may unpack to `most` bytes; StoreError names a file where they have more.
    """
    return read_unit(stored.path, lambda archive: groups_in(archive, groups, most))


def written_unit(folder: Place, unit: Unit | UnitRecord, result: UnitResult) -> StoredUnit:
    """Write what some seeds of a unit learnt in one move, and return where it is."""
    seeds = tuple(result.arrays["seeds"].tolist())
    about = UnitRecord(
        key=unit.key, dependencies=dict(unit.dependencies), task=unit.task, seeds=seeds
    )
    place = f"{UNITS}/{place_of(unit.key, unit.task, seed_ranges(seeds))}"
    _write(folder, place, unit_content(about, result))
    return StoredUnit(folder / place, unit.key, seeds)


def _write(folder: Place, name: str, content: bytes) -> None:
    path = folder / name
    with write_errors(folder):
        if isinstance(folder, Path):
            (folder / STUDY).stat()  # or a folder that was moved would be made again
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
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
                gone = FileNotFoundError(errno.ENOENT, "it is not there", str(self.path / STUDY))
                raise StoreError(f"a folder of results holds a {STUDY}: {lacks}") from gone
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

    def write_record(self, name: str, record: Plain) -> None:
        """Write a record with its own checksum."""
        self.write(name, sealed(plain(record)))

    def record(self, name: str, model: type[Record]) -> Record:
        """Return what :meth:`write_record` wrote; StoreError if it is damaged."""
        found = self.read_sealed(name)
        return self.checked(name, lambda: read_record(model, found))

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
        rows = found if isinstance(found, list) else [found]
        return self.checked(RUNS, lambda: [read_record(RunRecord, one) for one in rows])

    def checked(self, name: str | Place, read: Callable[[], Result]) -> Result:
        """Return what a function reads of a file; its ValueError becomes a StoreError with both."""
        try:
            return read()
        except ValueError as error:
            file = self.path / name if isinstance(name, str) else name
            raise StoreError(
                f"{file} is not as Curricle writes it: {error}; delete it and run the study again "
                "with --resume"
            ) from None

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

    def arrays(self, stored: StoredUnit, *groups: str, most: int | None = None) -> NamedArrays:
        """Return the arrays of some groups, such as ``run``, of a unit, without pickles."""
        return arrays_in(stored, *groups, most=most)

    def decisions(self, stored: StoredUnit) -> pa.Table:
        """Return the table of a unit's decisions."""
        return read_unit(stored.path, lambda archive: decisions_in(archive, len(stored.seeds)))

    def result(
        self, stored: StoredUnit, seeds: Collection[int], most: int | None = None
    ) -> UnitResult:
        """Return the result of some of a unit's seeds; StoreError if any of it is damaged.

        `most` is as in :meth:`arrays`.
        """
        if not stored.whole:
            raise damage(stored.path)

        def read(archive: ArrayArchive) -> tuple[NamedArrays, pa.Table]:
            return groups_in(archive, GROUPS, most), decisions_in(archive, len(stored.seeds))

        arrays, decisions = read_unit(stored.path, read)
        wanted = pc.is_in(decisions["seed"], pa.array(sorted(seeds), pa.int64()))
        return UnitResult(of_seeds(arrays, seeds), decisions.filter(wanted))


# -- What seeds learnt in a task, read from a store for the tasks that it is a source of -----------


class StoredSource(NamedTuple):
    """What the seeds of a unit learnt in a source, where it is stored."""

    units: Mapping[int, StoredUnit]
    """By seed."""
    read: bool
    """Whether its values are needed."""


def stored_values(
    arrays_of: Callable[..., Mapping[str, Any]],
    done: Mapping[int, StoredUnit],
    seeds: Sequence[int],
    *,
    read: bool,
) -> StoredValues:
    """Return what seeds learnt in a task, its values only if they are to be `read`.

    `arrays_of` is as :meth:`StudyStore.arrays`, and `done` has the unit that holds each seed.
    """
    units = {done[seed].path: done[seed] for seed in seeds}
    names = (RUN, VALUES) if read else (RUN,)
    arrays = {path: arrays_of(stored, *names) for path, stored in units.items()}
    rows = [(arrays[done[seed].path], done[seed].seeds.index(seed)) for seed in seeds]
    each = [values_of(found, k) for found, k in rows]
    values: Any = None  # not needed, or not saved: training raises an error then
    if all(one is not None for one in each):
        values = np.stack(each) if isinstance(each[0], np.ndarray) else each
    steps = np.array([found["steps_used"][k] for found, k in rows])
    scales = [float(found["scale"][k]) for found, k in rows if "scale" in found]
    return StoredValues(values, steps, scales)


# -- Units that failed: the arms that need them are left out, the others are trained and compared --

FAILURES = "failures.json"
"""The units that failed in the last run, in its folder; there is no such file if none did."""
Keys = Mapping[tuple[str, str], str]
"""The key of each arm's tasks, as in :class:`Arms`."""


@dataclass
class Failures:
    """The units that failed in a run."""

    keys: Keys
    each: list[tuple[Unit, BaseException]] = field(default_factory=list)
    """In the order in which they failed."""
    executor_failed: bool = False
    """Whether one of them was never trained, as the executor failed."""
    _kept: set[str] = field(default_factory=set, init=False)
    """The keys that arms without a failure need, once there is one."""

    def __bool__(self) -> bool:
        return bool(self.each)

    def add(self, unit: Unit, error: Exception) -> None:
        """Note that a unit failed; a BrokenExecutor's cause is why."""
        if isinstance(error, BrokenExecutor):
            self.executor_failed = True
            self.each.append((unit, error.__cause__ or error))
        else:
            self.each.append((unit, error))
        lost = arms_of(self.keys, {one.key for one, _ in self.each})
        none = self.executor_failed or SCRATCH in lost
        self._kept = {key for (arm, _), key in self.keys.items() if not none and arm not in lost}

    def keeps(self, unit: Unit) -> bool:
        """Return whether an arm without a failure needs a unit; without scratch nothing is kept."""
        return not self.each or unit.key in self._kept

    def rows(self) -> list[dict[str, Any]]:
        """Return what :func:`failed_arms` reads; it is no arm's fault that an executor failed."""
        if self.executor_failed:
            return []
        return [
            {
                "key": unit.key,
                "seeds": list(unit.seeds),
                "error": f"{unit.label}: {without_folders(in_words(error))}",
            }
            for unit, error in self.each
        ]

    def error(self) -> StudyError:
        """Return one error for all; its cause is the first that is not the library's own."""
        (unit, first), *others = self.each
        text = f"{unit.label} failed, and all that is stored is whole: {in_words(first)}"
        for other, error in others:
            if not isinstance(error, EngineError):  # one sentence says that a cluster is lost
                text += f"; {other.label} failed too: {in_words(error)}"
        lost = any(isinstance(error, EngineError) for _, error in self.each)
        found = EngineError(text) if lost else StudyError(text)
        foreign = [error for _, error in self.each if not isinstance(error, CurricleError)]
        found.__cause__ = foreign[0] if foreign else None
        return found


def without_folders(text: str) -> str:
    """Return an error's text with the names of files only: folders are those of one machine."""
    quoted = re.sub(r"""(['"])(?:[A-Za-z]:)?[/\\][^'"\n]*[/\\]([^'"\n/\\]+)\1""", r"\1\2\1", text)
    return re.sub(r"(?<![\w.:/\\])(?:[A-Za-z]:)?[/\\](?:[^\s:'\"/\\]*[/\\]+)+", "", quoted)


def arms_of(keys: Keys, some: Collection[str]) -> set[str]:
    """Return the arms that need a unit with one of these keys."""
    return {arm for (arm, _), key in keys.items() if key in some}


def read_failures(store: StudyStore) -> list[dict[str, Any]]:
    """Return the rows of :meth:`Failures.rows` that a folder holds; StoreError if damaged."""
    found = store.read_json(FAILURES) if store.has(FAILURES) else []
    try:
        return [
            {"key": str(row["key"]), "seeds": [*map(int, row["seeds"])], "error": str(row["error"])}
            for row in found
        ]
    except (TypeError, KeyError, ValueError, OverflowError):
        raise StoreError(
            f"{store.path / FAILURES} must list units that failed, each with key, seeds and error: "
            "delete it, and show leaves out no arm"
        ) from None


def failed_arms(
    rows: Iterable[Mapping[str, Any]], keys: Keys, stored: Mapping[str, Mapping[int, Any]]
) -> dict[str, str]:
    """Return the first error of each arm that needs a unit that failed and is not stored since."""
    found: dict[str, str] = {}
    for row in rows:
        if not set(row["seeds"]) <= set(stored.get(row["key"], ())):
            for arm in sorted(arms_of(keys, [row["key"]])):
                found.setdefault(arm, row["error"])
    return found


def write_failures(store: StudyStore, rows: Sequence[dict[str, Any]]) -> None:
    """Write the failures of a run in the place of those of an earlier one."""
    if rows:
        store.write_json(FAILURES, rows)
    else:
        with write_errors(store.path):
            (store.path / FAILURES).unlink(missing_ok=True)
