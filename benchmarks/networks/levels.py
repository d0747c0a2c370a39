"""MiniGrid's levels with the actions that have an effect, and classic control on a grid."""

import gymnasium as gym
import numpy as np

from curricle.interop import MiniGridView

make = gym.make


def walk(env):
    """Return an environment of MiniGrid in which an agent turns and walks."""
    return some_actions(env, 0, 1, 2)


def opens(env):
    """Return an environment in which the agent also opens doors."""
    return some_actions(env, 0, 1, 2, 5)


def fetch(env):
    """Return an environment in which the agent also picks things up."""
    return some_actions(env, 0, 1, 2, 3, 5)


def carry(env):
    """Return an environment in which the agent also lays down what it carries."""
    return some_actions(env, 0, 1, 2, 3, 4, 5)


def some_actions(env, *actions):
    """Return an environment of MiniGrid as zeros and ones, with some of its actions."""
    few = gym.spaces.Discrete(len(actions))
    return gym.wrappers.TransformAction(MiniGridView()(env), actions.__getitem__, few)


ENDS = {
    "MountainCar-v0": ((-1.2, 0.6), (-0.07, 0.07)),  # position and velocity
    "Acrobot-v1": ((-np.pi, np.pi),) * 2 + ((-2 * np.pi, 2 * np.pi), (-4.5 * np.pi, 4.5 * np.pi)),
}


class Grid(gym.Wrapper):
    """An environment of classic control on a grid of states; each action is held for some steps."""

    def __init__(self, id, points, held):
        super().__init__(gym.make(id).unwrapped)
        self.axes = [np.linspace(*ends, points) for ends in ENDS[id]]
        self.held = held

    def reset(self, **options):
        _, info = self.env.reset(**options)
        return self.rounded(), info

    def step(self, action):
        for _ in range(self.held):
            _, reward, terminated, truncated, info = self.env.step(action)
            if terminated:
                break
        return self.rounded(), reward, terminated, truncated, info

    def rounded(self):
        env = self.unwrapped
        pairs = zip(self.axes, env.state, strict=True)
        env.state = np.array([axis[np.abs(axis - x).argmin()] for axis, x in pairs])
        return env._get_ob() if hasattr(env, "_get_ob") else env.state.astype(np.float32)


def as_it_is(env):
    """Return an environment whose observations a network takes as they are."""
    return env
