"""Gymnasium's discrete spaces and Curricle's spaces of named components, both ways.

At the end: the names and the transition tables of Gymnasium's toy-text environments.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeGuard

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.blackjack import BlackjackEnv
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.spaces import Dict, Discrete, MultiBinary, MultiDiscrete, Tuple
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit

from curricle.arrays import IntArray, frozen
from curricle.checks import text
from curricle.errors import SettingError, TaskError
from curricle.tasks.spaces import MISSING, Component, Space

Flatten = Callable[[Any], tuple[Any, ...]]
Form = Literal["index", "components"]


def space_of(space: gym.Space[Any], name: str) -> Space:
    """Return the points of a discrete Gymnasium space, one component for each number in them."""
    components = list(_components(space, name))
    if len({component.name for component in components}) < len(components):
        components = [replace(c, name=f"{name}_{i + 1}") for i, c in enumerate(components)]
    return Space(components)


def is_discrete(space: gym.Space[Any]) -> bool:
    """Return whether :func:`space_of` can read a space."""
    if isinstance(space, Tuple | Dict):
        return all(is_discrete(part) for _, part in _parts(space))
    return isinstance(space, Discrete | MultiDiscrete | MultiBinary)


def counts_from_0(space: gym.Space[Any]) -> "TypeGuard[Discrete[np.int64]]":
    """Return whether the points of a space are 0, 1, ..., n - 1."""
    return isinstance(space, Discrete) and bool(space.start == 0)


@dataclass(frozen=True)
class Number:
    """From a point of a discrete Gymnasium space to its number in :func:`space_of`."""

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, point: Any) -> int:
        """Return the number of a point, negative where it is none."""
        try:
            return self._place(point)
        except (TypeError, ValueError):  # of what is no whole number, or no array of them
            return MISSING

    def __getstate__(self) -> dict[str, Any]:
        return {"space": self.space}  # the function below cannot be pickled

    @cached_property
    def _place(self) -> Callable[[Any], int]:
        flatten, encode = _flattening(self.space), space_of(self.space, "part").encode_one
        return lambda point: encode(flatten(point))


@dataclass(frozen=True)
class Point:
    """From a number in :func:`space_of` to its point of a discrete Gymnasium space."""

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, number: int) -> Any:
        """Return the point of a number; arrays in it are read-only."""
        values = space_of(self.space, "part").decode(number).values()
        return _assembled(self.space, iter([int(value) for value in values]))


def _parts(space: "Tuple[Any] | Dict") -> list[tuple[Any, gym.Space[Any]]]:
    return list(space.spaces.items() if isinstance(space, Dict) else enumerate(space.spaces))


def _components(space: gym.Space[Any], name: str) -> Iterator[Component]:
    if isinstance(space, Discrete):
        yield Component(name, int(space.n), low=int(space.start))
    elif isinstance(space, MultiDiscrete):
        ranges = zip(space.nvec.flat, space.start.flat, strict=True)
        for i, (size, low) in enumerate(ranges):
            yield Component(f"{name}_{i + 1}", int(size), low=int(low))
    elif isinstance(space, MultiBinary):
        for i in range(math.prod(space.shape)):
            yield Component(f"{name}_{i + 1}", 2)
    elif isinstance(space, Tuple | Dict):
        for key, part in _parts(space):
            yield from _components(part, key if isinstance(key, str) else f"{name}_{key + 1}")
    else:
        raise TaskError(
            "a space must be Discrete, MultiDiscrete, MultiBinary or a Tuple or Dict of these: "
            f"{name!r} is {space}"
        )


def _flattening(space: gym.Space[Any]) -> Flatten:
    """Return the function from a point to its numbers; Gymnasium's `flatten` makes them one-hot."""
    if isinstance(space, Discrete):
        return lambda point: (point,)
    if not isinstance(space, Tuple | Dict):
        return lambda point: tuple(np.asarray(point).ravel().tolist())
    if isinstance(space, Tuple) and all(isinstance(part, Discrete) for part in space.spaces):
        return tuple
    inner = [(key, _flattening(part)) for key, part in _parts(space)]
    return lambda point: tuple(n for key, flat in inner for n in flat(point[key]))


