"""Running a study from the command line: bars on a terminal, and lines where there is none.

There a line is printed for each unit; in a study of very many, how fast it goes, once a second.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from rich.console import Console

from curricle.cli.compilation import announce_compilation
from curricle.cli.live_page import page_of_run
from curricle.files import Place
from curricle.progress import Bars, shown
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.progress import Pace, Progress, shown_units
from curricle.study.results import StudyResults
from curricle.study.running import run_study
from curricle.study.tuning import with_trials
from curricle.study.workers import WorkerProcesses

MANY = 1_000
"""Units of a study; one with more does not print a line for each."""
BETWEEN = 1.0
"""Seconds between two lines of it at least."""


class Lines:
    """What is printed where there is no terminal: each unit, or at most a line a second of many.

    Of a tuning it is which trials are made. The pace is noted elsewhere.
    """

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
            line = ", ".join(filter(None, [f"done {progress.stored.label}", self.pace.repeated()]))
        elif now - self._printed >= BETWEEN or self.pace.stored == units:
            line, self._printed = self.pace.line(), now
        else:
            return
        print(line, file=sys.stderr, flush=True)


def run_with_bars(
    study: StudyConfig,
    path: str | Place,
    *,
    processes: bool,
    workers: int | None,
    on: str | None,
    page: int | None = None,
    **settings: Any,
) -> StudyResults:
    """Run a study, show its progress, and return its results.

    With a port for its `page`, which may be 0, a browser shows it and the report so far.
    """
    pace = Pace()
    progress = True if Console(stderr=True).is_terminal else Lines(pace).show
    with (
        page_of_run(path, pace, page),
        shown_units(progress, pace, and_compilation(pace.line)) as show,
        ExitStack() as ending,
    ):
        pool: WorkerProcesses | None = None
        if on is None and (
            processes or any(arms.live for arms in with_trials(study, Arms.of(study)))
        ):
            pool = WorkerProcesses(workers)
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        how: dict[str, Any] = {"workers": workers, "executor": pool, "on": on, "progress": show}
        return run_study(study, path, **how, **settings)


@contextmanager
def bars_with_words() -> Iterator[Bars]:
    """Yield bars, below which stands what they were told last, and what is being compiled."""
    words = ""

    def say(part: str) -> None:
        nonlocal words
        words = part

    with shown(True, and_compilation(lambda: words)) as bars:
        yield replace(bars, told=say)


def and_compilation(line: Callable[[], str]) -> Callable[[], str]:
    """Return a line below bars that also says what is compiled, which nothing else says then."""
    compilation = announce_compilation()
    compilation.silent = Console(stderr=True).is_terminal
    return lambda: ", ".join(filter(None, [line(), compilation.words]))
