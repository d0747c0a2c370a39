"""Sending the units of a study to workers, in the order that their sources allow.

Which worker trains a unit, and what happens when one dies, is the business of whatever runs them.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from heapq import heappop, heappush
from math import inf
from time import monotonic
from typing import Any

from curricle.curriculum.result import StoredValues, sources_read
from curricle.errors import LostStoreError
from curricle.study.arms import Arms
from curricle.study.engines.engine import Workers
from curricle.study.packing import Packing, Taken
from curricle.study.store import Failures, StoredSource, stored_values
from curricle.study.units import Unit, UnitInput

AHEAD = 2
"""Units submitted for each worker, so that none is idle between two."""
ASKED_AGAIN = 2.0
"""Seconds after which the number of workers is asked again: it may grow, and a cluster's answer
takes about as long as a small unit."""


class Queue:
    """Units that are still to be sent: the first of those whose sources are trained comes first.

    All of a unit, from waiting to being sent, costs time in the logarithm of their number and in
    its own sources and seeds alone.

    `done` has the seeds that are trained, by key.
    """

    def __init__(self, units: Iterable[Unit], done: Mapping[str, Collection[int]]):
        self.units = list(units)
        self.ready = list[int]()
        """A heap of the numbers of units that can be sent."""
        self._missing = list[int]()
        """How many pairs of a source and a seed each unit waits for."""
        self._waiting = dict[tuple[str, int], list[int]]()
        """Key and seed of a source -> numbers of the units that wait for it."""
        for number, unit in enumerate(self.units):
            missing = {
                (key, seed)
                for key in unit.sources.values()
                for seed in unit.seeds
                if seed not in done.get(key, ())
            }
            self._missing.append(len(missing))
            for pair in missing:
                self._waiting.setdefault(pair, []).append(number)
            if not missing:
                self.ready.append(number)  # ascending, and so a heap

    def pop(self) -> Unit:
        """Return the next unit to be sent."""
        return self.units[heappop(self.ready)]

    def trained(self, unit: Unit) -> None:
        """Note that a unit is stored: others may have waited for it alone."""
        for seed in unit.seeds:
            for number in self._waiting.pop((unit.key, seed), ()):
                self._missing[number] -= 1
                if not self._missing[number]:
                    heappush(self.ready, number)


@dataclass
class Scheduler:
    """Sends units to workers, each after its sources, and stores their results."""

    study: tuple[str, str, str]
    """As :func:`given_to_all`."""
    arms: Arms
    packing: Packing
    workers: Workers
    failures: Failures
    _number: int = field(default=0, init=False)
    _asked: float = field(default=-inf, init=False)

    def number(self) -> int:
        """Return how many workers there are, or were a moment ago."""
        if monotonic() - self._asked >= ASKED_AGAIN:
            self._number, self._asked = self.workers.number(), monotonic()
        return self._number

    def results(self, units: Iterable[Unit]) -> Iterator[Taken]:
        """Yield each unit with its result when it is stored.

        When one fails, no more are started that only arms with a failure need.
        """
        queue, running = Queue(units, self.packing.done), dict[Future[Any], Unit]()
        try:
            while queue.ready or running or self.packing:
                self._submit(queue, running)
                idle = not queue.ready  # others may wait for what was trained
                limit = self.packing.seconds if self.packing else ASKED_AGAIN
                ended, _ = wait(running, min(limit, ASKED_AGAIN), FIRST_COMPLETED)
                for future in [future for future in running if future in ended]:
                    if future in running:  # not cancelled, since one before it failed
                        self._end(future, running)
                if idle or not self.packing.seconds:
                    for unit, result in self.packing.write():
                        queue.trained(unit)
                        yield unit, result
        finally:
            for future in running:
                future.cancel()
            self.packing.write()

    def _submit(self, queue: Queue, running: dict["Future[Any]", Unit]) -> None:
        # one at least: some clusters start workers when there is work
        ahead = AHEAD * max(1, self.number())
        while queue.ready and len(running) < ahead:
            unit = queue.pop()
            if self.failures.keeps(unit):
                running[self._train(unit)] = unit

    def _end(self, future: "Future[Any]", running: dict["Future[Any]", Unit]) -> None:
        """Take the result of a unit that has ended, or cancel what needs it."""
        unit = running.pop(future)
        if (error := self._error_of(future)) is None:
            self.packing.add(unit, future.result())
            return
        self.failures.add(unit, error)
        for other, one in [*running.items()]:
            if not self.failures.keeps(one) and other.cancel():
                del running[other]

    def _train(self, unit: Unit) -> "Future[Any]":
        """Send a unit; workers that see the study's files read and write large ones themselves."""
        packing, curriculum = self.packing, self.arms.curricula[unit.arm]
        values, stored = dict[str, StoredValues](), dict[str, StoredSource]()
        read, seen = sources_read(curriculum, unit.task), self.workers.see(packing.store.path)
        for name, key in unit.sources.items():
            units = {seed: packing.done[key][seed] for seed in unit.seeds}
            if seen and packing.is_large(key, unit.seeds):
                stored[name] = StoredSource(units, name in read)
            else:
                values[name] = stored_values(packing.arrays, units, unit.seeds, read=name in read)
        kept = curriculum.node(unit.task).deep and (seen or self.workers.share_folders)
        checkpoints = packing.store.checkpoints(unit) if kept else None
        given = UnitInput(*self.study, unit, values, checkpoints)
        written = seen and packing.is_large(unit.key, unit.seeds)
        return self.workers.train(given, stored, packing.store.path if written else None)

    def _error_of(self, future: "Future[Any]") -> Exception | None:
        """Return why a unit failed, if it did; an interrupt and a lost store are raised."""
        if future.cancelled():
            return self.workers.lost()
        error = future.exception()
        if isinstance(error, LostStoreError) or not isinstance(error, Exception | None):
            raise error
        return error
