"""Which arm is better: profiles, the chance of improvement, tests and their correction.

An interval says how large a difference is, a test whether luck alone would show one like it. Each
test of several raises its own false alarms, which :func:`holm` holds to the rate of one. Arrays
only. A NaN is never dropped in silence: it makes an estimate NaN, and no test can be made of it.

Sources: Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice",
NeurIPS 2021; Fisher, "The design of experiments", 1935; Holm, "A simple sequentially rejective
multiple test procedure", Scandinavian Journal of Statistics 6, 1979.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import overload

import numpy as np
import numpy.typing as npt

from curricle.checks import number, numbers, whole_number
from curricle.errors import SettingError
from curricle.statistics.intervals import Interval, by_task, draw_counts, percentiles, resample

__all__ = ["holm", "performance_profile", "probability_of_improvement", "sign_flip_test"]

FloatArray = npt.NDArray[np.float64]

EXACT = 14
"""The most seeds whose 2^K signs are all counted (16,384)."""


def performance_profile(
    scores: npt.ArrayLike | Sequence[npt.ArrayLike],
    thresholds: npt.ArrayLike,
    *,
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Interval:
    """Return the share of runs that score above each threshold, with stratified bootstrap bands.

    share_l = (number of runs km with x_km > tau_l) / (number of runs), x_km being seed k on task
    m; as in :func:`stratified_bootstrap`, seeds are resampled for each task alone.

    Parameters
    ----------
    scores : (K,) or (K, M) float64 array, or a list or tuple of M arrays (K_m,)
        K seeds of M tasks, in a unit that is comparable across tasks; may be infinite. A NaN
        makes the result NaN.
    thresholds : (L,) float64
        tau, in the unit of the scores.
    confidence, resamples, seed
        As in :func:`bootstrap`.

    Returns
    -------
    Interval
        Arrays (L,) from 0 to 1; the bounds hold for each threshold alone.

    Raises
    ------
    SettingError
        If a shape or setting breaks these rules or a threshold is NaN.

    Notes
    -----
    Where no run or every run is above a threshold, every resample says the same: there the band
    has no width, though the true share may well be inside (0, 1).

    References
    ----------
    Agarwal et al., NeurIPS 2021, section 4.3; Dolan and Moré, Mathematical Programming 91, 2002.

    Examples
    --------
    >>> performance_profile([0.1, 0.4, 0.6, 0.9], [0.0, 0.5, 0.8]).estimate
    array([1.  , 0.5 , 0.25])
    """
    runs, sizes = by_task(scores)
    tau = numbers("thresholds", thresholds, SettingError)
    if tau.ndim != 1 or tau.size == 0:
        raise SettingError(f"thresholds must have shape (L,) with L at least 1: got {tau.shape}")
    if np.isnan(tau).any():
        raise SettingError(
            f"thresholds must be numbers: threshold {np.argmax(np.isnan(tau))} is nan"
        )
    column = runs[:, np.newaxis]
    above = np.where(np.isnan(column), np.nan, column > tau)
    return resample(above, sizes, np.mean, confidence, resamples, seed)


def probability_of_improvement(
    a: npt.ArrayLike,
    b: npt.ArrayLike,
    *,
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Interval:
    """Return the chance that a run of a beats a run of b, with its bootstrap interval.

    P(a > b) + P(a = b) / 2 = mean_ij ([a_i > b_j] + [a_i = b_j] / 2) over all pairs of runs: the
    Mann-Whitney U over the number of pairs. Seeds of both arms are resampled independently.

    Parameters
    ----------
    a, b : (K,) float64
        Any unit, more being better; the arms need not share seeds and may differ in K. May be
        infinite. A NaN makes the result NaN.
    confidence, resamples, seed
        As in :func:`bootstrap`.

    Returns
    -------
    Interval
        Floats from 0 to 1; 1/2 where neither arm is ahead.

    Raises
    ------
    SettingError
        If a shape or setting breaks these rules.

    Notes
    -----
    It says how often, not by how much. Where every run of one arm beats every run of the other the
    interval has no width, since every resample says the same.

    References
    ----------
    Mann and Whitney, Annals of Mathematical Statistics 18, 1947; Agarwal et al., NeurIPS 2021,
    section 4.3.

    Examples
    --------
    >>> print(probability_of_improvement([3.0, 5.0, 7.0, 9.0], [4.0, 5.0, 6.0]))
    0.62 [0.17, 1.00], 3 seeds
    """
    first, second = numbers("a", a, SettingError), numbers("b", b, SettingError)
    for name, arm in (("a", first), ("b", second)):
        if arm.ndim != 1 or arm.size == 0:
            raise SettingError(f"{name} must have shape (K,) with K at least 1: got {arm.shape}")
    row, column = second, first[:, np.newaxis]
    wins = np.where(np.isnan(column) | np.isnan(row), np.nan, (column > row) + (column == row) / 2)
    counts = draw_counts(wins.shape, resamples, seed)
    of_a, of_b = counts[:, : first.size], counts[:, first.size :]
    draws = (of_a @ wins * of_b).sum(axis=1) / wins.size
    return percentiles(wins.mean(), draws, confidence, min(wins.shape))


def sign_flip_test(differences: npt.ArrayLike, *, resamples: int = 10_000, seed: int = 0) -> float:
    """Return the p-value of paired differences whose signs might as well be luck, two-sided.

    p = share of the sign vectors s in {-1, 1}^K with ``|sum_k s_k d_k| >= |sum_k d_k|``. All of
    them are counted for up to 14 seeds; beyond, p = (1 + count) / (1 + resamples) over random ones.

    Parameters
    ----------
    differences : (K,) float64
        Any unit; a_k - b_k of matched seeds.
    resamples : int
        Sign vectors drawn for more than 14 seeds, at least 1.
    seed : int
        Of the draws.

    Returns
    -------
    float
        Above 0 and at most 1; 1 where all differences are 0.

    Raises
    ------
    SettingError
        If a shape or setting breaks these rules or a difference is not finite.

    Notes
    -----
    Under the null hypothesis each difference is as likely as its negative, as it is where the two
    arms are exchangeable. Then P(p <= alpha) <= alpha, whatever the distribution; where only the
    mean is 0 this holds roughly, for many seeds. The least p of few seeds is 2^(1 - K): five cannot
    give one below 0.0625.

    References
    ----------
    Fisher 1935, section 21; Pitman, Supplement to the Journal of the Royal Statistical Society 4,
    1937; Phipson and Smyth, Statistical Applications in Genetics and Molecular Biology 9, 2010.

    Examples
    --------
    >>> sign_flip_test([1.0, 2.0, 3.0, 1.5, 2.5, 0.5])
    0.03125
    """
    array = numbers("differences", differences, SettingError)
    if array.ndim != 1 or array.size == 0:
        raise SettingError(f"differences must have shape (K,) with K at least 1: got {array.shape}")
    wrong = ~np.isfinite(array)
    if wrong.any():
        place = int(np.argmax(wrong))
        raise SettingError(f"differences must be finite: seed {place} has {array[place]}")
    draws = whole_number("resamples", resamples, 1, SettingError)
    slack = 1e-12 * np.abs(array).sum()  # sums that are equal may differ by rounding
    least = abs(array.sum()) - slack
    if array.size <= EXACT:
        return float(np.mean(np.abs(_all_sums(array)) >= least))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(draws, array.size))
    return float((1 + np.sum(np.abs(signs @ array) >= least)) / (1 + draws))


@overload
def holm(p_values: Mapping[str, float]) -> dict[str, float]: ...
@overload
def holm(p_values: npt.ArrayLike) -> FloatArray: ...
def holm(p_values: Mapping[str, float] | npt.ArrayLike) -> dict[str, float] | FloatArray:
    """Return p-values adjusted for how many there are, by Holm's step-down rule.

    adjusted_(i) = max_{j <= i} min(1, (M - j + 1) p_(j)), with p_(1) <= ... <= p_(M). Calling those
    at most alpha significant raises a false alarm anywhere among the M tests with chance at most
    alpha, however the tests depend on each other.

    Parameters
    ----------
    p_values : mapping from name to float, or (M,) float64
        One for each of M tests, from 0 to 1.

    Returns
    -------
    dict from name to float, or (M,) float64
        In the order given.

    Raises
    ------
    SettingError
        If there are no p-values or one is not in [0, 1].

    References
    ----------
    Holm 1979.

    Examples
    --------
    >>> holm({"maze": 0.01, "pursuit": 0.04, "chain": 0.03})
    {'maze': 0.03, 'pursuit': 0.06, 'chain': 0.06}
    """
    if isinstance(p_values, Mapping):
        named = [number(f"p-value of {n}", p, SettingError, 0, 1) for n, p in p_values.items()]
        return dict(zip(p_values, holm(named).tolist(), strict=True))
    array = numbers("p-values", p_values, SettingError)
    if array.ndim != 1 or array.size == 0:
        raise SettingError(f"p-values must have shape (M,) with M at least 1: got {array.shape}")
    wrong = ~((array >= 0) & (array <= 1))
    if wrong.any():
        place = int(np.argmax(wrong))
        raise SettingError(f"p-values must lie in [0, 1]: test {place} has {array[place]}")
    order = np.argsort(array, kind="stable")
    scaled = np.minimum(1.0, np.arange(array.size, 0, -1) * array[order])
    adjusted = np.empty_like(array)
    adjusted[order] = np.maximum.accumulate(scaled)
    return adjusted


def _all_sums(array: FloatArray) -> FloatArray:
    """Return sum_k s_k array_k for each of the sign vectors s, shape (2^K,)."""
    sums = np.zeros(1)
    for value in array:
        sums = np.concatenate([sums + value, sums - value])
    return sums
