"""Finite spaces whose points have numbers, for compiled loops, and components, for mappings."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from operator import index
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import Frozen, IntArray, adopted
from curricle.checks import BEYOND_64_BITS, check_memory, text, whole_number
from curricle.errors import TaskError
from curricle.text import counted

Decoded = dict[str, IntArray]
"""Component name -> integer values, one per point, as :meth:`Space.decode` returns them."""

LONGEST_OWN = 80  # characters of a state's own text in a message
MISSING = -1  # the number in :meth:`Space.encode` of values that are no point of the space


def whole(values: npt.ArrayLike, name: str) -> IntArray:
    """Return values as int64, or raise TaskError where they are not whole numbers by type."""
    array = whole_by_type(values, name)
    if array.dtype == np.uint64 and array.size and array.max() >= BEYOND_64_BITS:
        raise TaskError(f"{name} must be below 2^63: got {array.max()}")
    return array.astype(np.int64)


def whole_by_type(values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    """Return values as an array, or raise TaskError where they are not whole numbers by type."""
    try:
        array = np.asarray(values)
    except ValueError:
        raise TaskError(f"{name} must be an array of whole numbers: got {values!r}") from None
    if array.dtype.kind not in "iu" and array.size:
        raise TaskError(f"{name} must be whole numbers: got {array.dtype}")
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
        Smallest value; all values must fit 64 bits.
    labels : tuple of str, optional
        How each value prints, `size` of them.
    arbitrary : bool
        Whether a search numbered the values as it found them; no mapping by name reads these.

    Examples
    --------
    >>> Component("move", 2, labels=("left", "right")).label(1)
    'right'
    """

    name: str
    size: int
    low: int = 0
    labels: tuple[str, ...] | None = None
    arbitrary: bool = field(default=False, repr=False)

    def __post_init__(self) -> None:
        text("the name of a component", self.name, TaskError)
        of = f"of component {self.name!r}"
        size = whole_number(f"the number of values {of}", self.size, 1, TaskError)
        low = whole_number(f"the lowest value {of}", self.low, 1 - BEYOND_64_BITS, TaskError)
        whole_number(f"the highest value {of}", low + size - 1, low, TaskError)
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "low", low)
        if self.labels is None:
            return
        labels: Any = self.labels
        if isinstance(labels, str) or not isinstance(labels, Sequence):
            raise TaskError(f"labels {of} must be a list of text: got {labels!r}")
        for label in labels:
            text(f"a label {of}", label, TaskError)
        if len(labels) != size:
            raise TaskError(
                f"a component needs one label per value: {self.name!r} has {size} values and "
                f"{len(labels)} labels"
            )
        if len(set(labels)) != size:
            raise TaskError(f"a component's labels must differ: {self.name!r} has {labels}")
        object.__setattr__(self, "labels", tuple(labels))

    @property
    def high(self) -> int:
        """The largest value."""
        return self.low + self.size - 1

    def label(self, value: int) -> str:
        """Return how `value` prints."""
        return str(value) if self.labels is None else self.labels[value - self.low]

    @property
    def ends(self) -> str:
        """The lowest and the highest value as text."""
        return f"{self.label(self.low)} to {self.label(self.high)}"

    def value(self, wanted: Any) -> int:
        """Return the value that a number or a label names; TaskError if there is none."""
        if isinstance(wanted, str) and wanted in (self.labels or ()):
            return self.low + (self.labels or ()).index(wanted)
        is_number = isinstance(wanted, Real) and not isinstance(wanted, bool)
        if is_number and self.low <= wanted <= self.high and wanted == int(wanted):
            return int(wanted)
        raise TaskError(f"{self.name} runs from {self.ends}: got {wanted!r}")


