"""Running a study: its units on any executor, each stored as soon as it is trained.

Parts that were run in several folders are merged into one.
"""

import json
import os
import platform
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from curricle.checks import BEYOND_64_BITS, instance, whole_number
from curricle.errors import SettingError, StoreError
from curricle.interop.trackers import Tracker, open_trackers, to_stderr, tracker_of
from curricle.learning.result import LearningResult
from curricle.progress import check_progress
from curricle.remote_path import Place
from curricle.study.analysis import analyse
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.engines.engine import ExecutorWorkers, Workers
from curricle.study.engines.opening import opened_engine, workers_of
from curricle.study.failures import FAILURES, Failures, read_failures
from curricle.study.packing import Packing, files_of, pack
from curricle.study.progress import Progress, shown_units
from curricle.study.record import RunRecord, plain
from curricle.study.recording import study_record
from curricle.study.results import StudyResults
from curricle.study.resuming import Done, arms_in, different_versions, usable_units
from curricle.study.scheduling import Scheduler
from curricle.study.serialization import UnitResult, result_of, without_snapshots
from curricle.study.store import StoredUnit, StudyStore
from curricle.study.units import Unit, units_of

LIBRARIES = ("curricle", "numpy", "numba", "llvmlite", "gymnasium", "pyarrow", "pydantic")
OF_NETWORKS = ("torch", "stable-baselines3", "sb3-contrib")
"""Optional libraries."""


