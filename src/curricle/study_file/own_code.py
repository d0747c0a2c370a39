"""The user's modules that a study names: loading functions from them, and digests of the files."""

import ast
import importlib
import importlib.util
import logging
import os
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import lru_cache
from hashlib import sha256
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, all_suffixes
from pathlib import Path
from types import ModuleType
from typing import Any

from curricle.checks import listed
from curricle.errors import ConfigError, CurricleError, in_words
from curricle.files import digest_of

# -- Functions that a study file names as ``module:function`` --------------------------------------
#
# A module beside the study file has precedence over a module on ``sys.path`` and belongs to its
# folder: modules of one name in two folders stay apart. While they are imported, they import their
# neighbours as a script would (``from rules import slip``), unless something else is called so, or
# relatively (``from .rules import slip``). A module on ``sys.path`` must belong to a package that
# the user allows, so that a stranger's study file cannot run code that the user did not choose.

ALLOW = "CURRICLE_ALLOW"  # environment variable: the installed packages that study files may name
# Always allowed, as they run no commands:
SAFE = {"curricle.deep", "gymnasium.wrappers", "minigrid", "torch.nn", "torch.optim"}
IMPORTED = dict[str, tuple[int, int] | None]()  # module -> time and size of its file
PACKAGES = "curricle_study_"  # prefix of the packages that hold studies' modules
LOGGER = logging.getLogger(__name__)  # names each module before it is imported


def load(reference: str, folder: Path) -> Callable[..., Any]:
    """Return the function that ``module:function`` names; ConfigError if there is none."""
    module_name, colon, name = reference.partition(":")
    if not colon or not all(part.isidentifier() for part in (*module_name.split("."), name)):
        raise ConfigError(f"a function must be named as module:function: got {reference!r}")
    module = _named(reference, module_name, folder)
    function = getattr(module, name, None)
    if not callable(function):
        public = {key: of for key, of in vars(module).items() if key[0] != "_" and callable(of)}
        local = [
            key for key, of in public.items() if getattr(of, "__module__", "") == module.__name__
        ]
        hint = suggestion(name, public) or (f": it has {listed(local)}" if local else "")
        raise ConfigError(
            f"{reference} names no function: {module_name} has no {name} to call{hint}"
        )
    return function  # type: ignore[no-any-return]


def registered(name: str, folder: Path) -> str:
    """Return an id of Gymnasium's registry, ``module:Name-v0``, whose module is imported.

    The module is imported by the rules of :func:`load`; the id of one beside the study file is
    returned without it, as Gymnasium would not find it. ConfigError where they refuse it.
    """
    module_name, colon, environment = name.rpartition(":")
    if not colon:
        return name
    if not all(part.isidentifier() for part in module_name.split(".")):
        raise ConfigError(f"an id with a module must be module:Name-v0: got {name!r}")
    module = _named(name, module_name, folder)
    return environment if module.__name__.startswith(PACKAGES) else name


def _named(reference: str, name: str, folder: Path) -> ModuleType:
    """Return the module that a reference names; ConfigError if there is none."""
    with users_code(reference):
        module = _module(name, folder)
    if module is None:
        raise ConfigError(
            f"{reference} names no module: {name} is neither beside the study file nor on Python's "
            "path"
        )
    return module


def suggestion(word: object, words: Iterable[str]) -> str:
    """Return ``, did you mean 'WORD'?`` with the closest of `words`; empty if none is close."""
    by_lower_case = {name.lower(): name for name in words}
    close = get_close_matches(str(word).lower(), by_lower_case, n=1)
    return f", did you mean {by_lower_case[close[0]]!r}?" if close else ""


@contextmanager
def users_code(reference: str) -> Iterator[None]:
    """Turn a failure of a user's function into a ConfigError that names it."""
    try:
        yield
    except CurricleError:
        raise
    # A sys.exit would end the command as if it had succeeded.
    except (Exception, SystemExit, GeneratorExit) as error:
        raise ConfigError(f"{reference} failed: {in_words(error)}") from error


def _module(name: str, folder: Path) -> ModuleType | None:
    """Return a module beside the study file or on ``sys.path``; None if there is none."""
    package, first = _package(folder), name.partition(".")[0]
    module = None
    if _exists(f"{package}.{first}"):
        with _Neighbours(package):
            module = _imported(f"{package}.{name}", name, "beside the study file")
    if module is None and (first in sys.modules or _exists(first)):
        allowed = os.environ.get(ALLOW, "").split(",")
        if first in sys.stdlib_module_names:
            raise ConfigError(
                f"a study file names functions of modules beside it: {first} is not there, and "
                "Python's own library, which can run any command, is refused"
            )
        if name not in SAFE and not any(f"{name}.".startswith(f"{x.strip()}.") for x in allowed):
            raise ConfigError(
                "a study file names functions of modules beside it, and of installed packages that "
                f"you allow: {first} is not beside it; set {ALLOW}={first} if you trust the file "
                "with it"
            )
        module = _imported(name, name, "from Python's path")
    for path in _modules_in(package):
        IMPORTED.setdefault(path, _stamp(path))
    return module


