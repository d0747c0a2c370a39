"""Time to threshold: how many steps a learner needed to become good enough.

A seed that never reaches the threshold is censored, not dropped: it is kept with the steps for
which it was followed. The thresholds themselves are here too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.errors import SettingError
from curricle.planning.target import part_of_the_way
from curricle.statistics.curves import Curve, require_pair, smooth

__all__ = ["Times", "fraction_of_optimum", "midpoint", "steps_saved", "time_to_threshold"]

BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Times:
    """The steps each seed took to a threshold, with the seeds that never got there kept.

    Attributes
    ----------
    steps : (K,) float64
        Steps to the threshold; for a seed that never reached it, the steps for which it was
        followed, so that its true time is at least that (right-censored).
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

    def __post_init__(self) -> None:
        steps = np.array(self.steps, dtype=np.float64)
        reached = np.array(self.reached, dtype=np.bool_)
        if steps.ndim != 1 or steps.size == 0 or steps.shape != reached.shape:
            raise SettingError(
                "steps and reached must both have shape (K,) with K at least 1:"
                f" got {steps.shape} and {reached.shape}"
            )
        wrong = ~(np.isfinite(steps) & (steps >= 0))
        if wrong.any():
            seed = int(np.argmax(wrong))
            raise SettingError(
                f"steps must be finite and at least 0: seed {seed} has {steps[seed]}"
            )
        steps.setflags(write=False)
        reached.setflags(write=False)
        object.__setattr__(self, "steps", steps)
        object.__setattr__(self, "reached", reached)

    def restricted_mean(self) -> float:
        """Return the restricted mean time to threshold, in steps.

        mean_k min(time_k, steps for which seed k was followed). It equals the mean time when
        every seed reached the threshold and is a lower bound of it otherwise.

        References
        ----------
        Royston and Parmar, "Restricted mean survival time", BMC Medical Research Methodology
        13:152, 2013.

        Examples
        --------
        >>> Times(np.array([200.0, 900.0]), np.array([True, False])).restricted_mean()
        550.0
        """
        return float(self.steps.mean())

    def __str__(self) -> str:
        seeds, missed = self.reached.size, int(np.sum(~self.reached))
        of_seeds = f"{seeds} seed{'s' if seeds > 1 else ''}"
        text = f"{self.restricted_mean():,.0f} steps"
        if missed == 0:
            return f"{text} ({of_seeds})"
        return f"at least {text} ({missed} of {of_seeds} never reached it)"


def midpoint(curve: Curve, *, window: int = 1, after: int = 0) -> float:
    """Return the threshold midway between a curve's lowest and highest value.

    (min_t m_t + max_t m_t) / 2, m the mean over seeds of the smoothed curve.

    Parameters
    ----------
    curve : Curve
        Usually the direct learner's.
    window : int
        Checkpoints to smooth over.
    after : int
        Steps; earlier checkpoints do not count. An untrained table breaks all its ties at random,
        which can be far worse than anything that follows.

    Returns
    -------
    float
        Return.

    Raises
    ------
    SettingError
        If `window` or `after` does not fit the curve.

    Notes
    -----
    A seed's leading NaN are read as its first measured value, so that the mean is always over
    the same seeds. Source: the paper, figure 3 (with a window of 10).

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
    """Return the threshold a fraction of the way from the worst return to the optimum.

    worst + fraction (optimum - worst), which means the same for negative returns as for positive.

    Parameters
    ----------
    optimum, worst : float
        Return of the optimal policy and of the yardstick that counts as nothing learnt.
    fraction : float
        From 0 to 1; 1 gives the optimum exactly.

    Returns
    -------
    float
        Return.

    Raises
    ------
    SettingError
        If an argument is not finite, `worst` exceeds `optimum` or `fraction` is not in [0, 1].

    Examples
    --------
    >>> fraction_of_optimum(optimum=-10.0, worst=-50.0, fraction=0.75)
    -20.0
    """
    if not (np.isfinite(optimum) and np.isfinite(worst) and worst <= optimum):
        raise SettingError(f"worst must be finite and at most optimum: got {worst} and {optimum}")
    if not 0 <= fraction <= 1:
        raise SettingError(f"fraction must be from 0 to 1: got {fraction}")
    return part_of_the_way(optimum, worst, fraction)


def time_to_threshold(
    curve: Curve, threshold: float, *, window: int = 1, strong: bool = False
) -> Times:
    """Return the steps each seed took until its smoothed value first reached a threshold.

    min {steps_t : smooth_t >= threshold}, plus the source steps if strong. A seed that never
    reaches it is censored at the last checkpoint (plus its source steps if strong), not dropped.

    Parameters
    ----------
    curve : Curve
        K seeds, T checkpoints.
    threshold : float
        Return.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to charge the source steps.

    Returns
    -------
    Times
        Steps (K,) and reached (K,).

    Raises
    ------
    SettingError
        If `threshold` is not finite or `window` does not fit the curve.

    References
    ----------
    Narvekar et al., JMLR 21(181), 2020; Taylor and Stone, JMLR 10, 2009.

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
    """Return the steps to threshold that transfer saved, seed by seed.

    time_to_threshold(baseline)_k - time_to_threshold(transfer)_k.

    Parameters
    ----------
    baseline, transfer : Curve
        The same K seeds and T checkpoints.
    threshold : float
        Return.
    window : int
        Checkpoints to smooth over.
    strong : bool
        Whether to charge the source steps.

    Returns
    -------
    (K,) float64
        Steps; negative where transfer cost more than it saved.

    Raises
    ------
    SettingError
        If the curves do not pair, or as :func:`time_to_threshold` does.

    Notes
    -----
    Where only the baseline is censored the true saving is at least this; where only transfer is,
    at most this. Where both are, this is 0, or if strong minus the source steps.

    Examples
    --------
    >>> steps = np.array([0, 100, 200])
    >>> direct = Curve(steps, np.array([[0.0, 1.0, 5.0]]))
    >>> helped = Curve(steps, np.array([[5.0, 5.0, 5.0]]), np.array([150]))
    >>> steps_saved(direct, helped, 5.0), steps_saved(direct, helped, 5.0, strong=True)
    (array([200.]), array([50.]))
    """
    require_pair(baseline, transfer)
    without = time_to_threshold(baseline, threshold, window=window, strong=strong)
    with_transfer = time_to_threshold(transfer, threshold, window=window, strong=strong)
    return without.steps - with_transfer.steps
