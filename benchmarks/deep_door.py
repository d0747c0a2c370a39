"""MiniGrid's DoorKey 8x8 from DoorKey 6x6: DQN, all steps charged.

The observation is a vector: offsets from the agent to key, door and goal, its direction, what is
ahead, what it carries. Two sources in the 6x6 room: a table over the current errand (fetch the key,
open the door, reach the goal), the offset to it, and what is ahead; and the DQN of the target,
whose weights can be carried over, as observations of both rooms have the same shape.

    pip install "minigrid>=3,<4"
    python benchmarks/deep_door.py [--seeds 5] [--workers 2] [--arms ...] [--out DIR]
"""

from functools import partial

import gymnasium as gym
import minigrid  # noqa: F401 - registers its environments
import numpy as np
from evidence import Benchmark

import curricle as cr

DISCOUNT = 0.97
SMALL, LARGE = 6, 8
SOURCE, BUDGET = 40_000, 80_000
EVAL_FREQ = 5_000
SCALE = 20  # of rewards: 20 for the goal, less with each step taken
REACH = 2  # cells; larger offsets are clipped
COLUMNS = np.array([1, 2, 2])  # the same by errand: no key of the small room is two columns away
ACTIONS = 0, 1, 2, 3, 5  # left, right, forward, pick up, toggle
LEARN = cr.QLearning(learning_rate=cr.learning.linear(0.5, 0.05, steps=SOURCE), epsilon=0.2)
EVALUATION = cr.GreedyEvaluation("rollouts", episodes=50, discounted=False)
DQN = {
    "learning_rate": 5e-4, "batch_size": 128, "buffer_size": 50_000, "learning_starts": 1_000,
    "gradient_steps": 2, "train_freq": 1, "target_update_interval": 1_000,
    "exploration_fraction": 0.3, "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [128, 128]},
}  # fmt: skip
WARM = DQN | {"exploration_initial_eps": 0.2}
GENTLE = DQN | {
    "learning_rate": 3e-5, "batch_size": 512, "gradient_steps": 1,
    "exploration_initial_eps": 0.5, "exploration_final_eps": 0.1,
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"eps": 1e-2}},
}  # fmt: skip
"""Where phi is nearly right, actions differ by little: small steps keep these differences."""


class Room(gym.Wrapper):
    """A DoorKey room observed as a vector, with the actions that have an effect."""

    def __init__(self, size):
        room = gym.make(f"MiniGrid-DoorKey-{size}x{size}-v0").unwrapped
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
        x, y = (int(each) for each in room.agent_pos)
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


ERRANDS = cr.Space([
    cr.Component("errand", 3, labels=("key", "door", "goal")),
    cr.Component("right", 2 * REACH + 1, low=-REACH),
    cr.Component("down", 2 * REACH + 1, low=-REACH),
    cr.Component("facing", 4, labels=("east", "south", "west", "north")),
    cr.Component("ahead", 3, labels=("blocked", "free", "thing")),
])  # fmt: skip


def errands(seen):
    """Return the states of the table that n observations fall into."""
    seen = np.atleast_2d(seen)
    errand = np.where(seen[:, 14] > 0, 2, np.where(seen[:, 13] > 0, 1, 0))
    offsets = np.rint(8 * seen[:, :6]).astype(int).reshape(-1, 3, 2)
    right, down = offsets[np.arange(len(seen)), errand].T
    right, down = np.clip(right, -COLUMNS[errand], COLUMNS[errand]), np.clip(down, -REACH, REACH)
    ahead = np.where(seen[:, 11] + seen[:, 12] > 0, 2, (seen[:, 10] > 0).astype(int))
    return ERRANDS.encode(
        errand=errand, right=right, down=down, facing=seen[:, 6:10].argmax(axis=1), ahead=ahead
    )


def errand(seen):
    return int(errands(seen)[0])


def target():
    return cr.tasks.ObservationTask(partial(Room, LARGE), DISCOUNT, 10 * LARGE**2)


def from_table(shaping, settings):
    large = target()
    small = cr.from_gymnasium(
        partial(Room, SMALL), encode=errand, states=ERRANDS, discount=DISCOUNT,
        time_limit=10 * SMALL**2,
    )  # fmt: skip
    edge = cr.Transfer("small", "large", cr.transfer.ObservationMapping(large, small, errands))
    learners = {"small": LEARN, "large": learner(settings)}
    return plan({"small": small, "large": large}, [edge], learners, shaping)


def from_network(shaping, settings):
    large = target()
    small = cr.tasks.ObservationTask(partial(Room, SMALL), DISCOUNT, 10 * SMALL**2)
    edge = cr.Transfer("small", "large", cr.transfer.ObservationMapping(large, small))
    learners = {"small": learner(DQN), "large": learner(settings)}
    return plan({"small": small, "large": large}, [edge], learners, shaping)


def plan(tasks, transfers, learners, shaping):
    return cr.Curriculum(
        tasks=tasks, transfers=transfers, learner=learners,
        budget={"small": cr.StoppingRule(SOURCE), "large": BUDGET - SOURCE},
        shaping={"large": shaping},
        eval_freq={"large": EVAL_FREQ}, evaluation={"large": EVALUATION},
    )  # fmt: skip


def from_scratch():
    return cr.Curriculum(
        {"large": target()},
        learner=learner(DQN),
        budget=BUDGET,
        eval_freq=EVAL_FREQ,
        evaluation=EVALUATION,
    )


def learner(settings):
    return cr.deep.DeepLearner("DQN", envs=8, settings=settings)


BENCHMARK = Benchmark(
    title="MiniGrid DoorKey 8x8 from 6x6 (DQN)",
    arms={
        "from scratch": from_scratch,
        "residual on the table": partial(from_table, cr.QInitialisation(), GENTLE),
        "shaped by the table": partial(from_table, cr.StateShaping(), DQN),
        "table's policy only": partial(from_table, cr.deep.PolicyReuse(), DQN),
        "residual on the network": partial(from_network, cr.QInitialisation(), WARM),
        "shaped by the network": partial(from_network, cr.StateShaping(), DQN),
        "weights carried over": partial(from_network, cr.deep.WeightTransfer(), WARM),
    },
    threshold=16.0,
)

if __name__ == "__main__":
    BENCHMARK.main("deep_door", __doc__)
