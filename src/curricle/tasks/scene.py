"""Pictures of a maze or a pursuit in one state, quick enough to be drawn at every step.

Figures differ in shape as well as in colour, and most colours are Okabe and Ito's, so that
colour-blind readers can tell them apart.
"""

import math
from collections.abc import Callable, Iterable
from functools import cache
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageColor, ImageDraw, ImageFont

from curricle.frozen_arrays import frozen
from curricle.tasks.grid_map import MOVES
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.pursuit import Pursuit

FINER = 4
"""Figures are drawn this many times larger and then reduced, which smooths their edges."""
FLOOR, DARK, INK = "#f7f5f0", "#4d5366", "#22242c"

Shape = tuple[Callable[..., None], tuple[float, ...], str]
"""The method that draws it, its coordinates in a cell of side 1, and its colour."""
OVAL, BLOCK = ImageDraw.ImageDraw.ellipse, ImageDraw.ImageDraw.rectangle
POLYGON = ImageDraw.ImageDraw.polygon


class Figure(NamedTuple):
    """Shapes, the later ones on top, and a number written over them."""

    shapes: tuple[Shape, ...]
    number: str = ""


def _flame(middle: float, width: float, top: float, bottom: float) -> tuple[float, ...]:
    """Return an outline that is pointed above and round below."""
    t = np.linspace(0, 2 * np.pi, 60)
    x = middle + 0.6 * width * np.sin(t) * np.sin(t / 2) ** 1.6
    y = (top + bottom) / 2 - (bottom - top) / 2 * np.cos(t)
    return tuple(np.stack([x, y], axis=1).ravel().tolist())


WALL = Figure(
    (
        (BLOCK, (0, 0, 1, 1), DARK),
        *((BLOCK, (0, y, 1, y + 0.03), "#6b7288") for y in (0.31, 0.64, 0.97)),
        *((BLOCK, (x, 0.00, x + 0.03, 0.31), "#6b7288") for x in (0.22, 0.72)),
        *((BLOCK, (x, 0.34, x + 0.03, 0.64), "#6b7288") for x in (0.47, 0.97)),
        *((BLOCK, (x, 0.67, x + 0.03, 0.97), "#6b7288") for x in (0.22, 0.72)),
    )
)
START = Figure(
    ((OVAL, (0.18, 0.18, 0.82, 0.82), "#c9c4b4"), (OVAL, (0.24, 0.24, 0.76, 0.76), FLOOR))
)
PIT = Figure(
    (
        (OVAL, (0.06, 0.14, 0.94, 0.90), "#b3ad9a"),
        (OVAL, (0.12, 0.20, 0.88, 0.87), DARK),
        (OVAL, (0.16, 0.32, 0.84, 0.87), "#000000"),
    )
)
FIRE = Figure(
    (
        (POLYGON, _flame(0.32, 0.40, 0.34, 0.90), "#D55E00"),
        (POLYGON, _flame(0.68, 0.40, 0.28, 0.90), "#D55E00"),
        (POLYGON, _flame(0.50, 0.62, 0.06, 0.94), "#D55E00"),
        (POLYGON, _flame(0.50, 0.36, 0.40, 0.92), "#F0E442"),
    )
)
TREASURE = Figure(
    (
        (OVAL, (0.12, 0.18, 0.88, 0.76), "#7a4f00"),
        (BLOCK, (0.12, 0.46, 0.88, 0.84), "#7a4f00"),
        (OVAL, (0.17, 0.23, 0.83, 0.70), "#E69F00"),
        (BLOCK, (0.17, 0.53, 0.83, 0.79), "#E69F00"),
        (BLOCK, (0.12, 0.44, 0.88, 0.52), "#7a4f00"),
        (BLOCK, (0.41, 0.40, 0.59, 0.64), "#F0E442"),
        (BLOCK, (0.47, 0.47, 0.53, 0.58), INK),
    )
)
AGENT = Figure(
    (
        (OVAL, (0.08, 0.08, 0.92, 0.92), "#ffffff"),
        (OVAL, (0.12, 0.12, 0.88, 0.88), "#0072B2"),
        *((OVAL, (x, 0.32, x + 0.20, 0.58), "#ffffff") for x in (0.27, 0.53)),
        *((OVAL, (x, 0.40, x + 0.11, 0.54), INK) for x in (0.33, 0.57)),
    )
)
PREY = Figure(
    (
        *((OVAL, (x, 0.08, x + 0.38, 0.46), "#7a4f00") for x in (0.04, 0.58)),
        *((OVAL, (x, 0.16, x + 0.22, 0.38), "#f3cfa0") for x in (0.12, 0.66)),
        (OVAL, (0.12, 0.20, 0.88, 0.92), "#E69F00"),
        *((OVAL, (x, 0.44, x + 0.11, 0.59), INK) for x in (0.31, 0.58)),
        (OVAL, (0.43, 0.66, 0.57, 0.77), "#7a4f00"),
    )
)
OBJECTS = {"#": WALL, "P": PIT, "F": FIRE, "T": TREASURE}
ASIDE = Figure(
    tuple(
        (method, tuple(0.44 + 0.56 * v for v in at), colour) for method, at, colour in AGENT.shapes
    )
)
"""The agent, drawn small, in a cell with an object."""
COATS = ("#0072B2", "#00785A", "#B34700", "#8E4C7A", "#444444", "#2B6E96")


