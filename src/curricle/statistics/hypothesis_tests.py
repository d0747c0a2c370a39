"""Which arm is better: profiles, the probability of improvement, tests and their correction.

A NaN is never dropped: it makes an estimate NaN, and a test refuses it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Literal, Self

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from curricle.arrays import FloatArray, Frozen, frozen as frozen_array
from curricle.checks import number, numbers, whole_number
from curricle.display import printed
from curricle.errors import SettingError
from curricle.statistics.intervals import (
    CONFIDENCE,
    ROUNDING,
    Interval,
    check_confidence,
    check_each,
    frozen,
    mean_interval,
    vector,
)
from curricle.text import brief_repr, counted

EXACT = 14  # seeds up to which all 2^K sign vectors are counted, at most 16,384
AT_ONCE = 4_000_000  # random signs drawn at once, 64 MB: those of 20,000 seeds would take 3 GB


def performance_profile(
    scores: npt.ArrayLike, thresholds: npt.ArrayLike, *, confidence: float = CONFIDENCE
) -> Interval:
    """Return the share of runs that score above each threshold, with Wilson's score interval.

    Its bounds are the shares p for which ``|share - p| = z sqrt(p (1 - p) / K)`` (Wilson 1927).
    Nominal 95 % cover 95 % on average over all shares, 84 % at worst with 5 seeds, 91 % with 20.
    """
    runs, tau = vector("scores", scores), vector("thresholds", thresholds, "L")
    if np.isnan(tau).any():
        raise SettingError(f"thresholds must be numbers: threshold {np.isnan(tau).argmax()} is nan")
    check_confidence(confidence)
    share = np.mean(runs[:, np.newaxis] > tau, axis=0)
    if np.isnan(runs).any():
        share = np.full(tau.size, np.nan)
    n, z = runs.size, ndtri((1 + confidence) / 2)
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2) / (1 + z**2 / n)
    if n == 1:
        half = np.full(tau.size, np.nan)
    low, high = np.clip([middle - half, middle + half], 0.0, 1.0)
    return Interval(frozen(share), frozen(low), frozen(high), confidence, n)


def probability_of_improvement(
    a: npt.ArrayLike, b: npt.ArrayLike, *, confidence: float = CONFIDENCE
) -> Interval:
    """Return the probability that a run of a beats a run of b, with Newcombe's score interval.

    P(a > b) + P(a = b) / 2 = mean_ij ([a_i > b_j] + [a_i = b_j] / 2) over all pairs of runs: the U
    of Mann and Whitney (1947) over the number of pairs. The bounds are the probabilities p for
    which ``|estimate - p| = z sqrt(v(p))`` with the variance of U for exponential scores (Newcombe
    2006, method 5): v(p) = p (1 - p) (1 + (N - 1) ((1 - p) / (2 - p) + p / (1 + p))) / (K_a K_b), N
    = (K_a + K_b) / 2.

    It says how often a beats b (1/2 if neither is ahead), not by how much. The interval has a width
    even if every run of an arm beats every run of the other. It is too wide for matched seeds that
    rise and fall together, and too short for spreads that differ by a factor of 5 (docs/trust.md).
    `a` and `b`, (K,), may differ in K and be infinite; a NaN makes the result NaN. SettingError on
    other arguments.

    Examples
    --------
    >>> print(probability_of_improvement([3.0, 5.0, 7.0, 9.0], [4.0, 5.0, 6.0]))
    0.62 [0.24, 0.90], 3 seeds
    """
    first, second = vector("a", a), vector("b", b)
    check_confidence(confidence)
    # Ranks instead of a table of all pairs, which for 20,000 seeds would take 3 GB.
    ordered = np.sort(second)
    wins = np.searchsorted(ordered, first, "left") + np.searchsorted(ordered, first, "right")
    has_nan = np.isnan(first).any() or np.isnan(second).any()
    share = math.nan if has_nan else float(wins.sum() / 2 / (first.size * second.size))
    n = min(first.size, second.size)
    if n == 1 or math.isnan(share):
        return Interval(share, math.nan, math.nan, confidence, n)
    z = float(ndtri((1 + confidence) / 2))
    low, other = (_lower_probability(p, first.size, second.size, z) for p in (share, 1 - share))
    return Interval(share, low, 1 - other, confidence, n)


def _lower_probability(share: float, n_a: int, n_b: int, z: float) -> float:
    """Return the smallest p from which a share is z standard errors away (Newcombe 2006)."""
    from scipy.optimize import brentq  # takes time, and few need it

    def excess(p: float) -> float:
        between = (1 - p) / (2 - p) + p / (1 + p)
        variance = p * (1 - p) * (1 + ((n_a + n_b) / 2 - 1) * between) / (n_a * n_b)
        return share - p - z * math.sqrt(variance)

    # Where the share is 1, p = 1 is a root too, but not the smallest.
    return float(brentq(excess, 0.0, min(share, 1 - ROUNDING))) if share > 0 else 0.0


def sign_flip_test(differences: npt.ArrayLike, *, resamples: int = 10_000, seed: int = 0) -> float:
    """Return the two-sided p-value of paired differences under random signs.

    p = share of the sign vectors s in {-1, 1}^K with ``|sum_k s_k d_k| >= |sum_k d_k|``, 1 if all
    differences are 0 (Fisher 1935; Pitman 1937). All vectors are counted for up to 14 seeds; for
    more, p = (1 + count) / (1 + resamples) over random vectors (Phipson and Smyth 2010).

    Under the null hypothesis a difference is as likely as its negative, which holds if the two arms
    are exchangeable; then P(p <= alpha) <= alpha whatever the distribution. If only the mean is 0,
    this holds roughly, for many seeds. Five seeds give no p below 0.0625. SettingError unless the
    differences a_k - b_k of matched seeds, (K,), are finite and `resamples` is at least 1.

    Examples
    --------
    >>> sign_flip_test([1.0, 2.0, 3.0, 1.5, 2.5, 0.5])
    0.03125
    """
    array = vector("differences", differences)
    check_each("differences must be finite", np.isfinite(array), array, "seed")
    draws = whole_number("resamples", resamples, 1, SettingError)
    total = np.abs(array).sum()
    if array.size == 1 or total == 0:
        return 1.0
    least = abs(array.sum()) - ROUNDING * total
    if array.size <= EXACT:
        return float((np.abs(_all_signs(array.size) @ array) >= least).mean())
    rng, rows = np.random.default_rng(seed), max(1, AT_ONCE // array.size)
    as_far = 0
    for drawn in range(0, draws, rows):
        signs = 2.0 * rng.integers(2, size=(min(rows, draws - drawn), array.size)) - 1.0
        as_far += int((np.abs(signs @ array) >= least).sum())
    return (1 + as_far) / (1 + draws)


@lru_cache(maxsize=EXACT)
def _all_signs(seeds: int) -> FloatArray:
    """Return the sign vectors (2^(K - 1), K) with 1 first; their opposites are as far from 0."""
    numbers = np.arange(2 ** (seeds - 1))[:, np.newaxis]
    signs = 1 - 2 * (numbers >> np.arange(seeds - 1, -1, -1) & 1)
    return signs.astype(np.float64)


def smallest_p(seeds: int, resamples: int = 10_000) -> float:
    """Return the smallest p-value of :func:`sign_flip_test` that so many seeds can give."""
    return 2.0 ** (1 - seeds) if seeds <= EXACT else 1 / (resamples + 1)


def holm(p_values: npt.ArrayLike) -> FloatArray:
    """Return p-values adjusted for their number, under any dependence (Holm 1979)."""
    array = vector("p-values", p_values, "M")
    check_each("p-values must lie in [0, 1]", (array >= 0) & (array <= 1), array, "test")
    order = np.argsort(array, kind="stable")
    scaled = np.minimum(1.0, np.arange(array.size, 0, -1) * array[order])
    adjusted = np.empty_like(array)
    adjusted[order] = np.maximum.accumulate(scaled)
    return adjusted


# -- Adding seeds until the answer is clear, without more false alarms -----------------------------
#
# Stopping at the first interval that excludes 0 gives far more false alarms than an interval
# states. Here the number of interim analyses ("looks") is planned: at every look intervals and
# p-values have the level with which all looks together keep the stated level.

Measure = Callable[[Sequence[int]], npt.ArrayLike]

NODES = 200  # of the integral of a density; twice as many change no level by 1e-9


@dataclass(frozen=True)
class Looks:
    """Planned interim analyses, at equal levels (Pocock 1977).

    Attributes
    ----------
    seeds : tuple of int
        Numbers of seeds at which the values are examined, increasing.

    Examples
    --------
    >>> looks = Looks.doubling(10, 100)
    >>> looks.seeds, round(looks.confidence(0.95), 4)
    ((10, 20, 40, 80, 100), 0.986)
    >>> looks.adjusted_p(0.01)
    0.05
    """

    seeds: tuple[int, ...]

    @classmethod
    def doubling(cls, first: int, most: int) -> Self:
        """Return looks at first, 2 first, 4 first, ... and `most` seeds."""
        seeds = [first]
        while seeds[-1] < most:
            seeds.append(min(2 * seeds[-1], most))
        return cls(tuple(seeds))

    def confidence(self, overall: float = CONFIDENCE) -> float:
        """Return the confidence of the interval at a look with which all looks hold at `overall`.

        It is computed for normal values; Student's intervals are within 0.005 of it (measured).
        """
        check_confidence(overall)
        return _pointwise(self.seeds, overall)

    def adjusted_p(self, p: float) -> float:
        """Return p times the number of looks, at most 1, which holds for any distribution."""
        # Pocock's smaller bound is for sums of normal values: with it sign-flip tests of lognormal
        # values raised 7 % false alarms, as their p-values at successive looks depend less on each
        # other.
        if not 0 <= number("a p-value", p, SettingError) <= 1:
            raise SettingError(f"a p-value must lie in [0, 1]: got {p}")
        return min(1.0, len(self.seeds) * p)


@cache
def _pointwise(seeds: tuple[int, ...], overall: float) -> float:
    """Return the confidence of a look with which all looks hold at `overall`."""
    if len(seeds) == 1:
        return overall
    from scipy.optimize import brentq  # takes time, and few need it

    alone = -float(ndtri((1 - overall) / 2))  # the bound of one look, and of Bonferroni's rule
    bonferroni = -float(ndtri((1 - overall) / 2 / len(seeds)))
    bound = brentq(lambda z: _within(seeds, z) - overall, alone, bonferroni, xtol=1e-12)
    return 1 - 2 * float(ndtr(-bound))


@cache
def _quadrature() -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(NODES)  # takes as long as all that follows


def _within(seeds: Sequence[int], bound: float) -> float:
    """Return the probability that the mean lies within `bound` standard errors at every look."""
    # The density of the sums that stayed within is integrated from look to look (Armitage et al.).
    nodes, weights = _quadrature()
    so_far, sums, mass = 0, np.zeros(1), np.ones(1)
    for n in seeds:
        edge, spread = bound * math.sqrt(n), math.sqrt(n - so_far)
        reached = edge * nodes
        density = np.exp(-(((reached[:, np.newaxis] - sums) / spread) ** 2) / 2)
        density /= spread * math.sqrt(2 * math.pi)
        so_far, sums, mass = n, reached, (density @ mass) * weights * edge
    return float(mass.sum())


@dataclass(frozen=True, eq=False)
class AddedSeeds(Frozen):
    """The values that :func:`add_seeds` measured, and why it stopped."""

    values: FloatArray  # (K,) of seeds 0 .. K-1, in the unit of the measure
    interval: Interval  # of their mean, with the confidence of the whole procedure, so wider
    p: float  # of no difference from 0, adjusted for the planned looks
    stopped_by: Literal["precision", "difference", "most"]  # "most": after all seeds allowed
    planned: Looks

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def looks(self) -> int:
        """Number of looks made."""
        return self.planned.seeds.index(self.values.size) + 1

    def __str__(self) -> str:
        return f"{self.interval}; {self.stopped}"

    @property
    def stopped(self) -> str:
        """The reason and the look of stopping, in words."""
        return f"stopped by {self.stopped_by} at look {self.looks} of {len(self.planned.seeds)}"


def add_seeds(
    measure: Measure,
    *,
    first: int = 10,
    most: int = 100,
    precision: float | None = None,
    difference: bool = False,
    confidence: float = CONFIDENCE,
) -> AddedSeeds:
    """Return the mean of a measure over as many seeds as a precise or clear answer takes.

    After first, 2 first, 4 first, ..., most seeds it computes Student's interval and the p-value
    of a sign-flip test at the level of :class:`Looks`. All intervals together cover the mean with
    the stated confidence for normal values (docs/trust.md has rates for others). Fewer than 8 seeds
    cannot show a difference at the first of five looks, and a difference that is shown early is
    overestimated on average. SettingError on other arguments.

    Parameters
    ----------
    measure : callable
        ``measure(seeds)`` returns a finite number for each of a range of new seeds, such as the
        paired difference of two arms. It is called once for a seed.
    first, most : int
        Seeds K at the first look, at least 2, and at the last.
    precision : float, optional
        Stop when the half-width is at most this, above 0, in the unit of the measure.
    difference : bool
        Stop when the adjusted p-value is below 1 - confidence. Give either this or `precision`.

    Examples
    --------
    >>> def noisy(seeds):
    ...     return [np.random.default_rng(seed).normal(1.0, 2.0) for seed in seeds]
    >>> added = add_seeds(noisy, precision=1.0)
    >>> added.stopped_by, added.values.size, added.looks
    ('precision', 40, 3)
    """
    first = whole_number("first", first, 2, SettingError)
    most = whole_number("most", most, first, SettingError)
    if difference == (precision is not None):
        raise SettingError(
            "add_seeds needs either a precision or difference=True:"
            f" got precision={precision} and difference={difference}"
        )
    if precision is not None and number("precision", precision, SettingError) <= 0:
        raise SettingError(f"precision must be above 0: got {precision}")
    planned = Looks.doubling(first, most)
    pointwise = planned.confidence(confidence)
    values = np.empty(0)
    for seeds in planned.seeds:
        new = range(values.size, seeds)
        measured = numbers("the values that measure returns", measure(new), SettingError)
        if measured.shape != (len(new),):
            raise SettingError(
                f"measure must return one number per seed: got shape {measured.shape}"
                f" for {counted(len(new), 'seed')}"
            )
        if (wrong := ~np.isfinite(measured)).any():
            place = int(wrong.argmax())
            raise SettingError(
                f"measure must return finite numbers: seed {new[place]} has {measured[place]}"
            )
        values = np.append(values, measured)
        mean = mean_interval(values, confidence=pointwise)
        p = planned.adjusted_p(sign_flip_test(values))
        half = (mean.high - mean.low) / 2
        enough = p < 1 - confidence if precision is None else half <= precision
        if enough:
            break
    goal: Literal["precision", "difference"] = "difference" if precision is None else "precision"
    interval = replace(mean, confidence=confidence)
    return AddedSeeds(frozen_array(values), interval, p, goal if enough else "most", planned)
