"""Discrete spaces of Gymnasium as spaces of a task, and their points as numbers, both ways."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeGuard

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Tuple

from curricle.arrays import IntArray, frozen
from curricle.checks import BEYOND_64_BITS
from curricle.errors import SettingError
from curricle.pictures.scenes import board
from curricle.tasks.spaces import MISSING, Component, Space, entry_names, values_of

Form = Literal["index", "components"]


def space_of(space: gym.Space[Any], name: str) -> Space:
    """Return the points of a discrete Gymnasium space, with a component for each number."""
    components = list(_components(space, name))
    if len({component.name for component in components}) < len(components):
        components = [replace(c, name=f"{name}_{i + 1}") for i, c in enumerate(components)]
    is_array = isinstance(space, Box)
    drawn = (lambda point, mode: board(Point(space)(point), mode)) if is_array else None
    return Space(components, drawn=drawn)


def is_discrete(space: gym.Space[Any]) -> bool:
    """Return whether :func:`space_of` can read a space."""
    return _count(space) < BEYOND_64_BITS


def _count(space: gym.Space[Any]) -> int:
    """Return how many points a space has; `BEYOND_64_BITS` or more where they are not numbered."""
    if isinstance(space, Tuple | Dict):
        return math.prod(_count(part) for _, part in _parts(space))
    sizes = [int(space.n)] if isinstance(space, Discrete) else [n for n, _ in _ranges(space)]
    few = sum(n > 1 for n in sizes) < 64  # the product of a picture's sizes takes a second
    return math.prod(sizes) if sizes and few else BEYOND_64_BITS


def _ranges(space: gym.Space[Any]) -> list[tuple[int, int]]:
    """Return how many values each number of a point has, and the lowest; none for fractions."""
    if isinstance(space, MultiBinary):
        space = MultiDiscrete(np.full(space.shape, 2))
    if isinstance(space, MultiDiscrete):
        return [*zip(space.nvec.ravel().tolist(), space.start.ravel().tolist(), strict=True)]
    if not isinstance(space, Box) or space.dtype.kind not in "iu":
        return []
    ends = zip(space.low.ravel().tolist(), space.high.ravel().tolist(), strict=True)
    return [(high - low + 1, low) for low, high in ends]


def counts_from_0(space: gym.Space[Any]) -> "TypeGuard[Discrete[np.int64]]":
    """Return whether the points of a space are 0, 1, ..., n - 1."""
    return isinstance(space, Discrete) and bool(space.start == 0)


@dataclass(frozen=True)
class Number:
    """From a point of a discrete Gymnasium space to its number in :func:`space_of`."""

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, point: object) -> int:
        """Return the number of a point, negative where it is not in the space."""
        try:
            return self._points.encode_one(tuple(_numbers(self.space, point)))
        except (TypeError, ValueError, LookupError):  # of no whole number, or without a part
            return MISSING

    @cached_property
    def _points(self) -> Space:
        return space_of(self.space, "part")


@dataclass(frozen=True)
class Point:
    """From a number in :func:`space_of` to its point of a discrete Gymnasium space."""

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, number: int) -> object:
        """Return the point of a number; arrays in it are read-only."""
        return _assembled(self.space, iter(values_of(self._points, number).values()))

    @cached_property
    def _points(self) -> Space:
        return space_of(self.space, "part")


def _parts(space: "Tuple[Any] | Dict") -> list[tuple[Any, gym.Space[Any]]]:
    return list(space.spaces.items() if isinstance(space, Dict) else enumerate(space.spaces))


def _components(space: gym.Space[Any], name: str) -> Iterator[Component]:
    if isinstance(space, Discrete):
        yield Component(name, int(space.n), low=int(space.start))
    elif isinstance(space, Tuple | Dict):
        for key, part in _parts(space):
            yield from _components(part, key if isinstance(key, str) else f"{name}_{key + 1}")
    else:
        names = entry_names(name, space.shape or ())
        for entry, (size, low) in zip(names, _ranges(space), strict=True):
            yield Component(entry, size, low=low)


def _numbers(space: gym.Space[Any], point: Any) -> Iterator[Any]:
    """Yield the numbers of a point; Gymnasium's `flatten` makes them one-hot."""
    if isinstance(space, Discrete):
        yield point
    elif isinstance(space, Tuple | Dict):
        for key, part in _parts(space):
            yield from _numbers(part, point[key])
    else:
        yield from np.asarray(point).ravel().tolist()


def _assembled(space: gym.Space[Any], values: Iterator[int]) -> object:
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
        self._lows = np.array([component.low for component in space.components])

    def coded(self, point: int) -> int | IntArray:
        """Return a point in Gymnasium's space: an int, or an int64 array."""
        if self.form == "index":
            return point
        if self.space.is_box:
            return np.array(np.unravel_index(point, self.space.shape))
        return np.asarray(self.space.points[point] - self._lows)

    def number(self, point: object) -> int:
        """Return the number of a box's point in Gymnasium's space."""
        number = self._number(point)
        if number == MISSING:
            raise SettingError(f"an action must lie in {self.gym_space}: got {point!r}")
        return number
