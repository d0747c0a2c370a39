"""How far a long function is, and how it is interrupted.

Each such function takes ``progress``: True shows bars on a terminal or in a notebook, and elsewhere
prints a line for each full bar; a function is called with each part of the work when it is done;
False and None do neither.
"""

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from importlib import import_module
from time import monotonic
from typing import Any, Union

import numpy as np
from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress as RichProgress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from curricle.arrays import BoolArray
from curricle.checks import brief
from curricle.errors import SettingError

BETWEEN = 0.2  # seconds between two pictures of the bars in a notebook, at least

Progress = Union[bool, Callable[[Any], Any], "Bars", None]  # bars: the caller's


class Screen(RichProgress):
    """Rich's bars, and below them the text that `line` returns."""

    def __init__(self, console: Console | None = None, line: Callable[[], str] | None = None):
        self.line = line
        console = Console(stderr=True) if console is None else console
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self.in_notebook = console.is_jupyter
        self._place: Any = None
        self._shown = -BETWEEN
        self._printed = dict[TaskID, float | None]()  # the size of a bar when it was last full

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield the bars and the line."""
        yield from super().get_renderables()
        if self.line is not None:
            yield Text(self.line())

    def start(self) -> None:
        """Begin to show the bars; a notebook begins with the first bar."""
        if not self.in_notebook:
            super().start()

    def stop(self) -> None:
        """Take the bars away."""
        if self._place is not None:
            self._place.update({"text/plain": "", "text/html": ""}, raw=True)
        elif not self.in_notebook:
            super().stop()

    def changed(self, task: TaskID) -> None:
        """Show that a bar has grown."""
        row = self.tasks[task]  # no bar is ever taken away
        if not self.in_notebook:
            full = not self.console.is_terminal and row.finished
            if full and self._printed.get(task) != row.total:
                self._printed[task] = row.total
                print(f"{row.description}: {row.completed:,.0f} done", file=sys.stderr, flush=True)
            return
        now = monotonic()
        if self._place is None:
            display: Any = import_module("IPython.display")
            self._place = display.display(self, display_id=True)
        elif now - self._shown >= BETWEEN:
            self._place.update(self)
        else:
            return
        self._shown = now


@dataclass(frozen=True)
class Bars:
    """Where a function shows how far it is: one bar for each part of its work."""

    screen: Screen | None = None  # None where nothing shows the bars
    call: Callable[[Any], Any] | None = None  # the user's function
    prefix: str = ""  # of the names of bars
    rows: dict[str, TaskID] = field(default_factory=dict)

    def bar(self, name: str, total: int | None = None) -> Callable[[], None]:
        """Return a function that makes the bar `name` longer by 1; totals of one name add up."""
        screen, label = self.screen, f"{self.prefix}{name}"
        if screen is None:
            return nothing
        if label not in self.rows:
            self.rows[label] = screen.add_task(label, total=total)
        elif total is not None:
            row = screen.tasks[self.rows[label]]
            screen.update(row.id, total=(row.total or 0) + total)
        task = self.rows[label]
        screen.changed(task)

        def grow() -> None:
            screen.advance(task)
            screen.changed(task)

        return grow

    def at(self, name: str, done: int, total: int | None = None) -> None:
        """Set the bar of work whose size changes, or is not known."""
        grow = self.bar(name)
        if self.screen is not None:
            task = self.rows[f"{self.prefix}{name}"]
            self.screen.update(task, completed=done - 1, total=total)
        grow()

    def tell(self, part: Any) -> None:
        """Call the user's function, if there is any, with a part that is done."""
        if self.call is not None:
            self.call(part)

    def within(self, name: str = "") -> "Bars":
        """Return bars for an inner function, which begin with `name` and call nothing."""
        prefix = f"{self.prefix}{name}: " if name else self.prefix
        return Bars(self.screen, None, prefix, self.rows)


def nothing() -> None:
    """Do nothing, in the place of a bar that nobody sees."""


SILENT = Bars()


@contextmanager
def shown(progress: Progress, line: Callable[[], str] | None = None) -> Iterator[Bars]:
    """Yield the bars that ``progress`` asks for, with `line` below them, until the block ends."""
    check_progress(progress)
    if isinstance(progress, Bars):
        yield progress
    elif progress is True:
        with Screen(line=line) as screen:
            yield Bars(screen)
    else:
        yield Bars(call=progress or None)


def check_progress(progress: Any) -> None:
    """Raise SettingError unless ``progress`` has one of its types."""
    if not (progress is None or isinstance(progress, bool | Bars) or callable(progress)):
        raise SettingError(
            f"progress must be True, False, None or a function: got {brief(progress)}"
        )


# -- interrupts ------------------------------------------------------------------------------------

_NEVER = np.zeros(1, np.bool_)
HALTED: ContextVar[BoolArray] = ContextVar("halted", default=_NEVER)
"""(1,), true once nobody waits for a thread any more: its compiled loops then end."""


@contextmanager
def interruptible(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Yield threads whose compiled loops end when the block is left by an exception."""
    # Python handles a signal in the main thread, and not while that runs compiled code.
    halted = np.zeros(1, np.bool_)
    pool = ThreadPoolExecutor(threads, initializer=HALTED.set, initargs=(halted,))
    try:
        yield pool
    except BaseException:
        halted[0] = True
        raise
    finally:  # a thread that compiles a loop would be waited for long
        pool.shutdown(wait=False, cancel_futures=True)
