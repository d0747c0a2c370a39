"""Engines: clusters that train units, the data sent to them, and functions that open them."""

import atexit
import pickle
import platform
import re
import shutil
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from socket import create_connection
from tempfile import mkdtemp
from threading import Lock
from typing import Any, TypeVar

from curricle.errors import CurricleError, EngineError, ForeignError, SettingError, in_words
from curricle.files import Place, RemotePath, remove_folder
from curricle.study.arms import Arms, UnitInput, train_unit
from curricle.study.store import StoredUnit, UnitResult, lost_errors, stored_values, written_unit
from curricle.study_file.own_code import PACKAGES, own_files

# -- On the worker's machine: write the user's modules, and train a unit ---------------------------

FOLDERS = dict[Any, Path]()  # content of modules -> folder where this process wrote them
WRITING, SERIAL = Lock(), Lock()
Result = TypeVar("Result")


def called(function: Callable[[Any], Result], argument: Any) -> Result | Exception:
    """Return a function's result, or its error in a form that other processes can read."""
    try:
        return function(argument)
    except Exception as error:
        return _sendable(error)


def _sendable(error: Exception) -> Exception:
    """Return an error without causes; if it cannot be sent, an error with the same text."""
    text = "".join(traceback.format_exception(error))
    error.__cause__ = error.__context__ = error.__traceback__ = None
    try:  # can a process without the user's modules read the error unchanged?
        content = pickle.dumps(error)
        again = pickle.loads(content)
        same = type(again) is type(error) and str(again) == str(error)
        survives = same and PACKAGES.encode() not in content
    except Exception:  # methods of the error's class may raise anything
        survives = False
    if not survives:
        kind: type[Exception] = ForeignError
        if isinstance(error, CurricleError):  # a user's subclass of an error of ours
            ours = CurricleError.__module__
            kind = next(parent for parent in type(error).__mro__ if parent.__module__ == ours)
        error = kind(in_words(error))
    error.add_note(text)
    return error


def train_sent(sent: UnitInput) -> UnitResult | StoredUnit | Exception:
    """Train a unit and return its results, the file that holds them, or its error."""
    return called(_train_sent, sent)


def _train_sent(sent: UnitInput) -> UnitResult | StoredUnit:
    if differ := difference(sent.versions, versions_here()):
        raise EngineError(f"worker {platform.node()} has {differ}")
    unit, sources = sent.unit, dict(sent.sources)
    with lost_errors():
        for name, (files, read) in sent.stored.items():
            sources[name] = stored_values(StoredUnit.arrays, files, unit.seeds, read=read)
    with SERIAL if sent.serial else nullcontext():
        result = train_unit(sent._replace(folder=str(written(sent.files)), sources=sources))
    if sent.place is None:
        return result
    with lost_errors():
        stored = written_unit(sent.place, unit, result)
    if sent.checkpoints is not None:
        remove_folder(sent.checkpoints)
    return stored


def versions_here() -> dict[str, str]:
    """Return the versions that must be equal on all machines."""
    python = ".".join(platform.python_version_tuple()[:2])  # the third number changes no result
    return {name: metadata.version(name) for name in ("curricle", "numba")} | {"Python": python}


def difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """Return a sentence on how versions differ; empty if they are equal."""
    differing = [name for name in here if there.get(name) != here[name]]
    return ", ".join(f"{k} {there.get(k)} and the run has {here[k]}" for k in differing)


