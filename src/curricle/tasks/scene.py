"""Pictures of a maze or a pursuit in one state, quick enough to be drawn at every step.

Figures differ in shape as well as in colour, and most colours are Okabe and Ito's, so that
colour-blind readers can tell them apart.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from functools import cache
from inspect import signature
from textwrap import shorten
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageColor, ImageDraw, ImageFont

from curricle.arrays import IntArray, frozen
from curricle.errors import SettingError
from curricle.tasks.domain import MOVES
from curricle.tasks.grid_layout import LETTERS, GridLayout, layout_of
from curricle.tasks.grid_view import GridView, stacked
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.observation_task import EnvironmentMaker
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.spaces import Space, parts_of
from curricle.tasks.start_states import TaskWithStart
from curricle.tasks.task import generative_model

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
Letters = npt.NDArray[np.str_]
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


def text_of(grid: Letters, there: Mapping[tuple[int, int], str], gap: str) -> str:
    """Return a map of letters with others in some cells, as wide as the widest of them."""
    wide = max(map(len, there.values()))
    cells = {place: there.get(place, letter).ljust(wide) for place, letter in np.ndenumerate(grid)}
    rows, columns = grid.shape
    lines = (gap.join(cells[row, column] for column in range(columns)) for row in range(rows))
    return "\n".join(line.rstrip() for line in lines)


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
        there = [
            (figure.number or "P", *divmod(cell, self._size))
            for cell, figure in zip(self._cells(state), self._figures, strict=True)
        ]
        return text_of(np.full((self._size, self._size), "."), stacked(there), " ")

    def _cells(self, state: int) -> list[int]:
        return [int(cell) for cell in self._states.decode(state).values()]


# -- of tasks --------------------------------------------------------------------------------------


MOST_CELLS = 40_000
"""Cells of a grid that is drawn, at most."""
WIDTH, LINE, LETTER = 480, 28, 9
"""A picture of text: its width, the height of a line, and the width of a letter, in pixels."""
MOST_LINES, LONGEST_LINE = 14, 48
FIGURES = {"#": WALL, "P": PIT, "F": FIRE, "T": TREASURE, "G": TREASURE}
"""What lies in cells, by its letter; a goal looks like a treasure."""


def scene_of(task: Any) -> Scene:
    """Return what draws a task: from above where it says where its states lie, else as a label."""
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


def agent_on(letter: str) -> Figure:
    """Return the agent, small where the cell has an object."""
    return AGENT if letter == "." else ASIDE


def put_letters(canvas: Canvas, grid: Letters) -> Canvas:
    """Return a canvas with the walls and objects of a map of letters, (rows, columns)."""
    for (row, column), letter in np.ndenumerate(grid):
        if letter != ".":
            canvas.put(row, column, FIGURES.get(letter, tile(letter, COATS[1])))
    return canvas


def letters_of(view: GridLayout | GridView, walls: IntArray) -> Letters:
    """Return the map of a layout or a view: walls, and the letters of what lies in cells."""
    grid = np.full(view.shape, ".")
    grid[tuple((walls - view.origin).T)] = "#"
    for name, row, column, _ in view.objects:
        grid[row - view.origin[0], column - view.origin[1]] = LETTERS[name]
    return grid


def lines_of(states: Space, state: int, names: Collection[str]) -> list[str]:
    """Return the values of these components of a state, a line each."""
    return [f"{name} = {label}" for name, label in parts_of(states, state) if name in names]


class LayoutScene:
    """The agent among walls, objects and what else moves; further components are lines of text."""

    def __init__(self, states: Space, layout: GridLayout):
        self._states, origin = states, np.array(layout.origin)
        self._cells = layout.cells - origin
        self._moving = {
            str(i + 1): cells - origin for i, cells in enumerate(layout.markers.values())
        }
        self._others = set(states.names) - {*layout.components, *layout.markers}
        self._map = letters_of(layout, layout.wall_cells)
        self._canvas = put_letters(self._background(), self._map)

    def _background(self) -> Canvas:
        return Canvas(*self._map.shape)

    def image(self, state: int) -> Pixels:
        """Return the grid from above and lines of text below it, (height, width, 3) uint8."""
        row, column = self._cells[state].tolist()
        moving = [(*at[state].tolist(), tile(n, COATS[2])) for n, at in self._moving.items()]
        agent = row, column, agent_on(self._map[row, column])
        grid = self._canvas.with_figures([*moving, agent])
        if not self._others:
            return grid
        below = Image.new("RGB", (grid.shape[1], LINE * len(self._others)), FLOOR)
        draw, font = ImageDraw.Draw(below), ImageFont.load_default(18)
        most = max(4, below.width // LETTER)
        for i, line in enumerate(lines_of(self._states, state, self._others)):
            short = shorten(line, most, placeholder=" …")
            draw.text((LINE // 4, LINE * i + LINE // 2), short, INK, font, anchor="lm")
        return np.concatenate([grid, np.array(below)])

    def text(self, state: int) -> str:
        """Return the map, with ``@`` for the agent and numbers for what else moves."""
        drawn = self._letters().copy()
        for letter, cells in self._moving.items():
            drawn[tuple(cells[state])] = letter
        drawn[tuple(self._cells[state])] = "@"
        lines = ["".join(line) for line in drawn.tolist()]
        return "\n".join(lines + lines_of(self._states, state, self._others))

    def _letters(self) -> Letters:
        return self._map


class MazeScene(LayoutScene):
    """A maze with its walls, fires, pits and treasures, and the agent.

    Cells beside a fire glow if entering them costs extra; a ring marks where episodes start.
    """

    def __init__(self, maze: GridWorld):
        self._maze = maze
        super().__init__(maze.states, maze.layout)

    def _background(self) -> Canvas:
        canvas, maze = super()._background(), self._maze
        if maze.rewards.near_fire:
            burning = np.pad(self._map == "F", 1)
            beside = np.any([np.roll(burning, way, (0, 1)) for way in MOVES.values()], axis=0)
            for row, column in np.argwhere(beside[1:-1, 1:-1] & (self._map != "#")):
                canvas.paint(row, column, GLOW)
        if maze.start != "uniform":
            for row, column in self._cells[maze.mdp.start_states]:
                canvas.put(row, column, START)
        return canvas

    def _letters(self) -> Letters:
        return np.array([list(line) for line in self._maze.map])


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
        lines = lines_of(space, state, space.names)
        if len(lines) > MOST_LINES:
            lines[MOST_LINES - 1 :] = [f"and {len(lines) - MOST_LINES + 1} more"]
        return [shorten(line, LONGEST_LINE, placeholder=" …") for line in lines]

    def text(self, state: int) -> str:
        """Return the state's label."""
        return self._states.label(state)


