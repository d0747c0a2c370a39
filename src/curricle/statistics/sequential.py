"""Adding seeds until the answer is clear, without more false alarms.

Testing after every batch of seeds and stopping at the first interval that excludes 0 gives far more
false alarms than a single interval states. Here the number of interim analyses ("looks") is
planned, and intervals and p-values are those of a group-sequential design: at every look they have
the level with which all looks together keep the stated level, so they hold wherever one stops.

Sources: Armitage, McPherson and Rowe, "Repeated significance tests on accumulating data", Journal
of the Royal Statistical Society A 132, 1969; Pocock, "Group sequential methods in the design and
analysis of clinical trials", Biometrika 64, 1977; Jennison and Turnbull, "Interim analyses: the
repeated confidence interval approach", Journal of the Royal Statistical Society B 51, 1989.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, Self

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from curricle.arrays import FloatArray, Frozen, frozen
from curricle.checks import number, numbers, whole_number
from curricle.display import printed
from curricle.errors import SettingError
from curricle.statistics.hypothesis_tests import sign_flip_test
from curricle.statistics.intervals import CONFIDENCE, Interval, check_confidence, mean_interval
from curricle.text import brief_repr, counted

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

        It is computed for sums of normal values; Student's intervals then have an overall
        confidence within 0.005 of `overall` from 2 seeds on (measured).
        """
        check_confidence(overall)
        return _pointwise(self.seeds, overall)

    def adjusted_p(self, p: float) -> float:
        """Return a p-value times the number of looks, at most 1 (Bonferroni).

        It bounds the probability of a p-value of at most `p` at any look, whatever the
        distribution.
        """
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
        reason = f"stopped by {self.stopped_by}"
        return f"{reason} at look {self.looks} of {len(self.planned.seeds)}"


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
    of a sign-flip test at the level of :class:`Looks`. It stops when the half-width is at most
    `precision`, or when the adjusted p-value is below 1 - confidence (`difference`).

    All planned intervals together cover the mean with the stated confidence for normal values
    (docs/trust.md has rates for others). Fewer than 8 seeds cannot show a difference at the first
    of five looks, and a difference that is shown early is overestimated on average.

    Parameters
    ----------
    measure : callable
        ``measure(seeds)`` for a range of new seeds returns a finite number for each, such as the
        paired difference of two arms. It is called once for a seed.
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
        If a setting breaks these rules or `measure` does not return a finite number per seed.

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
            "add_seeds stops at a precision or at a difference, one of them:"
            f" got precision={precision} and difference={difference}"
        )
    if precision is not None and number("precision", precision, SettingError) <= 0:
        raise SettingError(f"precision must be above 0: got {precision}")
    planned = Looks.doubling(first, most)
    pointwise = planned.confidence(confidence)
    values = np.empty(0)
    for seeds in planned.seeds:
        values = np.append(values, _measured(measure, range(values.size, seeds)))
        mean = mean_interval(values, confidence=pointwise)
        p = planned.adjusted_p(sign_flip_test(values))
        half = (mean.high - mean.low) / 2
        enough = p < 1 - confidence if precision is None else half <= precision
        if enough:
            break
    goal: Literal["precision", "difference"] = "difference" if precision is None else "precision"
    interval = Interval(mean.estimate, mean.low, mean.high, confidence, values.size)
    return AddedSeeds(frozen(values), interval, p, goal if enough else "most", planned)


def _measured(measure: Measure, seeds: range) -> FloatArray:
    """Return the measure of these seeds, (K,), all finite."""
    values = numbers("the values that measure returns", measure(seeds), SettingError)
    if values.shape != (len(seeds),):
        raise SettingError(
            f"measure must return one number per seed: got shape {values.shape}"
            f" for {counted(len(seeds), 'seed')}"
        )
    wrong = ~np.isfinite(values)
    if wrong.any():
        place = int(wrong.argmax())
        raise SettingError(
            f"measure must return finite numbers: seed {seeds[place]} has {values[place]}"
        )
    return values
