"""Processes of this machine that train units, and Dask clusters."""

import atexit
import logging
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing import connection, parent_process, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import Thread
from typing import Any, NamedTuple

from curricle.errors import EngineError, SettingError

# -- Processes of this machine, which end when the process that started them ends ------------------

POSIX = hasattr(signal, "pthread_sigmask")
REAPER = """
import os, signal, sys
held = []
for line in sys.stdin:  # it ends with the last process that can write to it
    try:
        held.append(os.pidfd_open(int(line)))
    except OSError:  # that worker has ended
        pass
for worker in held:
    try:
        signal.pidfd_send_signal(worker, signal.SIGKILL)
    except ProcessLookupError:
        pass
"""
"""Kills the workers whose process ids it has read when the process that wrote them ends (Linux).

Workers also end by themselves, but not in the seconds in which they start and import libraries.
"""


class _Worker(SpawnProcess):
    """A process whose id is sent to the reaper as soon as it has started."""

    def start(self) -> None:
        super().start()
        if hasattr(os, "pidfd_open"):
            pipe = _reaper(os.getpid()).stdin
            assert pipe is not None
            with suppress(BrokenPipeError):  # without the reaper the run goes on
                pipe.write(f"{self.pid}\n".encode())


class _Workers(SpawnContext):
    """The context that starts new interpreters for :class:`WorkerProcesses`."""

    Process = _Worker


@cache
def _reaper(process: int) -> subprocess.Popen[bytes]:
    """Return the reaper of this process, whose id is `process`; the first call starts it."""
    reaper = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", REAPER],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # signals to the run must not end it
        bufsize=0,
    )
    atexit.register(_end, reaper)
    return reaper


def _end(reaper: subprocess.Popen[bytes]) -> None:
    """End a reaper when this process ends normally, after the workers have ended."""
    assert reaper.stdin is not None
    reaper.stdin.close()
    with suppress(subprocess.TimeoutExpired):  # a forked process may hold the pipe open
        reaper.wait(1.0)


class WorkerProcesses(ProcessPoolExecutor):
    """An executor of processes, by default one a processor, which end when this process ends.

    They are new interpreters (``spawn``), so a script that uses them needs the guard
    ``if __name__ == "__main__":``. They ignore interrupts (Ctrl-C), which this process handles.

    Examples
    --------
    >>> with WorkerProcesses(1) as pool:
    ...     pool.submit(pow, 2, 10).result()
    1024
    """

    def __init__(self, workers: int | None = None):
        if POSIX:
            start_tracker()
        super().__init__(workers, _Workers(), initializer=end_with_parent)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """Submit a call, as any executor does."""
        with interrupts_blocked():  # the first call starts the processes
            return super().submit(fn, *args, **kwargs)


def start_tracker() -> None:
    """Start, without its warnings, the process that removes the semaphores of a killed run."""
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
    """Block SIGINT in this thread, and permanently in processes that it starts meanwhile."""
    # A terminal sends SIGINT also to a new process, before that process can ignore it.
    if not POSIX:
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """Ignore interrupts, and end this process when the process that started it has ended."""
    # A thread waits for that end. It can run during compiled loops, which release the GIL. Without
    # a reaper only this thread ends workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)  # the main thread may be in a compiled loop for minutes


# -- A Dask cluster: one at an address, or processes of this machine -------------------------------

DASK = re.compile(r"dask(?:://((?:[^\s/:@]+|\[[0-9a-fA-F:]+\]):\d{1,5}))?")
LOGGERS = [logging.getLogger(name) for name in ("distributed", "distributed.client", "asyncio")]
"""Of Dask, which sets the second's level itself; the third logs what a lost scheduler ended."""
REACHED_IN = 10  # seconds in which a scheduler must answer


class Cluster(NamedTuple):
    """An executor, what returns how many units it trains at once, and its dashboard if any."""

    executor: Executor
    workers: Callable[[], int]
    link: str | None


def dask_address(on: str) -> str | None:
    """Return host:port in the text of ``--on``, None for a new cluster; SettingError otherwise."""
    if "@" in on:
        raise SettingError("on must be an address without user and password: got one before @")
    if (match := DASK.fullmatch(on)) is None:
        raise SettingError(f"on must be dask, or an address as dask://host:8786: got {on!r}")
    return match[1]


@contextmanager
def dask_cluster(on: str, workers: int | None = None) -> Iterator[Cluster]:
    """Return a context with the Dask cluster that ``--on`` names; one started here ends with it."""
    address = dask_address(on)
    if address is not None and workers is not None:
        raise SettingError(f"{on} has workers of its own: workers={workers} is for dask")
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise SettingError(
            f'{on} needs a package that is not installed: pip install "curricle[dask]"'
        ) from None
    levels = {logger: logger.level for logger in LOGGERS}
    try:
        if address is not None:
            cluster, client = None, Client(f"tcp://{address}", timeout=REACHED_IN)
        else:
            if POSIX:
                start_tracker()  # before the next line, because starting it unblocks interrupts
            with interrupts_blocked():  # this process ends the workers, not a terminal's Ctrl-C
                cluster = LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
                )
            client = Client(cluster)
    except Exception as error:
        reason = " ".join(str(error).split())
        raise SettingError(
            f"{on} cannot be reached or started: {type(error).__name__}: {reason}"
        ) from None
    for logger in LOGGERS:
        logger.setLevel(logging.CRITICAL)  # futures report a lost scheduler instead
    try:
        link = None
        with suppress(KeyError):  # a scheduler may have no dashboard
            link = client.dashboard_link or None

        def threads() -> int:
            if client.status != "running":  # a call whose result is on its way would not end
                raise EngineError(f"{on} was lost: go on with --resume")
            return sum(client.nthreads().values())

        yield Cluster(client.get_executor(pure=False), threads, link)
    except BaseException:
        levels.clear()  # after an error Dask's threads log for some time
        raise
    finally:
        with suppress(Exception):  # a scheduler that is gone cannot be left
            client.close(timeout=2)
        if cluster is not None:
            with suppress(TimeoutError):  # processes that remain end with this process
                cluster.close(timeout=20)
        for logger, level in levels.items():
            logger.setLevel(level)
