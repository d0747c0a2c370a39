"""Four rooms: a grid of rooms joined by hallways, in which moves slip.

Sutton, Precup, Singh 1999, "Between MDPs and semi-MDPs: a framework for temporal abstraction in
reinforcement learning", section 3 and figure 2: 104 cells on a 13x13 grid, walls included. A move
north, east, south or west goes that way with probability 2/3 and each of the other three ways with
1/9; a move into a wall leaves the agent where it is. Rewards are 0 but for entering the goal, and
the discount is 0.9. One of the paper's goals is the hallway between the two rooms in the east, the
default here. ::

    #############
    #     #     #
    #     #     #
    #           #
    #     #     #
    #     #     #
    ## ####     #
    #     ### ###
    #     #     #
    #     #     #
    #           #
    #     #     #
    #############

Other sizes have the same plan: the wall between west and east in the middle, the wall between north
and south there in the west and one row further south in the east, a hallway in each.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from curricle.arrays import BoolArray, IntArray, frozen
from curricle.errors import TaskError
from curricle.tasks.domain import (
    MOVES,
    Cell,
    Domain,
    cell_space,
    check_part,
    check_sizes,
    check_starts,
    landing_or_staying,
    read_start,
    tables_of,
)
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import MISSING, Space, whole

SMALLEST_SIZE, LARGEST_SIZE = 7, 1000
"""Cells per side, walls included."""


@dataclass(frozen=True)
class FourRooms(Domain):
    """Four rooms joined by hallways; entering the goal ends the episode.

    Parameters
    ----------
    size : int
        Cells per side, outer walls included, 7 to 1000.
    slip : float
        Probability that a move goes another way, each of the three equally likely.
    goal : {"north", "east", "south", "west"} or (int, int)
        A hallway (that between the two rooms in the north, and so on), or a row and a column.
    step_reward, goal_reward : float
        Of a step that does not / does enter the goal.
    start : "corner", "uniform" or cells
        In the first free cell in reading order, in any cell but the goal, or in one of the given
        ``(row, column)`` cells; all are equally likely.
    rows, columns : (int, int), optional
        Half-open ranges: the part of the plan that the task has, all by default.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        When a size, a probability, a reward, the goal or a start is invalid.

    Examples
    --------
    >>> rooms = FourRooms()
    >>> rooms.states.size, rooms.goal_cell
    (104, (7, 9))
    >>> room = rooms.crop(rows=(7, 12), columns=(7, 12))
    >>> room.states.size  # the room in the south-east and the goal north of it
    21
    """

    size: int = 13
    slip: float = 1 / 3
    goal: Any = "east"
    step_reward: float = 0.0
    goal_reward: float = 1.0
    start: Any = "corner"
    rows: tuple[int, int] | None = None
    columns: tuple[int, int] | None = None
    discount: float = 0.9
    time_limit: int | None = 500

    def __post_init__(self) -> None:
        check_sizes(self, size=(SMALLEST_SIZE, LARGEST_SIZE))
        check_numbers(self, ("step_reward", "goal_reward"), ("slip",))
        for name in ("rows", "columns"):
            part = getattr(self, name)
            if part is not None:
                check_part(name, part, 0, self.size)
                object.__setattr__(self, name, (int(part[0]), int(part[1])))
        check_horizon(self)
        self._check_goal()
        read_start(self, ("corner", "uniform"), "[(1, 1)]")
        self._start_states()

    def _check_goal(self) -> None:
        """Check the goal and make one that is a cell two ints."""
        if isinstance(self.goal, str):
            if self.goal not in MOVES:
                known = ", ".join(map(repr, MOVES))
                raise TaskError(
                    f"goal must be one of the hallways {known}, or a row and a column: got "
                    f"{self.goal!r}"
                )
        else:
            cell = whole(self.goal, "the goal's row and column")
            if cell.shape != (2,):
                raise TaskError(f"goal must be a hallway, or a row and a column: got {self.goal!r}")
            object.__setattr__(self, "goal", (int(cell[0]), int(cell[1])))
        row, column = self.goal_cell
        if self.states.encode(row=row, column=column) == MISSING:
            raise TaskError(f"the goal needs a free cell of the rooms: got ({row}, {column})")

    # -- variants ------------------------------------------------------------------------------

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: Any = "uniform"
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in the same coordinates.

        A move off the part leaves the agent where it is.

        Raises
        ------
        TaskError
            When the part exceeds this one, is empty, or does not have the goal.
        """
        (top, bottom), (left, right) = self._part
        check_part("rows", rows, top, bottom - top)
        check_part("columns", columns, left, right - left)
        return replace(self, rows=rows, columns=columns, goal=self.goal_cell, start=start)

    # -- spaces --------------------------------------------------------------------------------

    @property
    def hallways(self) -> dict[str, Cell]:
        """The cell of each hallway: between the rooms in the north, the east, the south, the west.

        Examples
        --------
        >>> FourRooms().hallways
        {'north': (3, 6), 'east': (7, 9), 'south': (10, 6), 'west': (6, 2)}
        """
        half, sixth = self.size // 2, (self.size - 1) // 6
        return {
            "north": (self.size // 4, half),
            "east": (half + 1, half + half // 2),
            "south": (self.size - 1 - sixth, half),
            "west": (half, sixth),
        }

    @property
    def goal_cell(self) -> Cell:
        """Row and column of the goal."""
        cell: Cell = self.hallways[self.goal] if isinstance(self.goal, str) else self.goal
        return cell

    @cached_property
    def states(self) -> Space:
        """One state for each cell that is not a wall."""
        (top, bottom), (left, right) = self._part
        free = np.argwhere(self._free[top:bottom, left:right]) + np.array([top, left])
        if not len(free):
            raise TaskError(
                f"a crop needs a free cell: rows {top}..{bottom} and columns {left}..{right} have "
                "none"
            )
        return cell_space(bottom - top, right - left, (top, left), free)

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        (top, bottom), (left, right) = self._part
        return GridLayout(
            cells=self.states.points,
            components=("row", "column"),
            shape=(bottom - top, right - left),
            origin=(top, left),
            objects=(("goal", *self.goal_cell, True),),
        )

    @property
    def _part(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """The rows and columns that the task has, half-open."""
        return self.rows or (0, self.size), self.columns or (0, self.size)

    @property
    def _free(self) -> BoolArray:
        """Which cells of the whole plan are no walls, (size, size) bool."""
        half = self.size // 2
        free = np.ones((self.size, self.size), bool)
        free[[0, -1]] = free[:, [0, -1]] = free[:, half] = False
        free[half, :half] = free[half + 1, half:] = False
        for row, column in self.hallways.values():
            free[row, column] = True
        return free

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The rooms as tables: a row for each pair, O = the four ways that a move may go."""
        to = landing_or_staying(self.states)[:, None, :]
        return tables_of(
            self,
            np.where(np.eye(4, dtype=bool), 1 - self.slip, self.slip / 3),
            to,
            np.where(to == self._goal_state, self.goal_reward, self.step_reward),
            terminal=np.arange(self.states.size) == self._goal_state,
            starting=self._start_states(),
        )

    @property
    def _goal_state(self) -> int:
        row, column = self.goal_cell
        return int(self.states.encode(row=row, column=column))

    def _start_states(self) -> IntArray:
        """Return the states in which episodes start; TaskError where there are none."""
        others = frozen(np.delete(np.arange(self.states.size), self._goal_state))
        if isinstance(self.start, str):
            if not len(others):
                raise TaskError("a start needs a cell that is not the goal: there is none")
            return others if self.start == "uniform" else others[:1]
        row, column = np.array(self.start).T
        states = self.states.encode(row=row, column=column)
        allowed = np.arange(self.states.size) != self._goal_state
        rule = "an episode starts in a free cell that is not the goal"
        return check_starts(states, allowed, self.start, rule)