@dataclass(frozen=True, eq=False, repr=False)
class Space(Frozen):
    """A finite set of points with named integer components.

    Parameters
    ----------
    components : sequence of Component
        At least one; names must differ.
    points : (S, C) int array, optional
        The points that exist, in the order of their numbers, values within the components' ranges;
        by default the whole box, numbered in C order (last component fastest).
    drawn : callable, optional
        ``drawn(point, mode)`` is what the class that points come from itself shows of one, by the
        modes of Gymnasium's ``render``: text or pixels, None for neither. Pickles leave it out.

    Examples
    --------
    >>> space = Space([Component("row", 2), Component("column", 3)])
    >>> space.encode(row=[0, 1], column=[2, 2])
    array([2, 5])
    >>> space.decode([5])["row"], space.label(5)
    (array([1]), 'row=1 column=2')
    """

    components: Sequence[Component]
    points: Any = None
    drawn: Callable[[int, str], Any] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "drawn": None}

    def __post_init__(self) -> None:
        axes = self.components
        if not isinstance(axes, Sequence) or not all(isinstance(c, Component) for c in axes):
            raise TaskError(f"components must be a list of Component: got {axes!r}")
        object.__setattr__(self, "components", tuple(axes))
        names = [c.name for c in self.components]
        if not names or len(set(names)) != len(names):
            raise TaskError(f"components need different names, at least one: got {names}")
        if self.points is None:
            if self.size >= BEYOND_64_BITS:  # points have numbers, which loops hold in 64 bits
                more = f" and {len(names) - 6} more" * (len(names) > 6)
                raise TaskError(
                    f"a space must have fewer than 2^63 points: {', '.join(names[:6])}{more} make "
                    f"2^{math.log2(self.size):.1f}"
                )
            return
        points = whole(self.points, "points")
        if points.ndim != 2 or points.shape[1] != len(names) or not len(points):
            raise TaskError(
                f"points must have shape (S, {len(names)}), S at least 1: got {points.shape}"
            )
        object.__setattr__(self, "points", adopted(points, np.int64))
        for axis, component in enumerate(self.components):
            values = self.points[:, axis]
            bad = np.flatnonzero((values < component.low) | (values > component.high))
            if bad.size:
                raise TaskError(
                    f"component {component.name!r} runs from {component.low} to "
                    f"{component.high}: point {bad[0]} has {values[bad[0]]}"
                )
        if len(self._sorted[0]) != len(self.points):
            raise TaskError(
                f"the points of a space must differ: {len(self.points)} given, "
                f"{len(self._sorted[0])} distinct"
            )

    @cached_property
    def _sorted(self) -> tuple[npt.NDArray[np.void], IntArray]:
        """The points as sortable records, sorted, with the number of each."""
        records, numbers = np.unique(_records(self.points), return_index=True)
        return records, numbers.astype(np.int64)

    @property
    def is_box(self) -> bool:
        """Whether every combination of component values is a point."""
        return self.points is None

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
        """The increase of a point's number, in a whole box, by an offset of 1 in each component."""
        shape = self.shape
        return tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))

    @cached_property
    def size(self) -> int:
        """The number of points."""
        return math.prod(self.shape) if self.points is None else len(self.points)

    def __len__(self) -> int:
        return self.size

    def component(self, name: str) -> Component:
        """Return the component called `name`; TaskError lists the valid names otherwise."""
        for component in self.components:
            if component.name == name:
                return component
        raise TaskError(f"a component must be one of {', '.join(self.names)}: got {name!r}")

    def decode(self, index: npt.ArrayLike | None = None) -> Decoded:
        """Return the int64 values of each component at the points `index`, or at all of them."""
        if index is None:
            check_memory("all points of a space", 8 * self.size * len(self.names), TaskError)
        numbers = np.arange(self.size) if index is None else whole(index, "points' numbers")
        if numbers.size and (numbers.min() < 0 or numbers.max() >= self.size):
            raise TaskError(
                f"a point's number must lie in 0..{self.size - 1}: got "
                f"{numbers.min()}..{numbers.max()}"
            )
        if self.points is not None:
            return {n: self.points[numbers, i] for i, n in enumerate(self.names)}
        values = np.unravel_index(numbers, self.shape)
        return {c.name: v + c.low for c, v in zip(self.components, values, strict=True)}

    def encode(self, **values: npt.ArrayLike) -> IntArray:
        """Return the numbers of the points with these values, by component; `MISSING` where none.

        Values are int arrays, which broadcast together.
        """
        if set(values) != set(self.names):
            raise TaskError(
                f"encode needs exactly the components {', '.join(self.names)}: got "
                f"{', '.join(values) or 'none'}"
            )
        arrays = [whole(values[name], f"component {name!r}") for name in self.names]
        try:
            columns = np.broadcast_arrays(*arrays)
        except ValueError:
            shapes = ", ".join(str(array.shape) for array in arrays)
            raise TaskError(f"components' shapes must broadcast together: got {shapes}") from None
        if self.points is not None:
            rows = np.stack(columns, axis=-1)
            records, numbers = self._sorted
            wanted = _records(rows.reshape(-1, len(self.names)))
            nearest = np.minimum(np.searchsorted(records, wanted), len(records) - 1)
            points = np.where(records[nearest] == wanted, numbers[nearest], MISSING)
            return points.reshape(rows.shape[:-1])
        number = np.zeros(columns[0].shape, dtype=np.int64)
        inside = np.ones(columns[0].shape, dtype=bool)
        for component, column, stride in zip(self.components, columns, self.strides, strict=True):
            within = (column >= component.low) & (column <= component.high)
            number += np.where(within, column - component.low, 0) * stride
            inside &= within
        return np.where(inside, number, MISSING)

    def encode_one(self, values: tuple[Any, ...]) -> int:
        """Return the number of a point given as a tuple, as :meth:`encode` does; much faster."""
        if self.points is not None:
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
        return {values: i for i, values in enumerate(map(tuple, self.points.tolist()))}

    def label(self, index: int) -> str:
        """Return the point as text, ``name=value`` for each component."""
        return " ".join(f"{name}={label}" for name, label in parts_of(self, index))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Space):
            return NotImplemented
        ours, theirs = self.points, other.points
        alike = ours is theirs if ours is None or theirs is None else np.array_equal(ours, theirs)
        return alike and self.components == other.components

    def __hash__(self) -> int:
        return hash((self.components, self.size))

    def __repr__(self) -> str:
        parts = " x ".join(f"{c.name}[{c.size}]" for c in self.components[:6])
        more = f" x ... ({len(self.components)} components)" if len(self.components) > 6 else ""
        return f"Space({counted(self.size, 'point')}: {parts}{more})"


