"""A digest of everything that an object holds, by which equal states are known again."""

import hashlib
from collections import deque
from collections.abc import Collection
from enum import Enum
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec

from curricle.errors import TaskError
from curricle.interop.tabulation.random_states import GENERATORS
from curricle.interop.toy_text import HARMLESS

PLAIN = (type(None), bool, int, float, complex, str, bytes)
CONSTANT = (gym.Space, EnvSpec, *GENERATORS)
"""What is no part of a state: spaces and specifications are constant, and generators of random
numbers decide what happens next only in environments that are random."""
NAMED = (type, BuiltinFunctionType, ModuleType)
UNCHANGING = (tuple, frozenset, Enum, *NAMED, FunctionType, MethodType, CodeType)
"""What is read again wherever it is met: sharing it makes no difference."""


def fingerprint(
    value: Any, left_out: Collection[str] = (), generators: list[Any] | None = None
) -> bytes:
    """Return a digest of a value and all that it refers to, 16 bytes.

    Equal for values that are equal part by part, with the same parts shared between the same
    places. Random generators, spaces, and wrappers of Gymnasium that change nothing are left out.

    Parameters
    ----------
    value : any
    left_out : collection of str
        Names of attributes that do not count.
    generators : list, optional
        Random generators that are met are appended to it, each once.

    Raises
    ------
    TaskError
        When a part holds what cannot be read, such as an open file.

    Examples
    --------
    >>> fingerprint([1, np.arange(2)]) == fingerprint([1, np.arange(2)])
    True
    >>> fingerprint([1, 2]) == fingerprint((1, 2))
    False
    """
    reader = _Reader(frozenset(left_out))
    reader.read(value)
    if generators is not None:
        generators += reader.generators.values()
    return reader.digest.digest()


class _Reader:
    """Feeds values to a digest; each shared part once, then by its number."""

    def __init__(self, left_out: frozenset[str]):
        self.digest = hashlib.blake2b(digest_size=16)
        self.left_out = left_out
        self.met = dict[int, int]()
        self.generators = dict[int, Any]()
        self.alive = list[Any]()  # so that no number in `met` is given to another object

    def tell(self, *words: Any) -> None:
        for word in words:
            content = word if isinstance(word, bytes) else str(word).encode()
            self.digest.update(b"%d:" % len(content) + content)

    def read(self, value: Any) -> None:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, PLAIN) and not isinstance(value, Enum):
            content = value if isinstance(value, bytes) else repr(value)
            self.tell(type(value).__name__, content)
        elif isinstance(value, CONSTANT):
            self.tell("constant")
            if isinstance(value, GENERATORS):
                self.generators[id(value)] = value
        elif isinstance(value, HARMLESS):
            self.read(value.env)
        elif isinstance(value, UNCHANGING):
            self._read_parts(value)
        elif id(value) in self.met:
            self.tell("met", self.met[id(value)])
        else:
            self.met[id(value)] = len(self.met)
            self.alive.append(value)
            self._read_parts(value)

    def _read_parts(self, value: Any) -> None:
        """Read a value that has parts or a name."""
        if isinstance(value, np.ndarray) and value.dtype != object:
            self.tell("array", value.dtype.str, value.shape, value.tobytes())
        elif isinstance(value, Enum):
            self.tell("enum", type(value).__qualname__, value.name)
        elif isinstance(value, NAMED):
            self.tell("name", getattr(value, "__module__", ""), value.__name__)
        elif isinstance(value, FunctionType | MethodType | CodeType):
            self._read_function(value)
        elif isinstance(value, tuple | list | deque | np.ndarray):
            self.tell(type(value).__name__, np.shape(value) if hasattr(value, "shape") else "")
            self._read_all(list(value))
        elif isinstance(value, dict):
            self._read_dict(value)
        elif isinstance(value, set | frozenset):
            self.tell("set", *sorted(fingerprint(one, self.left_out) for one in value))
        else:
            self._read_object(value)

    def _read_all(self, values: Collection[Any]) -> None:
        self.tell(len(values))
        for each in values:
            self.read(each)

    def _read_dict(self, value: dict[Any, Any]) -> None:
        self.tell(type(value).__name__, len(value))
        for key in sorted(value, key=repr):
            self.read(key)
            self.read(value[key])

    def _read_function(self, value: Any) -> None:
        if isinstance(value, MethodType):
            self.tell("method", value.__func__.__qualname__)
            self.read(value.__self__)
        elif isinstance(value, CodeType):
            self.tell("code", value.co_code, repr(value.co_names))
            self._read_all(value.co_consts)
        else:
            self.tell("function", value.__module__, value.__qualname__)
            self.read(value.__code__)
            self.read(value.__defaults__)
            self._read_all([cell.cell_contents for cell in value.__closure__ or ()])

    def _read_object(self, value: Any) -> None:
        """Read an object by its attributes, or where it has none by what pickle would keep."""
        kind = type(value)
        self.tell("object", kind.__module__, kind.__qualname__)
        attributes = dict(getattr(value, "__dict__", {}))
        for base in kind.__mro__:
            names = vars(base).get("__slots__", ())
            for name in (names,) if isinstance(names, str) else names:
                if hasattr(value, name):
                    attributes[name] = getattr(value, name)
        for name in sorted(attributes.keys() - self.left_out):
            self.tell(name)
            self.read(attributes[name])
        if not attributes and not isinstance(value, gym.Env):
            try:
                self.read(list(value.__reduce_ex__(4)[1:]))
            except TypeError as error:
                raise TaskError(
                    "states must be told apart to be tabulated, by all that an environment holds "
                    f"or by functions state=(save, restore): a {kind.__qualname__} in it cannot be "
                    f"read ({error})"
                ) from None
