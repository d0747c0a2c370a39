"""Numbers of a recipe that grow with the size of a task: a power of its number of states."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.checks import brief, number, numbers
from curricle.errors import CurriculumError
from curricle.frozen_arrays import Frozen, frozen


@dataclass(frozen=True, eq=False)
class Trend(Frozen):
    """A number by the states of a task: at(S) = level (S / around)^slope.

    Parameters
    ----------
    level : float
        At the middle of the sizes that it was fitted to; above 0.
    slope : float
        Of its logarithm over that of S; 0 is a constant.
    around : float
        States at which it is `level`.
    draws : (n, 2) float64
        Level and slope of n resamples of what it was fitted to, for intervals; may be empty.

    Raises
    ------
    CurriculumError
        When a number is not finite, or the level or `around` not above 0.

    Examples
    --------
    >>> steps = Trend(50.0, slope=0.5, around=100.0)
    >>> float(steps.at(100)), float(steps.at(400))
    (50.0, 100.0)
    >>> print(Trend.constant(40))
    40
    """

    level: float
    slope: float = 0.0
    around: float = 1.0
    draws: npt.ArrayLike = ()

    def __post_init__(self) -> None:
        number("the slope of a trend", self.slope, CurriculumError)
        for name in ("level", "around"):
            given = number(f"{name} of a trend", getattr(self, name), CurriculumError)
            if given <= 0:
                raise CurriculumError(f"{name} of a trend must be above 0: got {given:g}")
        draws = numbers("draws of a trend", self.draws, CurriculumError)
        if draws.size and (draws.ndim != 2 or draws.shape[1] != 2):
            raise CurriculumError(
                f"draws of a trend must be pairs of level and slope: got {brief(self.draws)}"
            )
        draws = draws.reshape(-1, 2)
        if not np.isfinite(draws).all() or (draws[:, 0] <= 0).any():
            raise CurriculumError(
                f"draws of a trend must be finite, their levels above 0: got {brief(self.draws)}"
            )
        object.__setattr__(self, "draws", frozen(draws.copy()))

    @classmethod
    def constant(cls, value: float) -> "Trend":
        """Return a number that is the same at all sizes."""
        return cls(float(number("a number of a recipe", value, CurriculumError)))

    def at(self, states: float) -> float:
        """Return the number for a task of so many states.

        CurriculumError where no float holds it, as of a slope of hundreds.
        """
        try:
            found = float(self.level * (states / self.around) ** self.slope)
        except OverflowError:
            found = math.inf
        if not 0 < found < math.inf:
            raise CurriculumError(
                f"a number of a recipe must be finite and above 0: {self} is {found:g} at "
                f"{states:,} states"
            )
        return found

    def interval(self, states: float, confidence: float = 0.95) -> tuple[float, float]:
        """Return the percentiles of the number over the resamples; NaN where there are none.

        Examples
        --------
        >>> two = Trend(2.0, draws=[(1.0, 0.0), (3.0, 0.0)])
        >>> two.interval(10, confidence=1.0)
        (1.0, 3.0)
        """
        draws: FloatArray = np.asarray(self.draws)
        if not len(draws):
            return math.nan, math.nan
        found = draws[:, 0] * (states / self.around) ** draws[:, 1]
        tail = 50 * (1 - confidence)
        low, high = np.percentile(found, [tail, 100 - tail])
        return float(low), float(high)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Trend):
            return NotImplemented
        same = (self.level, self.slope, self.around) == (other.level, other.slope, other.around)
        return same and np.array_equal(self.draws, other.draws)

    def __hash__(self) -> int:
        return hash((self.level, self.slope, self.around))

    def __str__(self) -> str:
        if self.slope == 0:
            return f"{self.level:.3g}"
        return f"{self.level:.3g} x (S / {self.around:,.0f})^{self.slope:.2g}"
