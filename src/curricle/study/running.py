"""Running a study: an executor trains its units, which are stored as soon as they are trained."""

import json
import os
import platform
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from graphlib import TopologicalSorter
from heapq import heappop, heappush
from importlib import metadata
from itertools import chain, product
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any

from curricle.checks import BEYOND_64_BITS, whole_number
from curricle.comparison.plan import Failures, Plan, Unit, numbered_seeds
from curricle.curriculum.result import SourceValues, sources_read
from curricle.design.choice import chosen
from curricle.errors import LostStoreError, SettingError, StoreError
from curricle.files import Place, place_at
from curricle.interop.trackers import Tracker, Trackers, to_stderr, trackers_of
from curricle.learning.result import LearningResult
from curricle.progress import check_progress, interruptible, shown
from curricle.study.analysis import analyse, study_record
from curricle.study.arms import Arms, UnitInput, changes_of, replaced_keys, seeds_of, units_of
from curricle.study.config import Study, StudyConfig, study_of
from curricle.study.engines.engine import ExecutorWorkers, Workers, opened_engine
from curricle.study.record import FailureRecord, RunRecord, StudyRecord, plain
from curricle.study.results import (
    FAILURES,
    StudyResults,
    failure_error,
    failure_records,
    write_failures,
)
from curricle.study.store import (
    ANALYSIS,
    RUNS,
    SNAPSHOTS,
    Packing,
    StoredUnit,
    StudyStore,
    files_of,
    group_of,
    holds_study,
    lost_errors,
    pack,
    stored_values,
)
from curricle.study.tuning import (
    CHOICE,
    TRIALS,
    chosen_study,
    trial_study,
    tuned_before,
    tuned_study,
)
from curricle.text import brief_repr, counted

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

    def line_of(self, stored: int, units: int) -> str:
        """Return the line for the number of units that another process has stored."""
        if not self.units:
            self._begun = self.clock(), stored
        self.stored, self.units = stored, units
        return self.line()

    def line(self) -> str:
        """Return a line on the progress of the run, and the time left at its pace so far."""
        parts = [f"{self.stored:,} of {counted(self.units, 'unit')}"] if self.units else []
        if self._workers:
            parts.append(counted(self._workers, "worker"))
        begun, before = self._begun
        if self.units > self.stored > before:
            left = (self.units - self.stored) * (self.clock() - begun) / (self.stored - before)
            parts.append(f"{timedelta(seconds=round(left))} left")
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
                    bars.bar("forecasts and certificates")
            bars.tell(now)

        yield show


# -- The stored units that a run uses, and the reasons why it does not use other units -------------

Done = dict[str, dict[int, StoredUnit]]  # key -> seed -> unit


def usable_units(store: StudyStore, arms: Arms, *, remove_damaged: bool) -> tuple[Done, list[str]]:
    """Return the usable units, and sentences about damaged files and stale units."""
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
        label = f"{': '.join(places[key])}, {numbered_seeds(sorted(units))}"
        why = "; ".join(changes_of(units, depends[key]))
        remarks.append(f"{label}, is stale and trained again: {why}")
    return done, remarks


# -- The order of units ----------------------------------------------------------------------------

AHEAD = 2  # units submitted for each worker, so that workers need not wait for the next unit
ASKED_AGAIN = 2.0
"""Seconds between requests for the number of workers: it may grow, but a cluster's answer takes
about as long as a small unit."""


class Queue:
    """Units to send: in order, but each after its sources are trained."""

    def __init__(self, units: Iterable[Unit]):
        self.units = list(units)
        numbers = enumerate(self.units)
        self._numbers = {(unit.key, seed): n for n, unit in numbers for seed in unit.seeds}
        self._order = TopologicalSorter[int]()
        for number, unit in enumerate(self.units):
            read = self._numbers.keys() & product(unit.sources.values(), unit.seeds)
            self._order.add(number, *{self._numbers[pair] for pair in read})
        self._order.prepare()
        self.ready = sorted(self._order.get_ready())  # heap of the units whose sources are trained

    def pop(self) -> Unit:
        """Return the next unit to send."""
        return self.units[heappop(self.ready)]

    def trained(self, unit: Unit) -> None:
        """Release the units that waited for a unit; call it when that unit is stored."""
        self._order.done(self._numbers[unit.key, unit.seeds[0]])
        for number in self._order.get_ready():
            heappush(self.ready, number)


