"""A corridor for a cart with a battery, and a mapping from it to one without."""

import numpy as np

import curricle as cr

SLIP = 0.1  # probability that a move fails


def corridor(places, full, chargers=()):
    """Return the corridor: a step costs 1 and one of `full` units; an empty battery costs 100."""
    cells = [(p, b) for p in range(places) for b in range(full + 1)]
    number = {cell: i for i, cell in enumerate(cells)}
    over = [p == places - 1 or (full > 0 and b == 0) for p, b in cells]

    def enter(p, b):  # -> next state, reward
        p = min(max(p, 0), places - 1)
        stranded = full > 0 and b == 0 and p < places - 1
        return number[p, b], -1 - 100 * stranded

    def moves(p, b):  # left, right, charge: (probability, state, reward)
        left = b - (full > 0)
        return [
            [(1 - SLIP, *enter(p - 1, left)), (SLIP, *enter(p, left))],
            [(1 - SLIP, *enter(p + 1, left)), (SLIP, *enter(p, left))],
            [(1.0, *enter(p, full if p in chargers else left))],
        ]

    states = [cr.Component("place", places)]
    states += [cr.Component("battery", full + 1)] * (full > 0)
    return cr.FiniteMDP.from_outcomes(
        [[[]] * 3 if end else moves(*cell) for cell, end in zip(cells, over, strict=True)],
        terminal=over,
        start=number[0, full],
        discount=0.99,
        time_limit=200,
        states=cr.Space(states),
        actions=cr.Space([cr.Component("move", 3, labels=("left", "right", "charge"))]),
    )


def cautious(state, action):
    """Return the same place, or the beginning where the battery does not reach the next stop."""
    place, battery = state["place"], state["battery"]
    stops = np.array([6, 12, 18, 24])
    distance = stops[np.searchsorted(stops, place)] - place
    return {"place": np.where(distance > battery, 0, place)}, action
