"""How far a run is, and how long the remaining units will take."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from time import monotonic
from typing import Any

from curricle.comparison.plan import Unit
from curricle.progress import shown
from curricle.text import brief_repr, counted


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Attributes
    ----------
    units : tuple of Unit
        All units that the run trains; the same tuple each time.
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
    """How many units are stored, and about how long the others take."""

    def __init__(self, clock: Callable[[], float] = monotonic):
        self.clock, self.stored, self.units = clock, 0, 0
        self._workers, self._begun = 0, (clock(), 0)  # time, and units stored then

    def note(self, progress: Progress) -> None:
        """Record the beginning of a run, or a stored unit."""
        self.units, self._workers = len(progress.units), progress.workers
        self.stored = 0 if progress.stored is None else self.stored + 1
        if progress.stored is None:  # or further units, after those of a tuning
            self._begun = self.clock(), 0

    def line_of(self, stored: int, units: int) -> str:
        """Record the units that another process has stored in a folder, and return the line."""
        if not self.units:
            self._begun = self.clock(), stored
        self.stored, self.units = stored, units
        return self.line()

    def line(self) -> str:
        """Return a line on how far the run is, and when it ends at its pace since it began."""
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
    """Yield a function that shows each :class:`Progress` of a run as ``progress`` asks for."""
    # Below the bars stands a `line`, by default how far the whole run is, its `pace`.
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