@dataclass
class Scheduler:
    """Sends units to workers, each after its sources, and passes results to a `holder` to store."""

    # `holder.add` takes a result, `holder.write` stores all results taken, which may wait for
    # `holder.seconds`; the holder is true while it holds results. `workers` return their number,
    # and the error of a unit that was cancelled, but not by this process.

    send: Callable[[Unit], Future[Any]]  # called after the unit's sources are stored
    holder: Any
    workers: Any
    failures: Failures
    _number: int = field(default=0, init=False)
    _asked: float = field(default=-inf, init=False)

    def number(self) -> int:
        """Return the number of workers, now or a moment ago."""
        if monotonic() - self._asked >= ASKED_AGAIN:
            self._number, self._asked = self.workers.number(), monotonic()
        return self._number

    def results(self, units: Iterable[Unit]) -> Iterator[tuple[Unit, Any]]:
        """Yield each unit with its result when the result is stored."""
        # After a failure no unit is started that only arms with a failure need.
        queue, running = Queue(units), dict[Future[Any], Unit]()
        try:
            while queue.ready or running or self.holder:
                # for one worker at least: some clusters start workers only when there are calls
                ahead = AHEAD * max(1, self.number())
                while queue.ready and len(running) < ahead:
                    unit = queue.pop()
                    if self.failures.keeps(unit):
                        running[self.send(unit)] = unit
                idle = not queue.ready  # then units may wait for results that are not stored yet
                limit = self.holder.seconds if self.holder else ASKED_AGAIN
                ended, _ = wait(running, min(limit, ASKED_AGAIN), FIRST_COMPLETED)
                for future in [future for future in running if future in ended]:
                    if future in running:  # the failure of another unit may have cancelled it
                        self._end(future, running)
                if idle or not self.holder.seconds:
                    for unit, result in self.holder.write():
                        queue.trained(unit)
                        yield unit, result
        finally:
            for future in running:
                future.cancel()
            self.holder.write()

    def _end(self, future: Future[Any], running: dict[Future[Any], Unit]) -> None:
        """Take the result of a unit that has ended; if it failed, cancel units needed no longer."""
        unit = running.pop(future)
        error = self.workers.lost() if future.cancelled() else future.exception()
        result = None if error else future.result()
        error = result if isinstance(result, Exception) else error  # an error from another process
        if isinstance(error, LostStoreError) or not isinstance(error, Exception | None):
            raise error  # the store is lost, or this is an interrupt
        if error is None:
            self.holder.add(unit, result)
            return
        self.failures.add(unit, error)
        for other, waiting in [*running.items()]:
            if not self.failures.keeps(waiting) and other.cancel():
                del running[other]


# -- Running a study -------------------------------------------------------------------------------

LIBRARIES = ("curricle", "numpy", "numba", "llvmlite", "gymnasium", "pyarrow", "pydantic")
OPTIONAL = ("torch", "stable-baselines3", "sb3-contrib")  # libraries that may be installed


