"""The states of an environment: how they are distinguished, saved, restored, and all found."""

import hashlib
import math
import random
import re
import time
from abc import ABC, abstractmethod
from array import array
from collections import deque
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple, Self

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
from curricle.checks import number
from curricle.errors import SettingError, TaskError, in_words, note_place
from curricle.interop.tabulated_task import POSITION, parts_of, same_observation
from curricle.tasks.live import RETURNED, action_mask, seeded_reset, wrong_parts
from curricle.tasks.mdp import SINGLE_PRECISION
from curricle.tasks.models import flag_of, number_of
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
GeneratorState = Mapping[str, Any] | tuple[Any, ...]
GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
SALT = 2718  # begins the seeds of repeated steps, so that they are not those of resets


def restart(
    generators: Sequence[Generator],
    repetition: int,
    states: Mapping[tuple[int, type], GeneratorState],
) -> None:
    """Seed generators differently in each repetition, or let them go on from their `states`."""
    for place, generator in enumerate(generators):
        kind = kind_of(generator)
        _set(generator, states.get((place, kind)) or _fresh(kind, place, repetition))


@contextmanager
def shared_draws() -> Iterator[Callable[[], bool]]:
    """Return a context that notes whether the global generators are used, and resets them."""
    before = [*map(state_of, SHARED)]
    with shared_restored():
        yield lambda: [*map(state_of, SHARED)] != before


def state_of(generator: Generator) -> GeneratorState:
    """Return a generator's state in a form that can be compared."""
    if isinstance(generator, np.random.Generator):
        return generator.bit_generator.state
    if isinstance(generator, np.random.RandomState):
        name, keys, *rest = generator.get_state()
        return name, tuple(np.asarray(keys).tolist()), *rest
    return generator.getstate()


def _set(generator: Generator, state: Any) -> None:
    if isinstance(generator, np.random.Generator):
        generator.bit_generator.state = state
    elif isinstance(generator, np.random.RandomState):
        generator.set_state(state)
    else:
        generator.setstate(state)


@cache
def _fresh(kind: type[Any], place: int, repetition: int) -> GeneratorState:
    new = kind(SALT + 1000 * place + repetition)
    return new.state if isinstance(new, np.random.BitGenerator) else state_of(new)


def kind_of(generator: object) -> type:
    """Return the kind of a generator: the type that draws its bits."""
    if isinstance(generator, np.random.Generator):
        return type(generator.bit_generator)
    return next(kind for kind in GENERATORS if isinstance(generator, kind))


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
            for key in sorted(value, key=repr):
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

    copies: bool  # whether each restored state has an environment of its own, with wrappers
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
    """States as copies: the content of a state is an environment and its random generators."""

    copies = True

    def __init__(self, ignored: frozenset[str]):
        self.ignored, self.unmet = ignored, set(ignored)

    def save(self, env: Environment, returned: object) -> tuple[Hashable, Restored]:
        """Return the environment's digest; and itself, with its generators."""
        reader = _Reader(env, self.ignored | left_out(env))
        self.unmet -= reader.skipped
        return reader.digest.digest(), Restored(env, [*reader.generators.values()])

    def check(self) -> None:
        """Raise SettingError if `ignore` names an attribute that nothing has."""
        if self.unmet:
            raise SettingError(
                "ignore must name attributes in the environment: nothing in it has "
                f"{', '.join(sorted(self.unmet))}"
            )

    def restore(self, env: Environment, content: object) -> Restored:
        """Return a copy, and its generators."""
        assert isinstance(content, Restored)
        copy, memo = copied(content.env)
        return Restored(copy, [memo[id(part)] for part in content.generators if id(part) in memo])

    def describe(self, env: Environment, observation: object) -> Words:
        """Return the plain attributes of the environment."""
        attributes, ignored = vars(env.unwrapped).items(), self.ignored | left_out(env)
        return words_of_state({name: value for name, value in attributes if name not in ignored})


class ObservedCopies(Copies):
    """Copies that are told apart by their observations alone."""

    witnessed = True

    def __init__(self, names: tuple[str, ...]):
        super().__init__(frozenset())
        self.names = names

    def save(self, env: Environment, returned: object) -> tuple[Hashable, Restored]:
        """Return the observation's digest; and the environment, with its generators."""
        parts = [part for layer in layers_of(env) for part in vars(layer).values()]
        generators = [part for part in parts if isinstance(part, GENERATORS)]
        return fingerprint(returned), Restored(env, generators)

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
        values = (f"{x:.6g}" if isinstance(x, float) and x % 1 else x for x in entries.values())
        return words_of_state(
            {
                name: int(x) if isinstance(x, float) else x
                for name, x in zip(names, values, strict=True)
            }
        )


