"""Grids drawn with Matplotlib: mazes, the grid of any view, and values as heat maps."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import numbers, one_of
from curricle.curriculum.result import CurriculumResult
from curricle.errors import CurriculumError, SettingError
from curricle.planning.target import Target
from curricle.plotting.scales import minus
from curricle.plotting.styles import COLOURS, DIVERGING, SEQUENTIAL, STYLE, caption, new_figure
from curricle.tasks.grid_layout import LETTERS
from curricle.tasks.grid_view import At, GridView
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.task import Task, generative_model
from curricle.transfer.edges import transfer_names

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

    Over a heat map the objects of a maze are letters only, in the corners of cells whose numbers
    are written. The legend, below the grid, says what the letters mean.
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


PANEL = 2.6
"""Width of a panel in inches."""
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


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
    r"""Draw values of states, or the best of their actions, as a heat map of a grid.

    Colours diverge from white at 0 where the limits have both signs and for differences; otherwise
    they run from the lower limit to the upper. States in which the episode is over are hatched.

    Parameters
    ----------
    axes : Axes
    task : Task
        A :class:`GridWorld`, or a task whose states have one cell that `at` leaves free: in
        :class:`Pursuit` that of the prey or of one predator.
    values : (S,) or (S, A) float64
        Of (S, A) the maximum over actions is drawn.
    label : str
        What the values are; the title of the panel.
    at : dict of str to int, str or (int, int), optional
        The other components of the state, as in ``{"prey": (1, 2)}``. Letters mark them.
    limits : (float, float), optional
        Ends of the colours, to compare panels; by default those of the drawn values
        (:func:`shared_limits`).
    difference : bool
        Whether 0 is the middle of the colours in any case.
    bar : bool
        Whether to draw a bar of colours beside the panel.
    unit : str
        Label of that bar.

    Returns
    -------
    AxesImage
        To give several panels one bar of colours.

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
    (low, high), palette = limits or shared_limits(task, values, at=at), SEQUENTIAL
    if difference or low < 0 < high:
        high = max(abs(low), abs(high)) or 1.0
        low, palette = -high, DIVERGING
    if low == high:
        low, high = low - 1, high + 1
    image = draw_heat(axes, view, _best(task, values)[view.states], palette, (low, high))
    draw_view(axes, view, heat=True)
    axes.set_title(label)
    if bar:
        axes.figure.colorbar(image, ax=axes, label=unit, shrink=0.8)
    return image


def shared_limits(task: Task, *several: npt.ArrayLike, at: At | None = None) -> tuple[float, float]:
    """Return the lowest and the highest value that :func:`draw_potential` would draw of `several`.

    States in which the episode is over are left out; their values are 0 by rule.
    """
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


class _Panel(NamedTuple):
    """One heat map: its title and its values, (S,) or (S, A)."""

    title: str
    values: FloatArray
    difference: bool = False


@matplotlib.rc_context(STYLE)
def draw_sources(
    result: CurriculumResult,
    target: str | None = None,
    *,
    seed: int = 0,
    at: At | None = None,
) -> Figure:
    """Return the figure of a target's potentials: of each transfer, aggregated, and V*.

    A panel for phi_i(s) = max_a phi_i(s, a) of each transfer, one for the aggregate as it enters
    the target, one for V*(s) = max_a Q*(s, a), all in the same colours; and one for the error of
    the aggregate, phi(s, a*) - V*(s), where a* is the action that phi prefers. The last two are
    left out where the target cannot be solved, the aggregate where it equals the only source.

    Parameters
    ----------
    result : CurriculumResult
        With the target's sources trained.
    target : str, optional
        By default the task that all others lead to.
    seed : int
        One of those of the sources.
    at : dict of str to int, str or (int, int), optional
        As in :func:`draw_potential`.

    Raises
    ------
    CurriculumError
        When the target is unknown, not unique or has no transfer into it.
    SettingError
        When the seed was not trained, or the states make no grid.

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
    if not curriculum.in_edges(name):
        raise CurriculumError(f"sources to draw need transfers into the task: {name!r} has none")
    seeds = result[curriculum.in_edges(name)[0].source].seeds
    one_of("seed", seed, seeds, SettingError)
    panels, aggregate = _potential_panels(result, name, seeds.index(seed))
    solution = Target.of(curriculum.tasks[name]).solution
    words = f"Seed {seed}. Values of the best action, all in one scale of return"
    if solution is None:
        words += "; the target cannot be solved, so V* is not drawn."
    else:
        panels.append(_Panel("V* = max Q*", solution.values))
        error = aggregate.max(axis=1) - solution.values
        panels.append(_Panel("φ(s, a*) − V*(s)", error, difference=True))
        words += (
            ". Last panel, in a scale of its own: φ of the action a* that φ prefers, minus V*; "
            "above 0 it is an overestimate."
        )
    figure, view = _draw_panels(curriculum.tasks[name], panels, at)
    figure.suptitle(f"{name}: potentials from its sources")
    words += " Hatched: the episode is over." * bool(view.ended.any())
    if view.words:
        words += f" {view.words[0].upper()}{view.words[1:]}."
    caption(figure, words)
    return figure


def _potential_panels(
    result: CurriculumResult, name: str, k: int
) -> tuple[list[_Panel], FloatArray]:
    """Return the panels of a seed's potentials, and the aggregate, (S, A)."""
    curriculum, edges = result.curriculum, result.curriculum.in_edges(name)
    each = [
        curriculum.potentials(name, result.sources, transfers=[edge])[k].values for edge in edges
    ]
    numbers = [f"{i}".translate(SUBSCRIPTS) * (len(edges) > 1) for i in range(1, len(edges) + 1)]
    panels = [
        _Panel(f"φ{number}: {words}", values)
        for number, words, values in zip(numbers, transfer_names(edges), each, strict=True)
    ]
    used = result.potentials.get(name) or curriculum.potentials(name, result.sources)
    aggregate = used[k].values
    if len(edges) > 1 or not np.array_equal(aggregate, each[0]):
        function = curriculum.setting("aggregate", name)
        title = f"φ: {getattr(function, '__name__', 'aggregate')}"
        if name in result.calibrations:
            title += f", calibrated × {result.calibrations[name][k].scale:.2g}"
        panels.append(_Panel(title, aggregate))
    return panels, aggregate


def _draw_panels(task: Task, panels: Sequence[_Panel], at: At | None) -> tuple[Figure, GridView]:
    """Return a figure of panels and their view; all but the differences share their colours."""
    alike = [panel.values for panel in panels if not panel.difference]
    limits, view = shared_limits(task, *alike, at=at), GridView.of(task, at)
    columns = min(len(panels), 3 if len(panels) <= 6 else 4)
    rows = -(-len(panels) // columns)
    high = (PANEL - 0.6) * min(1.5, view.shape[0] / view.shape[1]) + 0.55
    figure, grid = new_figure(rows, columns, width=1 + PANEL * columns, height=0.8 + high * rows)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    shared = dict[Axes, AxesImage]()
    for axes, (title, values, difference) in zip(grid.flat, panels, strict=False):
        drawn: Any = {"difference": True} if difference else {"limits": limits, "bar": False}
        image = draw_potential(axes, task, values, label=title, at=at, **drawn)
        axes.set_xlabel("column")
        if not difference:
            shared[axes] = image
    figure.colorbar(next(iter(shared.values())), ax=[*shared], label="return", shrink=0.8)
    return figure, view
