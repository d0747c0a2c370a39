"""The states of an environment: how they are told apart, saved and restored."""

import hashlib
import pickle
import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from itertools import count
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.envs.toy_text.blackjack import BlackjackEnv
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.utils import EzPickle
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit

from curricle.arrays import IntArray
from curricle.errors import SettingError, TaskError, in_words
from curricle.interop.tabulated_task import POSITION, parts_of
from curricle.tasks.observation_task import SHARED, layers_of, shared_restored
from curricle.tasks.spaces import entry_names

TOY_TEXT = BlackjackEnv, CliffWalkingEnv, FrozenLakeEnv, TaxiEnv
HARMLESS = OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit
"""Wrappers that change no transition; the time limit is read from the specification."""


def acts_as(env: object, *kinds: type, methods: Sequence[str] = ("step", "reset")) -> bool:
    """Return whether an environment is of one of these classes, with the class's own methods."""
    kind = next((kind for kind in kinds if isinstance(env, kind)), None)
    return kind is not None and all(
        getattr(type(env), name) is getattr(kind, name) and name not in vars(env)
        for name in methods
    )


Generator = np.random.Generator | np.random.RandomState | random.Random
GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
SALT = 2718  # with which seeds of repeated steps are made, so that they are not those of resets


def restart(generators: Sequence[Generator], repetition: int) -> None:
    """Seed generators, each of them differently in each repetition."""
    for place, generator in enumerate(generators):
        seed = int(np.random.SeedSequence([SALT, place, repetition]).generate_state(1)[0])
        if isinstance(generator, np.random.Generator):
            bits = generator.bit_generator
            bits.state = type(bits)(seed).state
        else:
            generator.seed(seed)


@contextmanager
def shared_draws() -> Iterator[Callable[[], bool]]:
    """Return a context that notes whether the global generators are used, and resets them."""
    before = [*map(state_of, SHARED)]
    with shared_restored():
        yield lambda: [*map(state_of, SHARED)] != before


def state_of(generator: Generator) -> bytes:
    """Return a generator's state in a form that can be compared."""
    if isinstance(generator, np.random.Generator):
        return pickle.dumps(generator.bit_generator.state)
    return pickle.dumps(generator.__getstate__())


PLAIN = (type(None), bool, int, float, complex, str, bytes)
CONSTANT = (gym.Space, EnvSpec, *GENERATORS)
"""Parts that belong to no state: spaces and specifications are constant, and generators of random
numbers decide what happens next only in environments that are random."""
DRAWING = frozenset({"pygame", "pyglet", "matplotlib", "PIL", "cv2", "tkinter"})
"""Packages whose objects (windows, clocks, fonts) are part of no state; copies share them."""
PLACES = ("Rect", "FRect", "Vector2", "Vector3", "Color")
NAMED = (type, BuiltinFunctionType, ModuleType)
# What is read again wherever it is met: sharing it makes no difference.
UNCHANGING = (tuple, frozenset, Enum, *NAMED, MethodType, CodeType)


def _draws(kind: Any) -> bool:
    """Return whether objects of a type are those of a package that draws, and hold no place."""
    module = getattr(kind, "__module__", "")
    return module.partition(".")[0] in DRAWING and kind.__name__ not in PLACES


draws: Callable[[Any], bool] = cache(_draws)


def _has_order(key: object) -> bool:
    """Return whether the text of a dict's key is that of equal keys in copies."""
    if isinstance(key, tuple):
        return all(map(_has_order, key))
    return isinstance(key, (*PLAIN, Enum, np.generic))


def fingerprint(value: object, left_out: Collection[str] = ()) -> bytes:
    """Return a digest, 16 bytes, of a value and all it refers to, without names in `left_out`."""
    return _Reader(value, frozenset(left_out)).digest.digest()


