"""Value lookup: phi(s, a) of one state at a time, computed from source values while learning.

A target with a hundred million states has no array of phi. A lookup holds the sources' values and,
for each value of each component of a target state, what it adds to the number of the source's
state: strides that depend on the value. Sparse tables read it, also without a source: another type
for that would compile their loops twice. Potentials make it (`transfer/potential.py`).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, IntArray, frozen
from curricle.tasks.kernel import inlined, quotient

# Aggregates: how the sources' potentials become one.
MINIMUM, MAXIMUM, MEAN, TOTAL = range(4)


class ValueLookup(NamedTuple):
    """phi(s, a) = scale g_n(values_n[f_n(s, a)]) + shift for N sources; C components of states.

    Each source's values have one row more than it has states and one column more than it has
    actions, for pairs without a counterpart: NaN there means that the source knows nothing, and g
    skips it. A source's row for a target state starts at
    ``first[n]`` plus ``strides[strides_at[n, c] + value]`` for the value of each component; the
    target's action adds ``action[n, a]``.
    """

    values: FloatArray  # (V,) of all sources, flat, scaled and shifted
    first: IntArray  # (N,)
    unmapped_row: IntArray  # (N,) the row of states without counterpart
    size: npt.NDArray[np.uint64]  # (C,) the number of values of each component, last one first
    inverse: npt.NDArray[np.uint64]  # (C,) as in `quotient`; 0 where numbers are too large
    strides_at: IntArray  # (N, C)
    strides: IntArray  # (L,) negative where a value has no counterpart
    action: IntArray  # (N, A)
    combine: int
    partial: bool  # whether values are NaN, where a source knows nothing
    unknown: float  # phi where no source knows anything
    scale: float  # of the aggregate
    shift: float
    initial: float  # the learner's own initial value, added to phi


def no_sources(n_actions: int, initial: float = 0.0) -> ValueLookup:
    """Return the lookup without sources: every pair has the initial value."""
    none, pairs = frozen(np.zeros(0, np.int64)), frozen(np.zeros((0, 1), np.int64))
    actions, empty = frozen(np.zeros((0, n_actions), np.int64)), frozen(np.zeros(0))
    sizes = frozen(np.zeros(0, np.uint64))
    affine = 0.0, 1.0, 0.0, float(initial)
    return ValueLookup(empty, none, none, sizes, sizes, pairs, none, actions, MEAN, False, *affine)


@inlined
def source_row(lookup, n, state):
    """Return where the n-th source's values for a target state start."""
    start = lookup.first[n]
    for c in range(np.uint64(lookup.size.shape[0])):
        size, inverse = lookup.size[c], lookup.inverse[c]
        rest = quotient(state, inverse) if inverse > np.uint64(0) else state // size
        stride = lookup.strides[np.uint64(lookup.strides_at[n, c]) + (state - rest * size)]
        if stride < 0:
            return lookup.unmapped_row[n]
        start += stride
        state = rest
    return start


@inlined
def read_known(lookup, state, out):
    """Write the aggregate of the sources that know a pair, hence are not NaN there."""
    n_sources, n_actions = lookup.action.shape
    knowing = np.uint64(0)  # a bit for each source that knows something of the state
    for action in range(np.uint64(n_actions)):
        out[action] = np.nan
    for n in range(np.uint64(n_sources)):
        row = source_row(lookup, n, state)
        if row != lookup.unmapped_row[n] or not np.isnan(lookup.values[np.uint64(row)]):
            knowing |= np.uint64(1) << n
        for action in range(np.uint64(n_actions)):
            value = lookup.values[np.uint64(row + lookup.action[n, action])]
            if np.isnan(value):
                continue
            if np.isnan(out[action]):
                out[action] = value
            elif lookup.combine == MINIMUM:
                out[action] = value if value < out[action] else out[action]
            elif lookup.combine == MAXIMUM:
                out[action] = value if value > out[action] else out[action]
            else:
                out[action] += value
    for action in range(np.uint64(n_actions)):
        if np.isnan(out[action]):
            out[action] = lookup.unknown
        elif lookup.combine == MEAN:
            known = 0
            for n in range(np.uint64(n_sources)):
                # An action without counterpart is NaN in every row, also in the first.
                first = lookup.values[np.uint64(lookup.first[n] + lookup.action[n, action])]
                if knowing >> n & np.uint64(1) and not np.isnan(first):
                    known += 1
            out[action] /= known


@inlined
def read_all(lookup, state, out):
    """Write the aggregate for `state` into `out`, where every source knows every pair."""
    n_sources, n_actions = lookup.action.shape
    for action in range(np.uint64(n_actions)):
        out[action] = 0.0
    for n in range(np.uint64(n_sources)):
        row = source_row(lookup, n, state)
        # One loop for each aggregate: a branch inside the loop would be taken A times.
        if n == np.uint64(0):
            for action in range(np.uint64(n_actions)):
                out[action] = lookup.values[np.uint64(row + lookup.action[n, action])]
        elif lookup.combine == MINIMUM:
            for action in range(np.uint64(n_actions)):
                value = lookup.values[np.uint64(row + lookup.action[n, action])]
                out[action] = value if value < out[action] else out[action]
        elif lookup.combine == MAXIMUM:
            for action in range(np.uint64(n_actions)):
                value = lookup.values[np.uint64(row + lookup.action[n, action])]
                out[action] = value if value > out[action] else out[action]
        else:
            for action in range(np.uint64(n_actions)):
                out[action] += lookup.values[np.uint64(row + lookup.action[n, action])]
    if lookup.combine == MEAN and n_sources > 1:
        for action in range(np.uint64(n_actions)):
            out[action] /= n_sources


@inlined
def read_row(lookup, state, out):
    """Write initial value + phi(state, a) into `out`, (A,) float64."""
    if lookup.partial:
        read_known(lookup, state, out)
    else:
        read_all(lookup, state, out)
    n_actions = np.uint64(lookup.action.shape[1])
    if lookup.scale != 1.0 or lookup.shift != 0.0:
        for action in range(n_actions):
            out[action] = lookup.scale * out[action] + lookup.shift
    for action in range(n_actions):
        out[action] += lookup.initial
