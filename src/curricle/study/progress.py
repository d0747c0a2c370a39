"""How far a run is, how fast its units are stored, and how long the others will take."""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from time import monotonic
from typing import Any

from curricle.display import brief_repr
from curricle.progress import shown
from curricle.study.units import Unit

WINDOW = 60.0
"""Seconds that the rate is measured over."""
FEWEST = 10
"""Marks that it is measured over at least: units of an hour end less than once a minute."""
BETWEEN = 1.0
"""Seconds between two marks at least."""


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Attributes
    ----------
    units : tuple of Unit
        All that the run trains; the same tuple each time.
    stored : Unit or None
        The unit that has just been stored; None at the beginning.
    workers : int
        How many there are now: those of a cluster come and go.
    link : str or None
        To the cluster's own page, if it has one.

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
    link: str | None = None

    __repr__ = brief_repr


class Pace:
    """The rate at which units were stored in the last minute, and what follows from it.

    Examples
    --------
    >>> from curricle.study.units import Unit
    >>> units = tuple(Unit("0f", "scratch", "maze", (seed,), {}, {}, 0) for seed in range(9))
    >>> now = 0.0
    >>> pace = Pace(lambda: now)
    >>> pace.note(Progress(units, workers=2))
    >>> pace.line()
    '0 of 9 units, 2 workers'
    >>> now = 10.0
    >>> pace.note(Progress(units, units[0], workers=2))
    >>> pace.line()
    '1 of 9 units, 2 workers, 6 units a minute, 0:01:20 left'
    """

    def __init__(self, clock: Callable[[], float] = monotonic):
        self.clock = clock
        self.stored = 0
        self._progress: Progress | None = None
        self._marks = deque[tuple[float, int]]()
        """When so many had been stored, at the beginning of what the rate is measured over."""

    def note(self, progress: Progress) -> None:
        """Note the beginning, or that a unit is stored."""
        self._progress, now = progress, self.clock()
        self.stored += progress.stored is not None
        if not self._marks or now - self._marks[-1][0] >= BETWEEN:
            self._marks.append((now, self.stored))
        while len(self._marks) > FEWEST and self._marks[1][0] <= now - WINDOW:
            self._marks.popleft()

    def rate(self) -> float:
        """Return units a second; 0 until one is stored."""
        if not self._marks:
            return 0.0
        begun, before = self._marks[0]
        passed = self.clock() - begun
        return (self.stored - before) / passed if passed > 0 else 0.0

    def line(self) -> str:
        """Return how far the run is, how fast it goes and when it ends, in words."""
        if self._progress is None:
            return ""
        units, workers = len(self._progress.units), self._progress.workers
        words = [f"{self.stored:,} of {units:,} units"]
        words.append(f"{workers:,} worker{'s' * (workers != 1)}")
        if rate := self.rate():
            words.append(_in_words(rate))
            if left := units - self.stored:
                words.append(f"{timedelta(seconds=round(left / rate))} left")
        return ", ".join([*words, *filter(None, [self._progress.link])])


@contextmanager
def shown_units(
    progress: bool | Callable[[Progress], Any] | None,
) -> Iterator[Callable[[Progress], None]]:
    """Yield what takes each :class:`Progress` of a run and shows it as ``progress`` asks for.

    Bars are of all seeds of a task in an arm; below them stands how fast the whole run goes.
    """
    pace = Pace()
    grow: dict[tuple[str, str], Callable[[], None]] = {}
    with shown(progress, pace.line) as bars:

        def show(now: Progress) -> None:
            pace.note(now)
            if now.stored is None:
                seeds = Counter[tuple[str, str]]()
                for unit in now.units:
                    seeds[unit.arm, unit.task] += len(unit.seeds)
                for (arm, task), total in seeds.items():
                    grow[arm, task] = bars.bar(f"{arm}: {task}", total)
            else:
                for _ in now.stored.seeds:
                    grow[now.stored.arm, now.stored.task]()
                if pace.stored == len(now.units):
                    bars.bar("forecasts and certificates")
            bars.tell(now)

        yield show


def _in_words(rate: float) -> str:
    """Return units a second, or a minute or an hour if that is a number of at least one.

    Examples
    --------
    >>> _in_words(1234.5), _in_words(0.5), _in_words(0.0001)
    ('1,234 units a second', '30 units a minute', '0.36 units an hour')
    """
    each = (("a second", 1), ("a minute", 60), ("an hour", 3600))
    time, seconds = next((one for one in each if rate * one[1] >= 1), each[-1])
    number = rate * seconds
    text = f"{number:,.0f}" if number >= 100 else f"{number:.2g}"
    return f"{text} unit{'s' * (text != '1')} {time}"