def written(files: Mapping[str, bytes]) -> Path:
    """Return a folder with these files, written once a process and removed when it ends."""
    content = frozenset(files.items())
    with WRITING:
        if content not in FOLDERS:
            # Its name cannot be guessed: others could put code into a folder with a known name.
            folder = Path(mkdtemp(prefix="curricle-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            for name, code in files.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(code)
            FOLDERS[content] = folder
        return FOLDERS[content]


# -- Workers: threads, processes, any executor, or an engine on other machines ---------------------

ANSWERS_IN = 10  # seconds in which a scheduler or head must accept a connection


@dataclass(frozen=True)
class ExecutorWorkers:
    """The workers of an executor."""

    executor: Executor
    workers: int
    share_folders: bool = True

    def see(self, place: Place) -> bool:
        """Return False: the process that runs the study reads and writes files for the workers."""
        return False

    def train(self, sent: UnitInput) -> "Future[Any]":
        """Return the future result of a unit."""
        # Threads pass errors on unchanged.
        threads = isinstance(self.executor, ThreadPoolExecutor)
        try:
            return self.executor.submit(
                train_unit if threads else partial(called, train_unit), sent
            )
        except Exception as error:
            broken = BrokenExecutor("the executor took no unit")
            broken.__cause__ = error
            return failed(broken)

    def number(self) -> int:
        """The number of workers."""
        return self.workers

    def lost(self) -> Exception:
        """Return the error of a unit that was cancelled, but not by this process."""
        return BrokenExecutor("the executor cancelled it")


class Engine(ABC):
    """A cluster that trains units: it calls functions, and repeats calls lost with a machine."""

    on = ""  # the text by which the user chose it
    link: str | None = None  # of its dashboard, if it has one
    share_folders = False  # whether it was started here and so sees this machine's folders
    files: Mapping[str, bytes]  # the user's modules, which are sent with each unit
    versions: Mapping[str, str]  # the versions that each worker must have
    serial: bool  # whether a process must train one unit at a time (`Plan.serial`)
    _number = 1

    @abstractmethod
    def submit(self, function: Callable[[Any], Any], argument: Any) -> "Future[Any]":
        """Return the future result of a call."""

    @abstractmethod
    def count(self) -> int:
        """Return how many calls can run in parallel; EngineError if the cluster is lost."""

    @abstractmethod
    def close(self, whole: bool) -> None:
        """Leave the engine, and end it if it was started here; `whole`: without an interrupt."""

    def carry(self, all_arms: Sequence[Arms], folder: Path) -> None:
        """Prepare to send the user's modules in a study's folder with the units of all arms."""
        files = own_files([list(arms.dependencies.values()) for arms in all_arms], folder)
        self.versions, self.serial = versions_here(), any(arms.serial for arms in all_arms)
        # Modules elsewhere on Python's path are not sent: workers import theirs (`arms_from_json`).
        root = folder.resolve()
        beside = {name: file for name, file in files.items() if root / name == file.resolve()}
        self.files = {name: file.read_bytes() for name, file in beside.items()}

    def see(self, place: Place) -> bool:
        """Return whether workers read and write the study's files themselves, as files at a URL."""
        return isinstance(place, RemotePath)

    def train(self, sent: UnitInput) -> "Future[Any]":
        """Return the future result of a unit, or the file that it was written to."""
        sent = sent._replace(files=self.files, versions=self.versions, serial=self.serial)
        try:
            return self.submit(train_sent, sent)
        except Exception as error:
            return failed(self.lost(f" ({type(error).__name__}: {error})"))

    def number(self) -> int:
        """Return the number of workers; the last known number if the cluster does not answer."""
        try:
            self._number = self.count()
        except EngineError:
            raise
        except Exception:  # each engine has its own
            return self._number
        return self._number

    def lost(self, why: str = "") -> Exception:
        """Return the error of a unit that was cancelled, but not by this process."""
        return EngineError(f"{self.on} was lost or cancelled it{why}: go on with --resume")


Workers = ExecutorWorkers | Engine  # they train the units of a study


def answers(host: str, port: int) -> bool:
    """Return whether a server accepts connections at this host and port."""
    try:
        create_connection((host.strip("[]"), port), ANSWERS_IN).close()
    except OSError:
        return False
    return True


def failed(error: Exception) -> "Future[Any]":
    """Return a future that has failed."""
    future = Future[Any]()
    future.set_exception(error)
    return future


# -- Opening the engine that a text names ----------------------------------------------------------

WORD = re.compile(r"(dask|ray)(?:://([^\s/:]+|\[[0-9a-fA-F:]+\]):(\d{1,5}))?")
ENGINE_PACKAGES = {"dask": "distributed", "ray": "ray"}


def parsed(on: str) -> tuple[str, str | None]:
    """Return the name of an engine and its host:port; SettingError for any other text."""
    if "@" in str(on):
        raise SettingError("on must be an address without user and password: got one before @")
    if (match := WORD.fullmatch(str(on))) is None:
        raise SettingError(
            f"on must be dask or ray, or an address such as dask://host:8786: got {on!r}"
        )
    return match[1], match[2] and f"{match[2]}:{match[3]}"


@contextmanager
def opened_engine(on: str, workers: int | None) -> Iterator[Engine]:
    """Return a context with the engine that `on` names."""
    name, address = parsed(on)
    if address is not None and workers is not None:
        raise SettingError(f"{on} has workers of its own: workers={workers} is for dask or ray")
    try:
        import_module(ENGINE_PACKAGES[name])
    except ImportError:
        raise SettingError(
            f'{on} needs a package that is not installed: pip install "curricle[{name}]"'
        ) from None
    module = import_module(f"curricle.study.engines.{name}_engine")
    try:
        engine: Engine = module.connected(address, workers)
        engine.on = on
    except CurricleError:
        raise
    except Exception as error:  # each engine has its own
        first, *further_lines = str(error).strip().splitlines() or [""]
        reason = " ".join([first, *further_lines[-1:]])  # the last line of a trace names the error
        raise SettingError(
            f"{on} cannot be reached or started: {type(error).__name__}: {reason}"
        ) from None
    whole = True
    try:
        yield engine
    except BaseException as error:
        whole = isinstance(error, Exception)  # an interrupt is no Exception
        raise
    finally:
        engine.close(whole)
