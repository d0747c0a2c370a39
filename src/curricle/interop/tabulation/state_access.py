"""How the state of an environment is saved and restored: by deep copies, or by two functions."""

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np

from curricle.errors import SettingError, TaskError
from curricle.interop.tabulation.fingerprint import CONSTANT, fingerprint

Environment = gym.Env[Any, Any]
Words = Mapping[str, int | str]
"""A state in words: the value of each component by name."""
CONSTANTS = frozenset({"metadata", "spec"})
"""Attributes that no step changes; copies share them."""
TOY_TEXT = "gymnasium.envs.toy_text."
TOY_CONSTANTS = frozenset({"P", "initial_state_distrib", "desc", "locs"})
"""Further attributes of Gymnasium's toy-text environments that no step changes."""
LEFT_OUT = CONSTANTS | {"_np_random_seed"}
"""Attributes that make no difference between states."""
TOY_LEFT_OUT = TOY_CONSTANTS | {"lastaction", "taxi_orientation"}
"""Further ones of toy-text environments: some are only drawn."""
MOST_CELLS = 16
"""Entries of an array that are part of a state's label, at most."""


class SavedState(NamedTuple):
    """A state of an environment."""

    key: Hashable  # equal for equal states
    content: Any  # what it is restored from


class StateAccess(Protocol):
    """Saves and restores the states of one environment while it is tabulated.

    `copies` is whether each restored state has an environment of its own, wrappers included.
    """

    copies: bool

    def prepare(self, env: Environment) -> None:
        """Change for good what is to be tabulated in another way than the environment has it."""

    def begin(self, env: Environment) -> None:
        """Note what a reset made."""

    def save(self, env: Environment) -> SavedState:
        """Return the state of an environment."""

    def restore(self, env: Environment, content: Any) -> tuple[Environment, Sequence[Any]]:
        """Return an environment in a saved state, the one given or another; its generators."""

    def observation(self, env: Environment, returned: Any) -> Any:
        """Return the observation of an environment, given what its step or reset returned."""

    def describe(self, env: Environment) -> Words:
        """Return the state in words."""

    def end(self) -> None:
        """Check what can only be checked when all states are known."""


@dataclass(frozen=True)
class DeepCopy:
    """States are deep copies of the environment: right for every environment that can be copied.

    Two states are equal if all attributes are, part by part. Random generators do not count: what
    they decide is randomness. States that differ in nothing that can be observed or earned later
    are made one in the end.

    Parameters
    ----------
    ignore : collection of str
        Names of attributes, of whatever object, that make no difference to what happens, such as a
        counter that is only shown.

    Examples
    --------
    >>> DeepCopy(ignore=["episodes_so_far"])
    DeepCopy(ignore=('episodes_so_far',))
    """

    ignore: Collection[str] = ()

    def __post_init__(self) -> None:
        given = self.ignore
        if not isinstance(given, Collection) or isinstance(given, str):
            raise SettingError(f"ignore must be a list of attributes' names: got {given!r}")
        object.__setattr__(self, "ignore", tuple(map(str, given)))

    def open(self) -> StateAccess:
        """Return what saves and restores by copies."""
        return Copies(frozenset(self.ignore))


class Copies:
    """States as copies: the content of one is an environment and its random generators.

    Parameters
    ----------
    ignored : frozenset of str
        As of :class:`DeepCopy`.
    """

    copies = True

    def __init__(self, ignored: frozenset[str]):
        self.ignored = ignored

    def prepare(self, env: Environment) -> None:
        """Nothing is changed."""

    def begin(self, env: Environment) -> None:
        """Nothing is noted."""

    def save(self, env: Environment) -> SavedState:
        """Return the environment itself, and its digest."""
        generators = list[Any]()
        return SavedState(
            fingerprint(env, self.ignored | left_out(env), generators), (env, generators)
        )

    def restore(self, env: Environment, content: Any) -> tuple[Environment, Sequence[Any]]:
        """Return a copy, and its generators."""
        saved, generators = content
        copy, memo = copied(saved)
        return copy, [memo[id(each)] for each in generators if id(each) in memo]

    def observation(self, env: Environment, returned: Any) -> Any:
        """Return what the step returned."""
        return returned

    def describe(self, env: Environment) -> Words:
        """Return the plain attributes of the environment."""
        found, ignored = plain_attributes(env.unwrapped), self.ignored | left_out(env)
        return {name: value for name, value in found.items() if name not in ignored}

    def end(self) -> None:
        """Nothing is left to be checked."""


