"""Stages: where a page shows the states of any task, who moves there, and what a choice looks like.

A maze or a pursuit is shown as its grid; states without geometry stand in a strip, six a row.
Places are counted from the top-left cell: column, then row.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.plotting.figures import COLOURS, LETTERS, TINTS
from curricle.plotting.grid_view import Board, board, labelled_cells, letter_of
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.labels import action_name
from curricle.tasks.spaces import Space
from curricle.tasks.task import generative_model

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

STRIP = 6
"""States in a row of a strip."""
LONGEST_STRIP = 60
"""States of a strip at most."""
MOST_CELLS = 2500
"""Cells of a grid at most."""
LONGEST_WORD = 9
"""Letters of an action's name up to which it is written into a cell."""
DIRECTIONS = {"stay": 0, "noop": 0, "north": 1, "up": 1, "east": 2, "right": 2}
DIRECTIONS |= {"south": 3, "down": 3, "west": 4, "left": 4}
AGENTS = ("blue", "vermillion", "green", "purple")
"""Colours of those that act; others are black."""

_CELL = re.compile(r"\((\d+), ?(\d+)\)")
# Of a direction, drawn for north from the middle of a cell one wide: alone, and among equals.
_HALF = ((0.15, -0.05), (0.05, -0.05), (0.05, 0.26))
_ARROW = ((0, -0.26), *_HALF, *((-x, y) for x, y in reversed(_HALF)))
_TIP = ((0, -0.32), (0.1, -0.18), (-0.1, -0.18))
_STAY = ((0, -0.1), (0.1, 0), (0, 0.1), (-0.1, 0))


@dataclass(frozen=True, eq=False)
class Actor:
    """Who moves in an episode.

    Attributes
    ----------
    name, letter : str
    colour : str
        As ``#rrggbb``.
    cells : (S,) int64
        Where it is in each state, as ``row * columns + column``; -1 where that is not shown.
    """

    name: str
    letter: str
    colour: str
    cells: IntArray


@dataclass(frozen=True, eq=False)
class Stage:
    """Where states of a task are shown.

    Attributes
    ----------
    board : Board
        The states that make one picture, a cell each.
    is_map : bool
        Whether the cells are places of the task. In a strip they are states in order.
    options : (A,) int64
        What each action means for whoever is drawn: a direction from 0 (stay), 1 (north) to
        4 (west), or an action's own number.
    arrows : bool
        Whether options are directions.
    actors : tuple of Actor
    """

    board: Board
    is_map: bool
    options: IntArray
    arrows: bool
    actors: tuple[Actor, ...]

    @property
    def known(self) -> IntArray:
        """The options that there are, (O,)."""
        return np.unique(self.options)

    def choices(self, action_values: npt.NDArray[np.floating[Any]]) -> BoolArray:
        """Return which options are greedy, ties included: (..., A) -> (..., O)."""
        greedy = action_values == action_values.max(axis=-1, keepdims=True)
        chosen = [greedy[..., self.options == option].any(axis=-1) for option in self.known]
        return np.stack(chosen, axis=-1)

    def mark(self, chosen: BoolArray) -> str:
        """Return how a choice, (O,), is drawn into a cell.

        A path around the cell's middle where options are directions, words elsewhere; nothing where
        all options are as good.
        """
        if chosen.all() and len(chosen) > 1:
            return ""
        best = self.known[chosen].tolist()
        if self.arrows:
            return "".join(_path(option, alone=len(best) == 1) for option in best)
        actions = generative_model(self.board.task).actions
        return "/".join(_word(actions, option) for option in best)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.board.shape[1], self.board.shape[0]

    @property
    def things(self) -> tuple[tuple[str, str, int, int, bool], ...]:
        """What lies on the grid: letter, colour, column, row, and whether it ends the episode."""
        maze = self.board.task
        if not isinstance(maze, GridWorld):
            return ()
        top, left = self.board.origin
        return tuple(
            (LETTERS[name], TINTS[name], column - left, row - top, name in maze.ends)
            for name, row, column in maze.objects
        )

    @property
    def fixed(self) -> tuple[tuple[str, int, int], ...]:
        """Who stands where in the picture of the board: letters, column and row."""
        together: dict[tuple[int, int], str] = {}
        for letter, row, column in self.board.letters:
            place = column - self.board.origin[1], row - self.board.origin[0]
            together[place] = together.get(place, "") + letter
        return tuple((letters, *place) for place, letters in together.items())

    @property
    def labels(self) -> tuple[tuple[int, int, str], ...]:
        """Column, row and number of each state in a strip; empty for a map."""
        places = self._places(self.board.cells).tolist()
        states = () if self.is_map else self.board.states.tolist()
        return tuple((x, y, str(state)) for (x, y), state in zip(places, states, strict=False))

    @property
    def over(self) -> str:
        """The path of the cells in which the episode is over."""
        return squares(self._places(self.board.cells[self.board.ended]))

    @property
    def walls(self) -> str:
        """The path of the cells of a map that are none of the task's."""
        columns, rows = self.size
        free = {(x, y) for x, y in self._places(self.board.cells).tolist()}
        eval_freq = [(x, y) for y in range(rows) for x in range(columns) if (x, y) not in free]
        return squares(np.array(eval_freq, dtype=np.int64).reshape(-1, 2)) if self.is_map else ""

    @property
    def lines(self) -> str:
        """The path of the lines between cells."""
        columns, rows = self.size
        across = "".join(f"M0 {y}h{columns}" for y in range(rows + 1))
        return across + "".join(f"M{x} 0v{rows}" for x in range(columns + 1))

    def _places(self, cells: IntArray) -> IntArray:
        """Return column and row from the top-left cell, (n, 2)."""
        return np.asarray((cells - np.array(self.board.origin))[:, ::-1])


