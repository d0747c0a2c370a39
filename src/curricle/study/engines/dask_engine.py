"""Dask: a running cluster, or processes on this machine."""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from typing import Any

from distributed import Client, LocalCluster
from distributed.comm import CommClosedError

from curricle.study.engines.engine import Engine, answers
from curricle.study.workers import POSIX, interrupts_blocked, start_tracker

LOGGERS = [logging.getLogger(name) for name in ("distributed", "distributed.client", "asyncio")]
"""Dask sets the second logger's level itself; the third logs tasks that a lost scheduler ended."""
REACHED_IN = 10  # seconds in which a scheduler must answer


class DaskEngine(Engine):
    """A Dask cluster through its client."""

    def __init__(self, client: Client, cluster: LocalCluster | None):
        self.client, self.cluster = client, cluster
        self.share_folders = cluster is not None
        with suppress(KeyError):  # a scheduler may have no dashboard
            self.link = client.dashboard_link or None
        self.levels = [logger.level for logger in LOGGERS]
        for logger in LOGGERS:
            logger.setLevel(logging.CRITICAL)  # futures report a lost scheduler instead

    def submit(self, function: Callable[[Any], Any], argument: Any) -> "Future[Any]":
        """Return the future result of a call."""
        there = self.client.submit(function, argument, pure=False)
        loop = self.client.loop.asyncio_loop
        return asyncio.run_coroutine_threadsafe(self._outcome(there), loop)

    async def _outcome(self, there: Any) -> Any:
        """Return the result of a call, even if its first result was lost with its worker."""
        # After a lost worker, Dask's own executor never ends the future of a call that raises.
        try:
            return await self.client.gather(there, asynchronous=True)
        except asyncio.CancelledError:  # cancelled by this process
            with suppress(Exception):
                await there.cancel(asynchronous=True)
            raise
        except (CancelledError, CommClosedError):  # the scheduler is lost
            raise asyncio.CancelledError from None

    def count(self) -> int:
        """Return the number of threads of all workers."""
        return sum(self.client.nthreads().values())

    def close(self, whole: bool) -> None:
        """Leave the scheduler, which drops calls not yet begun; end a cluster started here."""
        # Dask's logging is restored, unless the run was interrupted or its scheduler is lost: then
        # Dask's threads log errors for some time after this.
        host, _, port = self.client.scheduler.address.rpartition("://")[2].rpartition(":")
        whole = whole and self.client.status == "running" and answers(host, int(port))
        with suppress(Exception):  # a scheduler that is gone cannot be left
            self.client.close(timeout=2)
        if self.cluster is not None:
            with suppress(TimeoutError):  # processes that remain end with this process
                self.cluster.close(timeout=20)
        for logger, level in zip(LOGGERS, self.levels, strict=True) if whole else ():
            logger.setLevel(level)


def connected(address: str | None, workers: int | None) -> DaskEngine:
    """Return the scheduler at host:port, or a new scheduler with processes of one thread."""
    if address is not None:
        return DaskEngine(Client(f"tcp://{address}", timeout=REACHED_IN), None)
    here = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"}
    if POSIX:
        start_tracker()  # before the next line, because starting it unblocks interrupts
    with interrupts_blocked():  # this process ends the workers, not a terminal's Ctrl-C
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, **here)
    return DaskEngine(Client(cluster), cluster)
