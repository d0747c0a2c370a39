"""CliffWalking: along the edge of a cliff to the goal (Sutton & Barto 2018, example 6.6).

Gymnasium's ``CliffWalking-v1``, of any size: the start is at the bottom left, the goal at the
bottom right, and between them lies the cliff. A step into the cliff costs 100 and leads back to the
start; the episode goes on. On slippery ground a move goes where it was meant to with probability
1/3, and to either side with probability 1/3 each.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from curricle.arrays import BoolArray, IntArray, frozen
from curricle.checks import instance
from curricle.errors import TaskError
from curricle.tasks.domain import (
    Cell,
    CellDomain,
    cell_space,
    check_sizes,
    check_starts,
    landing_or_staying,
    read_start,
    tables_of,
)
from curricle.tasks.frozen_lake import slipping
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import Space

ROWS, COLUMNS = 4, 12
"""Of Gymnasium's cliff."""
LARGEST_SIDE = 1000


@dataclass(frozen=True)
class CliffWalking(CellDomain):
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
        check_sizes(self, rows=(2, LARGEST_SIDE), columns=(3, LARGEST_SIDE))
        instance("slippery", self.slippery, bool, TaskError)
        check_numbers(self, ("step_reward", "cliff_reward"))
        check_horizon(self)
        read_start(self, example="[(2, 11)]")
        self._start_states()

    # -- spaces --------------------------------------------------------------------------------

    @property
    def origin(self) -> Cell:
        """Row and column of the top-left cell."""
        return ROWS - self.rows, COLUMNS - self.columns

    @cached_property
    def states(self) -> Space:
        """One state for each cell, the cliff's too, where nobody ever stands."""
        return cell_space(self.rows, self.columns, self.origin)

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
        to = landing_or_staying(self.states)
        after = slipping(to) if self.slippery else to[:, :, None]
        fallen = self._cliff[after]
        return tables_of(
            self,
            1 / after.shape[2],
            np.where(fallen, self._first, after),
            np.where(fallen, self.cliff_reward, self.step_reward),
            terminal=self.goal_states,
            starting=self._start_states(),
        )

    @property
    def _first(self) -> int:
        """The state at the bottom left."""
        return (self.rows - 1) * self.columns

    def _start_states(self) -> IntArray:
        standing = ~(self._cliff | self.goal_states)
        if isinstance(self.start, str):
            return np.array([self._first]) if self.start == "map" else np.flatnonzero(standing)
        row, column = np.array(self.start).T
        states = self.states.encode(row=row, column=column)
        rule = "a start must be a cell beside the cliff and the goal"
        return check_starts(states, standing, self.start, rule)
