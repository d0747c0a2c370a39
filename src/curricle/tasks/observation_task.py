"""Observation tasks: seen as vectors, pictures or dicts instead of numbered states."""

import inspect
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import dataclass, field, is_dataclass
from functools import cached_property, partial
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Tuple
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate

from curricle.checks import brief, instance
from curricle.errors import CurricleError, TaskError, in_words
from curricle.files import short_digest
from curricle.tasks.minigrid_view import view_compiled
from curricle.tasks.models import check_horizon


@dataclass(frozen=True)
class EnvironmentMaker:
    """Makes an environment; two makers of the same environment are equal."""

    recipe: Any = field(hash=False)  # what ``gymnasium.make`` takes, or a function that makes one
    arguments: Mapping[str, Any] = field(default_factory=dict, hash=False)  # copied for each
    encode: Callable[[Any], Any] | None = field(default=None, hash=False)  # wraps what is made

    def __post_init__(self) -> None:
        if self.encode is not None and not callable(self.encode):
            raise TaskError(f"encode must be a wrapper of environments: got {self.encode!r}")

    def __call__(self) -> gymnasium.Env[Any, Any]:
        """Return a new environment; all are equal, also if its constructor draws a level."""
        make = self.recipe if callable(self.recipe) else partial(gymnasium.make, self.recipe)
        with shared_restored():
            seed_shared(0)
            environment: Any = make(**deepcopy(dict(self.arguments)))
        if callable(self.recipe) and not _takes_seeds(environment):
            environment = OlderAPI(environment)
        if self.encode is None:
            return environment  # type: ignore[no-any-return]
        rule = "encode must take an environment and return it wrapped"
        try:
            encoded = self.encode(environment)
        except CurricleError:
            raise
        except Exception as error:
            raise TaskError(
                f"{rule}: {_text(self.encode)} failed with {in_words(error)}; "
                "gymnasium.wrappers.TransformObservation applies a function to observations"
            ) from error
        if not isinstance(encoded, gymnasium.Env):
            raise TaskError(f"{rule}: {_text(self.encode)} returned {encoded!r}")
        return encoded

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, EnvironmentMaker):
            return NotImplemented
        left, right = ((maker.recipe, maker.arguments, maker.encode) for maker in (self, other))
        return _alike(left, right)

    def __str__(self) -> str:
        recipe = self.recipe
        name = _text(recipe) if callable(recipe) else getattr(recipe, "id", recipe)
        parts = [f"{n}={getattr(v, '__qualname__', repr(v))}" for n, v in self.arguments.items()]
        parts += [] if self.encode is None else [f"encode={_text(self.encode)}"]
        return f"{name}({', '.join(parts)})" if parts else str(name)


def _takes_seeds(environment: Any) -> bool:
    """Return whether a reset takes what Gymnasium gives it."""
    if not callable(getattr(environment, "reset", None)):
        return True  # it is refused where it is used
    parameters = inspect.signature(environment.reset).parameters.values()
    named = {"seed", "options"} <= {parameter.name for parameter in parameters}
    return named or any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)


