"""Running a study: an executor trains its units, which are stored as soon as they are trained."""

import json
import os
import platform
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib import metadata
from itertools import chain
from math import inf
from os import PathLike
from pathlib import Path
from time import monotonic
from typing import Any

from curricle.checks import BEYOND_64_BITS, whole_number
from curricle.comparison.plan import (
    ASKED_AGAIN,
    Failures,
    Plan,
    Unit,
    numbered_seeds,
    trained_units,
)
from curricle.curriculum.result import sources_read
from curricle.errors import SettingError, StoreError
from curricle.files import Place, place_at
from curricle.interop.trackers import Tracker, Trackers, to_stderr, trackers_of
from curricle.learning.result import LearningResult
from curricle.progress import check_progress, interruptible, shown
from curricle.study.analysis import analyse, study_record
from curricle.study.arms import Arms, UnitInput, changes_of, replaced_keys, seeds_of, units_of
from curricle.study.config import Study, StudyConfig, study_of
from curricle.study.executors import Workers
from curricle.study.record import FailuresRecord, RunRecord, RunsRecord, StudyRecord
from curricle.study.results import (
    FAILURES,
    StudyResults,
    failure_error,
    failure_records,
    write_failures,
)
from curricle.study.store import (
    ANALYSIS,
    CHOICE,
    RUNS,
    SNAPSHOTS,
    TRIALS,
    Finished,
    StudyStore,
    UnitContent,
    group_of,
    holds_study,
    lost_errors,
)
from curricle.study.tuning import (
    settled,
    trials_of,
    tuned_before,
)
from curricle.text import brief_repr, counted, duration

# -- The progress of a run, and the time that is left ----------------------------------------------


@dataclass(frozen=True)
class Progress:
    """The progress of a run.

    Attributes
    ----------
    units : tuple of Unit
        All units that the run trains; the same tuple in every call.
    stored : Unit or None
        The unit that has just been stored; None at the beginning.
    workers : int
        Number of workers now.
    tuning : str
        The trials to which the units belong, as text; empty for units of the study itself.

    Examples
    --------
    >>> unit = Unit("0f", "scratch", "maze", (0, 1), {}, {}, 0)
    >>> progress = Progress((unit,), stored=unit, workers=2)
    >>> progress.stored.label, progress.workers
    ('scratch: maze, seeds 0-1', 2)
    """

    units: tuple[Unit, ...]
    stored: Unit | None = None
    workers: int = 1
    tuning: str = ""

    __repr__ = brief_repr


class Pace:
    """The number of stored units, and about the time that the other units will take."""

    def __init__(self, clock: Callable[[], float] = monotonic):
        self.clock, self.stored, self.units = clock, 0, 0
        self._workers, self._begun = 0, (clock(), 0)  # time, and units stored at that time

    def note(self, progress: Progress) -> None:
        """Record the beginning of a run, or a stored unit."""
        self.units, self._workers = len(progress.units), progress.workers
        self.stored = 0 if progress.stored is None else self.stored + 1
        if progress.stored is None:  # units of a study may follow the units of its tuning
            self._begun = self.clock(), 0

    def line(self) -> str:
        """Return a line on the progress of the run, and the time left at its pace so far."""
        parts = [f"{self.stored:,} of {counted(self.units, 'unit')}"] if self.units else []
        if self._workers:
            parts.append(counted(self._workers, "worker"))
        begun, before = self._begun
        if self.units > self.stored > before:
            seconds = (self.units - self.stored) * (self.clock() - begun) / (self.stored - before)
            parts.append(f"about {duration(seconds)} left")
        return ", ".join(parts)


