"""Blind: slides over ice from wall to wall, and a sailor on a lake whose wind turns."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import MOVES, cells_of, explored, grid, redrawn

RINK = [
    "..#..#.#...",
    "...........",
    "...#.#.#...",
    ".#.........",
    "..#..#...#.",
    "..........#",
    "...S.......",
    "#...#..#...",
    "...#.......",
    "....G....#.",
    ".........##",
]
THIN = [
    ".......#..#.",
    "....#...S...",
    ".....#......",
    "#..........#",
    "..........#.",
    "#..O.......O",
    "#...#.......",
    ".#..#....#..",
    ".O.#........",
    "....###.....",
    "....G...O..#",
    ".#...O.#..##",
]


def rink(
    lines: list[str], *, goal: float, step: float = 0.0, grip: float = 0.0, starts: str = "S",
    first_row: int = 0,
) -> cr.FiniteMDP:  # fmt: skip
    """Return ice on which a move ends before a rock, at the goal, or in a hole.

    With probability `grip` a move ends after one cell. Rows are numbered from `first_row`.
    """
    cells = cells_of(lines, (first_row, 0))
    moves = list(MOVES.values())

    def passed(cell: Any, move: Any) -> list[Any]:
        way = [cell]
        while len(way) == 1 or cells[way[-1]] not in "GO":
            after = way[-1][0] + move[0], way[-1][1] + move[1]
            if after not in cells:
                break
            way.append(after)
        return way

    def outcomes(point: Any, action: int) -> Any:
        way = passed(point, moves[action])
        reached = (1 - grip, way[-1]), (grip, way[min(1, len(way) - 1)])
        return [(p, to, step + (goal if cells[to] == "G" else 0.0)) for p, to in reached]

    return explored(
        [cell for cell, character in cells.items() if character in starts],
        ("row", "column"), cr.Component("move", 4, labels=tuple(MOVES)), outcomes,
        ends=lambda point: cells[point] in "GO", discount=0.9, time_limit=60,
    )  # fmt: skip


def slides() -> Family:
    """Return sure ice (6,000 steps), and rough ice with holes at -.1 a move (15,000)."""
    family = Family("slides", "blind")
    family.target("sure", rink(RINK, goal=1.0), 6_000)
    anywhere, half = rink(RINK, goal=1.0, starts="S."), rink(RINK[5:], goal=1.0, first_row=5)
    on_foot = grid(RINK, rewards={"G": 1.0}, starts="S.", discount=0.9)
    family.add("near", "from everywhere", anywhere, budget=1_000)
    family.add("far", "the goal's half", half, budget=500)
    family.add("far", "on foot", on_foot, budget=1_500)

    rough: dict[str, Any] = {"goal": 2.0, "step": -0.1}
    family.target("rough", rink(THIN, grip=0.2, **rough), 15_000)
    nearer = redrawn(THIN, {(1, 8): ".", (7, 6): "S"})
    dry = rink([line.replace("O", ".") for line in THIN], grip=0.2, **rough)
    family.add("near", "a nearer start", rink(nearer, grip=0.2, **rough), budget=2_000)
    family.add("near", "sure slides", rink(THIN, **rough), budget=1_500)
    family.add("far", "no holes", dry, budget=2_000)
    return family


LAKE = [
    "S.......",
    "........",
    "..##....",
    "..##....",
    ".....#..",
    ".....#..",
    ".#......",
    ".......G",
]
COURSES = {
    "north": (-1, 0), "north-east": (-1, 1), "east": (0, 1), "south-east": (1, 1),
    "south": (1, 0), "south-west": (1, -1), "west": (0, -1), "north-west": (-1, -1),
}  # fmt: skip
COSTS = (1.0, 1.5, 2.5, 4.0, 4.0)
"""Of a course by its angle to where the wind blows, in eighths of a turn; none goes against it."""


def sailed(
    lines: list[str], *, turns: float = 0.3, starts: str = "S", origin: int = 0
) -> cr.FiniteMDP:
    """Return a lake with islands and a wind that turns either way with probability `turns`."""
    cells = cells_of(lines, (origin, origin))
    courses = list(COURSES.values())

    def outcomes(point: Any, action: int) -> Any:
        *cell, wind = point
        angle = min((action - wind) % 8, (wind - action) % 8)
        after = cell[0] + courses[action][0], cell[1] + courses[action][1]
        if angle == 4 or after not in cells:
            after = cell[0], cell[1]
        ways = (1 - 2 * turns, 0), (turns, 1), (turns, -1)
        return [(p, (*after, (wind + turn) % 8), -COSTS[angle]) for p, turn in ways]

    return explored(
        [(*cell, wind) for cell, c in cells.items() if c in starts for wind in range(8)],
        ("row", "column", "wind"), cr.Component("course", 8, labels=tuple(COURSES)), outcomes,
        ends=lambda point: cells[point[:2]] == "G", discount=0.99, time_limit=150,
    )  # fmt: skip


def still(lines: list[str]) -> cr.FiniteMDP:
    """Return the lake under a motor, which needs no wind: every course costs the same."""
    cells = cells_of(lines)
    courses = list(COURSES.values())

    def outcomes(point: Any, action: int) -> Any:
        after = point[0] + courses[action][0], point[1] + courses[action][1]
        return [(1.0, after if after in cells else point, -float(np.mean(COSTS)))]

    return explored(
        [cell for cell, character in cells.items() if character != "G"],
        ("row", "column"), cr.Component("course", 8, labels=tuple(COURSES)), outcomes,
        ends=lambda point: cells[point] == "G", discount=0.99, time_limit=150,
    )  # fmt: skip


def bay_below(corner: int) -> Any:
    """Return how cells read the bay from this row and column on: those before it, its edge."""

    def read(state: Any, action: Any) -> Any:
        return {
            "row": np.maximum(state["row"], corner),
            "column": np.maximum(state["column"], corner),
            "wind": state["wind"],
        }, action

    return read


def sails() -> Family:
    """Return the lake, 60,000 steps."""
    family = Family("sails", "blind")
    lake = family.target("lake", sailed(LAKE), 60_000)
    bay = sailed([line[4:] for line in LAKE[4:]], starts=".", origin=4)
    steady, motor = sailed(LAKE, turns=0.0, starts="S."), still(LAKE)
    family.add("near", "the goal's bay", bay, budget=8_000)
    family.add("far", "the bay for all", bay, bay_below(4), budget=8_000)
    family.add("near", "a steady wind", steady, budget=12_000)
    family.add("far", "under a motor", motor, cr.project(lake, motor), budget=4_000)
    return family
