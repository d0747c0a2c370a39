"""Gymnasium's discrete spaces as spaces of named components."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import gymnasium as gym
import numpy as np

from curricle.errors import TaskError
from curricle.tasks.spaces import Component, Space, frozen

Flatten = Callable[[Any], tuple[Any, ...]]


def space_of(space: gym.Space[Any], name: str) -> Space:
    """Return the points of a discrete Gymnasium space, one component for each number in them.

    Components are called `name`, or `name_1`, `name_2`, ... if there are several; those of a
    ``Dict`` have its keys as names if these are all different. TaskError when a part of it is not
    discrete.

    Examples
    --------
    >>> from gymnasium.spaces import Dict, Discrete, MultiDiscrete
    >>> space_of(Dict(card=Discrete(10, start=1), dice=MultiDiscrete([6, 6])), "state")
    Space(360 points: card[10] x dice_1[6] x dice_2[6])
    """
    components = list(_components(space, name))
    if len({component.name for component in components}) < len(components):
        components = [replace(c, name=f"{name}_{i + 1}") for i, c in enumerate(components)]
    return Space(components)


def is_discrete(space: gym.Space[Any]) -> bool:
    """Return whether :func:`space_of` can read a space."""
    if isinstance(space, gym.spaces.Tuple | gym.spaces.Dict):
        return all(is_discrete(part) for _, part in _parts(space, ""))
    kinds = gym.spaces.Discrete, gym.spaces.MultiDiscrete, gym.spaces.MultiBinary
    return isinstance(space, kinds)


@dataclass(frozen=True)
class Number:
    """From a point of a discrete Gymnasium space to its number in :func:`space_of`.

    Examples
    --------
    >>> Number(gym.spaces.Tuple([gym.spaces.Discrete(3), gym.spaces.Discrete(2)]))((2, 1))
    5
    """

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, point: Any) -> int:
        """Return the number of a point, negative where it is none."""
        return self._place(self._flatten(point))

    @cached_property
    def _flatten(self) -> Flatten:
        return _flattening(self.space)

    @cached_property
    def _place(self) -> Callable[[tuple[Any, ...]], int]:
        return space_of(self.space, "part").encode_one


@dataclass(frozen=True)
class Point:
    """From a number in :func:`space_of` to its point of a discrete Gymnasium space.

    Examples
    --------
    >>> Point(gym.spaces.MultiDiscrete([3, 2]))(5)
    array([2, 1])
    """

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, number: int) -> Any:
        """Return the point of a number; arrays in it are read-only."""
        values = space_of(self.space, "part").decode(number).values()
        return _assembled(self.space, iter([int(value) for value in values]))


def _parts(space: gym.Space[Any], name: str) -> list[tuple[str, gym.Space[Any]]]:
    """Return the parts of a Tuple or Dict with their names."""
    if isinstance(space, gym.spaces.Dict):
        return list(space.spaces.items())
    assert isinstance(space, gym.spaces.Tuple)
    return [(f"{name}_{i + 1}", part) for i, part in enumerate(space.spaces)]


def _components(space: gym.Space[Any], name: str) -> Iterator[Component]:
    if isinstance(space, gym.spaces.Discrete):
        yield Component(name, int(space.n), low=int(space.start))
    elif isinstance(space, gym.spaces.MultiDiscrete):
        ranges = zip(space.nvec.flat, space.start.flat, strict=True)
        for i, (size, low) in enumerate(ranges):
            yield Component(f"{name}_{i + 1}", int(size), low=int(low))
    elif isinstance(space, gym.spaces.MultiBinary):
        for i in range(math.prod(space.shape)):
            yield Component(f"{name}_{i + 1}", 2)
    elif isinstance(space, gym.spaces.Tuple | gym.spaces.Dict):
        for called, part in _parts(space, name):
            yield from _components(part, called)
    else:
        raise TaskError(
            "a space must be Discrete, MultiDiscrete, MultiBinary or a Tuple or Dict of these: "
            f"{name!r} is {space}"
        )


def _flattening(space: gym.Space[Any]) -> Flatten:
    """Return the function from a point to the tuple of the numbers in it."""
    if isinstance(space, gym.spaces.Discrete):
        return lambda point: (point,)
    if not isinstance(space, gym.spaces.Tuple | gym.spaces.Dict):
        return lambda point: tuple(np.asarray(point).ravel().tolist())
    if isinstance(space, gym.spaces.Tuple):
        if all(isinstance(part, gym.spaces.Discrete) for part in space.spaces):
            return tuple
        parts: list[tuple[Any, gym.Space[Any]]] = list(enumerate(space.spaces))
    else:
        parts = list(space.spaces.items())
    inner = [(key, _flattening(part)) for key, part in parts]
    return lambda point: tuple(n for key, flat in inner for n in flat(point[key]))


def _assembled(space: gym.Space[Any], values: Iterator[int]) -> Any:
    """Return a point made of the numbers that come next."""
    if isinstance(space, gym.spaces.Discrete):
        return next(values)
    if isinstance(space, gym.spaces.Tuple):
        return tuple(_assembled(part, values) for part in space.spaces)
    if isinstance(space, gym.spaces.Dict):
        return {key: _assembled(part, values) for key, part in space.spaces.items()}
    shape = space.shape or ()
    array = np.array([next(values) for _ in range(math.prod(shape))], space.dtype)
    return frozen(array.reshape(shape))
