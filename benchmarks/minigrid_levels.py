"""Exact answers for six MiniGrid levels: states, seconds, optimal value and length.

The optimal length of each is found a second time, by a search that shares no code with Curricle.
Seconds are by the wall and of the processor. Needs the extra `minigrid`.

    python -m benchmarks.minigrid_levels [--seed 0] [--discount 0.99]
"""

import argparse
import math
import time
from collections import deque

import gymnasium as gym

import curricle as cr

LEVELS = (
    "DoorKey-8x8-v0",
    "MultiRoom-N4-S5-v1",
    "KeyCorridorS3R2-v0",
    "LavaCrossingS9N2-v0",
    "FourRooms-v0",
    "Unlock-v0",
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--discount", type=float, default=0.99)
    given = parser.parse_args()
    cr.solve(cr.tabulate("minigrid:MiniGrid-Empty-5x5-v0", discount=0.9))  # imports and compiles
    print(f"{'level':<20} {'states':>7} {'seconds':>8} {'of CPU':>6} V*(start) length by hand")
    for level in LEVELS:
        began, busy = time.perf_counter(), time.process_time()
        name = f"minigrid:MiniGrid-{level}"
        task = cr.tabulate(name, discount=given.discount, seeds=[given.seed])
        seconds = f"{time.perf_counter() - began:>8.2f} {time.process_time() - busy:>6.2f}"
        value = cr.solve(task).start_value
        length = 1 + round(math.log(value) / math.log(given.discount))
        with gym.make(name) as env:
            env.reset(seed=given.seed)
            by_hand = shortest(env)
        counts = f"{task.states.size:>7,} {seconds} {value:>9.4f} {length:>6} {by_hand:>7}"
        print(f"{level:<20} {counts}", flush=True)


# -- the shortest solution, by rules written down here and a search of their own -------------------
#
# Nothing of Curricle is used, and of MiniGrid `Grid.encode` and where the agent is.

# Numbers of MiniGrid's encoding.
WALL, DOOR, KEY, BALL, BOX, GOAL, LAVA = 2, 4, 5, 6, 7, 8, 9
OPEN, CLOSED, LOCKED = 0, 1, 2
AHEAD = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, down, left, up
LEFT, RIGHT, FORWARD, PICK_UP, DROP, TOGGLE = range(6)


def shortest(env):
    """Return the fewest actions that solve the level of an environment just reset; None if none do.

    Solved is: at a goal; or the object `env.obj` picked up; or the door `env.door` open.
    """
    base = env.unwrapped
    cells = base.grid.encode()
    at = {
        (x, y): tuple(int(n) for n in cells[x, y])
        for x in range(base.width)
        for y in range(base.height)
    }
    wanted = getattr(base, "obj", None)
    wanted = None if wanted is None else tuple(int(n) for n in wanted.cur_pos)
    door = getattr(base, "door", None)
    door = None if door is None else tuple(int(n) for n in door.cur_pos)
    fixed = {place for place, (kind, _, _) in at.items() if kind == WALL}
    lava = {place for place, (kind, _, _) in at.items() if kind == LAVA}
    goals = {place for place, (kind, _, _) in at.items() if kind == GOAL}
    doors = {place: (color, state) for place, (kind, color, state) in at.items() if kind == DOOR}
    # An item is its kind, its colour and where it first lay, so that no two are the same.
    items = {p: (kind, color, p) for p, (kind, color, _) in at.items() if kind in (KEY, BALL, BOX)}
    x, y = (int(n) for n in base.agent_pos)
    start = (x, y, int(base.agent_dir), None, frozenset(doors.items()), frozenset(items.items()))
    distance, waiting = {start: 0}, deque([start])
    while waiting:
        state = waiting.popleft()
        for action in range(6):
            after, solved = moved(state, action, fixed, lava, goals, wanted, door)
            if solved:
                return distance[state] + 1
            if after is not None and after not in distance:
                distance[after] = distance[state] + 1
                waiting.append(after)
    return None


def moved(state, action, fixed, lava, goals, wanted, door):
    """Return the state after an action, None where the episode ends; and whether it is solved."""
    x, y, facing, carried, doors, items = state
    if action in (LEFT, RIGHT):
        return (x, y, (facing + (1 if action == RIGHT else 3)) % 4, carried, doors, items), False
    front = x + AHEAD[facing][0], y + AHEAD[facing][1]
    doors_at, items_at = dict(doors), dict(items)
    if action == FORWARD:
        if front in goals:
            return None, True
        if front in lava:
            return None, False
        shut = front in doors_at and doors_at[front][1] != OPEN
        if front in fixed or front in items_at or shut:
            return state, False
        return (*front, facing, carried, doors, items), False
    if action == PICK_UP:
        if front not in items_at or carried is not None:
            return state, False
        taken = items_at.pop(front)
        return (x, y, facing, taken, doors, frozenset(items_at.items())), taken[2] == wanted
    if action == DROP:
        free = front not in fixed | lava | goals and front not in doors_at and front not in items_at
        if carried is None or not free:
            return state, False
        items_at[front] = carried
        return (x, y, facing, None, doors, frozenset(items_at.items())), False
    if front in doors_at:
        color, how = doors_at[front]
        if how == LOCKED:
            opens = carried is not None and carried[:2] == (KEY, color)
            how = OPEN if opens else LOCKED
        else:
            how = CLOSED if how == OPEN else OPEN
        doors_at[front] = color, how
        after = (x, y, facing, carried, frozenset(doors_at.items()), items)
        return after, front == door and how == OPEN
    return state, False


if __name__ == "__main__":
    main()
