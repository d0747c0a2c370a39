"""Taxi from an errand, and from taxis with fewer places.

A taxi has two errands: to fetch a passenger and to take the passenger to a place. One errand is a
task of 100 states and 5 actions (the taxi has 500 and 6): drive to a place and stop there. Its
values are read for the place where the passenger waits and for the destination. A taxi with two or
three of the four places is mapped by name, and the other states are unmapped.

Measured over 20 seeds, with the source's steps charged, steps until greedy episodes return 0 (the
optimum is 7.9): 114,000 from scratch, about 103,000 from the smaller taxis. From the unchanged
errand 7 seeds do not get there in 128,000. Its greedy policy is good at first, but the values of
fetching are too high, as they leave out the cost of the ride, and learning corrects one after the
other. Shifted by the cost of a ride they lead there in 16,400. All arms have the portfolio, the
default; without it no seed gets there from the unchanged errand, and the others need 900 to 15,000
steps less.

The optimistic learner gets there in 24,500 steps without a source. Over it even the shifted errand,
which is there sooner, costs more mean return than it brings: -23, as its source's steps are charged
with the random policy's return.

python examples/taxi.py
"""

import gymnasium as gym
import numpy as np

import curricle as cr

PLACES = {"red": (0, 0), "green": (0, 4), "yellow": (4, 0), "blue": (4, 3)}
STOP = 4
RIDE = 10.0
"""The cost of the longest ride; values that are too low do less harm than values too high."""
DISCOUNT = 0.99
LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
THOROUGH = cr.QLearning(learning_rate=1.0, epsilon=0.5)  # the task is deterministic


def errand(table):
    """Return the task of driving to a place and stopping there, in the grid of Taxi."""
    cells = [(row, column) for row in range(5) for column in range(5)]
    goals = list(PLACES.values())
    home = 4 * len(cells)  # where every errand ends

    def outcome(state, action):
        cell, place = divmod(state, 4)
        if action != STOP:
            # Taxi numbers its states by cell first, 20 to a cell.
            (_, after, _, _) = table[20 * cell][action][0]
            return [(1.0, 4 * (after // 20) + place, -1.0)]
        arrived = cells[cell] == goals[place]
        return [(1.0, home, 20.0) if arrived else (1.0, state, -10.0)]

    points = [(*cell, place) for cell in cells for place in range(4)]
    sides = [cr.Component("row", 6), cr.Component("column", 5)]
    moves = ("south", "north", "east", "west", "stop")
    return cr.FiniteMDP.from_outcomes(
        [*([outcome(s, a) for a in range(5)] for s in range(home)), [[]] * 5],
        terminal=np.arange(home + 1) == home,
        start=np.append(np.full(home, 1 / home), 0.0),
        discount=DISCOUNT,
        time_limit=200,
        states=cr.Space(
            [*sides, cr.Component("place", 4, labels=tuple(PLACES))], [*points, (5, 0, 0)]
        ),
        actions=cr.Space([cr.Component("move", 5, labels=moves)]),
    )


def taxi_with(places, taxi):
    """Return the taxi with some of the places, and the states in which no other occurs."""
    space = taxi.states.decode()
    labels = {name: taxi.states.component(name).labels for name in ("passenger", "destination")}
    ids = [i for i, label in enumerate(labels["passenger"]) if label in (*places, "taxi")]
    kept = np.isin(space["passenger"], ids) & np.isin(space["destination"], ids)
    number = np.cumsum(kept) - 1
    states = np.flatnonzero(kept)
    after = taxi.next_state[taxi.outcome_row[states], 0]
    # A drop-off at a place left out is punished like one anywhere else.
    wrong = ~kept[after]
    after = np.where(wrong, states[:, None], after)
    reward = np.where(wrong, -10.0, taxi.reward[taxi.outcome_row[states], 0])

    sides = [taxi.states.component(name) for name in ("row", "column")]
    parts = [
        cr.Component(name, len(some), labels=tuple(some))
        for name, some in (("passenger", (*places, "taxi")), ("destination", places))
    ]
    return cr.FiniteMDP.from_outcomes(
        [
            [[(1.0, int(number[s]), float(r))] for s, r in zip(*pairs, strict=True)]
            for pairs in zip(after, reward, strict=True)
        ],
        terminal=taxi.terminal[states],
        start=taxi.start[states] / taxi.start[states].sum(),
        discount=DISCOUNT,
        time_limit=200,
        states=cr.Space([*sides, *parts]),
        actions=taxi.actions,
    )


def errand_mapping(taxi, source, *, waiting=True, riding=True):
    """Return the mapping to an errand where the passenger waits, or rides, or both."""

    def to_errand(state, action):
        rides = state["passenger"] == 4
        read = (rides & riding) | (~rides & waiting)
        place = np.where(rides, state["destination"], state["passenger"])
        # Stopping is dropping off a passenger who rides and picking up one who waits.
        stop = np.where(rides, 5, 4)
        move = np.where(action["move"] < 4, action["move"], STOP)
        wrong = (action["move"] >= 4) & (action["move"] != stop)
        cell = {"row": state["row"], "column": state["column"]}
        return {**cell, "place": np.where(read, place, -1)}, {"move": np.where(wrong, -1, move)}

    return cr.from_function(taxi, source, to_errand)


def main(seeds=20, steps=120_000, source_steps=8_000):
    taxi = cr.from_gymnasium("Taxi-v4", discount=DISCOUNT)
    drive = errand(gym.make("Taxi-v4").unwrapped.P)

    def curriculum(source, *transfers):
        return cr.Curriculum(
            tasks={"source": source, "taxi": taxi},
            transfers=[cr.Transfer("source", "taxi", f, shift=shift) for f, shift in transfers],
            aggregate=cr.total,  # each transfer maps a part of the taxi of its own
            learner={"source": THOROUGH, "taxi": LEARNER},
            # Exactly as long in each arm, which then differ in what is mapped alone.
            budget={"source": cr.StoppingRule(source_steps), "taxi": steps},
            evaluation=cr.GreedyEvaluation(discounted=False),
        )

    fetching = errand_mapping(taxi, drive, riding=False)
    taking = errand_mapping(taxi, drive, waiting=False)
    arms = {
        "errand": curriculum(drive, (errand_mapping(taxi, drive), 0.0)),
        "errand, less a ride": curriculum(drive, (fetching, -RIDE), (taking, 0.0)),
    }
    for some in (("red", "green"), ("red", "green", "yellow")):
        fewer = taxi_with(some, taxi)
        arms[f"{len(some)} places"] = curriculum(fewer, (cr.project(taxi, fewer), 0.0))
    print(cr.compare(arms, seeds=seeds, threshold=0.0))


if __name__ == "__main__":
    main()