class _Reader:
    """Feeds a value to a digest: a shared part the first time, later its number."""

    def __init__(self, value: object, left_out: frozenset[str], *, strict: bool = True):
        self.left_out, self.strict = left_out, strict
        # A pickle would not do: equal sets have several, and equal strings are shared or not.
        self.digest = hashlib.blake2b(digest_size=16)
        self.numbers = dict[int, int]()
        self.skipped = set[str]()  # the attributes among `left_out` that were met
        self.generators = dict[int, Generator]()
        self.alive = list[Any]()  # so that no number in `numbers` is given to another object
        self.read(value)

    def tell(self, *parts: object) -> None:
        for part in parts:
            content = part if isinstance(part, bytes) else str(part).encode()
            self.digest.update(b"%d:" % len(content) + content)

    def read(self, value: object) -> None:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, PLAIN) and not isinstance(value, Enum):
            self.tell(type(value).__name__, value if isinstance(value, bytes) else repr(value))
        elif isinstance(value, CONSTANT) or draws(type(value)):
            self.tell("constant")
            if isinstance(value, GENERATORS):
                self.generators[id(value)] = value
        elif isinstance(value, HARMLESS) and acts_as(value, *HARMLESS):
            self.read(value.env)
        elif isinstance(value, UNCHANGING):
            self._read_parts(value)
        elif id(value) in self.numbers:
            self.tell("met", self.numbers[id(value)])
        else:
            self.numbers[id(value)] = len(self.numbers)
            self.alive.append(value)
            self._read_parts(value)

    def _read_parts(self, value: object) -> None:
        """Read a value that has parts or a name."""
        parts: Collection[Any] | None = None
        if isinstance(value, np.ndarray) and value.dtype != object:
            self.tell("array", value.dtype.str, value.shape, value.tobytes())
        elif isinstance(value, Enum):
            self.tell("enum", type(value).__qualname__, value.name)
        elif isinstance(value, NAMED):
            self.tell("name", getattr(value, "__module__", ""), value.__name__)
        elif isinstance(value, MethodType):
            self.tell("method", value.__func__.__qualname__)
            self.read(value.__self__)
        elif isinstance(value, CodeType):
            self.tell("code", value.co_code, repr(value.co_names))
            parts = value.co_consts
        elif isinstance(value, FunctionType):
            self.tell("function", value.__module__, value.__qualname__)
            self.read((value.__code__, value.__defaults__, value.__kwdefaults__))
            parts = [cell.cell_contents for cell in value.__closure__ or ()]
        elif isinstance(value, tuple | list | deque | np.ndarray):
            self.tell(type(value).__name__, np.shape(value) if hasattr(value, "shape") else "")
            parts = list(value)
        elif isinstance(value, dict):
            self.tell(type(value).__name__, len(value))
            # Objects that have no order keep that of their insertion, as copies do.
            for key in sorted(value, key=repr) if all(map(_has_order, value)) else value:
                self.read(key)
                self.read(value[key])
        elif isinstance(value, set | frozenset):
            self.tell("set", *sorted(fingerprint(part, self.left_out) for part in value))
        else:
            self._read_object(value)
        if parts is not None:
            self.tell(len(parts))
            for part in parts:
                self.read(part)

    def _read_object(self, value: object) -> None:
        """Read an object's attributes, or what pickle would keep where it has none."""
        kind = type(value)
        self.tell("object", getattr(kind, "__module__", ""), kind.__qualname__)  # SWIG's have none
        attributes = dict(getattr(value, "__dict__", {}))
        for base in kind.__mro__:
            names = vars(base).get("__slots__", ())
            for name in (names,) if isinstance(names, str) else names:
                if hasattr(value, name):
                    attributes[name] = getattr(value, name)
        left_out = self.left_out | TOY_CONSTANTS if acts_as(value, *TOY_TEXT) else self.left_out
        self.skipped |= attributes.keys() & left_out
        for name in sorted(attributes.keys() - left_out):
            self.tell(name)
            self.read(attributes[name])
        if attributes or isinstance(value, gym.Env):
            return
        try:
            self.read(list(value.__reduce_ex__(4)[1:]))
        except TypeError as error:
            if self.strict:
                raise TaskError(
                    "states must be told apart to be tabulated, by all that an environment holds "
                    f"or by functions state=(save, restore): a {kind.__qualname__} in it cannot be "
                    f"read ({error}); from_gymnasium plays it live, with encode=Bins(...) where "
                    "observations are no whole numbers"
                ) from None


