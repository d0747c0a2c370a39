"""How far a run is, how fast units are stored, and how long the remaining units will take."""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from time import monotonic
from typing import Any

from curricle.comparison.plan import Unit
from curricle.progress import shown
from curricle.text import brief_repr, counted

WINDOW = 60.0  # seconds that the rate is measured over
FEWEST = 10  # marks that it is measured over at least: units of an hour end less than once a minute
BETWEEN = 1.0  # seconds between two marks at least


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
    repeated : int
        Units that a cluster has begun again so far, because a worker died.
    link : str or None
        Link to the cluster's own page, if it has a page.
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
    repeated: int = 0
    link: str | None = None
    tuning: str = ""

    __repr__ = brief_repr


class Pace:
    """The rate at which units were stored in the last minute, and the remaining time."""

    def __init__(self, clock: Callable[[], float] = monotonic):
        self.clock = clock
        self.stored = 0
        self._units: int | None = None
        self._last: Progress | None = None
        self._marks = deque[tuple[float, int]]()  # (time, units stored)

    def note(self, progress: Progress) -> None:
        """Record the beginning of a run, or a stored unit."""
        self._units, self._last = len(progress.units), progress
        if progress.stored is None:  # further units, after those of a tuning
            self._marks.clear()
        self._mark(0 if progress.stored is None else self.stored + 1)

    def line_of(self, stored: int, units: int) -> str:
        """Record the units that another process has stored in a folder, and return the line."""
        if self._units is None or stored != self.stored:
            self._mark(stored)
        self._units = units
        return self.line()

    def line_in(self, stored: int, units: int) -> str:
        """Return the line of a run whose folder also gets units from other processes."""
        tuning = self._last is not None and bool(self._last.tuning)
        if not units or (self._units == units and not tuning):
            return self.line()
        whole = f"{stored:,} of {counted(units, 'unit')}"
        if self._units is None:
            return whole
        return f"{whole}; {'its tuning' if tuning else 'this run'}: {self.line()}"

    def _mark(self, stored: int) -> None:
        """Record the number of units stored now."""
        self.stored, now = stored, self.clock()
        if not self._marks or now - self._marks[-1][0] >= BETWEEN:
            self._marks.append((now, self.stored))
        while len(self._marks) > FEWEST and self._marks[1][0] <= now - WINDOW:
            self._marks.popleft()

    def rate(self) -> float:
        """Return the units stored a second; 0 until a unit is stored."""
        if not self._marks:
            return 0.0
        begun, before = self._marks[0]
        passed = self.clock() - begun
        return (self.stored - before) / passed if passed > 0 else 0.0

    def line(self) -> str:
        """Return a line on how far the run is, how fast it goes and when it ends."""
        if self._units is None:
            return ""
        parts = [f"{self.stored:,} of {counted(self._units, 'unit')}"]
        if self._last is not None:
            parts.append(counted(self._last.workers, "worker"))
        if rate := self.rate():
            parts.append(_in_words(rate))
            if left := self._units - self.stored:
                parts.append(f"{timedelta(seconds=round(left / rate))} left")
        link = "" if self._last is None else self._last.link or ""
        return ", ".join(filter(None, [*parts, self.repeated(), link]))

    def repeated(self) -> str:
        """Return a text on the units that were begun again; empty if there are none."""
        number = 0 if self._last is None else self._last.repeated
        return f"{counted(number, 'unit')} begun again" if number else ""


@contextmanager
def shown_units(
    progress: bool | Callable[[Progress], Any] | None,
    pace: Pace | None = None,
    line: Callable[[], str] | None = None,
) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that shows each :class:`Progress` of a run as ``progress`` asks for."""
    # Below the bars stands a `line`, by default how fast the whole run goes, its `pace`.
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


def _in_words(rate: float) -> str:
    """Return a rate as text, in units a second, a minute or an hour: the first of at least 1."""
    period, seconds = "an hour", 3600
    for longer, length in (("a minute", 60), ("a second", 1)):
        if rate * length >= 1:
            period, seconds = longer, length
    number = rate * seconds
    text = f"{number:,.0f}" if number >= 100 else f"{number:.2g}"
    return f"{text} unit{'s' * (text != '1')} {period}"
