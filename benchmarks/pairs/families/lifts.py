"""Fresh: a lift that never rests; people call it on four floors and want to go down."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import task_of

ROOM = 2


def lift(
    floors: int, calls: float, *, delivered: float = 5.0, carried: float = -0.1
) -> cr.FiniteMDP:
    """Return a lift that holds two; a floor without a call gets one with this probability.

    Rewards are for each person delivered and each person carried a step; a call costs .2 a step.
    """

    def outcomes(point: Any, action: int) -> Any:
        at, load, *waiting = point
        reward = carried * load - 0.2 * sum(waiting)
        if action == 2 and at == 0:
            reward, load = reward + delivered * load, 0
        elif action == 2 and waiting[at - 1] and load < ROOM:
            load, waiting[at - 1] = load + 1, 0
        elif action < 2:
            at = min(max(at + (1 if action == 0 else -1), 0), floors)
        found = [(1.0, (at, load), reward)]
        for called in waiting:
            chances = [(1.0, 1)] if called else [(calls, 1), (1 - calls, 0)]
            found = [(p * q, (*to, new), r) for p, to, r in found for q, new in chances]
        return found

    return task_of(
        [tuple(point) for point in np.ndindex(floors + 1, ROOM + 1, *[2] * floors)],
        ("floor", "load", *(f"call_{k}" for k in range(1, floors + 1))),
        cr.Component("move", 3, labels=("up", "down", "open")), outcomes,
        starts=lambda point: not any(point), discount=0.95, time_limit=100,
    )  # fmt: skip


def lifts() -> Family:
    """Return a lift of four floors above the ground, 40,000 steps."""
    family = Family("lifts", "fresh")
    family.target("four floors", lift(4, 0.08), 40_000)

    def halved(state: Any, action: Any) -> Any:
        low, high = (state[f"call_{k}"] | state[f"call_{k + 1}"] for k in (1, 3))
        small = {"floor": (state["floor"] + 1) // 2, "load": state["load"]}
        return {**small, "call_1": low, "call_2": high}, action

    def swapped(state: Any, action: Any) -> Any:
        return state, {"move": np.array([1, 0, 2])[action["move"]]}

    quiet, small = lift(4, 0.03), lift(2, 0.16)
    pleasure = lift(4, 0.08, delivered=0.0, carried=1.0)
    family.add("near", "fewer calls", quiet, budget=10_000)
    family.add("far", "two floors, one for two", small, halved, budget=4_000)
    family.add("wrong goal", "paid for the ride", pleasure, budget=10_000)
    family.add("mirrored", "up for down", quiet, swapped, budget=10_000)
    family.spoil("fewer calls")
    return family
