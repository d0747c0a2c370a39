"""Exact answers for six MiniGrid levels: optimal value and length, states, seconds.

The optimal length of each is found a second time, by a search that shares no code with Curricle
(`minigrid_by_hand.py`). The bar is 30,000 transitions a second: saved, restored and stepped, and
each step repeated to see that it is deterministic. In brackets the rate by processor time, which
other programs disturb less. Needs the extra `minigrid`.

    python -m benchmarks.minigrid_levels [--seed 0] [--discount 0.99]
"""

import argparse
import math
import time

import gymnasium as gym
import minigrid  # noqa: F401  # registers its environments

import curricle as cr
from benchmarks.minigrid_by_hand import shortest

LEVELS = (
    "MiniGrid-DoorKey-8x8-v0",
    "MiniGrid-MultiRoom-N4-S5-v1",
    "MiniGrid-KeyCorridorS3R2-v0",
    "MiniGrid-LavaCrossingS9N2-v0",
    "MiniGrid-FourRooms-v0",
    "MiniGrid-Unlock-v0",
)
BAR = 30_000
HEAD = (
    f"{'level':<29} {'states':>7} {'transitions':>11} {'seconds':>8} "
    f"{'of CPU':>6} {'a second':>17} {'V*(start)':>9} {'length':>6} "
    f"{'by hand':>7} {'MiniGrid pays':>13}"
)


def row(level, seed, discount):
    """Return a line of the table, and whether both lengths agree and the rate clears the bar."""
    began, busy = time.perf_counter(), time.process_time()
    task = cr.tabulate(level, discount=discount, seeds=[seed])
    seconds = time.perf_counter() - began
    share = (time.process_time() - busy) / seconds
    value = cr.solve(task).start_value
    length = 1 + round(math.log(value) / math.log(discount))
    with gym.make(level) as env:
        env.reset(seed=seed)
        by_hand = shortest(env)
        pays = 1 - 0.9 * length / env.unwrapped.max_steps
    rate = task.record.transitions / (task.record.seconds - task.record.observing)
    line = (
        f"{level:<29} {task.states.size:>7,} {task.record.transitions:>11,} {seconds:>8.2f} "
        f"{seconds * share:>6.2f} "
        f"{rate:>8,.0f} ({rate / share:>6,.0f}) {value:>9.4f} {length:>6} {by_hand:>7} "
        f"{pays:>13.4f}"
    )
    return line, length == by_hand, rate / share >= BAR


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--discount", type=float, default=0.99)
    given = parser.parse_args()
    cr.solve(cr.tabulate("MiniGrid-Empty-5x5-v0", discount=0.9))  # imports and compiles
    print(HEAD)
    right, fast = [], []
    for level in LEVELS:
        line, agrees, clears = row(level, given.seed, given.discount)
        print(line, flush=True)
        right.append(agrees)
        fast.append(clears)
    print(f"lengths agree: {all(right)}; {sum(fast)} of {len(fast)} levels at {BAR:,} a second")
    raise SystemExit(not all(right))


if __name__ == "__main__":
    main()