@contextmanager
def shown_units(
    progress: bool | Callable[[Progress], Any] | None,
    pace: Pace | None = None,
    line: Callable[[], str] | None = None,
) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that shows every :class:`Progress` in the form that `progress` states."""
    # `line` returns the text below the bars, by default the line of `pace` on the whole run.
    pace = pace or Pace()
    grow: dict[str, Callable[[], None]] = {}
    with shown(progress, line or pace.line) as bars:

        def show(now: Progress) -> None:
            pace.note(now)
            if now.stored is None:
                seeds = Counter[str]()
                for unit in now.units:
                    seeds[now.tuning or f"{unit.arm}: {unit.task}"] += len(unit.seeds)
                for row, total in seeds.items():
                    grow[row] = bars.bar(row, total)
            else:
                for _ in now.stored.seeds:
                    grow[now.tuning or f"{now.stored.arm}: {now.stored.task}"]()
                if pace.stored == len(now.units) and not now.tuning:
                    bars.bar("certificates and episodes")
            bars.tell(now)

        yield show


# -- The stored units that a run uses, and the reasons why it does not use other units -------------


def usable_units(
    store: StudyStore, arms: Arms, seeds: Sequence[int], *, remove_damaged: bool
) -> tuple[Finished, list[str]]:
    """Return the usable units, and sentences about damaged files and stale units of `seeds`."""
    # Stale units stay in the folder: they are used again when their dependencies are as before.
    damaged = store.damaged_units()
    remarks = [f"{file} is damaged: its units are trained again" for file in damaged]
    if remove_damaged:
        store.remove(damaged)
    done = store.finished(without=damaged)
    places: dict[str, tuple[str, str]] = {}
    for place, key in arms.keys.items():
        places.setdefault(key, place)  # the first of the arms that share units
    depends = {key: arms.dependencies[place] for key, place in places.items()}
    stale = replaced_keys(depends, done)
    for key in (key for key in places if key in stale):
        units = done[stale[key]]
        why = "; ".join(changes_of(units, depends[key]))
        label = ": ".join(places[key])
        if again := sorted(units.keys() & {*seeds}):
            remarks.append(f"{label}, {numbered_seeds(again)}, is stale and trained again: {why}")
    return done, remarks


# -- Running a study -------------------------------------------------------------------------------

AHEAD = 2  # units submitted for each worker, so that workers need not wait for the next unit
LIBRARIES = ("curricle", "numpy", "numba", "llvmlite", "gymnasium", "pyarrow", "pydantic")
OPTIONAL = ("torch", "stable-baselines3", "sb3-contrib", "minigrid")  # they may be installed
TASKS_OR_LEARNERS = {"gymnasium", "minigrid", "stable-baselines3", "sb3-contrib"}
"""Libraries whose versions may change a task or a learner, not the last bits alone."""


def run_study(
    study: Study,
    path: str | Place | None = None,
    *,
    resume: bool = False,
    workers: int | Callable[[], int] | None = None,
    executor: Executor | None = None,
    shard: tuple[int, int] = (1, 1),
    trackers: Sequence[Tracker] = (),
    report: Callable[[str], Any] | None = None,
    progress: bool | Callable[[Progress], Any] | None = True,
) -> StudyResults:
    """Run a study into a folder and return its results.

    Parameters
    ----------
    study : StudyConfig or path of its file
    path : path or str, optional
        The folder, created if missing, or a URL. By default FILE-results in the working directory.
    resume : bool
        Whether to use the folder's units. Units are trained if they are missing, damaged or stale.
        A unit is stale if its settings, its sources, the user's code or Curricle's version differ.
    workers : int or callable, optional
        Number of threads: by default one a processor, but a single thread if a task runs in Python
        or is learnt by a network (use :class:`WorkerProcesses` then). Results do not depend on it.
        With an executor, how many units it trains at once; a function if that may change.
    executor : concurrent.futures.Executor, optional
        Trains the units instead of threads, maybe on other machines; it is not shut down.
    shard : (int, int)
        (i, n) runs the i-th of n parts of the seeds, i from 1; :func:`merge` joins the folders.
    trackers : sequence of Tracker
        Each :class:`Tracker` also receives each unit's curves.
    report : callable, optional
        Called with a sentence for each failed tracker and each damaged file or stale task; by
        default it prints to stderr.
    progress : bool or callable, optional
        Bars by default; a function is called with a :class:`Progress` at the start and after each
        unit.

    Raises
    ------
    ConfigError
        With all mistakes in the study's file, including those that Stable-Baselines3 finds.
    StoreError
        When the folder holds other files, is in use, is damaged or cannot be written to;
        LostStoreError if it fails during the run, which `resume` then continues.
    SettingError
        When the arms cannot be compared, a setting is invalid, or a package is missing.
    StudyError
        When units failed, after the units of all other arms are stored.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> study = StudyConfig.from_data(
    ...     {"name": "line", "seeds": [0, 1], "arms": {"transfer": {
    ...         "tasks": {"line": {"type": "maze", "map": "S..T", "budget": 500}}}}}, Path())
    >>> found = run_study(study, Path(mkdtemp()) / "results")
    >>> found.results["scratch"]["line"].steps_used
    array([500, 500])
    """
    study = study_of(study)
    check_progress(progress)
    path = path or study.results_folder
    if workers is not None and not callable(workers):
        whole_number("workers", workers, 1, SettingError)
    if report is not None and not callable(report):
        raise SettingError(f"report must be a function that takes a sentence: got {report!r}")
    if not isinstance(resume, bool):
        raise SettingError(f"resume must be True or False: got {resume!r}")
    whole = isinstance(shard, tuple | list) and [type(part) for part in shard] == [int, int]
    if not (whole and 1 <= shard[0] <= shard[1]):
        raise SettingError(f"a shard must be (i, n), whole numbers, i from 1 to n: got {shard!r}")
    check_runnable(study)
    trackers = trackers_of(trackers)
    report = report or to_stderr
    if not seeds_of(study, shard):
        part = f"shard {shard[0]}/{shard[1]}"
        report(f"{part} has no seeds: there are fewer groups of seeds than shards")
    trials, folder = trials_of(study), CHOICE if study.choose else TRIALS
    study = tuned_before(study, place_at(path))
    arms = Arms.of(study)
    with ExitStack() as ending:
        all_arms = [Arms.of(part) for part in (study, trials) if part]
        places = _workers(study, all_arms, workers, executor, ending)
        about, record = described(study, arms)
        opened = StudyStore.opened(path, about, resume=resume, check=False)
        store = ending.enter_context(opened)
        ending.enter_context(lost_errors())
        training = Training(store, places, ending.enter_context(shown_units(progress)), report)
        if trials:
            about, of_trials = described(trials, Arms.of(trials), record)
            opened = StudyStore.opened(store.path / folder, about, resume=resume, check=False)
            with opened as trials_store:
                tried = partial(replace(training, store=trials_store).tried, trials, of_trials)
                study = settled(study, trials, tried)
            arms = Arms.of(study)
            about, record = described(study, arms, of_trials)
            store.describe(about)
        tracking = Trackers(trackers, report)
        beside = (
            store.path
            if isinstance(store.path, Path)
            else Path(store.path.name or store.path.drive)
        )
        tracking.start(study.name, {key: about[key] for key in about if key != "plan"}, beside)
        ending.callback(tracking.close)
        failures = training.run(
            study, arms, record, shard, track=tracking.record if trackers else None
        )
        results = StudyResults(store)
        analyse(results, arms)
    if failures:
        raise failure_error(failures)
    return results


def check_runnable(study: StudyConfig) -> None:
    """Raise what would end a run of a study, or of its trials, before anything is trained."""
    study.check_networks()
    if trials := trials_of(study):
        if Arms.of(trials).total is None:
            raise SettingError(
                "arms are tuned at one total of steps: give the budget of the target in steps"
            )
        trials.check_networks()


@dataclass(frozen=True)
class Training:
    """The store of units, the workers that train them, and the functions that report on them."""

    store: StudyStore
    workers: Workers
    show: Callable[[Progress], Any]
    report: Callable[[str], Any]

    def run(
        self,
        study: StudyConfig,
        arms: Arms,
        record: StudyRecord,
        shard: tuple[int, int] = (1, 1),
        *,
        part: Plan | None = None,
        words: str = "",
        track: Callable[[str, str, LearningResult], Any] | None = None,
    ) -> Failures:
        """Train and store the missing units of a study or a part of it; return the failures."""
        part = part or arms
        store, workers, failures = self.store, self.workers, Failures(part.needs)
        done = _begun(store, study, arms, self.report)
        units = tuple(units_of(study, part, done, shard))
        data = json.dumps(study.data), str(study.folder.resolve()), json.dumps(arms.code)
        number, asked = 0, -inf

        def now() -> int:
            nonlocal number, asked
            if monotonic() - asked >= ASKED_AGAIN:
                number, asked = workers.number(), monotonic()
            return number

        def send(unit: Unit) -> Future[Any]:
            curriculum = arms.curricula[unit.arm]
            read = sources_read(curriculum, unit.task)
            sources = {
                name: store.source_values(name, done[key], unit.seeds, read=name in read)
                for name, key in unit.sources.items()
            }
            return workers.train(UnitInput(*data, unit, sources, arms))

        def keep(unit: Unit, result: UnitContent) -> None:
            stored = store.write_unit(unit, result)
            done.setdefault(unit.key, {}).update(dict.fromkeys(stored.seeds, stored))

        if units or not words:
            self.show(Progress(units, None, now(), words))
        # for one worker at least: some clusters start workers only when there are calls
        for unit, result in trained_units(
            units, send, keep, failures, at_once=lambda: AHEAD * max(1, now())
        ):
            if track is not None:
                node = arms.curricula[unit.arm].node(unit.task)
                learnt = LearningResult.of_arrays(result.arrays, node.task, node.learner)
                track(unit.arm, unit.task, learnt)
            self.show(Progress(units, unit, now(), words))
        write_failures(store, failure_records(failures))
        store.require_there()  # a moved folder
        StudyResults(store, record).write_tables()
        return failures

    def tried(
        self,
        trials: StudyConfig,
        of_trials: StudyRecord,
        part: Arms,
        seeds: Sequence[int],
        words: str,
    ) -> StudyResults:
        """Train some arms of a study of trials on further seeds, and return their results."""
        study, arms = trials.varied(seeds=list(seeds)), Arms.of(trials)
        about, record = described(study, part, of_trials)
        self.store.describe(about)
        if failures := self.run(study, arms, record, part=part, words=words):
            raise failure_error(failures)
        return StudyResults(self.store, record)


def described(
    study: StudyConfig, arms: Arms, *solved: StudyRecord
) -> tuple[dict[str, Any], StudyRecord]:
    """Return the description of a study, on which its results depend, and its record.

    Its target is not solved again if it is that of one of the records `solved`.
    """
    record, version = study_record(study, arms, solved), metadata.version("curricle")
    about = {"curricle": version, "configuration": study.data, "code": arms.code}
    return {**about, "plan": record.plan}, record


def _workers(
    study: StudyConfig,
    all_arms: Sequence[Arms],
    workers: int | Callable[[], int] | None,
    executor: Executor | None,
    ending: ExitStack,
) -> Workers:
    """Return the workers of a run; threads started for the run end with it."""
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise SettingError(f"executor must be a concurrent.futures.Executor: got {executor!r}")
    number = workers or os.cpu_count() or 1
    if executor is None:  # results of units in progress would be thrown away
        if callable(number):
            raise SettingError("workers must be a number without an executor: got a function")
        threads = 1 if any(arms.serial for arms in all_arms) else number
        executor = ending.enter_context(interruptible(threads))
    count = number if callable(number) else lambda: number
    return Workers.of(executor, count, all_arms, study.folder)


def _begun(
    store: StudyStore, study: StudyConfig, arms: Arms, report: Callable[[str], Any]
) -> Finished:
    """Record the run in its folder, and return the stored units that the run uses."""
    done, remarks = usable_units(store, arms, study.seeds, remove_damaged=True)
    runs = store.record(RUNS, RunsRecord).runs
    versions = {name: metadata.version(name) for name in LIBRARIES}
    for name in OPTIONAL:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    for library, version in versions.items():
        used = {earlier.versions[library] for earlier in runs if library in earlier.versions}
        earlier_versions = sorted(used - {version})
        if earlier_versions and library != "curricle":
            how = "" if library in TASKS_OR_LEARNERS else " in the last bits"
            remarks.append(
                f"{library} was {' and '.join(earlier_versions)} in earlier runs and is {version}: "
                f"their units are used, and may differ from today's{how}"
            )
    for sentence in remarks:
        report(sentence)
    # The record names no machine, user or path, because users send folders to other people.
    run = RunRecord(
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        file=study.file,
        seeds=study.seeds,
        commit=_commit(study.folder),
        python=platform.python_version(),
        machine=f"{platform.system()} {platform.machine()}",
        versions=versions,
        finished_before=_finished(done, arms, {seed for run in runs for seed in run.seeds}),
    )
    store.write_record(RUNS, RunsRecord(runs=(*runs, run)))
    return done


def _finished(done: Finished, arms: Arms, planned: set[int]) -> int:
    """Return the number of planned seeds if all are finished in several arms; else 0."""
    targets = [key for (_, task), key in arms.keys.items() if task == arms.target and key in done]
    whole = all(planned <= done[key].keys() for key in targets)
    return len(planned) if whole and len(targets) > 1 else 0


def _commit(folder: Path) -> str | None:
    """Return the Git commit of a folder, marked if files differ from it; None without Git."""
    asked = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    quiet: Any = {"capture_output": True, "text": True, "check": False}
    try:
        described = subprocess.run(asked, cwd=folder, timeout=10, **quiet)
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip() or None


# -- Merging parts of a study that ran in several folders ------------------------------------------


def merge(path: str | Place, parts: Sequence[str | Place]) -> StudyResults:
    """Merge the parts of a study, run in several folders, into one folder; return its results.

    The folder is created if missing; its units of the same study stay. The parts do not change. A
    unit in several parts is copied once, because equal units have equal results. StoreError when
    the folders hold different studies, or a folder is damaged or in use.
    """
    if isinstance(parts, str | PathLike):
        raise StoreError(f"folders to merge must be a list: got {str(parts)!r} alone")
    if not parts:
        raise StoreError("there must be at least one folder to merge: got none")
    studies = [StudyResults(part) for part in parts]
    stores = [study.store for study in studies]
    units_of_parts = [store.units() for store in stores]
    for study, units in zip(studies, units_of_parts, strict=True):
        stores[0].check(study.store.description)
        for unit in units:  # reads all units before any file is written
            unit.result(unit.seeds, study.most_bytes)
    # The analysis covers the first seeds: a part that finished these has the whole analysis.
    by_seed = sorted(studies, key=lambda study: min(study.seeds, default=BEYOND_64_BITS))
    analysis = next((study.analysis for study in by_seed if study.analysis), None)
    with StudyStore.opened(path, stores[0].description, resume=True) as target:
        failures = [*target.record(FAILURES, FailuresRecord).failures]
        before = target.record(RUNS, RunsRecord).runs
        runs = [*before]
        done = target.finished()
        stored = [*done.values(), *(unit.seeds for units in units_of_parts for unit in units)]
        first = min(chain.from_iterable(stored), default=0)
        for store, units in zip(stores, units_of_parts, strict=True):
            target.describe(store.description)
            # Records in the folder come from a part that was merged before.
            runs += [run for run in store.record(RUNS, RunsRecord).runs if run not in before]
            target.write_record(RUNS, RunsRecord(runs=tuple(runs)))
            for unit in units:
                merged_units = done.setdefault(unit.key, {})
                if new := tuple(seed for seed in unit.seeds if seed not in merged_units):
                    result = unit.result(new)
                    if first not in new:  # a study keeps snapshots of its first seed only
                        arrays = result.arrays.items()
                        kept = {k: v for k, v in arrays if group_of(k) != SNAPSHOTS}
                        result = result._replace(arrays=kept)
                    merged_units |= dict.fromkeys(new, target.write_unit(unit.about, result))
            of_part = store.record(FAILURES, FailuresRecord).failures
            failures += [failure for failure in of_part if failure not in failures]
        target.describe(stores[0].description)  # now with the seeds of all parts
        merged = StudyResults(target)
        merged.write_tables()
        if analysis is not None:
            target.write_record(ANALYSIS, analysis)
        write_failures(target, tuple(failures))
    for folder in (TRIALS, CHOICE):
        if holds_study(stores[0].path / folder):
            merge(target.path / folder, [store.path / folder for store in stores])
    return merged
