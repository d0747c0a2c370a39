"""Running a study with its progress on the terminal: a bar for each task of each arm."""

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

from curricle.study.config.study_file import StudyFile
from curricle.study.runner.arms import Arms
from curricle.study.runner.run import Progress, run_study


def run_live(
    study: StudyFile,
    path: Path,
    *,
    processes: bool,
    workers: int | None,
    track: Sequence[str],
    **settings: Any,
) -> None:
    """Run a study and show how far it is; the time left is that of all seeds of a task."""
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
        if progress.unit is None:
            for row, seeds in _seeds(progress).items():
                rows[row] = bars.add_task(f"{row[0]}: {row[1]}", total=seeds)
            return
        bars.advance(rows[progress.unit.arm, progress.unit.node], len(progress.unit.seeds))
        if not console.is_terminal:
            print(f"done {progress.unit.words}", file=sys.stderr, flush=True)

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
    for unit in progress.left:
        found[unit.arm, unit.node] += len(unit.seeds)
    return found
