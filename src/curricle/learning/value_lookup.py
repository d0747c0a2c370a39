"""Potentials read from source values while learning: phi(s, a) of one state at a time, compiled.

A potential over a target of a hundred million states is never an array. What is kept are the
sources' values and, for each component of a target state, its share in the number of the source's.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.tasks.draws import inlined
from curricle.tasks.simd import quotient
from curricle.tasks.spaces import frozen

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

# How the sources' potentials become one.
MINIMUM, MAXIMUM, MEAN, TOTAL = range(4)


class Reading(NamedTuple):
    """phi(s, a) = g_n(values_n[f_n(s, a)]) for N sources; C components of the target's states.

    Each source's values are rows of one more than its actions, and there is one more row: what
    has no counterpart is read there, and all of these hold what it is worth. A source's row for a
    target state starts at ``first[n]`` plus ``shares[shares_at[n, c] + value]`` for the value of
    each component; the target's action adds ``action[n, a]``.
    """

    values: FloatArray  # (V,) of all sources, flat, scaled and shifted
    first: IntArray  # (N,)
    nowhere: IntArray  # (N,) the row for states without counterpart
    size: npt.NDArray[np.uint64]  # (C,) values of a component, the last one's first
    inverse: npt.NDArray[np.uint64]  # (C,) as in `quotient`; 0 where numbers are too large
    shares_at: IntArray  # (N, C)
    shares: IntArray  # (L,) negative where a value has no counterpart
    action: IntArray  # (N, A)
    combine: int
    initial: float  # the learner's own initial value, added to phi


def nothing(n_actions: int, initial: float) -> Reading:
    """Return the reading of no source: every pair is worth the initial value.

    Examples
    --------
    >>> nothing(5, -1.0).first.size
    0
    """
    none, pairs = frozen(np.zeros(0, np.int64)), frozen(np.zeros((0, 1), np.int64))
    actions, empty = frozen(np.zeros((0, n_actions), np.int64)), frozen(np.zeros(0))
    sizes = frozen(np.zeros(0, np.uint64))
    return Reading(empty, none, none, sizes, sizes, pairs, none, actions, MEAN, float(initial))


@inlined
def source_row(reading, n, state):
    """Return where the n-th source's values for a target state start."""
    start = reading.first[n]
    for c in range(np.uint64(reading.size.shape[0])):
        size, inverse = reading.size[c], reading.inverse[c]
        rest = quotient(state, inverse) if inverse > np.uint64(0) else state // size
        share = reading.shares[np.uint64(reading.shares_at[n, c]) + (state - rest * size)]
        if share < 0:
            return reading.nowhere[n]
        start += share
        state = rest
    return start


@inlined
def read_row(reading, state, out):
    """Write initial value + phi(state, a) into `out`, (A,) float64."""
    n_sources, n_actions = reading.action.shape
    for action in range(np.uint64(n_actions)):
        out[action] = 0.0
    for n in range(np.uint64(n_sources)):
        row = source_row(reading, n, state)
        # One loop for each way of combining: a choice inside the loop would be made A times.
        if n == np.uint64(0):
            for action in range(np.uint64(n_actions)):
                out[action] = reading.values[np.uint64(row + reading.action[n, action])]
        elif reading.combine == MINIMUM:
            for action in range(np.uint64(n_actions)):
                value = reading.values[np.uint64(row + reading.action[n, action])]
                out[action] = value if value < out[action] else out[action]
        elif reading.combine == MAXIMUM:
            for action in range(np.uint64(n_actions)):
                value = reading.values[np.uint64(row + reading.action[n, action])]
                out[action] = value if value > out[action] else out[action]
        else:
            for action in range(np.uint64(n_actions)):
                out[action] += reading.values[np.uint64(row + reading.action[n, action])]
    if reading.combine == MEAN and n_sources > 1:
        for action in range(np.uint64(n_actions)):
            out[action] /= n_sources
    for action in range(np.uint64(n_actions)):
        out[action] += reading.initial


@njit(cache=True, nogil=True)
def read_all(reading, q):
    """Write initial value + phi into every row of a table, (S, A)."""
    row = np.empty(q.shape[1])
    for state in range(np.uint64(q.shape[0])):
        read_row(reading, state, row)
        for action in range(row.shape[0]):
            q[state, action] = row[action]


@njit(cache=True, nogil=True)
def read_some(reading, states, q):
    """Write initial value + phi of n states into the rows of a table, (n, A) float64."""
    for i in range(states.shape[0]):
        read_row(reading, np.uint64(states[i]), q[i])
