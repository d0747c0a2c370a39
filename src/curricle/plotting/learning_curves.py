"""Learning curves: one with its band, and those of all arms over target steps or over all steps."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.comparison.comparison import Comparison
from curricle.plotting.scales import minus, return_scale, steps_scale
from curricle.plotting.styles import COLOURS, STYLE, ArmStyle, arm_styles
from curricle.statistics.curves import Curve, smooth
from curricle.statistics.intervals import bootstrap

LOG = " (symlog scale)"


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
        Name in the legend; key of `COLOURS`, or any colour of Matplotlib.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to start the curve at its mean number of source steps.
    dashes : str or tuple
        Line style of Matplotlib.

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
        band = bootstrap(values, resamples=1000)
        axes.fill_between(steps, band.low, band.high, color=shade, alpha=0.2, lw=0)


@matplotlib.rc_context(STYLE)
def draw_learning_curves(
    comparison: Comparison, *, width: float = 8.4, height: float = 4.0
) -> tuple[Figure, Figure]:
    """Return two figures of the arms' learning curves with one scale of return.

    First weak transfer, over steps in the target up to its budget; then strong transfer, over all
    steps including those of the sources, dotted while an arm trains its sources. Means over seeds
    with 95 % bootstrap bands. There is no legend: :func:`arm_styles` gives the colours.

    Parameters
    ----------
    comparison : Comparison
    width, height : float
        Inches.

    Returns
    -------
    (Figure, Figure)

    Examples
    --------
    >>> from curricle.comparison.arms import Arm
    >>> flat = np.zeros((2, 3))
    >>> arm = Arm(Curve(np.array([0, 50, 100]), flat), flat, flat, False)
    >>> weak, strong = draw_learning_curves(Comparison("hunt", {"scratch": arm}, 50, 100, 1.0, 1))
    >>> weak.axes[0].get_xlabel(), strong.axes[0].get_xlabel()
    ('target steps', 'target and source steps')
    """
    styles, figures = arm_styles(comparison), list[Figure]()
    for strong in (False, True):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw_arms(figure.subplots(), comparison, styles, strong=strong)
        figures.append(figure)
    spans = [figure.axes[0].dataLim.intervaly for figure in figures]
    low, high = (float(limit) for limit in (np.min(spans), np.max(spans)))
    for figure in figures:
        axes = figure.axes[0]
        return_scale(axes.yaxis, min(low, comparison.threshold), max(high, comparison.threshold))
        axes.set_ylabel(f"greedy return{LOG * (axes.get_yscale() != 'linear')}")
        axes.grid(axis="y", color="#e4e4e4", lw=0.6)
        axes.set_axisbelow(True)
    return figures[0], figures[1]


def draw_arms(
    axes: Axes, comparison: Comparison, styles: Mapping[str, ArmStyle], *, strong: bool
) -> None:
    """Draw the curve of each arm, controls below the scratch baseline and the curricula.

    Parameters
    ----------
    axes : Axes
        The scale of its returns is left as it is.
    comparison : Comparison
    styles : dict of str to ArmStyle
        From :func:`arm_styles`.
    strong : bool
        Whether source steps count (strong transfer).
    """
    for name, style in sorted(styles.items(), key=lambda one: not one[1].control):
        curve = comparison[name].curve
        begin, end = 0, int(np.searchsorted(curve.steps, comparison.budget, side="right"))
        if strong:
            curve = comparison[name].charged(comparison.scratch)
            # The first checkpoint at which a seed has left its sources.
            begin = int(np.searchsorted(curve.steps, comparison[name].curve.source_steps.min()))
            begin, end = min(begin, len(curve.steps) - 1), len(curve.steps)
        shown = Curve(curve.steps[begin:end], curve.values[:, begin:end])
        draw_curve(axes, shown, label=name, colour=style.colour, dashes=style.dashes)
        if begin:
            _draw_sources(axes, comparison, shown, style.colour)
    last = comparison.total if strong else comparison.budget
    axes.set_xlim(0, last)
    unit = steps_scale(axes.xaxis, last)
    counted = "target and source steps" if strong else "target steps"
    axes.set_xlabel(f"{counted}{f' ({unit})' if unit else ''}")
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


def _draw_sources(axes: Axes, comparison: Comparison, shown: Curve, colour: str) -> None:
    """Draw a dotted line from step 0 to where training in the target begins."""
    random_return = float(comparison.scratch.curve.filled()[:, 0].mean())
    start, first = int(shown.steps[0]), float(shown.values[:, 0].mean())
    axes.plot(
        [0, start, start], [random_return, random_return, first], ":", color="#555555", lw=1.2
    )
    axes.plot(start, first, "o", color=colour, mfc="w", ms=4.5, zorder=4)
