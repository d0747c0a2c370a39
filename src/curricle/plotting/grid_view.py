"""Boards: which states of a task are drawn, and in which cell of a grid each lies."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from curricle.checks import instance
from curricle.errors import SettingError
from curricle.plotting.figures import (
    LETTERS,
    draw_grid,
    draw_letter,
    draw_maze,
    draw_walls,
    label_objects,
)
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.spaces import MISSING, Component, Space
from curricle.tasks.task import generative_model

IntArray = npt.NDArray[np.int64]
At = Mapping[str, Any]
"""Component name -> its value, a number, a label, or for a cell (row, column)."""

_CELL = re.compile(r"\((\d+), ?(\d+)\)")


@dataclass(frozen=True, eq=False)
class Board:
    """Some states of a task as cells of a grid, seen from above.

    Attributes
    ----------
    task : Task
    states : (n,) int64
        One a cell, at most.
    cells : (n, 2) int64
        Row and column of each.
    origin, shape : (int, int)
        Top-left cell; rows and columns.
    letters : tuple of (str, int, int)
        What else stands on the grid: letter, row, column.
    words : str
        What is free and what is fixed, with the letters.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> found = board(Pursuit(3, 2), {"prey": (1, 2), "predator_2": (0, 0)})
    >>> found.states.size, found.cells[5], found.letters
    (9, array([1, 2]), (('P', 1, 2), ('2', 0, 0)))
    >>> found.words
    'cells: where predator_1 is; P: prey, 2: predator_2'
    """

    task: Any
    states: IntArray
    cells: IntArray
    origin: tuple[int, int]
    shape: tuple[int, int]
    letters: tuple[tuple[str, int, int], ...] = ()
    words: str = ""
    ended: npt.NDArray[np.bool_] = field(init=False)
    """(n,) bool: states in which the episode is over."""

    def __post_init__(self) -> None:
        terminal = generative_model(self.task).terminal
        over = np.zeros(len(self.states), bool) if terminal is None else terminal[self.states]
        object.__setattr__(self, "ended", over)

    def draw(self, axes: Axes, *, over: bool, corners: bool = True) -> None:
        """Draw the grid, walls, and the letters of what stands on it.

        Parameters
        ----------
        axes : Axes
        over : bool
            Whether it comes over a heat map: a maze's objects are then letters only.
        corners : bool
            Whether these letters go into corners, beside numbers.
        """
        if isinstance(self.task, GridWorld) and not over:
            draw_maze(axes, self.task)
        else:
            draw_grid(axes, self.origin, self.shape)
        if isinstance(self.task, GridWorld) and over:
            draw_walls(axes, self.task)
            label_objects(axes, self.task, corner=corners)
        together: dict[tuple[int, int], str] = {}
        for letter, row, column in self.letters:
            together[row, column] = together.get((row, column), "") + letter
        for (row, column), letters in together.items():
            written = draw_letter(axes, letters, row - 0.3, column - 0.3)
            written.set_bbox({"boxstyle": "circle,pad=0.15", "fc": "w", "ec": "k", "lw": 0.6})
        if self.words:
            axes.set_xlabel(f"column\n{self.words}", fontsize=8)


def board(task: Any, at: At | None = None) -> Board:
    """Return the states of a task that make one picture, with the cell of each.

    Parameters
    ----------
    task : Task
        A :class:`GridWorld`, or any task in whose states one component is a cell, its labels being
        ``(row,column)`` as in :class:`Pursuit`, or two are a row and a column.
    at : dict of str to int, str or (int, int), optional
        What the other components are: a number, a label, or a cell's row and column. Those left out
        make the board: one that is a cell, or two, the first being the row.

    Raises
    ------
    SettingError
        When a component or value is unknown, or what is left makes no grid.
    """
    fixed = {} if at is None else at
    instance("at", fixed, Mapping, SettingError)
    if isinstance(task, GridWorld):
        if fixed:
            raise SettingError(f"a maze is drawn whole, without at: got at {dict(fixed)}")
        shape = (len(task.map), len(task.map[0]))
        objects = dict.fromkeys(name for name, *_ in task.objects)
        words = ", ".join(f"{LETTERS[name]}: {name}" for name in objects)
        return Board(task, np.arange(len(task.cells)), task.cells, task.origin, shape, (), words)
    space = generative_model(task).states
    unknown = [name for name in fixed if name not in space.names]
    if unknown:
        raise SettingError(
            f"at must name components of a state, {', '.join(space.names)}: got {unknown[0]!r}"
        )
    given = {name: _value(space.component(name), value) for name, value in fixed.items()}
    free = [component for component in space.components if component.name not in given]
    cells, values = _grid_of(free, space)
    states = space.encode(**given, **values)
    there = states != MISSING
    letters, words = _standing(space, given, free)
    return Board(
        task,
        states[there],
        cells[there],
        (int(cells[:, 0].min()), int(cells[:, 1].min())),
        (int(np.ptp(cells[:, 0])) + 1, int(np.ptp(cells[:, 1])) + 1),
        letters,
        words,
    )


def _grid_of(free: list[Component], space: Space) -> tuple[IntArray, dict[str, IntArray]]:
    """Return all cells that the free components make, (n, 2), and their values, (n,) each."""
    if len(free) == 1 and (cells := labelled_cells(free[0])) is not None:
        return cells, {free[0].name: free[0].low + np.arange(free[0].size)}
    if len(free) == 2 and all(labelled_cells(component) is None for component in free):
        sides = [component.low + np.arange(component.size) for component in free]
        cells = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        return cells, {free[0].name: cells[:, 0], free[1].name: cells[:, 1]}
    names = [component.name for component in free]
    raise SettingError(
        "a picture is of one cell, or of a row and a column; at must fix all other components of "
        f"{', '.join(space.names)}: it leaves {', '.join(names) or 'none'}"
    )


def labelled_cells(component: Component) -> IntArray | None:
    """Return the row and column of each value, (size, 2); None if its labels are no cells."""
    found = [_CELL.fullmatch(label) for label in component.labels or ("",)]
    if not all(found):
        return None
    return np.array([[int(part) for part in match.groups()] for match in found if match])


def _value(component: Component, given: Any) -> int:
    """Return a component's value from a number, a label, or a cell's row and column."""
    label = given
    if isinstance(given, tuple | list | np.ndarray):
        label = f"({','.join(str(int(part)) for part in given)})"
    if isinstance(label, str) and label in (component.labels or ()):
        return component.low + (component.labels or ()).index(label)
    high = component.low + component.size - 1
    if isinstance(given, int | np.integer) and component.low <= given <= high:
        return int(given)
    raise SettingError(
        f"{component.name} runs from {component.label(component.low)} to {component.label(high)}: "
        f"got {given!r}"
    )


def _standing(
    space: Space, given: Mapping[str, int], free: list[Component]
) -> tuple[tuple[tuple[str, int, int], ...], str]:
    """Return the letters of the fixed cells, and what a picture's label says of it."""
    letters: dict[str, tuple[str, int, int]] = {}
    keys = list[str]()
    for component in space.components:
        if component.name not in given:
            continue
        value, cells = given[component.name], labelled_cells(component)
        if cells is None:
            keys.append(f"{component.name} {component.label(value)}")
            continue
        letter = letter_of(component.name, [taken for taken, *_ in letters.values()])
        row, column = cells[value - component.low]
        letters[component.name] = (letter, int(row), int(column))
        keys.append(f"{letter}: {component.name}")
    what = f"cells: where {free[0].name} is" if len(free) == 1 else ""
    return tuple(letters.values()), "; ".join(filter(None, (what, ", ".join(keys))))


def letter_of(name: str, taken: list[str]) -> str:
    """Return the number that a name ends in, or its first letter that is not taken yet."""
    number = re.search(r"\d+$", name)
    candidates = [number.group()] if number else []
    candidates += [letter.upper() for letter in name if letter.isalnum()]
    return next((one for one in candidates if one not in taken), "?")
