"""Sending the units of a study to workers, in the order that their sources allow.

Which worker trains a unit, and what happens when one dies, is the business of whatever runs them.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any

from curricle.learning.result import LearningResult
from curricle.study.arms import Arms
from curricle.study.engines.engine import Workers
from curricle.study.failures import Failures
from curricle.study.resuming import Done
from curricle.study.serialization import UnitResult, result_of
from curricle.study.source_values import sources_read
from curricle.study.store import StudyStore
from curricle.study.stored_values import stored_values
from curricle.study.units import Unit, UnitInput

AHEAD = 2
"""Units submitted for each worker, so that none is idle between two."""
ASKED_AGAIN = 2.0
"""Seconds after which the number of workers is asked again if no unit has ended: it may grow."""


@dataclass(frozen=True)
class Scheduler:
    """Sends units to workers, each after its sources, and stores their results."""

    study: tuple[str, str, str]
    """The first fields of :class:`UnitInput`."""
    arms: Arms
    store: StudyStore
    done: Done
    workers: Workers
    failures: Failures

    def results(self, units: Iterable[Unit]) -> Iterator[tuple[Unit, LearningResult]]:
        """Yield each unit with its result when it is stored.

        When one fails, no more are started that only arms with a failure need.
        """
        waiting, running = list(units), dict[Future[Any], Unit]()
        try:
            while waiting or running:
                # one at least: some clusters start workers when there is work
                ahead = AHEAD * max(1, self.workers.number())
                for unit in [unit for unit in waiting if self._ready(unit)]:
                    if len(running) >= ahead:
                        break
                    waiting.remove(unit)
                    running[self.workers.train(self._input(unit))] = unit
                ended, _ = wait(running, ASKED_AGAIN, FIRST_COMPLETED)
                for future in [future for future in running if future in ended]:
                    if future not in running:  # cancelled, since one before it failed
                        continue
                    unit = running.pop(future)
                    if (error := self._error_of(future)) is None:
                        yield unit, self._store(unit, future.result())
                    else:
                        self.failures.add(unit, error)
                        waiting = self.failures.left(waiting)
                        kept = self.failures.left(running.values())
                        running = {
                            one: it for one, it in running.items() if it in kept or not one.cancel()
                        }
        finally:
            for future in running:
                future.cancel()

    def _ready(self, unit: Unit) -> bool:
        """Return whether all sources of a unit are trained."""
        return all(
            seed in self.done.get(key, ()) for key in unit.sources.values() for seed in unit.seeds
        )

    def _input(self, unit: Unit) -> UnitInput:
        curriculum = self.arms.curricula[unit.arm]
        read = sources_read(curriculum, unit.task)
        sources = {
            name: stored_values(self.store, self.done[key], unit.seeds, read=name in read)
            for name, key in unit.sources.items()
        }
        deep = curriculum.node(unit.task).deep
        kept = deep and self.workers.share_folders
        checkpoints = str(self.store.checkpoints(unit)) if kept else None
        return UnitInput(*self.study, unit, sources, checkpoints)

    def _store(self, unit: Unit, result: UnitResult) -> LearningResult:
        stored = self.store.write_unit(unit, result)
        self.done.setdefault(unit.key, {}).update(dict.fromkeys(unit.seeds, stored))
        node = self.arms.curricula[unit.arm].node(unit.task)
        return result_of(result.arrays, node.task, node.learner)

    def _error_of(self, future: "Future[Any]") -> Exception | None:
        """Return why a unit failed, if it did; an interrupt is raised."""
        if future.cancelled():
            return self.workers.lost()
        error = future.exception()
        if error is not None and not isinstance(error, Exception):
            raise error
        return error
