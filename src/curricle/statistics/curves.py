"""Learning curves, returns at checkpoints with a row per seed, and measures of transfer and time.

Weak transfer ignores the steps in source tasks; strong transfer charges them (``charge_source``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import number, numbers
from curricle.errors import SettingError
from curricle.statistics.intervals import (
    Interval,
    check_each,
    mean_interval,
)
from curricle.text import brief_repr, printed

SCRATCH = "scratch"  # the arm that learns the target alone, with which others are compared
ROUNDING = 1e-7  # relative difference that rounding causes between two exact mean returns


@dataclass(frozen=True, eq=False)
class Curve(Frozen):
    """The learning curves of an arm, copied and frozen; SettingError on invalid arrays.

    Attributes
    ----------
    steps : (T,) int64
        Checkpoints in target steps, from 0 or later, increasing.
    values : (K, T) float64
        Unshaped return at the checkpoints. A seed's row is NaN before its first episode has ended:
        NaN reaches no threshold, and elsewhere the first measured value replaces it.
    source_steps : (K,) int64
        Steps in source tasks before the first target step; a single number holds for all seeds.

    Examples
    --------
    >>> Curve(np.array([0, 100, 200]), np.array([[np.nan, -4.0, -1.0]])).filled()
    array([[-4., -4., -1.]])
    """

    steps: IntArray
    values: FloatArray
    source_steps: IntArray = field(default_factory=lambda: np.zeros((), dtype=np.int64))

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        whole = list[IntArray]()
        for name in ("steps", "source_steps"):
            if (counts := np.asarray(getattr(self, name))).dtype.kind not in "iu":
                raise SettingError(f"{name} must be integers: got dtype {counts.dtype}")
            whole.append(counts.astype(np.int64))
        steps, source = whole
        if steps.ndim != 1 or steps.size == 0:
            raise SettingError(f"steps must have shape (T,) with T at least 1: got {steps.shape}")
        if steps[0] < 0:
            raise SettingError(f"steps must be at least 0: checkpoint 0 is {steps[0]}")
        if (wrong := np.flatnonzero(np.diff(steps) <= 0)).size:
            before, place = steps[wrong[0]], wrong[0] + 1
            raise SettingError(
                f"steps must be increasing: checkpoint {place} is {steps[place]} after {before}"
            )
        values = numbers("values", self.values, SettingError)
        if values.ndim != 2 or values.shape[0] == 0 or values.shape[1] != steps.size:
            raise SettingError(
                f"values must have shape (K, {steps.size}) with K at least 1: got {values.shape}"
            )
        missing = np.isnan(values)
        leading = np.logical_and.accumulate(missing, axis=1)
        leading[:, -1] = False  # the last checkpoint is always measured
        for rule, broken in (
            ("values must not be infinite", np.isinf(values)),
            ("values may be NaN only before a seed's first measurement", missing & ~leading),
        ):
            for k, t in np.argwhere(broken)[:1]:
                raise SettingError(f"{rule}: seed {k}, checkpoint {t} is {values[k, t]}")
        if source.ndim != 0 and source.shape != values.shape[:1]:
            raise SettingError(
                f"source_steps must have shape ({values.shape[0]},), one per seed:"
                f" got {source.shape}"
            )
        if np.any(source < 0):
            raise SettingError(f"source_steps must be at least 0: got {source.min()}")
        source = np.array(np.broadcast_to(source, values.shape[:1]))
        for name, array in (("steps", steps), ("values", values), ("source_steps", source)):
            object.__setattr__(self, name, frozen(array))

    @classmethod
    def of(cls, result: Any, source_steps: npt.ArrayLike = 0) -> Curve:
        """Return the greedy returns of a :class:`LearningResult` as a curve."""
        return cls(result.steps, result.greedy_return, np.asarray(source_steps))

    def filled(self) -> FloatArray:
        """Return the values with a seed's first measured value in place of its NaN, (K, T)."""
        missing = np.isnan(self.values)
        first = np.take_along_axis(self.values, missing.sum(axis=1, keepdims=True), axis=1)
        return np.where(missing, first, self.values)


def smooth(values: FloatArray, window: int) -> FloatArray:
    """Return the trailing mean of each row over the last `window` checkpoints; NaN stays."""
    mean = values.copy()
    if not 1 <= window <= mean.shape[1] or int(window) != window:
        raise SettingError(
            f"window must be a whole number of checkpoints from 1 to {mean.shape[1]}: got {window}"
        )
    for lag in range(1, int(window)):
        # A running mean, newest first: a constant row stays so, and rounding moves no threshold.
        step = (values[:, :-lag] - mean[:, lag:]) / (lag + 1)
        mean[:, lag:] += np.where(np.isnan(step), 0.0, step)
    return mean