def _assembled(space: gym.Space[Any], values: Iterator[int]) -> Any:
    """Return a point made of the numbers that come next."""
    if isinstance(space, Discrete):
        return next(values)
    if isinstance(space, Tuple):
        return tuple(_assembled(part, values) for part in space.spaces)
    if isinstance(space, Dict):
        return {key: _assembled(part, values) for key, part in space.spaces.items()}
    shape = space.shape or ()
    array = np.array([next(values) for _ in range(math.prod(shape))], space.dtype)
    return frozen(array.reshape(shape))


class Coding:
    """The points of a space as Gymnasium's spaces hold them."""

    def __init__(self, space: Space, form: Form):
        self.space, self.form = space, form
        self.gym_space: Discrete[np.int64] | MultiDiscrete[np.int64] = (
            Discrete(space.size) if form == "index" else MultiDiscrete(list(space.shape))
        )
        self._number = Number(self.gym_space)
        self._rows: IntArray | None = None
        if not space.is_box:
            lows = [component.low for component in space.components]
            self._rows = np.stack(list(space.decode().values()), axis=1) - lows

    def coded(self, point: int) -> Any:
        """Return a point in Gymnasium's space: an int, or an int64 array."""
        return point if self.form == "index" else np.array(self.offsets(point))

    def offsets(self, point: int) -> list[int]:
        """Return the offset of each component's value from its lowest."""
        if self._rows is not None:
            return self._rows[point].tolist()  # type: ignore[no-any-return]
        return [int(offset) for offset in np.unravel_index(point, self.space.shape)]

    def label(self, point: int) -> str:
        """Return a point in words, as :meth:`Space.label` does, but faster."""
        named = zip(self.space.components, self.offsets(point), strict=True)
        return " ".join(f"{part.name}={part.label(part.low + offset)}" for part, offset in named)

    def number(self, point: Any) -> int:
        """Return the number of a box's point in Gymnasium's space."""
        number = self._number(point)
        if number == MISSING:
            raise SettingError(f"an action must lie in {self.gym_space}: got {point!r}")
        return number


# -- names that a caller gives ---------------------------------------------------------------------


def name_list(names: Sequence[str], what: str = "names of a state's components") -> tuple[str, ...]:
    """Return names as a tuple; TaskError where they are no list of different texts."""
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise TaskError(f"{what} must be a list of text: got {names!r}")
    for name in names:
        text(f"one of the {what}", name, TaskError)
    if len(set(names)) < len(names):
        raise TaskError(f"{what} must differ: got {', '.join(names)}")
    return tuple(names)


def with_space(what: str, space: Space, other: Space | None) -> Space:
    """Return the space that a caller gives instead of another with as many points, if any."""
    if other is not None and other.size != space.size:
        raise TaskError(
            f"{what} must name the environment's {space.size}: got {other.size} of them"
        )
    return space if other is None else other


def with_names(space: Space, names: Sequence[str], sizes: Any = None) -> Space:
    """Return a space of states with other names; `sizes`, of each name, split a single number."""
    here = ", ".join(space.names)
    if sizes is None and len(names) == len(space.names):
        pairs = zip(space.components, names, strict=True)
        return Space([replace(c, name=name) for c, name in pairs], space.points)
    if sizes is None:
        raise TaskError(
            f"names must be one for each component of a state, in the order of {here}: got "
            f"{len(names)}, {', '.join(names) or 'none'}"
        )
    if isinstance(sizes, str) or not isinstance(sizes, Sequence):
        raise TaskError(f"sizes must be a list of whole numbers: got {sizes!r}")
    if len(space.components) > 1:
        raise TaskError(f"sizes are for observations that are one number: these have {here}")
    if len(sizes) != len(names):
        raise TaskError(
            f"sizes must be of each name, {', '.join(names)}: got {len(sizes)}, {list(sizes)}"
        )
    split = Space([Component(name, size) for name, size in zip(names, sizes, strict=True)])
    if split.size != space.size:
        raise TaskError(
            f"sizes must make the environment's {space.size:,} states when multiplied: "
            f"{' x '.join(map(str, sizes))} is {split.size:,}"
        )
    return split


# -- Gymnasium's toy-text environments -------------------------------------------------------------

