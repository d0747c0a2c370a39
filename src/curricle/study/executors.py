"""An executor that trains the units of a study, on this machine or others, and what it is sent."""

import atexit
import platform
import shutil
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ThreadPoolExecutor,
)
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock
from typing import Any

from curricle.errors import CurricleError, EngineError, ForeignError, in_words
from curricle.study.arms import Arms, UnitInput, train_unit
from curricle.study.store import UnitContent
from curricle.study_file.own_code import own_files

# -- The workers of a run --------------------------------------------------------------------------


@dataclass
class Workers:
    """An executor that trains units, and what is sent to it with each unit."""

    executor: Executor
    count: Callable[[], int]  # how many units it trains at once, now
    files: Mapping[str, bytes] = field(default_factory=dict)  # the user's modules by path
    serial: bool = False  # whether a process must train one unit at a time (`Plan.serial`)
    _number: int = field(default=1, init=False)

    @classmethod
    def of(
        cls, executor: Executor, count: Callable[[], int], all_arms: Sequence[Arms], folder: Path
    ) -> "Workers":
        """Return workers for the units of all arms of the study in a folder."""
        # Modules elsewhere on Python's path are not sent: workers import theirs (`arms_from_json`).
        root = folder.resolve()
        modules = own_files([list(arms.dependencies.values()) for arms in all_arms], folder)
        beside = {name: file for name, file in modules.items() if root / name == file.resolve()}
        files = {name: file.read_bytes() for name, file in beside.items()}
        return cls(executor, count, files, serial=any(arms.serial for arms in all_arms))

    @property
    def threads(self) -> bool:
        """Whether units are trained in this process."""
        return isinstance(self.executor, ThreadPoolExecutor)

    def train(self, sent: UnitInput) -> "Future[Any]":
        """Return the future result of a unit."""
        sent = sent._replace(serial=self.serial)
        if not self.threads:  # which pass errors on unchanged, and have the plan itself
            sent = sent._replace(arms=None, files=self.files, versions=versions_here())
        try:
            return self.executor.submit(_train if self.threads else train_sent, sent)
        except Exception as error:
            future, broken = Future[Any](), BrokenExecutor("the executor took no unit")
            broken.__cause__ = error
            future.set_exception(broken)
            return future

    def number(self) -> int:
        """Return the number of workers, or the last one that was known; EngineError if lost."""
        try:
            self._number = self.count()
        except EngineError:
            raise
        except Exception:  # each cluster has its own
            return self._number
        return self._number


# -- On the worker's machine: train a unit with the user's modules ---------------------------------

FOLDERS = dict[Any, Path]()  # content of modules -> folder where this process wrote them
WRITING, SERIAL = Lock(), Lock()


def _train(sent: UnitInput) -> UnitContent:
    """Train a unit; a serial one when no other is trained in this process."""
    # After an interrupt a unit of the run before may still be in training, in its thread.
    with SERIAL if sent.serial else nullcontext():
        return train_unit(sent)


def train_sent(sent: UnitInput) -> UnitContent | Exception:
    """Train a unit and return its results, or its error."""
    # An error is returned: raising it would need the user's class where it is received.
    try:
        if difference := _difference(sent.versions, versions_here()):
            raise EngineError(f"worker {platform.node()} has {difference}")
        folder = _folder_with(sent.files, Path(sent.folder))
        return _train(sent._replace(folder=str(folder)))
    except Exception as error:
        return _sendable(error)


def _sendable(error: Exception) -> Exception:
    """Return an error of the library's own classes, which every process can read, in its words."""
    module = CurricleError.__module__
    kinds = (kind for kind in type(error).__mro__ if kind.__module__ == module)
    sent: Exception = next(kinds, ForeignError)(in_words(error))
    sent.add_note("".join(traceback.format_exception(error)))
    return sent


@cache
def versions_here() -> dict[str, str]:
    """Return the versions that must be equal on all machines."""
    python = ".".join(platform.python_version_tuple()[:2])  # the third number changes no result
    return {name: metadata.version(name) for name in ("curricle", "numba")} | {"Python": python}


def _difference(run: Mapping[str, str], worker: Mapping[str, str]) -> str:
    """Return a sentence on how versions differ; empty if they are equal."""
    differing = [name for name in run if worker.get(name) != run[name]]
    return ", ".join(f"{k} {worker.get(k)} and the run has {run[k]}" for k in differing)


def _folder_with(files: Mapping[str, bytes], run: Path) -> Path:
    """Return the run's folder where this machine has its modules, else one with those sent."""
    with suppress(OSError):
        if all((run / name).read_bytes() == code for name, code in files.items()):
            return run
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
