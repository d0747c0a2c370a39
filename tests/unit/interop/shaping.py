"""A random world to be shaped, and how the tests step through it."""

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TimeLimit

import curricle as cr
from curricle.interop.potential_shaping import PotentialShaping

N_STATES, N_ACTIONS, DISCOUNT, LIMIT = 6, 3, 0.9, 7
RNG = np.random.default_rng(0)
TRANSITION = RNG.dirichlet(np.full(N_STATES, 0.5), size=(N_STATES, N_ACTIONS))
REWARD = RNG.normal(size=(N_STATES, N_ACTIONS, N_STATES))
PHI = 3 * RNG.normal(size=N_STATES)
SOME = np.arange(N_STATES) == N_STATES - 1
NONE = np.zeros(N_STATES, bool)
MODES = list(AutoresetMode)


class World(gym.Env):
    """A random finite MDP; an episode begins anywhere it does not end."""

    def __init__(self, terminal=SOME, observe=int, space=None, p=TRANSITION, r=REWARD):
        self.p, self.r, self.terminal, self.observe = p, r, terminal, observe
        self.observation_space = space or gym.spaces.Discrete(len(p))
        self.action_space = gym.spaces.Discrete(p.shape[1])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.choice(np.flatnonzero(~self.terminal)))
        return self.observe(self.state), {"begun": 1}

    def step(self, action):
        before = self.state
        self.state = int(self.np_random.choice(len(self.p), p=self.p[before, action]))
        reward = float(self.r[before, action, self.state])
        return self.observe(self.state), reward, bool(self.terminal[self.state]), False, {"at": 1}


def world(terminal=SOME, limit=LIMIT, **settings):
    return TimeLimit(World(terminal, **settings), limit)


def task(terminal=SOME, discount=DISCOUNT, **settings):
    return cr.FiniteMDP.from_dense(
        TRANSITION, REWARD, terminal=terminal, start=0, discount=discount, **settings
    )


def table(state):
    return PHI[state]


def actions_of(n_steps, *shape):
    return np.random.default_rng(1).integers(N_ACTIONS, size=(n_steps, *shape))


def episodes_of(env, actions):
    """The oracle: the plain environment's episodes, as lists of (s, r, s', terminated)."""
    episodes, state = [[]], env.reset(seed=3)[0]
    for action in actions.tolist():
        following, reward, terminated, truncated, _ = env.step(action)
        episodes[-1].append((state, reward, following, terminated))
        state = following
        if terminated or truncated:
            episodes.append([])
            state = env.reset()[0]
    return episodes


def shaped_steps(env, actions):
    """What the wrapper does with the same actions: (reward, info) of each step."""
    steps = []
    env.reset(seed=3)
    for action in actions.tolist():
        _, reward, terminated, truncated, info = env.step(action)
        steps.append((reward, info))
        if terminated or truncated:
            env.reset()
    return steps


def paid(env):
    return [reward for reward, _ in shaped_steps(env, actions_of(60))]


def by_function(values=PHI):
    return paid(PotentialShaping(world(), lambda s: values[s], discount=DISCOUNT))


def as_picture(state):
    return np.eye(N_STATES, dtype=np.float32)[state]


PICTURE = gym.spaces.Box(0, 1, (N_STATES,))


def always(value):
    return lambda observation: value


def run_episode(env, seed=0, action=0):
    env.reset(seed=seed)
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    return info
