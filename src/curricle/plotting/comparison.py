"""The figure of a comparison: learning curves, performance profiles and gains."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.comparison.comparison import Comparison
from curricle.comparison.verdicts import SIGNIFICANT
from curricle.errors import SettingError
from curricle.plotting.learning_curves import controls_first, draw_arms, scale_returns
from curricle.plotting.scales import return_scale, without_seeds
from curricle.plotting.styles import (
    COLOURS,
    STYLE,
    ArmStyle,
    ShownFigure,
    arm_styles,
    caption,
    write_columns,
)
from curricle.statistics.curves import SCRATCH
from curricle.statistics.hypothesis_tests import performance_profile
from curricle.statistics.metrics import asymptotic_performance

ROW_HEIGHT = 0.21


@matplotlib.rc_context(STYLE)
def draw_comparison(comparison: Comparison) -> Figure:
    """Return the figure of a comparison: learning curves, performance profiles and gains.

    Left, the mean curve of each arm over target and source steps, dotted while it trains its
    sources. Middle, the share of its runs whose final return is above tau. Right, its mean return
    above that of the scratch baseline; the list of arms there is the legend of all three. Each
    with 95 % intervals over seeds.

    Raises
    ------
    SettingError
        When there is no arm besides the scratch baseline.

    Examples
    --------
    >>> from curricle.comparison.arms import Arm
    >>> from curricle.statistics.curves import Curve
    >>> steps, low = np.array([0, 50, 100]), np.zeros((3, 3))
    >>> arms = {
    ...     "scratch": Arm(Curve(steps, low), low, low, False),
    ...     "mean": Arm(Curve(steps, low + [1, 2, 2], np.array([50] * 3)), low, low, False)}
    >>> figure = draw_comparison(Comparison("hunt", arms, 50, 100, 1.5, 1))
    >>> [axes.get_title() for axes in figure.axes]
    ['learning curves (strong transfer)', 'final returns', 'gain over scratch']
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
    tested = not _too_few(comparison)
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


def _too_few(comparison: Comparison) -> str:
    """Return that there are too few seeds for a verdict; empty if there are enough."""
    return next((one.too_few for one in comparison.verdicts.values()), "")


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
        if few := _too_few(comparison):
            sure = f"; {few}"
    else:
        how, sure = "One seed, which allows neither intervals nor tests.", ""
    controls = any(arm.control for arm in comparison.arms.values())
    return (
        f"{how} Left: means over seeds; dotted, steps in the sources, at the random policy's "
        "return; circle, where the first seed begins the target. Middle: final is the mean over "
        "the last tenth of the checkpoints. Right: the mean return is the mean height of the left "
        f"curve{sure}.{' Dashed and greyer: controls.' * controls}"
    )
