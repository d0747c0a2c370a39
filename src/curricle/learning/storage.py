"""Storage of values: precision, dense or sparse tables, memory limit."""

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatTable, Frozen, IntArray
from curricle.checks import instance, one_of, physical_memory, whole_number
from curricle.errors import SettingError
from curricle.tasks.task import GenerativeModel
from curricle.text import brief_repr

UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9}
UNITS |= {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
ROW_EXTRAS = 4 + 8 + 4 * 4
"""Bytes of a sparse row besides its values and their maximum: greedy action, state, slots."""
COUNT = 8
"""Bytes of the count of a pair's updates."""


@dataclass(frozen=True)
class Storage:
    """How the values that :func:`learn` computes are stored.

    Neither the kind of table nor a memory limit that suffices changes a result.

    Parameters
    ----------
    kind : {"auto", "dense", "sparse"}
        A row for every state, or for those visited, filled from the potential at the first visit.
        "auto" is dense where that fits the memory limit. Only Q-learning without shaping, or with
        :class:`QInitialisation` or :class:`LookAheadAdvice`, can be sparse.
    dtype : {"float64", "float32"}
        Precision of the values, and of what plain Q-learning computes with.
    memory_limit : int or str, optional
        Bytes that all tables of a call of :func:`learn` may take, such as ``"4 GiB"``; half of the
        machine's memory by default. A sparse run stops before a state that would not fit; its
        result has :attr:`LearningResult.out_of_memory` set.
    save_values : bool
        Whether the result has the values. Without them, memory is needed only for the seeds that
        are trained at the same time.

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
    """Return the rows a sparse table may have, or 0 if tables are dense.

    `seeds` of them hold tables at the same time, each `tables` of them and `counts` of counted
    updates, and a run has up to `steps` steps. Raises SettingError when dense tables that were
    asked for exceed the memory limit.
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
    fitting = storage.rows_within(storage.limit // seeds, n_actions, counts)
    # A step visits one state, and another when it starts an episode.
    return max(1, min(fitting, n_states, 2 * steps + 1, 2**31 - 2))


@dataclass(frozen=True, eq=False)
class SparseValues(Frozen):
    """Values of the R states that learning visited.

    Attributes
    ----------
    states : (R,) int64
        Ascending.
    values : (R, A) float64 or float32
        Q of each.

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
            raise SettingError(f"sparse values hold visited states only: {missing} is not one")
        return self.values[row]