@dataclass(eq=False)
class SaveAndRestore(StateAccess):
    """States are saved and restored by two functions: a hundred times as fast as copies."""

    save_state: Callable[[Any], Hashable]
    restore_state: Callable[[Any, Any], Any]
    generators: list[Generator] = field(default_factory=list)
    copies = False

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


# -- breadth-first search for every state that can be reached --------------------------------------


MORE_RESETS = 8  # with other seeds, to see whether the states that they lead to differ
INTERVAL = 0.5  # seconds between two reports of progress


class Reached(NamedTuple):
    """An outcome of an action: the next state, its probability and its reward."""

    probability: float
    key: Hashable  # equal for equal states
    content: object  # what the state is restored from
    reward: float
    terminated: bool
    truncated: bool
    available: tuple[bool, ...] | None = None  # the actions that can be taken there; None for all
    # The environment in that state, until it is stepped again, and what its step or reset returned.
    env: Any = None
    returned: Any = None


class State(NamedTuple):
    """A state, as it was when it was reached first."""

    terminal: bool
    observation: object
    components: Words


ALIKE = (
    "states must lead alike where they look alike, to be told apart by observations: in {} an "
    "action led to another state or reward when its observation was met again"
)


class Search:
    """All states that can be reached and a table of all outcomes, breadth first."""

    def __init__(
        self,
        stepper: "World | ListedOutcomes",
        max_states: int,
        max_seconds: float,
        show: Callable[[str, int, int], object],  # a sentence; states done and found
    ):
        self.stepper, self.show = stepper, show
        self.max_states, self.max_seconds = max_states, max_seconds
        self.states = list[State]()  # in the order of meeting
        # The columns of the table of outcomes; a pair is state x A + action.
        self.pair, self.next_state = array("q"), array("q")
        self.probability, self.reward = array("d"), array("d")
        self.first = list[int]()  # the state that each start leads to
        self.several = False  # whether resets lead to different states
        self.cut = 0  # states from which nothing goes on, as episodes are truncated there
        self.seconds = 0.0
        self._numbers = dict[tuple[Hashable, bool], int]()
        # The states whose actions are to be taken: number, content, available actions.
        self._queue = deque[tuple[int, object, tuple[bool, ...] | None]]()
        self._queued = bytearray()  # of each state, how often it was put into the queue
        self._done = bytearray()  # of each state, whether its actions have been taken
        self._led = dict[int, tuple[int, float]]()  # where a pair led, if states are tried twice
        self._tries = 1 + stepper.witnessed  # of each state
        self._last: Any = None  # the environment in the state that was reached last

    def run(self) -> Self:
        """Search to the end and return the search; TaskError when a limit is reached before."""
        stepper, n_actions, seeds = self.stepper, self.stepper.n_actions, self.stepper.seeds
        began = shown = time.perf_counter()
        for seed in seeds:
            observed = deepcopy(stepper.look(stepper.start(seed))[0])
            reached = stepper.start(seed)
            number = self._number(reached)
            if not same_observation(observed, stepper.look(reached)[0]):
                raise TaskError(
                    f"a reset must follow its seed: two resets of {stepper.name} with seed "
                    f"{seed} differ; let reset call super().reset(seed=seed), and draw from "
                    "self.np_random alone"
                )
            self.first.append(number)
        expanded = 0
        while self._queue:
            number, content, available = self._queue.popleft()
            again, self._done[number] = self._done[number], True
            for action in range(n_actions):
                if available is not None and not available[action]:
                    continue
                try:
                    for reached in stepper.outcomes(content, action):
                        pair, after = number * n_actions + action, self._number(reached)
                        led = after, reached.reward
                        if self._tries > 1 and self._led.setdefault(pair, led) != led:
                            raise TaskError(ALIKE.format(self.stepper.name))
                        if not again:
                            self._add(pair, after, reached.probability, reached.reward)
                except Exception as error:
                    parts = (f"{k} {v}" for k, v in self.states[number].components.items())
                    note_place(
                        error, f", for action {action} in state {number} ({', '.join(parts)})"
                    )
                    raise
                now, n_states = time.perf_counter(), len(self.states)
                if now - began > self.max_seconds:
                    raise TaskError(
                        f"a table must be complete within max_seconds, {self.max_seconds:g}: "
                        f"tabulating {stepper.name} had found {n_states:,} states by then and "
                        f"done {expanded:,} of them{self._hint()}"
                    )
                if now - shown > INTERVAL:
                    shown, speed = now, len(self.pair) / (now - began)
                    sentence = (
                        f"tabulating {stepper.name}: {n_states:,} states, {expanded:,} done, "
                        f"{speed:,.0f} transitions a second"
                    )
                    self.show(sentence, expanded, n_states)
            expanded += not again
        for number, state in enumerate(self.states):
            if not (self._queued[number] or state.terminal):
                self.cut += 1
                for pair in range(number * n_actions, (number + 1) * n_actions):
                    self._add(pair, number, 1.0, 0.0)
        resets = (stepper.start(max(seeds) + k) for k in range(1, MORE_RESETS + 1))
        starts = (self._numbers.get((reset.key, False)) in self.first for reset in resets)
        self.several = len({*self.first}) > 1 or not all(starts)
        self.seconds = time.perf_counter() - began
        return self

    def _add(self, pair: int, after: int, probability: float, reward: float) -> None:
        """Add a row to the table of outcomes: a pair that leads to the state `after`."""
        self.pair.append(pair)
        self.next_state.append(after)
        self.probability.append(probability)
        self.reward.append(reward)

    def _number(self, reached: Reached) -> int:
        """Return the number of a state, which is a new number if the state is new."""
        name = reached.key, reached.terminated  # entered with the episode's end it is another
        number, self._last = self._numbers.get(name), reached.env
        if number is None:
            number = self._numbers[name] = len(self.states)
            if number >= self.max_states:
                raise TaskError(
                    f"a table may have at most max_states, {self.max_states:,} states: tabulating "
                    f"{self.stepper.name} found more{self._hint()}"
                )
            observation, components = self.stepper.look(reached)
            observation = deepcopy(observation)  # which a step may change
            components = {**components, **words_of_state(observation, "_")}
            self.states.append(State(reached.terminated, observation, components))
            self._queued.append(0)
            self._done.append(False)
        goes_on = not (reached.terminated or reached.truncated)
        if goes_on and self._queued[number] < self._tries:
            self._queue.append((number, reached.content, reached.available))
            self._queued[number] += 1
        return number

    def _hint(self) -> str:
        """Return why there are many states: a part that counts steps, or that has most values."""
        of_states = [state.components for state in self.states]
        before = np.array(self.pair, np.int64) // self.stepper.n_actions
        counting = counters_of(of_states, before, np.array(self.next_state), self._last)
        if counting:
            return (
                f"; {counting[0]!r} counts steps, which state=DeepCopy(ignore={counting}) leaves "
                f"out (in a file ignore = {counting}): let time_limit end the episodes"
            )
        everywhere = set(of_states[0]).intersection(*of_states)
        values = dict[str, set[Any]]()
        for components in of_states:
            parts = dict[str, list[int | str]]()
            for name, value in components.items():
                # Entries that some states lack are those of a list that grows.
                whole = name if name in everywhere else re.sub(r"(_\d+)+$", "", name)
                parts.setdefault(whole, []).append(value)
            for name, part in parts.items():
                values.setdefault(name, set()).add(tuple(part))
        name = max(values, key=lambda name: len(values[name]), default="")
        hint = ", and most differ only in parts that are neither whole numbers nor words"
        different = {frozenset(components.items()) for components in of_states}
        if 2 * len(different) > len(of_states):
            hint = f", and {name!r} has the most values, {len(values[name]):,}"
        return f"{hint}; from_gymnasium plays it live" * (len(of_states) > 1)


