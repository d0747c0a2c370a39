"""What a comparison found: arms on one axis, what they gained, and how sure that is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.checks import one_of
from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult
from curricle.statistics.curves import Curve, charge_source
from curricle.statistics.hypothesis_tests import holm, probability_of_improvement, sign_flip_test
from curricle.statistics.intervals import Interval, bootstrap, interquartile_mean, paired_difference
from curricle.statistics.metrics import asymptotic_performance, jumpstart, mean_return
from curricle.statistics.thresholds import Times, steps_saved, time_to_threshold

FloatArray = npt.NDArray[np.float64]
SCRATCH = "scratch"
SIGNIFICANT = 0.05
ROUNDING = 1e-7
"""Relative difference of two mean returns that exact evaluations may have by rounding."""
UNKNOWN = Interval(float("nan"), float("nan"), float("nan"), 0.95, 0)


@dataclass(frozen=True, eq=False)
class Arm:
    """One way of learning the target.

    Attributes
    ----------
    curve : Curve
        Greedy return, (K, T), over target steps; with the source steps of each seed.
    training_return : (K, T) float64
    trust : (K, T) float64
        As in :class:`LearningResult`.
    control : bool
        Whether it is a control of another arm.

    Examples
    --------
    >>> flat = np.zeros((2, 3))
    >>> steps = np.array([0, 10, 20])
    >>> arm = Arm(Curve(steps, flat + 4, np.array([10, 10])), flat, flat, False)
    >>> arm.gain(Arm(Curve(steps, flat), flat, flat, False))
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
        """Return a training on the axis that all arms share, each seed up to its own total.

        After what its sources left of it a seed's last value is held.

        Parameters
        ----------
        result : LearningResult
            Of the target.
        spent : (K,) int64
            Source steps of each seed.
        total : int
            Steps that every arm spends, sources included.
        eval_freq : int
            Steps between checkpoints.
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
        """Return the curve on the axis of total steps, source steps included."""
        return charge_source(scratch.curve, self.curve)

    def taken(self, seeds: npt.NDArray[np.int64]) -> "Arm":
        """Return the arm with the seeds in these rows, in this order."""
        curve = Curve(self.curve.steps, self.curve.values[seeds], self.curve.source_steps[seeds])
        return Arm(curve, self.training_return[seeds], self.guard_share[seeds], self.control)

    def gain(self, scratch: "Arm") -> FloatArray:
        """Return the mean height of the charged curve above the direct learner's, (K,).

        A difference within the rounding of both counts as none.
        """
        mine, base = mean_return(self.charged(scratch)), mean_return(scratch.curve)
        noise = ROUNDING * np.maximum(np.abs(mine), np.abs(base))
        return np.where(np.abs(mine - base) > noise, np.subtract(mine, base), 0.0)


@dataclass(frozen=True, eq=False)
class Contrast:
    """One arm against the direct learner, over K seeds.

    Attributes
    ----------
    jumpstart : Interval
        Return at the first target step, above the direct learner's first; sources free (weak).
    saved : Interval
        Target steps to the threshold saved, sources free (weak).
    strong_steps_saved : Interval
        The same with source steps charged (strong).
    gain_free : Interval
        Mean height of the curve above the direct learner's over the target's budget, sources free
        (weak), in return.
    gain : Interval
        The same over the total budget with source steps charged (strong).
    final : Interval
        Return at the end of the total budget, above the direct learner's (strong).
    better : Interval
        Probability that a run of the arm has the higher charged curve on average (strong).
    p : float
        Two-sided, of no gain, by flipping signs of the paired differences.
    adjusted : float
        The same, corrected for the number of arms compared (Holm).
    """

    jumpstart: Interval
    saved: Interval
    strong_steps_saved: Interval
    gain_free: Interval
    gain: Interval
    final: Interval
    better: Interval
    p: float
    adjusted: float

    @property
    def verdict(self) -> str:
        """Whether it paid, in two words."""
        if not self.adjusted < SIGNIFICANT:
            return "no difference shown"
        return "pays" if self.gain.estimate > 0 else "costs more than it brings"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Arms x seeds on one axis. Prints as a table.

    Attributes
    ----------
    target : str
    arms : dict of str to Arm
        The direct learner first.
    budget : int
        Target steps that the weak measures are taken over.
    total : int
        Steps that every arm spends, sources included; the strong measures are taken over these.
    threshold : float
        Return.
    window : int
        Checkpoints that curves are smoothed over before they reach it.
    """

    target: str
    arms: Mapping[str, Arm]
    budget: int
    total: int
    threshold: float
    window: int

    def __getitem__(self, name: str) -> Arm:
        one_of("an arm", name, self.arms, CurriculumError)
        return self.arms[name]

    @property
    def scratch(self) -> Arm:
        """The target learnt directly."""
        return self.arms[SCRATCH]

    @property
    def seeds(self) -> int:
        """K."""
        return len(self.scratch.curve.values)

    def times(self, name: str, *, strong: bool = True) -> Times:
        """Return an arm's steps to the threshold; seeds that never got there are kept."""
        curve = self[name].charged(self.scratch) if strong else self._free(name)
        return time_to_threshold(curve, self.threshold, window=self.window)

    def height(self, name: str) -> Interval:
        """Return the interquartile mean over seeds of an arm's mean charged return."""
        values = mean_return(self[name].charged(self.scratch))
        return bootstrap(values, interquartile_mean)

    @cached_property
    def contrasts(self) -> dict[str, Contrast]:
        """Each arm against the direct learner."""
        names = [name for name in self.arms if name != SCRATCH]
        p = {name: sign_flip_test(self.arms[name].gain(self.scratch)) for name in names}
        adjusted = holm(p)
        return {name: self._contrast(name, p[name], adjusted[name]) for name in names}

    def _free(self, name: str) -> Curve:
        """Return an arm's curve over the target's budget, source steps left aside."""
        curve = self[name].curve
        n = int(np.searchsorted(curve.steps, self.budget, side="right"))
        return Curve(curve.steps[:n], curve.values[:, :n])

    def _contrast(self, name: str, p: float, adjusted: float) -> Contrast:
        scratch, arm = self.scratch, self[name]
        free, base, charged = self._free(name), self._free(SCRATCH), arm.charged(scratch)
        saved = {
            strong: steps_saved(one, other, self.threshold, window=self.window)
            for strong, one, other in ((False, base, free), (True, scratch.curve, charged))
        }
        return Contrast(
            jumpstart=bootstrap(jumpstart(base, free)),
            saved=bootstrap(saved[False]),
            strong_steps_saved=bootstrap(saved[True]),
            gain_free=paired_difference(mean_return(free), mean_return(base)),
            gain=bootstrap(arm.gain(scratch)),
            final=paired_difference(
                asymptotic_performance(charged), asymptotic_performance(scratch.curve)
            ),
            better=probability_of_improvement(mean_return(charged), mean_return(scratch.curve)),
            p=p,
            adjusted=adjusted,
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return the table as data: a dict for each arm, intervals as name, name_low, name_high.

        All have the same keys; what compares an arm with the direct learner is NaN for that one.
        """
        return [{"arm": name, **self._row(name)} for name in self.arms]

    def _row(self, name: str) -> dict[str, Any]:
        times = self.times(name)
        row: dict[str, Any] = {
            "control": self[name].control,
            "seeds": self.seeds,
            "source_steps": float(self[name].curve.source_steps.mean()),
            "steps_to_threshold": times.restricted_mean(),
            "reached": int(times.reached.sum()),
        }
        row |= _spread("return", self.height(name))
        contrast = self.contrasts.get(name)
        for measure in (
            "jumpstart",
            "saved",
            "strong_steps_saved",
            "gain_free",
            "gain",
            "final",
            "better",
        ):
            row |= _spread(measure, UNKNOWN if contrast is None else getattr(contrast, measure))
        row["p"] = float("nan") if contrast is None else contrast.p
        row["p_adjusted"] = float("nan") if contrast is None else contrast.adjusted
        row["verdict"] = "" if contrast is None else contrast.verdict
        return row

    def __str__(self) -> str:
        width = max(len(name) for name in self.arms) + 2
        lines = [
            f"{self.target!r} in {self.total:,} steps, sources charged; {self.seeds} seeds; "
            f"threshold {self.threshold:.4g}",
            f"{'':{width}}{'steps to threshold':>20}  {'mean return (IQM)':<23}"
            f"{'gain over direct':<22}{'sources free':<22}verdict",
        ]
        for name in self.arms:
            times = self.times(name)
            missed = int((~times.reached).sum())
            text = f"{times.restricted_mean():,.0f}" + (f" ({missed} never)" if missed else "")
            text = "> " * (missed > 0) + text
            line = f"{name:{width}}{text:>20}  {_short(self.height(name)):<23}"
            if name != SCRATCH:
                contrast = self.contrasts[name]
                line += f"{_short(contrast.gain):<22}{_short(contrast.gain_free):<22}"
                line += f"{contrast.verdict} (p = {contrast.adjusted:.2g})"
            lines.append(line.rstrip())
        return "\n".join(lines)


def joined(batches: Sequence[Mapping[str, Arm]]) -> dict[str, Arm]:
    """Return arms whose seeds were run in several batches as arms of all seeds."""
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


def _short(interval: Interval) -> str:
    """Return an interval without its number of seeds."""
    return str(interval).rsplit(",", 1)[0]


def _spread(name: str, interval: Interval) -> dict[str, Any]:
    return {name: interval.estimate, f"{name}_low": interval.low, f"{name}_high": interval.high}
