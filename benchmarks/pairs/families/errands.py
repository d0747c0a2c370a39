"""Blind: a robot that lives on its battery, a fragile lamp in a cave, and switches in order."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import MOVES, by_cell, cells_of, cropped, explored, grid, redrawn

STEPS = list(MOVES.values())


def moved(cells: Any, cell: Any, action: int) -> Any:
    """Return the cell that a move leads to, which may be the same."""
    after = cell[0] + STEPS[action][0], cell[1] + STEPS[action][1]
    return after if after in cells else cell


HALL = [
    "..A....",
    "..##...",
    "..#....",
    "...C.#.",
    ".....#.",
    ".##....",
    "....B..",
]
FULL, CHARGED = 16, 6
"""Units of charge: the most, and what a step at a charger adds."""


def patrol(
    lines: list[str], *, drain: float = 0.25, battery: bool = True, empty: float = -5.0
) -> cr.FiniteMDP:
    """Return a robot that is paid 1 at post A and at post B by turns, until its battery is empty.

    A step takes a unit of charge, or two with probability `drain`; at C it can charge.
    """
    cells = cells_of(lines)
    posts = [next(cell for cell in cells if cells[cell] == post) for post in "AB"]

    def outcomes(point: Any, action: int) -> Any:
        cell, wanted, *charge = point[:2], *point[2:]
        after = moved(cells, cell, action) if action < 4 else cell
        arrived = after == posts[wanted]
        reward, wanted = float(arrived), 1 - wanted if arrived else wanted
        if not battery:
            return [(1.0, (*after, wanted), reward)]
        if action == 4 and cells[cell] == "C":
            return [(1.0, (*cell, wanted, min(charge[0] + CHARGED, FULL)), 0.0)]
        left = [(1 - drain, charge[0] - 1), (drain, max(charge[0] - 2, 0))]
        return [(p, (*after, wanted, c), reward + (0.0 if c else empty)) for p, c in left]

    chargers = [cell for cell, character in cells.items() if character == "C"]
    return explored(
        [(*cell, 0, FULL) if battery else (*cell, 0) for cell in chargers],
        ("row", "column", "post", "charge")[: 4 if battery else 3],
        cr.Component("move", 5, labels=(*MOVES, "charge")), outcomes,
        ends=lambda point: battery and point[3] == 0, discount=0.95, time_limit=150,
    )  # fmt: skip


def batteries() -> Family:
    """Return the patrol, 50,000 steps; a source without a battery hides what ends it."""
    family = Family("batteries", "blind")
    hall = family.target("hall", patrol(HALL), 50_000)
    on_mains, sure = patrol(HALL, battery=False), patrol(HALL, drain=0.0)
    more = patrol(redrawn(HALL, {(0, 6): "C", (6, 0): "C"}))
    nearer = redrawn(HALL, {(0, 2): ".", (6, 4): ".", (2, 3): "A", (4, 2): "B"})
    family.add("far", "on mains", on_mains, cr.project(hall, on_mains), budget=3_000)
    family.add("near", "a steady drain", sure, budget=10_000)
    family.add("near", "more chargers", more, budget=10_000)
    family.add("far", "nearer posts", patrol(nearer), budget=10_000)
    return family


CAVE = [
    "S.....#....",
    ".####.#.##.",
    ".#....#..#.",
    ".#.##...O#.",
    "...#O.#.##.",
    ".#.#..#....",
    ".#...##.##.",
    ".###..O..#.",
    "...O#.##.#.",
    ".#....#...G",
]


def cave(
    lines: list[str], *, breaks: float = 0.3, stumbles: float = 0.6, lit: int = 1
) -> cr.FiniteMDP:
    """Return a cave with a treasure of 10 and pits of -1, at -.02 a step.

    Who runs into rock breaks the lamp with probability `breaks`. In the dark a move goes anywhere
    with probability `stumbles`.
    """
    cells = cells_of(lines)
    found = {"G": 10.0, "O": -1.0}

    def outcomes(point: Any, action: int) -> Any:
        cell, lamp = point[:2], point[2]
        chance = 0.0 if lamp else stumbles
        ways = [(1 - chance, action), *((chance / 4, move) for move in range(4))]
        reached: list[Any] = []
        for p, move in ways:
            after = moved(cells, cell, move)
            reward = -0.02 + found.get(cells[after], 0.0)
            broken = breaks * lamp * (after == cell)
            reached.append((p * (1 - broken), (*after, lamp), reward))
            reached.append((p * broken, (*after, 0), reward))
        return reached

    return explored(
        [(*cell, lit) for cell, character in cells.items() if character == "S"],
        ("row", "column", "lamp"), cr.Component("move", 4, labels=tuple(MOVES)), outcomes,
        ends=lambda point: cells[point[:2]] in "GO", discount=0.99, time_limit=120,
    )  # fmt: skip


def lamps() -> Family:
    """Return the cave, 25,000 steps; the treasure of one source lies in the other wing."""
    family = Family("lamps", "blind")
    family.target("cave", cave(CAVE), 25_000)
    other = redrawn(CAVE, {(9, 10): ".", (8, 0): "G"})
    nearer = redrawn(CAVE, {(0, 0): ".", (3, 6): "S"})
    rules: dict[str, Any] = {"rewards": {"G": 10.0, "O": -1.0}, "step": -0.02, "ends": "GO"}
    wing = cropped(CAVE, (0, 10), (6, 11), starts=".", **rules)
    family.add("near", "a sturdy lamp", cave(CAVE, breaks=0.05), budget=3_000)
    family.add("far", "the other wing's treasure", cave(other), budget=3_000)
    family.add("near", "from the passage", cave(nearer), budget=3_000)
    family.add("far", "the last wing by day", wing, by_cell(), budget=2_000)
    return family


FLOOR = [
    "2......",
    "..#....",
    "..#..3.",
    "...S...",
    ".1..#..",
    "....#..",
    "......4",
]


def panel(
    lines: list[str], *, switches: str, pressed: int = 0, slip: float = 0.0, wrong: float = 0.0,
    resets: bool = True,
) -> cr.FiniteMDP:  # fmt: skip
    """Return a floor with switches to be pressed in order, for +1 at the last of `switches`.

    A wrong press is paid `wrong`, and `resets` what was pressed; the first `pressed` are already.
    """
    cells = cells_of(lines)

    def outcomes(point: Any, action: int) -> Any:
        cell, done = point[:2], point[2]
        if action == 4:
            mark = cells[cell]
            if mark == str(done + 1):
                return [(1.0, (*cell, done + 1), float(done + 1 == len(switches)))]
            again = done if mark not in switches or not resets else 0
            return [(1.0, (*cell, again), wrong)]
        ways = [(1 - slip, action), (slip / 2, (action + 1) % 4), (slip / 2, (action - 1) % 4)]
        return [(p, (*moved(cells, cell, move), done), 0.0) for p, move in ways]

    return explored(
        [(*cell, pressed) for cell, character in cells.items() if character == "S"],
        ("row", "column", "pressed"), cr.Component("move", 5, labels=(*MOVES, "press")), outcomes,
        ends=lambda point: point[2] == len(switches), discount=0.98, time_limit=150,
    )  # fmt: skip


def switches() -> Family:
    """Return four switches on a sure floor (40,000 steps), three with slips and fines (20,000)."""
    family = Family("switches", "blind")
    family.target("four", panel(FLOOR, switches="1234"), 40_000)
    last = panel(FLOOR, switches="1234", pressed=2)
    kind = panel(FLOOR, switches="1234", resets=False)
    family.add("near", "the first two", panel(FLOOR, switches="12"), budget=6_000)
    family.add("near", "the last two", last, budget=8_000)
    family.add("far", "wrong presses are free", kind, budget=12_000)

    rules: dict[str, Any] = {"slip": 0.2, "wrong": -0.02}
    family.target("three, slips", panel(FLOOR, switches="123", **rules), 20_000)
    one = grid(FLOOR, rewards={"1": 1.0}, starts="S", ends="1", slip=0.2, discount=0.98)

    def to_the_first(state: Any, action: Any) -> Any:
        row = np.where((state["pressed"] == 0) & (action["move"] < 4), state["row"], -9)
        return {"row": row, "column": state["column"]}, {"move": np.minimum(action["move"], 3)}

    sure = panel(FLOOR, switches="123")
    family.add("near", "three, no slips", sure, budget=5_000)
    family.add("far", "three, on the way to the first", one, to_the_first, budget=1_500)
    return family
