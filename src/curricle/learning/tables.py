"""The table a Q-learner fills, with each row's best value and greedy action kept at hand.

Two kinds, which a loop reads alike: :class:`Dense` has a row for every state, :class:`Sparse` for
the states met so far, each made from the potential when its state is first met.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.learning.exploration import TIED, best_of
from curricle.learning.value_lookup import Reading, read_row
from curricle.tasks.draws import inlined, splitmix64
from curricle.tasks.overloads import Overloaded
from curricle.tasks.simd import of_width

FloatTable = npt.NDArray[np.floating[Any]]


Number = tuple[None, ...]
"""A number as a type, by its length: loops are compiled for each."""


class Dense(NamedTuple):
    """A row for every state: a state's row is the state."""

    q: FloatTable  # (S, A)
    best: FloatTable  # (S,) max_a q(s, a)
    greedy: npt.NDArray[np.uint16]  # (S,) an action that attains it, flagged where several do
    key: np.uint64  # of the ties before learning
    width: Number  # A where loops along a row are to be unrolled, else 0
    far: Number  # 1 where rows come late from memory, else 0


class Sparse(NamedTuple):
    """Rows for the states met so far, found by hashing; R at most. Row 0 is no state's."""

    q: FloatTable  # (R, A)
    best: FloatTable  # (R,)
    greedy: npt.NDArray[np.uint16]  # (R,)
    phi: npt.NDArray[np.float64]  # (A,) room for a potential's row
    row: FloatTable  # (1, A) room for a table's row
    states: npt.NDArray[np.uint64]  # (R,) the state of each row
    slots: npt.NDArray[np.int32]  # (2^h,) a row, or 0 where empty; open addressing
    used: npt.NDArray[np.int64]  # (1,) rows made so far, row 0 among them
    reading: Reading
    key: np.uint64  # of the ties in fresh rows
    width: Number  # A where loops along a row are to be unrolled, else 0
    far: Number  # 1 where rows come late from memory, else 0


def prepare(table):
    """Fill in what is kept of the rows that there are before learning."""


def place(table, state, over):
    """Return the row of a state, made if need be; R where no room is left.

    A state in which the episode is over needs no row: any is returned.
    """


def is_full(table, row):
    """Return whether a row is out of range because no room was left for it."""


def greedy_of(view, state, bits):
    """Return a greedy action, drawn afresh among several and then flagged; changes nothing."""


def acting_row(view, state, out):
    """Write the values that the policy acts on in a state into `out`, (1, A)."""


preparations, places, limits = Overloaded(prepare), Overloaded(place), Overloaded(is_full)
greedies, acting_rows = Overloaded(greedy_of), Overloaded(acting_row)


@inlined
def first_choice(key, state):
    """Return the bits that break the ties of a fresh row; the same in either kind of table."""
    return splitmix64(key ^ splitmix64(state))


# -- dense ---------------------------------------------------------------------------------------


@preparations.body(Dense)
def _look_through(table):
    q = of_width(table.q, table.width)
    for state in range(np.uint64(q.shape[0])):
        bits = first_choice(table.key, state)
        table.best[state], table.greedy[state] = best_of(q, state, bits)


@places.body(Dense)
def _dense_place(table, state, over):
    return state


@limits.body(Dense)
def _never(table, row):
    return False


@greedies.body(Dense)
def _dense_greedy(view, state, bits):
    greedy = np.uint64(view.greedy[state])
    if greedy >= TIED:
        greedy = best_of(of_width(view.q, view.width), state, bits)[1]
    return greedy


@acting_rows.body(Dense)
def _dense_row(view, state, out):
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
def make_row(table, state, slot):
    """Make the row of a state out of the potential, and return it; R where no room is left."""
    row = np.uint64(table.used[0])
    if row < table.q.shape[0]:
        read_row(table.reading, state, table.phi)
        for action in range(table.q.shape[1]):
            table.q[row, action] = table.phi[action]
        bits = first_choice(table.key, state)
        table.best[row], table.greedy[row] = best_of(table.q, row, bits)
        table.states[row] = state
        table.slots[slot] = np.int32(row)
        table.used[0] += 1
    return row


@preparations.body(Sparse)
def _nothing_yet(table):
    pass


@places.body(Sparse)
def _sparse_place(table, state, over):
    if over:
        return np.uint64(0)
    slot = find(table, state)
    if table.slots[slot] != 0:
        return np.uint64(table.slots[slot])
    return make_row(table, state, slot)


@limits.body(Sparse)
def _when_spent(table, row):
    return row >= np.uint64(table.q.shape[0])


@inlined
def unmade_row(view, state):
    """Write the row of a state not met as it would be made into the room for it."""
    read_row(view.reading, state, view.phi)
    for action in range(view.row.shape[1]):
        view.row[0, action] = view.phi[action]


@greedies.body(Sparse)
def _sparse_greedy(view, state, bits):
    found = view.slots[find(view, state)]
    if found == 0:
        unmade_row(view, state)
        return best_of(view.row, 0, bits)[1]
    row = np.uint64(found)
    greedy = np.uint64(view.greedy[row])
    if greedy >= TIED:
        greedy = best_of(view.q, row, bits)[1]
    return greedy


@acting_rows.body(Sparse)
def _sparse_row(view, state, out):
    found = view.slots[find(view, state)]
    if found == 0:
        unmade_row(view, state)
    for action in range(out.shape[1]):
        if found == 0:
            out[0, action] = view.row[0, action]
        else:
            out[0, action] = view.q[np.uint64(found), action]


@njit(cache=True, nogil=True)
def reorder(table, order):
    """Put the rows of a table in order, in place: row i becomes what row order[i] was.

    `order` is used up.
    """
    room = np.empty(table.shape[1], table.dtype)
    for first in range(order.shape[0]):
        here = first
        room[:] = table[first]
        while order[here] >= 0:  # along one cycle of the permutation
            there = order[here]
            order[here] = -1
            table[here] = room if there == first else table[there]
            here = there
