"""Running a study with progress bars on the terminal, one for each task of each arm.

Below them stands how fast the whole run goes. Where stderr is no terminal, a line is printed for
each unit; in a study of very many, how fast it goes, once a second.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress as Bars,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from curricle.cli.compilation import announce_compilation
from curricle.cli.live_page import page_of_run
from curricle.cli.pace import Pace
from curricle.remote_path import Place
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.running import Progress, run_study
from curricle.study.units import Unit
from curricle.study.workers import WorkerProcesses

MANY = 1_000
"""Units of a study; one with more does not print a line for each."""
BETWEEN = 1.0
"""Seconds between two lines of it at least."""


class CompilationColumn(ProgressColumn):
    """What is being compiled."""

    def __init__(self) -> None:
        super().__init__()
        self.compilation = announce_compilation()
        self.compilation.aside = sys.stdout.isatty()

    def render(self, task: Task) -> Text:
        """Return it as text."""
        return Text(self.compilation.words)


class BarsAndPace(Bars):
    """Bars, and below them a line on the whole run and on what is being compiled."""

    def __init__(self, pace: Pace, *columns: ProgressColumn, console: Console):
        self.pace, self.compilation = pace, announce_compilation()
        self.compilation.aside = console.is_terminal
        super().__init__(*columns, console=console, disable=not console.is_terminal)

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield the bars and the line."""
        yield from super().get_renderables()
        yield Text(", ".join(filter(None, [self.pace.line(), self.compilation.words])))


class Lines:
    """What is printed where there is no terminal: each unit, or at most a line a second of many."""

    def __init__(self, pace: Pace):
        self.pace = pace
        self._printed = -BETWEEN

    def show(self, progress: Progress) -> None:
        """Print a line about the unit that was stored, if it is time for one."""
        units, now = len(progress.units), self.pace.clock()
        if progress.stored is None:
            return
        if units <= MANY:
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
) -> None:
    """Run a study and show its progress; the time left is for all seeds of a task.

    With a port for its `page`, which may be 0, a browser shows it and the report so far.
    """
    console = Console(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    description = TextColumn("{task.description}", markup=False)
    pace = Pace()
    bars, lines = BarsAndPace(pace, description, *columns, console=console), Lines(pace)
    rows: dict[str, Any] = {}

    def show(progress: Progress) -> None:
        pace.note(progress)
        unit = progress.stored
        if unit is None:
            seeds = Counter[str]()
            for one in progress.units:
                seeds[_row(progress, one)] += len(one.seeds)
            for row, total in seeds.items():
                rows[row] = bars.add_task(row, total=total)
            if progress.tuning and not console.is_terminal:
                print(progress.tuning, file=sys.stderr, flush=True)
        else:
            bars.advance(rows[_row(progress, unit)], len(unit.seeds))
            if bars.finished and not progress.tuning:
                bars.add_task("forecasts and certificates", total=None)
            if not (console.is_terminal or progress.tuning):
                lines.show(progress)

    with page_of_run(path, pace, page), bars, ExitStack() as ending:
        pool: WorkerProcesses | None = None
        if on is None and (processes or Arms.of(study).live):
            pool = WorkerProcesses(workers)
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        run_study(study, path, workers=workers, executor=pool, on=on, progress=show, **settings)


def _row(progress: Progress, unit: Unit) -> str:
    """Return the name of a unit's row: all trials of a tuning that are made at once share one."""
    return progress.tuning or f"{unit.arm}: {unit.task}"