def run_study(
    study: StudyConfig,
    path: str | Place,
    *,
    resume: bool = False,
    workers: int | None = None,
    executor: Executor | None = None,
    on: str | None = None,
    shard: tuple[int, int] = (1, 1),
    keep_stale: bool = False,
    trackers: Sequence[str | Tracker] = (),
    report: Callable[[str], Any] | None = None,
    progress: bool | Callable[[Progress], Any] | None = True,
) -> StudyResults:
    """Run a study into a folder and return its results.

    Parameters
    ----------
    study : StudyConfig
    path : path or str
        The folder; made if need be. Or a URL, such as "s3://bucket/study".
    resume : bool
        Whether to go on with what the folder holds. A unit is trained if it is not there, if a file
        of it is damaged, or if it is stale: there is one of its task, but that depended on other
        settings, sources or code of the user's own, or on another version of Curricle.
    workers : int, optional
        Threads; as many as there are processors by default, one where a task runs in Python or is
        learnt by a network (use :class:`WorkerProcesses` for those). Results do not depend on it.
    executor : concurrent.futures.Executor, optional
        Trains the units instead; it is not shut down. A unit is a picklable function of picklable
        data (:func:`train_unit`), so processes and other machines can be used.
    on : str, optional
        A cluster that trains the units instead: "dask" or "ray", or one that is there, as in
        "dask://host:8786" or "ray://host:10001". The study's own modules are sent along.
    shard : (int, int)
        (i, n) runs the i-th of n parts of the seeds, i from 1; :func:`merge` puts the folders
        together.
    keep_stale : bool
        Whether to use units that are stale because of code or Curricle's version alone.
    trackers : sequence of str or Tracker
        They get each unit's curves too: "tensorboard", "wandb", "mlflow", or one's own. One that
        fails is reported and switched off; it never stops the run.
    report : callable, optional
        Called with a sentence for each failure of a tracker, and for each task with units that are
        damaged or stale; printed to stderr by default.
    progress : bool or callable, optional
        By default bars for the tasks of each arm, and below them how fast the run goes; a function
        is called with a :class:`Progress` at the beginning and whenever a unit is stored.

    Raises
    ------
    StoreError
        When the folder holds something else, is in use, is damaged or cannot be written to.
    SettingError
        When the arms cannot be compared, workers or shard make no sense, a network is to learn
        and Stable-Baselines3 is not installed, or `on` names no cluster that can be used.
    ConfigError
        When Stable-Baselines3 does not accept a learner's settings.
    StudyError
        When units failed. An arm with one that failed is given up; the others are trained and
        stored before the error is raised, and :class:`StudyResults` reads them. Without scratch or
        an executor nothing more is trained.

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
    instance("study", study, StudyConfig, SettingError)
    check_progress(progress)
    if workers is not None:
        workers = whole_number("workers", workers, 1, SettingError)
    _check_shard(*shard)
    arms = arms_in(study, path, keep_stale=keep_stale)
    _check_networks(study)
    trackers = [tracker_of(each) for each in dict.fromkeys(trackers)]
    configuration, folder = study.to_data(), str(study.folder.resolve())
    description = {
        "curricle": metadata.version("curricle"),
        "configuration": configuration,
        "code": arms.code,
    }
    record = study_record(study, arms)
    described = {**description, "record": plain(record)}
    report = report or to_stderr
    with ExitStack() as ending:
        # first: where a cluster is refused, no folder is made
        places = _workers(study, arms, workers, executor, on, report, ending)
        opened = StudyStore.opened(path, described, resume=resume, check=False)
        store = ending.enter_context(opened)
        done = _begun(store, study, arms, report)
        units = tuple(units_of(study, arms, done, shard))
        beside = store.path if isinstance(store.path, Path) else Path(store.path.name)
        tracking = open_trackers(trackers, study.name, description, beside, report)
        ending.callback(tracking.close)
        given = json.dumps(configuration), folder, json.dumps(arms.code)
        failures, per_file = Failures(arms.keys), files_of(record)
        scheduler = Scheduler(given, arms, Packing(store, done, per_file), places, failures)
        say = ending.enter_context(shown_units(progress))
        say(Progress(units, None, scheduler.number(), places.link))
        for unit, result in scheduler.results(units):
            if trackers:
                tracking.record(unit.arm, unit.task, _learnt(store, arms, unit, result))
            say(Progress(units, unit, scheduler.number(), places.link))
        _write_failures(store, failures.rows())
        if not failures:
            store.remove_checkpoints()
        pack(store, per_file)
        found = StudyResults(path)
        found.write_tables()
        analyse(found, arms)
    if failures:
        raise failures.error()
    return found


def _check_shard(part: int, parts: int) -> None:
    if not 1 <= part <= parts:
        raise SettingError(f"a shard is i of n, i from 1 to n: got {part} of {parts}")


def _check_networks(study: StudyConfig) -> None:
    try:
        study.check_networks()
    except ImportError as error:
        raise SettingError(f"a task is learnt by a network: {error}") from None


def _workers(
    study: StudyConfig,
    arms: Arms,
    workers: int | None,
    executor: Executor | None,
    on: str | None,
    report: Callable[[str], Any],
    ending: ExitStack,
) -> Workers:
    """Return what trains the units of a run; what was started for it ends with it."""
    if on is not None and executor is not None:
        raise SettingError(f"units are trained in one place: got on={on!r} and an executor")
    if on is not None:
        engine = ending.enter_context(opened_engine(on, workers))
        link = f", {engine.link}" if engine.link else ""
        report(f"{on}: {engine.workers()} workers{link}")
        return workers_of(engine, on, arms, study.folder)
    number = workers or os.cpu_count() or 1
    if executor is None:  # do not wait for units whose results would be thrown away
        executor = ThreadPoolExecutor(1 if arms.live else number)
        ending.callback(executor.shutdown, wait=False, cancel_futures=True)
    return ExecutorWorkers(executor, number)


def _begun(store: StudyStore, study: StudyConfig, arms: Arms, report: Callable[[str], Any]) -> Done:
    """Note a run in its folder, and return the units there that it uses."""
    done, remarks = usable_units(store, arms, remove_damaged=True)
    run = _provenance(study)
    for sentence in (*remarks, *different_versions(store.runs(), run)):
        report(sentence)
    store.add_run(run)
    return done


def _learnt(
    store: StudyStore, arms: Arms, unit: Unit, result: UnitResult | StoredUnit
) -> LearningResult:
    if isinstance(result, StoredUnit):
        result = store.result(result, unit.seeds)
    node = arms.curricula[unit.arm].node(unit.task)
    return result_of(result.arrays, node.task, node.learner)


def _write_failures(store: StudyStore, rows: Sequence[dict[str, Any]]) -> None:
    """Write the failures of a run in the place of those of an earlier one."""
    if rows:
        store.write_json(FAILURES, rows)
    else:
        (store.path / FAILURES).unlink(missing_ok=True)


def _provenance(study: StudyConfig) -> RunRecord:
    """Return what a run is made with: versions, kind of machine, the study's file and its commit.

    Nothing in it names the machine, its user or a place on its disk: folders are sent to others.
    """
    versions = {name: metadata.version(name) for name in LIBRARIES}
    for name in OF_NETWORKS:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return RunRecord(
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        file=study.file,
        seeds=study.seeds,
        commit=_commit(study.folder),
        python=platform.python_version(),
        machine=f"{platform.system()} {platform.machine()}",
        versions=versions,
    )


def _commit(folder: Path) -> str | None:
    """Return the Git commit a folder is at, marked if files differ; None if it is in none."""
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None


def merge(path: str | Place, parts: Sequence[str | Place]) -> StudyResults:
    """Merge the parts of a study, run in several folders, into one folder; return its results.

    The parts do not change. A unit that several have is taken once, since equal units have equal
    results.

    Parameters
    ----------
    path : path
        Made if need be; or a folder of the same study, whose units stay.
    parts : sequence of path

    Raises
    ------
    StoreError
        When folders hold different studies, or one is damaged or in use; what was merged before is
        whole then.
    """
    if not parts:
        raise StoreError("there must be at least one folder to merge: got none")
    studies = [StudyResults(part) for part in parts]
    stores = [study.store for study in studies]
    found = [store.units() for store in stores]
    for study, units in zip(studies, found, strict=True):
        stores[0].check(study.store.description)
        if study.record.keys != studies[0].record.keys:
            raise StoreError(
                f"{study.store.path} holds units of other code, kept with --keep-stale: parts that "
                "are merged must be of the same"
            )
        for unit in units:  # damage is found before anything is written
            study.store.result(unit, unit.seeds, study.most_bytes)
    analysis = next(
        (one.analysis for one in sorted(studies, key=_first_seed) if one.analysis), None
    )
    first = min((seed for units in found for unit in units for seed in unit.seeds), default=0)
    for store, units in zip(stores, found, strict=True):
        with StudyStore.opened(path, store.description, resume=True) as target:
            done = target.finished()
            for run in store.runs():
                target.add_run(run)
            for unit in units:
                there = done.setdefault(unit.key, {})
                new = tuple(seed for seed in unit.seeds if seed not in there)
                if new:
                    result = store.result(unit, new)
                    if first not in new:  # a study keeps the snapshots of its first seed alone
                        result = without_snapshots(result)
                    taken = target.write_unit(unit.about.model_copy(update={"seeds": new}), result)
                    there |= dict.fromkeys(new, taken)
            pack(target, files_of(studies[0].record))
            merged = StudyResults(path)
            merged.write_tables()
            if analysis is not None:
                merged.write_analysis(analysis)
    with StudyStore.opened(path, stores[0].description, resume=True) as target:
        _write_failures(target, [row for store in stores for row in read_failures(store)])
    return StudyResults(path)


def _first_seed(study: StudyResults) -> int:
    """Return the first seed that a study has finished; the analysis of the first is that of all."""
    return min(study.seeds, default=BEYOND_64_BITS)
