"""Fresh: the mountain car (Moore 1990) on a grid of places and speeds, drawn between points."""

from itertools import product
from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import task_of

PLACES, SPEEDS = np.linspace(-1.2, 0.5, 24), np.linspace(-0.07, 0.07, 17)
HELD = 5
"""Steps of Moore's car that an action is held for, so that it leaves a grid point's neighbours."""


def hill(*, engine: float = 0.001, gravity: float = 0.0025, left: bool = False) -> cr.FiniteMDP:
    """Return the car in its valley: -1 a step until it is on the right hill, or on the left."""

    def driven(point: Any, action: int) -> tuple[float, float]:
        place, speed = PLACES[point[0]], SPEEDS[point[1]]
        for _ in range(HELD):
            speed += engine * (action - 1) - gravity * np.cos(3 * place)
            speed = np.clip(speed, SPEEDS[0], SPEEDS[-1])
            place = np.clip(place + speed, PLACES[0], PLACES[-1])
            if place == PLACES[0]:
                speed = max(speed, 0.0)
        return place, speed

    def beside(grid: Any, value: float) -> list[tuple[float, int]]:
        at = (value - grid[0]) / (grid[1] - grid[0])
        low = min(int(at), len(grid) - 2)
        chances = (1 - (at - low), low), (at - low, low + 1)
        return [(float(p), i) for p, i in chances if p > 1e-9]

    def outcomes(point: Any, action: int) -> Any:
        place, speed = driven(point, action)
        ways = product(beside(PLACES, place), beside(SPEEDS, speed))
        return [(p * q, (i, j), -1.0) for (p, i), (q, j) in ways]

    top = 0 if left else len(PLACES) - 1
    return task_of(
        [tuple(point) for point in np.ndindex(len(PLACES), len(SPEEDS))],
        ("place", "speed"), cr.Component("push", 3, labels=("left", "none", "right")), outcomes,
        ends=lambda point: point[0] == top,
        starts=lambda point: -0.6 <= PLACES[point[0]] <= -0.4 and point[1] == len(SPEEDS) // 2,
        discount=0.99, time_limit=100,
    )  # fmt: skip


def hills() -> Family:
    """Return the car, 40,000 steps."""
    family = Family("hills", "fresh")
    family.target("car", hill(), 40_000)
    strong, flat, other = hill(engine=0.0015), hill(gravity=0.00125), hill(left=True)
    family.add("near", "a stronger engine", strong, budget=10_000)
    family.add("far", "a flatter valley", flat, budget=10_000)
    family.add("wrong goal", "the other hill", other, budget=10_000)
    family.add("mirrored", "left for right", strong, budget=10_000, turned=True)
    family.spoil("a stronger engine")
    return family
