"""The families of four rooms, and of rooms with a key, a lock and pits."""

from typing import Any, Literal

import numpy as np

from curricle.array_types import IntArray
from curricle.tasks.families.family import FamilyMember, TaskFamily
from curricle.tasks.families.parameters import Parameter
from curricle.tasks.four_rooms import LARGEST_SIZE, SMALLEST_SIZE, FourRooms
from curricle.tasks.key_lock_pit import LARGEST_ROOM, SMALLEST_ROOM, KeyLockPit
from curricle.tasks.spaces import Decoded


def four_rooms_task(
    size: int = 13,
    slip: float = 1 / 3,
    goal: Literal["north", "east", "south", "west"] = "east",
    start: Literal["corner", "uniform"] = "corner",
    step_reward: float = 0.0,
    goal_reward: float = 1.0,
    discount: float = 0.9,
    time_limit: int | None = 500,
) -> FourRooms:
    """Return four rooms with the goal in a hallway; the parameters are those of :class:`FourRooms`.

    Examples
    --------
    >>> four_rooms_task() == FourRooms()
    True
    """
    return FourRooms(
        size=size,
        slip=slip,
        goal=goal,
        start=start,
        step_reward=step_reward,
        goal_reward=goal_reward,
        discount=discount,
        time_limit=time_limit,
    )


def key_lock_pit_task(
    size: int = 8,
    keys_held: bool = False,
    start: Literal["map", "uniform"] = "map",
    key_reward: float = 500.0,
    lock_reward: float = 1000.0,
    pit_reward: float = -200.0,
    step_reward: float = -10.0,
    discount: float = 0.99,
    time_limit: int | None = 200,
) -> KeyLockPit:
    """Return the square room of :meth:`KeyLockPit.room`; the parameters are those of the class.

    Examples
    --------
    >>> key_lock_pit_task() == KeyLockPit()
    True
    """
    return KeyLockPit.room(
        size,
        keys_held=keys_held,
        start=start,
        key_reward=key_reward,
        lock_reward=lock_reward,
        pit_reward=pit_reward,
        step_reward=step_reward,
        discount=discount,
        time_limit=time_limit,
    )


def four_rooms_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how four rooms read others: hallways as hallways, the cells of rooms in proportion.

    Examples
    --------
    >>> mapped = four_rooms_mapping(four_rooms_family(size=13), four_rooms_family(size=9))
    >>> cells, _ = mapped({"row": np.array([7, 6, 11]), "column": np.array([9, 2, 1])}, {})
    >>> cells["row"], cells["column"]
    (array([5, 4, 7]), array([6, 1, 1]))
    """
    own, other = (_plan(one["size"]) for one in (target, source))

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row, column = states["row"], states["column"]
        west, east = (_between(row, own[side], other[side]) for side in ("west", "east"))
        rows = np.where(column < target["size"] // 2, west, east)
        columns = _between(column, own["columns"], other["columns"])
        return {"row": rows, "column": columns}, actions

    return function


def key_lock_pit_mapping(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a room with a key reads another: key, pits and lock as such, others in proportion.

    Examples
    --------
    >>> mapped = key_lock_pit_mapping(key_lock_pit_family(size=8), key_lock_pit_family(size=5))
    >>> cells, _ = mapped({"row": np.array([1, 5, 7]), "column": np.array([1, 4, 7])}, {})
    >>> cells["row"], cells["column"]
    (array([1, 3, 4]), array([1, 2, 4]))
    """

    def marks(size: int) -> tuple[list[int], list[int]]:
        pits = size // 2
        return [0, 1, 2, size - 1], [0, 1, pits - 1, pits, pits + 1, size - 1]

    rows, columns = zip(marks(target["size"]), marks(source["size"]), strict=True)

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row, column = _between(states["row"], *rows), _between(states["column"], *columns)
        return {**states, "row": row, "column": column}, actions

    return function


def _plan(size: int) -> dict[str, list[int]]:
    """Return the rows, in the west and the east, and the columns of hallways, walls and corners."""
    half, sixth, first = size // 2, (size - 1) // 6, size // 4
    last = size - 1 - sixth
    return {
        "west": [first, last, half, half - 1, half + 1, 1, size - 2],
        "east": [first, last, half + 1, half, half + 2, 1, size - 2],
        "columns": [sixth, half + half // 2, half, half - 1, half + 1, 1, size - 2],
    }


def _between(values: IntArray, own: list[int], other: list[int]) -> IntArray:
    """Return values so that each of one's own marks becomes the other's, in proportion between.

    Of two marks in one place the first counts.
    """
    marks, first = np.unique(own, return_index=True)
    read = np.interp(values, marks, np.array(other)[first])
    return np.asarray(np.rint(read), dtype=np.int64)


four_rooms_family = TaskFamily(
    "four_rooms",
    four_rooms_task,
    (
        Parameter("size", low=SMALLEST_SIZE, high=LARGEST_SIZE, harder="larger"),
        Parameter("slip", low=0, high=1, harder="larger"),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=four_rooms_mapping,
)
"""Four rooms (:func:`four_rooms_task`); members map by :func:`four_rooms_mapping`."""
key_lock_pit_family = TaskFamily(
    "key_lock_pit",
    key_lock_pit_task,
    (
        Parameter("size", low=SMALLEST_ROOM, high=LARGEST_ROOM, harder="larger"),
        Parameter("keys_held", harder="smaller"),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=key_lock_pit_mapping,
)
"""Rooms with a key, a lock and pits (:func:`key_lock_pit_task`).

Members map by :func:`key_lock_pit_mapping`.
"""