REPETITIONS = 8  # of a step that draws random numbers; one that draws none is taken twice
LONG_AGO = -(2**62)  # steps that the clock of a wrapper shows, so that no time limit is met


@dataclass(eq=False)
class World:
    """An environment that is stepped from saved states."""

    env: Environment  # nobody else's: it is stepped and reset
    act: Callable[[int], Any]
    n_actions: int
    seeds: Sequence[int]
    samples: int | None
    access: StateAccess
    name: str
    action_masks: bool = False  # whether the environment says which actions can be taken
    transitions: int = 0
    drawing: int = 0  # pairs whose steps draw random numbers
    shared: Sequence[Generator] = ()  # the global generators, if steps or resets draw from them
    # The generators' states, where nobody has drawn since; where they were left after a sample.
    _undrawn: list[GeneratorState] | None = None
    _drawn: dict[tuple[int, type], GeneratorState] = field(default_factory=dict)

    def __post_init__(self) -> None:
        views_apart = not self.access.copies
        self.core, self.views, self.acts = core_and_views(self.env, views_apart=views_apart)
        self.access.prepare(self.env)

    @property
    def witnessed(self) -> bool:
        """Whether states that are met again are tried again, as a check that they are equal."""
        return self.access.witnessed and self.samples is None

    def start(self, seed: int) -> Reached:
        """Return the state after a reset with a seed."""
        self._undrawn, env = None, self.core
        if self.access.copies:
            env, _ = self.access.restore(self.core, Restored(self.core, []))
        with shared_restored():  # what the reset draws from them follows its seed
            returned, info = self._returned("reset", seeded_reset(env, seed))
        _rewind_clocks(env)
        self.access.begin(env)
        return self._reached(env, returned, info, 1.0, 0.0, terminated=False, truncated=False)

    def _reached(
        self, env: Environment, returned: object, info: object, chance: float, reward: float,
        *, terminated: bool, truncated: bool,
    ) -> Reached:  # fmt: skip
        """Return where an environment is after a step or a reset."""
        available = None
        if self.action_masks and not terminated:
            available = tuple(action_mask(env, info, self.n_actions).tolist())
        key, content = self.access.save(env, returned)
        ends = terminated, truncated
        return Reached(chance, key, content, reward, *ends, available, env, returned)

    def outcomes(self, content: object, action: int) -> Iterator[Reached]:
        """Yield an action's only outcome, or the outcome of every sample."""
        if self.transitions == self.n_actions:
            self.access.check()
        self.transitions += 1
        if self.samples is None:
            yield self._step(content, action)
            return
        for _ in range(self.samples):
            env, generators = self.access.restore(self.core, content)
            generators = [*generators, *self.shared]
            restart(generators, 0, self._drawn)  # with random numbers not used before
            reached = self._arrival(env, action)
            self._drawn |= {(k, kind_of(g)): state_of(g) for k, g in enumerate(generators)}
            yield reached

    def look(self, reached: Reached) -> tuple[object, Words]:
        """Return the observation and the components of the state that was reached last."""
        observation = self.access.observation(reached.env, reached.returned)
        for view in self.views:
            observation = view.observation(observation)
        return observation, self.access.describe(reached.env, observation)

    def _step(self, content: object, action: int) -> Reached:
        """Return the only outcome of an action in a saved state."""
        env, generators = self.access.restore(self.core, content)
        generators = [*generators, *self.shared]
        before = self._undrawn if self._undrawn is not None else [*map(state_of, generators)]
        first = self._arrival(env, action)
        after = [*map(state_of, generators)]
        drew = after != before
        self.drawing += drew
        for repetition in range(1, REPETITIONS if drew else 2):
            again, generators = self.access.restore(self.core, content)
            if drew:
                restart([*generators, *self.shared], repetition, {})
            self._check_repeated(first, self._arrival(again, action), action)
        # Where all is one environment its generators are now as they were, and it is in the same
        # state; else `first` has one of its own.
        self._undrawn = None if drew or self.access.copies else after
        return first

    def _arrival(self, env: Environment, action: int) -> Reached:
        """Return where a step leads."""
        core_action = self.act(action)
        for wrapper in self.acts:
            core_action = wrapper.action(core_action)
        returned = self._returned("step", env.step(core_action))
        observed, reward, terminated, truncated, info = returned
        _rewind_clocks(env)
        earned = number_of(reward)
        if not math.isfinite(earned):
            raise TaskError(f"a reward must be a finite number: got {reward!r} from {self.name}")
        chance = 1.0 if self.samples is None else 1 / self.samples
        flags = {"terminated": terminated, "truncated": truncated}
        place = f" from {self.name} for action {action}"
        ends = {name: flag_of(flag, name, place) for name, flag in flags.items()}
        return self._reached(env, observed, info, chance, earned, **ends)

    def _returned(self, by: str, returned: object) -> tuple[Any, ...]:
        """Return the result of a reset or a step; TaskError unless it has the right parts."""
        if not isinstance(returned, tuple) or len(returned) != len(RETURNED[by]):
            raise TaskError(f"{self.name}: {wrong_parts(by, returned)}")
        return returned

    def _check_repeated(self, first: Reached, again: Reached, action: int) -> None:
        differing, results = "", slice(3, 7)  # from the reward to the available actions
        if first.key != again.key:
            differing = "state"
        elif first[results] != again[results]:
            differing = "reward, end or mask of actions"
        elif not same_observation(first.returned, again.returned):
            differing = "observation"
        if differing:
            raise TaskError(
                "steps must be deterministic to be tabulated, unless outcomes= lists what can "
                "happen or samples= says from how many steps of a pair it is estimated "
                f"(from_gymnasium plays it live){self.access.hint}: action {action}, repeated from "
                f"one state of {self.name}, led to another {differing}"
            )


