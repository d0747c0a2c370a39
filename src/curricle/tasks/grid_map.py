"""Maps of grid worlds: their lines of text, their parts, and the moves between their cells."""

from textwrap import dedent
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.errors import TaskError
from curricle.frozen_arrays import frozen
from curricle.tasks.spaces import Space, whole
from curricle.text_tables import counted

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
