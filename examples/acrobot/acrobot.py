"""Acrobot on a grid: a miniature of Acrobot-v1, for acrobot.toml."""

import gymnasium as gym
import numpy as np

ENDS = (np.pi, np.pi, 2 * np.pi, 4.5 * np.pi)  # of two angles and of their velocities


class Coarse(gym.Wrapper):
    """Acrobot on a grid: each action is held for some steps, then the state is rounded.

    Its values are those of Acrobot if its task's discount is discount^held.
    """

    def __init__(self, points, held, discount=0.99):
        super().__init__(gym.make("Acrobot-v1").unwrapped)
        self.axes = [np.linspace(-end, end, points) for end in ENDS]
        self.held, self.discount = held, discount

    def reset(self, **options):
        _, info = super().reset(**options)
        return self.rounded(), info

    def step(self, action):
        total = 0.0
        for k in range(self.held):
            _, reward, terminated, truncated, info = super().step(action)
            total += self.discount**k * reward
            if terminated:
                break
        return self.rounded(), total, terminated, truncated, info

    def rounded(self):
        env = self.unwrapped
        pairs = zip(self.axes, env.state, strict=True)
        env.state = np.array([axis[np.abs(axis - x).argmin()] for axis, x in pairs])
        return env._get_ob()
