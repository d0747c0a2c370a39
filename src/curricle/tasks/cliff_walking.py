"""CliffWalking: along the edge of a cliff to the goal (Sutton & Barto 2018, example 6.6).

Gymnasium's ``CliffWalking-v1``, of any size: the start is at the bottom left, the goal at the
bottom right, and between them lies the cliff. A step into the cliff leads back to the start; the
episode goes on.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray
from curricle.tasks.domain import (
    Cell,
    CellDomain,
    Discount,
    MapStart,
    TimeLimit,
    family_of,
    slipping,
)
from curricle.tasks.family import ComponentsByName, Rule
from curricle.tasks.mdp import FiniteMDP

ROWS, COLUMNS = 4, 12  # of Gymnasium's cliff
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
        At the bottom left, in any cell but the cliff and the goal, or in one of these cells.
    discount, time_limit
        As in :class:`FiniteMDP`; Gymnasium's has no time limit.

    Examples
    --------
    >>> from curricle import solve
    >>> walk = CliffWalking()
    >>> round(solve(walk).start_value, 3), round(-(1 - 0.99**13) / (1 - 0.99), 3)  # 13 steps
    (-12.248, -12.248)
    >>> CliffWalking(columns=4).states.label(0)
    'row=0 column=8'
    """

    rows: Annotated[int, Rule(2, LARGEST_SIDE, "larger")] = ROWS
    columns: Annotated[int, Rule(3, LARGEST_SIDE, "larger")] = COLUMNS
    slippery: Annotated[bool, Rule(harder="larger")] = False
    step_reward: float = -1.0
    cliff_reward: float = -100.0
    start: MapStart = "map"
    discount: Discount = 0.99
    time_limit: TimeLimit = None

    OBJECTS: ClassVar = {"C": "pit", "G": "goal"}  # pits that end no episode
    ENDS = "G"

    @property
    def origin(self) -> Cell:
        """Row and column of the top-left cell."""
        return ROWS - self.rows, COLUMNS - self.columns

    @cached_property
    def _grid(self) -> npt.NDArray[np.str_]:
        grid = np.full((self.rows, self.columns), ".")
        grid[-1] = ["S", *"C" * (self.columns - 2), "G"]
        return grid

    @property
    def goal_states(self) -> BoolArray:
        """Which states are the goal, (S,) bool."""
        return self._holds("G")

    @property
    def _standing(self) -> BoolArray:
        return ~self._holds("CG")

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The walk as tables: on slippery ground O = to the one side, ahead, to the other side."""
        to = self._landing()
        after = slipping(to) if self.slippery else to[:, :, None]
        fallen = self._holds("C")[after]
        return self._tables(
            1 / after.shape[2],
            np.where(fallen, self._holds("S").argmax(), after),
            np.where(fallen, self.cliff_reward, self.step_reward),
            terminal=self.goal_states,
            starting=self._start_states(),
        )


cliff_walking_family = family_of(CliffWalking, mapping=ComponentsByName("clip"))
"""Walks along a cliff (:class:`CliffWalking`).

Members map cell by cell, counted from the goal; cells farther off than the source has are read at
its edge.
"""