def stage(task: Any) -> Stage | None:
    """Return where a task's states are shown; None where a picture would have too many cells.

    Of several cells in a state the first that an action moves is drawn in every place, that of an
    agent; what no action moves stands in the middle, other agents in the corners.

    Examples
    --------
    >>> from curricle import GridWorld, Pursuit
    >>> hunt = stage(Pursuit(3, 2))
    >>> hunt.board.words, [actor.letter for actor in hunt.actors]
    ('cells: where predator_1 is; P: prey, 2: predator_2', ['P', '1', '2'])
    >>> maze = stage(GridWorld(["S.", ".T"]))
    >>> maze.choices(np.array([0.0, 1.0, 1.0, 0.0])), maze.things
    (array([False,  True,  True, False]), (('T', '#f2c14e', 1, 1, True),))
    """
    if isinstance(task, GridWorld):
        return _grid(board(task), {"agent": task.cells})
    space = generative_model(task).states
    if cells := _cell_components(space):
        return _pieces(task, space, cells)
    for names in (("row", "column"), ("y", "x")):
        if set(names) <= set(space.names):
            values = space.decode()
            places = np.stack([values[name] for name in names], axis=1)
            fixed = {c.name: c.low for c in space.components if c.name not in names}
            return _grid(board(task, fixed), {"agent": places})
    return _strip(task, space)


def squares(cells: npt.NDArray[np.integer[Any]]) -> str:
    """Return the path of unit squares with these corners, (n, 2) column and row.

    Examples
    --------
    >>> squares(np.array([[0, 0], [2, 1]]))
    'M0 0h1v1h-1zM2 1h1v1h-1z'
    """
    return "".join(f"M{x} {y}h1v1h-1z" for x, y in cells.tolist())


def _cell_components(space: Space) -> dict[str, IntArray]:
    """Return the components whose labels are cells, with the row and column of each value."""
    read = {component.name: labelled_cells(component) for component in space.components}
    return {name: cells for name, cells in read.items() if cells is not None}


def _pieces(task: Any, space: Space, cells: Mapping[str, IntArray]) -> Stage | None:
    """Return the stage of a task in whose states one or several stand on cells."""
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
        away = abs(cells[component.name] - np.array(wanted)).sum(axis=1)
        at[component.name] = tuple(cells[component.name][away.argmin()].tolist())
    values = space.decode()
    places = {
        name: where[values[name] - space.component(name).low] for name, where in cells.items()
    }
    return _grid(board(task, at), places, free)


def _grid(shown: Board, places: Mapping[str, IntArray], mover: str | None = None) -> Stage | None:
    """Return the stage of a grid; `mover` is the agent whose own moves are drawn."""
    rows, columns = shown.shape
    if rows * columns > MOST_CELLS:
        return None
    actions = generative_model(shown.task).actions
    options, arrows = np.arange(actions.size), False
    own = [one for one in actions.components if one.name == mover or len(actions.names) == 1]
    if own and set(own[0].labels or ("",)) <= set(DIRECTIONS):
        moves = actions.decode()[own[0].name]
        options = np.array([DIRECTIONS[own[0].label(int(move))] for move in moves])
        arrows = True
    actors = list[Actor]()
    acting = cycle(AGENTS)
    for name, where in places.items():
        acts = len(places) == 1 or name in actions.names
        letter = letter_of(name, [actor.letter for actor in actors])
        cells = (where - np.array(shown.origin)) @ np.array([columns, 1])
        actors.append(Actor(name, letter, COLOURS[next(acting) if acts else "black"], cells))
    return Stage(shown, True, options, arrows, tuple(actors))


def _strip(task: Any, space: Space) -> Stage:
    """Return the stage of a task without geometry: its first states in rows."""
    states = np.arange(min(space.size, LONGEST_STRIP))
    cells = np.stack(np.divmod(states, STRIP), axis=1)
    shape = (int(cells[-1, 0]) + 1, min(STRIP, len(states)))
    words = "cells: states by number"
    if len(states) < space.size:
        words += f", the first {len(states)} of {space.size:,}"
    place = np.full(space.size, -1)
    place[states] = cells @ np.array([shape[1], 1])
    shown = Board(task, states, cells, (0, 0), shape, (), words)
    agent = Actor("state", "", COLOURS[AGENTS[0]], place)
    return Stage(shown, False, np.arange(generative_model(task).actions.size), False, (agent,))


def _word(actions: Space, action: int) -> str:
    name = action_name(actions, action).removeprefix("action ")
    return name if len(name) <= LONGEST_WORD else str(action)


def _path(option: int, *, alone: bool) -> str:
    """Return a direction as a path from a cell's middle and back: an arrow, or one of several."""
    points: tuple[tuple[float, float], ...] = _STAY
    if option:
        # A quarter turn from north for each option on.
        cos, sin = [(1, 0), (0, 1), (-1, 0), (0, -1)][option - 1]
        drawn = _ARROW if alone else _TIP
        points = tuple((x * cos - y * sin, x * sin + y * cos) for x, y in drawn)
    way = np.diff(np.array([(0.0, 0.0), *points]), axis=0).round(3).tolist()
    steps = [f"{x:zg},{y:zg}" for x, y in [*way, (-points[0][0], -points[0][1])]]
    # A page may hold thousands of them: 0.5 is written .5.
    return f"m{' '.join(steps[:-1])}zm{steps[-1]}".replace("0.", ".")
