"""Pictures: learning curves with bands, mazes with values, paths and marks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from curricle.statistics.curves import Curve, smooth
from curricle.statistics.intervals import bootstrap
from curricle.tasks.gridworld import GridWorld

# Okabe and Ito's colours, told apart by colour-blind readers.
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
# Matplotlib's settings for these pictures; hand them to matplotlib.rc_context.
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 150,
    # Without it an SVG differs from run to run.
    "svg.hashsalt": "curricle",
}
LETTERS = {"treasure": "T", "fire": "F", "pit": "P"}
TINTS = {"treasure": "#f2c14e", "fire": "#ee6c4d", "pit": "#3d405b"}


def new_figure(rows: int, columns: int, *, width: float, height: float) -> tuple[Figure, Any]:
    """Return a figure of `width` x `height` inches and its (rows, columns) array of axes."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def draw_curve(
    axes: Axes,
    curve: Curve,
    *,
    label: str,
    colour: str,
    window: int = 1,
    strong: bool = False,
    dashes: Any = "-",
) -> None:
    """Draw the mean over seeds with its 95 % bootstrap band.

    Parameters
    ----------
    axes : Axes
    curve : Curve
    label, colour : str
        Name in the legend; key of `COLOURS`, or any colour of Matplotlib's.
    dashes : str or tuple
        Line style, as Matplotlib's.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to start the curve at its mean number of source steps.
    """
    values = smooth(curve.filled(), window)
    steps = curve.steps + (curve.source_steps.mean() if strong else 0)
    shade = COLOURS.get(colour, colour)
    axes.plot(steps, values.mean(axis=0), linestyle=dashes, color=shade, label=label, lw=1.5)
    if len(values) > 1:
        band = bootstrap(values, resamples=1000)
        axes.fill_between(steps, band.low, band.high, color=shade, alpha=0.2, lw=0)


def draw_maze(
    axes: Axes,
    maze: GridWorld,
    *,
    path: Sequence[int] | npt.NDArray[np.int64] = (),
    marked: npt.NDArray[np.bool_] | None = None,
    values: npt.NDArray[np.float64] | None = None,
    value_label: str = "",
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
    values : (S,) float64, optional
        Shown as colours and numbers.
    value_label : str
        What the values are, with the unit; beside the colour bar.
    """
    draw_grid(axes, maze.origin, (len(maze.map), len(maze.map[0])))
    if values is not None:
        _values(axes, maze, values, value_label)
    for name, row, column in maze.objects if values is None else ():
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, color=TINTS[name], alpha=0.8))
        colour = "w" if name == "pit" else "k"
        draw_letter(axes, LETTERS[name], row, column, colour=colour)
    if values is not None:
        label_objects(axes, maze)
    draw_walls(axes, maze)
    for state in np.flatnonzero(marked) if marked is not None else ():
        row, column = maze.cells[state]
        axes.add_patch(
            Rectangle(
                (column - 0.46, row - 0.46), 0.92, 0.92, fill=False, edgecolor=COLOURS["blue"], lw=2
            )
        )
    if len(path):
        cells = maze.cells[np.asarray(path)]
        axes.plot(cells[:, 1], cells[:, 0], "-", color=COLOURS["sky"], lw=2)
        axes.plot(cells[0, 1], cells[0, 0], "o", color=COLOURS["sky"], ms=6)


def draw_grid(axes: Axes, origin: tuple[int, int], shape: tuple[int, int]) -> None:
    """Draw the lines between the cells of a grid, north on top.

    Parameters
    ----------
    axes : Axes
    origin : (int, int)
        Row and column of the top-left cell.
    shape : (int, int)
        Rows and columns.
    """
    (top, left), (height, width) = origin, shape
    axes.set_xlim(left - 0.5, left + width - 0.5)
    axes.set_ylim(top + height - 0.5, top - 0.5)
    axes.set_aspect("equal")
    axes.set_xticks(range(left, left + width))
    axes.set_yticks(range(top, top + height))
    axes.set_xlabel("column")
    axes.set_ylabel("row")
    for x in range(left, left + width + 1):
        axes.axvline(x - 0.5, color="#dddddd", lw=0.5, zorder=0)
    for y in range(top, top + height + 1):
        axes.axhline(y - 0.5, color="#dddddd", lw=0.5, zorder=0)


def draw_walls(axes: Axes, maze: GridWorld) -> None:
    """Fill the cells of a maze that are walls."""
    (top, left), height, width = maze.origin, len(maze.map), len(maze.map[0])
    walls = {(top + r, left + c) for r in range(height) for c in range(width)}
    for row, column in sorted(walls - {(int(r), int(c)) for r, c in maze.cells}):
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, color="#222222"))


def label_objects(axes: Axes, maze: GridWorld, *, corner: bool = True) -> None:
    """Write the letter of each object over its cell: into a corner, or the middle."""
    shift = 0.32 * corner
    for name, row, column in maze.objects:
        letter = draw_letter(axes, LETTERS[name], row - shift, column - shift)
        if not corner:
            letter.set_path_effects([withStroke(linewidth=2, foreground="w")])


def write_columns(axes: Axes, columns: Sequence[Sequence[str]]) -> None:
    """Write columns of text to the right of a panel: a head above it, then one entry a row.

    Parameters
    ----------
    axes : Axes
        Whose row r lies at y = r.
    columns : sequence of sequence of str
        The head first; may be empty.
    """
    place: Any = {"textcoords": "offset points", "va": "center", "fontsize": 7.5}
    left = 6.0
    for head, *rows in columns:
        axes.annotate(head, (1, 1), (left, 8), xycoords="axes fraction", color="#555555", **place)
        for row, text in enumerate(rows):
            axes.annotate(text, (1, row), (left, 0), xycoords=("axes fraction", "data"), **place)
        left += 4.0 * max(len(text) for text in (head, *rows)) + 8


def draw_letter(axes: Axes, text: str, row: float, column: float, *, colour: str = "k") -> Text:
    """Return a bold letter, drawn at a place of a grid."""
    return axes.text(
        column,
        row,
        text,
        ha="center",
        va="center",
        color=colour,
        fontsize=8,
        fontweight="bold",
    )


def _values(axes: Axes, maze: GridWorld, values: npt.NDArray[np.float64], label: str) -> None:
    top, left = maze.origin
    grid = np.full((len(maze.map), len(maze.map[0])), np.nan)
    grid[maze.cells[:, 0] - top, maze.cells[:, 1] - left] = values
    extent = (left - 0.5, left + grid.shape[1] - 0.5, top + grid.shape[0] - 0.5, top - 0.5)
    limit = float(abs(values).max()) or 1.0
    image = axes.imshow(grid, extent=extent, cmap="PuOr", vmin=-limit, vmax=limit)
    axes.figure.colorbar(image, ax=axes, label=label, shrink=0.8)
    for (row, column), value in zip(maze.cells, values, strict=True):
        colour = "w" if abs(value) > 0.6 * limit else "k"
        axes.text(column - 0.2, row + 0.25, f"{value:.0f}", ha="center", va="center", color=colour)