def charge_source(baseline: Curve, transfer: Curve) -> Curve:
    """Return a transfer curve over total steps, source steps included (strong transfer).

    At checkpoint x, seed k has the baseline's first value while x < source_steps_k + steps_0, less
    any gain in area that a baseline would have by beginning later; and then its value at
    x - source_steps_k target steps, interpolated between checkpoints.
    """
    require_pair(baseline, transfer)
    if np.any(baseline.source_steps):
        raise SettingError(
            "the baseline of a strong comparison must have no source steps:"
            f" got {baseline.source_steps.max()}"
        )
    steps, alone = baseline.steps, baseline.filled()
    target = steps - transfer.source_steps[:, np.newaxis]
    training = target < transfer.steps[0]
    late, shifted = (
        np.stack([np.interp(x, steps, row) for x, row in zip(target, rows, strict=True)])
        for rows in (alone, transfer.filled())
    )
    first = np.broadcast_to(alone[:, :1], alone.shape)
    # Where learning falls below its first value, to hold that value is a gift: a baseline begun
    # later has a larger area. The gift is taken off, so that a useless source gains nothing.
    gift = np.trapezoid(np.where(training, first, late) - alone, steps, axis=1).mean()
    if gift > 0:
        first = first - gift / np.trapezoid(1.0 * training, steps, axis=1).mean()
    return Curve(steps, np.where(training, first, shifted))


def require_pair(baseline: Curve, transfer: Curve) -> None:
    """Raise SettingError unless two curves have the same seeds and checkpoints."""
    seeds, theirs = len(baseline.values), len(transfer.values)
    if seeds != theirs:
        raise SettingError(
            "baseline and transfer must hold the same seeds, row by row:"
            f" got {seeds} and {theirs} seeds"
        )
    if not np.array_equal(baseline.steps, transfer.steps):
        ends = [f"{curve.steps.size} ending at {curve.steps[-1]}" for curve in (baseline, transfer)]
        raise SettingError(
            f"baseline and transfer must share their checkpoints: got {' and '.join(ends)}"
        )


def jumpstart(baseline: Curve, transfer: Curve) -> FloatArray:
    """Return how much better transfer starts than learning from scratch (Taylor and Stone 2009).

    transfer_k(steps_0) - baseline_k(steps_0), (K,). SettingError unless both have the same seeds
    and checkpoints.

    Examples
    --------
    >>> steps = np.array([0, 100, 200])
    >>> scratch = Curve(steps, np.array([[0.0, 1.0, 5.0]]))
    >>> helped = Curve(steps, np.array([[4.0, 5.0, 5.0]]))
    >>> jumpstart(scratch, helped)
    array([4.])
    """
    require_pair(baseline, transfer)
    return np.subtract(transfer.filled()[:, 0], baseline.filled()[:, 0])


LAST = 0.1  # of the checkpoints, over which asymptotic performance is the mean


def asymptotic_performance(curve: Curve) -> FloatArray:
    """Return the mean return over the last tenth of the checkpoints, (K,) (Taylor and Stone 2009).

    mean(values_{T - n}, ..., values_{T - 1}), n = T / 10 rounded, at least 1.

    Examples
    --------
    >>> asymptotic_performance(Curve(np.array([0, 1, 2]), np.array([[0.0, 3.0, 5.0]])))
    array([5.])
    """
    last = max(1, round(LAST * curve.steps.size))
    mean: FloatArray = curve.filled()[:, -last:].mean(axis=1)
    return mean


def mean_return(curve: Curve) -> FloatArray:
    """Return the normalised area under the learning curve, (K,), in return.

    (area from the first to the last checkpoint) / (steps between them), by the trapezoid rule: the
    total reward of Taylor and Stone (2009) divided by the steps. SettingError if the curve has a
    single checkpoint.

    Examples
    --------
    >>> mean_return(Curve(np.array([0, 100, 400]), np.array([[0.0, 4.0, 4.0]])))
    array([3.5])
    """
    if curve.steps.size < 2:
        raise SettingError(f"an area needs at least 2 checkpoints: got {curve.steps.size}")
    area = np.asarray(np.trapezoid(curve.filled(), curve.steps, axis=1), dtype=np.float64)
    return area / float(curve.steps[-1] - curve.steps[0])


# -- Thresholds, and the steps that a learner takes to reach them ----------------------------------