TOY_TEXT = BlackjackEnv, CliffWalkingEnv, FrozenLakeEnv, TaxiEnv
HARMLESS = OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit
"""Wrappers that change no transition; the time limit is read from the specification."""
STANDS = ("red", "green", "yellow", "blue")
Outcomes = list[list[list[tuple[float, int, float, bool]]]]


def acts_as(env: Any, *kinds: type, methods: Sequence[str] = ("step", "reset")) -> bool:
    """Return whether an environment is of one of these classes, with the class's own methods."""
    kind = next((kind for kind in kinds if isinstance(env, kind)), None)
    return kind is not None and all(
        getattr(type(env), name) is getattr(kind, name) and name not in vars(env)
        for name in methods
    )


def has_table(env: gym.Env[Any, Any]) -> bool:
    """Return whether an environment has a transition table that describes it completely."""
    while isinstance(env, gym.Wrapper):
        if not acts_as(env, *HARMLESS) or (isinstance(env, TimeLimit) and env.spec is None):
            return False
        env = env.env
    states, actions, table = env.observation_space, env.action_space, getattr(env, "P", None)
    if not (acts_as(env, *TOY_TEXT) and counts_from_0(states) and counts_from_0(actions)):
        return False
    if getattr(env, "fickle_passenger", False):  # a taxi's moves with it are not in its table
        return False
    try:
        pairs: Any = [table[s][a] for s in range(int(states.n)) for a in range(int(actions.n))]  # type: ignore[index]
        lists_outcomes = all(len(outcome) == 4 for pair in pairs for outcome in pair)
        return lists_outcomes and len(table) == states.n  # type: ignore[arg-type]
    except (TypeError, KeyError, IndexError):
        return False


def outcomes_of(world: Any) -> Outcomes:
    """Return a table's outcomes, in which entering a state ends the episode always or never."""
    n_states, n_actions = int(world.observation_space.n), int(world.action_space.n)
    outcomes: Outcomes = [
        [[(p, int(after), r, bool(ended)) for p, after, r, ended in world.P[s][a]]
         for a in range(n_actions)]
        for s in range(n_states)
    ]  # fmt: skip
    # Where an episode ends only sometimes, those ends go to one more state, the last.
    continuing = set(np.flatnonzero(world.initial_state_distrib).tolist())
    queue, ends = list(continuing), set[int]()
    while queue:
        for pair in outcomes[queue.pop()]:
            for probability, after, _, ended in pair:
                if ended and probability > 0:
                    ends.add(after)
                elif probability > 0 and after not in continuing:
                    continuing.add(after)
                    queue.append(after)
    both = continuing & ends  # the states in which an episode may end or go on
    if not both:
        return outcomes
    apart: Outcomes = [
        [[(p, n_states if ended and after in both else after, r, ended)
          for p, after, r, ended in pair]
         for pair in pairs]
        for pairs in outcomes
    ]  # fmt: skip
    return [*apart, [[] for _ in range(n_actions)]]


def names_of(world: Any) -> tuple[Space | None, Space | None]:
    """Return named state and action spaces of a known environment, None for others."""
    # Named as in GridWorld, so that mappings by name work between the two.
    if isinstance(world, FrozenLakeEnv):
        moves = _moves(world, "west", "south", "east", "north")
        return _cells(*np.asarray(world.desc).shape), moves
    if isinstance(world, CliffWalkingEnv):
        return _cells(*world.shape), _moves(world, "north", "east", "south", "west")
    if isinstance(world, TaxiEnv):
        passenger = Component("passenger", 5, labels=(*STANDS, "taxi"))
        destination = Component("destination", 4, labels=STANDS)
        states = Space([*_cells(5, 5).components, passenger, destination])
        return states, _moves(world, "south", "north", "east", "west", "pick up", "drop off")
    if isinstance(world, BlackjackEnv):
        ace = Component("ace", 2, labels=("none", "usable"))
        states = Space([Component("player", 32), Component("dealer", 11), ace])
        return states, _moves(world, "stick", "hit")
    return None, None


def _cells(rows: int, columns: int) -> Space:
    return Space([Component("row", int(rows)), Component("column", int(columns))])


def _moves(world: Any, *labels: str) -> Space:
    # A subclass with a step of its own may go anywhere, so that its actions have no labels.
    known = acts_as(world, *TOY_TEXT, methods=["step"])
    return Space([Component("move", len(labels), labels=labels if known else None)])
