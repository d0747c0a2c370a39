"""What the domains that come with the library share: tables, variants and text maps."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, Frozen, IntArray, frozen
from curricle.checks import indices, number, whole_number
from curricle.errors import TaskError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Component, Space, whole
from curricle.text import counted

# -- maps drawn in text ----------------------------------------------------------------------------

MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
"""Name -> rows and columns that a move goes."""
Cell = tuple[int, int]
"""Row and column."""
MARK = "\ufeff"  # the byte order mark, with which some editors begin a file


def read_map(given: Any, characters: str) -> tuple[str, ...]:
    """Return the lines of a map, given as text or as a list of lines; TaskError if it is none."""
    if not isinstance(given, str | list | tuple) or not all(isinstance(one, str) for one in given):
        raise TaskError(f"a map must be text or a list of lines: got {given!r}")
    if isinstance(given, str):
        given = [line.strip() for line in given.lstrip(MARK).strip().splitlines()]
    lines = tuple(line.lstrip(MARK) for line in given)
    for row, line in enumerate(lines):
        if len(line) != len(lines[0]):
            raise TaskError(
                f"all lines of a map must be equally long: line {row} has "
                f"{counted(len(line), 'character')}, line 0 has {len(lines[0])}"
            )
        for column, character in enumerate(line):
            if character not in characters:
                raise TaskError(
                    f"a map is drawn with {' '.join(characters)}: row {row}, column {column} has "
                    f"{character!r}"
                )
    return lines


def read_origin(given: Any) -> Cell:
    """Return the row and column of a map's top-left cell; TaskError if they are none."""
    origin = whole(given, "the origin's row and column")
    if origin.shape != (2,):
        raise TaskError(f"origin must be a row and a column: got {given!r}")
    return int(origin[0]), int(origin[1])


def cut(lines: tuple[str, ...], origin: Cell, rows: Any, columns: Any) -> list[str]:
    """Return the lines of the part of a map in half-open ranges of its rows and columns."""
    check_part("rows", rows, origin[0], len(lines))
    check_part("columns", columns, origin[1], len(lines[0]))
    part = lines[rows[0] - origin[0] : rows[1] - origin[0]]
    return [line[columns[0] - origin[1] : columns[1] - origin[1]] for line in part]


def check_part(name: str, given: Any, first: int, size: int) -> None:
    """Raise TaskError unless `given` is a half-open range of the rows or columns of a map."""
    if whole(given, f"a crop's {name}").shape != (2,):
        raise TaskError(f"a crop's {name} must be a first and an end: got {given!r}")
    low, high = given
    if not first <= low < high <= first + size:
        raise TaskError(
            f"a crop must lie within the map's {name} {first}..{first + size}: got {low}..{high}"
        )


def cell_space(
    rows: int, columns: int, origin: Cell = (0, 0), cells: IntArray | None = None
) -> Space:
    """Return the space of a grid's cells: all of them, or only these, (n, 2)."""
    row, column = origin
    return Space([Component("row", rows, row), Component("column", columns, column)], cells)


def landing(cells: Space, moves: Mapping[str, Cell] = MOVES) -> IntArray:
    """Return the cell that each move leads to from each, (n, moves) int64; MISSING where none is.

    `cells` has the components ``row`` and ``column``.
    """
    where = cells.decode()
    steps = np.array(list(moves.values()))
    after = np.stack([where["row"], where["column"]], axis=1)[:, None, :] + steps
    return frozen(cells.encode(row=after[:, :, 0], column=after[:, :, 1]))


def landing_or_staying(cells: Space, moves: Mapping[str, Cell] = MOVES) -> IntArray:
    """Return what :func:`landing` does, and the cell itself where a move leads to none."""
    to = landing(cells, moves)
    return np.where(to == MISSING, np.arange(len(to))[:, None], to)


# -- what domains are made of ----------------------------------------------------------------------


def tables_of(
    task: Any,
    probability: Any,
    next_state: Any,
    reward: Any,
    *,
    terminal: BoolArray,
    starting: IntArray,
    outcome_row: IntArray | None = None,
) -> FiniteMDP:
    """Return the tables of a task whose episodes start in the states `starting`, equally likely.

    Outcomes are (Y, O) as in :class:`FiniteMDP`. Without `outcome_row` every pair has a row of its
    own, and they are (S, A, O) or broadcast to it.
    """
    if outcome_row is None:
        outcomes = np.broadcast_arrays(probability, next_state, reward)
        *pairs, width = outcomes[0].shape
        outcome_row = np.arange(np.prod(pairs)).reshape(pairs)
        probability, next_state, reward = (table.reshape(-1, width) for table in outcomes)
    start = np.zeros(len(terminal))
    start[starting] = 1 / len(starting)
    return FiniteMDP(
        states=task.states,
        actions=task.actions,
        outcome_row=outcome_row,
        probability=probability,
        next_state=next_state,
        reward=reward,
        terminal=terminal,
        start=start,
        discount=task.discount,
        time_limit=task.time_limit,
    )


