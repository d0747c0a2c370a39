"""A task given by two functions, too large for tables: a boat steers for harbour in changing wind.

A boat on a lake of 40 x 40 cells moves by motor while a changing wind blows it off course. With 21
winds from west to east and 21 from north to south there are 700,000 states, 5 actions and up to 36
outcomes of each pair: tables would need 3.5 GB. The source is the lake without wind, where a state
is the boat's cell alone.

python examples/own_task.py
"""

import time

import numpy as np
from numba import njit

import curricle as cr

LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)


# `data` is an argument of the functions, because numba compiles global variables as constants. So
# the lake without wind (one wind) and the one with 21 winds share one compiled function.
@njit(nogil=True)
def start(data, bits):
    size, winds = data
    # Anywhere but in the harbour.
    return winds**2 + cr.tasks.integers(bits, (size**2 - 1) * winds**2)


@njit(nogil=True)
def step(data, state, action, bits):
    size, winds = data
    # State and bits are unsigned 64-bit numbers; signed ones are safer to subtract.
    rest, north = divmod(np.int64(state), winds)
    rest, east = divmod(rest, winds)
    y, x = divmod(rest, size)
    x, bits = blown(x + (action == 1) - (action == 2), east, winds, size, bits)
    y, bits = blown(y + (action == 3) - (action == 4), north, winds, size, bits)
    # Each step gets 64 random bits: `uniform` reads the upper ones, `integers` the lower ones.
    east = min(max(east + np.int64(cr.tasks.integers(bits, 3)) - 1, 0), winds - 1)
    north = min(
        max(north + np.int64(cr.tasks.integers(cr.tasks.splitmix64(bits), 3)) - 1, 0), winds - 1
    )
    return ((y * size + x) * winds + east) * winds + north, -1.0, x == 0 and y == 0


@njit(nogil=True)
def blown(place, wind, winds, size, bits):
    middle = winds // 2  # no wind; further from it a push is likelier
    pushed = cr.tasks.uniform(bits) < abs(wind - middle) / (middle + 1)
    place += pushed * (1 if wind > middle else -1)
    # When the bits are used up, `splitmix64` makes new ones of them.
    return min(max(place, 0), size - 1), cr.tasks.splitmix64(bits)


def lake(size, winds):
    sides = [cr.Component("y", size), cr.Component("x", size)]
    wind = [cr.Component("east", winds), cr.Component("north", winds)] if winds > 1 else []
    motor = cr.Component("motor", 5, labels=("off", "east", "west", "north", "south"))
    return cr.ComputedMDP(
        cr.Space(sides + wind), cr.Space([motor]), start, step, data=(size, winds), time_limit=500
    )


def main(size=40, winds=21, steps=5_000_000, seeds=4):
    calm, windy = lake(size, 1), lake(size, winds)
    for task in (calm, windy):
        begin = time.perf_counter()
        cr.learn(task, LEARNER, 1)
        print(f"{time.perf_counter() - begin:.1f} s for one step of {task}, compiling included")

    moves = cr.GreedyEvaluation(method="rollouts", episodes=200, discounted=False)
    curriculum = cr.Curriculum(
        tasks={"calm": calm, "windy": windy},
        # By name: x, y and the motor are read off the target, the wind is left out. Rewards are
        # negative and the way in the wind is longer, hence the scale.
        transfers=[cr.Transfer("calm", "windy", cr.project(windy, calm), scale=3)],
        learner={"calm": cr.QLearning(learning_rate=1.0, epsilon=0.3), "windy": LEARNER},
        budget={"calm": 2 * steps // 5, "windy": steps},
        # Without the portfolio that is the default, to see where the calm's values alone begin.
        shaping=cr.QInitialisation(),
        evaluation=moves,
    )
    transfer = curriculum.train(seeds)["windy"]
    scratch = cr.learn(windy, LEARNER, 7 * steps // 5, seeds=seeds, evaluation=moves)
    print("Return of the greedy policy, -1 a move, at most 500 moves:")
    print(
        f"from the calm, at the start  {cr.statistics.mean_interval(transfer.greedy_return[:, 0])}"
    )
    print(
        f"from the calm, at the end    {cr.statistics.mean_interval(transfer.greedy_return[:, -1])}"
    )
    end = cr.statistics.mean_interval(scratch.greedy_return[:, -1])
    print(f"from scratch, at the end     {end}, same number of steps")


if __name__ == "__main__":
    main()
