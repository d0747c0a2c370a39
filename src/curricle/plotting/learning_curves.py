"""Learning curves, one or those of all arms, and the figure of a comparison."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.arrays import IntArray
from curricle.comparison.comparison import Comparison
from curricle.comparison.verdicts import SIGNIFICANT
from curricle.curriculum.result import MOST_CURVES
from curricle.errors import SettingError
from curricle.learning.result import LearningResult, shown_returns
from curricle.plotting.scales import minus, return_scale, steps_scale, without_seeds
from curricle.plotting.styles import (
    COLOURS,
    STYLE,
    ArmStyle,
    ShownFigure,
    arm_styles,
    caption,
    new_figure,
    write_columns,
)
from curricle.statistics.curves import SCRATCH, Curve, asymptotic_performance, smooth
from curricle.statistics.hypothesis_tests import performance_profile
from curricle.statistics.intervals import CONFIDENCE, mean_interval, seed_line

ALL = 10**9
"""More checkpoints than a curve has."""


def draw_curve(
    axes: Axes,
    curve: Curve,
    *,
    label: str,
    colour: str,
    window: int = 1,
    strong: bool = False,
    dashes: Any = "-",
    confidence: float = CONFIDENCE,
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
        Of the band, at each checkpoint.

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
        band = mean_interval(values, confidence=confidence)
        axes.fill_between(steps, band.low, band.high, color=shade, alpha=0.2, lw=0)


def places(n: int, most: int) -> IntArray:
    """Return the places of at most `most` of `n` checkpoints, evenly spaced, with both ends."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def shown_curve(comparison: Comparison, name: str, *, strong: bool) -> tuple[Curve, int]:
    """Return the curve of an arm as it is drawn, and its first checkpoint of the comparison's.

    For strong transfer source steps count, and the curve begins at the first checkpoint at which a
    seed has left its sources. For weak transfer it ends at the budget of the target.
    """
    arm = comparison[name]
    if not strong:
        kept = arm.curve.steps <= comparison.budget
        return Curve(arm.curve.steps[kept], arm.curve.values[:, kept]), 0
    curve = arm.charged(comparison.scratch)
    begin = int(np.searchsorted(curve.steps[:-1], arm.curve.source_steps.min()))
    return Curve(curve.steps[begin:], curve.values[:, begin:]), begin


@matplotlib.rc_context(STYLE)
def draw_results(results: Mapping[str, LearningResult]) -> Figure:
    """Return the figure of what tasks learnt: a panel with a curve for each, of at most the last 4.

    The greedy return, or that of training where nothing was evaluated: mean over seeds with
    Student's 95 % band.
    """
    shown = [*results.items()][-MOST_CURVES:]
    figure, grid = new_figure(1, len(shown), width=1 + 4.2 * len(shown), height=3.4)
    for axes, (name, one) in zip(grid[0], shown, strict=True):
        named, values = shown_returns(one)
        line = seed_line(name, one.steps, values)
        axes.plot(line.steps, line.values, color=COLOURS["blue"], lw=1.5)
        axes.fill_between(line.steps, line.low, line.high, color=COLOURS["blue"], alpha=0.2, lw=0)
        axes.set_title(name)
        steps_scale(axes, int(one.steps[-1]))
        drawn = axes.dataLim
        if np.isfinite([drawn.y0, drawn.y1]).all():
            return_scale(axes.yaxis, drawn.y0, drawn.y1, named)
    return figure


@matplotlib.rc_context(STYLE)
def draw_learning_curves(
    comparison: Comparison, *, width: float = 8.4, height: float = 4.0, most: int = ALL
) -> tuple[Figure, Figure]:
    """Return two figures of the arms' learning curves with one scale of return.

    First weak transfer, over target steps up to the budget of the target; then strong transfer,
    over all steps, dotted while an arm trains its sources. Means over seeds with Student's 95 %
    bands. There is no legend: :func:`arm_styles` gives the colours.
    """
    styles = arm_styles(comparison)
    weak, strong = (new_figure(1, 1, width=width, height=height)[0] for _ in range(2))
    draw_arms(weak.axes[0], comparison, styles, strong=False, most=most)
    draw_arms(strong.axes[0], comparison, styles, strong=True, most=most)
    both = weak.axes + strong.axes
    scale_returns(both, comparison)
    for axes in both:
        axes.grid(axis="y", color="#e4e4e4", lw=0.6)
        axes.set_axisbelow(True)
    return weak, strong


