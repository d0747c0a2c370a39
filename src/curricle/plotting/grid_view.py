"""Grid views: which states of a task are shown, in which cell of a grid each lies, and who moves.

Pictures and pages use the same view; :mod:`curricle.plotting.grids` draws it with Matplotlib.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import cycle
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance
from curricle.errors import SettingError
from curricle.plotting.styles import COLOURS
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.spaces import MISSING, Component, Space
from curricle.tasks.task import generative_model

IntArray = npt.NDArray[np.int64]
At = Mapping[str, Any]
"""Component name -> its value, a number, a label, or for a cell (row, column)."""

LETTERS = {"treasure": "T", "fire": "F", "pit": "P"}
TINTS = {"treasure": "#f2c14e", "fire": "#ee6c4d", "pit": "#3d405b"}
"""Of the objects in a maze."""
STRIP, LONGEST_STRIP = 6, 60
"""States without geometry stand in a strip: so many a row, so many at most."""
MOST_CELLS = 2500
"""Cells of a replayed grid at most."""
DIRECTIONS = {"stay": 0, "noop": 0, "north": 1, "up": 1, "east": 2, "right": 2}
DIRECTIONS |= {"south": 3, "down": 3, "west": 4, "left": 4}
AGENTS = ("blue", "vermillion", "green", "purple")
"""Colours of pieces that act; others are black."""

_CELL = re.compile(r"\((\d+), ?(\d+)\)")


@dataclass(frozen=True, eq=False)
class Piece:
    """Something that moves over a grid during an episode.

    Attributes
    ----------
    name, letter : str
    colour : str
        As ``#rrggbb``.
    cells : (S,) int64
        Its cell in each state, as ``row * columns + column``; -1 where that cell is not shown.
    """

    name: str
    letter: str
    colour: str
    cells: IntArray


@dataclass(frozen=True, eq=False)
class GridView:
    """Some states of a task as cells of a grid, seen from above.

    Attributes
    ----------
    task : Task
    states : (n,) int64
        At most one a cell.
    cells : (n, 2) int64
        Row and column of each.
    origin, shape : (int, int)
        Top-left cell; rows and columns.
    letters : tuple of (str, int, int)
        What else stands on the grid: letter, row, column.
    words : str
        What is free and what is fixed, and what the letters mean.
    is_map : bool
        Whether cells are places of the task. In a strip they are states in order.
    pieces : tuple of Piece
        What moves during an episode; empty for a view that is not replayed.
    mover : str or None
        The piece that the view follows.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> view = GridView.of(Pursuit(3, 2), {"prey": (1, 2), "predator_2": (0, 0)})
    >>> view.states.size, view.cells[5], view.letters
    (9, array([1, 2]), (('P', 1, 2), ('2', 0, 0)))
    >>> view.words
    'cells: where predator_1 is; P: prey, 2: predator_2'
    """

    task: Any
    states: IntArray
    cells: IntArray
    origin: tuple[int, int]
    shape: tuple[int, int]
    letters: tuple[tuple[str, int, int], ...] = ()
    words: str = ""
    is_map: bool = True
    pieces: tuple[Piece, ...] = ()
    mover: str | None = None

    @classmethod
    def of(cls, task: Any, at: At | None = None) -> "GridView":
        """Return the view of the states that share the given components.

        Parameters
        ----------
        task : Task
            A :class:`GridWorld`, or any task whose states have one component that is a cell, with
            labels ``(row,column)`` as in :class:`Pursuit`, or two that are a row and a column.
        at : dict of str to int, str or (int, int), optional
            The other components: a number, a label, or a cell's row and column. Those left out
            make the grid: one that is a cell, or two, the first being the row.

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
            return cls(task, np.arange(len(task.cells)), task.cells, task.origin, shape, (), words)
        return _of_components(task, fixed)

    @classmethod
    def for_replay(cls, task: Any) -> "GridView | None":
        """Return a view with pieces, to replay training in; None where it has too many cells.

        A maze or a pursuit is shown as its grid, states without geometry as a strip. Of several
        cells in a state the view follows the first that an action moves. Cells that no action moves
        are fixed in the middle, those of other agents in the corners.

        Examples
        --------
        >>> from curricle import Pursuit
        >>> view = GridView.for_replay(Pursuit(3, 2))
        >>> view.words, [piece.letter for piece in view.pieces]
        ('cells: where predator_1 is; P: prey, 2: predator_2', ['P', '1', '2'])
        """
        if isinstance(task, GridWorld):
            return _with_pieces(cls.of(task), {"agent": task.cells})
        space = generative_model(task).states
        read = {component.name: labelled_cells(component) for component in space.components}
        if cells := {name: found for name, found in read.items() if found is not None}:
            return _of_agents(task, space, cells)
        for names in (("row", "column"), ("y", "x")):
            if set(names) <= set(space.names):
                values = space.decode()
                places = np.stack([values[name] for name in names], axis=1)
                fixed = {c.name: c.low for c in space.components if c.name not in names}
                return _with_pieces(cls.of(task, fixed), {"agent": places})
        return _strip(task, space)

    @cached_property
    def ended(self) -> npt.NDArray[np.bool_]:
        """States in which the episode is over, (n,)."""
        terminal = generative_model(self.task).terminal
        return np.zeros(len(self.states), bool) if terminal is None else terminal[self.states]

    @cached_property
    def directions(self) -> IntArray | None:
        """What each action does to the mover, (A,): 0 stay, 1 north ... 4 west.

        None where actions are no moves on the grid.
        """
        actions = generative_model(self.task).actions
        alone = len(actions.names) == 1
        own = [one for one in actions.components if one.name == self.mover or alone]
        if not self.is_map or not own or not set(own[0].labels or ("",)) <= set(DIRECTIONS):
            return None
        moves = actions.decode()[own[0].name]
        return np.array([DIRECTIONS[own[0].label(int(move))] for move in moves])

    @property
    def stacked_letters(self) -> dict[tuple[int, int], str]:
        """The letters on the grid, (row, column) -> those that share a cell."""
        together: dict[tuple[int, int], str] = {}
        for letter, row, column in self.letters:
            together[row, column] = together.get((row, column), "") + letter
        return together

    @property
    def walls(self) -> IntArray:
        """Row and column of the cells of a map that are none of the states', (m, 2)."""
        grid = np.full(self.shape, self.is_map)
        row, column = (self.cells - np.array(self.origin)).T
        grid[row, column] = False
        return np.asarray(np.argwhere(grid) + np.array(self.origin))


