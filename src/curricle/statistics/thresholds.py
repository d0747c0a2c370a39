"""Thresholds, and the steps that a learner takes to reach them.

A seed that never reaches the threshold is censored, not dropped: its time is known only to exceed
its observed steps. Leaving it out, or taking these steps as its time, would favour the arm.

Sources: Kaplan and Meier, Journal of the American Statistical Association 53, 1958; Royston and
Parmar, "Restricted mean survival time", BMC Medical Research Methodology 13:152, 2013; Thompson,
Annals of Mathematical Statistics 7, 1936; Narvekar et al., JMLR 21(181), 2020; Taylor and Stone,
JMLR 10, 2009.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, frozen
from curricle.checks import number
from curricle.display import printed
from curricle.errors import SettingError
from curricle.statistics.curves import Curve, require_pair, smooth
from curricle.statistics.intervals import (
    CONFIDENCE,
    Interval,
    check_confidence,
    check_each,
    mean_interval,
)
from curricle.text import brief_repr

ROUNDING = 1e-9  # difference of a product of shares from the fraction that it stands for, at most


@dataclass(frozen=True, eq=False)
class Times(Frozen):
    """The steps of each seed to a threshold, censored seeds included.

    Attributes
    ----------
    steps : (K,) float64
        Steps to the threshold; of a seed that never reached it, its observed steps, which its true
        time exceeds (right-censored).
    reached : (K,) bool
        Whether the seed reached the threshold.

    Raises
    ------
    SettingError
        If the shapes differ or a time is negative or not finite.

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
        steps = np.array(self.steps, dtype=np.float64)
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

    def survival(self) -> Any:
        """Return the share of seeds that are not yet at the threshold, by Kaplan and Meier.

        share(t) = prod_{t_i <= t} (1 - d_i / n_i), where d_i seeds reach the threshold at t_i and
        n_i are observed until then and have not reached it before. The end of a seed's observation
        must not depend on its returns, as a budget of steps does not.

        Returns
        -------
        EmpiricalDistributionFunction
            Of ``scipy.stats.ecdf``: ``quantiles`` (L,) are steps, ``probabilities`` (L,) the shares
            from these steps on. It has ``plot`` and ``confidence_interval``.

        Examples
        --------
        >>> reached = np.array([True, False, True, True])
        >>> curve = Times(np.array([100.0, 200.0, 300.0, 300.0]), reached).survival()
        >>> curve.quantiles, curve.probabilities
        (array([100., 200., 300.]), array([0.75, 0.75, 0.  ]))
        """
        from scipy.stats import CensoredData, ecdf  # half a second that few need

        return ecdf(CensoredData.right_censored(self.steps, ~self.reached)).sf

    def median(self, *, confidence: float = CONFIDENCE) -> Interval:
        """Return the median time with the interval of the sign test, in steps.

        The estimate is min {t : share(t) <= 1/2} of :meth:`survival`, infinite if the share stays
        above. The bounds are the two order statistics of the times between which the median lies
        with at least the stated probability, whatever the distribution (Thompson 1936). A censored
        time counts as its observed steps for the lower bound and as infinite for the upper bound.
        Five seeds or fewer bound no median at 95 %: from 0 to infinity.

        Examples
        --------
        >>> reached = np.array([True] * 7 + [False])
        >>> print(Times(np.arange(1.0, 9.0) * 100, reached).median())
        400 [100, inf], 8 seeds
        """
        from scipy.stats import quantile_test  # half a second that few need

        check_confidence(confidence)
        k = self.steps.size
        if k == 1:
            return Interval(self._median(), np.nan, np.nan, confidence, 1)
        latest = np.where(self.reached, self.steps, np.inf)
        low = quantile_test(self.steps).confidence_interval(confidence).low
        high = quantile_test(latest).confidence_interval(confidence).high
        if np.isnan(low):  # too few seeds
            low, high = 0.0, np.inf
        return Interval(self._median(), float(low), float(high), confidence, k)

    def restricted_mean(
        self, horizon: float | None = None, *, confidence: float = CONFIDENCE
    ) -> Interval:
        """Return the mean time within a horizon with Student's interval, in steps.

        mean_k min(time_k, horizon), which is the area under :meth:`survival` up to the horizon.
        By default a seed counts with its observed steps: the mean time if all seeds reached the
        threshold, else a lower bound of it, with infinity as the upper bound. The bounds are
        clipped to 0 and the horizon.

        Parameters
        ----------
        horizon : float, optional
            Above 0, at most the observed steps of any censored seed, or SettingError. Arms are
            comparable only within the same horizon.
        confidence : float
            Between 0 and 1.

        Examples
        --------
        >>> times = Times(np.array([200.0, 400.0, 900.0]), np.array([True, True, False]))
        >>> print(times.restricted_mean(600.0))
        400 [0, 600], 3 seeds
        """
        within = self.steps
        if horizon is not None:
            if number("horizon", horizon, SettingError) <= 0:
                raise SettingError(f"horizon must be above 0 steps: got {horizon:g}")
            short = ~self.reached & (self.steps < horizon)
            if short.any():
                place = int(np.argmax(short))
                raise SettingError(
                    f"horizon must not exceed the observed steps of a censored seed: got"
                    f" {horizon:g}, seed {place} was censored at {self.steps[place]:g}"
                )
            within = np.minimum(self.steps, horizon)
        mean = mean_interval(within, confidence=confidence)
        low, high = np.clip([mean.low, mean.high], 0.0, horizon)
        if horizon is None and not self.reached.all() and not np.isnan(high):
            high = np.inf
        return Interval(mean.estimate, float(low), float(high), confidence, mean.n)

    def _median(self) -> float:
        curve = self.survival()
        half = curve.probabilities <= 0.5 + ROUNDING
        return float(curve.quantiles[half.argmax()]) if half.any() else np.inf

    def __str__(self) -> str:
        seeds, missed = self.reached.size, int(np.sum(~self.reached))
        of_seeds = f"{seeds} seed{'s' if seeds > 1 else ''}"
        text = f"{self.steps.mean():,.0f} steps"
        if missed == 0:
            return f"{text} ({of_seeds})"
        return f"at least {text} ({missed} of {of_seeds} never reached it)"


