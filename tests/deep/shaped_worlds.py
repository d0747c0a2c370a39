"""Random worlds as vector environments of Stable-Baselines3, and their shaping."""

from functools import partial
from itertools import count

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

pytest.importorskip("stable_baselines3")

from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
)

from curricle.deep.vec_env import ShapedVecEnv

DISCOUNT = 0.9


class World(gym.Env):
    """A finite MDP, P and r (S, A, S), that begins anywhere but where it ends: its last state."""

    made = count()

    def __init__(self, p, r, observe=int, space=None):
        self.p, self.r, self.observe = p, r, observe
        self.observation_space = space or gym.spaces.Discrete(len(p))
        self.action_space = gym.spaces.Discrete(p.shape[1])
        self.np_random = np.random.default_rng(next(World.made))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(len(self.p) - 1))
        return self.observe(self.state), {}

    def step(self, action):
        before = self.state
        self.state = int(self.np_random.choice(len(self.p), p=self.p[before, action]))
        reward = float(self.r[before, action, self.state])
        return self.observe(self.state), reward, self.state == len(self.p) - 1, False, {}


@pytest.fixture(autouse=True)
def the_same_worlds():
    """Have each test play the same worlds whenever it runs."""
    World.made = count()


RNG = np.random.default_rng(0)
SIZE = 6
P = RNG.dirichlet(np.full(SIZE, 0.5), size=(SIZE, 2))
R = RNG.normal(size=(SIZE, 2, SIZE))
PHI = 3 * RNG.normal(size=SIZE)
LIMIT = 4


def one_hot(state, size=SIZE):
    return np.eye(size, dtype=np.float32)[state]


def world(limit=LIMIT, observe=one_hot):
    size = len(P)
    space = gym.spaces.Box(0, 1, (size,)) if observe is one_hot else None
    return TimeLimit(World(P, R, observe, space), limit)


def worlds(n=2, **settings):
    return DummyVecEnv([partial(world, **settings)] * n)


def height(observations):
    return observations @ PHI


def shape(venv, **settings):
    return ShapedVecEnv(venv, height, **{"discount": DISCOUNT, "batched": True, **settings})


def monitored(limit=LIMIT):
    return Monitor(world(limit))
