"""What the records say: steps of each designer as a share of scratch's, and who beats whom."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.referee.lines import Record
from benchmarks.referee.players import FIXED, SCRATCH
from curricle.arrays import BoolArray, FloatArray
from curricle.statistics import Interval, mean_interval

MANY_TARGETS = 10
"""From so many targets on, an interval is over targets; below it is over seeds."""

SMALL = 0.01
"""A share below it is printed with a decimal: an interval may show it, and it be no use."""


@dataclass(frozen=True, eq=False)
class Unit:
    """One designer in one domain: T targets, K seeds.

    Attributes
    ----------
    rate : float
        Its learning rate.
    steps, learnt : (T, K)
        Until the target was learnt, sources included; a full training where it never was.
    search : (T,)
        Steps of its search for each target; those of a search for a domain are shared equally.
    tuning : int
        Steps of all trials of learning rates, with their searches.
    refused : int
        Targets for which it had no design, so that the target was learnt alone.
    """

    rate: float
    steps: FloatArray
    learnt: BoolArray
    search: FloatArray
    tuning: int
    refused: int = 0

    @classmethod
    def of(cls, tuning: Sequence[Record], judged: Sequence[Record]) -> "Unit":
        """Return the unit of its records."""
        search = np.array([one["search"] for one in judged], float)
        if judged[0]["shared"]:
            search /= len(judged)
        trials = sum(int(np.sum(one["steps"])) for one in tuning)
        return cls(
            judged[0]["rate"],
            np.array([one["steps"] for one in judged], float),
            np.array([one["learnt"] for one in judged], bool),
            search,
            trials + round(_searched(tuning)),
            sum("refused" in one for one in judged),
        )

    @property
    def cost(self) -> FloatArray:
        """The steps of one training and of the whole search for it, (T, K)."""
        return self.steps + self.search[:, None]


def _searched(tuning: Sequence[Record]) -> float:
    """Return the steps of the searches of tuning; one for all maps is counted once."""
    costs = {(one["rate"], one["shared"] or one["case"]): one["search"] for one in tuning}
    return float(sum(costs.values()))


@dataclass(frozen=True, eq=False)
class Verdict:
    """One designer against another in one domain.

    Attributes
    ----------
    share : Interval
        Of the other's steps that it saves, averaged over targets; negative where it takes more.
    beats : bool
        Whether that is shown: the interval lies above 0.
    """

    share: Interval

    @property
    def beats(self) -> bool:
        """Whether the designer saves steps, shown by the interval."""
        low = self.share.low
        return bool((self.share.estimate if np.isnan(low) else low) > 0)

    def __str__(self) -> str:
        middle, low, high = self.share.estimate, self.share.low, self.share.high
        if np.isnan(low):
            return f"{middle:+.0%}"
        digits = 0 if abs(float(middle)) >= SMALL else 1
        bounds = f"[{low:+.{digits}%}, {high:+.{digits}%}]"
        return f"{middle:+.{digits}%} {bounds}"


def against(unit: Unit, base: Unit, *, search: bool = False) -> Verdict:
    """Return what a designer saves, as a share of another's steps; with its search if asked.

    Seeds are paired: seed k of the one is compared with seed k of the other. The interval is over
    targets, or over seeds where targets are few: then it says nothing of other targets.

    Examples
    --------
    >>> base = Unit(0.1, np.full((1, 4), 100.0), np.ones((1, 4), bool), np.zeros(1), 0)
    >>> own = np.array([[50.0, 60, 40, 50]])
    >>> one = Unit(0.1, own, np.ones((1, 4), bool), np.array([70.0]), 0)
    >>> print(against(one, base), against(one, base).beats)
    +50% [+37%, +63%] True
    >>> print(against(one, base, search=True), against(one, base, search=True).beats)
    -20% [-33%, -7%] False
    """
    own, other = (unit.cost, base.cost) if search else (unit.steps, base.steps)
    saved = (other - own) / other.mean(axis=1, keepdims=True)
    axis = 1 if len(saved) >= MANY_TARGETS else 0
    return Verdict(mean_interval(saved.mean(axis=axis)))


def paid_after(unit: Unit, base: Unit) -> int | None:
    """Return after how many trainings of each target the search has paid; None if it never does.

    The least whole n with n x saving >= search, computed exactly.

    Examples
    --------
    >>> base = Unit(0.1, np.full((1, 2), 100.0), np.ones((1, 2), bool), np.zeros(1), 0)
    >>> one = Unit(0.1, np.full((1, 2), 75.0), np.ones((1, 2), bool), np.array([120.0]), 0)
    >>> paid_after(one, base)
    5
    """
    saving = Fraction(float((base.steps - unit.steps).mean()))
    return None if saving <= 0 else math.ceil(Fraction(float(unit.search.mean())) / saving)


@dataclass(frozen=True, eq=False)
class Match:
    """All units, by domain and designer, in the order of play."""

    units: Mapping[str, Mapping[str, Unit]]

    @cached_property
    def designers(self) -> list[str]:
        """All who played anywhere."""
        return list(dict.fromkeys(one for units in self.units.values() for one in units))

    def best_fixed(self, name: str) -> str | None:
        """Return the fixed recipe that saves most in a domain; None where none has played.

        It is chosen by the targets that it is judged on, which favours it.
        """
        units = self.units[name]
        there = [one for one in FIXED if one in units]
        if not there:
            return None
        return max(there, key=lambda one: against(units[one], units[SCRATCH]).share.estimate)

    def base(self, name: str, *, fixed: bool) -> str | None:
        """Return whom all are compared with in a domain: scratch, or the best fixed recipe."""
        return self.best_fixed(name) if fixed else SCRATCH

    def beaten(
        self, designer: str, *, fixed: bool = False, search: bool = False
    ) -> dict[str, bool]:
        """Return the domains in which a designer met scratch, or a fixed recipe: did it beat it?"""
        found = dict[str, bool]()
        for name, units in self.units.items():
            base = self.base(name, fixed=fixed)
            if designer in units and base is not None:
                found[name] = against(units[designer], units[base], search=search).beats
        return found


def count(beaten: Mapping[str, Any]) -> str:
    """Return in how many domains one beat another.

    Examples
    --------
    >>> count({"a": True, "b": False, "c": True})
    '2 of 3'
    """
    return f"{sum(beaten.values())} of {len(beaten)}"