def midpoint(curve: Curve, *, window: int = 1, after: int = 0) -> float:
    """Return the threshold midway between a curve's lowest and highest value (paper, figure 3).

    (min_t m_t + max_t m_t) / 2, where m is the mean over seeds of the :meth:`Curve.filled` and
    smoothed curve.

    Parameters
    ----------
    curve : Curve
        Usually that of learning from scratch.
    window : int
        Checkpoints to smooth over; 10 in the paper.
    after : int
        Steps; earlier checkpoints do not count. An untrained table breaks all its ties at random,
        which can be far worse than anything later.

    Raises
    ------
    SettingError
        If `window` or `after` does not fit the curve.

    Examples
    --------
    >>> midpoint(Curve(np.array([0, 100]), np.array([[-9.0, -1.0], [-7.0, -3.0]])))
    -5.0
    """
    counted = curve.steps >= after
    if not counted.any():
        raise SettingError(
            f"after must not exceed the last checkpoint, {curve.steps[-1]}: got {after}"
        )
    mean = smooth(curve.filled(), window).mean(axis=0)[counted]
    return float((mean.min() + mean.max()) / 2)


def fraction_of_optimum(optimum: float, worst: float, fraction: float) -> float:
    """Return worst + fraction (optimum - worst); a fraction of 1 gives the optimum exactly."""
    if not (np.isfinite(optimum) and np.isfinite(worst) and worst <= optimum):
        raise SettingError(f"worst must be finite and at most optimum: got {worst} and {optimum}")
    if not 0 <= fraction <= 1:
        raise SettingError(f"fraction must be from 0 to 1: got {fraction}")
    return float(optimum - (1 - fraction) * (optimum - worst))


def time_to_threshold(
    curve: Curve, threshold: float, *, window: int = 1, strong: bool = False
) -> Times:
    """Return the steps of each seed until its smoothed value first reaches a threshold.

    min {steps_t : smooth_t >= threshold}, plus the source steps if strong. A seed that never
    reaches it is censored at the last checkpoint (plus its source steps if strong).

    Parameters
    ----------
    curve : Curve
    threshold : float
        Return.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to charge the source steps.

    Raises
    ------
    SettingError
        If `threshold` is not finite or `window` does not fit the curve.

    Examples
    --------
    >>> curve = Curve(np.array([0, 100, 200]), np.array([[0.0, 5.0, 9.0], [0.0, 1.0, 2.0]]))
    >>> time_to_threshold(curve, 5.0)
    Times(steps=array([100., 200.]), reached=array([ True, False]))
    """
    if not np.isfinite(threshold):
        raise SettingError(f"threshold must be a finite return: got {threshold}")
    above = smooth(curve.values, window) >= threshold
    reached = np.asarray(above.any(axis=1))
    place = np.where(reached, above.argmax(axis=1), curve.steps.size - 1)
    steps = curve.steps[place] + (curve.source_steps if strong else 0)
    return Times(steps.astype(np.float64), reached)


def steps_saved(
    baseline: Curve, transfer: Curve, threshold: float, *, window: int = 1, strong: bool = False
) -> FloatArray:
    """Return the steps to threshold that transfer saves, (K,).

    time_to_threshold(baseline)_k - time_to_threshold(transfer)_k. Where only the baseline is
    censored the true saving is at least this; where only transfer is, at most this. Where both are,
    it is 0, or minus the source steps if strong. SettingError if the curves do not pair, or as of
    :func:`time_to_threshold`.

    Examples
    --------
    >>> steps = np.array([0, 100, 200])
    >>> scratch = Curve(steps, np.array([[0.0, 1.0, 5.0]]))
    >>> helped = Curve(steps, np.array([[5.0, 5.0, 5.0]]), np.array([150]))
    >>> steps_saved(scratch, helped, 5.0), steps_saved(scratch, helped, 5.0, strong=True)
    (array([200.]), array([50.]))
    """
    require_pair(baseline, transfer)
    without = time_to_threshold(baseline, threshold, window=window, strong=strong)
    with_transfer = time_to_threshold(transfer, threshold, window=window, strong=strong)
    return without.steps - with_transfer.steps