Environment = gym.Env[Any, Any]
Words = Mapping[str, int | str]  # a state in words: the value of each component by name
CONSTANTS = frozenset({"metadata", "spec"})  # attributes that no step changes; copies share them
TOY_CONSTANTS = frozenset({"P", "initial_state_distrib", "desc", "locs"})  # of toy-text
LEFT_OUT = CONSTANTS | {"_np_random_seed"}  # attributes that make no difference between states
TOY_DRAWN = frozenset({"lastaction", "taxi_orientation"})  # of toy-text, where nothing wraps it
MOST_CELLS = 16  # entries of an array that are part of a state's label, at most


class Restored(NamedTuple):
    """An environment in a state, and the generators from which its steps may draw."""

    env: Environment
    generators: Sequence[Generator]


class StateAccess(ABC):
    """Saves and restores the states of one environment while it is tabulated."""

    copies = False  # whether each restored state has an environment of its own, with wrappers
    hint = ""  # another possible cause where a repeated step leads elsewhere
    note = ""  # how the tables differ from the environment
    witnessed = False  # whether a state that is met again must lead as it did before

    def prepare(self, env: Environment) -> None:  # noqa: B027 - many have nothing to do
        """Change the environment once, before it is tabulated."""

    def begin(self, env: Environment) -> None:  # noqa: B027
        """Prepare for the states after a reset."""

    @abstractmethod
    def save(self, env: Environment, returned: object) -> tuple[Hashable, object]:
        """Return a key, equal for equal states, and the content from which to restore the state.

        `returned` is the observation that a step or reset returned.
        """

    @abstractmethod
    def restore(self, env: Environment, content: object) -> Restored:
        """Return an environment in a saved state, maybe `env` itself, and its generators."""

    def check(self) -> None:  # noqa: B027 - many have nothing to do
        """Check the settings as soon as all actions have been taken in the first state."""

    def observation(self, env: Environment, returned: object) -> object:
        """Return the observation, from the observation that a step or reset returned."""
        return returned

    @abstractmethod
    def describe(self, env: Environment, observation: object) -> Words:
        """Return the state's components by name."""

    def end(self) -> None:  # noqa: B027 - many have nothing to do
        """Check that nothing was missed, when all states are known."""


@dataclass(frozen=True)
class DeepCopy:
    """States are deep copies of the environment: right for every environment that can be copied.

    Two states are equal if all their attributes but random generators are equal. In the end states
    are merged whose later observations and rewards are the same.

    Parameters
    ----------
    ignore : collection of str
        Names of attributes that change no observation and no reward, such as a counter for display.
    observed : collection of str, optional
        Take states that look alike for one state, whatever else the environment holds, such as a
        record of what was done; the names of an observation's numbers, or none for their places.
        Where steps are certain, each state is met again in another way, and must lead as it did.

    Examples
    --------
    >>> DeepCopy(ignore=["episodes_so_far"])
    DeepCopy(ignore=('episodes_so_far',), observed=None)
    """

    ignore: Collection[str] = ()
    observed: Collection[str] | None = None

    def __post_init__(self) -> None:
        for key in ("ignore", "observed")[: 1 if self.observed is None else 2]:
            names = getattr(self, key)
            if not isinstance(names, Collection) or isinstance(names, str):
                raise SettingError(f"{key} must be a list of names: got {names!r}")
            object.__setattr__(self, key, tuple(map(str, names)))

    def open(self) -> StateAccess:
        """Return the `StateAccess` that saves and restores by copies."""
        if self.observed is not None:
            return ObservedCopies(tuple(self.observed))
        return Copies(frozenset(self.ignore))


