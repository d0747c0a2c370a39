"""MiniGrid's DoorKey rooms, of any size, seen in two ways.

What is seen of a room is a vector: offsets from the agent to key, door and goal, its direction,
what is ahead, what it carries. A network learns from the vector itself. A table of errands has a
state for the current errand (fetch the key, open the door, reach the goal), the offset to it, and
what is ahead. The tables of errands of all rooms have the same states, and networks read them.

    pip install "curricle[deep,minigrid]"
"""

from functools import partial

import gymnasium as gym
import numpy as np
from minigrid.envs import DoorKeyEnv

import curricle as cr
from curricle.transfer import ObservationMapping

DISCOUNT = 0.97
SCALE = 20  # of rewards: 20 for the goal, less with each step taken
REACH = 2  # cells; larger offsets are clipped
ACTIONS = 0, 1, 2, 3, 5  # left, right, forward, pick up, toggle


class Room(gym.Wrapper):
    """A DoorKey room observed as a vector, with the actions that have an effect."""

    def __init__(self, size):
        room = DoorKeyEnv(size=size)
        super().__init__(room)
        room.gen_obs = dict  # the picture is not needed
        self.observation_space = gym.spaces.Box(-2, 2, (16,), np.float32)
        self.action_space = gym.spaces.Discrete(len(ACTIONS))
        self.places = {}

    def reset(self, *, seed=None, options=None):
        self.env.reset(seed=seed, options=options)
        for place in np.ndindex(self.env.width, self.env.height):
            thing = self.env.grid.get(*place)
            if thing is not None and thing.type in ("key", "door", "goal"):
                self.places[thing.type] = place
        return self.seen(), {}

    def step(self, action):
        _, reward, terminated, truncated, _ = self.env.step(ACTIONS[int(action)])
        return self.seen(), SCALE * float(reward), terminated, truncated, {}

    def seen(self):
        room = self.env
        x, y = map(int, room.agent_pos)
        carrying, ahead = room.carrying is not None, room.grid.get(*room.front_pos)
        if carrying:
            self.places["key"] = (x, y)
        seen = np.zeros(16, np.float32)
        for k, thing in enumerate(("key", "door", "goal")):
            seen[2 * k : 2 * k + 2] = np.subtract(self.places[thing], (x, y)) / 8
        seen[6 + room.agent_dir] = 1
        seen[10] = ahead is None or ahead.can_overlap()
        seen[11] = ahead is not None and ahead.type == "key"
        seen[12] = ahead is not None and ahead.type == "door"
        seen[13:] = (
            carrying,
            room.grid.get(*self.places["door"]).is_open,
            x > self.places["door"][0],
        )
        return seen


FACING = cr.Component("facing", 4, labels=("east", "south", "west", "north"))
AHEAD = cr.Component("ahead", 3, labels=("blocked", "free", "thing"))
ERRANDS = cr.Space([
    cr.Component("errand", 3, labels=("key", "door", "goal")),
    cr.Component("right", 2 * REACH + 1, low=-REACH),
    cr.Component("down", 2 * REACH + 1, low=-REACH),
    FACING,
    AHEAD,
])  # fmt: skip


def errands(seen, size):
    """Return the states that n observations fall into, of the table of errands of a room."""
    seen = np.atleast_2d(seen)
    errand = np.where(seen[:, 14] > 0, 2, np.where(seen[:, 13] > 0, 1, 0))
    right, down = offsets(seen)[np.arange(len(seen)), errand].T
    return ERRANDS.encode(
        errand=errand, facing=seen[:, 6:10].argmax(axis=1), ahead=ahead(seen),
        **within(size, errand, right, down),
    )  # fmt: skip


def within(size, errand, right, down):
    """Return the offset of an errand as the table of a room has it.

    It is clipped to what can be in the room: no key is two columns away in that of side 6.
    """
    columns = np.minimum(REACH, size - np.array([5, 4, 3]))[errand]
    return {"right": np.clip(right, -columns, columns), "down": np.clip(down, -REACH, REACH)}


def offsets(seen):
    """Return the cells from the agent to key, door and goal, (n, 3, 2) int."""
    return np.rint(8 * seen[:, :6]).astype(int).reshape(-1, 3, 2)


def ahead(seen):
    return np.where(seen[:, 11] + seen[:, 12] > 0, 2, (seen[:, 10] > 0).astype(int))


def table(size):
    """Return the task of a room of a side, walls included, by its errands."""
    return cr.from_gymnasium(
        partial(Room, size), encode=partial(errand, size=size), states=ERRANDS,
        discount=DISCOUNT, time_limit=10 * size**2,
    )  # fmt: skip


def errand(seen, size):
    """Return the state that one observation falls into."""
    return int(errands(seen, size)[0])


def read_table(large, small):
    """Return how the network of a room reads the errands of that of side 6."""
    return ObservationMapping(large, small, partial(errands, size=6))
