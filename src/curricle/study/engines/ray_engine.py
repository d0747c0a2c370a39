"""Ray: a cluster at an address, the one that this machine is in, or one started here."""

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

import ray
from ray.exceptions import RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from curricle.errors import EngineError

ASKED = 60
"""Seconds in which each machine must answer; it starts a process first."""


class RayEngine:
    """A Ray cluster that this process is connected to.

    Parameters
    ----------
    link : str or None
    ends : bool
        Whether the connection was made here, and so ends here.
    """

    local = False  # Ray may have found a cluster of several machines

    def __init__(self, link: str | None, ends: bool):
        self.link, self.ends = link, ends

    def submit(self, function: Callable[[Any], Any], argument: Any) -> "Future[Any]":
        """Return the future result of a call, which has a processor to itself."""
        reference = ray.remote(function).remote(argument)
        found = Future[Any]()

        def end(done: "Future[Any]") -> None:
            if not found.set_running_or_notify_cancel():
                return
            error = done.exception()
            if error is None:
                found.set_result(done.result())
            elif isinstance(error, RayTaskError) and isinstance(error.cause, Exception):
                found.set_exception(error.cause)  # as it was raised, without Ray's words around it
            elif isinstance(error, ConnectionError):
                found.set_exception(EngineError(f"Ray was lost: {error}: go on with --resume"))
            else:
                found.set_exception(error)

        def cancel(done: "Future[Any]") -> None:
            if done.cancelled():
                ray.cancel(reference)

        found.add_done_callback(cancel)
        reference.future().add_done_callback(end)
        return found

    def workers(self) -> int:
        """How many processors there are."""
        return int(ray.cluster_resources().get("CPU", 0))

    def each(self, function: Callable[[], Any]) -> Mapping[str, Any]:
        """Return what a call returns on every machine, or its exception, by name."""
        asked = {}
        for node in ray.nodes():
            if node["Alive"]:
                there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                call = ray.remote(function).options(num_cpus=0, scheduling_strategy=there)
                asked[f"{node['NodeManagerHostname']} ({node['NodeID'][:8]})"] = call.remote()
        return {name: _answer(reference) for name, reference in asked.items()}

    def close(self) -> None:
        """Leave the cluster; one that was started here ends."""
        if self.ends:
            ray.shutdown()


def _answer(reference: Any) -> Any:
    """Return what a call returned, or its exception."""
    try:
        return ray.get(reference, timeout=ASKED)
    except Exception as error:
        return getattr(error, "cause", None) or error


def connected(address: str | None, workers: int | None) -> RayEngine:
    """Return the cluster at host:port, or what ``ray.init()`` finds or starts."""
    if address is None and ray.is_initialized():
        return RayEngine(None, ends=False)
    settings: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address is None:
        settings["num_cpus"] = workers
    else:
        settings["address"] = f"ray://{address}"
    context = ray.init(**settings)
    link = getattr(context, "dashboard_url", None)
    return RayEngine(f"http://{link}" if link else None, ends=True)
