"""Times to threshold when some seeds never arrive: nothing is dropped, nothing made up.

A seed that did not reach the threshold has a time known only to exceed the steps for which it was
followed. Leaving it out flatters the arm, and so does taking those steps for its time. The
Kaplan-Meier curve uses it for as long as it was followed.

Sources: Kaplan and Meier, "Nonparametric estimation from incomplete observations", Journal of the
American Statistical Association 53, 1958; Efron, "Censored data and the bootstrap", Journal of the
American Statistical Association 76, 1981.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.checks import number
from curricle.errors import SettingError
from curricle.statistics.intervals import Interval, bootstrap, draw_counts, percentiles
from curricle.statistics.thresholds import Times

__all__ = ["Survival", "median_time", "restricted_mean_time", "survival"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

ROUNDING = 1e-9
"""How far products of shares may be from the fraction they stand for."""


@dataclass(frozen=True, eq=False)
class Survival:
    """The share of seeds not yet at a threshold, as a falling staircase.

    Attributes
    ----------
    steps : (L,) float64
        The L different steps at which a seed reached the threshold or was followed no longer,
        increasing.
    share : (L,) float64
        Share not yet there from these steps on, until the next; before the first it is 1.

    Examples
    --------
    >>> survival(Times(np.array([200.0, 900.0]), np.array([True, False])))
    Survival(steps=array([200., 900.]), share=array([0.5, 0.5]))
    """

    steps: FloatArray
    share: FloatArray


def survival(times: Times) -> Survival:
    """Return the Kaplan-Meier curve of times to a threshold.

    share(t) = prod_{t_i <= t} (1 - d_i / n_i), with d_i seeds arriving at t_i out of n_i still
    followed and not there just before. A seed left at t_i counts among n_i.

    Parameters
    ----------
    times : Times
        Of K seeds. What ended the following must not depend on how a seed did, as a budget of
        steps does not.

    Returns
    -------
    Survival
        Steps (L,) and share (L,), L at most K.

    References
    ----------
    Kaplan and Meier 1958.

    Examples
    --------
    >>> reached = np.array([True, False, True, True])
    >>> survival(Times(np.array([100.0, 200.0, 300.0, 300.0]), reached))
    Survival(steps=array([100., 200., 300.]), share=array([0.75, 0.75, 0.  ]))
    """
    ends, shares = _curves(times, np.ones((1, times.steps.size), dtype=np.int64))
    share = shares[0]
    ends.setflags(write=False)
    share.setflags(write=False)
    return Survival(ends, share)


def median_time(
    times: Times, *, confidence: float = 0.95, resamples: int = 2000, seed: int = 0
) -> Interval:
    """Return the median time to a threshold with its bootstrap interval, censored seeds included.

    min {t : share(t) <= 1/2} of the Kaplan-Meier curve, infinite where it never falls so low.

    Parameters
    ----------
    times : Times
        Of K seeds; each is resampled together with whether it arrived.
    confidence, resamples, seed
        As in :func:`bootstrap`.

    Returns
    -------
    Interval
        Steps. The estimate is infinite where fewer than half the seeds arrived, a bound where that
        is so in enough resamples. All are times at which a seed arrived, or infinite.

    Raises
    ------
    SettingError
        If a setting makes no sense.

    References
    ----------
    Efron 1981.

    Examples
    --------
    >>> reached = np.array([True, True, True, False])
    >>> print(median_time(Times(np.array([100.0, 200.0, 300.0, 500.0]), reached)))
    200 [100, inf], 4 seeds
    """
    seeds = times.steps.size
    counts = draw_counts([seeds], resamples, seed)
    estimate = _medians(times, np.ones((1, seeds), dtype=np.int64))[0]
    return percentiles(estimate, _medians(times, counts), confidence, seeds, "inverted_cdf")


def restricted_mean_time(
    times: Times,
    horizon: float,
    *,
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Interval:
    """Return the mean time to a threshold within a horizon, with its bootstrap interval.

    mean_k min(time_k, horizon), the area under the Kaplan-Meier curve up to the horizon.

    Parameters
    ----------
    times : Times
        Of K seeds.
    horizon : float
        Steps, above 0. No further than every seed was followed, so that each minimum is known;
        arms are comparable only within the same horizon.
    confidence, resamples, seed
        As in :func:`bootstrap`.

    Returns
    -------
    Interval
        Steps.

    Raises
    ------
    SettingError
        If `horizon` exceeds the time at which a seed was censored, or a setting makes no sense.

    References
    ----------
    Royston and Parmar, BMC Medical Research Methodology 13:152, 2013.

    Examples
    --------
    >>> times = Times(np.array([200.0, 400.0, 900.0]), np.array([True, True, False]))
    >>> print(restricted_mean_time(times, 600.0))
    400 [200, 600], 3 seeds
    """
    if number("horizon", horizon, SettingError) <= 0:
        raise SettingError(f"horizon must be above 0 steps: got {horizon:g}")
    short = ~times.reached & (times.steps < horizon)
    if short.any():
        place = int(np.argmax(short))
        raise SettingError(
            f"horizon must not exceed the steps a seed was followed: got {horizon:g},"
            f" seed {place} was left at {times.steps[place]:g} without having arrived"
        )
    within = np.minimum(times.steps, horizon)
    return bootstrap(within, confidence=confidence, resamples=resamples, seed=seed)


def _curves(times: Times, counts: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return steps (L,) and one curve (R, L) for each row of seeds' counts (R, K)."""
    ends, place = np.unique(times.steps, return_inverse=True)
    left = place[:, np.newaxis] == np.arange(ends.size)
    leaving = counts @ left
    arriving = counts @ (left & times.reached[:, np.newaxis])
    followed = np.cumsum(leaving[:, ::-1], axis=1)[:, ::-1]
    return ends, np.cumprod(1 - arriving / np.maximum(followed, 1), axis=1)


def _medians(times: Times, counts: IntArray) -> FloatArray:
    """Return the median time (R,) for each row of seeds' counts (R, K)."""
    ends, shares = _curves(times, counts)
    half = np.pad(shares <= 0.5 + ROUNDING, ((0, 0), (0, 1)), constant_values=True)
    medians: FloatArray = np.append(ends, np.inf)[half.argmax(axis=1)]
    return medians
