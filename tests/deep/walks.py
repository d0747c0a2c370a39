"""Walks of several lengths as tasks of a vector environment, and teachers that draw in order."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import curricle as cr
from curricle.deep import CurriculumVecEnv

LENGTHS = {"short": 3, "middle": 5, "long": 8}


class Walk(gym.Env):
    """A walk to the right end by action 1, from a random place; it tells where it is and was."""

    def __init__(self, length, size=8, actions=2, closed=None, reuse=True):
        self.length, self.closed, self.reuse = length, closed, reuse
        self.observation_space = gym.spaces.Box(-1, 20, (size,), np.float32)
        self.action_space = gym.spaces.Discrete(actions)
        self.buffer = np.zeros(size, np.float32)  # one array for all observations

    def seen(self):
        self.buffer[:3] = self.length, self.place, self.steps
        self.buffer[3] = self.drawn
        return self.buffer if self.reuse else self.buffer.copy()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.drawn = self.np_random.random()
        self.place = int(self.np_random.integers(self.length - 1))
        self.steps = 0
        return self.seen(), {"options": options}

    def step(self, action):
        self.steps += 1
        self.place = max(0, self.place + (1 if action else -1))
        over = self.place >= self.length - 1
        return self.seen(), float(over), over, False, {"is_success": over}

    def close(self):
        if self.closed is not None:
            self.closed.append(self.length)


class Always:
    """Draws one task."""

    def __init__(self, task):
        self.task = task

    def start(self, n_tasks):
        return np.eye(n_tasks)[self.task]

    def update(self, memory, episode):
        return memory

    def probabilities(self, memory):
        return memory


class Recorder(Always):
    """Draws tasks in turn, and remembers the episodes."""

    uses_td_errors = True

    def __init__(self):
        super().__init__(0)
        self.seen = []

    def update(self, memory, episode):
        self.seen.append(episode)
        return np.roll(memory, 1)


def walk(length, limit=6, discount=0.9, **settings):
    return cr.observation_task(
        partial(Walk, length, **settings), discount=discount, time_limit=limit
    )


TASKS = {name: walk(length) for name, length in LENGTHS.items()}


def curriculum(teacher=None, envs=2, tasks=TASKS, target="long", **named):
    return CurriculumVecEnv(tasks, teacher, target=target, envs=envs, **named)


def actions(n, steps, seed=0):
    rng = np.random.default_rng(seed)
    return (rng.random((steps, n)) < 0.7).astype(int)


def played(venv, steps=120, seed=1):
    """Return what each of some steps gave, after a reset with a seed."""
    venv.seed(seed)
    found = [(venv.reset(), np.zeros(0), np.zeros(0), [*venv.reset_infos])]
    return found + [venv.step(each) for each in actions(venv.num_envs, steps)]


def plain(info):
    """Return an info without what Monitor measures by the clock."""
    ended = {k: v for k, v in info.get("episode", {}).items() if k != "t"}
    return {**info, "episode": ended}


def assert_same(one, other, but=()):
    for mine, yours in zip(one, other, strict=True):
        for a, b in zip(mine[:3], yours[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        for a, b in zip(mine[3], yours[3], strict=True):
            left = {k: v for k, v in plain(a).items() if k not in but}
            np.testing.assert_equal(left, {k: v for k, v in plain(b).items() if k not in but})