def _records(rows: object) -> npt.NDArray[np.void]:
    """View an (n, C) int64 array as n comparable records (big-endian bytes sort like numbers)."""
    shifted = np.ascontiguousarray(rows, dtype=">i8")
    return shifted.view(np.dtype((np.void, shifted.shape[1] * 8))).ravel()


# -- names of states and actions -------------------------------------------------------------------


def state_name(space: Space, state: int) -> str:
    """Return a state's number, its components in words, and its own text if that is one line."""
    parts = [f"{name} {label}" for name, label in parts_of(space, state)]
    if len(parts) == 1 and parts[0].endswith(f" {state}"):
        parts = []
    shown = space.drawn(state, "ansi") if space.drawn else None
    if shown and len(shown) <= LONGEST_OWN and "\n" not in shown:
        parts.append(f"shown as {shown}")
    return f"state {state} ({', '.join(parts)})" if parts else f"state {state}"


def action_name(space: Space, action: int) -> str:
    """Return an action in words."""
    parts = parts_of(space, action)
    if len(parts) > 1:
        return ", ".join(f"{name} {label}" for name, label in parts)
    labelled = space.components[0].labels is not None
    return parts[0][1] if labelled else f"{parts[0][0]} {parts[0][1]}"


def entry_names(name: str, shape: Sequence[int]) -> list[str]:
    """Return a name for each entry of an array: numbered from 1, or by its indices from 0."""
    # A flat number would be another place in an array of another width.
    if len(shape) < 2:
        return [f"{name}_{i + 1}" for i in range(math.prod(shape))]
    return ["_".join(map(str, (name, *indices))) for indices in np.ndindex(*shape)]


def values_of(space: Space, point: int) -> dict[str, int]:
    """Return a point's components by name."""
    return {name: int(value) for name, value in space.decode(point).items()}


def parts_of(space: Space, point: int) -> list[tuple[str, str]]:
    """Return the name and the label of each component of a point."""
    values = values_of(space, point)
    return [(c.name, c.label(values[c.name])) for c in space.components]