class OlderAPI(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment whose reset takes no seed or no options, with what Gymnasium returns.

    Its reset may return an observation alone, and its step four parts, without `truncated`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]):
        super().__init__(env)
        self.taken = inspect.signature(env.reset).parameters.keys() & {"seed", "options"}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Return the observation and the info of a reset, with what it takes of the arguments."""
        given: dict[str, Any] = {"seed": seed, "options": options}
        if seed is not None and "seed" not in self.taken:
            gymnasium.Env.reset(self.unwrapped, seed=seed)  # which seeds np_random alone
            getattr(self.env, "seed", lambda _: None)(seed)
        returned: Any = self.env.reset(**{name: given[name] for name in self.taken})
        pair = isinstance(returned, tuple) and len(returned) == 2 and isinstance(returned[1], dict)
        return returned if pair else (returned, {})

    def step(self, action: Any) -> Any:
        """Return the five parts of a step."""
        returned: Any = self.env.step(action)
        if not (isinstance(returned, tuple) and len(returned) == 4):
            return returned
        observed, reward, over, info = returned
        cut = bool(info.get("TimeLimit.truncated", False))
        return observed, reward, bool(over) and not cut, cut, info


SHARED: Any = random.getstate.__self__, np.random.get_state.__self__  # type: ignore[attr-defined]
"""The generators of Python and NumPy that all code shares; many classes draw from them."""


def seed_shared(seed: int) -> None:
    """Seed the shared generators."""
    for generator in SHARED:
        generator.seed(seed)


@contextmanager
def shared_restored() -> Iterator[None]:
    """Return a context after which the shared generators are as before."""
    python, numpy = SHARED
    before = python.getstate(), numpy.get_state()
    try:
        yield
    finally:
        python.setstate(before[0])
        numpy.set_state(before[1])


def check_spaces(environment: gymnasium.Env[Any, Any]) -> None:
    """Raise TaskError unless an environment has a space of observations and one of actions."""
    for name in ("observation_space", "action_space"):
        space = getattr(environment, name, None)
        if not isinstance(space, gymnasium.Space):
            raise TaskError(
                f"{name} of an environment must be a gymnasium.Space, set in its class or its "
                f"__init__: {environment!r} has {space!r}"
            )


@dataclass(frozen=True)
class ObservationTask:
    """A task whose learner gets observations, as deep learners do; it has no tables.

    Parameters
    ----------
    make : callable
        Returns a new Gymnasium environment; called for each environment that is needed.
    discount : float
        gamma, in [0, 1].
    time_limit : int, optional
        Steps after which an episode is cut off, at most the environment's own, the default.
    compiled_view : bool
        Whether compiled code makes the observations of MiniGrid's environments. They are the same
        as by MiniGrid's own code, which an environment with methods of its own keeps.

    Examples
    --------
    >>> car = ObservationTask(EnvironmentMaker("MountainCar-v0"), discount=0.98)
    >>> car
    ObservationTask(MountainCar-v0, discount 0.98, Box(2,) -> Discrete(3))
    >>> car.n_actions, car == ObservationTask(EnvironmentMaker("MountainCar-v0"), 0.98)
    (3, True)
    """

    make: Callable[[], gymnasium.Env[Any, Any]]
    discount: float = 0.99
    time_limit: int | None = None
    compiled_view: bool = field(default=True, compare=False, kw_only=True)  # changes nothing seen

    def __post_init__(self) -> None:
        instance("compiled_view", self.compiled_view, bool, TaskError)
        if not callable(self.make):
            raise TaskError(f"make must be a function that returns an environment: {self.make!r}")
        check_horizon(self)
        _ = self._inspected

    @cached_property
    def _inspected(self) -> tuple[gymnasium.Space[Any], gymnasium.Space[Any], int | None]:
        environment = self.make()
        if not isinstance(environment, gymnasium.Env):
            raise TaskError(f"make must return a gymnasium.Env: {self.make} made {environment!r}")
        check_spaces(environment)
        spaces = environment.observation_space, environment.action_space
        limit = _limit_of(environment)
        environment.close()
        if self.time_limit is None:
            return (*spaces, limit)
        if limit is not None and self.time_limit > limit:
            raise TaskError(
                f"time_limit must not exceed the environment's own limit, {limit} steps of "
                f"{made_by(self.make)}: got {self.time_limit}; make the environment itself with a "
                "higher limit, as gymnasium.make does with max_episode_steps="
            )
        return (*spaces, self.time_limit)

    @property
    def observations(self) -> gymnasium.Space[Any]:
        """The space of one observation."""
        return self._inspected[0]

    @property
    def actions(self) -> gymnasium.Space[Any]:
        """The space of one action."""
        return self._inspected[1]

    @property
    def n_actions(self) -> int | None:
        """The number of actions, A; None unless they are numbered from 0."""
        space = self.actions
        return int(space.n) if isinstance(space, Discrete) and space.start == 0 else None

    @property
    def longest(self) -> int | None:
        """Steps after which an episode is cut off; None if unknown."""
        return self._inspected[2]

    def environment(self) -> gymnasium.Env[Any, Any]:
        """Return a new environment, cut off at the task's time limit."""
        environment = self.make()
        view_compiled(environment, self.compiled_view)
        if self.time_limit is None:
            return environment
        return gymnasium.wrappers.TimeLimit(environment, self.time_limit)

    @property
    def shapes(self) -> str:
        """The spaces of observations and actions, such as ``Box(2,) -> Discrete(3)``."""
        return " -> ".join(
            f"Box{space.shape}" if isinstance(space, Box) else stable_text(space)
            for space in self._inspected[:2]
        )

    def __repr__(self) -> str:
        limit = "" if self.time_limit is None else f", time limit {self.time_limit}"
        maker = made_by(self.make)
        return f"ObservationTask({maker}, discount {self.discount:g}{limit}, {self.shapes})"


