"""Greedy actions: the best of a row of values, ties broken uniformly; compiled.

A *view* is a NamedTuple of the values that a policy is greedy on, which loops read with
:func:`greedy_action` and :func:`acting_row`.
"""

from typing import NamedTuple

import numpy as np

from curricle.arrays import FloatTable, IntArray, frozen
from curricle.tasks.kernel import (
    LANES as LANES_OF_SIMD,
    first_above,
    highest_of_lanes,
    inlined,
    integers,
    nth_one,
    ones,
    overloaded,
    ties_in_lanes,
)

LANES, WORD = np.uint64(LANES_OF_SIMD), np.uint64(64)
TIED = np.uint64(1 << 15)  # flag of an action that was drawn among several of the same value
ACTION = np.uint64((1 << 15) - 1)  # the bits of the action itself
ONLY_ROW = np.uint64(0)
"""The row of a table of one row; Numba would compile once more for a literal 0."""
MULTIPLIER = np.uint64(0xD1342543DE82EF95)
"""Turns bits that have chosen an action into bits that can break a tie."""


@inlined
def highest(table, row, changed=None):
    """Return the highest value of a row; as if one were changed: its action and its value."""
    best = highest_of_lanes(table, row, changed, np.uint64(0))
    for first in range(LANES, np.uint64(table.shape[1]), LANES):
        other = highest_of_lanes(table, row, changed, first)
        best = other if other > best else best
    return best


@inlined
def ties_in_word(table, row, changed, first, value):
    """Return which of up to 64 values of a row equal `value`, from entry `first` on: a bit each."""
    tied, end = np.uint64(0), np.uint64(table.shape[1])
    end = end if end < first + WORD else first + WORD
    for start in range(first, end, LANES):
        tied |= ties_in_lanes(table, row, changed, start, value) << (start - first)
    return tied


@inlined
def best_of(table, row, bits, changed=None):
    """Return the highest value of a row and an action that has it, drawn and flagged among ties.

    As :func:`highest`, it reads the row as if one value were changed.
    """
    # No branch depends on the draw: the processor would often predict it wrongly, and then wait
    # for the row to arrive from memory.
    best, first = highest(table, row, changed), np.uint64(0)
    tied = ties_in_word(table, row, changed, first, best)
    ties = ones(tied)
    for start in range(WORD, np.uint64(table.shape[1]), WORD):
        ties += ones(ties_in_word(table, row, changed, start, best))
    if ties == np.uint64(0):  # only where learning has diverged to NaN
        return best, np.uint64(0)
    skipped = integers(bits * MULTIPLIER, ties)
    while skipped >= ones(tied):  # further on, in a row of more than 64
        skipped, first = skipped - ones(tied), first + WORD
        tied = ties_in_word(table, row, changed, first, best)
    flag = TIED if ties > np.uint64(1) else np.uint64(0)
    return best, (first + nth_one(tied, skipped)) | flag


@overloaded()
def greedy_action(view, state, bits):
    """Return a greedy action, drawn anew among several and then flagged; changes nothing."""


@overloaded()
def acting_row(view, state, out):
    """Write the values that the policy acts on in a state into `out`, (1, A)."""


class Values(NamedTuple):
    """Fixed values of every pair."""

    values: FloatTable  # (n S, A)
    apart: np.uint64 = np.uint64(1)  # n, the rows from a state to the next


@greedy_action.body(Values)
def _greedy_on_values(view, state, bits):
    return best_of(view.values, state * view.apart, bits)[1]


@acting_row.body(Values)
def _row_of_values(view, state, out):
    for action in range(out.shape[1]):
        out[0, action] = view.values[state * view.apart, action]


class VisitedValues(NamedTuple):
    """Fixed values of the R states that were visited; elsewhere all actions tie."""

    states: IntArray  # (R,) ascending
    values: FloatTable  # (R, A)

    @classmethod
    def none(cls, n_actions: int) -> "VisitedValues":
        """Return the view without a visited state: the uniformly random policy is greedy on it."""
        return cls(frozen(np.zeros(0, np.int64)), frozen(np.zeros((0, n_actions))))


@greedy_action.body(VisitedValues)
def _greedy_where_visited(view, state, bits):
    above = first_above(view.states, np.int64(state))
    if above > np.uint64(0) and view.states[above - np.uint64(1)] == np.int64(state):
        return best_of(view.values, above - np.uint64(1), bits)[1]
    return integers(bits * MULTIPLIER, np.uint64(view.values.shape[1])) | TIED
