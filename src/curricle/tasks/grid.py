"""Grids of cells: maps drawn in text, where moves lead, and where the states of a task lie."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, Frozen, IntArray, adopted, frozen
from curricle.checks import one_of
from curricle.errors import TaskError
from curricle.tasks.spaces import MISSING, Component, Space, whole
from curricle.text import counted

Cell = tuple[int, int]  # row and column
LETTERS = {"treasure": "T", "fire": "F", "pit": "P", "goal": "G", "key": "K", "lock": "L"}
LETTERS |= {"exit": "E"}
"""Of the objects on a grid."""
MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
"""Name -> rows and columns that a move goes."""


@dataclass(frozen=True, eq=False)
class Grid(Frozen):
    """Cells drawn with a character each, of which n are no walls; they count in reading order."""

    drawn: npt.NDArray[np.str_]  # (rows, columns); "#" is a wall
    corner: Cell = (0, 0)  # row and column of the top-left cell
    listed: bool = False  # whether the space lists its cells even where none is a wall

    def __post_init__(self) -> None:
        object.__setattr__(self, "drawn", adopted(self.drawn, self.drawn.dtype))

    @cached_property
    def cells(self) -> IntArray:
        """Row and column of each cell, (n, 2)."""
        return frozen(np.argwhere(self.drawn != "#") + np.array(self.corner))

    @cached_property
    def space(self) -> Space:
        """The space of the cells."""
        rows, columns = self.drawn.shape
        listed = self.listed or len(self.cells) < rows * columns
        return cell_space(rows, columns, self.corner, self.cells if listed else None)

    @cached_property
    def contents(self) -> npt.NDArray[np.str_]:
        """The character of each cell, (n,)."""
        return frozen(self.drawn[self.drawn != "#"])

    def holds(self, characters: str) -> BoolArray:
        """Return which cells are drawn as one of some characters, (n,) bool."""
        return np.isin(self.contents, list(characters))

    def landing(self, moves: Mapping[str, Cell] = MOVES) -> IntArray:
        """Return the cell that each move leads to from each cell: the same if there is none."""
        to = landing(self.space, moves)
        return np.where(to == MISSING, np.arange(len(to))[:, None], to)


def cell_space(
    rows: int, columns: int, corner: Cell = (0, 0), cells: IntArray | None = None
) -> Space:
    """Return the space of a grid's cells: all of them, or only these, (n, 2)."""
    row, column = corner
    return Space([Component("row", rows, row), Component("column", columns, column)], cells)


def landing(cells: Space, moves: Mapping[str, Cell] = MOVES) -> IntArray:
    """Return the cell that each move leads to from each cell, (n, moves) int64, or MISSING."""
    row, column = (values[:, None] for values in cells.decode().values())
    down, right = np.array(list(moves.values())).T
    return frozen(cells.encode(row=row + down, column=column + right))


def in_proportion(values: IntArray, marks: list[int], images: list[int]) -> IntArray:
    """Return values moved so that each mark becomes its image, in proportion between them."""
    rising, first = np.unique(marks, return_index=True)
    read = np.interp(values, rising, np.array(images)[first])
    return np.asarray(np.rint(read), dtype=np.int64)


# -- where the states of a task lie: what it may say of it, and pictures read ----------------------


@dataclass(frozen=True, eq=False)
class GridLayout:
    """The cell of each state of a task, and the objects in cells; a task offers it as `layout`."""

    cells: IntArray  # row and column of the agent in each state, (S, 2)
    components: tuple[str, ...]
    """The components of a state that say where the agent is; a picture fixes the others."""
    shape: tuple[int, int]  # rows and columns
    origin: Cell = (0, 0)  # row and column of the top-left cell
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    """Name (treasure, goal, exit, pit, fire, key or lock), row and column of an object in a cell,
    and whether entering it ends the episode."""
    walls: IntArray | None = None
    """Rows and columns of walls, (m, 2); None where all cells without a state are walls."""
    markers: Mapping[str, IntArray] = field(default_factory=dict)
    """Other moving objects: name -> row and column in each state, (S, 2)."""

    def __post_init__(self) -> None:
        for name, *_ in self.objects:
            one_of("an object of a layout", name, tuple(LETTERS), TaskError)

    @property
    def wall_cells(self) -> IntArray:
        """Row and column of each wall, (m, 2)."""
        if self.walls is not None:
            return self.walls
        free = np.zeros(self.shape, bool)
        free[tuple((self.cells - self.origin).T)] = True
        return np.argwhere(~free) + self.origin


# -- maps drawn in text ----------------------------------------------------------------------------

MARK = "\ufeff"  # the byte order mark, with which some editors begin a file


def read_map(
    drawn: object, characters: str, legend: Mapping[str, str] | None = None
) -> tuple[str, ...]:
    """Return the lines of a map, given as text or as a list of lines; TaskError if it is none.

    A `legend` says which of the `characters` others stand for, where the domain has one.
    """
    if not isinstance(drawn, str | list | tuple) or not all(isinstance(x, str) for x in drawn):
        raise TaskError(f"a map must be text or a list of lines: got {drawn!r}")
    if isinstance(drawn, str):
        drawn = [line.strip() for line in drawn.lstrip(MARK).strip().splitlines()]
    meant = str.maketrans(dict(legend or {}))
    lines = tuple(line.lstrip(MARK).translate(meant) for line in drawn)
    for row, line in enumerate(lines):
        if len(line) != len(lines[0]):
            raise TaskError(
                f"all lines of a map must be equally long: line {row} has "
                f"{counted(len(line), 'character')}, line 0 has {len(lines[0])}"
            )
        for column, character in enumerate(line):
            if character not in characters:
                says = (
                    "" if legend is None else f"; legend={{{character!r}: 'wall'}} makes it a wall"
                )
                raise TaskError(
                    f"a map is drawn with {' '.join(characters)}: row {row}, column {column} has "
                    f"{character!r}{says}"
                )
    return lines


def cell_of(name: str, value: Any, rule: str) -> Cell:
    """Return a row and a column as ints; TaskError if they are none."""
    cell = np.empty(0) if isinstance(value, str) else whole(value, f"the {name}'s row and column")
    if cell.shape != (2,):
        raise TaskError(f"{name} must be {rule}: got {value!r}")
    return int(cell[0]), int(cell[1])


def cut(lines: tuple[str, ...], origin: Cell, rows: object, columns: object) -> list[str]:
    """Return the lines of the part of a map in half-open ranges of its rows and columns."""
    top, bottom = part_of("rows", rows, origin[0], len(lines))
    left, right = part_of("columns", columns, origin[1], len(lines[0]))
    part = lines[top - origin[0] : bottom - origin[0]]
    return [line[left - origin[1] : right - origin[1]] for line in part]


def part_of(name: str, part: Any, first: int, size: int) -> tuple[int, int]:
    """Return a half-open range of the rows or columns of a map; TaskError if it is none."""
    if whole(part, f"a crop's {name}").shape != (2,):
        raise TaskError(f"a crop's {name} must be a first and an end: got {part!r}")
    low, high = map(int, part)
    if not first <= low < high <= first + size:
        raise TaskError(
            f"a crop must lie within the map's {name} {first}..{first + size}: got {low}..{high}"
        )
    return low, high
