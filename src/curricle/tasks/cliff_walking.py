"""CliffWalking: along the edge of a cliff to the goal (Sutton & Barto 2018, example 6.6).

Gymnasium's ``CliffWalking-v1``, of any size: the start is at the bottom left, the goal at the
bottom right, and between them lies the cliff. A step into the cliff costs 100 and leads back to the
start; the episode goes on. On slippery ground a move goes where it was meant to with probability
1/3, and to either side with probability 1/3 each.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray, IntArray
from curricle.checks import indices, instance, number, whole_number
from curricle.errors import TaskError
from curricle.frozen_arrays import Frozen, frozen
from curricle.tasks.frozen_lake import moves_in_a_box, slipping
from curricle.tasks.grid_layout import MOVES, Cell, GridLayout, read_cells
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import Component, Space

ROWS, COLUMNS = 4, 12
"""Of Gymnasium's cliff."""
LARGEST_SIDE = 1000


@dataclass(frozen=True)
class CliffWalking(Frozen):
    """A walk along a cliff; the goal lies at (3, 11) in walks of every size, as in Gymnasium's.

    Parameters
    ----------
    rows, columns : int
        2 to 1000 and 3 to 1000.
    slippery : bool
        Whether a move goes to either side with probability 1/3 each.
    step_reward, cliff_reward : float
        Of a step, and of a step into the cliff.
    start : "map", "uniform" or cells
        At the bottom left, in any cell but the cliff and the goal, or in one of the given
        ``(row, column)`` cells; all are equally likely.
    discount, time_limit
        As in :class:`FiniteMDP`; Gymnasium's has no time limit.

    Raises
    ------
    TaskError
        When a size or a number is out of range, or a start is no place to stand.

    Examples
    --------
    >>> from curricle import solve
    >>> walk = CliffWalking()
    >>> round(solve(walk).start_value, 3), round(-(1 - 0.99**13) / (1 - 0.99), 3)  # 13 steps
    (-12.248, -12.248)
    >>> CliffWalking(columns=4).states.label(0)
    'row=0 column=8'
    """

    rows: int = ROWS
    columns: int = COLUMNS
    slippery: bool = False
    step_reward: float = -1.0
    cliff_reward: float = -100.0
    start: Any = "map"
    discount: float = 0.99
    time_limit: int | None = None

    def __post_init__(self) -> None:
        for name, least in (("rows", 2), ("columns", 3)):
            value = whole_number(name, getattr(self, name), least, TaskError)
            value = int(number(name, value, TaskError, least, LARGEST_SIDE))
            object.__setattr__(self, name, value)
        instance("slippery", self.slippery, bool, TaskError)
        check_numbers(self, ("step_reward", "cliff_reward"))
        check_horizon(self)
        if not isinstance(self.start, str):
            cells = read_cells(self.start, "'map', 'uniform'", "[(2, 11)]")
            object.__setattr__(self, "start", cells)
        self._start_states()

    def with_start(self, start: Literal["map", "uniform"] | Iterable[Cell]) -> Self:
        """Return the same walk with another start: ``"map"``, ``"uniform"`` or cells."""
        return replace(self, start=start)

    def start_in(self, states: npt.ArrayLike) -> Self:
        """Return the same walk with starts in these states, by number, equally likely."""
        cells = self.layout.cells[indices("start states", states, self.states.size, TaskError)]
        return self.with_start([(int(row), int(column)) for row, column in cells])

    # -- spaces --------------------------------------------------------------------------------

    @property
    def origin(self) -> Cell:
        """Row and column of the top-left cell."""
        return ROWS - self.rows, COLUMNS - self.columns

    @cached_property
    def states(self) -> Space:
        """One state for each cell, the cliff's too, where nobody ever stands."""
        row, column = self.origin
        return Space(
            [Component("row", self.rows, low=row), Component("column", self.columns, low=column)]
        )

    @cached_property
    def actions(self) -> Space:
        """The moves north, east, south and west, in Gymnasium's order."""
        return Space([Component("move", 4, labels=tuple(MOVES))])

    @property
    def goal_states(self) -> BoolArray:
        """Which states are the goal, (S,) bool."""
        return np.asarray(np.arange(self.states.size) == self.states.size - 1)

    @property
    def _cliff(self) -> BoolArray:
        """Which cells are the cliff, (S,) bool."""
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        return np.asarray((row == self.rows - 1) & (column > 0) & (column < self.columns - 1))

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures; the cliff is drawn as pits, which end no episode."""
        cells = frozen(np.stack(list(self.states.decode().values()), axis=1))
        pits = [("pit", row, column, False) for row, column in cells[self._cliff].tolist()]
        return GridLayout(
            cells=cells,
            components=("row", "column"),
            shape=(self.rows, self.columns),
            origin=self.origin,
            objects=(*pits, ("goal", *cells[-1].tolist(), True)),
        )

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The walk as tables: on slippery ground O = to the one side, ahead, to the other side."""
        landing = moves_in_a_box(self.rows, self.columns, list(MOVES.values()))
        after = slipping(landing) if self.slippery else landing[:, :, None]
        fallen, first = self._cliff[after], (self.rows - 1) * self.columns
        reward = np.where(fallen, self.cliff_reward, self.step_reward)
        width, pairs = after.shape[2], landing.size
        start = np.zeros(self.states.size)
        start[self._start_states()] = 1 / len(self._start_states())
        return FiniteMDP(
            states=self.states,
            actions=self.actions,
            outcome_row=np.arange(pairs).reshape(landing.shape),
            probability=np.full((pairs, width), 1 / width),
            next_state=np.where(fallen, first, after).reshape(pairs, width),
            reward=reward.reshape(pairs, width),
            terminal=self.goal_states,
            start=start,
            discount=self.discount,
            time_limit=self.time_limit,
        )

    def _start_states(self) -> IntArray:
        standing = ~(self._cliff | self.goal_states)
        if isinstance(self.start, str):
            if self.start not in ("map", "uniform"):
                raise TaskError(f"start must be 'map', 'uniform' or cells: got {self.start!r}")
            first = np.array([(self.rows - 1) * self.columns])
            return first if self.start == "map" else np.flatnonzero(standing)
        row, column = np.array(self.start).T
        found = self.states.encode(row=row, column=column)
        for cell, state in zip(self.start, found, strict=True):
            if state < 0 or not standing[state]:
                raise TaskError(f"a start must be a cell beside the cliff and the goal: got {cell}")
        return found