# -- of a grid view --------------------------------------------------------------------------------


INKS = dict(zip(("blue", "green", "vermillion", "purple", "black"), COATS[:5], strict=True))
"""Colours of markers by name."""


class ViewScene:
    """A grid view with its markers in given cells."""

    def __init__(self, view: GridView):
        self._markers, (_, self._columns) = view.markers, view.shape
        self._map = letters_of(view, view.walls)
        self._canvas = put_letters(Canvas(*view.shape), self._map)

    def image(self, cells: IntArray) -> Pixels:
        """Return the grid from above, (height, width, 3) uint8.

        `cells`, (markers,), are where each is, as row * columns + column.
        """
        places = [divmod(int(cell), self._columns) for cell in cells]
        if len(places) == 1:
            figure = agent_on(self._map[places[0]])
            return self._canvas.with_figures([(*places[0], figure)])
        return self._canvas.with_figures(
            (*place, tile(marker.letter, INKS[marker.colour]))
            for place, marker in zip(places, self._markers, strict=True)
        )

    def text(self, cells: IntArray) -> str:
        """Return the map with each marker's letter, or ``@`` for the only one."""
        places = [divmod(cell, self._columns) for cell in cells.tolist()]
        if len(places) == 1:
            return text_of(self._map, {places[0]: "@"}, "")
        letters = (marker.letter for marker in self._markers)
        there = stacked((letter, *place) for letter, place in zip(letters, places, strict=True))
        return text_of(self._map, there, " ")


# -- pictures of environments ----------------------------------------------------------------------


PICTURES = "rgb_array"


def with_pictures(make: Callable[[], Any]) -> Callable[[], Any]:
    """Return what makes the same environments, with pictures where they can be asked for."""
    if not isinstance(make, EnvironmentMaker):
        return EnvironmentMaker(make, _render_mode(make)) if _render_mode(make) else make
    if isinstance(make.what, EnvironmentMaker):
        return replace(make, what=with_pictures(make.what))
    return replace(make, arguments={**make.arguments, **_render_mode(make.what)})


def _render_mode(what: Any) -> dict[str, str]:
    """Return the argument that asks for pictures, if an environment's maker has it."""
    asked = not callable(what) or "render_mode" in signature(what).parameters
    return {"render_mode": PICTURES} if asked else {}


def draws_pictures(environment: Any) -> bool:
    """Return whether an environment says that it can draw pictures."""
    return PICTURES in getattr(environment, "metadata", {}).get("render_modes", ())


def frame_of(environment: Any) -> npt.NDArray[np.uint8]:
    """Return a picture of an environment, (height, width, 3) uint8; SettingError if it has none."""
    mode = getattr(environment, "render_mode", None)
    drawn: Any = environment.render() if mode == PICTURES else None
    if np.ndim(drawn) != 3:
        raise SettingError(
            'an episode\'s environment must draw pictures, render_mode="rgb_array": got '
            f"render_mode={mode!r} from {environment}"
        )
    return np.array(drawn, dtype=np.uint8)
