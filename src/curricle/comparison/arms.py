"""One arm of a comparison: the curves of its seeds on the axis that all arms share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt

from curricle.learning.result import LearningResult
from curricle.statistics.curves import ROUNDING, Curve, charge_source
from curricle.statistics.metrics import mean_return

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arm:
    """The curves of one arm, over target steps, up to the total budget of the comparison.

    Attributes
    ----------
    curve : Curve
        Greedy return (K, T), with the source steps of each seed.
    training_return, guard_share : (K, T) float64
        As in :class:`LearningResult`.
    control : bool
        Whether it is a control of another arm.

    Examples
    --------
    >>> flat = np.zeros((2, 3))
    >>> steps = np.array([0, 10, 20])
    >>> arm = Arm(Curve(steps, flat + 4, np.array([10, 10])), flat, flat, False)
    >>> arm.strong_gain(Arm(Curve(steps, flat), flat, flat, False))
    array([3., 3.])
    """

    curve: Curve
    training_return: FloatArray = field(repr=False)
    guard_share: FloatArray = field(repr=False)
    control: bool

    @classmethod
    def of(
        cls,
        result: LearningResult,
        spent: npt.NDArray[np.int64],
        total: int,
        eval_freq: int,
        *,
        control: bool = False,
    ) -> Self:
        """Return a training of the target on the axis that all arms share.

        Seed k learns for total - spent_k steps; after these its last value is kept. `total` is the
        steps of every arm, sources included, `spent` (K,) the source steps, `eval_freq` the steps
        between checkpoints.
        """
        n = total // eval_freq + 1
        last = np.minimum((total - spent) // eval_freq, len(result.steps) - 1)
        place = np.minimum(np.arange(n), last[:, None])
        greedy, training, guard_share = (
            np.take_along_axis(found, place, axis=1)
            for found in (result.greedy_return, result.training_return, result.guard_share)
        )
        return cls(Curve(np.arange(n) * eval_freq, greedy, spent), training, guard_share, control)

    def charged(self, scratch: "Arm") -> Curve:
        """Return the curve over total steps, source steps included (:func:`charge_source`)."""
        return charge_source(scratch.curve, self.curve)

    def take(self, seeds: npt.NDArray[np.int64]) -> "Arm":
        """Return the arm with the seeds in these rows, in this order."""
        curve = Curve(self.curve.steps, self.curve.values[seeds], self.curve.source_steps[seeds])
        return Arm(curve, self.training_return[seeds], self.guard_share[seeds], self.control)

    def strong_gain(self, scratch: "Arm") -> FloatArray:
        """Return the area under the charged curve minus that of scratch, (K,), in return.

        Both are normalised (:func:`mean_return`); a difference within their rounding is 0.
        """
        mine, base = mean_return(self.charged(scratch)), mean_return(scratch.curve)
        noise = ROUNDING * np.maximum(np.abs(mine), np.abs(base))
        return np.where(np.abs(mine - base) > noise, np.subtract(mine, base), 0.0)


def joined(batches: Sequence[Mapping[str, Arm]]) -> dict[str, Arm]:
    """Return the arms of several batches of seeds as arms of all seeds."""
    return {
        name: Arm(
            Curve(
                arm.curve.steps,
                np.concatenate([batch[name].curve.values for batch in batches]),
                np.concatenate([batch[name].curve.source_steps for batch in batches]),
            ),
            np.concatenate([batch[name].training_return for batch in batches]),
            np.concatenate([batch[name].guard_share for batch in batches]),
            arm.control,
        )
        for name, arm in batches[0].items()
    }
