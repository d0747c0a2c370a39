"""Pursuit as a network sees it, and how its predators read the table of one."""

from functools import partial

import numpy as np
from gymnasium.spaces import Box
from gymnasium.wrappers import TransformObservation

from curricle.transfer import ObservationMapping

SIZE = 7


def places_and_ways(env):
    """Return an environment in which a network sees :func:`seen`."""
    predators = len(env.observation_space.nvec) - 1
    space = Box(-1.0, 1.0, (2 + 4 * predators,), np.float32)
    return TransformObservation(env, seen, space)


def seen(cells):
    """Return the prey's row and column in [-1, 1], then each predator's and its way to the prey."""
    places = np.stack(np.divmod(cells, SIZE), axis=1)
    ways = places[:1] - places[1:]
    places = 2 * places / (SIZE - 1) - 1
    parts = np.hstack([places[1:], ways / (SIZE - 1)])
    return np.append(places[0], parts).astype(np.float32)


def first(hunt, chase):
    """Return the mapping by which the first predator reads the table of one."""
    return read_alone(hunt, chase, 0)


def second(hunt, chase):
    """Return the mapping by which the second predator reads the table of one."""
    return read_alone(hunt, chase, 1)


def read_alone(hunt, chase, which):
    """Return the mapping by which one of the predators, from 0, reads the table of one."""
    predators = (hunt.observations.shape[0] - 2) // 4
    moves = np.unravel_index(np.arange(5**predators), (5,) * predators)[which]
    return ObservationMapping(hunt, chase, partial(alone, which), actions=moves)


def alone(which, observations):
    """Return the states of the table that one of the predators is in."""
    begin = 4 * which + 2
    places = observations[:, [0, 1, begin, begin + 1]].astype(np.float64)
    rows_and_columns = np.rint((places + 1) * (SIZE - 1) / 2).astype(np.int64)
    return rows_and_columns @ SIZE ** np.arange(3, -1, -1)