def time_limit_of(env: Environment, *more: int | None) -> int | None:
    """Return the steps after which an environment truncates: the least of its and more limits."""
    limits = [layer._max_episode_steps for layer in layers_of(env) if isinstance(layer, TimeLimit)]
    return min((int(steps) for steps in (*more, *limits) if steps is not None), default=None)


def _rewind_clocks(env: Environment) -> None:
    """Set back the clocks of time limits: time is no part of a state."""
    for layer in layers_of(env):
        if isinstance(layer, TimeLimit):
            layer._elapsed_steps = LONG_AGO  # type: ignore[assignment]


class Layers(NamedTuple):
    """The part of an environment that is stepped, and the wrappers apart from it."""

    core: Environment
    views: list[gym.ObservationWrapper[Any, Any, Any]]  # from the innermost
    acts: list[gym.ActionWrapper[Any, Any, Any]]  # from the outermost


def core_and_views(env: Environment, *, views_apart: bool) -> Layers:
    """Return the part of an environment that is stepped, and the wrappers apart from it."""
    views, acts = list[Any](), list[Any]()
    while isinstance(env, gym.Wrapper):
        if views_apart and acts_as(env, gym.ObservationWrapper):
            views.insert(0, env)
        elif views_apart and acts_as(env, gym.ActionWrapper):
            acts.append(env)
        elif not acts_as(env, *HARMLESS):
            break
        env = env.env
    return Layers(env, views, acts)


