"""Running a study from the command line: bars, lines, what is compiled, and the page of the run."""

import os
import sys
import webbrowser
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from threading import Thread

import typer
from rich.console import Console

from curricle.files import Place, place_at
from curricle.progress import BETWEEN_LINES, Bars, compilation, nothing, shown
from curricle.study.arms import Arms
from curricle.study.config import StudyConfig
from curricle.study.results import StudyResults
from curricle.study.running import Pace, Progress, run_study, shown_units
from curricle.study.workers import WorkerProcesses, dask_cluster
from curricle.text import counted

# -- Running a study from the command line: bars on a terminal, and lines where there is none ------


class Lines:
    """Prints how far a run is where there is no terminal, and which trials of a tuning begin."""

    def __init__(self, pace: Pace):
        self.pace = pace
        self._printed, self._tenth = pace.clock(), 0

    def show(self, progress: Progress) -> None:
        """Print a line, if it is time for one or another tenth of the study's units is stored."""
        line, now, tenth = progress.tuning, self.pace.clock(), 0
        if progress.stored is not None:
            line = self.pace.line()
            if not progress.tuning:  # of which there are many small parts
                tenth = 10 * self.pace.stored // len(progress.units)
            if now - self._printed < BETWEEN_LINES and tenth <= self._tenth:
                return
        if line:
            self._printed, self._tenth = now, tenth
            print(line, file=sys.stderr, flush=True)


def run_with_bars(
    study: StudyConfig,
    path: str | Place,
    *,
    resume: bool = False,
    shard: tuple[int, int] = (1, 1),
    processes: bool = False,
    workers: int | None = None,
    on: str | None = None,
    page: bool = False,
) -> StudyResults:
    """Run a study, show its progress and, with `page`, its report so far; return its results."""
    compilation().prints = True
    pace = Pace()
    progress = True if Console(stderr=True).is_terminal else Lines(pace).show
    with ExitStack() as ending:
        show_units = ending.enter_context(shown_units(progress, pace, pace.line))
        write_page = ending.enter_context(_page_of_run(path, pace)) if page else nothing

        def show(progress: Progress) -> None:
            show_units(progress)
            write_page()

        studies = [study, study.trials] if study.tune else [study]
        count: int | Callable[[], int] | None = workers
        executor: Executor | None = None
        if on is not None:
            cluster = ending.enter_context(dask_cluster(on, workers))
            executor, count = cluster.executor, cluster.workers
            link = f", {cluster.link}" if cluster.link else ""
            typer.echo(f"{on}: {counted(cluster.workers(), 'worker')}{link}", err=True)
        elif processes or any(Arms.of(part).serial for part in studies):
            executor = pool = WorkerProcesses(workers)
            ending.callback(pool.shutdown, wait=False, cancel_futures=True)
        return run_study(
            study,
            path,
            resume=resume,
            workers=count,
            executor=executor,
            shard=shard,
            progress=show,
        )


@contextmanager
def _page_of_run(path: str | Place, pace: Pace) -> Iterator[Callable[[], None]]:
    """Yield a function that writes the page of a run anew; in the end it is the report."""
    from curricle.show.report import InterimReport, default_page, write_report  # with Matplotlib

    out = default_page(place_at(path))
    live = InterimReport(path, out, lambda sentence: typer.echo(f"curricle: {sentence}", err=True))
    begun = False

    def write() -> None:
        nonlocal begun
        live.refresh(pace.line())
        if not begun:
            begun = True
            typer.echo(f"Open {out}: it is written anew as units end, and read again by itself.")
            if has_windows():  # not waited for: some browsers end when they are closed
                address = out.resolve().as_uri()
                Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    try:
        yield write
    except Exception:  # an interrupt is none: it does not wait for a page
        if begun:  # a folder that a run is refused stays as it is
            live.refresh(f"The run is over: {pace.line()}", over=True)
        raise
    if StudyResults(path).has_baseline:
        write_report(path, out)
    else:
        live.refresh(f"The run is over: {pace.line()}", over=True)


def has_windows() -> bool:
    """Return whether a browser would have a window: in the terminal it would hide the run."""
    if sys.platform in ("win32", "darwin"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


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
