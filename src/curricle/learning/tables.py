"""The table that a Q-learner fills, with the maximum and a greedy action of each row cached.

Two kinds with one interface: :class:`DenseTable` has a row for every state, :class:`SparseTable`
one for each state visited so far, filled from the potential on the first visit.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.arrays import FloatArray, FloatTable, IntArray
from curricle.learning.value_lookup import ValueLookup, read_row
from curricle.planning.greedy import TIED, acting_rows, best_of, greedy_actions
from curricle.tasks.draws import splitmix64
from curricle.tasks.loop_cache import compiled_once
from curricle.tasks.overloads import Overloaded, inlined
from curricle.tasks.simd import of_width

StaticInt = tuple[None, ...]
"""A number as a type, the tuple's length: loops are compiled for each."""


class DenseTable(NamedTuple):
    """A row for every state: a state's row is the state."""

    q: FloatTable  # (S, A)
    row_max: FloatTable  # (S,) max_a q(s, a)
    row_argmax: npt.NDArray[np.uint16]  # (S,) an action that attains it, flagged where several do
    key: np.uint64  # breaks the ties before learning
    width: StaticInt  # A where loops along a row are to be unrolled, else 0
    far: StaticInt  # 1 where the table exceeds the nearest cache, else 0


class SparseTable(NamedTuple):
    """Rows for the states visited so far, found by hashing; R at most. Row 0 has no state."""

    q: FloatTable  # (R, A)
    row_max: FloatTable  # (R,)
    row_argmax: npt.NDArray[np.uint16]  # (R,)
    phi: FloatArray  # (A,) work space: a row of the potential
    row: FloatTable  # (1, A) work space: a row of the table
    states: npt.NDArray[np.uint64]  # (R,) the state of each row
    slots: npt.NDArray[np.int32]  # (2^h,) a row, or 0 where empty; open addressing
    used: IntArray  # (1,) rows in use, row 0 among them
    lookup: ValueLookup
    key: np.uint64  # breaks the ties of new rows
    width: StaticInt  # A where loops along a row are to be unrolled, else 0
    far: StaticInt  # 1 where the table exceeds the nearest cache, else 0


def find_row_maxima(table):
    """Fill in the maxima of the rows that exist before learning."""


def row_of(table, state, terminated):
    """Return the row of a state, added if need be; R where the table is full.

    A state in which the episode has terminated needs no row: any is returned.
    """


def is_full(table, row):
    """Return whether a row is out of range because the table was full."""


row_maxima, rows_of = Overloaded(find_row_maxima), Overloaded(row_of)
full_tables = Overloaded(is_full)


@inlined
def tie_bits(key, state):
    """Return the bits that break the ties of a new row; the same in either kind of table."""
    return splitmix64(key ^ splitmix64(state))


# -- dense ---------------------------------------------------------------------------------------


@row_maxima.body(DenseTable)
def _find_dense_maxima(table):
    q = of_width(table.q, table.width)
    for state in range(np.uint64(q.shape[0])):
        bits = tie_bits(table.key, state)
        table.row_max[state], table.row_argmax[state] = best_of(q, state, bits)


@rows_of.body(DenseTable)
def _dense_row_of(table, state, terminated):
    return state


@full_tables.body(DenseTable)
def _dense_is_full(table, row):
    return False


@greedy_actions.body(DenseTable)
def _dense_greedy(view, state, bits):
    greedy = np.uint64(view.row_argmax[state])
    if greedy >= TIED:
        greedy = best_of(of_width(view.q, view.width), state, bits)[1]
    return greedy


@acting_rows.body(DenseTable)
def _dense_acting_row(view, state, out):
    for action in range(out.shape[1]):
        out[0, action] = view.q[state, action]


# -- sparse --------------------------------------------------------------------------------------


@inlined
def find(table, state):
    """Return the slot where a state's row is, or where it would go."""
    last = np.uint64(table.slots.shape[0] - 1)
    slot = splitmix64(state) & last
    while table.slots[slot] != 0:
        if table.states[np.uint64(table.slots[slot])] == state:
            break
        slot = (slot + np.uint64(1)) & last
    return slot


@njit(nogil=True)
def add_row(table, state, slot):
    """Add the row of a state, filled from the potential, and return it; R where it is full."""
    row = np.uint64(table.used[0])
    if row < table.q.shape[0]:
        read_row(table.lookup, state, table.phi)
        for action in range(table.q.shape[1]):
            table.q[row, action] = table.phi[action]
        bits = tie_bits(table.key, state)
        table.row_max[row], table.row_argmax[row] = best_of(table.q, row, bits)
        table.states[row] = state
        table.slots[slot] = np.int32(row)
        table.used[0] += 1
    return row


@row_maxima.body(SparseTable)
def _no_rows_yet(table):
    pass


@rows_of.body(SparseTable)
def _sparse_row_of(table, state, terminated):
    if terminated:
        return np.uint64(0)
    slot = find(table, state)
    if table.slots[slot] != 0:
        return np.uint64(table.slots[slot])
    return add_row(table, state, slot)


@full_tables.body(SparseTable)
def _sparse_is_full(table, row):
    return row >= np.uint64(table.q.shape[0])


@inlined
def row_to_be_added(view, state):
    """Write the row that a state not yet visited would get into the work space."""
    read_row(view.lookup, state, view.phi)
    for action in range(view.row.shape[1]):
        view.row[0, action] = view.phi[action]


@greedy_actions.body(SparseTable)
def _sparse_greedy(view, state, bits):
    found = view.slots[find(view, state)]
    if found == 0:
        row_to_be_added(view, state)
        return best_of(view.row, 0, bits)[1]
    row = np.uint64(found)
    greedy = np.uint64(view.row_argmax[row])
    if greedy >= TIED:
        greedy = best_of(view.q, row, bits)[1]
    return greedy


@acting_rows.body(SparseTable)
def _sparse_acting_row(view, state, out):
    found = view.slots[find(view, state)]
    if found == 0:
        row_to_be_added(view, state)
    for action in range(out.shape[1]):
        if found == 0:
            out[0, action] = view.row[0, action]
        else:
            out[0, action] = view.q[np.uint64(found), action]


@compiled_once
def reorder(table, order):
    """Put the rows of a table in order, in place: row i becomes what row order[i] was.

    `order` is overwritten. Values are moved one by one: NumPy's assignment of rows would take
    seconds to compile.
    """
    kept = np.empty(table.shape[1], table.dtype)
    for first in range(order.shape[0]):
        here = first
        for column in range(kept.shape[0]):
            kept[column] = table[first, column]
        while order[here] >= 0:  # along one cycle of the permutation
            there = order[here]
            order[here] = -1
            for column in range(kept.shape[0]):
                table[here, column] = kept[column] if there == first else table[there, column]
            here = there
