"""Grids of published curricula, drawn as maps, and values by shared objects."""

from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

import curricle as cr
from curricle.arrays import FloatArray

MAZES = {
    "maze": """
        ......P..T
        ..........
        .....P.PFF
        ..........
        .....F....
        .F..P.P..F
        ..........
        FFFFP.PPFF
        ..........
        S.........""",
    "line": "S........T",
    "small": "....T ..... ..... ..... S....",
    "near": ".........T " + ".......... " * 4 + "....S..... " + ".......... " * 4,
    "fire": "..T ... S.F",
    "pit": "...T .... .P.. S...",
    "pits": """
        ......P..T
        ..........
        .....P.PFF
        ..........
        .....F....
        .F..P.P..F
        ..........
        PPPPP.PPFP
        ..........
        S.........""",
    "six": "..P..T ..S... .P.PFF",
}
"""Name -> map, rows from the north. Silva and Costa 2018 have a target and goal-10-1, goal-5-5,
goal-10-10-easier, fire-1-5-5-far and pit-1-4-4; the last two are target and source of 2017."""


def maze(name: str, treasure: float = 200.0, times: int = 1) -> cr.GridWorld:
    """Return one of these tasks; a step costs 1 only where nothing else is paid.

    If the sides are `times` as long, the same objects are as many times as far apart, and an
    episode has as many times the steps, which are discounted and paid for by as much less.
    """
    free = "." * (times - 1)
    lines = ["".join(sign + free for sign in line) for line in MAZES[name].split()]
    rows = [row for line in lines for row in (line, *["." * len(line)] * (times - 1))]
    return cr.GridWorld(
        rows, rewards=cr.Rewards(step=-1.0 / times, treasure=treasure),
        combine="worst", discount=0.9 ** (1 / times), time_limit=200 * times,
    )  # fmt: skip


# -- Silva and Costa 2017: every state of the source tells, by the objects that it shares ----------

NEAR = 2  # rows and columns: how near fires and pits count
FIRST = 8  # the row of the target whose cells, and those of the next, carry the source's values


def listed(states: Any, actions: Any) -> Any:
    """Map the target's cells to the source's in order, again and again, for `shared`."""
    number = (10 * (states["row"] - FIRST) + states["column"]) % 18
    return {"row": number // 6, "column": number % 6}, actions


@cache
def in_common() -> FloatArray:
    """Return how many objects each state of the source shares with a state of the target, (T, S).

    A state of the target counts as every choice of as many near pits and fires as the source has;
    with too few of both kinds as every choice of one kind, and with too few of all by its treasure.
    """
    target, source = maze("pits"), maze("six")
    there = [around(source, cell, near=10) for cell in source.cells.tolist()]
    number = {kind: sum(name == kind for name, *_ in source.objects) for kind in ("pit", "fire")}
    weights = np.zeros((len(target.cells), len(there)))
    for state, cell in enumerate(target.cells.tolist()):
        seen = around(target, cell, near=NEAR)
        goal = {thing for thing in seen if thing[0] == "treasure"}
        pits, fires = (
            [{*chosen} for chosen in combinations([s for s in seen if s[0] == kind], number[kind])]
            for kind in ("pit", "fire")
        )
        views = [some | more for some in pits for more in fires] or [*pits, *fires] or [set()]
        for view in views:
            weights[state] += [len((view | goal) & things) for things in there]
    return weights


def around(grid: cr.GridWorld, cell: list[int], near: int) -> set[tuple[str, int, int]]:
    """Return the objects around a cell and where they are from it; a treasure is always near."""
    places = {(name, r - cell[0], c - cell[1]) for name, r, c in grid.objects}
    return {at for at in places if at[0] == "treasure" or max(map(abs, at[1:])) <= near}


def shared(values: FloatArray) -> FloatArray:
    """Return their QAverage: the mean of the source's values, weighted by shared objects.

    States that the source has not visited, where all values are 0, do not count.
    """
    learnt = values[0, 10 * FIRST : 10 * FIRST + 18]
    weights = in_common() * np.nan_to_num(learnt).any(axis=1)
    total = weights.sum(axis=1, keepdims=True)
    return weights @ np.nan_to_num(learnt) / np.maximum(total, 1)


def biased(values: FloatArray) -> FloatArray:
    """Return their QBias: the largest of these values for all actions, and 1 more for the best."""
    mean = shared(values)
    best = mean.argmax(axis=1)[:, None] == np.arange(mean.shape[1])
    return mean.max(axis=1, keepdims=True) + best