class SaveAndRestore:
    """States are saved and restored by two functions: a hundred times as fast as copies.

    Parameters
    ----------
    save_state : callable
        ``save(env)`` returns the state, hashable: equal states are one. `env` is the environment
        without wrappers.
    restore_state : callable
        ``restore(env, state)`` puts the environment into a state that was saved.
    """

    copies = False

    def __init__(
        self, save_state: Callable[[Any], Hashable], restore_state: Callable[[Any, Any], Any]
    ):
        self.save_state, self.restore_state = save_state, restore_state
        self.generators = list[Any]()

    def prepare(self, env: Environment) -> None:
        """Nothing is changed."""

    def begin(self, env: Environment) -> None:
        """Find the random generators."""
        self.generators = []
        fingerprint(env, left_out(env), self.generators)

    def save(self, env: Environment) -> SavedState:
        """Return what the function returns, which tells states apart and restores them."""
        state = self.save_state(env.unwrapped)
        try:
            hash(state)
        except TypeError:
            raise TaskError(
                f"a saved state must be hashable, as a tuple of numbers is: {state!r} is a "
                f"{type(state).__name__}"
            ) from None
        return SavedState(state, state)

    def restore(self, env: Environment, content: Any) -> tuple[Environment, Sequence[Any]]:
        """Return the same environment, put into the state."""
        self.restore_state(env.unwrapped, content)
        return env, self.generators

    def observation(self, env: Environment, returned: Any) -> Any:
        """Return what the step returned."""
        return returned

    def describe(self, env: Environment) -> Words:
        """Return the numbers and words that are saved."""
        return words_of_state(self.save_state(env.unwrapped))

    def end(self) -> None:
        """Nothing is left to be checked."""


def layers_of(env: Environment) -> list[Any]:
    """Return an environment's wrappers from the outermost, and it itself last."""
    found: list[Any] = [env]
    while isinstance(found[-1], gym.Wrapper):
        found.append(found[-1].env)
    return found


def left_out(env: Environment) -> frozenset[str]:
    """Return the names of an environment's attributes that make no difference between states."""
    return LEFT_OUT | TOY_LEFT_OUT if _is_toy(env) else LEFT_OUT


def _is_toy(env: Environment) -> bool:
    return type(env.unwrapped).__module__.startswith(TOY_TEXT)


def copied(env: Any) -> tuple[Any, dict[int, Any]]:
    """Return a deep copy that shares what is constant, and the memo of copying; or TaskError."""
    memo: dict[int, Any] = {}
    shared = CONSTANTS | TOY_CONSTANTS if _is_toy(env) else CONSTANTS
    layer: Any = env
    while layer is not None:
        for name, value in vars(layer).items():
            if name in shared or isinstance(value, gym.Space):
                memo[id(value)] = value
        layer = vars(layer).get("env")
    try:
        return deepcopy(env, memo), memo
    except Exception as error:
        raise TaskError(
            "an environment must be one that can be copied, or come with functions state=(save, "
            f"restore), to be tabulated: copying {env} failed with {type(error).__name__}: {error}"
        ) from error


def plain_attributes(env: Any) -> dict[str, int | str]:
    """Return an environment's attributes that are whole numbers or words.

    Examples
    --------
    >>> class Room:
    ...     def __init__(self):
    ...         self.place, self.lit = (2, 3), True
    >>> plain_attributes(Room())
    {'place_1': 2, 'place_2': 3, 'lit': 1}
    """
    found = dict[str, Any]()
    for name, value in vars(env).items():
        if name.startswith("_") or isinstance(value, CONSTANT):
            continue
        if isinstance(value, tuple | list | np.ndarray):
            flat = value.ravel().tolist() if isinstance(value, np.ndarray) else list(value)
            if len(flat) <= MOST_CELLS:
                found |= {f"{name}_{i + 1}": each for i, each in enumerate(flat)}
        else:
            found[name] = value
    return _plain(found)


def words_of_state(state: Any) -> Words:
    """Return the numbers and words of a state that is one of these, or a tuple of them.

    Examples
    --------
    >>> words_of_state((3, "red")), words_of_state(4)
    ({'state_1': 3, 'state_2': 'red'}, {'state': 4})
    """
    if not isinstance(state, tuple):
        return _plain({"state": state})
    names = getattr(state, "_fields", [f"state_{i + 1}" for i in range(len(state))])
    return _plain(dict(zip(names, state, strict=True)))


def _plain(values: Mapping[str, Any]) -> dict[str, int | str]:
    """Return what is a whole number or a word, the former as ints."""
    return {
        name: value if isinstance(value, str) else int(value)
        for name, value in values.items()
        if isinstance(value, bool | int | np.integer | np.bool_ | str) and value != ""
    }
