"""Measures of transfer, computed from learning curves.

Weak transfer ignores the steps spent on source tasks. Strong transfer charges them, so that both
arms are compared at the same total number of steps (``charge_source``).

Sources: Taylor and Stone, "Transfer learning for reinforcement learning domains: a survey", JMLR
10, 2009; Narvekar et al., "Curriculum learning for reinforcement learning domains: a framework and
survey", JMLR 21(181), 2020.
"""

from __future__ import annotations

import numpy as np

from curricle.array_types import FloatArray
from curricle.errors import SettingError
from curricle.statistics.curves import Curve, require_no_source, require_pair


def jumpstart(baseline: Curve, transfer: Curve, *, strong: bool = False) -> FloatArray:
    """Return how much better transfer starts than learning from scratch (Taylor and Stone 2009).

    transfer_k(steps_0) - baseline_k(steps_0 + c_k), with c_k = 0 if weak and source_steps_k if
    strong: the baseline has then learnt for as many steps as the sources took.

    Parameters
    ----------
    baseline, transfer : Curve
        The same K seeds and T checkpoints.
    strong : bool
        Whether to charge the source steps.

    Returns
    -------
    (K,) float64
        Return, seed by seed; NaN if the source steps exceed the baseline's curve, which is linearly
        interpolated between checkpoints.

    Raises
    ------
    SettingError
        If the curves do not pair, or if strong and `baseline` has source steps.

    Examples
    --------
    >>> steps = np.array([0, 100, 200])
    >>> scratch = Curve(steps, np.array([[0.0, 1.0, 5.0]]))
    >>> helped = Curve(steps, np.array([[4.0, 5.0, 5.0]]), np.array([150]))
    >>> jumpstart(scratch, helped), jumpstart(scratch, helped, strong=True)
    (array([4.]), array([1.]))
    """
    require_pair(baseline, transfer)
    first, rows = transfer.filled()[:, 0], baseline.filled()
    by_then: FloatArray = rows[:, 0]
    if strong:
        require_no_source(baseline)
        start = transfer.steps[0] + transfer.source_steps
        pairs = zip(start, rows, strict=True)
        by_then = np.array([np.interp(x, baseline.steps, row, right=np.nan) for x, row in pairs])
    return np.subtract(first, by_then)


def asymptotic_performance(curve: Curve, *, fraction: float = 0.1) -> FloatArray:
    """Return the mean return over the last checkpoints, (K,) (Taylor and Stone 2009).

    mean(values_{T - n}, ..., values_{T - 1}), n = fraction T rounded, at least 1. For strong
    transfer pass ``charge_source(baseline, transfer)``.

    Parameters
    ----------
    curve : Curve
    fraction : float
        Share of the checkpoints, above 0 and at most 1.

    Raises
    ------
    SettingError
        If `fraction` is out of range.

    Examples
    --------
    >>> asymptotic_performance(Curve(np.array([0, 1, 2]), np.array([[0.0, 3.0, 5.0]])))
    array([5.])
    """
    if not 0 < fraction <= 1:
        raise SettingError(f"fraction must be above 0 and at most 1: got {fraction}")
    last = max(1, round(fraction * curve.steps.size))
    mean: FloatArray = curve.filled()[:, -last:].mean(axis=1)
    return mean


def mean_return(curve: Curve) -> FloatArray:
    """Return the normalised area under the learning curve, (K,), in return.

    (area from the first to the last checkpoint) / (steps between them), by the trapezoid rule: the
    total reward of Taylor and Stone (2009) divided by the steps. For strong transfer pass
    ``charge_source(baseline, transfer)``.

    Raises
    ------
    SettingError
        If the curve has a single checkpoint.

    Examples
    --------
    >>> mean_return(Curve(np.array([0, 100, 400]), np.array([[0.0, 4.0, 4.0]])))
    array([3.5])
    """
    if curve.steps.size < 2:
        raise SettingError(f"an area needs at least 2 checkpoints: got {curve.steps.size}")
    area = np.asarray(np.trapezoid(curve.filled(), curve.steps, axis=1), dtype=np.float64)
    return area / float(curve.steps[-1] - curve.steps[0])