def layers_of(environment: object) -> list[Any]:
    """Return an environment's wrappers from the outermost, and it itself last."""
    layers = [environment]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    return layers


def _limit_of(environment: gymnasium.Env[Any, Any]) -> int | None:
    """Return the least of an environment's own time limits; None if there is none."""
    layers = layers_of(environment)
    limits = [vars(layer).get("_max_episode_steps") for layer in layers]  # of a TimeLimit
    bare = layers[-1]
    limits.append(getattr(getattr(bare, "task", None), "time_limit", None))  # Curricle's
    kinds = {kind.__module__ for kind in type(bare).__mro__}
    # BabyAI's levels set theirs at each reset, unless it is fixed.
    if "minigrid.minigrid_env" in kinds and getattr(bare, "fixed_max_steps", True):
        limits.append(bare.max_steps)
    return min((int(limit) for limit in limits if limit is not None), default=None)


def made_by(make: object) -> str:
    """Return the name of a maker of environments, the same in every process."""
    if isinstance(make, partial):
        arguments = [*map(repr, make.args)]
        arguments += [f"{name}={value!r}" for name, value in make.keywords.items()]
        return f"{made_by(make.func)}({', '.join(arguments)})"
    return str(getattr(make, "__name__", make))


def named(function: Callable[..., Any]) -> str:
    """Return a function's name as ``module:name``, the same in every process."""
    kind = function if hasattr(function, "__name__") else type(function)
    # The package of a study's own modules is named after its folder.
    module = re.sub(r"^curricle_study_[0-9a-f]+\.", "", kind.__module__)
    return f"{module}:{kind.__name__}"


def _text(function: Callable[..., Any]) -> str:
    """Return a function as text: a dataclass (an encoder) or a partial with its settings."""
    settings = is_dataclass(type(function)) or isinstance(function, partial)
    return stable_text(function) if settings else named(function)


def _alike(left: Any, right: Any) -> bool:
    """Return whether two arguments are equal, including arrays in them."""
    if isinstance(left, EnvSpec) and isinstance(right, EnvSpec):
        left, right = vars(left), vars(right)
    if isinstance(left, partial) and isinstance(right, partial):
        left, right = ((part.func, part.args, part.keywords) for part in (left, right))
    if isinstance(left, Mapping) and isinstance(right, Mapping):
        return left.keys() == right.keys() and all(_alike(left[key], right[key]) for key in left)
    if isinstance(left, list | tuple) and isinstance(right, list | tuple):
        return len(left) == len(right) and all(map(_alike, left, right))
    if isinstance(left, np.ndarray) or isinstance(right, np.ndarray):
        return np.array_equal(left, right)
    return bool(left == right)


def stable_text(value: object) -> str:
    """Return a space, or a function with arguments, as text that is the same in every process."""
    return re.sub(r" at 0x[0-9a-f]+", "", str(value))


def plain_text(value: object, within: tuple[Any, ...] = ()) -> str:
    """Return a value as text that is the same in every process and on every machine."""
    if isinstance(value, np.ndarray):
        text = repr(value)
        return (
            text if "..." not in text else f"array {value.shape} ({short_digest(value.tobytes())})"
        )
    function = getattr(value, "py_func", value)
    if inspect.isfunction(function) and function not in within:
        try:
            source = inspect.getsource(function)
        except OSError:
            source = repr(function.__code__.co_code)
        used = inspect.getclosurevars(function)
        known = {k: x for k, x in used.globals.items() if not inspect.ismodule(x)}
        texts = {name: plain_text(x, (*within, function)) for name, x in known.items()}
        constants = function.__code__.co_consts, used.nonlocals, *([texts] if texts else ())
        content = source + _of_any_process(repr(constants))
        return f"{function.__name__} ({short_digest(content.encode())})"
    if isinstance(value, set | frozenset):  # whose order differs between processes
        value = sorted(value, key=repr)
    return _of_any_process(repr(value))


