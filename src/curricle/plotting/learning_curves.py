"""How arms learn, on either axis: steps in the target alone, or all steps, sources charged."""

from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.comparison.comparison import Comparison
from curricle.plotting.figures import COLOURS, STYLE, draw_curve
from curricle.plotting.scales import minus, return_scale, steps_scale
from curricle.plotting.styles import Look, arm_looks
from curricle.statistics.curves import Curve

LOG = " (symlog scale)"


@matplotlib.rc_context(STYLE)
def draw_learning_curves(
    comparison: Comparison, *, width: float = 8.4, height: float = 4.0
) -> tuple[Figure, Figure]:
    """Return two figures of the arms' learning curves with one scale of return.

    First over steps in the target up to its budget, sources free (weak transfer); then over all
    steps, sources charged (strong transfer), dotted while an arm learns its sources. Means over
    seeds with 95 % bootstrap bands. There is no legend: colours are those of :func:`arm_looks`.

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
    >>> free, charged = draw_learning_curves(Comparison("hunt", {"scratch": arm}, 50, 100, 1.0, 1))
    >>> free.axes[0].get_xlabel(), charged.axes[0].get_xlabel()
    ('steps in the target, sources free', 'total steps, sources charged')
    """
    looks, figures = arm_looks(comparison), list[Figure]()
    for charged in (False, True):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw_arms(figure.subplots(), comparison, looks, charged=charged)
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
    axes: Axes, comparison: Comparison, looks: Mapping[str, Look], *, charged: bool
) -> None:
    """Draw the curve of each arm, the direct learner and the curricula over their controls.

    Parameters
    ----------
    axes : Axes
        Whose scale of return is left as it is.
    comparison : Comparison
    looks : dict of str to Look
        As :func:`arm_looks` gives them.
    charged : bool
        Whether source steps count.
    """
    for name, look in sorted(looks.items(), key=lambda one: not one[1].control):
        curve = comparison[name].curve
        begin, end = 0, int(np.searchsorted(curve.steps, comparison.budget, side="right"))
        if charged:
            curve = comparison[name].charged(comparison.scratch)
            # The first checkpoint at which a seed has left its sources.
            begin = int(np.searchsorted(curve.steps, comparison[name].curve.source_steps.min()))
            begin, end = min(begin, len(curve.steps) - 1), len(curve.steps)
        shown = Curve(curve.steps[begin:end], curve.values[:, begin:end])
        draw_curve(axes, shown, label=name, colour=look.colour, dashes=look.dashes)
        if begin:
            _draw_sources(axes, comparison, shown, look.colour)
    last = comparison.total if charged else comparison.budget
    axes.set_xlim(0, last)
    unit = steps_scale(axes.xaxis, last)
    counted = "total steps, sources charged" if charged else "steps in the target, sources free"
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
    """Draw the dotted way through the sources to where an arm's target begins."""
    random_return = float(comparison.scratch.curve.filled()[:, 0].mean())
    start, earned = int(shown.steps[0]), float(shown.values[:, 0].mean())
    axes.plot(
        [0, start, start], [random_return, random_return, earned], ":", color="#555555", lw=1.2
    )
    axes.plot(start, earned, "o", color=colour, mfc="w", ms=4.5, zorder=4)
