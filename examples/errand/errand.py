"""An errand: fetch the key, then open the door, on a square of any size."""

import gymnasium as gym
import numpy as np

MOVES = np.array([(-1, 0), (0, 1), (1, 0), (0, -1)])  # up, right, down, left


class Errand(gym.Env):
    """A square of `size` x `size` cells. The agent sees how far key and door are, in cells."""

    def __init__(self, size=16):
        self.size, self.limit = size, 4 * size
        self.observation_space = gym.spaces.Box(-1, 1, (5,), np.float32)
        self.action_space = gym.spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.agent, self.key, self.door = self.np_random.integers(self.size, size=(3, 2))
        self.has_key, self.steps = False, 0
        return self.observation(), {}

    def step(self, action):
        self.agent = np.clip(self.agent + MOVES[action], 0, self.size - 1)
        self.steps += 1
        self.has_key |= bool((self.agent == self.key).all())
        opened = self.has_key and bool((self.agent == self.door).all())
        return self.observation(), float(opened), opened, self.steps == self.limit, {}

    def observation(self):
        key = (self.key - self.agent) * (not self.has_key)
        return np.array([*key, *(self.door - self.agent), self.has_key], np.float32) / 16
