"""Figures of a sweep or a tuning: parallel coordinates of what was tried, and main effects."""

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from curricle.display import OWN_COLOURS
from curricle.plotting.scales import minus
from curricle.plotting.styles import COLOURS, SEQUENTIAL, STYLE, new_figure
from curricle.statistics.curves import SCRATCH
from curricle.study.config.varied_settings import value_text
from curricle.study.effects import TUNING, Effects, Setting, Tried, short
from curricle.text_tables import counted

PANEL = 2.6
"""Height of a panel, in inches."""
ACROSS = 4.2
"""Least width of a panel of parallel coordinates."""
SCORE = "mean return"
SMALL = 7.5
"""Size of the text at axes, in points."""
MOST_WORDS = 8
"""Listed values of a setting that are written at its axis; of more the first and the last."""


def effect_colours(effects: Effects) -> dict[str, str]:
    """Return the colour of each arm; scratch is black."""
    own = [arm for arm in effects.arms if not arm.startswith(SCRATCH)]
    found = {arm: COLOURS[OWN_COLOURS[n % len(OWN_COLOURS)]] for n, arm in enumerate(own)}
    return {arm: found.get(arm, COLOURS["black"]) for arm in effects.arms}


@matplotlib.rc_context(STYLE)
def draw_parallel_coordinates(effects: Effects, *, width: float = 8.6) -> Figure:
    """Return the figure with a line for each combination of values that was tried.

    It crosses an axis for each setting at its value, and ends at its mean return. A panel for each
    arm; the best is thick.

    Parameters
    ----------
    effects : Effects
    width : float
        Inches; panels that do not fit beside each other stand below each other.

    Examples
    --------
    >>> setting = Setting("learner.epsilon", ("0.1", "0.3"), 0.0, 1.0, False, (0.1, 0.3))
    >>> tried = [Tried("scratch", {"learner.epsilon": e}, -e, e == 0.1) for e in (0.1, 0.3)]
    >>> figure = draw_parallel_coordinates(Effects(TUNING, (setting,), tuple(tried), {}))
    >>> [axes.get_title("left") for axes in figure.axes if axes.axison]
    ['scratch: 2 trials']
    """
    panels = max(1, min(len(effects.arms), int(width / ACROSS)))
    rows = math.ceil(len(effects.arms) / panels)
    figure, grid = new_figure(rows, panels, width=width, height=0.3 + PANEL * rows)
    scores = [one.score for one in effects.tried]
    scale = Normalize(min(scores), max(scores) if max(scores) > min(scores) else min(scores) + 1)
    for axes in grid.flat[len(effects.arms) :]:
        axes.set_axis_off()
    for arm, axes in zip(effects.arms, grid.flat, strict=False):
        tried = effects.of(arm)
        kind = "trial" if effects.kind == TUNING else "arm"
        axes.set_title(f"{arm}: {counted(len(tried), kind)}", loc="left")
        own = [one for one in effects.settings if any(one.key in t.values for t in tried)]
        _draw_lines(axes, own, tried, scale)
    return figure


def _draw_lines(
    axes: Axes, settings: Sequence[Setting], tried: Sequence[Tried], scale: Normalize
) -> None:
    colours = matplotlib.colormaps[SEQUENTIAL]
    last = len(settings)
    for one in sorted(tried, key=lambda one: one.score):
        heights = [s.place(one.values[s.key]) for s in settings if s.key in one.values]
        points: Any = [*heights, float(scale(one.score))]
        best: Any = {"lw": 3.0, "zorder": 3} if one.best else {"lw": 1.1, "zorder": 2}
        if one.best:  # an outline, so that it stands out from lines of its colour
            axes.plot(range(len(points)), points, color="black", lw=4.6, zorder=3)
        axes.plot(range(len(points)), points, color=colours(scale(one.score)), **best)
    for place, setting in enumerate(settings):
        _draw_axis(axes, place, _marks(setting))
    low, high = scale.vmin or 0.0, scale.vmax or 0.0
    ends = [(y, minus(short(low + y * (high - low)))) for y in (0.0, 0.5, 1.0)]
    _draw_axis(axes, last, ends, left=True)
    axes.set_xticks(range(last + 1), [*(_in_lines(s.key) for s in settings), SCORE], fontsize=SMALL)
    axes.set(xlim=(-0.25, last + 0.45), ylim=(-0.07, 1.07), yticks=[])
    axes.tick_params(axis="x", length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)


