"""How far a long function is, and how it is interrupted.

Each such function takes ``progress``. By default, None, it shows bars after two seconds on a
terminal or in a notebook, and nothing elsewhere. True shows them at once, and elsewhere prints a
line for each full bar; a function is called with each part of the work when it is done, and nothing
is shown; False is silent. What runs inside another such function shows its bars among those.
"""

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from threading import Event, Thread, current_thread, main_thread
from time import monotonic
from typing import Any, Union

import numpy as np
from numba.core import event
from numba.core.caching import NullCache
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
BETWEEN_LINES = 10.0  # seconds between two lines where there are no bars, at least
DELAY = 2.0  # seconds before bars are shown by default

Progress = Union[bool, Callable[[Any], Any], "Bars", None]  # bars: the caller's

# -- Saying that loops are compiled, which happens once for each kind of task and learner ----------

EVENT = "numba:compile"
ONCE, EACH_TIME = "compiling, once", "compiling what is not kept on disk, at each start"
KEPT = f"curricle: {ONCE}; what is compiled is kept, so that later runs start at once"


class Compilation(event.Listener):
    """Counts compiled loops for the line below bars; commands have it print where none are."""

    def __init__(self) -> None:
        self.loops, self.line, self.prints = 0, "", False
        self.screens, self.noted = 0, -np.inf  # how many show the line; when `note` last printed
        self._depth = 0  # Numba compiles in one thread at a time

    def on_start(self, event: Any) -> None:
        """Count a loop, but not its parts."""
        self._depth += 1
        if self._depth > 1:
            return
        self.loops += 1
        unkept = isinstance(event.data["dispatcher"]._cache, NullCache)
        self.line = f"{EACH_TIME if unkept else ONCE}: {self.loops}"
        self._write(f"\r{self.line}")
        if self.prints and self.loops == 1 and not sys.stderr.isatty():
            print(f"curricle: {EACH_TIME}" if unkept else KEPT, file=sys.stderr, flush=True)

    def on_end(self, event: object) -> None:
        """Erase the line when a loop is compiled."""
        self._depth -= 1
        if not self._depth:
            self._write(f"\r{' ' * len(self.line)}\r")
            self.line = ""

    def note(self, text: str, wait: float = 0.0) -> None:
        """Print a line of a command, unless it printed one `wait` seconds ago."""
        if self.prints and monotonic() - self.noted >= wait:
            self.noted = monotonic()
            print(f"curricle: {text}", file=sys.stderr, flush=True)

    def _write(self, text: str) -> None:
        if self.prints and not self.screens and sys.stderr.isatty():
            print(text, end="", file=sys.stderr, flush=True)


@cache
def compilation() -> Compilation:
    """Return what counts the loops that are compiled from the first call on."""
    listener = Compilation()
    register: Any = event.register
    register(EVENT, listener)
    return listener


