"""Small tasks whose observations are one-hot, so that a linear network is a table."""

import random

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.wrappers import FlattenObservation

import curricle as cr
from curricle.deep import DeepLearner
from curricle.interop.gymnasium import TaskEnvironment

MAZE = cr.GridWorld(["..T", ".#.", "S.."], time_limit=30, rewards=cr.Rewards(treasure=10))
DEEP_Q = DeepLearner("DQN", settings={"learning_starts": 20, "policy_kwargs": {"net_arch": [16]}})
ACTOR = DeepLearner("PPO", settings={"n_steps": 64, "policy_kwargs": {"net_arch": [16]}})
LAKE = cr.observation_task(
    "FrozenLake-v1", is_slippery=False, encode=FlattenObservation, time_limit=20
)


class OneHot(gymnasium.ObservationWrapper):
    """A task's environment that observes which state it is in, as a vector of zeros and a one."""

    def __init__(self, task):
        super().__init__(TaskEnvironment(task))
        self.rows = np.eye(task.states.size, dtype=np.float32)
        self.observation_space = Box(0, 1, (task.states.size,), np.float32)

    def observation(self, observation):
        return self.rows[observation]


def one_hot(task):
    """Return a task as one seen through one-hot observations."""
    return cr.tasks.ObservationTask(lambda: OneHot(task), task.discount)


def random_task(rng, n_states=5, n_actions=3, *, discount=0.9, time_limit=7, scale=0.1):
    """Return a random MDP with an end, whose rewards are small; some episodes are cut off."""
    p = rng.dirichlet(np.full(n_states, 0.5), (n_states, n_actions))
    r = scale * rng.uniform(-1, 1, (n_states, n_actions, n_states))
    terminal = np.arange(n_states) == n_states - 1
    return cr.FiniteMDP.from_dense(
        p, r, terminal=terminal, start=0, discount=discount, time_limit=time_limit
    )


def table_potential(task, observed, table):
    """Return a potential over one-hot observations that says what a table says."""
    mapping = cr.transfer.ObservationMapping(observed, task, lambda rows: rows.argmax(axis=1))
    edge = cr.Transfer("source", "target", mapping)
    return cr.transfer.ObservationPotential(observed, [edge], [cr.transfer.TableValues(table)])


def generator_states():
    """Return the states of the generators that Stable-Baselines3 draws from."""
    return random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
