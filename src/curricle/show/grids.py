"""Grids by Matplotlib: mazes, the grid of any view, values and potentials as heat maps."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import numbers, one_of
from curricle.curriculum.result import CurriculumResult
from curricle.errors import CurriculumError, SettingError
from curricle.planning.target import Target
from curricle.show.style import (
    COLOURS,
    MOST_NUMBERS,
    STYLE,
    TINTS,
    caption,
    digits_of,
    minus,
    new_figure,
    value_scale,
)
from curricle.show.views import At, GridView, stacked
from curricle.tasks.domain import LETTERS
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import Task, generative_model
from curricle.transfer.transfer import transfer_names

DARK = 0.45  # brightness of a colour below which the text on it is white
PANEL = 2.6  # width of a panel in inches
MIDDLE: Any = {"ha": "center", "va": "center"}
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


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
    """Draw the grid of a view, north on top, with walls and objects, and the legend below it."""
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
    for row, column in view.walls:
        axes.add_patch(_square(row, column, color="#222222"))
    middle: Any = {**MIDDLE, "fontsize": 8, "fontweight": "bold"}
    aside = 0.32 if heat and height * width <= MOST_NUMBERS else 0
    for name, row, column, _ in view.objects:
        colour = "w" if name == "pit" and not heat else "k"
        letter = axes.text(column - aside, row - aside, LETTERS[name], color=colour, **middle)
        if not heat:
            axes.add_patch(_square(row, column, color=TINTS[name], alpha=0.8))
        elif not aside:
            letter.set_path_effects([withStroke(linewidth=2, foreground="w")])
    for (row, column), letters in stacked(view.letters).items():
        letter = axes.text(column - 0.3, row - 0.3, letters, color="k", **middle)
        letter.set_bbox({"boxstyle": "circle,pad=0.15", "fc": "w", "ec": "k", "lw": 0.6})
    if legend and view.words:
        axes.set_xlabel(f"column\n{view.words}", fontsize=8)


def _square(row: float, column: float, **style: Any) -> Rectangle:
    return Rectangle((column - 0.5, row - 0.5), 1, 1, **style)


def draw_potential(
    axes: Axes,
    task: Task,
    values: npt.ArrayLike,
    *,
    label: str,
    at: At | None = None,
    limits: tuple[float, float] | None = None,
    difference: bool = False,
    bar: bool = True,
    unit: str = "return",
) -> AxesImage:
    r"""Draw values of states, or of their best actions, as a heat map on a grid.

    Colours diverge from white at 0 where the limits have both signs. Terminal states are hatched.

    Parameters
    ----------
    axes : Axes
    task : Task
        A :class:`GridWorld`, or a task whose states have one cell that `at` leaves free.
    values : (S,) or (S, A) float64
        Values to draw; the maximum over actions is drawn of (S, A).
    label, unit : str
        Titles of the panel and of its bar of colours.
    at : dict of str to int, str or (int, int), optional
        Values of the other components, such as ``{"prey": (1, 2)}``; letters mark them.
    limits : (float, float), optional
        Values at the ends of the colours, to compare panels; by default of the drawn values.
    difference : bool
        Whether 0 is always the middle of the colours.
    bar : bool
        Whether to draw the bar; several panels can share the bar of a returned image.

    Raises
    ------
    SettingError
        When `values` have another shape or are not finite, or the states make no grid.

    Examples
    --------
    >>> from curricle import Pursuit, solve
    >>> hunt = Pursuit(3, 2, discount=0.9)
    >>> axes = Figure().subplots()
    >>> image = draw_potential(axes, hunt, solve(hunt).values, label="V* (return)",
    ...                        at={"prey": (1, 2), "predator_2": (0, 0)})
    >>> axes.get_title(), axes.get_xlabel(), image.get_cmap().name
    ('V* (return)', 'column\ncells: where predator_1 is; P: prey, 2: predator_2', 'cividis')
    """
    view = GridView.of(task, at)
    low, high = limits or shared_limits(task, values, at=at)
    low, high, palette = value_scale(low, high, difference=difference)
    if low == high:
        low, high = low - 1, high + 1
    (top, left), (height, width) = view.origin, view.shape
    grid, shown = np.full((height, width), np.nan), _best(task, values)[view.states]
    grid[tuple((view.cells - view.origin)[~view.ended].T)] = shown[~view.ended]
    extent = (left - 0.5, left + width - 0.5, top + height - 0.5, top - 0.5)
    image = axes.imshow(grid, extent=extent, cmap=palette, vmin=low, vmax=high)
    digits = digits_of(low, high)
    for (row, column), value, over in zip(view.cells, shown, view.ended, strict=True):
        if over:
            axes.add_patch(_square(row, column, fc="#eeeeee", ec="#bbbbbb", hatch="///", lw=0))
        elif height * width <= MOST_NUMBERS:
            red, green, blue, _ = image.to_rgba(value)
            colour = "w" if 0.299 * red + 0.587 * green + 0.114 * blue < DARK else "k"
            number = minus(f"{value:z.{digits}f}")
            axes.text(column + 0.05, row + 0.2, number, color=colour, **MIDDLE, fontsize=7)
    draw_view(axes, view, heat=True)
    axes.set_title(label)
    if bar:
        axes.figure.colorbar(image, ax=axes, label=unit, shrink=0.8)
    return image


def shared_limits(task: Task, *several: npt.ArrayLike, at: At | None = None) -> tuple[float, float]:
    """Return the least and largest value that :func:`draw_potential` draws of `several` tables."""
    view = GridView.of(task, at)
    alive = view.states[~view.ended]
    drawn = np.concatenate([_best(task, values)[alive] for values in several])
    return (float(drawn.min()), float(drawn.max())) if drawn.size else (0.0, 0.0)


def _best(task: Task, values: npt.ArrayLike) -> FloatArray:
    """Return the values of states, (S,), or raise SettingError."""
    generative, table = generative_model(task), numbers("values", values, SettingError)
    n_states, n_actions = generative.states.size, generative.actions.size
    if table.shape not in ((n_states,), (n_states, n_actions)):
        raise SettingError(
            f"values must have shape ({n_states},) or ({n_states}, {n_actions}): got {table.shape}"
        )
    if not np.isfinite(table).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(table))[0])
        raise SettingError(f"values must be finite: entry {place} is {table[place]}")
    return table if table.ndim == 1 else table.max(axis=1)


@matplotlib.rc_context(STYLE)
def draw_sources(
    result: CurriculumResult,
    target: str | None = None,
    *,
    seed: int = 0,
    at: At | None = None,
) -> Figure:
    """Return the figure of a target's potentials: of each transfer, aggregated, and V*.

    Panels in the same colours show phi_i(s) = max_a phi_i(s, a) of each transfer, the aggregate
    (unless it equals the only source), and V*(s) = max_a Q*(s, a). A last panel shows the error of
    the aggregate, phi(s, a*) - V*(s), where a* is the action that phi prefers. If the target cannot
    be solved, the last two are left out.

    Parameters
    ----------
    result : CurriculumResult
        A result in which the target's sources were trained.
    target : str, optional
        By default the task that all others lead to.
    seed : int
        A seed of the sources.
    at : dict of str to int, str or (int, int), optional
        As in :func:`draw_potential`.

    Raises
    ------
    CurriculumError, SettingError
        When the target is unknown, not unique or has no transfer into it; when the seed was not
        trained, or the states make no grid.

    Examples
    --------
    >>> from curricle import Curriculum, GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))], budget=1000)
    >>> figure = draw_sources(plan.train())
    >>> [axes.get_title() for axes in figure.axes[:3]]
    ['φ: corner -> maze', 'V* = max Q*', 'φ(s, a*) − V*(s)']
    """
    curriculum = result.curriculum
    name = curriculum.target if target is None else target
    edges = curriculum.in_edges(name)
    if not edges:
        raise CurriculumError(f"sources to draw need transfers into the task: {name!r} has none")
    seeds, task = result[edges[0].source].seeds, curriculum.tasks[name]
    one_of("seed", seed, seeds, SettingError)
    k, numbered = seeds.index(seed), len(edges) > 1
    panels = dict[str, npt.ArrayLike]()
    for i, (edge, title) in enumerate(zip(edges, transfer_names(edges), strict=True), start=1):
        phi = curriculum.potentials(name, result.sources, transfers=[edge])[k].values
        panels[f"φ{f'{i}'.translate(SUBSCRIPTS) * numbered}: {title}"] = phi
    potentials = result.potentials.get(name) or curriculum.potentials(name, result.sources)
    aggregate = potentials[k].values
    if numbered or not np.array_equal(aggregate, phi):
        title = f"φ: {getattr(curriculum.setting('aggregate', name), '__name__', 'aggregate')}"
        if name in result.calibrations:
            title += f", calibrated × {result.calibrations[name][k].scale:.2g}"
        panels[title] = aggregate
    solution, error = Target.of(task).solution, None
    sentences = f"Seed {seed}. Values of the best action, all in one scale of return"
    if solution is None:
        sentences += "; the target cannot be solved, so V* is not drawn."
    else:
        panels["V* = max Q*"] = solution.values
        error = aggregate.max(axis=1) - solution.values
        sentences += (
            ". Last panel, in a scale of its own: φ of the action a* that φ prefers, minus V*; "
            "above 0 it is an overestimate."
        )
    # A panel for each in the same colours, and for the error in its own.
    limits, view = shared_limits(task, *panels.values(), at=at), GridView.of(task, at)
    n = len(panels) + (error is not None)
    columns = min(n, 3 if n <= 6 else 4)
    rows = -(-n // columns)
    high = (PANEL - 0.6) * min(1.5, view.shape[0] / view.shape[1]) + 0.55
    figure, grid = new_figure(rows, columns, width=1 + PANEL * columns, height=0.8 + high * rows)
    for axes in grid.flat[n:]:
        axes.remove()
    shared = list(grid.flat[: len(panels)])
    for axes, (title, values) in zip(shared, panels.items(), strict=True):
        image = draw_potential(axes, task, values, label=title, at=at, limits=limits, bar=False)
    if error is not None:
        axes = grid.flat[n - 1]
        draw_potential(axes, task, error, label="φ(s, a*) − V*(s)", at=at, difference=True)
    for axes in grid.flat[:n]:
        axes.set_xlabel("column")
    figure.colorbar(image, ax=shared, label="return", shrink=0.8)
    figure.suptitle(f"{name}: potentials from its sources")
    sentences += " Hatched: the episode is over." * bool(view.ended.any())
    if view.words:
        sentences += f" {view.words[0].upper()}{view.words[1:]}."
    caption(figure, sentences)
    return figure
