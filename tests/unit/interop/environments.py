"""Tasks that become environments, and small environments that become tasks."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv

import curricle as cr
from curricle import GridWorld, Pursuit
from tests.support.tasks import ring

WALLED = GridWorld(["S.#T", "FP.."])
CROP = GridWorld(["......", "S....T"]).crop(rows=(0, 2), columns=(3, 6))


TASKS = {
    "walled": WALLED,
    "crop": CROP,
    "relative": GridWorld(["S.T", ".F."], representation="relative"),
    "pursuit": Pursuit(3, 2),
    "tables": Pursuit(3, 1).mdp,
    "ring": ring(7, time_limit=30),
}

OFF = cr.GreedyEvaluation("off")


class Ring(FrozenLakeEnv):
    """A table whose transitions, not states, end an episode: going round, or resting at 2."""

    def __init__(self, start=0):
        super().__init__()
        self.observation_space, self.action_space = spaces.Discrete(3), spaces.Discrete(2)
        self.initial_state_distrib = np.eye(3)[start]
        self.P = {
            s: {0: [(1.0, (s + 1) % 3, 1.0, s == 2)], 1: [(1.0, s, -1.0, s == 2)]} for s in range(3)
        }


class Echo(gym.Env):
    """Shows one observation after another, and notes what it is given."""

    def __init__(self, observation_space, action_space, observations=(), notes=None):
        self.observation_space, self.action_space = observation_space, action_space
        self.observations, self.notes = list(observations), notes

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.shown = 0
        return self.observations[0], {}

    def step(self, action):
        if self.notes is not None:
            self.notes.append(action)
        self.shown += 1
        over = self.shown == len(self.observations) - 1
        return self.observations[self.shown], 1.0, over, False, {}


TWO = spaces.Discrete(2)


class Watched(gym.Env):
    """A coin tossed until heads; counts how often it was opened, stepped and closed."""

    def __init__(self, log, fail=None):
        self.observation_space, self.action_space = TWO, TWO
        self.log, self.fail = log, fail or (lambda log: None)
        log.append("open")

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.log.append(f"seed {seed}" if seed is not None else "reset")
        self.fail(self.log)
        return 0, {}

    def step(self, action):
        self.log.append("step")
        self.fail(self.log)
        heads = bool(self.np_random.random() < 0.3)
        return 1 - heads, float(action), heads, False, {}

    def close(self):
        self.log.append("close")


def watched(log, fail=None, **settings):
    make = (lambda: Watched(log, fail)) if fail else (lambda: Watched(log))
    return cr.from_gymnasium(make, **{"discount": 0.9, "time_limit": 20, **settings})
