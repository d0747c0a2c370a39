"""Verification: Taxi-v4, from one destination, from fetching alone and from its errands."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import at_first

PLACES = ((0, 0), (0, 4), (4, 0), (4, 3))
RIDING, PICK_UP, DROP_OFF = 4, 4, 5


def changed(
    taxi: cr.FiniteMDP, keep: Any, reward: Any = lambda s, a, to, r: r, end: Any = None,
    start: Any = None,
) -> cr.FiniteMDP:  # fmt: skip
    """Return the taxi restricted to some states, with other rewards, starts and further ends.

    `keep`, `end`, `start` : (S,) bool; what leads outside stays where it is, at -10.
    """
    ends = taxi.terminal | (np.zeros(taxi.states.size, bool) if end is None else end)
    kept = np.flatnonzero(keep)
    number = np.cumsum(keep) - 1
    outcomes: list[list[list[tuple[float, int, float]]]] = []
    for s in kept.tolist():
        rows = []
        for a in range(taxi.actions.size):
            row = taxi.outcome_row[s, a]
            to, r = int(taxi.next_state[row, 0]), float(taxi.reward[row, 0])
            inside = bool(keep[to])
            rows.append([(1.0, int(number[to if inside else s]),
                          float(reward(s, a, to, r)) if inside else -10.0)])  # fmt: skip
        outcomes.append(rows)
    start = np.where(ends, 0.0, taxi.start if start is None else start)[kept]
    points = np.stack(list(taxi.states.decode().values()), axis=1)[kept]
    return cr.FiniteMDP.from_outcomes(
        outcomes, terminal=ends[kept], start=start / start.sum(), discount=taxi.discount,
        time_limit=taxi.time_limit, states=cr.Space(taxi.states.components, points),
        actions=taxi.actions,
    )  # fmt: skip


def taxis() -> Family:
    """Return Taxi-v4, 100,000 steps."""
    family = Family("taxi", "verification")
    taxi = family.target(
        "Taxi-v4", cr.from_gymnasium("Taxi-v4", discount=0.99, time_limit=200), 100_000
    )
    state = taxi.states.decode()
    riding = state["passenger"] == RIDING
    one = changed(taxi, state["destination"] == 0)
    two = changed(taxi, (state["destination"] < 2) & ((state["passenger"] < 2) | riding))
    # Fetching ends when the passenger is in the taxi, which is paid like a drop-off.
    everything = np.ones(taxi.states.size, bool)
    fetch = changed(
        taxi, everything, end=riding,
        reward=lambda s, a, to, r: 20.0 if riding[to] and not riding[s] else r,
    )  # fmt: skip
    # The ride alone: it starts with the passenger in the taxi.
    ride = changed(taxi, everything, start=riding)
    lost = changed(taxi, everything, reward=lambda s, a, to, r: -r if a >= PICK_UP else r)

    def next_place(state: Any, action: Any) -> Any:
        return {**state, "destination": (state["destination"] + 1) % 4}, action

    def turned(state: Any, action: Any) -> Any:
        return {**state, "row": 4 - state["row"], "column": 4 - state["column"]}, action

    other, same_way = changed(taxi, everything), at_first("destination")
    family.add("near", "two places", two, cr.project(taxi, two), budget=20_000)
    family.add("near", "fetching alone", fetch, budget=20_000)
    family.add("far", "one destination", one, cr.project(taxi, one), budget=15_000)
    family.add("far", "the ride alone", ride, budget=20_000)
    family.add("wrong goal", "every destination as one", one, same_way, budget=15_000)
    family.add("wrong goal", "the next destination", other, next_place, budget=20_000)
    family.add("mirrored", "turned round", other, turned, budget=20_000)
    family.add("useless", "paid for illegal stops", lost, budget=15_000)
    family.spoil("fetching alone")
    return family
