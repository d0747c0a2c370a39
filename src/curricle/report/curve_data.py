"""The learning curves of a page as data for its script."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.scale import SymmetricalLogTransform

from curricle.array_types import FloatArray, IntArray
from curricle.comparison.comparison import Comparison
from curricle.plotting.learning_curves import (
    controls_first,
    places,
    random_level,
    shown_curve,
)
from curricle.plotting.scales import minus
from curricle.plotting.styles import ArmStyle
from curricle.statistics.intervals import mean_interval

MOST_CHECKPOINTS = 400
"""Checkpoints of a mean that a page holds."""
MOST_SEEDS, MOST_SEED_VALUES = 100, 60_000
"""Seeds of an arm that a page shows, and the values of all of them that it holds at most."""
SEEN, SEEN_NEAR_ZERO = 4000, 100
"""Values are rounded to this share of a linear axis, or of the linear part of a symlog axis."""

Data = dict[str, Any]


def curve_data(
    comparison: Comparison, styles: Mapping[str, ArmStyle], panels: Mapping[str, Axes]
) -> Data:
    """Return what the script of a page draws curves from, as data for JSON.

    Returns are whole numbers of 10^-digits, and each row of numbers holds its first one, then
    differences, so that the text is short. None stands for a bound that does not exist.

    Parameters
    ----------
    comparison : Comparison
    styles : dict of str to ArmStyle
    panels : dict of str to Axes
        The drawn panels "weak" and "strong", whose scales the script takes.

    Returns
    -------
    dict
        ``digits``; ``threshold`` and its words; ``random``, the return while sources are trained;
        ``symlog``, the return up to which its axis is linear and Matplotlib's ``linscale``, or
        None; ``panels``, the limits of each; ``steps`` (T,) and ``seed_steps`` (T',); ``arms`` in
        the order of drawing: for each panel the place of its first step, mean, low and high; for
        each seed its ``source_steps``, and in ``seeds`` its returns over target steps.

    Examples
    --------
    >>> from curricle.comparison.arms import Arm
    >>> from curricle.plotting.learning_curves import draw_learning_curves
    >>> from curricle.plotting.styles import arm_styles
    >>> from curricle.statistics.curves import Curve
    >>> steps, rising = np.array([0, 50, 100]), np.array([[0.0, 1, 2], [0, 3, 4]])
    >>> arms = {"scratch": Arm(Curve(steps, rising), rising, rising, False)}
    >>> one = Comparison("hunt", arms, 100, 100, 1.0, 1)
    >>> weak, strong = (figure.axes[0] for figure in draw_learning_curves(one))
    >>> found = curve_data(one, arm_styles(one), {"weak": weak, "strong": strong})
    >>> found["steps"], found["digits"], found["arms"][0]["weak"]["mean"]
    ([0, 50, 50], 3, [0, 2000, 1000])
    """
    scale = panels["strong"].yaxis.get_transform()
    symlog = None
    if isinstance(scale, SymmetricalLogTransform):
        symlog = [float(scale.linthresh), float(scale.linscale)]
    low, high = panels["strong"].get_ylim()
    seen = symlog[0] / SEEN_NEAR_ZERO if symlog else (high - low) / SEEN
    digits = max(0, math.ceil(-math.log10(seen)))
    steps = comparison.scratch.curve.steps
    seeds = min(comparison.seeds, MOST_SEEDS)
    kept, kept_of_seeds = _kept(comparison, seeds)
    return {
        "digits": digits,
        "threshold": comparison.threshold,
        "threshold_words": minus(f"{comparison.threshold:.4g}"),
        "random": random_level(comparison),
        "symlog": symlog,
        "panels": {
            name: {"x": list(axes.get_xlim()), "y": list(axes.get_ylim())}
            for name, axes in panels.items()
        },
        "steps": _differences(steps[kept]),
        "seed_steps": _differences(steps[kept_of_seeds]),
        "arms": [
            {
                "name": name,
                "colour": style.colour,
                "dashes": style.svg_dashes,
                "control": style.control,
                **{panel: _band(comparison, name, panel, kept, digits) for panel in panels},
                "source_steps": comparison[name].curve.source_steps[:seeds].tolist(),
                "seeds": [
                    _numbers(row, digits)
                    for row in comparison[name].curve.filled()[:seeds, kept_of_seeds]
                ],
            }
            for name, style in controls_first(styles)
        ],
    }


def _kept(comparison: Comparison, seeds: int) -> tuple[IntArray, IntArray]:
    """Return the places of the checkpoints that are kept of means and of seeds."""
    steps = comparison.scratch.curve.steps
    begins = [shown_curve(comparison, name, strong=True)[1] for name in comparison.arms]
    budget = int(np.searchsorted(steps, comparison.budget, side="right")) - 1
    means = np.union1d(places(len(steps), MOST_CHECKPOINTS), [*begins, budget])
    most = max(2, MOST_SEED_VALUES // (seeds * len(comparison.arms)))
    return means, places(len(steps), min(most, MOST_CHECKPOINTS))


def _band(comparison: Comparison, name: str, panel: str, kept: IntArray, digits: int) -> Data:
    """Return the mean of an arm in a panel with its bounds, from the first of its places."""
    curve, begin = shown_curve(comparison, name, strong=panel == "strong")
    own = kept[(kept >= begin) & (kept < begin + len(curve.steps))]
    band = mean_interval(curve.filled()[:, own - begin], confidence=comparison.confidence)
    rows = {"mean": band.estimate, "low": band.low, "high": band.high}
    first = int(np.searchsorted(kept, begin))
    return {"first": first} | {key: _numbers(np.asarray(row), digits) for key, row in rows.items()}


def _numbers(values: FloatArray, digits: int) -> list[int | None]:
    """Return numbers as differences of whole numbers of 10^-digits; None for NaN.

    Examples
    --------
    >>> _numbers(np.array([0.5, np.nan, 0.75]), 2)
    [50, None, 25]
    """
    known = ~np.isnan(values)
    whole = np.round(values[known] * 10**digits).astype(np.int64)
    found: list[int | None] = [None] * len(values)
    for place, difference in zip(np.flatnonzero(known), _differences(whole), strict=True):
        found[place] = difference
    return found


def _differences(numbers: IntArray) -> list[int]:
    """Return the first number, then the difference of each from the one before."""
    found: list[int] = np.diff(numbers, prepend=0).tolist()
    return found
