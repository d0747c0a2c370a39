"""Gymnasium's discrete spaces and Curricle's spaces of named components, both ways."""

import math
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeGuard

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Dict, Discrete, MultiBinary, MultiDiscrete, Tuple

from curricle.arrays import IntArray, frozen
from curricle.checks import text
from curricle.errors import SettingError, TaskError
from curricle.tasks.spaces import MISSING, Component, Space

Flatten = Callable[[Any], tuple[Any, ...]]
Form = Literal["index", "components"]


def space_of(space: gym.Space[Any], name: str) -> Space:
    """Return the points of a discrete Gymnasium space, one component for each number in them.

    Components are called `name`, or `name_1`, `name_2`, ... if there are several; those of a
    ``Dict`` have its keys as names if these are all different. TaskError when a part of it is not
    discrete.
    """
    components = list(_components(space, name))
    if len({component.name for component in components}) < len(components):
        components = [replace(c, name=f"{name}_{i + 1}") for i, c in enumerate(components)]
    return Space(components)


def with_names(space: Space, names: Sequence[str], sizes: Sequence[int] | None = None) -> Space:
    """Return a space of states whose components have other names, in their order.

    With `sizes`, of the values of each, one number is split; the last component counts fastest.
    """
    if sizes is not None:
        return _split(space, names, sizes)
    if len(names) != len(space.names):
        raise TaskError(
            f"names must be one for each component of a state, in the order of "
            f"{', '.join(space.names)}: got {len(names)}, {', '.join(names) or 'none'}"
        )
    components = [replace(c, name=name) for c, name in zip(space.components, names, strict=True)]
    return Space(components, space.points)


def _split(space: Space, names: Sequence[str], sizes: Any) -> Space:
    """Return a space of one component as one of several."""
    if isinstance(sizes, str) or not isinstance(sizes, Sequence):
        raise TaskError(f"sizes must be a list of whole numbers: got {sizes!r}")
    if len(space.components) > 1:
        raise TaskError(
            f"sizes are for observations that are one number: these have {', '.join(space.names)}"
        )
    if len(sizes) != len(names):
        raise TaskError(
            f"sizes must be of each name, {', '.join(names)}: got {len(sizes)}, {list(sizes)}"
        )
    split = Space([Component(*part) for part in zip(names, sizes, strict=True)])
    if split.size != space.size:
        raise TaskError(
            f"sizes must make the environment's {space.size:,} states when multiplied: "
            f"{' x '.join(map(str, sizes))} is {split.size:,}"
        )
    return split


def with_labels(space: Space, labels: Sequence[str]) -> Space:
    """Return a space of actions, of one component, with a label for each action."""
    listed = name_list(labels, "labels of actions")
    if len(space.components) > 1:
        raise TaskError(
            "labels are for actions that are one number, and others are named by a Space: these "
            f"have {', '.join(space.names)}"
        )
    if len(listed) != space.size:
        raise TaskError(
            f"actions must have one label each, {space.size} in all: got {len(listed)}, "
            f"{', '.join(listed) or 'none'}"
        )
    return Space([replace(space.components[0], labels=listed)])


def name_list(given: Sequence[str], what: str = "names of a state's components") -> tuple[str, ...]:
    """Return names as a tuple; TaskError where they are no list of different texts."""
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise TaskError(f"{what} must be a list of text: got {given!r}")
    for one in given:
        text(f"one of the {what}", one, TaskError)
    if len(set(given)) < len(given):
        raise TaskError(f"{what} must differ: got {', '.join(given)}")
    return tuple(given)


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
            return self._place(self._flatten(point))
        except TypeError:  # of what is no whole number
            return MISSING

    def __getstate__(self) -> dict[str, Any]:
        return {"space": self.space}  # the functions below cannot be pickled

    @cached_property
    def _flatten(self) -> Flatten:
        return _flattening(self.space)

    @cached_property
    def _place(self) -> Callable[[tuple[Any, ...]], int]:
        return space_of(self.space, "part").encode_one


@dataclass(frozen=True)
class Point:
    """From a number in :func:`space_of` to its point of a discrete Gymnasium space."""

    space: gym.Space[Any] = field(hash=False)

    def __call__(self, number: int) -> Any:
        """Return the point of a number; arrays in it are read-only."""
        values = space_of(self.space, "part").decode(number).values()
        return _assembled(self.space, iter([int(value) for value in values]))


def _parts(space: "Tuple[Any] | Dict") -> list[tuple[Any, gym.Space[Any]]]:
    """Return the parts of a space with their keys."""
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
    """Return the function from a point to the tuple of the numbers in it."""
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
        self._rows: IntArray | None = None
        if not space.is_box:
            lows = [component.low for component in space.components]
            self._rows = np.stack(list(space.decode().values()), axis=1) - lows

    # The type is quoted: in older versions of Gymnasium these classes are not generic.
    @cached_property
    def gym_space(self) -> "Discrete[np.int64] | MultiDiscrete[np.int64]":
        """Gymnasium's space: ``Discrete(size)`` or ``MultiDiscrete(shape)``."""
        if self.form == "index":
            return Discrete(self.space.size)
        return MultiDiscrete(list(self.space.shape))

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

    def number(self, given: Any) -> int:
        """Return the number of a box's point that is given in Gymnasium's space."""
        shape = (self.space.size,) if self.form == "index" else self.space.shape
        try:
            values = [given] if self.form == "index" else np.asarray(given).tolist()
            return int(np.ravel_multi_index(tuple(map(operator.index, values)), shape))
        except (TypeError, ValueError):
            raise SettingError(f"an action must lie in {self.gym_space}: got {given!r}") from None