class Screen(RichProgress):
    """Rich's bars, and below them what is compiled and the text that `line` returns.

    They are shown after `delay` seconds, and with a delay they leave nothing behind.
    """

    def __init__(
        self,
        console: Console | None = None,
        line: Callable[[], str] | None = None,
        delay: float = 0.0,
    ):
        self.line, self.delay = line, delay
        self.parts = dict[TaskID, Callable[[], float]]()  # share of a bar's next step that is done
        self._ended = Event()
        self._thread: Thread | None = None
        console = Console(stderr=True) if console is None else console
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=delay > 0,
        )
        self.in_notebook = console.is_jupyter
        self._place: Any = None
        self._shown = -BETWEEN
        self._printed = dict[TaskID, float | None]()  # the size of a bar when it was last full

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield the bars and the line."""
        for task, part in [*self.parts.items()]:  # another thread may add a bar meanwhile
            row = self.tasks[task]
            self.update(task, completed=int(row.completed) + min(part(), 0.99))
        yield from super().get_renderables()
        texts = "" if self.line is None else self.line(), compilation().line
        if text := ", ".join(filter(None, texts)):
            yield Text(text)

    def start(self) -> None:
        """Begin to show the bars; a notebook begins with the first bar."""
        compilation().screens += 1
        self._begun = monotonic()
        if self.delay or self.in_notebook:
            self._thread = Thread(target=self._show_later, daemon=True)
            self._thread.start()
        else:
            super().start()

    def _show_later(self) -> None:
        """Show the bars after the delay; a notebook's also where no bar grows for a while."""
        if self._ended.wait(self.delay):
            return
        if not self.in_notebook:
            super().start()
        while self.in_notebook and not self._ended.wait(max(BETWEEN, 1.0)):
            self._draw()

    def stop(self) -> None:
        """Take the bars away."""
        compilation().screens -= 1
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
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
        self._draw()

    def _draw(self) -> None:
        """Show the bars in a notebook as they are, unless that was just done."""
        now = monotonic()
        if now - self._begun < self.delay:
            return
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
            screen.update(row.id, total=(row.total or 0) + total, visible=True)
        task = self.rows[label]
        screen.changed(task)

        def grow() -> None:
            screen.update(task, completed=int(screen.tasks[task].completed) + 1)
            screen.changed(task)

        return grow

    def partly(self, name: str, part: Callable[[], float]) -> None:
        """Have the bar `name` add the share of its next step that is done, as `part` returns it."""
        if self.screen is not None:
            self.screen.parts[self.rows[f"{self.prefix}{name}"]] = part

    def say(self, sentence: str) -> None:
        """Print a sentence, if any, above the bars at once, or as a command does without bars."""
        if self.screen is not None and sentence:
            self.screen.console.print(sentence, markup=False, highlight=False)
        elif sentence:
            compilation().note(sentence)

    def at(self, name: str, done: int, total: int | None = None, text: str = "") -> None:
        """Set the bar of work whose size changes, or is not known, maybe with a text beside it."""
        grow = self.bar(name)
        if self.screen is not None:
            row, description = self.rows[f"{self.prefix}{name}"], f"{self.prefix}{text or name}"
            self.screen.update(row, completed=done - 1, total=total, description=description)
        elif text:
            compilation().note(text, wait=BETWEEN_LINES)
        grow()

    def tell(self, part: object) -> None:
        """Call the user's function, if there is any, with a part that is done."""
        if self.call is not None:
            self.call(part)

    def within(self, name: str = "") -> "Bars":
        """Return bars for an inner function, which begin with `name` and call nothing."""
        prefix = f"{self.prefix}{name}: " if name else self.prefix
        return Bars(self.screen, None, prefix, self.rows)


def nothing() -> None:
    """Do nothing, in the place of a bar that nobody sees."""


_AROUND: ContextVar[Bars | None] = ContextVar("bars", default=None)
"""The bars of the function that calls, in the same thread."""


@contextmanager
def shown(progress: Progress, line: Callable[[], str] | None = None) -> Iterator[Bars]:
    """Yield the bars that ``progress`` asks for, with `line` below them, until the block ends."""
    check_progress(progress)
    inner, rows = None if progress is not None else _AROUND.get(), set[str]()
    if isinstance(progress, Bars):
        bars = progress
    elif inner is not None:
        bars = inner.within()
        rows = {*bars.rows}
    elif progress is True or (progress is None and _watched()):
        bars = Bars(Screen(line=line, delay=0.0 if progress else DELAY))
    else:
        bars = Bars(call=progress or None)
    before = _AROUND.set(bars)
    try:
        others = inner is not None or isinstance(progress, Bars)  # the caller shows them
        with nullcontext() if others or bars.screen is None else bars.screen:
            yield bars
    finally:
        _AROUND.reset(before)
        if inner is not None and bars.screen is not None:
            for label in bars.rows.keys() - rows:  # steps on the way, of no interest afterwards
                bars.screen.update(bars.rows[label], visible=False)


def _watched() -> bool:
    """Return whether somebody may watch: this is the main thread at a terminal or in a notebook."""
    shows = "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())
    return shows and current_thread() is main_thread()


def check_progress(progress: object) -> None:
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
