"""What draws a task in one state: a maze, a pursuit, any other grid, or text."""

from textwrap import shorten
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from curricle.tasks.grid_layout import LETTERS, GridLayout, layout_of
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.labels import values_of
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.scene import (
    AGENT,
    ASIDE,
    BLOCK,
    COATS,
    DARK,
    FLOOR,
    INK,
    OBJECTS,
    WALL,
    Canvas,
    Figure,
    MazeScene,
    Pixels,
    PursuitScene,
    Scene,
)
from curricle.tasks.spaces import Space
from curricle.tasks.start_states import TaskWithStart
from curricle.tasks.task import generative_model

MOST_CELLS = 40_000
"""Cells of a grid that is drawn, at most."""
WIDTH, LINE, LETTER = 480, 28, 9
"""A picture of text: its width, the height of a line, and the width of a letter, in pixels."""
MOST_LINES, LONGEST_LINE = 14, 48
FIGURES = {**OBJECTS, "G": OBJECTS["T"]}
"""What lies in cells, by its letter; a goal looks like a treasure."""


def scene_of(task: Any) -> Scene:
    """Return what draws a task: from above where it says where its states lie, else as a label.

    Examples
    --------
    >>> from curricle import GridWorld, Pursuit
    >>> print(scene_of(GridWorld(["S#T", "..."])).text(3))
    S#T
    .@.
    >>> scene_of(Pursuit(3, 2)).image(0).shape
    (200, 200, 3)
    >>> scene_of(Pursuit(3, 1).mdp).text(5)
    'prey=(0,0) predator=(1,2)'
    """
    if isinstance(task, GridWorld):
        return MazeScene(task)
    if isinstance(task, Pursuit):
        return PursuitScene(task)
    if isinstance(task, TaskWithStart):
        return scene_of(task.task)
    states, layout = generative_model(task).states, layout_of(task)
    if layout is not None and layout.shape[0] * layout.shape[1] <= MOST_CELLS:
        return LayoutScene(states, layout)
    return LabelScene(states)


def tile(letter: str, colour: str) -> Figure:
    """Return a square with a letter in white."""
    return Figure(((BLOCK, (0.08, 0.08, 0.92, 0.92), colour),), letter)


def canvas_of(grid: npt.NDArray[np.str_]) -> Canvas:
    """Return a canvas with the walls and objects of a map of letters, (rows, columns)."""
    canvas = Canvas(*grid.shape)
    for (row, column), letter in np.ndenumerate(grid):
        if letter != ".":
            figure = WALL if letter == "#" else FIGURES.get(letter, tile(letter, COATS[1]))
            canvas.put(row, column, figure)
    return canvas


class LayoutScene:
    """The agent among walls, objects and what else moves; further components are lines of text."""

    def __init__(self, states: Space, layout: GridLayout):
        self._states, origin = states, np.array(layout.origin)
        self._cells = layout.cells - origin
        self._moving = {
            str(i + 1): cells - origin for i, cells in enumerate(layout.markers.values())
        }
        drawn = {*layout.components, *layout.markers}
        self._others = [part for part in states.components if part.name not in drawn]
        self._map = np.full(layout.shape, "#" if layout.walls is None else ".")
        self._map[tuple(self._cells.T)] = "."
        if layout.walls is not None:
            self._map[tuple((layout.walls - origin).T)] = "#"
        for name, row, column, _ in layout.objects:
            self._map[row - origin[0], column - origin[1]] = LETTERS[name]
        self._canvas = canvas_of(self._map)

    def image(self, state: int) -> Pixels:
        """Return the grid from above and lines of text below it, (height, width, 3) uint8."""
        row, column = self._cells[state].tolist()
        figure = AGENT if self._map[row, column] == "." else ASIDE
        moving = [(*at[state].tolist(), tile(n, COATS[2])) for n, at in self._moving.items()]
        grid = self._canvas.with_figures([*moving, (row, column, figure)])
        if not self._others:
            return grid
        below = Image.new("RGB", (grid.shape[1], LINE * len(self._others)), FLOOR)
        draw, font = ImageDraw.Draw(below), ImageFont.load_default(18)
        most = max(4, below.width // LETTER)
        for i, words in enumerate(self._words(state)):
            said = shorten(words, most, placeholder=" …")
            draw.text((LINE // 4, LINE * i + LINE // 2), said, INK, font, anchor="lm")
        return np.concatenate([grid, np.array(below)])

    def text(self, state: int) -> str:
        """Return the map, with ``@`` for the agent and numbers for what else moves."""
        drawn = self._map.copy()
        for letter, cells in self._moving.items():
            drawn[tuple(cells[state])] = letter
        drawn[tuple(self._cells[state])] = "@"
        return "\n".join(["".join(line) for line in drawn.tolist()] + self._words(state))

    def _words(self, state: int) -> list[str]:
        values = values_of(self._states, state)
        return [f"{part.name} = {part.label(values[part.name])}" for part in self._others]


class LabelScene:
    """The number of a state and the values of its components, as text."""

    def __init__(self, states: Space):
        self._states = states

    def image(self, state: int) -> Pixels:
        """Return a card with a line for each component, (height, width, 3) uint8."""
        lines = self._lines(state)
        height = LINE * (len(lines) + (3 if lines else 2))
        image = Image.new("RGB", (WIDTH, height), FLOOR)
        draw = ImageDraw.Draw(image)
        draw.rectangle((0, 0, WIDTH, 2 * LINE), fill=DARK)
        large, font = ImageFont.load_default(22), ImageFont.load_default(18)
        draw.text((LINE, LINE), f"state {state}", "#ffffff", large, anchor="lm")
        for i, line in enumerate(lines):
            draw.text((LINE, LINE * (i + 3)), line, INK, font, anchor="lm")
        return np.array(image)

    def _lines(self, state: int) -> list[str]:
        """Return the components' values, nothing for the one component of plain numbered states."""
        space = self._states
        first, *others = space.components
        if space.is_box and first.low == 0 and first.labels is None and not others:
            return []
        values = values_of(space, state)
        lines = [f"{c.name} = {c.label(values[c.name])}" for c in space.components]
        if len(lines) > MOST_LINES:
            lines[MOST_LINES - 1 :] = [f"and {len(lines) - MOST_LINES + 1} more"]
        return [shorten(line, LONGEST_LINE, placeholder=" …") for line in lines]

    def text(self, state: int) -> str:
        """Return the state's label."""
        return self._states.label(state)