class Copies(StateAccess):
    """States as copies: the content of a state is an environment."""

    copies = True

    def __init__(self, ignored: frozenset[str]):
        self.ignored, self.unmet = ignored, set(ignored)

    def save(self, env: Environment, returned: object) -> tuple[Hashable, Environment]:
        """Return the environment's digest, and itself."""
        reader = _Reader(env, self.ignored | left_out(env))
        self.unmet -= reader.skipped
        return reader.digest.digest(), env

    def check(self) -> None:
        """Raise SettingError if `ignore` names an attribute that nothing has."""
        if self.unmet:
            raise SettingError(
                "ignore must name attributes in the environment: nothing in it has "
                f"{', '.join(sorted(self.unmet))}"
            )

    def restore(self, env: Environment, content: object) -> Restored:
        """Return a copy, and its generators, wherever it holds them."""
        copy, memo = copied(content)
        if any(hasattr(type(layer), "__deepcopy__") for layer in layers_of(copy)):
            generators = _Reader(copy, left_out(copy), strict=False).generators
            return Restored(copy, [*generators.values()])
        return Restored(copy, [part for part in memo.values() if isinstance(part, GENERATORS)])

    def describe(self, env: Environment, observation: object) -> Words:
        """Return the plain attributes of the environment."""
        attributes, ignored = vars(env.unwrapped).items(), self.ignored | left_out(env)
        return words_of_state({name: value for name, value in attributes if name not in ignored})


def time_before(number: int, end: int) -> int:
    """Return a time before an episode's end; times of consecutive numbers are far apart."""
    return int(number * 0.618034 % 1 * max(1, end - 1))


class Uncounted(Copies):
    """Copies at all counts of an episode in turn, so that repeated steps differ if it matters."""

    def __init__(self, counters: Mapping[str, int], longest: int):
        super().__init__(frozenset(counters))
        self.counters, self.longest, self.times = counters, longest, count()  # counts at first
        self.hint = f", and may depend on {' and '.join(counters)} only with state=DeepCopy()"

    def open(self) -> StateAccess:
        """Return itself, which serves one tabulation."""
        return self

    def restore(self, env: Environment, content: object) -> Restored:
        """Return a copy at another count than the last, and its generators."""
        restored, taken = super().restore(env, content), time_before(next(self.times), self.longest)
        for name, first in self.counters.items():
            setattr(restored.env.unwrapped, name, first + taken)
        return restored


class ObservedCopies(Copies):
    """Copies that are told apart by their observations alone."""

    witnessed = True
    note = "states that look alike are one"

    def __init__(self, names: tuple[str, ...]):
        super().__init__(frozenset())
        self.names = names

    def save(self, env: Environment, returned: object) -> tuple[Hashable, Environment]:
        """Return the observation's digest, and the environment."""
        return fingerprint(returned), env

    def describe(self, env: Environment, observation: object) -> Words:
        """Return the numbers in an observation, fractions as words; none if they are many."""
        entries = dict[str, Any]()
        for name, part in parts_of(observation).items():
            leaf, called = np.asarray(part), (name or "state").replace("/", "_").strip(POSITION)
            places = entry_names(called, leaf.shape) if leaf.ndim else [called]
            entries |= zip(places, leaf.ravel().tolist(), strict=True)
        if len(entries) > MOST_CELLS:
            return {}
        names = self.names if len(self.names) == len(entries) else tuple(entries)
        for place, number in entries.items():
            if isinstance(number, float):
                entries[place] = f"{number:.6g}" if number % 1 else int(number)
        return words_of_state(dict(zip(names, entries.values(), strict=True)))


