"""What trains units: threads, processes, any executor, or an engine on other machines."""

from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from socket import create_connection
from typing import Any, Protocol

from curricle.errors import EngineError
from curricle.files import Place, RemotePath
from curricle.study.engines.sending import SentUnit, train_apart, train_sent
from curricle.study.stored_values import StoredSource
from curricle.study.units import UnitInput, train_unit

ANSWERS_IN = 10
"""Seconds in which a scheduler or a head must take a connection."""


class Workers(Protocol):
    """What the units of a study are sent to."""

    @property
    def share_folders(self) -> bool:
        """Whether they see the folders of this machine."""

    @property
    def link(self) -> str | None:
        """Of their cluster's own page, if there is one."""

    @property
    def repeated(self) -> int:
        """How many units were begun again so far, as a worker died."""

    def see(self, place: Place) -> bool:
        """Return whether they read and write the study's files themselves."""

    def train(
        self,
        given: UnitInput,
        stored: Mapping[str, StoredSource] | None = None,
        place: Place | None = None,
    ) -> "Future[Any]":
        """Return the future result of a unit, or the file that it was written to.

        Workers that see the study's files read the sources that are `stored`, and write at `place`.
        """

    def number(self) -> int:
        """How many there are now."""

    def lost(self) -> Exception:
        """Return why a unit was cancelled that nobody here cancelled."""


class Engine(Protocol):
    """A cluster that calls functions, places them and repeats those whose machine died."""

    @property
    def link(self) -> str | None:
        """Of the engine's own page, if there is one."""

    @property
    def repeated(self) -> int:
        """How many calls were begun again so far, as a worker died."""

    @property
    def local(self) -> bool:
        """Whether it was started here, so that its workers see this machine's folders."""

    def submit(self, function: Callable[[Any], Any], argument: Any) -> "Future[Any]":
        """Return the future result of a call."""

    def workers(self) -> int:
        """How many calls run side by side now."""

    def each(self, function: Callable[[], Any]) -> Mapping[str, Any]:
        """Return what a call returns on every machine or worker, or its exception, by name."""

    def close(self, whole: bool) -> None:
        """Leave the engine; one that was started here ends. `whole`: nothing was interrupted."""


@dataclass(frozen=True)
class ExecutorWorkers:
    """The workers of an executor, as many as is said.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> ExecutorWorkers(ThreadPoolExecutor(2), 2).number()
    2
    """

    executor: Executor
    workers: int
    share_folders: bool = True
    link: str | None = None
    repeated: int = 0

    def see(self, place: Place) -> bool:
        """Return False: the process that runs the study reads and writes for them."""
        return False

    def train(self, given: UnitInput, stored: Any = None, place: Any = None) -> "Future[Any]":
        """Return the future result of a unit."""
        # Threads hand on what is raised as it is.
        train = train_unit if isinstance(self.executor, ThreadPoolExecutor) else train_apart
        try:
            return self.executor.submit(train, given)
        except Exception as error:
            broken = BrokenExecutor("the executor took no unit")
            broken.__cause__ = error
            return failed(broken)

    def number(self) -> int:
        """How many there are."""
        return self.workers

    def lost(self) -> Exception:
        """Return why a unit was cancelled that nobody here cancelled."""
        return BrokenExecutor("the executor cancelled it")


@dataclass(frozen=True)
class EngineWorkers:
    """The workers of an engine, which get the study's own modules with each unit.

    Attributes
    ----------
    engine : Engine
    on : str
        The word for it.
    files : dict of str to bytes
        The study's own modules; they are small, so that each unit carries them.
    versions : dict of str to str
        Those that each worker must have.
    live : bool
        Whether a unit needs its process for itself (:attr:`Arms.live`).
    """

    engine: Engine
    on: str
    files: Mapping[str, bytes]
    versions: Mapping[str, str]
    live: bool

    @property
    def share_folders(self) -> bool:
        """Whether they see the folders of this machine."""
        return self.engine.local

    @property
    def link(self) -> str | None:
        """Of the engine's own page, if there is one."""
        return self.engine.link

    @property
    def repeated(self) -> int:
        """How many units were begun again so far, as a worker died."""
        return self.engine.repeated

    def see(self, place: Place) -> bool:
        """Return whether they read and write the study's files themselves: those at a URL."""
        return isinstance(place, RemotePath)

    def train(
        self,
        given: UnitInput,
        stored: Mapping[str, StoredSource] | None = None,
        place: Place | None = None,
    ) -> "Future[Any]":
        """Return the future result of a unit, or the file that it was written to."""
        sent = SentUnit(given, self.files, self.versions, self.live, stored or {}, place)
        try:
            return self.engine.submit(train_sent, sent)
        except Exception as error:
            return failed(self._lost(f" ({type(error).__name__}: {error})"))

    def number(self) -> int:
        """How many there are now."""
        return self.engine.workers()

    def lost(self) -> Exception:
        """Return why a unit was cancelled that nobody here cancelled."""
        return self._lost("")

    def _lost(self, why: str) -> Exception:
        return EngineError(f"{self.on} was lost or cancelled it{why}: go on with --resume")


def answers(host: str, port: int) -> bool:
    """Return whether something takes connections there."""
    try:
        create_connection((host.strip("[]"), port), ANSWERS_IN).close()
    except OSError:
        return False
    return True


def failed(error: Exception) -> "Future[Any]":
    """Return a future that has failed.

    Examples
    --------
    >>> failed(KeyError("a")).exception()
    KeyError('a')
    """
    found = Future[Any]()
    found.set_exception(error)
    return found
