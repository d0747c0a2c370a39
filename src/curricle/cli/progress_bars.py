"""Running a study with progress bars on the terminal, one for each task of each arm."""

import sys
from collections import Counter
from contextlib import ExitStack
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress as Bars,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from curricle.remote_path import Place
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.running import Progress, run_study
from curricle.study.workers import WorkerProcesses


def run_with_bars(
    study: StudyConfig,
    path: str | Place,
    *,
    processes: bool,
    workers: int | None,
    on: str | None,
    **settings: Any,
) -> None:
    """Run a study and show its progress; the time left is for all seeds of a task."""
    console = Console(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    description = TextColumn("{task.description}", markup=False)
    bars = Bars(description, *columns, console=console, disable=not console.is_terminal)
    rows: dict[tuple[str, str], Any] = {}

    def show(progress: Progress) -> None:
        unit = progress.stored
        if unit is None:
            seeds = Counter[tuple[str, str]]()
            for one in progress.units:
                seeds[one.arm, one.task] += len(one.seeds)
            for (arm, task), total in seeds.items():
                rows[arm, task] = bars.add_task(f"{arm}: {task}", total=total)
        else:
            bars.advance(rows[unit.arm, unit.task], len(unit.seeds))
            if bars.finished:
                bars.add_task("forecasts and certificates", total=None)
            if not console.is_terminal:
                print(f"done {unit.label}", file=sys.stderr, flush=True)

    with bars, ExitStack() as ending:
        pool: WorkerProcesses | None = None
        if on is None and (processes or Arms.of(study).live):
            pool = WorkerProcesses(workers)
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        run_study(study, path, workers=workers, executor=pool, on=on, progress=show, **settings)
