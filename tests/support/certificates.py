"""The maze, the potentials and the rewards that tests of certificates share."""

import numpy as np

import curricle as cr

MAZE = cr.GridWorld(["S..", ".#.", "..T"], rewards=cr.Rewards(treasure=10), discount=0.9)
END = int(np.flatnonzero(MAZE.mdp.terminal)[0])
RNG = np.random.default_rng(5)
PHI = RNG.normal(size=MAZE.states.size) * 5
PAIRS = RNG.normal(size=(MAZE.states.size, 4)) * 5
ENDED = np.where(MAZE.mdp.terminal, 0.0, PHI)


def difference(phi, discount=0.9):
    """Return F(s, a, s') = discount Phi(s') - Phi(s)."""
    return lambda s, a, after: discount * phi[after] - phi[s]


def away(distance=1.0):
    """Return a potential that is lower at the end than anywhere else by so much."""
    return np.where(np.arange(MAZE.states.size) == END, -distance, 0.0)
