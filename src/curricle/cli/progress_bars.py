"""Running a study from the command line: bars on a terminal, and lines where there is none.

There a line is printed for each unit; in a study of very many, how fast it goes, once a second.
"""

import sys
from contextlib import ExitStack
from typing import Any

from rich.console import Console

from curricle.remote_path import Place
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.progress import Pace, Progress
from curricle.study.running import run_study
from curricle.study.workers import WorkerProcesses

MANY = 1_000
"""Units of a study; one with more does not print a line for each."""
BETWEEN = 1.0
"""Seconds between two lines of it at least."""


class Lines:
    """What is printed where there is no terminal: each unit, or at most a line a second of many."""

    def __init__(self, pace: Pace):
        self.pace = pace
        self._printed = -BETWEEN

    def show(self, progress: Progress) -> None:
        """Print a line about the unit that was stored, if it is time for one."""
        self.pace.note(progress)
        units, now = len(progress.units), self.pace.clock()
        if progress.stored is None:
            return
        if units <= MANY:
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
    processes: bool,
    workers: int | None,
    on: str | None,
    **settings: Any,
) -> None:
    """Run a study and show its progress."""
    progress = True if Console(stderr=True).is_terminal else Lines(Pace()).show
    with ExitStack() as ending:
        pool: WorkerProcesses | None = None
        if on is None and (processes or Arms.of(study).live):
            pool = WorkerProcesses(workers)
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        run_study(study, path, workers=workers, executor=pool, on=on, progress=progress, **settings)
