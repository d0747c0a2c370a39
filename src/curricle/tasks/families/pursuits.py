"""The family of pursuits: size, predators, torus, capture (paper, F4; E7)."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.errors import TaskError
from curricle.tasks.families.components_by_name import ComponentsByName
from curricle.tasks.families.family import FamilyMember, TaskFamily
from curricle.tasks.families.parameters import Parameter
from curricle.tasks.pursuit import LARGEST_SIZE, MOST_PREDATORS, Pursuit
from curricle.tasks.spaces import Decoded

Renaming = dict[str, str]


def pursuit_mappings(target: FamilyMember, source: FamilyMember) -> list[Any]:
    """Return how a pursuit reads a smaller one, or one with fewer predators.

    There is one mapping for each group of predators that stands for the source's: each predator
    and those after it, in a circle (paper E7: f_1 and f_2 of two predators from one). Between
    grids of equal size cells correspond by label. On another size the distances between the prey
    and the predators of the group stay the same where they fit: a window of the source's size is
    laid over all of them, and is the nearer to an edge the nearer they are to it. Distances that do
    not fit become the largest that do.

    Raises
    ------
    TaskError
        When the source has more predators than the target.

    Examples
    --------
    >>> hunt, chase = pursuit_family(size=4, predators=2), pursuit_family(size=4, predators=1)
    >>> [dict(one.renaming)["predator"] for one in pursuit_mappings(hunt, chase)]
    ['predator_1', 'predator_2']
    """
    if source["predators"] > target["predators"]:
        raise TaskError(
            f"a pursuit reads pursuits with at most its {target['predators']} predators: got "
            f"{source}"
        )
    groups = list(_groups(_names(target["predators"]), _names(source["predators"])))
    if target["size"] == source["size"]:
        return [ComponentsByName(renaming=group) for group in groups]
    return [_on_another_size(target, source, group) for group in groups]


def _names(predators: int) -> list[str]:
    """Return the names of a pursuit's predators, as :attr:`Pursuit.predator_names` has them."""
    return ["predator"] if predators == 1 else [f"predator_{i}" for i in range(1, predators + 1)]


def _groups(own: list[str], others: list[str]) -> Iterator[Renaming]:
    """Yield renamings of the source's predators, so that all of the target's are read equally."""
    for first in range(len(own) if len(own) > len(others) else 1):
        yield {name: own[(first + i) % len(own)] for i, name in enumerate(others)}


def _on_another_size(
    target: FamilyMember, source: FamilyMember, group: Renaming
) -> Callable[[Decoded, Decoded], tuple[Decoded, Decoded]]:
    """Return the function from the target's decoded states and actions to the source's."""
    size, smaller = target["size"], source["size"]
    five, other_five = target["moves"] == 5, source["moves"] == 5

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        bodies = ["prey", *group.values()]
        cells = np.stack(np.broadcast_arrays(*[states[name] for name in bodies]))
        place = _around_prey if source["torus"] else _window
        rows, columns = (
            place(axis, size, smaller, target["torus"]) for axis in np.divmod(cells, size)
        )
        read = rows * smaller + columns
        # Moves are numbered without staying where nobody stays: 0 is then north.
        moves = {name: actions[own] - five + other_five for name, own in group.items()}
        return dict(zip(["prey", *group], read, strict=True)), moves

    return function


def _window(axis: IntArray, size: int, smaller: int, torus: bool) -> IntArray:
    """Return coordinates in a walled grid of another size, (bodies, ...) as given.

    Examples
    --------
    >>> _window(np.array([[0, 2, 4, 0], [1, 3, 4, 4]]), 5, 3, False)
    array([[0, 1, 2, 0],
           [1, 2, 2, 2]])
    """
    low, high = axis.min(axis=0), axis.max(axis=0)
    before, after = low, size - 1 - high
    # The window begins at `first` of 0 .. size - smaller, in proportion to the room on both sides.
    room = np.maximum(before + after, 1)
    first = ((size - smaller) * before * 2 + room) // (2 * room)
    spread = high - low
    wide = spread > smaller - 1
    shifted = axis - np.clip(first, high - smaller + 1, low)
    squeezed = (2 * (axis - low) * (smaller - 1) + spread) // np.maximum(2 * spread, 1)
    return np.asarray(np.where(wide, squeezed, shifted))


def _around_prey(axis: IntArray, size: int, smaller: int, torus: bool) -> IntArray:
    """Return coordinates on a torus of another size: the prey's cell, and distances from it.

    Examples
    --------
    >>> _around_prey(np.array([[0, 4], [4, 0]]), 5, 3, True)
    array([[0, 1],
           [2, 2]])
    """
    prey, distance = axis[0], axis - axis[0]
    if torus:
        distance = (distance + size // 2) % size - size // 2
    nearest = np.clip(distance, -((smaller - 1) // 2), smaller // 2)
    return np.asarray((prey + nearest) % smaller)


def _enough_predators(parameters: dict[str, Any]) -> str | None:
    """Return what is wrong where more predators are needed than there are."""
    needed, there = parameters["capture"], parameters["predators"]
    if isinstance(needed, int) and needed > there:
        return f"capture of pursuit must be at most the number of predators, {there}"
    return None


pursuit_family = TaskFamily(
    "pursuit",
    Pursuit,
    (
        Parameter("size", low=2, high=LARGEST_SIZE, harder="larger"),
        Parameter("predators", low=1, high=MOST_PREDATORS, harder="larger"),
        Parameter("capture", values=("any", "all", "as_published", *range(1, MOST_PREDATORS + 1))),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=pursuit_mappings,
    constraint=_enough_predators,
)
"""Pursuits (:class:`Pursuit`); members read each other by :func:`pursuit_mappings`."""
