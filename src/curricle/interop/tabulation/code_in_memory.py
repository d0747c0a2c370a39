"""The code that decides what an environment does, so that tables of older code are not found."""

import inspect
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from curricle.interop.tabulation.fingerprint import PLAIN, fingerprint

PACKAGES = frozenset({"curricle", *sys.stdlib_module_names})
"""Top-level modules that count as installed wherever their files are."""


def code_digest(owners: Iterable[Any]) -> bytes:
    """Return a digest of the code of objects, 16 bytes.

    It reads functions, the classes of objects, and whatever these name in their modules: further
    functions, classes and data. Of installed packages it reads name and version. It is the code in
    memory that counts, as that makes the tables: a file may have changed since it was imported, and
    a class that was written in a notebook has none.

    Examples
    --------
    >>> class Steps:
    ...     def __init__(self, size):
    ...         self.size = size
    >>> code_digest([Steps(1)]) == code_digest([Steps(2)]) != code_digest([])  # state is no code
    True
    """
    read, met = list[Any](), dict[int, Any]()  # with the objects, so that no id is used again
    waiting = deque(one for owner in owners for one in _of_owner(owner))
    while waiting:
        one = waiting.popleft()
        if _is_plain(one):
            read.append(one)
        elif id(one) not in met:
            met[id(one)] = one
            read.append(_named(one))
            waiting += _parts(one)
    return fingerprint(read)


def _of_owner(owner: Any) -> list[Any]:
    """Return a function itself, or the class of an object and those of its attributes.

    What the attributes hold is the state, and no code.
    """
    if isinstance(owner, FunctionType | MethodType):
        return [owner]
    kinds = [one if callable(one) else type(one) for one in getattr(owner, "__dict__", {}).values()]
    return [type(owner), *kinds]


def _is_plain(value: Any) -> bool:
    array = isinstance(value, np.ndarray) and value.dtype != object
    return array or (isinstance(value, (*PLAIN, np.generic)) and not isinstance(value, Enum))


def _named(one: Any) -> tuple[str, ...]:
    """Return what an object is called, or what is known of one without a name."""
    if isinstance(one, ModuleType):
        return one.__name__, _version(one.__name__)
    if isinstance(one, type | FunctionType):
        return str(one.__module__), one.__qualname__, _version(str(one.__module__))
    return (type(one).__qualname__,)


def _version(module: str) -> str:
    """Return the version of the package that a module is in; empty where it says none."""
    return str(getattr(sys.modules.get(module.partition(".")[0]), "__version__", ""))


def _installed(module: str) -> bool:
    """Return whether a module is in an installed package, of which the version says enough."""
    file = getattr(sys.modules.get(module), "__file__", None) or ""
    return module.partition(".")[0] in PACKAGES or "-packages" in file


def _parts(one: Any) -> list[Any]:
    """Return what the behaviour of an object depends on."""
    if isinstance(one, type | FunctionType):
        if _installed(str(one.__module__)):
            return []
        return [*(_of_class(one) if isinstance(one, type) else _of_function(one))]
    if isinstance(one, MethodType | staticmethod | classmethod):
        return [one.__func__]
    if isinstance(one, property):
        return [one.fget, one.fset, one.fdel]
    if isinstance(one, Mapping):
        return [part for pair in one.items() for part in pair]
    if isinstance(one, set | frozenset):
        return sorted(one, key=repr)
    if isinstance(one, tuple | list):
        return [*one]
    if callable(one) and inspect.unwrap(one) is not one:  # compiled by Numba, or lru_cache
        return [inspect.unwrap(one)]
    if isinstance(one, ModuleType):
        return []
    known = _installed(type(one).__module__)
    attributes = {} if known else getattr(one, "__dict__", {})
    return [type(one), *(part for pair in attributes.items() for part in pair)]


def _of_class(one: type) -> Iterator[Any]:
    """Yield the bases of a class, and its methods and attributes by name."""
    yield from one.__bases__
    for name, value in vars(one).items():
        if not name.startswith("__") or isinstance(value, FunctionType):
            yield from (name, value)


def _of_function(one: FunctionType) -> Iterator[Any]:
    """Yield a function's code and all that it names in its module, or in modules named there."""
    yield fingerprint(one.__code__)
    yield from (one.__defaults__, one.__kwdefaults__)
    yield from inspect.getclosurevars(one).nonlocals.values()
    names, modules = [*_names(one.__code__)], list[ModuleType]()
    package, within = one.__globals__.get("__package__"), one.__globals__
    imported = {
        name: found
        for name in names
        for found in (sys.modules.get(f"{package}.{name}"), sys.modules.get(name))
        if found is not None
    }
    found = [{**imported, **within}[name] for name in names if name in imported or name in within]
    for value in found:  # which grows
        yield value
        if isinstance(value, ModuleType) and value not in modules:
            modules.append(value)
            if not _installed(value.__name__):
                found += [vars(value)[name] for name in names if name in vars(value)]


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that code uses, and those of functions inside it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
