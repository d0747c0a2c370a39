"""Pictures and text of a task in one state, quick enough to be drawn at every step.

Figures differ in shape as well as in colour, and most colours are Okabe and Ito's, so that
colour-blind readers can tell them apart.
"""

import io
import math
from base64 import b64encode
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cache
from textwrap import shorten
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt
from markupsafe import Markup
from PIL import Image, ImageColor, ImageDraw, ImageFont

from curricle.arrays import BoolArray, IntArray, frozen
from curricle.pictures.views import GridView, bars_of, layout_of, marker_letters, stacked
from curricle.tasks.grid import LETTERS, MOVES, GridLayout
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.live import LiveMDP, reset_state
from curricle.tasks.mdp import Task, generative_model, has_tables, tables
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.spaces import Space, parts_of
from curricle.tasks.start_states import TaskWithStart
from curricle.text import counted

COLOURS = {
    "black": "#000000",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "green": "#009E73",
    "blue": "#0072B2",
    "vermillion": "#D55E00",
    "purple": "#CC79A7",
    "grey": "#777777",
}
"""The palette of Okabe and Ito, which colour-blind readers can tell apart."""
FINER = 4  # figures are drawn this many times larger and then reduced, which smooths their edges
FLOOR, DARK, INK, WHITE = "#f7f5f0", "#4d5366", "#22242c", "#ffffff"
MIDDLE = (0.5, 0.57)  # of a number that is written over a figure

# The method that draws it, or text; its coordinates in a cell of side 1; its colour.
Shape = tuple[Callable[..., None] | str, tuple[float, ...], str]
Figure = tuple[Shape, ...]  # the later shapes on top
OVAL, BLOCK = ImageDraw.ImageDraw.ellipse, ImageDraw.ImageDraw.rectangle
POLYGON = ImageDraw.ImageDraw.polygon


def _flame(middle: float, width: float, top: float, bottom: float) -> tuple[float, ...]:
    """Return an outline that is pointed above and round below."""
    t = np.linspace(0, 2 * np.pi, 60)
    x = middle + 0.6 * width * np.sin(t) * np.sin(t / 2) ** 1.6
    y = (top + bottom) / 2 - (bottom - top) / 2 * np.cos(t)
    return tuple(np.stack([x, y], axis=1).ravel().tolist())


WALL = (
    (BLOCK, (0, 0, 1, 1), DARK),
    *((BLOCK, (0, y, 1, y + 0.03), "#6b7288") for y in (0.31, 0.64, 0.97)),
    *((BLOCK, (x, 0.00, x + 0.03, 0.31), "#6b7288") for x in (0.22, 0.72)),
    *((BLOCK, (x, 0.34, x + 0.03, 0.64), "#6b7288") for x in (0.47, 0.97)),
    *((BLOCK, (x, 0.67, x + 0.03, 0.97), "#6b7288") for x in (0.22, 0.72)),
)
START = (OVAL, (0.18, 0.18, 0.82, 0.82), "#c9c4b4"), (OVAL, (0.24, 0.24, 0.76, 0.76), FLOOR)
PIT = (
    (OVAL, (0.06, 0.14, 0.94, 0.90), "#b3ad9a"),
    (OVAL, (0.12, 0.20, 0.88, 0.87), DARK),
    (OVAL, (0.16, 0.32, 0.84, 0.87), "#000000"),
)
FIRE = (
    (POLYGON, _flame(0.32, 0.40, 0.34, 0.90), COLOURS["vermillion"]),
    (POLYGON, _flame(0.68, 0.40, 0.28, 0.90), COLOURS["vermillion"]),
    (POLYGON, _flame(0.50, 0.62, 0.06, 0.94), COLOURS["vermillion"]),
    (POLYGON, _flame(0.50, 0.36, 0.40, 0.92), "#F0E442"),
)
TREASURE = (
    (OVAL, (0.12, 0.18, 0.88, 0.76), "#7a4f00"),
    (BLOCK, (0.12, 0.46, 0.88, 0.84), "#7a4f00"),
    (OVAL, (0.17, 0.23, 0.83, 0.70), COLOURS["orange"]),
    (BLOCK, (0.17, 0.53, 0.83, 0.79), COLOURS["orange"]),
    (BLOCK, (0.12, 0.44, 0.88, 0.52), "#7a4f00"),
    (BLOCK, (0.41, 0.40, 0.59, 0.64), "#F0E442"),
    (BLOCK, (0.47, 0.47, 0.53, 0.58), INK),
)
AGENT = (
    (OVAL, (0.08, 0.08, 0.92, 0.92), WHITE),
    (OVAL, (0.12, 0.12, 0.88, 0.88), COLOURS["blue"]),
    *((OVAL, (x, 0.32, x + 0.20, 0.58), WHITE) for x in (0.27, 0.53)),
    *((OVAL, (x, 0.40, x + 0.11, 0.54), INK) for x in (0.33, 0.57)),
)
PREY = (
    *((OVAL, (x, 0.08, x + 0.38, 0.46), "#7a4f00") for x in (0.04, 0.58)),
    *((OVAL, (x, 0.16, x + 0.22, 0.38), "#f3cfa0") for x in (0.12, 0.66)),
    (OVAL, (0.12, 0.20, 0.88, 0.92), COLOURS["orange"]),
    *((OVAL, (x, 0.44, x + 0.11, 0.59), INK) for x in (0.31, 0.58)),
    (OVAL, (0.43, 0.66, 0.57, 0.77), "#7a4f00"),
)
ASIDE = tuple((drawn, tuple(0.44 + 0.56 * x for x in at), colour) for drawn, at, colour in AGENT)
"""The agent, drawn small, in a cell with an object."""
COATS = ("#0072B2", "#00785A", "#B34700", "#8E4C7A", "#444444", "#2B6E96")


