"""Where the states of a task lie on a grid: what pictures need to know of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from textwrap import dedent
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.checks import one_of
from curricle.errors import TaskError
from curricle.frozen_arrays import frozen
from curricle.tasks.spaces import Space, whole
from curricle.tasks.task import generative_model
from curricle.text_tables import counted

LETTERS = {"treasure": "T", "fire": "F", "pit": "P", "goal": "G", "key": "K", "lock": "L"}
LETTERS |= {"exit": "E"}
"""Of the objects on a grid."""
SIDES = (("row", "column"), ("row", "col"), ("y", "x"))
"""Components that say in which cell a state lies, by their names."""
MOST_STATES = 20_000_000
"""States of a task whose cells are read off its components."""


@dataclass(frozen=True, eq=False)
class GridLayout:
    """The cell of each state of a task, and what lies in cells; a task offers it as `layout`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> drawn = GridWorld("S.T").layout
    >>> drawn.shape, drawn.objects
    ((1, 3), (('treasure', 0, 2, True),))
    """

    cells: IntArray
    """Row and column of the agent in each state, (S, 2)."""
    components: tuple[str, ...]
    """The components of a state that say where the agent is; a picture fixes the others."""
    shape: tuple[int, int]
    """Rows and columns."""
    origin: tuple[int, int] = (0, 0)
    """Row and column of the top-left cell."""
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    """Name (treasure, goal, exit, pit, fire, key or lock), row and column of what lies in a cell,
    and whether entering it ends the episode."""
    walls: IntArray | None = None
    """Rows and columns of walls, (m, 2); None where all cells without a state are walls."""
    markers: Mapping[str, IntArray] = field(default_factory=dict)
    """What else moves: name -> its row and column in each state, (S, 2)."""

    def __post_init__(self) -> None:
        for name, *_ in self.objects:
            one_of("an object of a layout", name, tuple(LETTERS), TaskError)


def layout_of(task: Any) -> GridLayout | None:
    """Return where the states of a task lie: as it says, or by components called row and column.

    None for a task that has neither.

    Examples
    --------
    >>> from curricle import from_gymnasium
    >>> drawn = layout_of(from_gymnasium("Taxi-v4", discount=0.9))
    >>> drawn.components, drawn.shape, drawn.cells[:21:20]
    (('row', 'column'), (5, 5), array([[0, 0],
           [0, 1]]))
    """
    own = getattr(task, "layout", None)
    if isinstance(own, GridLayout):
        return own
    states = generative_model(task).states
    sides = next((names for names in SIDES if set(names) <= set(states.names)), None)
    if sides is None or states.size > MOST_STATES:
        return None
    values = states.decode()
    cells = np.stack([values[name] for name in sides], axis=1)
    origin, last = cells.min(axis=0), cells.max(axis=0)
    rows, columns = (last - origin + 1).tolist()
    return GridLayout(cells, sides, (rows, columns), tuple(origin.tolist()))


# -- maps drawn in text ----------------------------------------------------------------------------


MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
"""Name -> rows and columns that a move goes."""
_STEPS = np.array(list(MOVES.values()))

Cell = tuple[int, int]
"""Row and column."""


def read_map(given: Any, characters: str) -> tuple[str, ...]:
    """Return the lines of a map, given as text or as a list of lines; TaskError if it is none.

    Examples
    --------
    >>> read_map(["S.", ".T"], "ST.")
    ('S.', '.T')
    """
    if not isinstance(given, str | list | tuple) or not all(isinstance(one, str) for one in given):
        raise TaskError(f"a map must be text or a list of lines: got {given!r}")
    if isinstance(given, str):
        given = [line.strip() for line in dedent(given).strip().splitlines()]
    lines = tuple(given)
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


def read_cells(given: Any, words: str, example: str = "[(9, 0)]") -> tuple[Cell, ...]:
    """Return start cells, sorted and without repetitions; TaskError if they are none.

    `words` are what a start may be instead.
    """
    try:
        cells = np.array(list(given))
    except (TypeError, ValueError):
        cells = np.empty(0)
    if cells.ndim != 2 or cells.shape[1] != 2 or cells.dtype.kind not in "iu":
        raise TaskError(f"start must be {words} or cells such as {example}: got {given!r}")
    return tuple(sorted({(int(row), int(column)) for row, column in cells}))


def read_origin(given: Any) -> Cell:
    """Return the row and column of a map's top-left cell; TaskError if they are none."""
    origin = whole(given, "the origin's row and column")
    if origin.shape != (2,):
        raise TaskError(f"origin must be a row and a column: got {given!r}")
    return int(origin[0]), int(origin[1])


def cut(lines: tuple[str, ...], origin: Cell, rows: Any, columns: Any) -> list[str]:
    """Return the lines of the part of a map in half-open ranges of its rows and columns.

    Examples
    --------
    >>> cut(("S..", "..T"), (0, 5), (0, 2), (6, 8))
    ['..', '.T']
    """
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


def landing(cells: Space) -> IntArray:
    """Return the cell that each move leads to from each, (n, 4) int64; MISSING where none is.

    `cells` has the components ``row`` and ``column``.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> landing(GridWorld("S.T").states)
    array([[-1,  1, -1, -1],
           [-1,  2, -1,  0],
           [-1, -1, -1,  1]])
    """
    where = cells.decode()
    after = np.stack([where["row"], where["column"]], axis=1)[:, None, :] + _STEPS
    return frozen(cells.encode(row=after[:, :, 0], column=after[:, :, 1]))
