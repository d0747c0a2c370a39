"""Verification: RiverSwim, chains and DeepSea; the target is a longer line or a deeper sea."""

from typing import Any

import curricle as cr

from ..pair import Family
from ..worlds import by_cell, by_value, task_of

LEFT_RIGHT = cr.Component("move", 2, labels=("left", "right"))


def river(
    n: int, *, first: int = 0, bank: float = 0.005, sea: float = 1.0, anywhere: bool = True
) -> cr.FiniteMDP:
    """Return RiverSwim (Strehl & Littman 2008) with n states, numbered from `first`.

    Sources start anywhere, ten times as often; the target starts on the bank.
    """
    last = first + n - 1

    def outcomes(point: Any, action: int) -> Any:
        (at,) = point
        if action == 0:
            return [(1.0, (max(at - 1, first),), bank if at == first else 0.0)]
        if at == first:
            return [(0.6, (at + 1,), 0.0), (0.4, (at,), 0.0)]
        if at == last:
            return [(0.6, (at,), sea), (0.4, (at - 1,), sea)]
        return [(0.35, (at + 1,), 0.0), (0.6, (at,), 0.0), (0.05, (at - 1,), 0.0)]

    return task_of(
        [(at,) for at in range(first, last + 1)],
        ("place",), LEFT_RIGHT, outcomes,
        starts=lambda point: anywhere or point[0] == first,
        discount=0.99, time_limit=20 if anywhere else 200,
    )  # fmt: skip


def rivers() -> Family:
    """Return RiverSwim with 20 and 12 states, 60,000 and 40,000 steps."""
    family = Family("river-swim", "verification")
    family.target("20 states", river(20, anywhere=False), 60_000)
    small, middle = river(6), river(10)
    late = river(6, first=14, bank=0.0)
    home = river(20, sea=0.0, bank=1.0)
    shrunk, mirrored = by_value(lambda x: x * 6 // 20), by_value(lambda x: (19 - x) * 6 // 20)
    halved, dull = by_value(lambda x: x // 2), river(6, sea=0.0)
    family.add("near", "20 from 6", small, shrunk, budget=10_000)
    family.add("near", "20 from 10", middle, halved, budget=20_000)
    family.add("far", "20 from the last 6", late, budget=10_000)
    family.add("far", "20 from the first 6", small, budget=10_000)
    family.add("wrong goal", "20 paid at home", home, budget=10_000)
    family.add("mirrored", "20 mirrored", small, mirrored, budget=10_000)
    family.add("useless", "20 from a dry river", dull, shrunk, budget=5_000)
    family.spoil("20 from 6")
    family.target("12 states", river(12, anywhere=False), 40_000)
    family.add("near", "12 from 6", small, halved, budget=10_000)
    return family


def chain(
    n: int,
    *,
    slip: float = 0.1,
    near_end: float = 0.02,
    far_end: float = 1.0,
    anywhere: bool = True,
) -> cr.FiniteMDP:
    """Return a chain: a little to the left of the start, much at the right end.

    Sources start anywhere, the target at place 2.
    """

    def outcomes(point: Any, action: int) -> Any:
        found = []
        for chance, way in ((1 - slip, action), (slip, 1 - action)):
            to = point[0] + (1 if way == 1 else -1)
            reward = far_end if to == n else near_end if to == -1 else 0.0
            if chance:
                found.append((chance, (to,), reward))
        return found

    return task_of(
        [(at,) for at in range(-1, n + 1)],
        ("place",), LEFT_RIGHT, outcomes,
        ends=lambda point: point[0] in (-1, n), starts=lambda point: anywhere or point[0] == 2,
        discount=0.98, time_limit=150,
    )  # fmt: skip


def chains() -> Family:
    """Return chains of 30 and 18 places, 40,000 and 20,000 steps."""
    family = Family("chain", "verification")
    family.target("30 places", chain(30, anywhere=False), 40_000)
    short, middle = chain(8), chain(15)
    left, sure = chain(30, near_end=1.0, far_end=0.0), chain(15, slip=0.0)
    even, halved = chain(15, near_end=1.0), by_value(lambda x: x // 2)
    family.add("near", "30 from 8", short, by_value(lambda x: (x * 8) // 30), budget=5_000)
    family.add("near", "30 from 15", middle, halved, budget=10_000)
    family.add("far", "30 from the first 8", short, budget=5_000)
    family.add("far", "30 from 15 without slips", sure, halved, budget=10_000)
    family.add("wrong goal", "30 paid on the left", left, budget=8_000)
    family.add("mirrored", "30 from 15, moves reversed", middle, halved, budget=10_000, turned=True)
    family.add("useless", "30 from 15, both ends pay", even, halved, budget=10_000)
    family.spoil("30 from 8")
    family.target("18 places", chain(18, anywhere=False), 20_000)
    family.add("near", "18 from 8", short, by_value(lambda x: (x * 8) // 18), budget=5_000)
    return family


def sea(
    n: int, *, origin: int = 0, cost: float = 0.01, treasure: float = 1.0, anywhere: bool = True
) -> cr.FiniteMDP:
    """Return DeepSea (Osband et al. 2019): n rows down; only going right all the time pays.

    Rows and columns are numbered from `origin`. In the last row the dive ends. Sources start
    anywhere, the target at the top left.
    """
    end = (origin + n, origin)

    def outcomes(point: Any, action: int) -> Any:
        row, column = point
        found = treasure if action == 1 and (row, column) == (end[0] - 1,) * 2 else 0.0
        side = min(column + 1, end[0] - 1) if action == 1 else max(column - 1, origin)
        to = end if row == end[0] - 1 else (row + 1, side)
        return [(1.0, to, found - (cost / n if action == 1 else 0.0))]

    rows = range(origin, origin + n)
    return task_of(
        [*((row, column) for row in rows for column in rows), end],
        ("row", "column"), LEFT_RIGHT, outcomes,
        ends=lambda point: point == end, starts=lambda point: anywhere or point == (origin, origin),
        discount=0.99, time_limit=n,
    )  # fmt: skip


def seas() -> Family:
    """Return DeepSea 10 deep and 8 deep, 30,000 steps each."""
    family = Family("deep-sea", "verification")
    family.target("10 deep", sea(10, anywhere=False), 30_000)
    shallow, half = sea(6), sea(5)
    late, paid = sea(6, origin=4), sea(10, treasure=0.0, cost=-0.2)
    kept = sea(10, treasure=-1.0)
    halved = by_cell(lambda r, c: (r // 2, c // 2))
    across = by_cell(lambda r, c: (c // 2, r // 2))
    family.add("near", "10 from the last 6", late, budget=6_000)
    family.add("near", "10 from 5, one for four", half, halved, budget=5_000)
    family.add("far", "10 from the first 6", shallow, budget=6_000)
    family.add("far", "10 paid on the way", paid, budget=6_000)
    family.add("wrong goal", "10 without treasure", kept, budget=6_000)
    family.add("mirrored", "10 mirrored", late, budget=6_000, turned=True)
    family.add("useless", "10 turned", half, across, budget=5_000)
    family.spoil("10 from the last 6")
    family.target("8 deep", sea(8, anywhere=False), 30_000)
    family.add("near", "8 from 4, one for four", sea(4), halved, budget=3_000)
    return family
