"""Running a study from the command line: bars, lines, what is compiled, and the page of the run.

Without a terminal it prints a line for each unit, or at most a line a second on their pace.
"""

import os
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from subprocess import Popen
from tempfile import mkdtemp
from threading import Thread
from typing import Any

import typer
from rich.console import Console

from curricle.files import Place, place_at
from curricle.progress import Bars, compilation, shown
from curricle.study.arms import Arms
from curricle.study.config import StudyConfig
from curricle.study.results import StudyResults
from curricle.study.running import Pace, Progress, run_study, shown_units
from curricle.study.tuning import with_trials
from curricle.study.workers import WorkerProcesses

# -- Running a study from the command line: bars on a terminal, and lines where there is none ------

MANY = 1_000  # units of a study; one with more does not print a line for each
BETWEEN = 1.0  # seconds between two lines of it at least


class Lines:
    """Prints a line for each unit or second where there is no terminal; trials of a tuning too."""

    def __init__(self, pace: Pace):
        self.pace = pace
        self._printed = -BETWEEN

    def show(self, progress: Progress) -> None:
        """Print a line about the unit that was stored, if it is time for one."""
        units, now = len(progress.units), self.pace.clock()
        if progress.stored is None and progress.tuning:
            line = progress.tuning
        elif progress.stored is None or progress.tuning:
            return
        elif units <= MANY:
            line = f"done {progress.stored.label}"
        elif now - self._printed >= BETWEEN or self.pace.stored == units:
            line, self._printed = self.pace.line(), now
        else:
            return
        print(line, file=sys.stderr, flush=True)


def run_with_bars(
    study: StudyConfig,
    path: str | Place,
    *,
    processes: bool = False,
    workers: int | None = None,
    on: str | None = None,
    page: bool = False,
    **settings: Any,
) -> StudyResults:
    """Run a study, show its progress and, with `page`, its report so far; return its results."""
    compilation().prints = True
    pace, watchers = Pace(), list[Popen[bytes]]()
    progress = True if Console(stderr=True).is_terminal else Lines(pace).show
    with ExitStack() as ending:
        show_units = ending.enter_context(shown_units(progress, pace, pace.line))

        def show(progress: Progress) -> None:
            show_units(progress)
            if page and not watchers:  # not before: a folder that a run is refused stays as it is
                from curricle.show.report import default_page  # with Matplotlib

                out = default_page(place_at(path))
                command = [sys.executable, "-m", "curricle", "watch", str(path), "--out", str(out)]
                watchers.append(ending.enter_context(Popen(command)))  # which ends as the run does

        if on is None and (
            processes or any(arms.serial for arms in with_trials(study, Arms.of(study)))
        ):
            settings["executor"] = pool = WorkerProcesses(workers)
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        return run_study(study, path, workers=workers, on=on, progress=show, **settings)


def watch_results(folder: str, out: Path | None) -> None:
    """Show the report of a folder until the run, of another process, is over."""
    from curricle.show.report import InterimReport, default_page  # with Matplotlib

    if out is None:
        out = Path(mkdtemp(prefix="curricle-")) / default_page(place_at(folder)).name
    InterimReport(folder, Pace().line_of, _complain, open_page, out).watch()
    typer.echo(f"The run is over: {out}")


def open_page(path: Path) -> None:
    """Print where a page is, and open it where there is a browser with windows."""
    typer.echo(f"Open {path}: it is written anew as units end, and read again by itself.")
    if has_windows():  # not waited for: some browsers end when they are closed
        address = path.resolve().as_uri()
        Thread(target=webbrowser.open, args=(address,), daemon=True).start()


def has_windows() -> bool:
    """Return whether a browser would have a window: in the terminal it would hide the run."""
    if sys.platform in ("win32", "darwin"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def _complain(sentence: str) -> None:
    typer.echo(f"curricle: {sentence}", err=True)


@contextmanager
def bars_with_words() -> Iterator[Bars]:
    """Yield bars with a line below them: the latest message, and what is being compiled."""
    compilation().prints = True
    last = ""

    def say(part: str) -> None:
        nonlocal last
        last = part

    with shown(True, lambda: last) as bars:
        yield replace(bars, call=say)