def predator(number: int) -> Figure:
    """Return a round head with pointed ears, and its number in white."""
    coat = COATS[(number - 1) % len(COATS)]
    ears = (0.08, 0.04, 0.46, 0.24, 0.12, 0.56), (0.92, 0.04, 0.54, 0.24, 0.88, 0.56)
    head = (OVAL, (0.08, 0.16, 0.92, 0.96), coat)
    return (*((POLYGON, ear, coat) for ear in ears), head, (str(number), MIDDLE, WHITE))


@cache
def painted(figure: Figure, side: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return a figure's colours, (side, side, 3), and its transparency, (side, side, 1)."""
    large = side * FINER
    image = Image.new("RGBA", (large, large))
    draw = ImageDraw.Draw(image)
    for drawn, coordinates, colour in figure:
        scaled = [large * value for value in coordinates]
        if isinstance(drawn, str):
            font = ImageFont.load_default(0.52 * large / max(1, len(drawn) - 0.5))
            place, width = (scaled[0], scaled[1]), 0.02 * large
            draw.text(place, drawn, colour, font, anchor="mm", stroke_width=width)
        else:
            drawn(draw, scaled, fill=colour)
    pixels = np.asarray(image.resize((side, side), Image.Resampling.LANCZOS), dtype=np.float32)
    opaque = pixels[..., 3:] / np.float32(255)
    return frozen(pixels[..., :3] * opaque), frozen(1 - opaque)


Pixels = npt.NDArray[np.uint8]
Letters = npt.NDArray[np.str_]
Cells = Sequence[tuple[int, int]]  # row and column of everything that moves
SHOWN = 320  # pixels across of a picture in a notebook, at most
SIDE = 640  # pixels along the longer side of a grid, unless its cells are too large or small
LARGEST_CELL, SMALLEST_CELL = 64, 4
MARGIN = 4
LINES, GLOW = "#dedace", "#fadcc9"
NOWHERE = np.empty((0, 2), np.int64)
Marks = tuple[IntArray, IntArray, IntArray]
"""Cells that glow, cells in which episodes start, and thin walls as in a view."""
NO_MARKS: Marks = (NOWHERE, NOWHERE, np.empty(0, np.int64))
FIGURES = {"#": WALL, "P": PIT, "F": FIRE, "T": TREASURE, "G": TREASURE}
"""What lies in cells, by its letter; a goal looks like a treasure."""


def on_grid(bars: IntArray, shape: tuple[int, ...]) -> BoolArray:
    """Return where a grid has thin walls, (2, rows, columns): east of each cell, and south."""
    return np.isin(np.arange(2 * math.prod(shape)), bars).reshape(2, *shape)


def tile(letter: str, colour: str) -> Figure:
    """Return a square with a letter in white."""
    return (BLOCK, (0.08, 0.08, 0.92, 0.92), colour), (letter, MIDDLE, WHITE)


class Canvas:
    """A grid seen from above, north on top, on which figures are put; a frame marks its edge."""

    def __init__(self, letters: Letters, marks: Marks = NO_MARKS, *, framed: bool = True):
        """Draw the walls and objects of a map, (rows, columns), and marks below them."""
        self.bars = on_grid(marks[2], letters.shape)
        glowing, starts = ({*map(tuple, cells.tolist())} for cells in marks[:2])
        # Even, as video formats require.
        self._cell = max(SMALLEST_CELL, min(LARGEST_CELL, SIDE // max(letters.shape)) // 2 * 2)
        height, width = (side * self._cell + 2 * MARGIN for side in letters.shape)
        self._backdrop = np.empty((height, width, 3), np.uint8)
        self._backdrop[:] = ImageColor.getrgb(DARK if framed else FLOOR)
        side = self._cell
        for cell in np.ndindex(letters.shape):
            top, left = self._corner(cell)
            self._backdrop[top : top + side, left : left + side] = ImageColor.getrgb(LINES)
            inside = slice(top + 1, top + side - 1), slice(left + 1, left + side - 1)
            self._backdrop[inside] = ImageColor.getrgb(GLOW if cell in glowing else FLOOR)
        for cell in starts:
            _paste(self._backdrop, self._corner(cell), START, side)
        for cell, letter in np.ndenumerate(letters):
            if letter != ".":
                figure = FIGURES.get(letter, tile(letter, COATS[1]))
                _paste(self._backdrop, self._corner(cell), figure, side)
        for below, row, column in np.argwhere(self.bars).tolist():
            top, left = self._corner((row, column))
            edge = slice(side - max(1, side // 16), side + max(1, side // 16))
            region = (edge, slice(side)) if below else (slice(side), edge)
            self._backdrop[top:, left:][region] = ImageColor.getrgb(DARK)

    def with_figures(self, cells: Cells, figures: Sequence[Figure]) -> Pixels:
        """Return the grid with figures in cells; those that share a cell are side by side."""
        together: dict[tuple[int, int], list[Figure]] = {}
        for cell, figure in zip(cells, figures, strict=True):
            together.setdefault(cell, []).append(figure)
        image = self._backdrop.copy()
        for cell, group in together.items():
            (top, left), across = self._corner(cell), math.ceil(math.sqrt(len(group)))
            side = self._cell // across
            for i, figure in enumerate(group):
                corner = top + side * (i // across), left + side * (i % across)
                _paste(image, corner, figure, side)
        return image

    def _corner(self, cell: Sequence[int]) -> tuple[int, int]:
        """Return where a cell begins, y and x."""
        return MARGIN + self._cell * cell[0], MARGIN + self._cell * cell[1]


def _paste(image: Pixels, corner: tuple[int, int], figure: Figure, side: int) -> None:
    colours, through = painted(figure, side)
    region = image[corner[0] : corner[0] + side, corner[1] : corner[1] + side]
    region[:] = region * through + colours


# -- scenes: pictures, (height, width, 3) uint8 of one size, and text of all moments of a task -----

LARGEST_BOARD = 20  # rows or columns of an observation that is drawn as a board, at most
MOST_CELLS = 40_000  # cells of a grid that is drawn, at most, but for mazes
WIDTH, LINE, LETTER = 480, 28, 9  # pixels: a picture of text, its line's height, a letter
MOST_LINES, LONGEST_LINE = 14, 48
INKS = dict(zip(("blue", "green", "vermillion", "purple", "black"), COATS[:5], strict=True))
"""Colours of a view's markers by name."""


Moment = TypeVar("Moment")


@dataclass(frozen=True)
class GridScene(Generic[Moment]):
    """Figures that move over a grid, and lines of text for components not on the grid."""

    letters: Letters  # of the map as text, (rows, columns)
    canvas: Canvas
    objects: Letters  # what lies in cells
    cells: Callable[[Moment], Cells]  # of a moment: of a task the number of its state
    names: Sequence[str]  # of what moves; "@" is the agent
    figures: Sequence[Figure]  # the same in pictures
    gap: str = ""  # between letters; without it every cell has room for one letter
    lines: Callable[[Moment], list[str]] = lambda moment: []

    def image(self, moment: Moment) -> Pixels:
        """Return the picture of the grid from above, with the lines below it."""
        cells, lines = self.cells(moment), self.lines(moment)
        # The agent is drawn small in a cell with an object.
        figures = [
            ASIDE if name == "@" and self.objects[cell] != "." else figure
            for name, figure, cell in zip(self.names, self.figures, cells, strict=True)
        ]
        grid = self.canvas.with_figures(cells, figures)
        if not lines:
            return grid
        below = Image.new("RGB", (grid.shape[1], LINE * len(lines)), FLOOR)
        draw, font = ImageDraw.Draw(below), ImageFont.load_default(18)
        most = max(4, below.width // LETTER)
        for i, line in enumerate(lines):
            short = shorten(line, most, placeholder=" …")
            draw.text((LINE // 4, LINE * i + LINE // 2), short, INK, font, anchor="lm")
        return np.concatenate([grid, np.array(below)])

    def text(self, moment: Moment) -> str:
        """Return the map with the names of the moving figures, and the lines."""
        cells = self.cells(moment)
        named = zip(self.names, *zip(*cells, strict=True), strict=True)
        figures = stacked(named) if self.gap else dict(zip(cells, self.names, strict=True))
        wide = max(map(len, figures.values()))
        letters = [
            [figures.get((y, x), letter).ljust(wide) for x, letter in enumerate(row)]
            for y, row in enumerate(self.letters.tolist())
        ]
        east, south = self.canvas.bars.tolist()
        gap, rows = self.gap or " " * bool(self.canvas.bars.any()), list[str]()
        for row, walls, below in zip(letters, east, south, strict=True):
            cells_and_gaps = zip(row, walls, strict=True)
            rows.append("".join(text + ("|" if wall else gap) for text, wall in cells_and_gaps))
            rows += ["".join(("-" if wall else " ") * wide + gap for wall in below)] * any(below)
        return "\n".join([row.rstrip() for row in rows] + self.lines(moment))


@dataclass(frozen=True)
class LabelScene:
    """The number of a state and the values of its components, as text."""

    states: Space

    def image(self, state: int) -> Pixels:
        """Return the class's own picture, or a card with a line for each component."""
        own: Pixels | None = self.states.drawn and self.states.drawn(state, "rgb_array")
        if own is not None:
            return own
        first, *further = self.states.components
        lines = list[str]()  # none of the one component of plain numbered states
        if further or not self.states.is_box or first.low != 0 or first.labels is not None:
            lines = _lines_of(self.states, state, self.states.names)
        if len(lines) > MOST_LINES:
            lines[MOST_LINES - 1 :] = [f"and {len(lines) - MOST_LINES + 1} more"]
        height = LINE * (len(lines) + (3 if lines else 2))
        image = Image.new("RGB", (WIDTH, height), FLOOR)
        draw = ImageDraw.Draw(image)
        draw.rectangle((0, 0, WIDTH, 2 * LINE), fill=DARK)
        large, font = ImageFont.load_default(22), ImageFont.load_default(18)
        draw.text((LINE, LINE), f"state {state}", WHITE, large, anchor="lm")
        for i, line in enumerate(lines):
            short = shorten(line, LONGEST_LINE, placeholder=" …")
            draw.text((LINE, LINE * (i + 3)), short, INK, font, anchor="lm")
        return np.array(image)

    def text(self, state: int) -> str:
        """Return the class's own text, or the state's label."""
        own: str | None = self.states.drawn and self.states.drawn(state, "ansi")
        return own or self.states.label(state)


Scene = GridScene[int] | LabelScene


def scene_of(task: Task) -> Scene:
    """Return the scene that draws a task: a grid if its states have cells, else a label."""
    if isinstance(task, TaskWithStart):
        return scene_of(task.task)
    if isinstance(task, Pursuit):  # with a dark frame where the grid is walled
        empty = np.full((task.size, task.size), ".")
        predators = range(1, task.predators + 1)
        names, figures = ["P", *map(str, predators)], [PREY, *map(predator, predators)]

        def cells(state: int) -> Cells:
            return [divmod(int(cell), task.size) for cell in task.states.decode(state).values()]

        canvas = Canvas(empty, framed=not task.torus)
        return GridScene(empty, canvas, empty, cells, names, figures, " ")
    layout = layout_of(task)
    if layout is not None and (isinstance(task, GridWorld) or np.prod(layout.shape) <= MOST_CELLS):
        return _layout_scene(task, layout)
    return LabelScene(generative_model(task).states)


LARGEST_DRAWN = 1_000_000  # states of a task with tables that are made for its picture


def board(observation: object, mode: str) -> str | Pixels | None:
    """Return a board by a mode of ``render``: text, or tiles of all but 0; None if it is none."""
    entries = np.asarray(observation)
    if entries.ndim != 2 or entries.dtype.kind not in "iu" or max(entries.shape) > LARGEST_BOARD:
        return None
    texts = np.where(entries == 0, ".", entries.astype(str))
    if mode == "ansi":
        wide = max(map(len, texts.flat))
        return "\n".join(" ".join(text.rjust(wide) for text in row) for row in texts.tolist())
    cells = [(row, column) for row, column in np.argwhere(entries).tolist()]
    tiles = [tile(texts[cell], COATS[int(entries[cell]) % len(COATS)]) for cell in cells]
    return Canvas(np.full(entries.shape, ".")).with_figures(cells, tiles)


def in_a_notebook(task: Task) -> str | None:
    """Return the picture of a task where an episode may start, as HTML; None without a grid."""
    scene = scene_of(task)
    if isinstance(scene, LabelScene):
        return None
    generative, rng = generative_model(task), np.random.default_rng(0)
    if isinstance(task, LiveMDP):
        state = reset_state(task)
    elif has_tables(task) and generative.states.size <= LARGEST_DRAWN:
        state = int(rng.choice(np.flatnonzero(tables(task).start)))
    else:
        state = int(rng.integers(generative.states.size))
    image = Image.fromarray(scene.image(state))
    sizes = f"{generative.states.size:,} states, {counted(generative.actions.size, 'action')}"
    drawn = (
        "<div>{}: {}</div>"
        '<img alt="{}" style="max-width:100%;width:{}px" src="data:image/png;base64,{}">'
    )
    code, width, alt = png_code(image), min(image.width, SHOWN), scene.text(state)
    return str(Markup(drawn).format(type(task).__name__, sizes, alt, width, code))


def png_code(image: Image.Image) -> str:
    """Return a picture as a PNG in base64."""
    content = io.BytesIO()
    image.save(content, "PNG", optimize=True)
    return b64encode(content.getvalue()).decode()


def scene_of_view(view: GridView) -> GridScene[IntArray]:
    """Return the scene that draws a view; a moment is the cell of each marker, (markers,)."""
    letters, columns = _letters_of(view, view.walls), view.shape[1]
    names, gap = [marker.letter for marker in view.markers], " "
    figures = [tile(marker.letter, INKS[marker.colour]) for marker in view.markers]
    if len(names) < 2:
        names, figures, gap = ["@"], [AGENT], ""

    def cells(numbers: IntArray) -> Cells:
        return [divmod(number, columns) for number in numbers.tolist()]

    canvas = Canvas(letters, (NOWHERE, NOWHERE, view.bars))
    return GridScene(letters, canvas, letters, cells, names, figures, gap)


def _layout_scene(task: Task, layout: GridLayout) -> GridScene[int]:
    """Return a scene of the agent, walls, objects and markers; other components are lines."""
    states, letters = generative_model(task).states, _letters_of(layout, layout.wall_cells)
    unplaced = set(states.names) - {*layout.components, *layout.markers}
    moving = [*layout.markers.values(), layout.cells]
    markers = [*marker_letters(layout.markers).values()]

    def cells(state: int) -> Cells:
        (top, left), places = layout.origin, [places[state].tolist() for places in moving]
        return [(row - top, column - left) for row, column in places]

    text, glowing, starts = letters, NOWHERE, NOWHERE
    if isinstance(task, GridWorld):
        text = np.array([list(line) for line in task.map])
        if task.rewards.near_fire:  # cells glow that cost extra
            burning = np.pad(letters == "F", 1)
            beside = np.any([np.roll(burning, way, (0, 1)) for way in MOVES.values()], axis=0)
            glowing = np.argwhere(beside[1:-1, 1:-1] & (letters != "#"))
        if task.start != "uniform":
            starts = task.cells[task.mdp.start_states] - layout.origin
    figures = [*(tile(number, COATS[2]) for number in markers), AGENT]

    def lines(state: int) -> list[str]:
        return _lines_of(states, state, unplaced) if unplaced else []

    canvas, names = Canvas(letters, (glowing, starts, bars_of(task, layout))), [*markers, "@"]
    return GridScene(text, canvas, letters, cells, names, figures, lines=lines)


def _letters_of(grid: GridLayout | GridView, walls: IntArray) -> Letters:
    """Return the map of a layout or a view: walls, and the letters of objects in cells."""
    letters = np.full(grid.shape, ".")
    letters[tuple((walls - grid.origin).T)] = "#"
    for name, row, column, _ in grid.objects:
        letters[row - grid.origin[0], column - grid.origin[1]] = LETTERS[name]
    return letters


def _lines_of(states: Space, state: int, names: Collection[str]) -> list[str]:
    return [f"{name} = {label}" for name, label in parts_of(states, state) if name in names]