def check_sizes(task: Any, **limits: tuple[int, int]) -> None:
    """Check whole numbers of a frozen task, name -> least and most, and make them ints."""
    for name, (least, most) in limits.items():
        value = whole_number(name, getattr(task, name), least, TaskError)
        number(name, value, TaskError, least, most)
        object.__setattr__(task, name, value)


def read_start(
    task: Any, valid: tuple[str, ...] = ("map", "uniform"), example: str = "[(9, 0)]"
) -> None:
    """Check the start of a frozen task, which is a valid word or cells, and sort its cells."""
    words = ", ".join(map(repr, valid))
    if isinstance(task.start, str):
        if task.start not in valid:
            raise TaskError(f"start must be {words} or cells: got {task.start!r}")
        return
    try:
        cells = np.array(list(task.start))
    except (TypeError, ValueError):
        cells = np.empty(0)
    if cells.ndim != 2 or cells.shape[1] != 2 or cells.dtype.kind not in "iu":
        raise TaskError(f"start must be {words} or cells such as {example}: got {task.start!r}")
    listed = tuple(sorted({(int(row), int(column)) for row, column in cells}))
    object.__setattr__(task, "start", listed)


def check_starts(states: IntArray, allowed: BoolArray, cells: Any, rule: str) -> IntArray:
    """Return the states of start cells; TaskError where one is no state or not `allowed`."""
    bad = np.flatnonzero((states == MISSING) | ~allowed[states])
    if bad.size:
        raise TaskError(f"{rule}: got {tuple(map(int, cells[bad[0]]))}")
    return states


def numbered_names(kind: str, count: int) -> tuple[str, ...]:
    """Return ``key`` if there is one, else ``key_1``, ``key_2``, ..."""
    return (kind,) if count == 1 else tuple(f"{kind}_{i + 1}" for i in range(count))


class Domain(Frozen):
    """A task that is a frozen dataclass of its rules, one of them its `start`."""

    @cached_property
    def actions(self) -> Space:
        """The moves north, east, south and west."""
        return Space([Component("move", len(MOVES), labels=tuple(MOVES))])

    def with_start(self, start: Any) -> Self:
        """Return the same task with another start, which is what the class takes as `start`.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> GridWorld("S.T").with_start("uniform").mdp.start
        array([0.5, 0.5, 0. ])
        """
        task: Any = self
        moved: Self = replace(task, start=start)
        return moved


class CellDomain(Domain):
    """A domain with one state for each cell, whose number is that of the cell."""

    layout: Any

    def start_in(self, states: npt.ArrayLike) -> Self:
        """Return the same task with starts in these states, by number, equally likely.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> GridWorld("S..T").start_in([1, 2]).start
        ((0, 1), (0, 2))
        """
        cells = self.layout.cells
        chosen = cells[indices("start states", states, len(cells), TaskError)]
        return self.with_start([(int(row), int(column)) for row, column in chosen])


class MapDomain(Domain):
    """A domain drawn as a text map, on which ``#`` is a wall."""

    map: Any
    origin: Cell

    def _read_map(self, drawn: Any, characters: str, needed: str, rule: str) -> None:
        """Check the map, which has one of the characters `needed`, and its origin."""
        lines = read_map(drawn, characters)
        if not any(character in line for line in lines for character in needed):
            raise TaskError(f"{rule}: there is none")
        object.__setattr__(self, "map", lines)
        object.__setattr__(self, "origin", read_origin(self.origin))

    def crop(
        self, *, rows: tuple[int, int], columns: tuple[int, int], start: Any = "uniform"
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in this map's coordinates.

        Objects outside the part are removed, so fire just outside its edge no longer counts as
        near. The default start is uniform, as in the paper's source tasks.

        Raises
        ------
        TaskError
            When the part exceeds the map, is empty, or has no treasure or goal.
        """
        task: Any = self
        part = cut(self.map, self.origin, rows, columns)
        cropped: Self = replace(task, map=part, start=start, origin=(rows[0], columns[0]))
        return cropped

    @cached_property
    def cells(self) -> IntArray:
        """Row and column of each cell that is not a wall, (n, 2), in reading order."""
        return frozen(np.argwhere(self._grid != "#") + self.origin)

    @cached_property
    def _cell_space(self) -> Space:
        rows, columns = self._grid.shape
        walled = len(self.cells) < rows * columns
        return cell_space(rows, columns, self.origin, self.cells if walled else None)

    def _objects(self, names: Mapping[str, str]) -> list[tuple[str, int, int]]:
        """Return name, row and column of what is drawn with these characters, in reading order."""
        return [
            (names[character], row, column)
            for character, (row, column) in zip(self._contents, self.cells.tolist(), strict=True)
            if character in names
        ]

    def _at(self, character: str) -> IntArray:
        """Return row and column of each cell drawn with a character, (n, 2), in reading order."""
        return frozen(np.argwhere(self._grid == character) + self.origin)

    @cached_property
    def _grid(self) -> npt.NDArray[np.str_]:
        return np.array([list(line) for line in self.map])

    @cached_property
    def _contents(self) -> npt.NDArray[np.str_]:
        """The map's character for each cell that is not a wall, (n,)."""
        return np.asarray(self._grid[self._grid != "#"])
