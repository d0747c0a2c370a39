"""Opening the engine that a word names, and comparing its workers with this machine."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from curricle.errors import CurricleError, SettingError
from curricle.study.arms import Arms
from curricle.study.config.own_code import own_files
from curricle.study.engines.engine import Engine, EngineWorkers
from curricle.study.engines.sending import difference, versions_here

WORD = re.compile(r"(dask|ray)(?:://([^\s/:]+|\[[0-9a-fA-F:]+\]):(\d{1,5}))?")
PACKAGES = {"dask": "distributed", "ray": "ray"}


def parsed(on: str) -> tuple[str, str | None]:
    """Return the engine of a word and the address in it, host:port; SettingError if it has none.

    Examples
    --------
    >>> parsed("dask"), parsed("ray://head:10001")
    (('dask', None), ('ray', 'head:10001'))
    >>> parsed("dask://me:secret@head:8786")
    Traceback (most recent call last):
    curricle.errors.SettingError: on is an address without a user or a password: got one before @
    """
    match = WORD.fullmatch(on) if isinstance(on, str) else None
    if isinstance(on, str) and "@" in on:
        raise SettingError("on is an address without a user or a password: got one before @")
    if match is None:
        raise SettingError(
            f"on is dask or ray, or one of them at an address, such as dask://host:8786: got {on!r}"
        )
    return match[1], match[2] and f"{match[2]}:{match[3]}"


@contextmanager
def opened_engine(on: str, workers: int | None) -> Iterator[Engine]:
    """Give the engine that a word names, its workers compared with this machine; close it then.

    Parameters
    ----------
    on : str
    workers : int, optional
        Of an engine that is started here.

    Raises
    ------
    SettingError
        When the word names none, its package is not installed, nothing answers at the address, or
        a worker has other versions.
    """
    name, address = parsed(on)
    if address is not None and workers is not None:
        raise SettingError(f"{on} has workers of its own: workers={workers} is for dask or ray")
    try:
        import_module(PACKAGES[name])
    except ImportError:
        raise SettingError(
            f'{on} needs a package that is not installed: pip install "curricle[{name}]"'
        ) from None
    module = import_module(f"curricle.study.engines.{name}_engine")
    try:
        engine: Engine = module.connected(address, workers)
    except CurricleError:
        raise
    except Exception as error:  # each engine has its own
        first, *others = str(error).strip().splitlines() or [""]
        reason = " ".join([first, *others[-1:]])  # a trace's last line says what it is
        raise SettingError(
            f"{on} cannot be reached or started: {type(error).__name__}: {reason}"
        ) from None
    whole = True
    try:
        check_versions(on, engine.each(versions_here))
        yield engine
    except BaseException as error:
        whole = isinstance(error, Exception)  # and no interrupt
        raise
    finally:
        engine.close(whole)


def check_versions(on: str, found: Mapping[str, Any]) -> None:
    """Raise SettingError, which names the worker, unless all have the versions that are here.

    Examples
    --------
    >>> check_versions("dask", {"tcp://a:1": versions_here()})
    """
    for worker, versions in sorted(found.items()):
        if isinstance(versions, BaseException):
            raise SettingError(
                f"each worker of {on} must have Curricle: {worker} answered "
                f"{type(versions).__name__}: {versions}"
            )
        if differ := difference(versions_here(), versions):
            raise SettingError(
                f"each worker of {on} must have the versions of the run: {worker} has {differ}"
            )


def workers_of(engine: Engine, on: str, each: Sequence[Arms], folder: Path) -> EngineWorkers:
    """Return the workers of an engine for all arms of a study whose own modules are in a folder.

    Modules elsewhere on Python's path are not sent: workers import their own, which must be the
    same (:func:`arms_from_json`).
    """
    found = own_files([list(arms.dependencies.values()) for arms in each], folder)
    root = folder.resolve()
    files = {
        name: file.read_bytes() for name, file in found.items() if root / name == file.resolve()
    }
    return EngineWorkers(engine, on, files, versions_here(), any(arms.live for arms in each))
