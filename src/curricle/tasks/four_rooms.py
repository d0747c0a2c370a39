"""Four rooms joined by hallways: a grid of rooms in which moves slip."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from curricle.errors import TaskError
from curricle.tasks.domain import (
    MOVES,
    Cell,
    Discount,
    GridDomain,
    TimeLimit,
    cell_of,
    family_of,
    in_proportion,
    part_of,
)
from curricle.tasks.family import FamilyMember, Rule
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Decoded

SMALLEST_SIZE, LARGEST_SIZE = 7, 1000  # cells per side, walls included


@dataclass(frozen=True)
class FourRooms(GridDomain):
    """Four rooms joined by hallways, in which moves slip; entering the goal ends the episode.

    Sutton, Precup, Singh 1999, "Between MDPs and semi-MDPs: a framework for temporal abstraction in
    reinforcement learning", section 3 and figure 2, has the defaults and other goals besides: 104
    cells on a 13x13 grid, walls included. A move into a wall leaves the agent where it is.

    All sizes have the same plan: the wall between west and east in the middle, that between north
    and south there in the west and one row further south in the east, a hallway in each.

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
        In the first free cell, in any cell but the goal, or in one of these ``(row, column)``.
    rows, columns : (int, int), optional
        Half-open ranges: the part of the plan that the task has.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> rooms = FourRooms()
    >>> rooms.states.size, rooms.goal_cell
    (104, (7, 9))
    """

    size: Annotated[int, Rule(SMALLEST_SIZE, LARGEST_SIZE, "larger")] = 13
    slip: Annotated[float, Rule(0, 1, "larger")] = 1 / 3
    goal: Annotated[Any, Rule(values=tuple(MOVES))] = "east"
    step_reward: float = 0.0
    goal_reward: float = 1.0
    start: Annotated[Any, Rule(values=("corner", "uniform"))] = "corner"
    rows: tuple[int, int] | None = None
    columns: tuple[int, int] | None = None
    discount: Discount = 0.9
    time_limit: TimeLimit = 500

    OBJECTS: ClassVar = {"G": "goal"}
    ENDS = "G"
    LISTED = True

    def _check(self) -> None:
        for name in ("rows", "columns"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, part_of(name, getattr(self, name), 0, self.size))
        if not isinstance(self.goal, str) or self.goal not in MOVES:
            rule = f"one of the hallways {', '.join(map(repr, MOVES))}, or a row and a column"
            object.__setattr__(self, "goal", cell_of("goal", self.goal, rule))
        row, column = self.goal_cell
        if self._cell_space.encode(row=row, column=column) == MISSING:
            raise TaskError(f"the goal needs a free cell of the rooms: got ({row}, {column})")
        super()._check()

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: Any = "uniform"
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in the same coordinates.

        A move off the part leaves the agent where it is. The part must have the goal.
        """
        (top, bottom), (left, right) = self._part
        part_of("rows", rows, top, bottom - top)
        part_of("columns", columns, left, right - left)
        return replace(self, rows=rows, columns=columns, goal=self.goal_cell, start=start)

    @property
    def hallways(self) -> dict[str, Cell]:
        """The cell of each hallway: between the rooms in the north, east, south and west."""
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

    @property
    def _part(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """The rows and columns that the task has, half-open."""
        return self.rows or (0, self.size), self.columns or (0, self.size)

    @property
    def _corner(self) -> Cell:
        (top, _), (left, _) = self._part
        return top, left

    @cached_property
    def _grid(self) -> npt.NDArray[np.str_]:
        half, (top, bottom), (left, right) = self.size // 2, *self._part
        plan = np.full((self.size, self.size), ".")
        plan[[0, -1]] = plan[:, [0, -1]] = plan[:, half] = "#"
        plan[half, :half] = plan[half + 1, half:] = "#"
        for row, column in self.hallways.values():
            plan[row, column] = "."
        row, column = self.goal_cell
        if 0 <= row < self.size and 0 <= column < self.size and plan[row, column] == ".":
            plan[row, column] = "G"
        part = plan[top:bottom, left:right]
        if (part == "#").all():
            raise TaskError(
                f"a crop needs a free cell: rows {top}..{bottom} and columns {left}..{right} have "
                "none"
            )
        return part

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The rooms as tables: a row for each pair, O = the four ways that a move may go."""
        to = self._landing()[:, None, :]
        return self._tables(
            np.where(np.eye(4, dtype=bool), 1 - self.slip, self.slip / 3),
            to,
            np.where(self._ends[to], self.goal_reward, self.step_reward),
            terminal=self._ends,
            starting=self._start_states(),
        )


def _hallways_as_hallways(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how four rooms read others: hallways as hallways, the cells of rooms in proportion."""
    marks, others = (_marks(member.task) for member in (target, source))

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row, column = states["row"], states["column"]
        west, east = (in_proportion(row, marks[side], others[side]) for side in ("west", "east"))
        rows = np.where(column < target["size"] // 2, west, east)
        columns = in_proportion(column, marks["columns"], others["columns"])
        return {"row": rows, "column": columns}, actions

    return function


def _marks(rooms: FourRooms) -> dict[str, list[int]]:
    """Return the rows, in the west and the east, and the columns of hallways, walls and corners."""
    half, halls, sides = rooms.size // 2, rooms.hallways, [1, rooms.size - 2]
    rows = [halls["north"][0], halls["south"][0]]
    return {
        "west": [*rows, half, half - 1, half + 1, *sides],
        "east": [*rows, half + 1, half, half + 2, *sides],
        "columns": [halls["west"][1], halls["east"][1], half, half - 1, half + 1, *sides],
    }


four_rooms_family = family_of(FourRooms, mapping=_hallways_as_hallways)
"""Four rooms (:class:`FourRooms`); members map hallways as such, other cells in proportion."""
