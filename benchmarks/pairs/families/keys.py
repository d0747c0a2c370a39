"""Development: halls with a key and a locked door; the state has a component the source lacks."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import MOVES, by_cell, cropped, grid, redrawn, task_of

HALL = [
    "....#....",
    "....#....",
    "S...D...G",
    "....#....",
    "K...#....",
]
WIDE = [
    "......#...",
    ".##...#...",
    "S#....D..G",
    ".##...#...",
    "......#...",
    "K.....#...",
]


def locked(lines: list[str], *, step: float, goal: float, limit: int) -> cr.FiniteMDP:
    """Return the hall with a third component, ``key``: the door opens for who has it."""
    cells = {(i, j): c for i, line in enumerate(lines) for j, c in enumerate(line) if c != "#"}
    moves = list(MOVES.values())

    def outcomes(point: Any, action: int) -> Any:
        row, column, key = point
        after = row + moves[action][0], column + moves[action][1]
        if after not in cells or (cells[after] == "D" and not key):
            after = row, column
        key = max(key, int(cells[after] == "K"))
        return [(1.0, (*after, key), step + (goal if cells[after] == "G" else 0.0))]

    return task_of(
        [(*cell, key) for cell in cells for key in (0, 1)],
        ("row", "column", "key"), cr.Component("move", 4, labels=tuple(MOVES)), outcomes,
        ends=lambda point: cells[point[:2]] == "G",
        starts=lambda point: cells[point[:2]] == "S" and point[2] == 0,
        discount=0.97, time_limit=limit,
    )  # fmt: skip


def in_phase(key: int) -> Any:
    """Return how the states with, or without, the key read the cells of the source."""

    def read(state: Any, action: Any) -> Any:
        row = np.where(state["key"] == key, state["row"], -9)
        return {"row": row, "column": state["column"]}, action

    return read


def open_hall(lines: list[str], **rules: Any) -> cr.FiniteMDP:
    """Return the hall without a door; it ends at the goal."""
    return grid(lines, **{"discount": 0.97, "rewards": {"G": 1.0}, "time_limit": 100, **rules})


def keys() -> Family:
    """Return the family: +1 at the goal, 30,000 steps; a wide hall at -1 a step, 60,000."""
    family = Family("keys", "development")
    family.target("hall", locked(HALL, step=0.0, goal=1.0, limit=100), 30_000)
    through = open_hall(HALL, starts="SK.")
    fetch = open_hall(HALL, rewards={"K": 1.0}, ends="K")
    room = cropped(HALL, (0, 5), (4, 9), rewards={"G": 1.0}, starts=".D", discount=0.97)
    away = open_hall(redrawn(HALL, {(2, 8): ".", (0, 8): "G"}), starts="SK.")
    with_key, without, mirrored = in_phase(1), in_phase(0), by_cell(lambda row, at: (row, 8 - at))
    family.add("near", "the door is open, with the key", through, with_key, budget=5_000)
    family.add("near", "fetching the key", fetch, without, budget=4_000)
    family.add("far", "the last room", room, with_key, budget=2_000)
    family.add("wrong goal", "another goal", away, with_key, budget=5_000)
    family.add("useless", "the door is open, key or not", through, by_cell(), budget=5_000)
    family.add("mirrored", "mirrored", through, mirrored, budget=5_000)
    family.spoil("the door is open, with the key")

    family.target("wide hall", locked(WIDE, step=-1.0, goal=0.0, limit=200), 60_000)
    costly = {"rewards": {}, "step": -1.0, "time_limit": 200}
    through = open_hall(WIDE, starts="SK.", **costly)
    fetch = open_hall(WIDE, ends="K", **costly)
    family.add("near", "wide, with the key", through, with_key, budget=12_000)
    family.add("far", "wide, fetching the key", fetch, without, budget=8_000)
    return family