class _Neighbours(MetaPathFinder, Loader):
    """Has the modules of a study's folder import each other by their bare names in its block."""

    def __init__(self, package: str):
        self.package, self.names = package, list[str]()

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
        """Return how a module of the folder is imported; nothing of packages, or of elsewhere."""
        return ModuleSpec(name, self) if not path and _exists(f"{self.package}.{name}") else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module of the folder."""
        self.names.append(spec.name)
        module = importlib.import_module(f"{self.package}.{spec.name}")
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: Any) -> None:
        """Give the module back what says where it is from; it was run before."""
        module.__spec__ = module.__spec__.loader_state

    def __enter__(self) -> None:
        sys.meta_path.append(self)

    def __exit__(self, *_: object) -> None:
        sys.meta_path.remove(self)
        for name in self.names:  # so that another study's module of the name stays apart
            sys.modules.pop(name, None)


ANNOUNCED = set[str]()  # modules whose import was logged


def _imported(path: str, name: str, place: str) -> ModuleType | None:
    if path not in sys.modules and path not in ANNOUNCED:  # once, also where the import fails
        ANNOUNCED.add(path)
        LOGGER.info("importing the study's module %s, %s", name, place)
    return importlib.import_module(path) if _exists(path) else None


def _exists(path: str) -> bool:
    package = path.rpartition(".")[0]
    in_package = not package or package in sys.modules or _exists(package)
    return in_package and importlib.util.find_spec(path) is not None


def _package(folder: Path) -> str:
    """Return the name of the package of a folder's modules; changed modules are imported again."""
    path = str(folder.resolve())
    name = f"{PACKAGES}{sha256(path.encode()).hexdigest()[:16]}"
    imported = _modules_in(name)
    if any(module in IMPORTED and IMPORTED[module] != _stamp(module) for module in imported):
        for module in imported:
            del sys.modules[module]
            ANNOUNCED.discard(module)
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
    try:
        status = Path(getattr(sys.modules[module], "__file__", None) or "").stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


# -- Digests of the files of the user's modules that a study's functions need ---------------------
#
# A module is the user's if it is in the study's folder, or on Python's path but neither installed
# (in ``site-packages``) nor part of Python. The modules that it imports from its own folder count
# too, for every ``import`` in its text. Modules imported by a computed name do not count, nor do
# files that a module reads.

REFERENCE = re.compile(r"((?:[^\W\d]\w*\.)*[^\W\d]\w*):\S+")
"""``module:function``, or an environment of Gymnasium, ``module:Name-v0``."""
INSTALLED = {
    Path(sysconfig.get_path(scheme)).resolve()
    for scheme in ("stdlib", "platstdlib", "purelib", "platlib")
}


def code_of(data: object, folder: Path) -> dict[str, str]:
    """Return file -> digest of the user's modules that plain data name, equal on any machine."""
    return {
        name: digest_of(file.read_bytes().replace(b"\r\n", b"\n"))
        for name, file in own_files(data, folder).items()
    }


def own_files(data: object, folder: Path) -> dict[str, Path]:
    """Return the files of the user's modules that plain data name, by the keys of `code_of`."""
    files = dict[str, Path]()
    modules = {match[1] for text in _texts(data) if (match := REFERENCE.fullmatch(text))}
    for names in (tuple(module.split(".")) for module in sorted(modules)):
        root = folder if any(_files(folder, names)) else _other_folder(names)
        if root is None:
            continue
        closure, waiting = set[Path](), [names]  # files of the module and of its imports
        while waiting:
            for file in _files(root, waiting.pop()):
                if file not in closure:
                    closure.add(file)
                    text = file.read_bytes() if file.suffix == ".py" else b""
                    waiting += _imports(text, file.relative_to(root).parent.parts)
        files |= {file.relative_to(root).as_posix(): file for file in sorted(closure)}
    return files


def _texts(data: object) -> Iterator[str]:
    """Yield every text in plain data."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict | list | tuple):
        for value in data.values() if isinstance(data, dict) else data:
            yield from _texts(value)


def _other_folder(names: tuple[str, ...]) -> Path | None:
    """Return the folder on Python's path that holds a module; None if it is not the user's."""
    try:
        spec = importlib.util.find_spec(names[0])
    except ValueError:  # __main__
        return None
    if spec is None or names[0] == __name__.partition(".")[0]:  # Curricle has a version
        return None
    place, *_ = [*(spec.submodule_search_locations or []), spec.origin or ""]
    root = Path(place).resolve().parent
    installed = any(root.is_relative_to(path) for path in INSTALLED)
    return root if any(_files(root, names)) and not installed else None


def _files(root: Path, names: tuple[str, ...]) -> Iterator[Path]:
    """Yield the files of a module and of the packages that it is in."""
    for n in range(1, len(names) + 1):
        stem = root.joinpath(*names[:n])
        for suffix in all_suffixes():
            files = (stem / f"__init__{suffix}", stem.with_name(stem.name + suffix))
            yield from (file for file in files if file.is_file())


@lru_cache(maxsize=256)  # called for every task of every arm
def _imports(text: bytes, package: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the names of modules, or of functions in modules, that a module's text imports."""
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):  # the error is reported when the module is imported
        return []
    names = list[tuple[str, ...]]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += (tuple(alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            around = package[: len(package) + 1 - node.level] if node.level else ()
            module = (*around, *(node.module.split(".") if node.module else ()))
            names += ((*module, alias.name) for alias in node.names)
    return names
