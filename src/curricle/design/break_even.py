"""After how many trainings of its target a search for a curriculum has paid."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from curricle.checks import number
from curricle.errors import SettingError
from curricle.statistics.intervals import Interval

Saving = float | Interval


@dataclass(frozen=True)
class BreakEven:
    """After how many trainings of the target, or of members of its family, a search has paid.

    Prints as a sentence.

    Attributes
    ----------
    trainings : int or None
        Made after the search; None if it never pays. 0 where the search cost nothing.
    fewest, most : int or None
        At the upper and at the lower bound of the saving; None if it never pays there. Both None
        where the saving has no interval.
    cost, saving : float
        Of the search, and of each training, in steps whose price is 1.
    bounded : bool
        Whether the saving has an interval.

    Examples
    --------
    >>> print(break_even(90_000, Interval(11_000.0, -2_000.0, 24_000.0, 0.95, 30)))
    the search has paid after 9 trainings [4, never]
    """

    trainings: int | None
    fewest: int | None
    most: int | None
    cost: float
    saving: float
    bounded: bool = False

    @property
    def never(self) -> bool:
        """Whether the search never pays, by the estimate of the saving."""
        return self.trainings is None

    def __str__(self) -> str:
        if self.trainings is not None:
            limits = f" [{_shown(self.fewest)}, {_shown(self.most)}]" if self.bounded else ""
            one = "training" if self.trainings == 1 else "trainings"
            return f"the search has paid after {self.trainings:,} {one}{limits}"
        if self.saving == 0:
            why = "a training with the design costs as much as one without"
        else:
            why = f"a training with the design costs {-self.saving:,.4g} more than one without"
        if self.fewest is not None:
            why += f"; at the upper bound of its interval after {self.fewest:,} trainings"
        return f"the search never pays: {why}"


def break_even(cost: float, saving: Saving) -> BreakEven:
    """Return after how many trainings a search of this cost has paid.

    The least whole n with n x saving >= cost, computed exactly; there is none where nothing is
    saved.

    Examples
    --------
    >>> break_even(1000, 250).trainings, break_even(1001, 250).trainings, break_even(1, 0).never
    (4, 5, True)
    """
    cost = number("the cost of a search", cost, SettingError, 0)
    if not isinstance(saving, Interval):
        each = number("the saving of a training", saving, SettingError)
        return BreakEven(_trainings(cost, each), None, None, cost, each)
    if np.ndim(saving.estimate) != 0:
        raise SettingError(f"the saving of a training must be one interval: got {saving}")
    each = number("the saving of a training", float(saving.estimate), SettingError)
    low, high = float(saving.low), float(saving.high)
    if math.isnan(low) or math.isnan(high):
        return BreakEven(_trainings(cost, each), None, None, cost, each)
    at_most = None if low == -math.inf else _trainings(cost, low)
    at_least = (0 if cost == 0 else 1) if high == math.inf else _trainings(cost, high)
    return BreakEven(_trainings(cost, each), at_least, at_most, cost, each, bounded=True)


def _trainings(cost: float, saving: float) -> int | None:
    """Return the least whole n with n x saving >= cost; None where there is none."""
    if saving <= 0:
        return None
    return math.ceil(Fraction(cost) / Fraction(saving))


def _shown(trainings: int | None) -> str:
    return "never" if trainings is None else f"{trainings:,}"