def _marks(setting: Setting) -> list[tuple[float, str]]:
    """Return the places on the axis of a setting that are labelled, from 0 to 1."""
    if setting.values:
        values = setting.values
        values = values if len(values) <= MOST_WORDS else (values[0], values[-1])
        return [(setting.place(value), _words(value)) for value in values]
    middle = math.sqrt(setting.low * setting.high) if setting.log else 0.0
    middle = middle or (setting.low + setting.high) / 2
    ends = ((0.0, setting.low), (0.5, middle), (1.0, setting.high))
    return [(place, minus(short(value))) for place, value in ends]


def _draw_axis(
    axes: Axes, place: int, marks: Sequence[tuple[float, str]], *, left: bool = False
) -> None:
    """Draw an upright axis with its labels to the right of it, or of the last one too."""
    axes.plot([place, place], [0, 1], color="#444444", lw=0.9, zorder=4)
    for height, text in marks:
        axes.plot([place - 0.02, place + 0.02], [height] * 2, color="#444444", lw=0.9, zorder=4)
        axes.annotate(
            text,
            (place, height),
            (5, 0),
            textcoords="offset points",
            va="center",
            fontsize=SMALL,
            zorder=5,
            bbox={"fc": "w", "ec": "none", "pad": 0.6},
        )


@matplotlib.rc_context(STYLE)
def draw_main_effects(effects: Effects, *, width: float = 8.6) -> Figure:
    """Return the figure with the mean return of each arm over the levels of each setting.

    Bars are 95 % intervals over seeds; of a tuning they reach from the lowest to the highest trial.

    Parameters
    ----------
    effects : Effects
    width : float
        Inches.

    Examples
    --------
    >>> from curricle.study.effects import Level
    >>> setting = Setting("learner.epsilon", ("0.1", "0.3"), 0.0, 1.0, False, (0.1, 0.3))
    >>> levels = Level("0.1", 2, -3.0, -4.0, -2.0), Level("0.3", 2, -5.0, -6.0, -4.0)
    >>> tried = Tried("scratch", {"learner.epsilon": 0.1}, -3.0, True),
    >>> effects = Effects(TUNING, (setting,), tried, {("scratch", "learner.epsilon"): levels})
    >>> [axes.get_title() for axes in draw_main_effects(effects).axes]
    ['learner.epsilon']
    """
    panels = max(1, min(len(effects.settings), int(width / 2.7)))
    rows = math.ceil(len(effects.settings) / panels)
    figure, grid = new_figure(rows, panels, width=width, height=0.2 + PANEL * rows)
    figure.get_layout_engine().set(h_pad=0.1)  # type: ignore[union-attr, call-arg]
    for axes in grid.flat[len(effects.settings) :]:
        axes.set_axis_off()
    for number, (setting, axes) in enumerate(zip(effects.settings, grid.flat, strict=False)):
        if number:
            axes.sharey(grid.flat[0])
        _draw_effect(axes, effects, setting)
        axes.set_ylabel("mean return" if number % panels == 0 else "")
    return figure


def _draw_effect(axes: Axes, effects: Effects, setting: Setting) -> None:
    colours = effect_colours(effects)
    present = [arm for arm in effects.arms if (arm, setting.key) in effects.levels]
    for number, arm in enumerate(present):
        levels = effects.levels[arm, setting.key]
        apart = 0.12 * (number - (len(present) - 1) / 2)
        x = [setting.levels.index(one.text) + apart for one in levels]
        mean = [one.mean for one in levels]
        reach = [[one.mean - one.low for one in levels], [one.high - one.mean for one in levels]]
        axes.errorbar(x, mean, reach, color=colours[arm], fmt="o-", ms=4.5, lw=1.5, elinewidth=1)
    words = [*map(_words, setting.values or setting.levels)]
    slanted: Any = {"rotation": 25, "ha": "right"} if max(map(len, words)) > 8 else {}
    axes.set_xticks(range(len(words)), words, fontsize=SMALL, **slanted)
    axes.set_xlim(-0.5, len(words) - 0.5)
    axes.set_title(setting.key)
    axes.grid(axis="y", color="#e4e4e4", lw=0.6)
    axes.set_axisbelow(True)


def _in_lines(key: str) -> str:
    """Return the key of a setting in short lines.

    Examples
    --------
    >>> _in_lines("tasks.chase.learner.learning_rate").splitlines()
    ['chase', 'learning', '_rate']
    """
    words = key.split(".")
    lines = [*words[1:2], words[-1]] if words[0] in ("tasks", "transfers") else words[-1:]
    return "\n".join(_cut(line) for line in lines).replace("_", "\n_", 1)


def _words(value: Any) -> str:
    """Return a value, or a part of a range, as axes have it."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return minus(f"{value:,}" if whole else _cut(value_text(value)))


def _cut(text: str, most: int = 18) -> str:
    """Return a text that is cut where it is too long for an axis."""
    return text if len(text) <= most else f"{text[: most - 1]}…"
