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
from tests.unit.interop import shaping

DISCOUNT = 0.9


class World(shaping.World):
    """A finite MDP, P and r (S, A, S), that ends in its last state; each has a seed of its own."""

    made = count()

    def __init__(self, p, r, observe=int, space=None):
        super().__init__(np.arange(len(p)) == len(p) - 1, observe, space, p, r)
        self.np_random = np.random.default_rng(next(World.made))


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