def scale_returns(panels: Sequence[Axes], comparison: Comparison) -> None:
    """Give panels of drawn arms one scale of return, in which the threshold can be seen."""
    ends = [*np.ravel([axes.dataLim.intervaly for axes in panels]), comparison.threshold]
    for axes in panels:
        return_scale(axes.yaxis, float(min(ends)), float(max(ends)), "greedy return")


def draw_arms(
    axes: Axes,
    comparison: Comparison,
    styles: Mapping[str, ArmStyle],
    *,
    strong: bool,
    most: int = ALL,
) -> None:
    """Draw the curve of each arm, in which source steps count if `strong`.

    The scale of returns is left to :func:`scale_returns`, which panels can share.
    """
    for name, style in controls_first(styles):
        whole, begin = shown_curve(comparison, name, strong=strong)
        kept = places(len(whole.steps), most)
        shown = Curve(whole.steps[kept], whole.filled()[:, kept])
        look = {"label": name, "colour": style.colour, "dashes": style.dashes}
        draw_curve(axes, shown, **look, confidence=comparison.confidence)
        if begin:
            _draw_sources(axes, comparison, shown, style.colour)
    counted = "target and source steps" if strong else "target steps"
    steps_scale(axes, comparison.total if strong else comparison.budget, counted)
    axes.axhline(comparison.threshold, color=COLOURS["grey"], lw=0.8, zorder=1)
    axes.annotate(
        minus(f"threshold {comparison.threshold:.4g}"),
        (1, comparison.threshold),
        (-2, 2),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="right",
        fontsize=7.5,
        color="#444444",
        bbox={"fc": "w", "ec": "none", "pad": 0.8, "alpha": 0.8},
    )


def controls_first(styles: Mapping[str, ArmStyle]) -> list[tuple[str, ArmStyle]]:
    """Return arms in the order of drawing: the scratch baseline and the curricula over controls."""
    return sorted(styles.items(), key=lambda one: not one[1].control)


def random_level(comparison: Comparison) -> float:
    """Return the return that counts while an arm trains its sources: the first one of scratch."""
    return float(comparison.scratch.curve.filled()[:, 0].mean())


def _draw_sources(axes: Axes, comparison: Comparison, shown: Curve, colour: str) -> None:
    """Draw a dotted line from step 0 to where training in the target begins."""
    low = random_level(comparison)
    start, first = int(shown.steps[0]), float(shown.values[:, 0].mean())
    axes.plot([0, start, start], [low, low, first], ":", color="#555555", lw=1.2)
    axes.plot(start, first, "o", color=colour, mfc="w", ms=4.5, zorder=4)


ROW_HEIGHT = 0.21


@matplotlib.rc_context(STYLE)
def draw_comparison(comparison: Comparison) -> Figure:
    """Return the figure of a comparison: learning curves, performance profiles and gains.

    Left, the mean curve of each arm over target and source steps, dotted while it trains its
    sources. Middle, the share of its runs whose final return is above tau. Right, its mean return
    above that of the scratch baseline; the list of arms there is the legend of all three. Each
    with 95 % intervals over seeds. SettingError when scratch is the only arm.
    """
    if not comparison.contrasts:
        raise SettingError(f"a comparison to draw needs an arm besides {SCRATCH!r}: got none")
    styles = arm_styles(comparison)
    height = max(3.7, 1.5 + ROW_HEIGHT * len(styles))
    figure = ShownFigure(figsize=(11.5, height), layout="constrained")
    curves, profile, gains = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
    draw_arms(curves, comparison, styles, strong=True)
    scale_returns([curves], comparison)
    curves.set_title("learning curves (strong transfer)")
    _draw_profiles(profile, comparison, styles)
    _draw_gains(gains, comparison, styles)
    figure.suptitle(f"{comparison.target}: every arm spends {comparison.total:,} steps")
    caption(figure, _words(comparison))
    return figure


