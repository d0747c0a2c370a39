"""Rooms: four that hallways join, in which moves slip, and one with keys, locks and pits."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, IntArray
from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import (
    Discount,
    GridDomain,
    MapDomain,
    MapStart,
    TimeLimit,
    family_of,
    numbered_names,
)
from curricle.tasks.family import FamilyMember, Rule
from curricle.tasks.grid import MOVES, Cell, Grid, cell_of, in_proportion, part_of
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Component, Decoded, Space

# -- four rooms ------------------------------------------------------------------------------------

SMALLEST_PLAN, LARGEST_PLAN = 7, 1000  # cells per side, walls included


@dataclass(frozen=True)
class FourRooms(GridDomain):
    """Four rooms joined by hallways, in which moves slip; entering the goal ends the episode.

    Sutton, Precup, Singh 1999, "Between MDPs and semi-MDPs: a framework for temporal abstraction in
    reinforcement learning", section 3 and figure 2, has the defaults and other goals besides: 104
    cells on a 13x13 grid, walls included. A move into a wall leaves the agent where it is.

    All sizes have the same plan: the wall between west and east is in the middle; the wall between
    north and south is there in the west and one row further south in the east; each has a hallway.

    Parameters
    ----------
    size : int
        Cells per side, outer walls included, 7 to 1000.
    slip : float
        Probability that a move goes another way, each of the three equally likely.
    goal : {"north", "east", "south", "west"} or (int, int)
        A hallway (that between the two rooms in the north, and so on), or a row and a column.
    step_reward, goal_reward : float
        Rewards of a step that does not / does enter the goal.
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

    size: Annotated[int, Rule(SMALLEST_PLAN, LARGEST_PLAN, "larger")] = 13
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

    def _check(self) -> None:
        for name in ("rows", "columns"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, part_of(name, getattr(self, name), 0, self.size))
        if not isinstance(self.goal, str) or self.goal not in MOVES:
            rule = f"one of the hallways {', '.join(map(repr, MOVES))}, or a row and a column"
            object.__setattr__(self, "goal", cell_of("goal", self.goal, rule))
        row, column = self.goal_cell
        if self.grid.space.encode(row=row, column=column) == MISSING:
            raise TaskError(f"the goal needs a free cell of the rooms: got ({row}, {column})")
        super()._check()

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: object = "uniform"
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

    @cached_property
    def grid(self) -> Grid:
        """The cells of the part, and the goal."""
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
        return Grid(part, (top, left), listed=True)

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The rooms as tables: a row for each pair, O = the four ways that a move may go."""
        to = self.grid.landing()[:, None, :]
        return self._tables(
            np.where(np.eye(4, dtype=bool), 1 - self.slip, self.slip / 3),
            to,
            np.where(self._ends[to], self.goal_reward, self.step_reward),
        )


def _hallways_as_hallways(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how four rooms read others: hallways as hallways, the cells of rooms in proportion."""
    marks, images = (_marks(member.task) for member in (target, source))

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row, column = states["row"], states["column"]
        west, east = (in_proportion(row, marks[side], images[side]) for side in ("west", "east"))
        rows = np.where(column < target["size"] // 2, west, east)
        columns = in_proportion(column, marks["columns"], images["columns"])
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


# -- keys, locks and pits --------------------------------------------------------------------------

SMALLEST_ROOM, LARGEST_ROOM = 4, 1000
LARGEST_SPACE = 5_000_000  # states at most; keys and locks double them


def _room(side: int) -> tuple[str, ...]:
    """Return the lines of a square room with one key, one lock and a wall of pits between them."""
    drawn = np.full((side, side), ".")
    drawn[2:, side // 2] = "P"
    drawn[1, 1], drawn[-1, 0], drawn[-1, -1] = "K", "S", "L"
    return tuple("".join(line) for line in drawn)


ROOM = "\n".join(_room(8))


@dataclass(frozen=True)
class KeyLockPit(MapDomain):
    """Keys, locks and pits in a room drawn as a text map.

    Narvekar, Sinapov, Stone 2017, "Autonomous task sequencing for customized curriculum design in
    reinforcement learning" (also Narvekar and Stone 2019, "Learning curriculum policies for
    reinforcement learning"); their beacons are features and have no counterpart in a table.

    The agent moves one cell; a wall or the edge leaves it where it is. In a cell with a key it can
    pick the key up, in a cell with a lock it can open the lock if it holds all keys. The episode
    ends in a pit, or when all locks are open; without locks, when all keys are held.

    Parameters
    ----------
    map : str or sequence of str
        One line a row, north first. ``S`` start, ``K`` key, ``L`` lock, ``P`` pit, ``#`` wall,
        ``.`` free; at least one key or lock.
    key_reward, lock_reward, pit_reward, step_reward : float
        Of picking up a key, of opening a lock, of falling into a pit and of every other action.
    start : "map", "uniform" or cells
        At an ``S``, in any state in which the episode goes on, or at one of these cells.
    keys_held : bool
        Whether episodes start with all keys held, as in the second half of a task.
    origin : (int, int)
        Row and column of the top-left cell. A crop keeps the coordinates of the whole map; keys
        outside it count as held, and a key or a lock must be left.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> KeyLockPit().states  # 64 cells without the key, 64 with it, and the lock when it is open
    Space(129 points: row[8] x column[8] x key[2] x lock[2])
    """

    map: Any = ROOM
    key_reward: float = 500.0
    lock_reward: float = 1000.0
    pit_reward: float = -200.0
    step_reward: float = -10.0
    start: MapStart = "map"
    keys_held: Annotated[bool, Rule(harder="smaller")] = False
    origin: Cell = (0, 0)
    discount: Discount = 0.99
    time_limit: TimeLimit = 200

    ACTIONS = (*MOVES, "pick up", "unlock")
    CHARACTERS = "SKLP#."
    OBJECTS: ClassVar = {"K": "key", "L": "lock", "P": "pit"}
    ENDS = "P"

    def _check(self) -> None:
        self._read_map(self.map, "KL", "a map needs a key K or a lock L")
        keys, locks = len(self._keys), len(self._locks)
        objects = keys + locks
        if 2**objects * len(self.cells) > LARGEST_SPACE:
            raise TaskError(
                f"a map may have at most {LARGEST_SPACE:,} states: {len(self.cells):,} cells and "
                f"{objects} keys and locks make up to 2^{objects} times as many"
            )
        super()._check()

    @classmethod
    def room(cls, size: int = 8, **rules: Any) -> Self:
        """Return a square room, 4 to 1000 cells per side, with a key, and a lock behind pits."""
        side = whole_number("size", size, SMALLEST_ROOM, TaskError)
        side = int(number("size", side, TaskError, SMALLEST_ROOM, LARGEST_ROOM))
        return cls(map=_room(side), **rules)

    @cached_property
    def states(self) -> Space:
        """The agent's cell, which keys it holds and which locks are open."""
        axes = [*self.grid.space.components]
        for kind, cells, labels in (
            ("key", self._keys, ("lying", "held")),
            ("lock", self._locks, ("locked", "open")),
        ):
            axes += [Component(name, 2, labels=labels) for name in numbered_names(kind, len(cells))]
        keys, last = len(self._keys), self._locks if len(self._locks) else self._keys
        points = list[IntArray]()
        for status in product((0, 1), repeat=keys + len(self._locks)):
            if all(status[:keys]) or not any(status[keys:]):  # open locks have all keys held
                cells = last if all(status) else self.cells
                points.append(np.column_stack([cells, np.tile(status, (len(cells), 1))]))
        return Space(axes, np.concatenate(points))

    @cached_property
    def _cell(self) -> IntArray:
        """The number of the agent's cell in each state, (S,)."""
        row, column = self.states.points[:, :2].T
        return self.grid.space.encode(row=row, column=column)

    @cached_property
    def _keys(self) -> IntArray:
        return self.cells[self.grid.holds("K")]

    @cached_property
    def _locks(self) -> IntArray:
        return self.cells[self.grid.holds("L")]

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The task as tables: a row for entering each state by a move, one for using its object."""
        states, values, here = self.states, self.states.decode(), np.arange(self.states.size)
        inventory = {name: values[name][:, None] for name in states.names[2:]}
        row, column = self.cells[self.grid.landing()[self._cell]].transpose(2, 0, 1)
        entered = states.encode(row=row, column=column, **inventory)
        entered = np.where(entered == MISSING, here[:, None], entered)  # of states that ended
        used, paid = here.copy(), np.full(len(here), self.step_reward)
        picks, opens = np.zeros((2, len(here)), bool)
        held, keys = states.points[:, 2:] == 1, len(self._keys)
        for i, (row, column) in enumerate([*self._keys, *self._locks]):
            can = (values["row"] == row) & (values["column"] == column) & ~held[:, i]
            can &= (i < keys) | held[:, :keys].all(axis=1)  # a lock needs all keys
            changed = {**values, states.names[2 + i]: np.ones_like(here)}
            used[can] = states.encode(**{name: value[can] for name, value in changed.items()})
            paid[can] = self.key_reward if i < keys else self.lock_reward
            (picks if i < keys else opens)[can] = True
        use = [np.where(does, len(here) + here, here)[:, None] for does in (picks, opens)]
        moved = np.where(self._fallen, self.pit_reward, self.step_reward)
        return self._tables(
            np.ones((2 * len(here), 1)),
            np.concatenate([here, used])[:, None],
            np.concatenate([moved, paid])[:, None],
            outcome_row=np.concatenate([entered, *use], axis=1),
        )

    @property
    def _fallen(self) -> BoolArray:
        """Whether the agent is in a pit, (S,) bool."""
        return self.grid.holds("P")[self._cell]

    @property
    def _ends(self) -> BoolArray:
        """In a pit, or with all locks open (all keys held where there is no lock), (S,) bool."""
        first = 2 + (len(self._keys) if len(self._locks) else 0)
        return np.asarray(self._fallen | self.states.points[:, first:].all(axis=1))

    @property
    def _standing(self) -> BoolArray:
        held = self.states.points[:, 2 : 2 + len(self._keys)].all(axis=1)
        return ~self._ends & held if self.keys_held else ~self._ends

    def states_at(self, row: npt.ArrayLike, column: npt.ArrayLike) -> IntArray:
        """Return the first states of these cells, `MISSING` off the map and in walls."""
        names, keys = self.states.names[2:], len(self._keys)
        status = dict.fromkeys(names[:keys], int(self.keys_held)) | dict.fromkeys(names[keys:], 0)
        return self.states.encode(row=row, column=column, **status)


def _square_room(
    size: Annotated[int, Rule(SMALLEST_ROOM, LARGEST_ROOM, "larger")] = 8, **rules: Any
) -> KeyLockPit:
    return KeyLockPit.room(size, **rules)


def _keys_as_keys(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a room reads another: key, pits and lock as such, other cells in proportion."""

    def marks(size: int) -> tuple[list[int], list[int]]:
        pits = size // 2
        return [0, 1, 2, size - 1], [0, 1, pits - 1, pits, pits + 1, size - 1]

    rows, columns = zip(marks(target["size"]), marks(source["size"]), strict=True)

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        row = in_proportion(states["row"], *rows)
        return {**states, "row": row, "column": in_proportion(states["column"], *columns)}, actions

    return function


key_lock_pit_family = family_of(KeyLockPit, _square_room, mapping=_keys_as_keys)
"""Square rooms with a key, a lock and pits (:meth:`KeyLockPit.room`).

Members map key, pits and lock as such, other cells in proportion.
"""
