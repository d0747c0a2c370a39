"""Pictures: learning curves with bands, mazes with values, paths and marks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from curricle.study.curve import Curve, smooth
from curricle.study.statistics import bootstrap
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
    dashes: str = "-",
) -> None:
    """Draw the mean over seeds with its 95 % bootstrap band.

    Parameters
    ----------
    axes : Axes
    curve : Curve
    label, colour, dashes : str
        Name in the legend, key of `COLOURS`, line style.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to start the curve at its mean number of source steps.
    """
    values = smooth(curve.filled(), window)
    steps = curve.steps + (curve.source_steps.mean() if strong else 0)
    axes.plot(steps, values.mean(axis=0), dashes, color=COLOURS[colour], label=label, lw=1.5)
    if len(values) > 1:
        band = bootstrap(values, resamples=1000)
        axes.fill_between(steps, band.low, band.high, color=COLOURS[colour], alpha=0.2, lw=0)


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
    (top, left), height, width = maze.origin, len(maze.map), len(maze.map[0])
    _grid(axes, top, left, height, width)
    if values is not None:
        _values(axes, maze, values, value_label)
    for name, row, column in maze.objects:
        if values is None:
            axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, color=TINTS[name], alpha=0.8))
        at = (column, row) if values is None else (column - 0.32, row - 0.32)
        light = name == "pit" and values is None
        axes.text(
            at[0],
            at[1],
            LETTERS[name],
            ha="center",
            va="center",
            color="w" if light else "k",
            fontsize=8,
            fontweight="bold",
        )
    walls = {(top + r, left + c) for r in range(height) for c in range(width)}
    for row, column in walls - {(int(r), int(c)) for r, c in maze.cells}:
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, color="#222222"))
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


def _grid(axes: Axes, top: int, left: int, height: int, width: int) -> None:
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
