"""Ray: a cluster at an address, the cluster of this machine, or a cluster started here."""

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from functools import cache
from time import sleep
from typing import Any
from warnings import catch_warnings, filterwarnings

import ray

from curricle.errors import EngineError
from curricle.study.engines.engine import Engine, answers

ASKED_AGAIN, PAUSE = 3, 2.0  # retries if a head refuses a connection, and seconds between them


class RayEngine(Engine):
    """A Ray cluster of one or several machines, to which this process is connected."""

    # A connection to the `head`, (host, port), tells whether the cluster is lost: Ray itself raises
    # nothing and ends this process after a minute; Ray's client retries for half a minute. `ends`:
    # the connection to Ray was made here and is closed here.

    def __init__(self, link: str | None, head: tuple[str, int], ends: bool):
        self.link, self.head, self.ends = link, head, ends
        self._remote = cache(ray.remote)  # ray.remote sends the function to the head

    def submit(self, function: Callable[[Any], Any], argument: Any) -> "Future[Any]":
        """Return the future result of a call, which gets a processor of its own."""
        if not ray.is_initialized():  # Ray would start a new cluster
            raise ConnectionError("it is not connected to Ray")
        reference, outcome = self._remote(function).remote(argument), Future[Any]()

        def end(done: "Future[Any]") -> None:
            if not outcome.set_running_or_notify_cancel():
                return
            error = done.exception()
            if error is None:
                outcome.set_result(done.result())
            else:
                outcome.set_exception(lost(str(error)))

        def cancel(done: "Future[Any]") -> None:
            if done.cancelled():
                with suppress(Exception):  # a cluster that is gone has nothing to cancel
                    ray.cancel(reference)

        outcome.add_done_callback(cancel)
        reference.future().add_done_callback(end)
        return outcome

    def count(self) -> int:
        """Return the number of processors; EngineError if the head takes no connection."""
        if not answers(*self.head):
            raise lost(f"its head at {self.head[0]}:{self.head[1]} is gone")
        if not ray.is_initialized():  # Ray would start a new cluster
            raise ConnectionError("it is not connected to Ray")
        return int(ray.cluster_resources().get("CPU", 0))

    def close(self, whole: bool) -> None:
        """Leave the cluster, and end it if it was started here."""
        if self.ends:
            ray.shutdown()


def lost(why: str) -> EngineError:
    """Return the error of a unit whose cluster is gone."""
    reason = why.split("\n", maxsplit=1)[0]
    return EngineError(f"Ray was lost: {reason}: go on with --resume")


def _connected(where: Mapping[str, Any], again: int = ASKED_AGAIN) -> Any:
    """Return the result of ``ray.init``; retry if a head has just lost a machine."""
    try:
        return ray.init(**where, logging_level=logging.ERROR, log_to_driver=False)
    except ConnectionAbortedError:
        if not again:
            raise
    sleep(PAUSE)
    return _connected(where, again - 1)


def connected(address: str | None, workers: int | None) -> RayEngine:
    """Return the cluster at host:port, or the cluster that ``ray.init()`` finds or starts."""
    ends, link = address is not None or not ray.is_initialized(), None
    if ends:
        where = {"num_cpus": workers} if address is None else {"address": f"ray://{address}"}
        with catch_warnings():  # an error says too that the cluster was not reached
            filterwarnings("ignore", "Ray Client connection timed out")
            context = _connected(where)
        link = getattr(context, "dashboard_url", None)
    host, _, port = (address or ray.get_runtime_context().gcs_address).rpartition(":")
    return RayEngine(f"http://{link}" if link else None, (host.strip("[]"), int(port)), ends)
