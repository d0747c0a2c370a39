"""A pursuit whose positions a network sees, and what one predator alone would see of it."""

import numpy as np

import curricle as cr

CELLS = 9
"""Of the grid of 3 x 3."""


def observed(predators, **settings):
    """Return a pursuit on 3 x 3 cells as a task that is seen through the cells of all agents."""
    rules = {"size": 3, "predators": predators, "observation": "components"}
    return cr.observation_task("Curricle/Pursuit-v0", **rules, **settings)


def first(cells):
    """Return the states of the table of one predator that the first one is in."""
    return cells[:, 0] * CELLS + cells[:, 1]


def second(cells):
    """Return the states of the table of one predator that the second one is in."""
    return cells[:, 0] * CELLS + cells[:, 2]


def second_alone(cells):
    """Return what is observed where the second predator is the only one."""
    return cells[:, [0, 2]]


def transfers(hunt, chase):
    """Return the transfers by which each of two predators reads the table of one."""
    moves = np.divmod(np.arange(25), 5)
    return [
        cr.Transfer("chase", "hunt", cr.transfer.ObservationMapping(hunt, chase, states, actions))
        for states, actions in zip((first, second), moves, strict=True)
    ]
