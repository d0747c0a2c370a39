"""Potentials read from source values while learning: phi(s, a) of one state at a time, compiled.

A potential over a target of a hundred million states is never an array. What is kept are the
sources' values and, for each component of a target state, its share in the source's state.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.tasks.draws import piece
from curricle.tasks.spaces import frozen

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

# How the sources' potentials become one.
MINIMUM, MAXIMUM, MEAN, TOTAL = range(4)


class Reading(NamedTuple):
    """phi(s, a) = g_n(values_n[f_n(s, a)]) for N sources, each read through C components.

    The source pair of (s, a) starts at ``first[n]`` and adds up from ``shares``: component c of
    the target state, ``s // divisor % modulus``, is looked up from ``shares_at[n, c]`` on, and
    the action adds ``action[n, a]``. A negative entry has no counterpart.
    """

    values: FloatArray  # (V,) of all sources, flat, scaled and shifted
    first: IntArray  # (N,)
    unmapped: FloatArray  # (N,) what a pair without counterpart is worth
    divisor: IntArray  # (N, C)
    modulus: IntArray  # (N, C)
    shares_at: IntArray  # (N, C)
    shares: IntArray  # (L,)
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
    return Reading(empty, none, empty, pairs, pairs, pairs, none, actions, MEAN, float(initial))


@piece
def source_pair(reading, n, state):
    """Return where the n-th source's values for a target state start, negative if nowhere."""
    pair = reading.first[n]
    for c in range(reading.divisor.shape[1]):
        value = state // np.uint64(reading.divisor[n, c]) % np.uint64(reading.modulus[n, c])
        share = reading.shares[np.uint64(reading.shares_at[n, c]) + value]
        if share < 0:
            return np.int64(-1)
        pair += share
    return pair


@piece
def source_value(reading, n, pair, action):
    """Return what the n-th source makes of an action, its values for the state found at `pair`."""
    move = reading.action[n, action]
    if pair < 0 or move < 0:
        return reading.unmapped[n]
    return reading.values[np.uint64(pair + move)]


@piece
def read_row(reading, state, out):
    """Write initial value + phi(state, a) into `out`, (A,) float64."""
    n_sources, n_actions = reading.action.shape
    for action in range(np.uint64(n_actions)):
        out[action] = 0.0
    for n in range(np.uint64(n_sources)):
        pair = source_pair(reading, n, state)
        # One loop for each way of combining: a choice inside the loop would be made A times.
        if n == np.uint64(0):
            for action in range(np.uint64(n_actions)):
                out[action] = source_value(reading, n, pair, action)
        elif reading.combine == MINIMUM:
            for action in range(np.uint64(n_actions)):
                out[action] = min(out[action], source_value(reading, n, pair, action))
        elif reading.combine == MAXIMUM:
            for action in range(np.uint64(n_actions)):
                out[action] = max(out[action], source_value(reading, n, pair, action))
        else:
            for action in range(np.uint64(n_actions)):
                out[action] += source_value(reading, n, pair, action)
    parts = float(n_sources) if reading.combine == MEAN and n_sources > 0 else 1.0
    for action in range(np.uint64(n_actions)):
        out[action] = out[action] / parts + reading.initial


@njit(cache=True, nogil=True)
def read_all(reading, q):
    """Write initial value + phi into every row of a table, (S, A)."""
    row = np.empty(q.shape[1])
    for state in range(np.uint64(q.shape[0])):
        read_row(reading, state, row)
        for action in range(row.shape[0]):
            q[state, action] = row[action]
