"""Processes that train units, and end when the process that started them does."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process, resource_tracker
from threading import Thread
from typing import Any

POSIX = hasattr(signal, "pthread_sigmask")


class WorkerProcesses(ProcessPoolExecutor):
    """An executor of processes, by default one a processor, which end when this process ends.

    They are started afresh (``spawn``), so a script that uses them needs the guard
    ``if __name__ == "__main__":``. An interrupt (Ctrl-C) is left to this process.

    Examples
    --------
    >>> with WorkerProcesses(1) as pool:
    ...     pool.submit(pow, 2, 10).result()
    1024
    """

    def __init__(self, workers: int | None = None):
        if POSIX:
            start_tracker()
        super().__init__(workers, get_context("spawn"), initializer=end_with_parent)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """Submit a call, as any executor does."""
        with interrupts_blocked():  # the first call starts the processes
            return super().submit(fn, *args, **kwargs)


def start_tracker() -> None:
    """Start the process that removes the semaphores of a killed run, without its warnings."""
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = "ignore"
    try:
        resource_tracker.ensure_running()
    finally:
        del os.environ["PYTHONWARNINGS"]
        if before is not None:
            os.environ["PYTHONWARNINGS"] = before


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in this thread, and for good in processes that it starts meanwhile."""
    # A terminal sends SIGINT to a new process too, before that could say that it ignores it.
    if not POSIX:
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """Ignore interrupts, and end this process when the process that started it is gone."""
    # A thread waits for that; compiled loops release the GIL, so they do not keep it from running.
    # It begins before libraries are imported: this module needs none, and units come later.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)  # the main thread may be in a compiled loop for minutes
