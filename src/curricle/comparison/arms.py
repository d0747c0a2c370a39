"""One arm of a comparison: the curves of its seeds on an axis common to all arms."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.comparison.levels import Level, concatenated_levels
from curricle.comparison.verdicts import difference
from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult
from curricle.statistics.curves import SCRATCH, Curve, charge_source, mean_return
from curricle.text import brief_repr


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
    scratch : bool
        Whether it learns the target from scratch with a learner of its own.
    level : Level or None
        What a control that knows nothing of the task adds to every value.
    unlearnt : dict of str to (K,) bool
        For each source, which seeds did not learn it, by its stopping rule.

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
    scratch: bool = False
    level: Level | None = field(default=None, repr=False)
    unlearnt: Mapping[str, BoolArray] = field(default_factory=dict, repr=False)

    __repr__ = brief_repr

    def _repr_html_(self) -> str:
        return self.curve._repr_html_()

    @classmethod
    def of(
        cls,
        result: LearningResult,
        spent: IntArray,
        total: int,
        eval_freq: int,
        *,
        control: bool = False,
        scratch: bool = False,
        level: Level | None = None,
    ) -> Self:
        """Return an arm from the target's learning result.

        Seed k learns for total - spent_k steps, after which its last value is repeated. `total` are
        the steps of every arm, sources included, `spent` (K,) the source steps, at most as many,
        `eval_freq` the steps between checkpoints.
        """
        if spent.max() > total:
            raise CurriculumError(
                f"sources must take at most the total of {total:,} steps: got {spent.max():,}"
            )
        n = total // eval_freq + 1
        last = np.minimum((total - spent) // eval_freq, len(result.steps) - 1)
        place = np.minimum(np.arange(n), last[:, None])
        greedy, training, guard_share = (
            np.take_along_axis(found, place, axis=1)
            for found in (result.greedy_return, result.training_return, result.guard_share)
        )
        curve = Curve(np.arange(n) * eval_freq, greedy, spent)
        return cls(curve, training, guard_share, control, scratch, level)

    @property
    def initial_value(self) -> float | None:
        """The initial value that is the same as this control, mean over seeds; None if none is."""
        return None if self.level is None else self.level.initial_value

    def charged(self, scratch: "Arm") -> Curve:
        """Return the curve over total steps, source steps included (``charge_source``)."""
        return charge_source(scratch.curve, self.curve)

    def take(self, seeds: IntArray) -> "Arm":
        """Return the arm with the seeds in these rows, in this order."""
        curve = Curve(self.curve.steps, self.curve.values[seeds], self.curve.source_steps[seeds])
        level = None if self.level is None else self.level.take(seeds)
        training, guard_share = self.training_return[seeds], self.guard_share[seeds]
        unlearnt = {source: each[seeds] for source, each in self.unlearnt.items()}
        return Arm(curve, training, guard_share, self.control, self.scratch, level, unlearnt)

    def strong_gain(self, scratch: "Arm") -> FloatArray:
        """Return the area under the charged curve minus that of scratch, (K,), in return.

        Both are normalised (:func:`mean_return`); a difference within their rounding is 0.
        """
        return difference(mean_return(self.charged(scratch)), mean_return(scratch.curve))


def concatenated(arms: Sequence[Arm]) -> Arm:
    """Return the arms of several batches of seeds as one arm of all seeds."""
    curve = Curve(
        arms[0].curve.steps,
        np.concatenate([arm.curve.values for arm in arms]),
        np.concatenate([arm.curve.source_steps for arm in arms]),
    )
    training = np.concatenate([arm.training_return for arm in arms])
    guard_share = np.concatenate([arm.guard_share for arm in arms])
    levels = [arm.level for arm in arms if arm.level is not None]
    level = concatenated_levels(levels) if levels else None
    unlearnt = {
        source: np.concatenate([arm.unlearnt[source] for arm in arms])
        for source in arms[0].unlearnt
    }
    return Arm(curve, training, guard_share, arms[0].control, arms[0].scratch, level, unlearnt)


def best_from_scratch(arms: Mapping[str, Arm], failed: Collection[str] = ()) -> str:
    """Return the name of the arm that learns from scratch with the highest mean return."""
    own = arms[SCRATCH]
    names = [name for name in scratch_names(arms) if name not in failed]
    return max(names, key=lambda name: float(mean_return(arms[name].charged(own)).mean()))


def scratch_names(arms: Mapping[str, Arm]) -> tuple[str, ...]:
    """Return the names of the arms that learn from scratch."""
    return tuple(name for name, arm in arms.items() if name == SCRATCH or arm.scratch)
