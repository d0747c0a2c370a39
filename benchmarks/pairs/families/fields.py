"""Blind: a farmer's field through the seasons, and a forest on fire."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import at_first, explored

YEAR, FROST = 8, (6, 7)
"""Weeks, or so, of a year, and those in which what stands freezes."""
RICH, RIPE = 4, 3
WHEAT, BEANS = 1, 2


def farm(
    *, growth: float = 0.75, year: int = YEAR, tires: int = 2, crops: int = 2, sow: float = -1.0
) -> cr.FiniteMDP:
    """Return a field: wheat pays by the soil and tires it, beans pay less and feed it.

    A crop ripens by a step with probability `growth`, but freezes in winter. With one crop there
    are no beans.
    """

    def outcomes(point: Any, action: int) -> Any:
        season, soil, crop, ripe = point
        after = (season + 1) % year
        if action in (1, 2) and not crop:
            sown = WHEAT if action == 1 or crops == 1 else BEANS
            return [(1.0, (after, soil, sown, 0), sow)]
        if action == 3 and crop:
            paid = (ripe / RIPE) ** 2 * (2.0 + 2.0 * soil if crop == WHEAT else 4.0)
            change = -tires if crop == WHEAT else 1 * (ripe == RIPE)
            return [(1.0, (after, min(max(soil + change, 0), RICH), 0, 0), paid)]
        if not crop:
            rested = min(soil + 1, RICH)
            return [(0.4, (after, rested, 0, 0), 0.0), (0.6, (after, soil, 0, 0), 0.0)]
        if season in FROST:
            return [(0.7, (after, soil, 0, 0), 0.0), (0.3, (after, soil, crop, ripe), 0.0)]
        grown = min(ripe + 1, RIPE)
        ways = (growth, grown), (1 - growth, ripe)
        return [(p, (after, soil, crop, size), 0.0) for p, size in ways]

    return explored(
        [(season, 2, 0, 0) for season in range(year)],
        ("season", "soil", "crop", "ripe"),
        cr.Component("work", 4, labels=("wait", "wheat", "beans", "harvest")), outcomes,
        discount=0.95, time_limit=120,
    )  # fmt: skip


def crops() -> Family:
    """Return the field, 25,000 steps."""
    family = Family("crops", "blind")
    family.target("field", farm(), 25_000)

    family.add("near", "sure growth", farm(growth=1.0), budget=5_000)
    family.add("far", "always summer", farm(year=1), at_first("season"), budget=1_500)
    family.add("near", "wheat alone", farm(crops=1), budget=4_000)
    return family


GREEN, BURNING, BURNT = range(3)


def forest(
    rows: int, columns: int, *, spread: float = 0.15, hose: float = 0.7, fuel: float = 0.2,
    wind: float = 1.5,
) -> cr.FiniteMDP:  # fmt: skip
    """Return a forest that burns from its first cell, until nothing burns any more.

    Each burning cell costs 1 a step, lights each cell beside it with probability `spread` (`wind`
    times that to the east), and burns down with probability `fuel`, for -5. The hose puts a cell
    out with probability `hose`, and keeps a green one from being lit.
    """
    n = rows * columns
    cells = [divmod(k, columns) for k in range(n)]

    def lit(point: Any, k: int) -> float:
        row, column = cells[k]
        spared = 1.0
        for other, (i, j) in enumerate(cells):
            if point[other] == BURNING and abs(row - i) + abs(column - j) == 1:
                spared *= 1 - spread * (wind if column > j else 1.0)
        return 1 - spared

    def changes(point: Any, k: int, wet: bool) -> list[tuple[float, int, float]]:
        if point[k] == BURNING:
            out = hose if wet else 0.0
            down = (1 - out) * fuel
            return [(out, GREEN, -1.0), (down, BURNT, -6.0), (1 - out - down, BURNING, -1.0)]
        chance = lit(point, k) if point[k] == GREEN and not wet else 0.0
        return [(chance, BURNING, 0.0), (1 - chance, point[k], 0.0)]

    def outcomes(point: Any, action: int) -> Any:
        found: list[Any] = [(1.0, (), 0.0)]
        for k in range(n):
            found = [
                (p * q, (*to, new), r + more)
                for p, to, r in found
                for q, new, more in changes(point, k, k == action) if q > 0
            ]  # fmt: skip
        return found

    return explored(
        [tuple(BURNING if k == first else GREEN for k in range(n)) for first in (0, n - columns)],
        tuple(f"cell_{k + 1}" for k in range(n)), cr.Component("hose", n), outcomes,
        ends=lambda point: BURNING not in point, discount=0.97, time_limit=60,
    )  # fmt: skip


def part(first: int) -> Any:
    """Return how a forest of 2x3 cells reads one of 2x2, from this column."""
    cells = np.array([first, first + 1, first + 3, first + 4])

    def read(state: Any, action: Any) -> Any:
        number = np.full(6, -1)
        number[cells] = range(4)
        small = {f"cell_{k + 1}": state[f"cell_{cell + 1}"] for k, cell in enumerate(cells)}
        return small, {"hose": number[action["hose"]]}

    return read


def fires() -> Family:
    """Return a forest of 2x3 cells (40,000 steps), and one in a drought (20,000)."""
    family = Family("fires", "blind")
    family.target("forest", forest(2, 3), 40_000)
    small, damp = forest(2, 2), forest(2, 3, spread=0.08)
    least: dict[str, Any] = {"aggregate": cr.minimum}
    family.add("near", "a damp forest", damp, budget=8_000)
    family.add("far", "four cells, either side", small, part(0), part(1), budget=3_000, **least)
    family.target("drought", forest(2, 3, spread=0.3, fuel=0.3), 20_000)
    sure = forest(2, 3, spread=0.3, fuel=0.3, hose=1.0, wind=1.0)
    family.add("near", "drought, no wind, a sure hose", sure, budget=5_000)
    family.add("far", "drought, a damp forest", damp, budget=5_000)
    return family
