"""Storage of values: precision and memory limit, and the dense and sparse tables of Q-learning."""

import re
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.arrays import FloatArray, FloatTable, Frozen, IntArray
from curricle.checks import instance, one_of, physical_memory, whole_number
from curricle.errors import SettingError
from curricle.learning.value_lookup import ValueLookup, read_row
from curricle.planning.greedy import ONLY_ROW, TIED, Values, acting_row, best_of, greedy_action
from curricle.planning.policy_evaluation import fixed_values
from curricle.tasks.kernel import compiled_once, inlined, of_width, overloaded, splitmix64
from curricle.tasks.mdp import GenerativeModel
from curricle.tasks.models import close_row
from curricle.text import brief_repr

UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9}
UNITS |= {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
ROW_EXTRAS = 4 + 8 + 4 * 4
"""Bytes of a sparse row besides its values and their maximum: greedy action, state, slots."""
COUNT = 8  # bytes of the count of a pair's updates


@dataclass(frozen=True)
class Storage:
    """How the values that :func:`learn` computes are stored.

    Neither the kind of table nor a memory limit that suffices changes a curve.

    Parameters
    ----------
    kind : {"auto", "dense", "sparse"}
        A row for every state, or for those visited, filled from the potential at the first visit.
        "auto" is dense where that fits the memory limit, and sparse for a :class:`Portfolio` of
        more than 10 million pairs. Only Q-learning without shaping, or with
        :class:`QInitialisation` or :class:`LookAheadAdvice`, can be sparse.
    dtype : {"float64", "float32"}
        Precision of the values, and of the computations of plain Q-learning.
    memory_limit : int or str, optional
        Bytes that all tables of a call of :func:`learn` may take, such as ``"4 GiB"``; half of the
        machine's memory by default. A sparse run stops before a state that would not fit, with
        :attr:`LearningResult.out_of_memory` set.
    save_values : bool
        Whether the result has the values. Without them only the seeds that are trained at the same
        time need memory.

    Raises
    ------
    SettingError
        On an unknown kind or precision, or an invalid size.

    Examples
    --------
    >>> Storage(dtype="float32", memory_limit="1.5 GiB").limit
    1610612736
    """

    kind: Literal["auto", "dense", "sparse"] = "auto"
    dtype: Literal["float64", "float32"] = "float64"
    memory_limit: int | str | None = None
    save_values: bool = True

    def __post_init__(self) -> None:
        one_of("kind of storage", self.kind, ("auto", "dense", "sparse"), SettingError)
        one_of("dtype", self.dtype, ("float64", "float32"), SettingError)
        instance("save_values", self.save_values, bool, SettingError)
        _ = self.limit

    @property
    def limit(self) -> int:
        """The memory limit in bytes."""
        if self.memory_limit is None:
            return physical_memory() // 2
        if not isinstance(self.memory_limit, str):
            return whole_number("memory_limit in bytes", self.memory_limit, 1, SettingError)
        match = re.fullmatch(r"\s*([0-9]{1,18}(?:\.[0-9]*)?)\s*([A-Za-z]+)\s*", self.memory_limit)
        if not match or match[2] not in UNITS or float(match[1]) * UNITS[match[2]] < 1:
            raise SettingError(
                "memory_limit must be 1 byte or more, or a number with one of "
                f"{', '.join(UNITS)}: got {self.memory_limit!r}"
            )
        return int(float(match[1]) * UNITS[match[2]])

    def dense_bytes(self, n_states: int, n_actions: int, tables: int, counts: int = 0) -> int:
        """Return the bytes of one seed's dense tables, `counts` of them of counted updates."""
        size = np.dtype(self.dtype).itemsize
        return n_states * (n_actions * (tables * size + counts * COUNT) + size + 4)

    def rows_within(self, limit: int, n_actions: int, counts: int = 0) -> int:
        """Return how many rows of a sparse table fit, its counted updates included."""
        size = np.dtype(self.dtype).itemsize
        return limit // ((n_actions + 1) * size + n_actions * counts * COUNT + ROW_EXTRAS)


def rows_allowed(
    storage: Storage, task: GenerativeModel, *, tables: int, counts: int, seeds: int, steps: int
) -> int:
    """Return the states a sparse table may have rows for, or 0 if tables are dense.

    `seeds` seeds at a time hold `tables` of values and `counts` of updates, up to `steps` steps.
    SettingError when dense tables that were asked for exceed the memory limit.
    """
    n_states, n_actions = task.states.size, task.actions.size
    needed = seeds * storage.dense_bytes(n_states, n_actions, tables, counts)
    if storage.kind == "dense" or (storage.kind == "auto" and needed <= storage.limit):
        if needed > storage.limit:
            raise SettingError(
                f"the values of {seeds} seeds must fit the memory_limit of the storage, "
                f"{storage.limit / 1e9:.3g} GB: {n_states:,} states x {n_actions:,} actions in "
                f"{storage.dtype} take {needed / 1e9:.3g} GB; see also dtype, save_values and kind"
            )
        return 0
    fitting = storage.rows_within(storage.limit // seeds // tables, n_actions, counts)
    # A step visits one state, and another when it starts an episode.
    return max(1, min(fitting, n_states, 2 * steps + 1, (2**31 - 2) // tables))


@dataclass(frozen=True, eq=False)
class SparseValues(Frozen):
    """Values of the R states that learning visited.

    Attributes
    ----------
    states : (R,) int64
        Ascending.
    values : (R, A) float64 or float32
        Q of each state.

    Examples
    --------
    >>> SparseValues(np.array([3, 8]), np.array([[1.0, 2.0], [3.0, 4.0]])).at([8])
    array([[3., 4.]])
    """

    states: IntArray
    values: FloatTable

    __repr__ = brief_repr

    def at(self, states: npt.ArrayLike) -> FloatTable:
        """Return the values of these states, (..., A); SettingError if one was not visited."""
        wanted = np.asarray(states)
        row = np.minimum(np.searchsorted(self.states, wanted), len(self.states) - 1)
        if (self.states[row] != wanted).any():
            missing = wanted[self.states[row] != wanted].flat[0]
            raise SettingError(f"sparse values hold visited states only: {missing} was not visited")
        return self.values[row]


# -- tables of Q-learning, with the maximum and a greedy action of each row ---------------------


StaticInt = tuple[None, ...]  # a number as a type, the tuple's length: loops are compiled for each


class DenseTable(NamedTuple):
    """A row for every state: a state's row is the state. Or n tables, whose rows alternate."""

    q: FloatTable  # (n S, A)
    row_max: FloatTable  # (n S,) max_a q(s, a)
    row_argmax: npt.NDArray[np.uint16]  # (n S,) an action that attains it, flagged where several do
    key: np.uint64  # breaks the ties before learning
    n: StaticInt  # as loops read it
    apart: np.uint64  # n as evaluation reads it, which is compiled once for all n
    width: StaticInt  # A where loops along a row are to be unrolled, else 0
    far: StaticInt  # 1 where the table exceeds the nearest cache, else 0


class SparseTable(NamedTuple):
    """n rows for each state visited so far, by hashing; R at most. The first n have no state."""

    q: FloatTable  # (R, A)
    row_max: FloatTable  # (R,)
    row_argmax: npt.NDArray[np.uint16]  # (R,)
    phi: FloatArray  # (A,) work space: a row of the potential
    row: FloatTable  # (1, A) work space: a row of the table
    states: npt.NDArray[np.uint64]  # (R,) the state of each first row
    slots: npt.NDArray[np.int32]  # (2^h,) a state's first row, or 0 where empty; open addressing
    used: IntArray  # (1,) rows in use, the first n among them
    lookup: ValueLookup
    starts: FloatArray  # (n, 3) what is added to phi in each row, and what it is then cut to
    available: Any  # which actions can be taken, as a generative model has them; None for all
    key: np.uint64  # breaks the ties of new rows
    n_states: np.uint64
    n: StaticInt
    width: StaticInt  # A where loops along a row are to be unrolled, else 0
    far: StaticInt  # 1 where the table exceeds the nearest cache, else 0


# Rows of no state alone exist before a sparse table learns.
@overloaded(otherwise=lambda table: None)
def find_row_maxima(table):
    """Fill in the maxima of the rows that exist before learning."""


@overloaded()
def row_of(table, state, terminated):
    """Return a state's first row, added if need be; R where the table is full; any after an end."""


@overloaded(otherwise=lambda table, row: False)
def is_full(table, row):
    """Return whether a row is out of range because the table was full."""


@inlined
def tie_bits(key, state):
    """Return the bits that break the ties of a new row; the same in either kind of table."""
    return splitmix64(key ^ splitmix64(state))


class Change(NamedTuple):
    """An update of a pair of the row that an action was taken in."""

    action: np.uint64
    rate: float
    target: float
    bits: np.uint64  # break a tie


@inlined
def update(q, best, greedy, row, change):
    """Move q(row, action) towards the target, and update the row's maximum and greedy action."""
    action = change.action
    old = q[row, action]
    new = q.dtype.type(old + change.rate * (change.target - old))
    if new != old:
        # A vector that is read just after one of its values was written makes the processor wait.
        if new > best[row]:
            best[row], greedy[row] = new, action
        elif old == best[row] or new == best[row]:
            best[row], greedy[row] = best_of(q, row, change.bits, (action, new))
        q[row, action] = new
    elif np.uint64(greedy[row]) == action | TIED:
        greedy[row] = best_of(q, row, change.bits)[1]  # each visit draws afresh among several


# -- dense ---------------------------------------------------------------------------------------


@find_row_maxima.body(DenseTable)
def _find_dense_maxima(table):
    q, n = of_width(table.q, table.width), np.uint64(len(table.n))
    n_states = np.uint64(q.shape[0]) // n
    for row in range(np.uint64(q.shape[0])):
        bits = tie_bits(table.key, row % n * n_states + row // n)
        table.row_max[row], table.row_argmax[row] = best_of(q, row, bits)


@row_of.body(DenseTable)
def _dense_row_of(table, state, terminated):
    return state * np.uint64(len(table.n))


@greedy_action.body(DenseTable)
def _dense_greedy(view, state, bits):
    row = state * view.apart
    greedy = np.uint64(view.row_argmax[row])
    if greedy >= TIED:
        greedy = best_of(of_width(view.q, view.width), row, bits)[1]
    return greedy


@acting_row.body(DenseTable)
def _dense_acting_row(view, state, out):
    for action in range(out.shape[1]):
        out[0, action] = view.q[state * view.apart, action]


@fixed_values.body(DenseTable)
def _dense_values(view):
    return Values(view.q, view.apart)


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
    """Add the rows of a state, filled from phi, and return the first; R where the table is full."""
    first, n = np.uint64(table.used[0]), np.uint64(len(table.n))
    if first < table.q.shape[0]:
        read_row(table.lookup, state, table.phi)
        for k in range(n):
            added, lowest, highest = table.starts[k]
            for action in range(table.q.shape[1]):
                start = table.phi[action] + added
                start = start if start <= highest else highest  # NaN, unknown, too
                table.q[first + k, action] = start if start >= lowest else lowest
            if n == 1 or k + 1 < n:  # the last of several counts visits
                close_row(table.available, state, table.q, first + k)
            bits = tie_bits(table.key, k * table.n_states + state)  # as for dense tables
            best = best_of(table.q, first + k, bits)
            table.row_max[first + k], table.row_argmax[first + k] = best
        table.states[first] = state
        table.slots[slot] = np.int32(first)
        table.used[0] += len(table.n)
    return first


@row_of.body(SparseTable)
def _sparse_row_of(table, state, terminated):
    if terminated:
        return np.uint64(0)
    slot = find(table, state)
    if table.slots[slot] != 0:
        return np.uint64(table.slots[slot])
    return add_row(table, state, slot)


@is_full.body(SparseTable)
def _sparse_is_full(table, row):
    return row >= np.uint64(table.q.shape[0])


@inlined
def row_or_none(view, state):
    """Return the row of a state; 0 if it was not visited: the one it would get is ``view.row``."""
    row = np.uint64(view.slots[find(view, state)])
    if row == np.uint64(0):
        read_row(view.lookup, state, view.phi)
        for action in range(view.row.shape[1]):
            view.row[0, action] = view.phi[action]
        close_row(view.available, state, view.row, 0)
    return row


@greedy_action.body(SparseTable)
def _sparse_greedy(view, state, bits):
    row = row_or_none(view, state)
    if row == np.uint64(0):
        return best_of(view.row, ONLY_ROW, bits)[1]
    greedy = np.uint64(view.row_argmax[row])
    return best_of(view.q, row, bits)[1] if greedy >= TIED else greedy


@acting_row.body(SparseTable)
def _sparse_acting_row(view, state, out):
    row = row_or_none(view, state)
    for action in range(out.shape[1]):
        out[0, action] = view.row[0, action] if row == np.uint64(0) else view.q[row, action]


@compiled_once
def reorder(table, order):
    """Put the rows of a table in order, in place: row i becomes what row order[i] was."""
    # `order` is overwritten. Values are moved singly: NumPy's assignment of rows would take seconds
    # to compile.
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
