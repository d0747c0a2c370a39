"""Fresh: the racetrack of Barto, Bradtke and Singh (1995): take the bend and do not crash."""

from typing import Any

import curricle as cr

from ..pair import Family
from ..worlds import task_of

TRACK = [
    "####....G",
    "###.....G",
    "##......G",
    "##......G",
    "##....###",
    "##....###",
    "##....###",
    "##....###",
    "##....###",
    "##....###",
    "#.....###",
    "#SSS..###",
]
CHANGES = [(up, right) for up in (-1, 0, 1) for right in (-1, 0, 1)]


def race(lines: list[str], *, fastest: int = 2, slip: float = 0.1) -> cr.FiniteMDP:
    """Return a track: -1 a step; who leaves it begins again at the start with speed 0.

    With probability `slip` the speed does not change.
    """
    cells = {(i, j): c for i, line in enumerate(lines) for j, c in enumerate(line) if c != "#"}
    home = [cell for cell, c in cells.items() if c == "S"]
    speeds = range(fastest + 1)

    def driven(row: int, column: int, up: int, right: int) -> tuple[int, int] | None:
        parts = max(up, right)
        for k in range(1, parts + 1):
            cell = row - round(up * k / parts), column + round(right * k / parts)
            if cell not in cells:
                return None
            if cells[cell] == "G":
                return cell
        return cell if parts else (row, column)

    def outcomes(point: Any, action: int) -> Any:
        row, column, *speed = point
        found: list[Any] = []
        for chance, change in ((1 - slip, CHANGES[action]), (slip, (0, 0))):
            up, right = (min(max(v + dv, 0), fastest) for v, dv in zip(speed, change, strict=True))
            cell = driven(row, column, up, right)
            if chance and cell is None:
                found += [(chance / len(home), (*start, 0, 0), -1.0) for start in home]
            elif chance:
                found.append((chance, (*cell, up, right), -1.0))  # type: ignore[misc]
        return found

    return task_of(
        [(*cell, up, right) for cell in cells for up in speeds for right in speeds],
        ("row", "column", "up", "right"), cr.Component("change", 9), outcomes,
        ends=lambda point: cells[point[:2]] == "G",
        starts=lambda point: point in [(*cell, 0, 0) for cell in home],
        discount=0.99, time_limit=100,
    )  # fmt: skip


def races() -> Family:
    """Return the racetrack, 100,000 steps."""
    family = Family("races", "fresh")
    family.target("track", race(TRACK), 100_000)

    def slower(state: Any, action: Any) -> Any:
        return {**state, **{v: state[v].clip(max=1) for v in ("up", "right")}}, action

    sure, slow = race(TRACK, slip=0.0), race(TRACK, fastest=1)
    # The bend alone begins in the row below it.
    bend = race([*TRACK[:6], "##SSSS###"])
    family.add("near", "without slips", sure, budget=20_000)
    family.add("near", "the bend", bend, budget=10_000)
    family.add("far", "at half the speed", slow, slower, budget=15_000)
    family.add("mirrored", "brakes for gas", sure, budget=20_000, turned=True)
    family.spoil("the bend")
    return family