def labelled_cells(component: Component) -> IntArray | None:
    """Return the row and column of each value, (size, 2); None if its labels are no cells."""
    found = [_CELL.fullmatch(label) for label in component.labels or ("",)]
    if not all(found):
        return None
    return np.array([[int(part) for part in match.groups()] for match in found if match])


def _of_components(task: Any, fixed: At) -> GridView:
    """Return the view of the states whose other components are fixed."""
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
    letters, words = _letters(space, given, free)
    (top, left), (bottom, right) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    shape = (bottom - top + 1, right - left + 1)
    return GridView(task, states[there], cells[there], (top, left), shape, letters, words)


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


def _letters(
    space: Space, given: Mapping[str, int], free: list[Component]
) -> tuple[tuple[tuple[str, int, int], ...], str]:
    """Return the letters of the fixed cells, and the legend of the picture."""
    letters, keys = list[tuple[str, int, int]](), list[str]()
    for component in space.components:
        if component.name not in given:
            continue
        value, cells = given[component.name], labelled_cells(component)
        if cells is None:
            keys.append(f"{component.name} {component.label(value)}")
            continue
        letter = _letter_of(component.name, [taken for taken, *_ in letters])
        row, column = cells[value - component.low]
        letters.append((letter, int(row), int(column)))
        keys.append(f"{letter}: {component.name}")
    what = f"cells: where {free[0].name} is" if len(free) == 1 else ""
    return tuple(letters), "; ".join(filter(None, (what, ", ".join(keys))))


def _letter_of(name: str, taken: list[str]) -> str:
    """Return the number that a name ends in, or its first letter that is not taken yet."""
    number = re.search(r"\d+$", name)
    candidates = [number.group()] if number else []
    candidates += [letter.upper() for letter in name if letter.isalnum()]
    return next((one for one in candidates if one not in taken), "?")


def _of_agents(task: Any, space: Space, cells: Mapping[str, IntArray]) -> GridView | None:
    """Return the view of a task in whose states one or several pieces stand on cells."""
    agents = [name for name in generative_model(task).actions.names if name in cells]
    free = agents[0] if agents else next(iter(cells))
    rows, columns = cells[free].max(axis=0)
    corners = cycle([(0, 0), (0, columns), (rows, columns), (rows, 0)])
    at = dict[str, Any]()
    for component in space.components:
        if component.name == free:
            continue
        if component.name not in cells:
            at[component.name] = component.low
            continue
        wanted = next(corners) if component.name in agents else (rows // 2, columns // 2)
        distance = abs(cells[component.name] - np.array(wanted)).sum(axis=1)
        at[component.name] = tuple(cells[component.name][distance.argmin()].tolist())
    values = space.decode()
    places = {
        name: where[values[name] - space.component(name).low] for name, where in cells.items()
    }
    return _with_pieces(GridView.of(task, at), places, free)


def _with_pieces(
    view: GridView, places: Mapping[str, IntArray], mover: str | None = None
) -> GridView | None:
    """Return a view with pieces that stand in `places`, (S, 2) each; None if it is too large."""
    rows, columns = view.shape
    if rows * columns > MOST_CELLS:
        return None
    names, pieces, colours = generative_model(view.task).actions.names, list[Piece](), cycle(AGENTS)
    for name, where in places.items():
        acts = len(places) == 1 or name in names
        letter = _letter_of(name, [piece.letter for piece in pieces])
        cells = (where - np.array(view.origin)) @ np.array([columns, 1])
        pieces.append(Piece(name, letter, COLOURS[next(colours) if acts else "black"], cells))
    return replace(view, pieces=tuple(pieces), mover=mover)


def _strip(task: Any, space: Space) -> GridView:
    """Return the view of a task without geometry: its first states in rows."""
    states = np.arange(min(space.size, LONGEST_STRIP))
    cells = np.stack(np.divmod(states, STRIP), axis=1)
    shape = (int(cells[-1, 0]) + 1, min(STRIP, len(states)))
    words = "cells: states by number"
    if len(states) < space.size:
        words += f", the first {len(states)} of {space.size:,}"
    place = np.full(space.size, -1)
    place[states] = cells @ np.array([shape[1], 1])
    piece = Piece("state", "", COLOURS[AGENTS[0]], place)
    return GridView(task, states, cells, (0, 0), shape, (), words, False, (piece,))
