"""Running a study with progress bars on the terminal, one for each task of each arm."""

import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path
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

from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.running import Progress, run_study


def run_with_bars(
    study: StudyConfig,
    path: Path,
    *,
    processes: bool,
    workers: int | None,
    track: Sequence[str],
    **settings: Any,
) -> None:
    """Run a study and show its progress; the time left is for all seeds of a task."""
    console = Console(stderr=True)
    bars = Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    rows: dict[tuple[str, str], Any] = {}

    def show(progress: Progress) -> None:
        if progress.stored is None:
            for row, seeds in _seeds(progress).items():
                rows[row] = bars.add_task(f"{row[0]}: {row[1]}", total=seeds)
            return
        unit = progress.stored
        bars.advance(rows[unit.arm, unit.task], len(unit.seeds))
        if not console.is_terminal:
            print(f"done {unit.label}", file=sys.stderr, flush=True)

    with bars, ExitStack() as ending:
        pool: ProcessPoolExecutor | None = None
        if processes or Arms.of(study).live:
            pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        run_study(
            study,
            path,
            workers=workers,
            executor=pool,
            trackers=track,
            progress=show,
            **settings,
        )


def _seeds(progress: Progress) -> Counter[tuple[str, str]]:
    """Return the seeds to be trained of each task of each arm."""
    found = Counter[tuple[str, str]]()
    for unit in progress.units:
        found[unit.arm, unit.task] += len(unit.seeds)
    return found
