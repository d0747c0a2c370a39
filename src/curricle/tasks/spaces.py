"""Finite spaces whose points have named components.

A space numbers its points 0 .. size-1. Mappings between tasks are written with component names
(``prey``, ``row``, ...), compiled loops run on the numbers; this module converts between the two. A
whole box is numbered as NumPy numbers the entries of an array in C order: a point is the sum of its
components' offsets, each times its stride.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import index
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from curricle.array_types import IntArray
from curricle.checks import whole_number
from curricle.errors import TaskError

Array = TypeVar("Array", bound=npt.NDArray[Any])
Decoded = dict[str, IntArray]
"""Component name -> integer values, one per point (what :meth:`Space.decode` returns)."""

MISSING = -1
"""What :meth:`Space.encode` gives for values that are no point of the space."""


def frozen(array: Array) -> Array:
    """Return the array itself, made read-only, so that it cannot be changed in place."""
    array.flags.writeable = False
    return array


def adopted(values: npt.ArrayLike, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return `values` as a frozen array of this type: itself if nothing can write to it any more.

    Examples
    --------
    >>> mine = np.arange(3.0)
    >>> adopted(mine, np.float64) is mine, adopted(frozen(mine), np.float64) is mine
    (False, True)
    """
    if type(values) is np.ndarray and values.dtype == dtype and values.flags.c_contiguous:
        owner: Any = values
        while type(owner) is np.ndarray and not owner.flags.writeable:
            owner = owner.base
        if owner is None:
            return values
    return frozen(np.array(values, dtype=dtype, order="C"))


def whole(values: npt.ArrayLike, what: str) -> IntArray:
    """Return values as int64, or raise TaskError where they are not whole numbers by type."""
    return whole_by_type(values, what).astype(np.int64)


def whole_by_type(values: npt.ArrayLike, what: str) -> npt.NDArray[Any]:
    """Return values as an array, or raise TaskError where they are not whole numbers by type."""
    try:
        array = np.asarray(values)
    except ValueError:
        raise TaskError(f"{what} must be an array of whole numbers: got {values!r}") from None
    if array.dtype.kind not in "iu" and array.size:
        raise TaskError(f"{what} must be whole numbers: got {array.dtype}")
    return array


@dataclass(frozen=True)
class Component:
    """One named coordinate of a space: the integers from ``low`` to ``low + size - 1``.

    Parameters
    ----------
    name : str
    size : int
        Number of values, at least 1.
    low : int
        Smallest value.
    labels : tuple of str, optional
        How each value prints, `size` of them.

    Examples
    --------
    >>> Component("move", 2, labels=("left", "right")).label(1)
    'right'
    """

    name: str
    size: int
    low: int = 0
    labels: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        whole_number(f"the number of values of component {self.name!r}", self.size, 1, TaskError)
        whole_number(f"the lowest value of component {self.name!r}", self.low, -(2**62), TaskError)
        if self.labels is not None and len(self.labels) != self.size:
            raise TaskError(
                f"a component needs one label per value: {self.name!r} has {self.size} values "
                f"and {len(self.labels)} labels"
            )
        if self.labels is not None and len(set(self.labels)) != self.size:
            raise TaskError(f"a component's labels must differ: {self.name!r} has {self.labels}")

    def label(self, value: int) -> str:
        """Return how `value` prints."""
        return str(value) if self.labels is None else self.labels[value - self.low]


