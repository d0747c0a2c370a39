"""Acrobot on a grid: a miniature of Acrobot-v1, for acrobot.toml."""

import gymnasium as gym
import numpy as np

ENDS = (np.pi, np.pi, 2 * np.pi, 4.5 * np.pi)  # of two angles and of their velocities


class Coarse(gym.Wrapper):
    """Acrobot on a grid: each action is held for some steps, then the state is rounded."""

    def __init__(self, points, held):
        super().__init__(gym.make("Acrobot-v1").unwrapped)
        self.axes = [np.linspace(-end, end, points) for end in ENDS]
        self.held = held

    def reset(self, **options):
        _, info = super().reset(**options)
        return self.rounded(), info

    def step(self, action):
        total = 0.0
        for _ in range(self.held):
            _, reward, terminated, truncated, info = super().step(action)
            total += reward
            if terminated:
                break
        return self.rounded(), total, terminated, truncated, info

    def rounded(self):
        env = self.unwrapped
        pairs = zip(self.axes, env.state, strict=True)
        env.state = np.array([axis[np.abs(axis - x).argmin()] for axis, x in pairs])
        return env._get_ob()
