"""Grids drawn with Matplotlib: mazes, the grid of any view, and values as heat maps."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.plotting.scales import minus
from curricle.plotting.styles import COLOURS
from curricle.tasks.grid_layout import LETTERS
from curricle.tasks.grid_view import GridView
from curricle.tasks.gridworld import GridWorld

TINTS = {"treasure": "#f2c14e", "fire": "#ee6c4d", "pit": "#3d405b", "goal": "#f2c14e"}
TINTS |= {"key": "#8ecae6", "lock": "#c9a0dc", "exit": "#90be6d"}
"""Of the objects on a grid."""
MOST_NUMBERS = 36
"""Cells up to which their numbers are written."""
DARK = 0.45
"""Brightness of a colour below which the text on it is white."""


def draw_maze(
    axes: Axes,
    maze: GridWorld,
    *,
    path: Sequence[int] | IntArray = (),
    marked: BoolArray | None = None,
) -> None:
    """Draw a maze as seen from above, north on top, in map coordinates.

    Parameters
    ----------
    axes : Axes
    maze : GridWorld
    path : sequence of int
        States to join by a line.
    marked : (S,) bool, optional
        States to frame.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> axes = Figure().subplots()
    >>> draw_maze(axes, GridWorld(["S.", ".T"]), path=[0, 1, 3])
    >>> [text.get_text() for text in axes.texts]
    ['T']
    """
    draw_view(axes, GridView.of(maze), legend=False)
    if marked is not None:
        frame_cells(axes, maze, marked)
    if len(path):
        cells = maze.cells[np.asarray(path)]
        axes.plot(cells[:, 1], cells[:, 0], "-", color=COLOURS["sky"], lw=2)
        axes.plot(cells[0, 1], cells[0, 0], "o", color=COLOURS["sky"], ms=6)


def frame_cells(axes: Axes, maze: GridWorld, marked: BoolArray) -> None:
    """Frame the cells of the `marked` states, (S,), of a maze.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> axes = Figure().subplots()
    >>> frame_cells(axes, GridWorld("S.T"), np.array([True, False, False]))
    >>> len(axes.patches)
    1
    """
    for row, column in maze.cells[marked]:
        frame: Any = {"fill": False, "edgecolor": COLOURS["blue"], "lw": 2}
        axes.add_patch(Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, **frame))


def draw_view(axes: Axes, view: GridView, *, heat: bool = False, legend: bool = True) -> None:
    """Draw the grid of a view, its walls and what stands on it.

    Parameters
    ----------
    axes : Axes
    view : GridView
    heat : bool
        Whether it is drawn over a heat map. The objects of a maze are then letters only, in the
        corners of cells whose numbers are written.
    legend : bool
        Whether to write what the letters mean below the grid.
    """
    _draw_lines(axes, view)
    for row, column in view.walls:
        axes.add_patch(_square(row, column, color="#222222"))
    aside = 0.32 if heat and view.shape[0] * view.shape[1] <= MOST_NUMBERS else 0
    for name, row, column, _ in view.objects:
        white = name == "pit" and not heat
        letter = _letter(axes, LETTERS[name], row - aside, column - aside, "w" if white else "k")
        if not heat:
            axes.add_patch(_square(row, column, color=TINTS[name], alpha=0.8))
        elif not aside:
            letter.set_path_effects([withStroke(linewidth=2, foreground="w")])
    for (row, column), letters in view.stacked_letters.items():
        written = _letter(axes, letters, row - 0.3, column - 0.3)
        written.set_bbox({"boxstyle": "circle,pad=0.15", "fc": "w", "ec": "k", "lw": 0.6})
    if legend and view.words:
        axes.set_xlabel(f"column\n{view.words}", fontsize=8)


def draw_heat(
    axes: Axes,
    view: GridView,
    values: FloatArray,
    palette: str,
    limits: tuple[float, float],
) -> AxesImage:
    """Draw the values of a view's states, (n,), as colours, and as numbers where cells are few."""
    low, high = limits
    (top, left), (height, width) = view.origin, view.shape
    grid = np.full((height, width), np.nan)
    row, column = (view.cells - np.array(view.origin))[~view.ended].T
    grid[row, column] = values[~view.ended]
    extent = (left - 0.5, left + width - 0.5, top + height - 0.5, top - 0.5)
    image = axes.imshow(grid, extent=extent, cmap=palette, vmin=low, vmax=high)
    digits = 0 if max(abs(low), abs(high)) >= 100 else 1
    for (row, column), value, over in zip(view.cells, values, view.ended, strict=True):
        if over:
            axes.add_patch(_square(row, column, fc="#eeeeee", ec="#bbbbbb", hatch="///", lw=0))
        elif height * width <= MOST_NUMBERS:
            red, green, blue, _ = image.to_rgba(value)
            dark = 0.299 * red + 0.587 * green + 0.114 * blue < DARK
            number = minus(f"{value:z.{digits}f}")
            place: Any = {"ha": "center", "va": "center", "fontsize": 7}
            axes.text(column + 0.05, row + 0.2, number, color="w" if dark else "k", **place)
    return image


def _draw_lines(axes: Axes, view: GridView) -> None:
    """Draw the lines between the cells of a grid, north on top."""
    (top, left), (height, width) = view.origin, view.shape
    axes.set(
        xlim=(left - 0.5, left + width - 0.5),
        ylim=(top + height - 0.5, top - 0.5),
        aspect="equal",
        xticks=range(left, left + width),
        yticks=range(top, top + height),
        xlabel="column",
        ylabel="row",
    )
    for x in range(left, left + width + 1):
        axes.axvline(x - 0.5, color="#dddddd", lw=0.5, zorder=0)
    for y in range(top, top + height + 1):
        axes.axhline(y - 0.5, color="#dddddd", lw=0.5, zorder=0)


def _square(row: float, column: float, **style: Any) -> Rectangle:
    return Rectangle((column - 0.5, row - 0.5), 1, 1, **style)


def _letter(axes: Axes, text: str, row: float, column: float, colour: str = "k") -> Text:
    """Return a bold letter, drawn in the middle of a place on the grid."""
    middle: Any = {"ha": "center", "va": "center", "fontsize": 8, "fontweight": "bold"}
    return axes.text(column, row, text, color=colour, **middle)
