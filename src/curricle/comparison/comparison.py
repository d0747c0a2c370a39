"""The result of a comparison: arms on one axis, their gains, and how certain these are."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any

import numpy as np

from curricle.checks import one_of
from curricle.comparison.arms import Arm
from curricle.errors import CurriculumError
from curricle.statistics.curves import SCRATCH, Curve
from curricle.statistics.hypothesis_tests import holm, probability_of_improvement, sign_flip_test
from curricle.statistics.intervals import (
    Interval,
    interquartile_interval,
    mean_interval,
    paired_difference,
)
from curricle.statistics.metrics import asymptotic_performance, jumpstart, mean_return
from curricle.statistics.thresholds import Times, steps_saved, time_to_threshold

SIGNIFICANT = 0.05
"""Adjusted p-values below this count as a difference."""
UNKNOWN = Interval(float("nan"), float("nan"), float("nan"), 0.95, 0)


@dataclass(frozen=True, eq=False)
class Contrast:
    """One arm against learning from scratch, over K seeds.

    Weak transfer ignores the source steps and is measured over the target's own budget. Strong
    transfer charges them and is measured over the total budget. Gains are returns.

    Attributes
    ----------
    jumpstart : Interval
        Gain at the first target step (weak).
    weak_steps_saved, strong_steps_saved : Interval
        Steps to the threshold saved.
    weak_gain, strong_gain : Interval
        Difference of the normalised areas under the curves.
    asymptotic_gain : Interval
        Gain at the end of the total budget (strong).
    probability_of_improvement : Interval
        That a run of the arm has the larger area under its curve (strong).
    p : float
        Of no strong gain, two-sided, by flipping the signs of the paired differences.
    adjusted_p : float
        The same, corrected for the number of arms compared (Holm).
    """

    jumpstart: Interval
    weak_steps_saved: Interval
    strong_steps_saved: Interval
    weak_gain: Interval
    strong_gain: Interval
    asymptotic_gain: Interval
    probability_of_improvement: Interval
    p: float
    adjusted_p: float

    @property
    def verdict(self) -> str:
        """Either "pays", "costs more than it brings" or "no difference shown"."""
        if not self.adjusted_p < SIGNIFICANT:
            return "no difference shown"
        return "pays" if self.strong_gain.estimate > 0 else "costs more than it brings"


MEASURES = tuple(field.name for field in fields(Contrast) if field.type is Interval)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Arms of K seeds on one axis. Prints as a table.

    Attributes
    ----------
    target : str
    arms : dict of str to Arm
        The learner from scratch first.
    budget : int
        Target steps, over which weak transfer is measured.
    total : int
        Steps of every arm, sources included, over which strong transfer is measured.
    threshold : float
        Return.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold.
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
        """The arm that learns the target from scratch."""
        return self.arms[SCRATCH]

    @property
    def seeds(self) -> int:
        """Number of seeds, K."""
        return len(self.scratch.curve.values)

    def times(self, name: str, *, strong: bool = True) -> Times:
        """Return an arm's steps to the threshold; seeds that never reach it are censored."""
        curve = self[name].charged(self.scratch) if strong else self._weak(name)
        return time_to_threshold(curve, self.threshold, window=self.window)

    def mean_return(self, name: str) -> Interval:
        """Return the interquartile mean over seeds of an arm's area under the strong curve."""
        values = mean_return(self[name].charged(self.scratch))
        return interquartile_interval(values)

    @cached_property
    def contrasts(self) -> dict[str, Contrast]:
        """Each arm against learning from scratch."""
        names = [name for name in self.arms if name != SCRATCH]
        if not names:
            return {}
        p = [sign_flip_test(self.arms[name].strong_gain(self.scratch)) for name in names]
        tests = zip(names, p, holm(p).tolist(), strict=True)
        return {name: self._contrast(name, *both) for name, *both in tests}

    def _weak(self, name: str) -> Curve:
        """Return an arm's curve over the target's budget, without its source steps."""
        curve = self[name].curve
        n = int(np.searchsorted(curve.steps, self.budget, side="right"))
        return Curve(curve.steps[:n], curve.values[:, :n])

    def _contrast(self, name: str, p: float, adjusted_p: float) -> Contrast:
        arm, scratch = self[name], self.scratch
        weak, base = self._weak(name), self._weak(SCRATCH)
        strong, whole = arm.charged(scratch), scratch.curve
        saved = partial(steps_saved, threshold=self.threshold, window=self.window)
        return Contrast(
            jumpstart=mean_interval(jumpstart(base, weak)),
            weak_steps_saved=mean_interval(saved(base, weak)),
            strong_steps_saved=mean_interval(saved(whole, strong)),
            weak_gain=paired_difference(mean_return(weak), mean_return(base)),
            strong_gain=mean_interval(arm.strong_gain(scratch)),
            asymptotic_gain=paired_difference(
                asymptotic_performance(strong), asymptotic_performance(whole)
            ),
            probability_of_improvement=probability_of_improvement(
                mean_return(strong), mean_return(whole)
            ),
            p=p,
            adjusted_p=adjusted_p,
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return the table as data: a dict for each arm, intervals as name, name_low, name_high.

        All have the same keys; those of a :class:`Contrast` are NaN for scratch.
        """
        return [{"arm": name, **self._row(name)} for name in self.arms]

    def _row(self, name: str) -> dict[str, Any]:
        times, contrast = self.times(name), self.contrasts.get(name)
        row: dict[str, Any] = {
            "control": self[name].control,
            "seeds": self.seeds,
            "source_steps": float(self[name].curve.source_steps.mean()),
            "reached": int(times.reached.sum()),
        }
        intervals = {"steps_to_threshold": times.restricted_mean()}
        intervals["mean_return"] = self.mean_return(name)
        for measure in MEASURES:
            intervals[measure] = UNKNOWN if contrast is None else getattr(contrast, measure)
        for measure, interval in intervals.items():
            row[measure] = interval.estimate
            row[f"{measure}_low"], row[f"{measure}_high"] = interval.low, interval.high
        row["p"] = float("nan") if contrast is None else contrast.p
        row["adjusted_p"] = float("nan") if contrast is None else contrast.adjusted_p
        row["verdict"] = "" if contrast is None else contrast.verdict
        return row

    def __str__(self) -> str:
        width = max(len(name) for name in self.arms) + 2
        lines = [
            f"{self.target!r} in {self.total:,} steps, sources charged; "
            f"{self.seeds} seed{'s' * (self.seeds > 1)}; threshold {self.threshold:.4g}",
            f"{'':{width}}{'steps to threshold':>20}  {'mean return (IQM)':<23}"
            f"{'strong gain':<22}{'weak gain':<22}verdict",
        ]
        for name in self.arms:
            times = self.times(name)
            missed = int((~times.reached).sum())
            text = f"{times.steps.mean():,.0f}" + (f" ({missed} never)" if missed else "")
            text = "> " * (missed > 0) + text
            line = f"{name:{width}}{text:>20}  {_short(self.mean_return(name)):<23}"
            if name != SCRATCH:
                contrast = self.contrasts[name]
                line += f"{_short(contrast.strong_gain):<22}{_short(contrast.weak_gain):<22}"
                line += f"{contrast.verdict} (p = {contrast.adjusted_p:.2g})"
            lines.append(line.rstrip())
        return "\n".join(lines)


def _short(interval: Interval) -> str:
    """Return an interval without its number of seeds."""
    return str(interval).rsplit(",", 1)[0]
