"""Figures by Matplotlib: grids, learning results and comparisons; and their files."""

import io
import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from textwrap import fill, wrap
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
from curricle.checks import brief, numbers
from curricle.comparison import sentences
from curricle.comparison.comparison import Comparison
from curricle.curriculum.result import MOST_CURVES, CurriculumResult
from curricle.errors import SettingError
from curricle.files import write_whole
from curricle.learning.result import GREEDY_RETURN, LearningResult, ends_of, shown_returns
from curricle.pictures.views import At, GridView, stacked
from curricle.show.style import (
    COLOURS,
    MOST_NUMBERS,
    STYLE,
    TINTS,
    ArmStyle,
    ShownFigure,
    arm_styles,
    caption,
    digits_of,
    new_figure,
    return_scale,
    spell_out,
    steps_scale,
    value_scale,
    write_columns,
)
from curricle.statistics.curves import Curve, asymptotic_performance, smooth
from curricle.statistics.hypothesis_tests import performance_profile
from curricle.statistics.intervals import CONFIDENCE, mean_interval
from curricle.tasks.grid import LETTERS
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import Task, generative_model
from curricle.text import minus

METADATA: dict[str, dict[str, Any]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""Ending -> metadata. Without a date the same results give the same file."""


def plot(subject: object, path: str | Path | None = None, *, task: Task | None = None) -> Figure:
    """Return the figure of a subject, and write it to a file if there is a path.

    Parameters
    ----------
    subject : Comparison, StudyResults, LearningResult, CurriculumResult or array
        A comparison, a forecast's trial or a study: curves, profiles and gains of the arms. A
        learning result: its learning curve; a curriculum's: those of its last tasks. Values, (S,)
        or (S, A) float64: the best of each state, as a heat map of their `task`.
    path : str or Path, optional
        File that ends in .png, .svg or .pdf, in a folder that exists; written whole or not at all.
    task : Task, optional
        The task of an array of values, as in :func:`draw_potential`.

    Raises
    ------
    CurricleError
        When the subject or the file's ending is another, values and task do not come together,
        states lie on no grid, the file cannot be written, or a study cannot be compared.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> maze = GridWorld(["..T", "S.."])
    >>> learnt = learn(maze, budget=500)
    >>> plot(learnt).axes[0].get_ylabel()
    'mean return of greedy episodes'
    >>> plot(learnt.values[0], task=maze).axes[0].get_title()
    'max Q(s, a)'
    """
    if path is not None:
        check_path(path)
    if task is not None:
        array = numbers("the values of a task", subject, SettingError)
        with matplotlib.rc_context(STYLE):
            figure, ((axes,),) = new_figure(1, 1, width=5.5, height=4.2)
            draw_potential(axes, task, array, label="max Q(s, a)" if array.ndim == 2 else "V(s)")
    elif isinstance(subject, LearningResult):
        name = "learning" if subject.task is None else type(subject.task).__name__
        figure = draw_results({name: subject})
    elif isinstance(subject, CurriculumResult) and subject.nodes:
        figure = draw_results(subject.nodes)
    else:
        compared = getattr(subject, "comparison", subject)  # of a study, or itself
        if not isinstance(compared, Comparison):
            raise SettingError(
                "what is plotted must be a Comparison, StudyResults, LearningResult or "
                f"CurriculumResult, or an array of values with its task: got {brief(subject)}"
            )
        figure = draw_comparison(compared)
    if path is not None:
        save(figure, path)
    return figure


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure to a file, as :func:`plot` does; the same bytes every time.

    Raises
    ------
    SettingError
        When the path is not a picture's, or the file cannot be written.

    Examples
    --------
    >>> save(Figure(), "picture.bmp")
    Traceback (most recent call last):
    curricle.errors.SettingError: a picture's file must end in .png, .svg, .pdf: got picture.bmp
    """
    place = check_path(path)
    try:
        write_whole(place, content_of(figure, place.suffix.lower()))
    except OSError as error:
        raise SettingError(f"a picture cannot be written to {place} ({error.strerror})") from error


def content_of(figure: Figure, ending: str) -> bytes:
    """Return the content of a figure's file that ends in .png, .svg or .pdf, the same every time.

    Examples
    --------
    >>> content_of(Figure(), ".png")[1:4]
    b'PNG'
    """
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(content, format=ending[1:], metadata=METADATA[ending])
    return content.getvalue()


def check_path(path: str | Path) -> Path:
    """Return the path of a picture; SettingError if no picture can be written there."""
    if not isinstance(path, str | Path):
        raise SettingError(f"a picture's file must be a path: got {path!r}")
    place = Path(path)
    if place.suffix.lower() not in METADATA:
        raise SettingError(f"a picture's file must end in {', '.join(METADATA)}: got {place}")
    if place.is_dir() or not place.parent.is_dir():
        raise SettingError(f"a picture needs a file in a folder that exists: got {place}")
    return place


# -- learning curves -------------------------------------------------------------------------------

ALL = 10**9  # more checkpoints than a curve has
NAME_LETTERS, TITLE_LETTERS = 28, 110  # in a line of an arm's name, of the title
MOST_BANDS, BARS = 6, 6  # arms up to which bands are drawn; bars of an arm in their place
ROW_HEIGHT = 0.21  # inches of an arm in a comparison


def draw_curve(
    axes: Axes,
    curve: Curve,
    *,
    label: str,
    colour: str,
    window: int = 1,
    strong: bool = False,
    dashes: object = "-",
    confidence: float = CONFIDENCE,
    within: tuple[float, float] = (-math.inf, math.inf),
    bars: IntArray | None = None,
) -> None:
    """Draw the mean over seeds with Student's 95 % band.

    Parameters
    ----------
    axes : Axes
    curve : Curve
    label, colour : str
        Name in the legend; key of `COLOURS`, or any colour of Matplotlib.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to start the curve at its mean number of source steps.
    dashes : str or tuple
        Line style of Matplotlib.
    confidence : float
        Confidence of the band at each checkpoint.
    within : (float, float)
        Lowest and highest possible return, which the band stays within.
    bars : (n,) int, optional
        Checkpoints at which a bar is drawn in place of the band.

    Examples
    --------
    >>> axes = Figure().subplots()
    >>> curve = Curve(np.array([0, 50]), np.array([[0.0, 1.0], [1.0, 3.0]]))
    >>> draw_curve(axes, curve, label="scratch", colour="black")
    >>> axes.lines[0].get_ydata()
    array([0.5, 2. ])
    """
    values = smooth(curve.filled(), window)
    steps = curve.steps + (curve.source_steps.mean() if strong else 0)
    shade = COLOURS.get(colour, colour)
    axes.plot(steps, values.mean(axis=0), linestyle=dashes, color=shade, label=label, lw=1.5)
    if len(values) > 1:
        band = mean_interval(values, confidence=confidence).within(within)
        low, high = np.asarray(band.low), np.asarray(band.high)
        if bars is None:
            axes.fill_between(steps, low, high, color=shade, alpha=0.2, lw=0)
        else:
            axes.vlines(steps[bars], low[bars], high[bars], color=shade, lw=1)


def places(n: int, most: int) -> IntArray:
    """Return the indices of at most `most` of `n` checkpoints, evenly spaced, with both ends."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def shown_curve(comparison: Comparison, name: str, *, strong: bool) -> tuple[Curve, int]:
    """Return the drawn curve of an arm, and the comparison's checkpoint at which it begins."""
    arm = comparison[name]
    if not strong:
        kept = arm.curve.steps <= comparison.budget
        return Curve(arm.curve.steps[kept], arm.curve.values[:, kept]), 0
    curve = arm.charged(comparison.scratch)
    begin = int(np.searchsorted(curve.steps[:-1], arm.curve.source_steps.min()))
    return Curve(curve.steps[begin:], curve.values[:, begin:]), begin


@matplotlib.rc_context(STYLE)
def draw_results(results: Mapping[str, LearningResult]) -> Figure:
    """Return a figure of at most the last 4 tasks' returns: mean and Student's 95 % band."""
    shown = [*results.items()][-MOST_CURVES:]
    figure, grid = new_figure(1, len(shown), width=1 + 4.2 * len(shown), height=3.4)
    for axes, (name, result) in zip(grid[0], shown, strict=True):
        named, values = shown_returns(result)
        band, shade = mean_interval(values).within(ends_of(result)), COLOURS["blue"]
        axes.plot(result.steps, band.estimate, color=shade, lw=1.5)
        axes.fill_between(result.steps, band.low, band.high, color=shade, alpha=0.2, lw=0)
        axes.set_title(name)
        steps_scale(axes, int(result.steps[-1]))
        drawn = axes.dataLim
        if np.isfinite([drawn.y0, drawn.y1]).all():
            return_scale(axes.yaxis, drawn.y0, drawn.y1, named)
    return figure


@matplotlib.rc_context(STYLE)
def draw_learning_curves(
    comparison: Comparison, *, width: float = 8.4, height: float = 4.0, most: int = ALL
) -> tuple[Figure, Figure]:
    """Return figures of the arms' curves in one scale: weak, then strong transfer; no legend."""
    weak, strong = (new_figure(1, 1, width=width, height=height)[0] for _ in range(2))
    both = weak.axes + strong.axes
    _draw_arms(dict(zip(both, (False, True), strict=True)), comparison, most)
    for axes in both:
        axes.grid(axis="y", color="#e4e4e4", lw=0.6)
        axes.set_axisbelow(True)
    return weak, strong


def _draw_arms(panels: Mapping[Axes, bool], comparison: Comparison, most: int = ALL) -> None:
    """Draw all arms' curves in one scale into panels; source steps count in a panel under True."""
    shown = controls_first(arm_styles(comparison))
    for (axes, strong), (number, (name, style)) in product(panels.items(), enumerate(shown)):
        whole, begin = shown_curve(comparison, name, strong=strong)
        kept = places(len(whole.steps), most)
        curve = Curve(whole.steps[kept], whole.filled()[:, kept])
        drawn: Any = {"label": name, "colour": style.colour, "dashes": style.dashes}
        if len(shown) > MOST_BANDS:  # bars, which stand beside those of the other arms
            parts = np.linspace(0, len(curve.steps) - 1, BARS + 1)
            at = parts[:-1] + (number + 1) / (len(shown) + 1) * parts[1]
            drawn["bars"] = np.unique(at.round().astype(np.int64))
        draw_curve(axes, curve, within=comparison.within, **drawn)
        if begin:
            # Dotted from step 0 to where training in the target begins.
            low, start = random_level(comparison), int(curve.steps[0])
            first = float(curve.values[:, 0].mean())
            axes.plot([0, start, start], [low, low, first], ":", color="#555555", lw=1.2)
            axes.plot(start, first, "o", color=style.colour, mfc="w", ms=4.5, zorder=4)
    above: Any = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    look: Any = {"ha": "right", "fontsize": 7.5, "color": "#444444"}
    behind = {"fc": "w", "ec": "none", "pad": 0.8, "alpha": 0.8}
    label = minus(f"threshold {comparison.threshold:.4g}")
    for axes, strong in panels.items():
        counted = "target and source steps" if strong else "target steps"
        steps_scale(axes, comparison.total if strong else comparison.budget, counted)
        if comparison.nobody:
            continue
        axes.axhline(comparison.threshold, color=COLOURS["grey"], lw=0.8, zorder=1)
        axes.annotate(label, (1, comparison.threshold), (-2, 2), **above, **look, bbox=behind)
    # In which the threshold can be seen.
    ends = [*np.ravel([axes.dataLim.intervaly for axes in panels]), comparison.threshold]
    for axes in panels:
        returns = "return" if comparison.remarks else GREEDY_RETURN
        return_scale(axes.yaxis, float(min(ends)), float(max(ends)), returns)


def controls_first(styles: Mapping[str, ArmStyle]) -> list[tuple[str, ArmStyle]]:
    """Return arms in the order of drawing: the scratch baseline and the curricula over controls."""
    return sorted(styles.items(), key=lambda arm: not arm[1].control)


def random_level(comparison: Comparison) -> float:
    """Return the return of an arm while it trains its sources: the first return of scratch."""
    return float(comparison.scratch.curve.filled()[:, 0].mean())


@matplotlib.rc_context(STYLE)
def draw_comparison(comparison: Comparison, *, profiles: bool = True) -> Figure:
    """Return the figure of a comparison: learning curves, performance profiles and gains.

    Without an arm that has a source there are no gains, and the curves have a legend.
    """
    styles = arm_styles(comparison)
    lines = max(len(wrap(style.short, NAME_LETTERS)) for style in styles.values())
    height = max(3.7, 1.5 + ROW_HEIGHT * len(styles) * max(1, 0.75 * lines))
    figure = ShownFigure(figsize=(11.5, height), layout="constrained")
    ratios = (1.5 if profiles else 2.5, *(1,) * (profiles + bool(comparison.contrasts)))
    curves, *others = figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
    _draw_arms({curves: True}, comparison)
    curves.set_title("learning curves (strong transfer)")
    if profiles:
        _draw_profiles(others[0], comparison, styles)
    if comparison.contrasts:
        _draw_gains(others[-1], comparison, styles)
    else:
        curves.legend(frameon=False)
    title = f"{comparison.target}: every arm spends {comparison.total:,} steps"
    figure.suptitle(fill(title, TITLE_LETTERS))  # Matplotlib's own lines read dollars as formulas
    caption(figure, sentences.caption(comparison, profiles=profiles))
    return figure


def _draw_profiles(axes: Axes, comparison: Comparison, styles: Mapping[str, ArmStyle]) -> None:
    """Draw the share of runs above tau; a step where a run ends."""
    scratch, arms = comparison.scratch, comparison.arms
    final = {name: asymptotic_performance(arms[name].charged(scratch)) for name in styles}
    ends = np.concatenate(list(final.values()))
    return_scale(axes.xaxis, float(ends.min()), float(ends.max()), "τ: final mean return")
    tau = np.unique([*axes.get_xlim(), *ends])
    curricula = curricula_to_draw = sum(not style.control for style in styles.values())
    for name, style in controls_first(styles):
        share = performance_profile(final[name], tau)
        curricula_to_draw -= not style.control
        # Later lines are thinner, so that none hides one below it.
        width = 1.2 + (0.0 if style.control else 2 * curricula_to_draw / curricula)
        drawn: Any = {"color": style.colour, "label": name, "lw": width, "drawstyle": "steps-post"}
        axes.plot(tau, share.estimate, linestyle=style.dashes, **drawn)
        if share.n > 1 and len(styles) <= MOST_BANDS:
            band = tau, share.low, share.high
            axes.fill_between(*band, step="post", color=style.colour, alpha=0.15, lw=0)
    axes.axvline(comparison.threshold, color=COLOURS["grey"], lw=0.8, zorder=1)
    label = "share of runs above τ"
    axes.set(ylim=(-0.03, 1.03), title="final returns", ylabel=label)


def _draw_gains(axes: Axes, comparison: Comparison, styles: Mapping[str, ArmStyle]) -> None:
    """Draw the gains as a forest plot; the names of its rows are the legend of the figure."""
    axes.axvline(0, color=COLOURS["black"], lw=0.8)
    for row, (name, style) in enumerate(styles.items()):
        sample: Any = {"linestyle": style.dashes, "lw": 1.8, "clip_on": False}
        across = axes.get_yaxis_transform()
        axes.plot([-0.16, -0.03], [row, row], color=style.colour, transform=across, **sample)
        if name in comparison.scratches:
            continue
        gain = comparison.contrasts[name].strong_gain
        verdict = comparison.verdicts.get(name)
        axes.hlines(row, gain.low, gain.high, colors=style.colour, lw=2)
        face = style.colour if verdict is not None and verdict.direction else "w"
        axes.plot(gain.estimate, row, "o", color=style.colour, mfc=face, ms=4.5, label=name)
    write_columns(axes, sentences.gain_columns(comparison, list(styles)))
    names = [fill(style.short, NAME_LETTERS) for style in styles.values()]
    axes.set_yticks(range(len(styles)), names)
    axes.tick_params(axis="y", length=0, pad=32)
    for text, style in zip(axes.get_yticklabels(), styles.values(), strict=True):
        text.set_color("#555555" if style.control else "k")
        text.set_fontsize(7.5 if style.control else 9)
    axes.margins(x=0.08)
    spell_out(axes.xaxis, max(map(abs, axes.get_xlim())))
    axes.spines["left"].set_visible(False)
    spare = max(0.5, (7 - len(styles)) / 2)
    axes.set_ylim(len(styles) - 1 + spare, -spare)
    best = " or ".join(comparison.best_opponents)
    axes.set_title("gain in mean return", loc="right")  # columns of text begin there
    axes.set_xlabel(fill(f"over that of the best opponent, {best}", 40))


# -- grids: mazes, values and potentials as heat maps ----------------------------------------------

DARK = 0.45  # brightness of a colour below which the text on it is white
MIDDLE: Any = {"ha": "center", "va": "center"}


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
        axes.add_patch(Rectangle(_corner(row, column), 1, 1, color="#222222"))
    middle: Any = {**MIDDLE, "fontsize": 8, "fontweight": "bold"}
    aside = 0.32 if heat and height * width <= MOST_NUMBERS else 0
    for name, row, column, _ in view.objects:
        colour = "w" if name == "pit" and not heat else "k"
        letter = axes.text(column - aside, row - aside, LETTERS[name], color=colour, **middle)
        if not heat:
            square = Rectangle(_corner(row, column), 1, 1, color=TINTS[name], alpha=0.8)
            axes.add_patch(square)
        elif not aside:
            letter.set_path_effects([withStroke(linewidth=2, foreground="w")])
    for (row, column), letters in stacked(view.letters).items():
        letter = axes.text(column - 0.3, row - 0.3, letters, color="k", **middle)
        letter.set_bbox({"boxstyle": "circle,pad=0.15", "fc": "w", "ec": "k", "lw": 0.6})
    if legend and view.words:
        axes.set_xlabel(f"column\n{view.words}", fontsize=8)


def _corner(row: float, column: float) -> tuple[float, float]:
    """Return the x and y at which the square of a cell begins."""
    return column - 0.5, row - 0.5


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
    shown = _best(task, values)[view.states]
    drawn = shown[~view.ended]
    low, high = limits or ((drawn.min(), drawn.max()) if drawn.size else (0.0, 0.0))
    low, high, palette = value_scale(float(low), float(high), difference=difference)
    if low == high:
        low, high = low - 1, high + 1
    (top, left), (height, width) = view.origin, view.shape
    grid = np.full((height, width), np.nan)
    grid[tuple((view.cells - view.origin)[~view.ended].T)] = drawn
    extent = (left - 0.5, left + width - 0.5, top + height - 0.5, top - 0.5)
    image = axes.imshow(grid, extent=extent, cmap=palette, vmin=low, vmax=high)
    digits = digits_of(low, high)
    for (row, column), value, over in zip(view.cells, shown, view.ended, strict=True):
        if over:
            corner, grey = _corner(row, column), "#bbbbbb"
            square = Rectangle(corner, 1, 1, fc="#eeeeee", ec=grey, hatch="///", lw=0)
            axes.add_patch(square)
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


def _best(task: Task, values: npt.ArrayLike) -> FloatArray:
    """Return the values of states, (S,), or raise SettingError."""
    generative, table = generative_model(task), numbers("values", values, SettingError)
    n_states, n_actions = generative.states.size, generative.actions.size
    if table.shape not in ((n_states,), (n_states, n_actions)):
        raise SettingError(
            f"values must have shape ({n_states},) or ({n_states}, {n_actions}): got {table.shape}"
        )
    best = table if table.ndim == 1 else table.max(axis=1)  # -inf is an action not available
    if not np.isfinite(best).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(table))[0])
        raise SettingError(f"values must be finite: entry {place} is {table[place]}")
    return best
