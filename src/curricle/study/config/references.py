"""Functions that a study file names as ``module:function``."""

import hashlib
import importlib
import importlib.util
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from curricle.checks import listed
from curricle.errors import ConfigError, CurricleError
from curricle.study.config.tables import suggestion

IMPORTED = dict[str, tuple[int, int] | None]()
"""The time and size of each module's file when it was imported."""
PACKAGES = "curricle_study_"
"""What the names of packages of studies' own modules begin with."""
LOGGER = logging.getLogger(__name__)
"""It names each module of a study before the module is imported."""


def load(reference: str, folder: Path) -> Callable[..., Any]:
    """Return the function that ``module:function`` names.

    A module beside the study file comes before one on ``sys.path``. It belongs to its folder:
    modules of the same name in two folders stay apart. It imports its neighbours relatively
    (``from .rules import slip``). ConfigError says that there is no such module or function, or
    that importing the module failed.

    Examples
    --------
    >>> load("math:hypot", Path())(3, 4)
    5.0
    """
    module_name, colon, name = reference.partition(":")
    words = [*module_name.split("."), name]
    if not colon or not all(word.isidentifier() for word in words):
        raise ConfigError(f"a function is named as module:function: got {reference!r}")
    with users_code(reference):
        module = _module(module_name, folder)
    if module is None:
        raise ConfigError(
            f"{reference} names no module: {module_name} is neither beside the study file nor on "
            "Python's path"
        )
    function = getattr(module, name, None)
    if not callable(function):
        raise ConfigError(
            f"{reference} names no function: {module_name} has no {name} to call"
            f"{_others(module, name)}"
        )
    return function  # type: ignore[no-any-return]


def _others(module: ModuleType, name: str) -> str:
    """Return what else of a module can be called: the closest name, or all that it defines."""
    there = {one: of for one, of in vars(module).items() if one[0] != "_" and callable(of)}
    own = [one for one, of in there.items() if getattr(of, "__module__", "") == module.__name__]
    return suggestion(name, there) or (f": it has {listed(own)}" if own else "")


@contextmanager
def users_code(reference: str) -> Iterator[None]:
    """Turn a failure of a user's function into a ConfigError that names it."""
    try:
        yield
    except CurricleError:
        raise
    except Exception as error:
        raise ConfigError(f"{reference} failed: {type(error).__name__}: {error}") from error


def _module(name: str, folder: Path) -> ModuleType | None:
    """Return a module beside the study file or on ``sys.path``; None if there is none."""
    package = _package(folder)
    paths = (f"{package}.{name}", name)
    if not any(path in sys.modules for path in paths):
        first = name.partition(".")[0]
        beside = (folder / f"{first}.py").exists() or (folder / first).is_dir()
        place = "beside the study file" if beside else "from Python's path"
        LOGGER.info("importing the study's module %s, %s", name, place)
    found = next((importlib.import_module(path) for path in paths if _exists(path)), None)
    for module in _modules_in(package):
        IMPORTED.setdefault(module, _stamp(module))
    return found


def _exists(path: str) -> bool:
    package = path.rpartition(".")[0]
    there = not package or package in sys.modules or _exists(package)
    return there and importlib.util.find_spec(path) is not None


def _package(folder: Path) -> str:
    """Return the name of a package whose modules are those in a folder.

    As its submodules they are found without changing ``sys.path``, and keep apart from others. When
    a file of them has changed since it was imported, they are imported again.
    """
    path = str(folder.resolve())
    name = f"{PACKAGES}{hashlib.sha256(path.encode()).hexdigest()[:16]}"
    imported = _modules_in(name)
    if any(module in IMPORTED and IMPORTED[module] != _stamp(module) for module in imported):
        for module in imported:  # all, since they import each other
            del sys.modules[module]
            IMPORTED.pop(module, None)
        importlib.invalidate_caches()
    package = ModuleType(name, f"The modules in {path}.")
    package.__path__ = [path]
    sys.modules.setdefault(name, package)
    return name


def _modules_in(package: str) -> list[str]:
    return [name for name in list(sys.modules) if name.startswith(f"{package}.")]


def _stamp(module: str) -> tuple[int, int] | None:
    """Return the time and size of a module's file now; None if it has none."""
    file = getattr(sys.modules[module], "__file__", None)
    try:
        found = Path(file or "").stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
