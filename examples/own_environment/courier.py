"""A courier on a square: a parcel lies in one corner and is wanted in the next."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))  # up, right, down, left


class Courier(gym.Env):
    """A square of `size` x `size` cells: the parcel lies lower left and is wanted lower right.

    Episodes begin upper left, with the parcel in hand if `parcel` is 1.
    """

    def __init__(self, size=8, parcel=0):
        self.size, self.at_first = size, parcel
        self.observation_space = spaces.MultiDiscrete([size, size, 2])
        self.action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row, self.column, self.parcel = 0, 0, self.at_first
        return self._observation(), {}

    def step(self, action):
        down, right = MOVES[action]
        self.row = min(max(self.row + down, 0), self.size - 1)
        self.column = min(max(self.column + right, 0), self.size - 1)
        below = self.row == self.size - 1
        if below and self.column == 0:
            self.parcel = 1
        delivered = bool(below and self.column == self.size - 1 and self.parcel)
        return self._observation(), float(delivered), delivered, False, {}

    def _observation(self):
        return np.array([self.row, self.column, self.parcel])
