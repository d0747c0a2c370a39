"""Adding seeds until the answer is clear, without more false alarms.

Testing after every batch of seeds and stopping at the first interval that excludes 0 gives far more
false alarms than each interval states. Here the number of interim analyses is planned, and each
interval is wider accordingly (Bonferroni), so that all of them hold at once.

Sources: Armitage, McPherson and Rowe, "Repeated significance tests on accumulating data", Journal
of the Royal Statistical Society A 132, 1969; Student, "The probable error of a mean", Biometrika
6, 1908.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.stats import sem, t

from curricle.array_types import FloatArray
from curricle.checks import number, numbers, whole_number
from curricle.errors import SettingError
from curricle.statistics.intervals import Interval, check_confidence

Measure = Callable[[Sequence[int]], npt.ArrayLike]


@dataclass(frozen=True, eq=False)
class AddedSeeds:
    """The values that :func:`add_seeds` measured, and why it stopped.

    Attributes
    ----------
    values : (K,) float64
        Of seeds 0 .. K-1, in the unit of the measure.
    interval : Interval
        The mean of `values`. Its confidence is that of the whole procedure: it is wider because
        of the planned interim analyses.
    stopped_by : {"precision", "difference", "most"}
        A half-width of at most `precision`, an interval that excludes 0, or neither after all
        seeds allowed.
    looks, planned : int
        Interim analyses ("looks") made and planned.

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
    """Return the mean of a measure over as many seeds as a precise or clear answer takes.

    After first, 2 first, 4 first, ..., most seeds it computes mean +- t s / sqrt(K), where t is
    Student's quantile for the confidence 1 - (1 - confidence) / looks and s the standard deviation
    over the K seeds. It stops when the half-width is at most `precision`, or when the interval
    excludes 0 (`difference`).

    Parameters
    ----------
    measure : callable
        ``measure(seeds)`` for a range of new seeds returns one finite number each, in their
        order, such as the paired difference of two arms. Each seed is measured once.
    first, most : int
        Seeds K at the first look, at least 2, and at the last.
    precision : float, optional
        Half-width to reach, in the unit of the measure, above 0.
    difference : bool
        Whether to stop at a difference from 0. Give either this or `precision`.
    confidence : float
        Of the whole procedure, between 0 and 1.

    Raises
    ------
    SettingError
        If a setting breaks these rules or `measure` does not return one finite number per seed.

    Notes
    -----
    By Bonferroni's inequality all planned intervals, and so the last one, cover the mean at once
    with at least the stated confidence where Student's t holds at each look, which it does exactly
    for normal values. At a nominal 95 % and the default looks, `difference` gave a false alarm in 2
    to 4 % of simulated procedures for symmetric values, as paired differences of equal arms are
    (6 % where each is +1 or -1), in 9 % for exponential and in 18 % for lognormal values (6 and
    11 % with first=40). The percentile bootstrap gives 9 % even for normal values.

    If all first seeds agree, the interval has no width: values that seldom differ need a larger
    `first`. A difference found early is overestimated on average.

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
    check_confidence(confidence)
    planned = [first]
    while planned[-1] < most:
        planned.append(min(2 * planned[-1], most))
    values = np.empty(0)
    for seeds in planned:
        values = np.append(values, _measured(measure, range(values.size, seeds)))
        mean = float(values.mean())
        level = 1 - (1 - confidence) / len(planned)
        half = float(t.ppf((1 + level) / 2, values.size - 1) * sem(values))
        enough = abs(mean) > half if precision is None else half <= precision
        if enough:
            break
    values.setflags(write=False)
    goal: Literal["precision", "difference"] = "difference" if precision is None else "precision"
    interval = Interval(mean, mean - half, mean + half, confidence, values.size)
    looks = planned.index(values.size) + 1
    return AddedSeeds(values, interval, goal if enough else "most", looks, len(planned))


def _measured(measure: Measure, seeds: range) -> FloatArray:
    """Return the measure of these seeds, one finite number each."""
    values = numbers("the values that measure returns", measure(seeds), SettingError)
    if values.shape != (len(seeds),):
        raise SettingError(
            f"measure must return one number per seed: got shape {values.shape}"
            f" for {len(seeds)} seeds"
        )
    wrong = ~np.isfinite(values)
    if wrong.any():
        place = int(wrong.argmax())
        raise SettingError(
            f"measure must return finite numbers: seed {seeds[place]} has {values[place]}"
        )
    return values