@dataclass(eq=False)
class SaveAndRestore(StateAccess):
    """States are saved and restored by two functions: a hundred times as fast as copies."""

    save_state: Callable[[Any], Hashable]
    restore_state: Callable[[Any, Any], Any]
    generators: list[Generator] = field(default_factory=list)

    def begin(self, env: Environment) -> None:
        """Find the random generators, wherever the environment can be read."""
        reader = _Reader(env, left_out(env), strict=False)
        self.generators = list(reader.generators.values())

    def save(self, env: Environment, returned: object) -> tuple[Hashable, Any]:
        """Return what the user's function returns, as key and as content."""
        state = self.save_state(env.unwrapped)
        try:
            hash(state)
        except TypeError:
            raise TaskError(
                f"a saved state must be hashable, as a tuple of numbers is: {state!r} is a "
                f"{type(state).__name__}"
            ) from None
        return state, state

    def restore(self, env: Environment, content: object) -> Restored:
        """Return the same environment, put into the state."""
        self.restore_state(env.unwrapped, content)
        return Restored(env, self.generators)

    def describe(self, env: Environment, observation: object) -> Words:
        """Return the numbers and words that are saved."""
        return words_of_state(self.save_state(env.unwrapped))


def left_out(env: Environment) -> frozenset[str]:
    """Return the names of an environment's attributes that make no difference between states."""
    # A wrapper may read what its toy-text environment only draws.
    return LEFT_OUT | TOY_DRAWN if acts_as(env, *TOY_TEXT) else LEFT_OUT


def copied(env: object) -> tuple[Any, dict[int, Any]]:
    """Return a deep copy that shares what is constant, and the memo of copying; or TaskError."""
    memo: dict[int, Any] = {
        id(value): value
        for layer in layers_of(env)
        for name, value in vars(layer).items()
        if name in CONSTANTS
        or isinstance(value, gym.Space)
        or draws(type(value))
        or (name in TOY_CONSTANTS and acts_as(layer, *TOY_TEXT))
    }
    try:
        for layer in layers_of(env)[::-1]:
            if isinstance(layer, EzPickle):  # which keeps its constructor's arguments alone
                memo[id(layer)] = new = object.__new__(type(layer))
                vars(new).update(deepcopy(vars(layer), memo))
        return deepcopy(env, memo), memo
    except Exception as error:
        raise TaskError(
            "an environment that cannot be copied needs functions state=(save, restore) to be "
            "tabulated; from_gymnasium plays it live, and observation_task makes a network's task "
            f"of it: copying {env} failed with {in_words(error)}"
        ) from error


def words_of_state(state: object, before: str = "") -> Words:
    """Return the whole numbers and words in a state, alone or in a short list, by name."""
    named = state._asdict() if hasattr(state, "_asdict") else state
    named = named if isinstance(named, Mapping) else {"state": state}
    values, whole = dict[str, Any](), {f"{before}{name}" for name in named}
    for name, value in named.items():
        if isinstance(value, tuple | list | np.ndarray):
            flat = value.ravel().tolist() if isinstance(value, np.ndarray) else list(value)
            if len(flat) <= MOST_CELLS:
                shape = value.shape if isinstance(value, np.ndarray) else (len(flat),)
                for entry, number in zip(entry_names(f"{before}{name}", shape), flat, strict=True):
                    while entry in values or entry in whole:  # of {"a": [3], "a_1": 4}
                        entry += "_"
                    values[entry] = number
        else:
            values[f"{before}{name}"] = value
    return {
        name: value if isinstance(value, str) else int(value)
        for name, value in values.items()
        if isinstance(value, bool | int | np.integer | np.bool_ | str) and value != ""
    }


def counters_of(
    states: Sequence[Words], before: IntArray, after: IntArray, env: Environment
) -> list[str]:
    """Return the attributes that count steps: 1 higher in each state `after` than `before` it."""
    names = list[str]()
    for name in sorted(vars(env.unwrapped).keys() & states[0].keys()):
        column = [components.get(name) for components in states]
        if len(after) and all(isinstance(value, int) for value in column):
            values = np.array(column)
            names += [name] * bool((values[after] == values[before] + 1).all())
    return names