def _of_any_process(text: str) -> str:
    """Return a text without memory addresses and folders, which differ between processes."""
    # Names of the packages of studies' own modules, and of code objects, contain folders.
    parts = r' at 0x[0-9a-f]+|\bcurricle_study_[0-9a-f]+\.|, file "[^"]*", line \d+'
    return re.sub(parts, "", text)


def is_observation_task(task: object) -> bool:
    """Return whether a task is seen through observations."""
    return isinstance(task, ObservationTask)


Observations: TypeAlias = npt.NDArray[Any] | dict[str, npt.NDArray[Any]]
"""n observations that a network reads, stacked along their first axis, by part if they have any."""


def stack(space: gymnasium.Space[Any], observations: Sequence[Any]) -> Any:
    """Return observations of a space as one batch, as vector environments stack them."""
    if isinstance(space, Box | Discrete | MultiDiscrete | MultiBinary):
        return np.array(observations, dtype=space.dtype)  # as `concatenate` does, and quicker
    empty: Any = create_empty_array(space, len(observations))
    return concatenate(space, observations, empty)


def check_observation(space: gymnasium.Space[Any], observation: object) -> None:
    """Raise TaskError unless an observation, in its space's types of numbers, is in the space."""
    try:
        (read,) = iterate(batch_space(space, 1), stack(space, [observation]))
        fits = space.contains(read) and _equal(space, observation, read)
    except (TypeError, ValueError, LookupError, OverflowError):  # as it lacks a part, or a shape
        fits = False
    if not fits:
        raise TaskError(
            "an observation must lie in the environment's observation_space, "
            f"{brief(space)}: got {brief(observation)}{_outside(space, observation)}; let "
            "observation_space state all that reset and step return"
        )


def _outside(space: Any, observation: Any) -> str:
    """Return which part of an observation does not fit: a long one is cut in an error."""
    if isinstance(space, Dict) and isinstance(observation, Mapping):
        missing = (f", which has no {key!r}" for key in space if key not in observation)
        parts = (_outside(part, observation.get(key)) for key, part in space.items())
        return next(missing, "") or next(filter(None, parts), "")
    with suppress(TypeError, ValueError):  # it may be no array of numbers
        numbers = np.asarray(observation)
        if isinstance(space, Box) and numbers.shape != space.shape:
            return f", of shape {numbers.shape} instead of {space.shape}"
        if isinstance(space, Box):
            ends = zip(numbers.flat, space.low.flat, space.high.flat, strict=True)
            for i, (number, low, high) in enumerate(ends, start=1):
                if not low <= number <= high:
                    return f", where number {i}, {number:g}, is not in [{low:g}, {high:g}]"
    return ""


def _equal(space: Any, observation: Any, read: Any) -> bool:
    """Return whether an observation has the numbers that are read, up to rounding of fractions."""
    if isinstance(space, Dict):
        return all(_equal(part, observation[key], read[key]) for key, part in space.items())
    if isinstance(space, Tuple):
        return all(map(_equal, space, observation, read))
    if not isinstance(space, Box | Discrete | MultiDiscrete | MultiBinary):
        return True  # texts and graphs are not converted
    rounding = np.finfo(space.dtype).eps if space.dtype.kind == "f" else 0.0
    return np.allclose(observation, read, rtol=rounding, atol=rounding)


def shapes_of(space: gymnasium.Space[Any], order: Callable[[Any], Any] = tuple) -> Any:
    """Return the shape of a space, its axes in an order; a dict or a list for a Dict or a Tuple."""
    if isinstance(space, Dict):
        return {key: shapes_of(part, order) for key, part in space.items()}
    if isinstance(space, Tuple):
        return [shapes_of(part, order) for part in space]
    return space.shape and order(space.shape)


def batch_size(observations: Any) -> int:
    """Return how many observations are stacked, n; arrays (n, ...), or dicts or tuples of them."""
    while isinstance(observations, (tuple, Mapping)):
        parts = observations.values() if isinstance(observations, Mapping) else observations
        observations = next(iter(parts))
    return len(observations)