def predator(number: int) -> Figure:
    """Return a round head with pointed ears, and its number in white."""
    coat = COATS[(number - 1) % len(COATS)]
    ears = (0.08, 0.04, 0.46, 0.24, 0.12, 0.56), (0.92, 0.04, 0.54, 0.24, 0.88, 0.56)
    head = (OVAL, (0.08, 0.16, 0.92, 0.96), coat)
    return Figure((*((POLYGON, ear, coat) for ear in ears), head), str(number))


@cache
def painted(figure: Figure, side: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return a figure's colours, (side, side, 3), and its transparency, (side, side, 1)."""
    large = side * FINER
    image = Image.new("RGBA", (large, large))
    draw = ImageDraw.Draw(image)
    for method, coordinates, colour in figure.shapes:
        method(draw, [large * value for value in coordinates], fill=colour)
    if figure.number:
        font = ImageFont.load_default(0.52 * large / max(1, len(figure.number) - 0.5))
        middle = (0.5 * large, 0.57 * large)
        draw.text(middle, figure.number, "#ffffff", font, anchor="mm", stroke_width=0.02 * large)
    pixels = np.asarray(image.resize((side, side), Image.Resampling.LANCZOS), dtype=np.float32)
    opaque = pixels[..., 3:] / np.float32(255)
    return frozen(pixels[..., :3] * opaque), frozen(1 - opaque)


Pixels = npt.NDArray[np.uint8]
SIDE = 640
"""Pixels along the longer side of a grid, unless its cells would be too large or too small."""
LARGEST_CELL, SMALLEST_CELL = 64, 4
MARGIN = 4
LINES, GLOW = "#dedace", "#fadcc9"


class Scene(Protocol):
    """A task that can be drawn in any of its states."""

    def image(self, state: int) -> Pixels:
        """Return a picture, (height, width, 3) uint8; the size is the same for every state."""

    def text(self, state: int) -> str:
        """Return a drawing made of characters."""


class Canvas:
    """A grid seen from above, north on top, on which figures are put; a frame marks its edge."""

    def __init__(self, height: int, width: int, *, framed: bool = True):
        # Even, as video formats require.
        self._cell = max(SMALLEST_CELL, min(LARGEST_CELL, SIDE // max(height, width)) // 2 * 2)
        size = (height * self._cell + 2 * MARGIN, width * self._cell + 2 * MARGIN, 3)
        self._backdrop = np.empty(size, np.uint8)
        self._backdrop[:] = ImageColor.getrgb(DARK if framed else FLOOR)
        for row, column in np.ndindex(height, width):
            self.paint(row, column, FLOOR)

    def paint(self, row: int, column: int, colour: str) -> None:
        """Give a cell of the background a colour."""
        y, x = self._corner(row, column)
        self._backdrop[y : y + self._cell, x : x + self._cell] = ImageColor.getrgb(LINES)
        inside = slice(y + 1, y + self._cell - 1), slice(x + 1, x + self._cell - 1)
        self._backdrop[inside] = ImageColor.getrgb(colour)

    def put(self, row: int, column: int, figure: Figure) -> None:
        """Put a figure into a cell of the background."""
        _paste(self._backdrop, self._corner(row, column), figure, self._cell)

    def with_figures(self, figures: Iterable[tuple[int, int, Figure]]) -> Pixels:
        """Return the grid with figures in rows and columns, (height, width, 3) uint8.

        Figures that share a cell are side by side.
        """
        together: dict[tuple[int, int], list[Figure]] = {}
        for row, column, figure in figures:
            together.setdefault((row, column), []).append(figure)
        image = self._backdrop.copy()
        for place, group in together.items():
            (top, left), across = self._corner(*place), math.ceil(math.sqrt(len(group)))
            side = self._cell // across
            for i, figure in enumerate(group):
                corner = top + side * (i // across), left + side * (i % across)
                _paste(image, corner, figure, side)
        return image

    def _corner(self, row: int, column: int) -> tuple[int, int]:
        """Return where a cell begins, y and x."""
        return MARGIN + self._cell * row, MARGIN + self._cell * column


def _paste(image: Pixels, corner: tuple[int, int], figure: Figure, side: int) -> None:
    colours, through = painted(figure, side)
    region = image[corner[0] : corner[0] + side, corner[1] : corner[1] + side]
    region[:] = region * through + colours


class MazeScene:
    """A maze with its walls, fires, pits and treasures, and the agent.

    Cells beside a fire glow if entering them costs extra; a ring marks where episodes start.
    """

    def __init__(self, maze: GridWorld):
        self._map = maze.map
        self._places: list[list[int]] = (maze.cells - maze.origin).tolist()
        self._canvas = Canvas(len(maze.map), len(maze.map[0]))
        drawn = dict(np.ndenumerate([list(line) for line in maze.map]))
        if maze.rewards.near_fire:
            for (row, column), what in drawn.items():
                beside = [drawn.get((row + down, column + right)) for down, right in MOVES.values()]
                if what != "#" and "F" in beside:
                    self._canvas.paint(row, column, GLOW)
        if maze.start != "uniform":
            for state in maze.mdp.start_states:
                row, column = self._places[state]
                self._canvas.put(row, column, START)
        for (row, column), what in drawn.items():
            if what in OBJECTS:
                self._canvas.put(row, column, OBJECTS[what])

    def image(self, state: int) -> Pixels:
        """Return the maze from above, (height, width, 3) uint8."""
        row, column = self._places[state]
        figure = ASIDE if self._map[row][column] in OBJECTS else AGENT
        return self._canvas.with_figures([(row, column, figure)])

    def text(self, state: int) -> str:
        """Return the map, with ``@`` where the agent is."""
        row, column = self._places[state]
        lines = list(self._map)
        lines[row] = f"{lines[row][:column]}@{lines[row][column + 1 :]}"
        return "\n".join(lines)


class PursuitScene:
    """The prey and the numbered predators of a pursuit; a dark frame where the grid is walled."""

    def __init__(self, pursuit: Pursuit):
        self._size, self._states = pursuit.size, pursuit.states
        self._canvas = Canvas(pursuit.size, pursuit.size, framed=not pursuit.torus)
        self._figures = [PREY, *(predator(i + 1) for i in range(pursuit.predators))]

    def image(self, state: int) -> Pixels:
        """Return the grid from above, (height, width, 3) uint8."""
        places = self._cells(state)
        return self._canvas.with_figures(
            (*divmod(cell, self._size), figure)
            for cell, figure in zip(places, self._figures, strict=True)
        )

    def text(self, state: int) -> str:
        """Return the grid with ``P`` for the prey and each predator's number."""
        there = [""] * self._size**2
        for cell, figure in zip(self._cells(state), self._figures, strict=True):
            there[cell] += figure.number or "P"
        width = max(map(len, there))
        rows = np.reshape([(letters or ".").ljust(width) for letters in there], (-1, self._size))
        return "\n".join(" ".join(row).rstrip() for row in rows)

    def _cells(self, state: int) -> list[int]:
        return [int(cell) for cell in self._states.decode(state).values()]
