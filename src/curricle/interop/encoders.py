"""Encoders: how an environment's observations become what a network takes.

An encoder is a function from an environment to the same environment, wrapped, so that it has other
observations. Those of this module and of ``minigrid_encoders`` are frozen dataclasses: equal
settings are equal encoders, with the same text in every process.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Tuple
from gymnasium.spaces.utils import flatten, flatten_space
from gymnasium.wrappers import FrameStackObservation

from curricle.checks import instance, whole_number
from curricle.errors import SettingError, TaskError
from curricle.tasks.observation_task import named, space_text

Environment = gym.Env[Any, Any]
Encoder = Callable[[Environment], Environment]
"""From an environment to the same with other observations."""
CAMERA = (1, 3, 4)
"""Channels of pictures that have them last: grey, colours, colours and transparency."""


class EncodedObservations(gym.ObservationWrapper[Any, Any, Any]):
    """Shows another observation in the place of each; it has no state, so it can be tabulated.

    Parameters
    ----------
    env : gymnasium.Env
    encoded : callable
        ``encoded(env, observation)`` with the environment without wrappers.
    space : gymnasium.Space
        Of what `encoded` returns.
    """

    def __init__(self, env: Environment, encoded: Callable[[Any, Any], Any], space: gym.Space[Any]):
        super().__init__(env)
        self.encoded, self.observation_space = encoded, space

    def observation(self, observation: Any) -> Any:
        """Return the observation encoded."""
        return self.encoded(self.unwrapped, observation)


@dataclass(frozen=True)
class FunctionEncoder:
    """Observations through a function of one's own.

    Parameters
    ----------
    function : callable
        From one observation to another, always the same for the same. Tasks can be sent to other
        processes if it is a function of a module.
    space : gymnasium.Space
        Of what it returns.

    Raises
    ------
    SettingError
        When `function` cannot be called or `space` is no space.
    TaskError
        When an observation has another shape than the space.

    Examples
    --------
    >>> from curricle import observation_task
    >>> def position(car):
    ...     return car[:1]
    >>> observation_task("MountainCar-v0", encode=FunctionEncoder(position, Box(-1.2, 0.6, (1,))))
    ObservationTask(MountainCar-v0(encode=FunctionEncoder(...:position, Box(-1.2, 0.6, (1,),
    float32))), discount 0.99, Box(1,) -> Discrete(3))
    """

    function: Callable[[Any], Any]
    space: gym.Space[Any] = field(hash=False)

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise SettingError(f"an encoder's function must be callable: got {self.function!r}")
        instance("space of an encoder", self.space, gym.Space, SettingError)

    def __call__(self, env: Environment) -> Environment:
        """Return the environment with encoded observations."""
        return EncodedObservations(env, self._encoded, self.space)

    def _encoded(self, env: Any, observation: Any) -> Any:
        found = self.function(observation)
        if self.space.shape is not None and np.shape(found) != self.space.shape:
            raise TaskError(
                f"an encoder's function must return what is in its space, {self.space}: "
                f"{named(self.function)} returned an array of shape {np.shape(found)}"
            )
        return found

    def __repr__(self) -> str:
        return f"FunctionEncoder({named(self.function)}, {self.space})"


@dataclass(frozen=True)
class FlatDict:
    """A Dict of numbers as one vector, float32.

    Parts are in the space's order. A Box is read row by row as it is, unscaled; ``Discrete`` and
    ``MultiDiscrete`` are one-hot.

    Parameters
    ----------
    leave_out : sequence of str
        Keys to leave out, as text must be.

    Raises
    ------
    SettingError
        When `leave_out` is no list of keys.
    TaskError
        When observations are no Dict, a key is unknown, or a part is neither numbers nor left out.

    Examples
    --------
    >>> from gymnasium.spaces import Text
    >>> from gymnasium.wrappers import TransformObservation
    >>> def with_words():
    ...     space = Dict(hand=MultiDiscrete([3, 2]), words=Text(9))
    ...     seen = lambda square: {"hand": np.array([square % 3, 1]), "words": "go"}
    ...     return TransformObservation(gym.make("FrozenLake-v1"), seen, space)
    >>> env = FlatDict(leave_out=["words"])(with_words())
    >>> env.observation_space, env.reset(seed=0)[0]
    (Box(0.0, 1.0, (5,), float32), array([1., 0., 0., 0., 1.], dtype=float32))
    """

    leave_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given: Any = self.leave_out
        if not isinstance(given, list | tuple) or not all(isinstance(key, str) for key in given):
            raise SettingError(f"leave_out must be a list of keys: got {given!r}")
        object.__setattr__(self, "leave_out", tuple(given))

    def __call__(self, env: Environment) -> Environment:
        """Return the environment with encoded observations."""
        space = env.observation_space
        if not isinstance(space, Dict):
            raise TaskError(
                f"FlatDict is for observations that are a Dict: got {space_text(space)}"
            )
        for key in self.leave_out:
            if key not in space.spaces:
                raise TaskError(
                    f"leave_out must name keys of the Dict, {', '.join(space.spaces)}: got {key!r}"
                )
        kept = Dict([(k, part) for k, part in space.spaces.items() if k not in self.leave_out])
        for key, part in kept.spaces.items():
            if not _of_numbers(part):
                raise TaskError(
                    f"parts of a FlatDict must be numbers, or be named in leave_out: {key!r} is "
                    f"{space_text(part)}"
                )
        flat: Any = flatten_space(kept)
        low, high = (bound.astype(np.float32) for bound in (flat.low, flat.high))
        return EncodedObservations(env, _Flattened(kept), Box(low, high, dtype=np.float32))


@dataclass(frozen=True)
class StackedFrames:
    """The last n observations at once, for tasks in which one observation shows too little.

    Vectors are joined end to end and pictures by their channels, the oldest first. An episode
    begins with n times its first observation.

    The frames are a history that a state does not show, so :func:`tabulate` refuses them.

    Parameters
    ----------
    n : int
        How many.
    of : callable, optional
        An encoder of each observation.

    Raises
    ------
    SettingError
        When `n` is no whole number from 2, or `of` cannot be called.
    TaskError
        When an observation is no array (``Box``).

    Examples
    --------
    >>> from curricle import observation_task
    >>> observation_task("CartPole-v1", encode=StackedFrames(4))
    ObservationTask(CartPole-v1(encode=StackedFrames(n=4, of=None)), discount 0.99,
    Box(16,) -> Discrete(2))
    """

    n: int
    of: Encoder | None = None

    def __post_init__(self) -> None:
        whole_number("n of stacked frames", self.n, 2, SettingError)
        if self.of is not None and not callable(self.of):
            raise SettingError(f"of must be an encoder of each frame: got {self.of!r}")

    def __call__(self, env: Environment) -> Environment:
        """Return the environment with encoded observations."""
        each = env if self.of is None else self.of(env)
        space = each.observation_space
        if not isinstance(space, Box) or not space.shape:
            raise TaskError(f"stacked frames must be arrays, of a Box: got {space_text(space)}")
        stacked: Any = FrameStackObservation(each, self.n)
        bounds = stacked.observation_space.low, stacked.observation_space.high
        low, high = (_joined(None, bound) for bound in bounds)
        joined = Box(low, high, dtype=space.dtype)
        return EncodedObservations(stacked, _joined, joined)


@dataclass(frozen=True)
class _Flattened:
    """Flattens observations of a space."""

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, env: Any, observation: Any) -> npt.NDArray[np.float32]:
        kept = {key: observation[key] for key in self.space}  # type: ignore[attr-defined]
        return np.asarray(flatten(self.space, kept), dtype=np.float32)


def _joined(env: Any, frames: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return n frames as one: vectors end to end, planes as channels, pictures by channels."""
    if frames.ndim == 2:
        return frames.reshape(-1)
    if frames.ndim == 4 and frames.shape[3] in CAMERA:
        return np.concatenate([*frames], axis=-1)
    return frames if frames.ndim == 3 else frames.reshape(-1, *frames.shape[2:])


def _of_numbers(space: gym.Space[Any]) -> bool:
    """Return whether a space has numbers only, so that it can be flattened."""
    if isinstance(space, Dict | Tuple):
        parts = space.spaces.values() if isinstance(space, Dict) else space.spaces
        return all(map(_of_numbers, parts))
    return isinstance(space, Box | Discrete | MultiDiscrete | MultiBinary)
