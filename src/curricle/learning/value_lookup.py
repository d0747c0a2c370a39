"""Value lookup: phi(s, a) of one state at a time, computed from source values while learning.

A target with a hundred million states has no array of phi. A lookup holds the sources' values and,
for each value of each component of a target state, what it adds to the number of the source's
state: strides that depend on the value. Sparse tables read it, also without a source: another type
for that would compile their loops twice.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, IntArray, frozen
from curricle.tasks.kernel import compiled_once, inlined, inverse_of, quotient
from curricle.tasks.spaces import MISSING, Component, Space

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


class SourceTable(NamedTuple):
    """The values of a source as a target reads them, and where its pairs find them."""

    values: FloatArray  # (S' + 1, A' + 1), the last row and column for pairs without counterpart
    # For each component of target states what each of its values adds to the source's state;
    # `MISSING` for values without a counterpart.
    offsets: Sequence[IntArray]
    action: IntArray  # (A,) the source action of each target action; `MISSING` if there is none


def value_lookup(
    states: Space, sources: Sequence[SourceTable], combine: int, unknown: float
) -> ValueLookup:
    """Return the lookup of N sources for a task with these states, a whole box."""
    actions, strides, partial = list[IntArray](), list[IntArray](), False
    for values, offsets, action in sources:
        width = values.shape[1]
        actions.append(np.where(action == MISSING, width - 1, action))
        strides += [np.where(at == MISSING, -1, at * width) for at in reversed(offsets)]
        missing = any((part == MISSING).any() for part in (action, *offsets))
        partial |= bool((missing and np.isnan(values[-1, -1])) or np.isnan(values[:-1, :-1]).any())
    sizes = states.shape[::-1]
    first, at = (
        np.cumsum([0, *(array.size for array in arrays[:-1])])
        for arrays in ([source.values for source in sources], strides)
    )
    rows = [source.values.size - source.values.shape[1] for source in sources]
    return ValueLookup(
        values=frozen(np.concatenate([source.values.ravel() for source in sources])),
        first=frozen(first),
        unmapped_row=frozen(first + rows),
        size=frozen(np.array(sizes, np.uint64)),
        inverse=frozen(np.array([inverse_of(n, states.size) for n in sizes], np.uint64)),
        strides_at=frozen(at.reshape(len(sources), -1)),
        strides=frozen(np.concatenate(strides)),
        action=frozen(np.stack(actions)),
        combine=combine,
        partial=partial,
        unknown=float(unknown),
        scale=1.0,
        shift=0.0,
        initial=0.0,
    )


def fits_task(lookup: object, states: Space, n_actions: int) -> bool:
    """Return whether all lookups of a task's states stay within the sources: loops do not check."""
    if not isinstance(lookup, ValueLookup) or not states.is_box:
        return False
    n, c = len(lookup.first), len(states.components)
    if n == 0:
        return lookup.action.shape == (0, n_actions)
    shapes = lookup.strides_at.shape, lookup.action.shape, lookup.unmapped_row.shape
    sizes = states.shape[::-1]
    inverses = tuple(inverse_of(size, states.size) for size in sizes)
    if shapes != ((n, c), (n, n_actions), (n,)):
        return False
    if (*lookup.size, *lookup.inverse) != (*sizes, *inverses):
        return False
    ends = lookup.strides_at + np.array(sizes)
    if lookup.strides_at.min() < 0 or ends.max() > len(lookup.strides):
        return False
    last = lookup.first.copy()  # the offset of each source's last mapped state
    for source, component in np.ndindex(n, c):
        at, end = lookup.strides_at[source, component], ends[source, component]
        last[source] += max(int(lookup.strides[at:end].max()), 0)
    last = np.maximum(last, lookup.unmapped_row) + lookup.action.max(axis=1)
    lowest = min(part.min() for part in (lookup.first, lookup.unmapped_row, lookup.action))
    return bool(lowest >= 0 and last.max() < len(lookup.values))


def no_sources(n_actions: int, initial: float = 0.0) -> ValueLookup:
    """Return the lookup without sources: every pair has the initial value."""
    none, pairs = frozen(np.zeros(0, np.int64)), frozen(np.zeros((0, 1), np.int64))
    actions, empty = frozen(np.zeros((0, n_actions), np.int64)), frozen(np.zeros(0))
    sizes = frozen(np.zeros(0, np.uint64))
    affine = 0.0, 1.0, 0.0, float(initial)
    return ValueLookup(empty, none, none, sizes, sizes, pairs, none, actions, MEAN, False, *affine)


def array_lookup(values: FloatArray, *, partial: bool) -> ValueLookup:
    """Return the lookup of phi as an array, (S, A), NaN in parts if nothing is known there."""
    n_states, n_actions = values.shape
    table = SourceTable(values, [np.arange(n_states)], np.arange(n_actions))
    states = Space([Component("state", n_states)])
    return value_lookup(states, [table], MINIMUM, np.nan)._replace(partial=partial)


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


@compiled_once
def read_rows(lookup, states, q):
    """Write initial value + phi of n states into a table of n rows, (n, A) float64."""
    for i in range(states.shape[0]):
        read_row(lookup, np.uint64(states[i]), q[i])
