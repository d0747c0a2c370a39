"""The picture of a comparison: how arms learn, how their runs end, what they gain."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.comparison.comparison import SIGNIFICANT, Comparison
from curricle.errors import SettingError
from curricle.plotting.figures import COLOURS, STYLE, write_columns
from curricle.plotting.learning_curves import LOG, draw_arms
from curricle.plotting.scales import caption, minus, return_scale, steps_scale
from curricle.plotting.styles import Look, arm_looks
from curricle.statistics.curves import SCRATCH
from curricle.statistics.hypothesis_tests import performance_profile
from curricle.statistics.metrics import asymptotic_performance

ROW_HEIGHT = 0.21


@matplotlib.rc_context(STYLE)
def draw_comparison(comparison: Comparison) -> Figure:
    """Return the figure of a comparison: learning curves, performance profiles and gains.

    Left, the mean charged curve of each arm: on the axis of total steps, dotted while it learns
    its sources. Middle, the share of its runs whose final charged return is above tau. Right, its
    mean charged return above the direct learner's; the list of arms there is the legend of all
    three. Each with 95 % bootstrap intervals over seeds.

    Parameters
    ----------
    comparison : Comparison
        Of at least one arm besides the direct learner.

    Returns
    -------
    Figure

    Raises
    ------
    SettingError
        When there is no such arm.

    Examples
    --------
    >>> from curricle.comparison.arms import Arm
    >>> from curricle.statistics.curves import Curve
    >>> steps, low = np.array([0, 50, 100]), np.zeros((3, 3))
    >>> arms = {
    ...     "scratch": Arm(Curve(steps, low), low, low, False),
    ...     "taught": Arm(Curve(steps, low + [1, 2, 2], np.array([50] * 3)), low, low, False)}
    >>> figure = draw_comparison(Comparison("hunt", arms, 50, 100, 1.5, 1))
    >>> [axes.get_title() for axes in figure.axes]
    ['learning, sources charged', 'how runs end', 'gain over the direct learner']
    """
    if len(comparison.arms) < 2:
        raise SettingError(f"a comparison to draw needs an arm besides {SCRATCH!r}: got none")
    looks = arm_looks(comparison)
    height = max(3.7, 1.5 + ROW_HEIGHT * len(looks))
    figure = Figure(figsize=(11.5, height), layout="constrained")
    curves, profile, gains = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
    _draw_curves(curves, comparison, looks)
    _draw_profiles(profile, comparison, looks)
    _draw_gains(gains, comparison, looks)
    figure.suptitle(f"{comparison.target}: every arm spends {comparison.total:,} steps")
    caption(figure, _words(comparison))
    return figure


def _draw_curves(axes: Axes, comparison: Comparison, looks: Mapping[str, Look]) -> None:
    """Draw the charged curves, dotted up to where the target begins."""
    draw_arms(axes, comparison, looks, charged=True)
    low, high = axes.dataLim.intervaly
    return_scale(axes.yaxis, min(low, comparison.threshold), max(high, comparison.threshold))
    unit = steps_scale(axes.xaxis, comparison.total)
    axes.set(
        title="learning, sources charged",
        xlabel=f"total steps{f' ({unit})' if unit else ''}",
        ylabel=f"greedy return{LOG * (axes.get_yscale() != 'linear')}",
    )


def _draw_profiles(axes: Axes, comparison: Comparison, looks: Mapping[str, Look]) -> None:
    """Draw the share of runs above tau; a step where a run ends."""
    final = {
        name: asymptotic_performance(arm.charged(comparison.scratch))
        for name, arm in comparison.arms.items()
    }
    eval_freq = np.concatenate(list(final.values()))
    return_scale(axes.xaxis, float(eval_freq.min()), float(eval_freq.max()))
    tau = np.unique([*axes.get_xlim(), *eval_freq])
    own = left = sum(not look.control for look in looks.values())
    for name, look in _controls_first(looks):
        share = performance_profile(final[name], tau, resamples=1000)
        left -= not look.control
        # The later a line is drawn the thinner, so that it hides none that it runs upon.
        width = 1.2 + (0.0 if look.control else 2 * left / own)
        drawn: Any = {"color": look.colour, "label": name, "lw": width, "drawstyle": "steps-post"}
        axes.plot(tau, share.estimate, linestyle=look.dashes, **drawn)
        if share.n > 1:
            band = tau, share.low, share.high
            axes.fill_between(*band, step="post", color=look.colour, alpha=0.15, lw=0)
    axes.axvline(comparison.threshold, color=COLOURS["grey"], lw=0.8, zorder=1)
    axes.set(
        ylim=(-0.03, 1.03),
        title="how runs end",
        xlabel=f"τ: final return{LOG * (axes.get_xscale() != 'linear')}",
        ylabel="share of runs with a final return > τ",
    )


def _draw_gains(axes: Axes, comparison: Comparison, looks: Mapping[str, Look]) -> None:
    """Draw the gains as a forest plot; the names of its rows are the legend of the figure."""
    axes.axvline(0, color=COLOURS["black"], lw=0.8)
    sure = comparison.seeds > 1
    numbers = {SCRATCH: ("reference", "")}
    for row, (name, look) in enumerate(looks.items()):
        sample: Any = {"linestyle": look.dashes, "lw": 1.8, "clip_on": False}
        across = axes.get_yaxis_transform()
        axes.plot([-0.16, -0.03], [row, row], color=look.colour, transform=across, **sample)
        if name == SCRATCH:
            continue
        contrast = comparison.contrasts[name]
        gain = contrast.strong_gain
        shown = contrast.adjusted_p < SIGNIFICANT
        axes.hlines(row, gain.low, gain.high, colors=look.colour, lw=2)
        face = look.colour if shown else "w"
        axes.plot(gain.estimate, row, "o", color=look.colour, mfc=face, ms=4.5, label=name)
        p = f"{contrast.adjusted_p:.2g}" if sure else ""
        numbers[name] = minus(str(gain).rsplit(",", 1)[0]), p
    _write_rows(axes, looks, numbers, ("gain [95 %]", "p (Holm)") if sure else ("gain", ""))
    axes.margins(x=0.08)
    axes.spines["left"].set_visible(False)
    spare = max(0.5, (7 - len(looks)) / 2)
    axes.set_ylim(len(looks) - 1 + spare, -spare)
    axes.set(title="gain over the direct learner", xlabel="mean charged return, minus the direct's")


def _write_rows(
    axes: Axes,
    looks: Mapping[str, Look],
    numbers: Mapping[str, tuple[str, str]],
    head: tuple[str, str],
) -> None:
    """Write the name of each row to its left, its gain and its p value to its right."""
    axes.set_yticks(range(len(looks)), [look.short for look in looks.values()])
    axes.tick_params(axis="y", length=0, pad=32)
    for text, look in zip(axes.get_yticklabels(), looks.values(), strict=True):
        text.set_color("#555555" if look.control else "k")
        text.set_fontsize(7.5 if look.control else 9)
    columns = list(zip(head, *(numbers[name] for name in looks), strict=True))
    write_columns(axes, columns)


def _controls_first(looks: Mapping[str, Look]) -> list[tuple[str, Look]]:
    """Return the arms with the direct learner and the curricula last, to be drawn on top."""
    return sorted(looks.items(), key=lambda one: not one[1].control)


def _words(comparison: Comparison) -> str:
    """Return what the figure shows, in sentences."""
    n, seeds = len(comparison.contrasts), comparison.seeds
    tests = f"adjusted for {n} arms by Holm's rule" if n > 1 else "of one arm"
    if seeds > 1:
        how = (
            f"{seeds} seeds; bands and bars are nominal 95 % percentile bootstrap intervals over "
            "them, those of curves and profiles at each point alone."
        )
        sure = (
            f"; p values by flipping signs of the paired differences, {tests}; filled where "
            f"p < {SIGNIFICANT:g}"
        )
    else:
        how, sure = "One seed, which allows neither intervals nor tests.", ""
    controls = any(arm.control for arm in comparison.arms.values())
    return (
        f"{how} Left: means over seeds; dotted, steps spent on sources, at the untaught return; "
        "circle, the first seed's target begins. Middle: final is the mean over the last tenth of "
        "the checkpoints. Right: the gain is the mean height of the left curve above the direct "
        f"learner's{sure}.{' Dashed and greyer: controls.' * controls}"
    )