def _draw_profiles(axes: Axes, comparison: Comparison, styles: Mapping[str, ArmStyle]) -> None:
    """Draw the share of runs above tau; a step where a run ends."""
    final = {
        name: asymptotic_performance(arm.charged(comparison.scratch))
        for name, arm in comparison.arms.items()
    }
    ends = np.concatenate(list(final.values()))
    return_scale(axes.xaxis, float(ends.min()), float(ends.max()), "τ: final return")
    tau = np.unique([*axes.get_xlim(), *ends])
    own = left = sum(not style.control for style in styles.values())
    for name, style in controls_first(styles):
        share = performance_profile(final[name], tau, confidence=comparison.confidence)
        left -= not style.control
        # Later lines are thinner, so that none hides one below it.
        width = 1.2 + (0.0 if style.control else 2 * left / own)
        drawn: Any = {"color": style.colour, "label": name, "lw": width, "drawstyle": "steps-post"}
        axes.plot(tau, share.estimate, linestyle=style.dashes, **drawn)
        if share.n > 1:
            band = tau, share.low, share.high
            axes.fill_between(*band, step="post", color=style.colour, alpha=0.15, lw=0)
    axes.axvline(comparison.threshold, color=COLOURS["grey"], lw=0.8, zorder=1)
    axes.set(
        ylim=(-0.03, 1.03),
        title="final returns",
        ylabel="share of runs with a final return > τ",
    )


def _draw_gains(axes: Axes, comparison: Comparison, styles: Mapping[str, ArmStyle]) -> None:
    """Draw the gains as a forest plot; the names of its rows are the legend of the figure."""
    axes.axvline(0, color=COLOURS["black"], lw=0.8)
    tested = not comparison.withheld
    head = "gain [95 %]" if comparison.seeds > 1 else "gain"
    columns = [(head, "p (Holm)" if tested else "")]
    for row, (name, style) in enumerate(styles.items()):
        sample: Any = {"linestyle": style.dashes, "lw": 1.8, "clip_on": False}
        across = axes.get_yaxis_transform()
        axes.plot([-0.16, -0.03], [row, row], color=style.colour, transform=across, **sample)
        if name in comparison.scratches:
            columns.append(("reference" if name == comparison.best_scratch else "", ""))
            continue
        gain = comparison.contrasts[name].strong_gain
        verdict = comparison.verdicts.get(name)
        axes.hlines(row, gain.low, gain.high, colors=style.colour, lw=2)
        face = style.colour if verdict is not None and verdict.direction else "w"
        axes.plot(gain.estimate, row, "o", color=style.colour, mfc=face, ms=4.5, label=name)
        p = f"{verdict.adjusted_p:.2g}" if tested and verdict is not None else ""
        columns.append((without_seeds(gain), p))
    write_columns(axes, list(zip(*columns, strict=True)))
    axes.set_yticks(range(len(styles)), [style.short for style in styles.values()])
    axes.tick_params(axis="y", length=0, pad=32)
    for text, style in zip(axes.get_yticklabels(), styles.values(), strict=True):
        text.set_color("#555555" if style.control else "k")
        text.set_fontsize(7.5 if style.control else 9)
    axes.margins(x=0.08)
    axes.spines["left"].set_visible(False)
    spare = max(0.5, (7 - len(styles)) / 2)
    axes.set_ylim(len(styles) - 1 + spare, -spare)
    xlabel = f"mean return, minus that of {comparison.best_scratch}"
    axes.set(title="gain over scratch", xlabel=xlabel)


def _words(comparison: Comparison) -> str:
    """Return the caption."""
    n, seeds = len(comparison.verdicts), comparison.seeds
    tests = f"adjusted for {n} curricula by Holm's rule" if n > 1 else "of one curriculum"
    if seeds > 1:
        how = (
            f"{seeds} seeds; bands and bars are nominal 95 % intervals over seeds, Student's for "
            "means and Wilson's for shares, pointwise for curves and profiles."
        )
        sure = (
            f"; p values of a sign-flip test of the paired differences, {tests}; filled where "
            f"p < {SIGNIFICANT:g}"
        )
        if why := comparison.withheld:
            sure = f"; {why}"
    else:
        how, sure = "One seed, which allows neither intervals nor tests.", ""
    controls = any(arm.control for arm in comparison.arms.values())
    return (
        f"{how} Left: means over seeds; dotted, steps in the sources, at the random policy's "
        "return; circle, where the first seed begins the target. Middle: final is the mean over "
        "the last tenth of the checkpoints. Right: the mean return is the mean height of the left "
        f"curve{sure}.{' Dashed and greyer: controls.' * controls}"
    )