class Space:
    """A finite set of points with named integer components.

    Without `points` the space is the whole box (every combination, last component fastest);
    with `points` it is just those rows, numbered in the order given.

    Parameters
    ----------
    components : sequence of Component
        At least one; names must differ.
    points : (S, C) int array, optional
        The points that exist, one row each, values within the components' ranges.

    Raises
    ------
    TaskError
        On duplicate names, duplicate points or values out of range.

    Examples
    --------
    >>> space = Space([Component("row", 2), Component("column", 3)])
    >>> space.size, space.names
    (6, ('row', 'column'))
    >>> space.encode(row=[0, 1], column=[2, 2])
    array([2, 5])
    >>> space.decode([5])["row"]
    array([1])
    >>> space.label(5)
    'row=1 column=2'
    """

    def __init__(self, components: Sequence[Component], points: npt.ArrayLike | None = None):
        self.components = tuple(components)
        names = [c.name for c in self.components]
        if not names or len(set(names)) != len(names):
            raise TaskError(f"components need different names, at least one: got {names}")
        self._points: IntArray | None = None
        if points is not None:
            self._points = frozen(whole(points, "points").copy())
            if self._points.ndim != 2 or self._points.shape[1] != len(self.components):
                raise TaskError(
                    f"points must have shape (S, {len(self.components)}): got {self._points.shape}"
                )
            self._check_points()

    def _check_points(self) -> None:
        assert self._points is not None
        for axis, component in enumerate(self.components):
            values = self._points[:, axis] - component.low
            bad = np.flatnonzero((values < 0) | (values >= component.size))
            if bad.size:
                raise TaskError(
                    f"component {component.name!r} runs from {component.low} to "
                    f"{component.low + component.size - 1}: point {bad[0]} has "
                    f"{self._points[bad[0], axis]}"
                )
        if len(self._sorted[0]) != len(self._points):
            raise TaskError(
                f"the points of a space must differ: {len(self._points)} given, "
                f"{len(self._sorted[0])} distinct"
            )

    @cached_property
    def _sorted(self) -> tuple[npt.NDArray[np.void], IntArray]:
        """The points as sortable records, sorted, with the number of each."""
        records, numbers = np.unique(_records(self._points), return_index=True)
        return records, numbers.astype(np.int64)

    @property
    def is_box(self) -> bool:
        """Whether every combination of component values is a point."""
        return self._points is None

    @property
    def names(self) -> tuple[str, ...]:
        """The component names, in order."""
        return tuple(c.name for c in self.components)

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """The number of values of each component."""
        return tuple(c.size for c in self.components)

    @property
    def strides(self) -> tuple[int, ...]:
        """What an offset of 1 in each component adds to the number of a point of a whole box."""
        shape = self.shape
        return tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))

    @cached_property
    def size(self) -> int:
        """The number of points."""
        if self._points is not None:
            return len(self._points)
        return math.prod(self.shape)

    def __len__(self) -> int:
        return self.size

    def component(self, name: str) -> Component:
        """Return the component called `name`; TaskError lists the valid names otherwise."""
        for component in self.components:
            if component.name == name:
                return component
        raise TaskError(
            f"a component must be one of {', '.join(self.names)}: got {name!r}",
        )

    def decode(self, index: npt.ArrayLike | None = None) -> Decoded:
        """Return the component values of the points numbered `index` (default: all of them).

        Parameters
        ----------
        index : int array of any shape, optional

        Returns
        -------
        dict
            Name -> int64 array of the shape of `index`.
        """
        numbers = np.arange(self.size) if index is None else whole(index, "points' numbers")
        if numbers.size and (numbers.min() < 0 or numbers.max() >= self.size):
            raise TaskError(
                f"a point's number must lie in 0..{self.size - 1}: got "
                f"{numbers.min()}..{numbers.max()}"
            )
        if self._points is not None:
            return {n: self._points[numbers, i] for i, n in enumerate(self.names)}
        values = np.unravel_index(numbers, self.shape)
        return {c.name: v + c.low for c, v in zip(self.components, values, strict=True)}

    def encode(self, **values: npt.ArrayLike) -> IntArray:
        """Return the numbers of the points with these component values, `MISSING` where none.

        Parameters
        ----------
        **values : int arrays, broadcast together
            One per component, by name.

        Raises
        ------
        TaskError
            When a component is missing or unknown.
        """
        if set(values) != set(self.names):
            raise TaskError(
                f"encode needs exactly the components {', '.join(self.names)}: got "
                f"{', '.join(values) or 'none'}"
            )
        given = [whole(values[name], f"component {name!r}") for name in self.names]
        try:
            columns = np.broadcast_arrays(*given)
        except ValueError:
            shapes = ", ".join(str(column.shape) for column in given)
            raise TaskError(f"components' shapes must broadcast together: got {shapes}") from None
        if self._points is not None:
            return self._look_up(np.stack(columns, axis=-1))
        number = np.zeros(columns[0].shape, dtype=np.int64)
        inside = np.ones(columns[0].shape, dtype=bool)
        for component, column, stride in zip(self.components, columns, self.strides, strict=True):
            offset = column - component.low
            inside &= (offset >= 0) & (offset < component.size)
            number += offset * stride
        return np.where(inside, number, MISSING)

    def encode_one(self, values: tuple[Any, ...]) -> int:
        """Return what :meth:`encode` does, for one point given as a tuple; much faster.

        Examples
        --------
        >>> space = Space([Component("row", 2), Component("column", 3)])
        >>> space.encode_one((1, 2)), space.encode_one((2, 0))
        (5, -1)
        """
        if self._points is not None:
            return self._numbers.get(values, MISSING)
        if len(values) != len(self.components):
            return MISSING
        number = 0
        for value, component in zip(values, self.components, strict=True):
            offset = index(value) - component.low
            if not 0 <= offset < component.size:
                return MISSING
            number = number * component.size + offset
        return number

    @cached_property
    def _numbers(self) -> dict[tuple[int, ...], int]:
        """The number of each point that is listed."""
        assert self._points is not None
        return {values: i for i, values in enumerate(map(tuple, self._points.tolist()))}

    def _look_up(self, rows: IntArray) -> IntArray:
        records, numbers = self._sorted
        wanted = _records(rows.reshape(-1, len(self.names)))
        nearest = np.minimum(np.searchsorted(records, wanted), len(records) - 1)
        found = np.where(records[nearest] == wanted, numbers[nearest], MISSING)
        return found.reshape(rows.shape[:-1])

    def label(self, index: int) -> str:
        """Return the point as text, ``name=value`` for each component."""
        values = self.decode(index)
        return " ".join(f"{c.name}={c.label(int(values[c.name]))}" for c in self.components)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Space):
            return NotImplemented
        if self.components != other.components:
            return False
        if self._points is None or other._points is None:
            return self._points is other._points
        return np.array_equal(self._points, other._points)

    def __hash__(self) -> int:
        return hash((self.components, self.size))

    def __repr__(self) -> str:
        parts = " x ".join(f"{c.name}[{c.size}]" for c in self.components[:6])
        more = f" x ... ({len(self.components)} components)" if len(self.components) > 6 else ""
        return f"Space({self.size} points: {parts}{more})"


def _records(rows: Any) -> npt.NDArray[np.void]:
    """View an (n, C) int64 array as n comparable records (big-endian bytes sort like numbers)."""
    shifted = np.ascontiguousarray(rows, dtype=">i8")
    return shifted.view(np.dtype((np.void, shifted.shape[1] * 8))).ravel()
