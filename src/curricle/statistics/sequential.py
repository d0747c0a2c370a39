"""Adding seeds until the answer is clear, without paying for the looks in false alarms.

Whoever looks after every batch of seeds and stops at the first interval that excludes 0 is fooled
far more often than each interval says. Here the number of looks is planned, and each look's
interval is that much wider (Bonferroni), so that all of them hold at once.

Sources: Armitage, McPherson and Rowe, "Repeated significance tests on accumulating data", Journal
of the Royal Statistical Society A 132, 1969; Student, "The probable error of a mean", Biometrika
6, 1908.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from curricle.checks import number, numbers, whole_number
from curricle.errors import SettingError
from curricle.statistics.intervals import Interval

__all__ = ["AddedSeeds", "add_seeds"]

FloatArray = npt.NDArray[np.float64]

Measure = Callable[[Sequence[int]], npt.ArrayLike]


@dataclass(frozen=True, eq=False)
class AddedSeeds:
    """What :func:`add_seeds` measured and why it stopped.

    Attributes
    ----------
    values : (K,) float64
        Of seeds 0 .. K-1, in the unit of the measure.
    interval : Interval
        The mean of `values`. Its confidence is that of the whole procedure: it was widened for
        the planned looks.
    stopped_by : {"precision", "difference", "most"}
        The argument that ended it: a half-width at most `precision`, an interval that excludes 0,
        or all seeds allowed spent without either.
    looks, planned : int
        Looks made, looks allowed for.

    Examples
    --------
    >>> print(add_seeds(lambda seeds: [3.0 + seed % 2 for seed in seeds], difference=True))
    3.50 [2.96, 4.04], 10 seeds; stopped by difference at look 1 of 5
    """

    values: FloatArray
    interval: Interval
    stopped_by: Literal["precision", "difference", "most"]
    looks: int
    planned: int

    def __str__(self) -> str:
        return (
            f"{self.interval}; stopped by {self.stopped_by} at look {self.looks} of {self.planned}"
        )


def add_seeds(
    measure: Measure,
    *,
    first: int = 10,
    most: int = 100,
    precision: float | None = None,
    difference: bool = False,
    confidence: float = 0.95,
) -> AddedSeeds:
    """Return the mean of a measure over as many seeds as it takes to know it well enough.

    After first, 2 first, 4 first, ..., most seeds it looks at mean +- t s / sqrt(K), t being
    Student's quantile for the confidence 1 - (1 - confidence) / looks and s the standard deviation
    over the K seeds. It stops when the half-width is at most `precision`, or when the interval
    excludes 0 (`difference`).

    Parameters
    ----------
    measure : callable
        ``measure(seeds)`` with seeds a range of new ones: one finite number for each, in their
        order, such as the paired difference of two arms. Each seed is asked for once.
    first, most : int
        Seeds K at the first look, at least 2, and at the last.
    precision : float, optional
        Half-width to reach, in the unit of the measure, above 0.
    difference : bool
        Whether to stop at a difference from 0. Give this or `precision`, not both.
    confidence : float
        Of the whole procedure, between 0 and 1.

    Returns
    -------
    AddedSeeds
        Values (K,), their interval, why it stopped.

    Raises
    ------
    SettingError
        If a setting breaks these rules or `measure` does not give one finite number per seed.

    Notes
    -----
    By Bonferroni's inequality all planned intervals cover the mean at once with at least the stated
    confidence, hence also the one it stops at, as far as Student's t holds at each look: exactly
    for normal values. At a nominal 95 % and the default looks, `difference` was a false alarm in 2
    to 4 % of simulated procedures for symmetric values, as paired differences of equal arms are
    (6 % where each is +1 or -1). For exponential values it was in 9 %, for lognormal ones in 18 %;
    6 and 11 % with 40 seeds first. The percentile bootstrap gives 9 % for normal values already.

    Seeds that all agree look certain: values that seldom differ need a larger `first`. A difference
    found early is on average found too large.

    References
    ----------
    Armitage, McPherson and Rowe 1969; Student 1908.

    Examples
    --------
    >>> def noisy(seeds):
    ...     return [np.random.default_rng(seed).normal(1.0, 2.0) for seed in seeds]
    >>> found = add_seeds(noisy, precision=1.0)
    >>> found.stopped_by, found.values.size, found.looks
    ('precision', 40, 3)
    """
    first = whole_number("first", first, 2, SettingError)
    most = whole_number("most", most, first, SettingError)
    if difference == (precision is not None):
        raise SettingError(
            "add_seeds stops at a precision or at a difference, one of them:"
            f" got precision={precision} and difference={difference}"
        )
    if precision is not None and number("precision", precision, SettingError) <= 0:
        raise SettingError(f"precision must be above 0: got {precision}")
    if not 0 < number("confidence", confidence, SettingError) < 1:
        raise SettingError(f"confidence must be between 0 and 1: got {confidence}")
    planned = _planned(first, most)
    values = np.empty(0)
    for seeds in planned:
        values = np.append(values, _measured(measure, range(values.size, seeds)))
        mean = float(values.mean())
        half = _half_width(values, 1 - (1 - confidence) / len(planned))
        enough = abs(mean) > half if precision is None else half <= precision
        if enough:
            break
    values.setflags(write=False)
    goal: Literal["precision", "difference"] = "difference" if precision is None else "precision"
    interval = Interval(mean, mean - half, mean + half, confidence, values.size)
    looks = planned.index(values.size) + 1
    return AddedSeeds(values, interval, goal if enough else "most", looks, len(planned))


def _planned(first: int, most: int) -> list[int]:
    """Return the seeds K at each look: doubled until `most`."""
    looks = [first]
    while looks[-1] < most:
        looks.append(min(2 * looks[-1], most))
    return looks


def _measured(measure: Measure, seeds: range) -> FloatArray:
    """Return what `measure` gives for these seeds, one finite number each."""
    values = numbers("what measure returns", measure(seeds), SettingError)
    if values.shape != (len(seeds),):
        raise SettingError(
            f"measure must return one number per seed: got shape {values.shape}"
            f" for {len(seeds)} seeds"
        )
    wrong = ~np.isfinite(values)
    if wrong.any():
        place = int(np.argmax(wrong))
        raise SettingError(
            f"measure must return finite numbers: seed {seeds[place]} has {values[place]}"
        )
    return values


def _half_width(values: FloatArray, confidence: float) -> float:
    """Return half the width of Student's interval of the mean."""
    error = float(values.std(ddof=1)) / math.sqrt(values.size)
    return _student(confidence, values.size - 1) * error


def _student(confidence: float, freedom: int) -> float:
    """Return the t with P(|T| <= t) = confidence for Student's T, by bisection of the angle."""
    low, high = 0.0, math.pi / 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _within(middle, freedom) < confidence else (low, middle)
    return math.sqrt(freedom) * math.tan(low)


def _within(angle: float, freedom: int) -> float:
    """Return P(|T| <= sqrt(freedom) tan(angle)); Abramowitz and Stegun 1964, 26.7.3 and 26.7.4."""
    odd, total, term = freedom % 2, 0.0, 1.0
    for j in range(freedom // 2):
        total += term
        term *= math.cos(angle) ** 2 * (2 * j + 1 + odd) / (2 * j + 2 + odd)
    if odd:
        return 2 / math.pi * (angle + math.sin(angle) * math.cos(angle) * total)
    return math.sin(angle) * total