def run_study(
    study: Study,
    path: str | Place | None = None,
    *,
    resume: bool = False,
    workers: int | None = None,
    executor: Executor | None = None,
    on: str | None = None,
    shard: tuple[int, int] = (1, 1),
    trackers: Sequence[str | Tracker] = (),
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
    workers : int, optional
        Number of threads: by default one a processor, but a single thread if a task runs in Python
        or is learnt by a network (use :class:`WorkerProcesses` then). Results do not depend on it.
    executor : concurrent.futures.Executor, optional
        Trains the units instead of threads, maybe on other machines; it is not shut down.
    on : str, optional
        A cluster that trains the units: "dask", "ray", or an address such as "dask://host:8786".
    shard : (int, int)
        (i, n) runs the i-th of n parts of the seeds, i from 1; :func:`merge` joins the folders.
    trackers : sequence of str or Tracker
        Trackers that also receive each unit's curves: "tensorboard", or your :class:`Tracker`.
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
    if workers is not None:
        whole_number("workers", workers, 1, SettingError)
    if report is not None and not callable(report):
        raise SettingError(f"report must be a function that takes a sentence: got {report!r}")
    if not isinstance(resume, bool):
        raise SettingError(f"resume must be True or False: got {resume!r}")
    whole = isinstance(shard, tuple | list) and [type(part) for part in shard] == [int, int]
    if not (whole and 1 <= shard[0] <= shard[1]):
        raise SettingError(f"a shard must be (i, n), whole numbers, i from 1 to n: got {shard!r}")
    study.check_networks()
    trackers = trackers_of(trackers)
    report = report or to_stderr
    if not seeds_of(study, shard):
        part = f"shard {shard[0]}/{shard[1]}"
        report(f"{part} has no seeds: there are fewer groups of seeds than shards")
    study = tuned_before(study, place_at(path))
    trials = trial_study(study) if study.choose else study.of_trials() if study.tune else None
    arms, of_trials = Arms.of(study), Arms.of(trials) if trials else None
    if trials and of_trials:
        if of_trials.total is None:
            raise SettingError(
                "arms are tuned at one total of steps: give the budget of the target in steps"
            )
        trials.check_networks()
    with ExitStack() as ending:
        # opened first, so that a refused cluster leaves no folder
        every = [arms, of_trials] if of_trials else [arms]
        places = _workers(study, every, workers, executor, on, report, ending)
        about, record = described(study, arms)
        opened = StudyStore.opened(path, about, resume=resume, check=False)
        store = ending.enter_context(opened)
        ending.enter_context(lost_errors())
        training = Training(store, places, ending.enter_context(shown_units(progress)), report)
        if trials and of_trials:
            folder = store.path / (CHOICE if study.choose else TRIALS)
            about, _ = described(trials, of_trials)
            with StudyStore.opened(folder, about, resume=resume, check=False) as there:
                of_folder = replace(training, store=there), trials, of_trials
                if study.choose:
                    choice = chosen(of_trials, lambda *part: _tried(*of_folder, *part).comparison)
                    study = chosen_study(study, trials, choice)
                else:
                    title = f"tuning: {counted(len(of_trials.curricula), 'trial')}"
                    tried = _tried(*of_folder, of_trials, trials.seeds, title)
                    study = tuned_study(study, tried)
            arms = Arms.of(study)
            about, record = described(study, arms)
            training = replace(training, store=store.redescribed(about))
        tracking = Trackers(trackers, report)
        beside = store.path if isinstance(store.path, Path) else Path(store.path.name)
        tracking.start(study.name, {key: about[key] for key in about if key != "record"}, beside)
        ending.callback(tracking.close)
        failures = training.run(
            study, arms, record, shard, track=tracking.record if trackers else None
        )
        store = training.store
        results = StudyResults(store)
        analyse(results, arms)
    if failures:
        raise failure_error(failures)
    return results


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
        packing = Packing(store, done, files_of(record))
        data = json.dumps(study.to_data()), str(study.folder.resolve()), json.dumps(arms.code)
        seen = workers.see(store.path)  # workers that see the store read and write large files

        def send(unit: Unit) -> Future[Any]:
            curriculum = arms.curricula[unit.arm]
            values, stored = dict[str, SourceValues](), dict[str, Any]()
            read = sources_read(curriculum, unit.task)
            for name, key in unit.sources.items():
                files, needed = {seed: packing.done[key][seed] for seed in unit.seeds}, name in read
                if seen and packing.is_large(key, unit.seeds):
                    stored[name] = files, needed
                else:
                    values[name] = stored_values(packing.arrays, files, unit.seeds, read=needed)
            kept = curriculum.node(unit.task).deep and (seen or workers.share_folders)
            checkpoints = store.checkpoints(unit) if kept else None
            place = store.path if seen and packing.is_large(unit.key, unit.seeds) else None
            return workers.train(UnitInput(*data, unit, values, checkpoints, stored, place))

        scheduler = Scheduler(send, packing, workers, failures)
        self.show(Progress(units, None, scheduler.number(), words))
        for unit, result in scheduler.results(units):
            if track is not None:
                if isinstance(result, StoredUnit):
                    result = result.result(unit.seeds)
                node = arms.curricula[unit.arm].node(unit.task)
                learnt = LearningResult.of_arrays(result.arrays, node.task, node.learner)
                track(unit.arm, unit.task, learnt)
            self.show(Progress(units, unit, scheduler.number(), words))
        write_failures(store, failure_records(failures))
        pack(store, packing.per_file)
        if not failures:
            store.remove_checkpoints()
        store.require_there()  # listing a moved folder raises no error
        StudyResults(store, record).write_tables()
        return failures


def _tried(
    training: Training, study: StudyConfig, arms: Arms, part: Any, seeds: Sequence[int], words: str
) -> StudyResults:
    """Train some arms of trials on further seeds, and return their results."""
    study = study.varied(seeds=list(seeds))
    about, record = described(study, part)
    training = replace(training, store=training.store.redescribed(about))
    if failures := training.run(study, arms, record, part=part, words=words):
        raise failure_error(failures)
    return StudyResults(training.store, record)


def described(study: StudyConfig, arms: Arms) -> tuple[dict[str, Any], StudyRecord]:
    """Return the description of a study, on which its results depend, and its record."""
    record, version = study_record(study, arms), metadata.version("curricle")
    about = {"curricle": version, "configuration": study.to_data(), "code": arms.code}
    return {**about, "record": plain(record)}, record


def _workers(
    study: StudyConfig,
    all_arms: Sequence[Arms],
    workers: int | None,
    executor: Executor | None,
    on: str | None,
    report: Callable[[str], Any],
    ending: ExitStack,
) -> Workers:
    """Return the workers of a run; workers started for the run end with it."""
    if on is not None and executor is not None:
        raise SettingError(f"on and an executor exclude each other: got on={on!r} and an executor")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise SettingError(f"executor must be a concurrent.futures.Executor: got {executor!r}")
    if on is not None:
        engine = ending.enter_context(opened_engine(on, workers))
        link = f", {engine.link}" if engine.link else ""
        report(f"{on}: {counted(engine.number(), 'worker')}{link}")
        engine.carry(all_arms, study.folder)
        return engine
    number = workers or os.cpu_count() or 1
    if executor is None:  # results of units in progress would be thrown away
        threads = 1 if any(arms.serial for arms in all_arms) else number
        executor = ending.enter_context(interruptible(threads))
    return ExecutorWorkers(executor, number)


def _begun(store: StudyStore, study: StudyConfig, arms: Arms, report: Callable[[str], Any]) -> Done:
    """Record the run in its folder, and return the stored units that the run uses."""
    done, remarks = usable_units(store, arms, remove_damaged=True)
    runs = store.records(RUNS, RunRecord)
    versions = {name: metadata.version(name) for name in LIBRARIES}
    for name in OPTIONAL:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    for library, version in versions.items():
        used = {earlier.versions[library] for earlier in runs if library in earlier.versions}
        earlier_versions = sorted(used - {version})
        if earlier_versions and library != "curricle":
            remarks.append(
                f"{library} was {' and '.join(earlier_versions)} in earlier runs and is {version}: "
                "their units are used, and may differ from today's in the last bits"
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
    )
    store.write_records(RUNS, [*runs, run])
    return done


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
    if isinstance(parts, str | Place):
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
        failures = target.records(FAILURES, FailureRecord)
        before = target.records(RUNS, RunRecord)
        runs = [*before]
        done = target.finished()
        stored = [*done.values(), *(unit.seeds for units in units_of_parts for unit in units)]
        first = min(chain.from_iterable(stored), default=0)
        for store, units in zip(stores, units_of_parts, strict=True):
            target = target.redescribed(store.description)
            # Records in the folder come from a part that was merged before.
            runs += [run for run in store.records(RUNS, RunRecord) if run not in before]
            target.write_records(RUNS, runs)
            for unit in units:
                merged_units = done.setdefault(unit.key, {})
                if new := tuple(seed for seed in unit.seeds if seed not in merged_units):
                    result = unit.result(new)
                    if first not in new:  # a study keeps snapshots of its first seed only
                        arrays = result.arrays.items()
                        kept = {k: v for k, v in arrays if group_of(k) != SNAPSHOTS}
                        result = result._replace(arrays=kept)
                    merged_units |= dict.fromkeys(new, target.write_unit(unit.about, result))
            of_part = store.records(FAILURES, FailureRecord)
            failures += [failure for failure in of_part if failure not in failures]
        target = target.redescribed(stores[0].description)  # now with the seeds of all parts
        pack(target, files_of(studies[0].record))
        merged = StudyResults(target)
        merged.write_tables()
        if analysis is not None:
            target.write_record(ANALYSIS, analysis)
        write_failures(target, failures)
    for folder in (TRIALS, CHOICE):
        if holds_study(stores[0].path / folder):
            merge(target.path / folder, [store.path / folder for store in stores])
    return merged
