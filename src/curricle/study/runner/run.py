"""Running a study's units on any executor, storing each as soon as it is there."""

import json
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from curricle.checks import whole_number
from curricle.errors import CurricleError, SettingError, StudyError
from curricle.interop.trackers import Tracker, open_trackers
from curricle.learning.result import LearningResult
from curricle.study.config.study_file import StudyFile
from curricle.study.runner.arms import Arms
from curricle.study.runner.environment import environment
from curricle.study.runner.folder import CHECKPOINTS, Stored, StudyFolder
from curricle.study.runner.serialization import result_of
from curricle.study.runner.source_values import read_by
from curricle.study.runner.stored_sources import finished, stored_knowledge
from curricle.study.runner.study import Study
from curricle.study.runner.unit import Unit, Work, train_unit, units_of

AHEAD = 2
"""Units handed to the executor for each worker, so that none waits for the next."""


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Attributes
    ----------
    left : tuple of Unit
        What was to be done when the run began.
    unit : Unit or None
        What has just been stored; None at the beginning.
    """

    left: tuple[Unit, ...]
    unit: Unit | None = None


def run_study(
    study: StudyFile,
    path: str | Path,
    *,
    resume: bool = False,
    workers: int | None = None,
    executor: Executor | None = None,
    shard: tuple[int, int] = (1, 1),
    trackers: Sequence[str | Tracker] = (),
    report: Callable[[str], Any] | None = None,
    progress: Callable[[Progress], Any] | None = None,
) -> Study:
    """Return a study that was run, and whose results are in a folder.

    Parameters
    ----------
    study : StudyFile
    path : path
        The folder; made if need be.
    resume : bool
        Whether to go on with what the folder holds of this study. More seeds may be asked for than
        before.
    workers : int, optional
        Threads; as many as there are processors by default, one where a task is played live or
        learnt by a network (an executor of processes serves those better). Results do not depend
        on it.
    executor : concurrent.futures.Executor, optional
        Where units are trained instead; it is not shut down. A unit is a picklable function of
        picklable data (:func:`train_unit`), so processes and other machines will do.
    shard : (int, int)
        (i, n) runs the i-th of n parts of the seeds, i from 1; :func:`merge` puts the folders
        together.
    trackers : sequence of str or Tracker
        Who else is told of each unit's curves: "tensorboard", "wandb", "mlflow", or one's own. One
        that fails is reported and switched off; it never stops the run.
    report : callable, optional
        Called with a sentence for each failure of a tracker; printed to stderr by default.
    progress : callable, optional
        Called with a :class:`Progress` at the beginning and whenever a unit is stored.

    Raises
    ------
    StoreError
        When the folder holds something else, is in use, is damaged or cannot be written.
    SettingError
        When the arms cannot be compared, workers or shard make no sense, or a network is to learn
        and Stable-Baselines3 is not installed.
    ConfigError
        When Stable-Baselines3 does not take a learner's settings.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> study = StudyFile.rebuilt(
    ...     {"name": "line", "seeds": [0, 1], "arms": {"transfer": {
    ...         "tasks": {"line": {"type": "maze", "map": "S..T", "budget": 500}}}}}, Path())
    >>> found = run_study(study, Path(mkdtemp()) / "results")
    >>> found.results["scratch"]["line"].steps_used
    array([500, 500])
    """
    workers = (os.cpu_count() or 1) if workers is None else workers
    workers = whole_number("workers", workers, 1, SettingError)
    part, parts = shard
    if not 1 <= part <= parts:
        raise SettingError(f"a shard is i of n, i from 1 to n: got {part} of {parts}")
    arms = Arms.of(study)
    try:
        study.check_networks()
    except ImportError as error:
        raise SettingError(f"a network is to learn: {error}") from None
    given = {
        "curricle": metadata.version("curricle"),
        "folder": str(study.folder.resolve()),
        "configuration": study.resolved(),
    }
    with StudyFolder.opened(path, given, resume=resume) as folder, ExitStack() as ending:
        folder.note(environment(study))
        done = finished(folder.units())
        left = left_to_do(study, arms, done, shard)
        told = open_trackers(trackers, study.document.name, given, folder.path, report)
        ending.callback(told.close)
        tell = progress or (lambda _: None)
        tell(Progress(tuple(left)))
        pool = executor or ThreadPoolExecutor(1 if arms.live else workers)
        if executor is None:  # nobody waits for units whose results would be thrown away
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        turn = _Turn(study, arms, folder, done, pool, workers * AHEAD)
        for unit, result in turn.all(left):
            told.record(unit.arm, unit.node, result)
            tell(Progress(tuple(left), unit))
        shutil.rmtree(folder.path / CHECKPOINTS, ignore_errors=True)
        found = Study(path)
        found.write_tables()
    return found


def left_to_do(
    study: StudyFile,
    arms: Arms,
    done: Mapping[str, Collection[int]],
    shard: tuple[int, int],
) -> list[Unit]:
    """Return the units of a shard, (i, n), for the seeds that are not done, sources first."""
    (part, parts), document = shard, study.document
    seeds = [seed for seed in document.seeds if seed // document.seeds_per_unit % parts == part - 1]
    return units_of(arms, seeds, document.seeds_per_unit, done, document.snapshots)


class _Turn:
    """Units going through an executor, each after its sources."""

    def __init__(
        self,
        study: StudyFile,
        arms: Arms,
        folder: StudyFolder,
        done: dict[str, dict[int, Stored]],
        pool: Executor,
        ahead: int,
    ):
        self.arms, self.folder, self.done = arms, folder, done
        self.pool, self.ahead = pool, ahead
        self.study, self.modules = json.dumps(study.resolved()), str(study.folder.resolve())

    def all(self, left: Iterable[Unit]) -> Iterator[tuple[Unit, LearningResult]]:
        """Yield each unit with its result when it is stored.

        When one fails, no more are begun, and those under way are stored before it is told.
        """
        waiting, running = list(left), dict[Future[Any], Unit]()
        failure: StudyError | None = None
        try:
            while waiting or running:
                for unit in [unit for unit in waiting if self._ready(unit)]:
                    if len(running) >= self.ahead:
                        break
                    waiting.remove(unit)
                    running[self._begun(unit)] = unit
                ended, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in [future for future in running if future in ended]:
                    unit = running.pop(future)
                    try:
                        result = self._stored(unit, future)
                    except StudyError as error:
                        failure, waiting = failure or error, []
                        running = {one: it for one, it in running.items() if not one.cancel()}
                    else:
                        yield unit, result
        finally:
            for future in running:
                future.cancel()
        if failure is not None:
            raise failure

    def _begun(self, unit: Unit) -> "Future[Any]":
        work = self._work(unit)
        try:
            return self.pool.submit(train_unit, work)
        except Exception as error:
            refused: Future[Any] = Future()
            refused.set_exception(error)
            return refused

    def _ready(self, unit: Unit) -> bool:
        return all(
            seed in self.done.get(key, ()) for key in unit.sources.values() for seed in unit.seeds
        )

    def _stored(self, unit: Unit, future: "Future[Any]") -> LearningResult:
        try:
            trained = future.result()
        except Exception as error:
            ours = isinstance(error, CurricleError)
            words = str(error) if ours else f"{type(error).__name__}: {error}"
            raise StudyError(
                f"{unit.words} failed, and what was stored before is whole: {words}"
            ) from (None if ours else error)
        stored = self.folder.write(unit, trained)
        self.done.setdefault(unit.key, {}).update(dict.fromkeys(unit.seeds, stored))
        node = self.arms.curricula[unit.arm].node(unit.node)
        return result_of(node, trained.arrays)

    def _work(self, unit: Unit) -> Work:
        curriculum = self.arms.curricula[unit.arm]
        read = read_by(curriculum, unit.node)
        sources = {
            name: stored_knowledge(self.folder, self.done[key], unit.seeds, read=name in read)
            for name, key in unit.sources.items()
        }
        saves = str(self.folder.saves(unit)) if curriculum.node(unit.node).deep else None
        return Work(self.study, self.modules, unit, sources, saves)