Listed = Callable[[Any, int], Sequence[tuple[float, Any, float, bool]]]
"""From a state and an action to (probability, next state, reward, terminated) of each outcome."""


@dataclass(eq=False)
class ListedOutcomes:
    """Outcomes that a function or a table lists, of states or observations."""

    env: Environment
    listed: Listed
    n_actions: int
    seeds: Sequence[int]
    name: str
    save: Callable[[Any], Hashable] | None = None
    parts: Callable[[Any], Words] | None = None
    transitions: int = 0
    witnessed = False

    def start(self, seed: int) -> Reached:
        """Return the state after a reset."""
        observed, _ = seeded_reset(self.env, seed)
        state = deepcopy(observed) if self.save is None else self.save(self.env.unwrapped)
        return self._reached(1.0, state, 0.0, ended=False)

    def outcomes(self, content: object, action: int) -> Iterable[Reached]:
        """Yield the outcomes that are possible."""
        self.transitions += 1
        total = 0.0
        listed = self.listed(content, action)
        outcomes = [*listed] if isinstance(listed, Iterable) else [listed]
        for outcome in outcomes:
            try:
                chance, after, reward, ended = outcome
                chance = number("a probability", chance, TaskError, 0, 1)
                reward = number("a reward", reward, TaskError)
                # As an array or named tuple where the environment's own states are these.
                if isinstance(content, np.ndarray):
                    after = np.asarray(after, content.dtype)
                elif isinstance(content, tuple) and isinstance(after, np.ndarray | list | tuple):
                    after = getattr(content, "_make", tuple)(after)
                hash(_key(after))
            except (TypeError, ValueError) as error:
                raise TaskError(
                    "an outcome must be (probability, next state, reward, terminated) with finite "
                    f"numbers and a hashable state: action {action} in {content!r} lists "
                    f"{outcome!r}"
                ) from error
            total += chance
            if chance > 0:
                # A text of the state for every outcome would cost more than the rest.
                place = "" if type(ended) is bool else f": action {action} in {content!r}"
                ended = flag_of(ended, "terminated", place)
                yield self._reached(chance, after, reward, ended=ended)
        if outcomes and abs(total - 1) > SINGLE_PRECISION:
            raise TaskError(
                f"transition probabilities must sum to 1: action {action} in {content!r} sums to "
                f"{total:.10g}"
            )

    def look(self, reached: Reached) -> tuple[object, Words]:
        """Return the state, if it is an observation, and its components."""
        state = reached.content
        components = words_of_state(state) if self.parts is None else self.parts(state)
        return state if self.save is None else None, components

    def _reached(self, chance: float, state: object, reward: float, *, ended: bool) -> Reached:
        return Reached(chance, _key(state), state, reward, ended, truncated=False, env=self.env)


def _key(state: object) -> Hashable:
    """Return a hashable key, equal for equal states: arrays and lists become tuples."""
    if isinstance(state, np.ndarray):
        state = state.tolist()
    if isinstance(state, Mapping):
        return frozenset((key, _key(part)) for key, part in state.items())
    return tuple(map(_key, state)) if isinstance(state, list | tuple) else state
