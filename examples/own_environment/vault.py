"""A vault that opens with a key, which lies in another corner of the room."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))  # up, right, down, left


class Vault(gym.Env):
    """A room of `size` x `size` cells: the key lies lower left, the vault is lower right.

    With `key` = 1 an episode starts with the key in hand.
    """

    def __init__(self, size=6, key=0):
        self.size, self.first_key = size, key
        self.observation_space = spaces.MultiDiscrete([size, size, 2])
        self.action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row, self.column, self.key = 0, 0, self.first_key
        return self._observation(), {}

    def step(self, action):
        down, right = MOVES[action]
        self.row = min(max(self.row + down, 0), self.size - 1)
        self.column = min(max(self.column + right, 0), self.size - 1)
        below = self.row == self.size - 1
        if below and self.column == 0:
            self.key = 1
        opened = bool(below and self.column == self.size - 1 and self.key)
        return self._observation(), float(opened), opened, False, {}

    def _observation(self):
        return np.array([self.row, self.column, self.key])