@dataclass(frozen=True, eq=False)
class Times(Frozen):
    """The steps of each seed to a threshold; SettingError on invalid arrays.

    A seed that never reaches it is censored, not dropped: its time is known only to exceed its
    observed steps. Leaving it out, or taking these steps as its time, would favour the arm.

    Attributes
    ----------
    steps : (K,) float64
        From 0, finite; the observed steps of a seed that never reached it.
    reached : (K,) bool
        Whether the seed reached the threshold.

    Examples
    --------
    >>> print(Times(np.array([200.0, 900.0]), np.array([True, False])))
    at least 550 steps (1 of 2 seeds never reached it)
    """

    steps: FloatArray
    reached: BoolArray

    __repr__ = brief_repr
    _repr_html_ = printed

    def __post_init__(self) -> None:
        steps = numbers("steps", self.steps, SettingError)
        reached = np.array(self.reached, dtype=np.bool_)
        if steps.ndim != 1 or steps.size == 0 or steps.shape != reached.shape:
            raise SettingError(
                "steps and reached must both have shape (K,) with K at least 1:"
                f" got {steps.shape} and {reached.shape}"
            )
        valid = np.isfinite(steps) & (steps >= 0)
        check_each("steps must be finite and at least 0", valid, steps, "seed")
        for name, array in (("steps", steps), ("reached", reached)):
            object.__setattr__(self, name, frozen(array))

    def restricted_mean(self) -> Interval:
        """Return the mean of the observed steps with Student's interval, from 0 (Royston 2013).

        It is a lower bound, with infinity as the upper bound, unless all seeds reached the
        threshold. Arms are comparable only if they were observed for as many steps.

        Examples
        --------
        >>> times = Times(np.array([200.0, 400.0, 900.0]), np.array([True, True, False]))
        >>> print(times.restricted_mean())
        500 [0, inf], 3 seeds
        """
        mean = mean_interval(self.steps)
        high = mean.high if self.reached.all() or np.isnan(mean.high) else np.inf
        return replace(mean, low=float(np.maximum(mean.low, 0.0)), high=float(high))

    def __str__(self) -> str:
        seeds, missed = self.reached.size, int(np.sum(~self.reached))
        of_seeds = f"{seeds} seed{'s' if seeds > 1 else ''}"
        text = f"{self.steps.mean():,.0f} steps"
        if missed == 0:
            return f"{text} ({of_seeds})"
        return f"at least {text} ({missed} of {of_seeds} never reached it)"


def midpoint(curve: Curve, *, window: int = 1, after: int = 0) -> float:
    """Return the threshold midway between a curve's lowest and highest value (paper, figure 3).

    (min_t m_t + max_t m_t) / 2, where m is the mean over seeds of the :meth:`Curve.filled` curve,
    smoothed over `window` checkpoints (10 in the paper). Checkpoints before the step `after` do not
    count: an untrained table breaks all its ties at random, which can be far worse than anything
    later. SettingError if `window` or `after` does not fit the curve.

    Examples
    --------
    >>> midpoint(Curve(np.array([0, 100]), np.array([[-9.0, -1.0], [-7.0, -3.0]])))
    -5.0
    """
    late = curve.steps >= after
    if not late.any():
        raise SettingError(
            f"after must not exceed the last checkpoint, {curve.steps[-1]}: got {after}"
        )
    mean = smooth(curve.filled(), window).mean(axis=0)[late]
    return float((mean.min() + mean.max()) / 2)


def fraction_of_optimum(optimum: float, worst: float, fraction: float) -> float:
    """Return worst + fraction (optimum - worst); a fraction of 1 gives the optimum exactly."""
    if not (np.isfinite(optimum) and np.isfinite(worst) and worst <= optimum):
        raise SettingError(f"worst must be finite and at most optimum: got {worst} and {optimum}")
    if not 0 <= fraction <= 1:
        raise SettingError(f"fraction must be from 0 to 1: got {fraction}")
    return float(optimum - (1 - fraction) * (optimum - worst))


def time_to_threshold(curve: Curve, threshold: float, *, window: int = 1) -> Times:
    """Return the steps of each seed until its smoothed value first reaches a threshold, a return.

    min {steps_t : smooth_t >= threshold}, the mean of `window` checkpoints. A seed that never
    reaches it is censored at the last checkpoint. SettingError if `threshold` is not finite or
    `window` does not fit the curve.

    Examples
    --------
    >>> curve = Curve(np.array([0, 100, 200]), np.array([[0.0, 5.0, 9.0], [0.0, 1.0, 2.0]]))
    >>> time_to_threshold(curve, 5.0)
    Times(steps=array([100., 200.]), reached=array([ True, False]))
    """
    number("threshold", threshold, SettingError)
    above = smooth(curve.values, window) >= threshold
    reached = np.asarray(above.any(axis=1))
    place = np.where(reached, above.argmax(axis=1), curve.steps.size - 1)
    return Times(curve.steps[place].astype(np.float64), reached)
