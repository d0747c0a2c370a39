"""Learning curves: the return of one arm at each checkpoint, one row per seed.

A row may begin with NaN, where no episode of the seed has ended yet. A leading NaN never counts as
reaching a threshold; everywhere else the seed's first measured value is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray, IntArray
from curricle.display import block, brief_repr, curves
from curricle.errors import SettingError
from curricle.frozen_arrays import Frozen, frozen
from curricle.statistics.intervals import seed_line
from curricle.text_tables import counted

SCRATCH = "scratch"
"""Name of the arm that learns the target from scratch; all others are compared with it."""
ROUNDING = 1e-7
"""Relative difference of two mean returns that rounding can cause in exact evaluations."""


@dataclass(frozen=True, eq=False)
class Curve(Frozen):
    """The learning curves of one arm, one row per seed.

    Attributes
    ----------
    steps : (T,) int64
        Checkpoints in target steps, from 0 or later, increasing.
    values : (K, T) float64
        Unshaped return at each checkpoint. NaN is allowed only in leading places of a row, before
        the seed's first measurement; the last place is always measured.
    source_steps : (K,) int64
        Steps each seed spent on source tasks before its first target step; a single number is
        repeated for all seeds.

    Raises
    ------
    SettingError
        If a shape, a checkpoint or a value breaks the rules above.

    Notes
    -----
    The arrays are copied and frozen.

    Examples
    --------
    >>> curve = Curve(np.array([0, 100, 200]), np.array([[-9.0, -4.0, -1.0]]))
    >>> curve.source_steps
    array([0])
    """

    steps: IntArray
    values: FloatArray
    source_steps: IntArray = field(default_factory=lambda: np.zeros((), dtype=np.int64))

    __repr__ = brief_repr

    def _repr_html_(self) -> str:
        line = seed_line("", self.steps, self.filled())
        title = f"Curve of {counted(len(self.values), 'seed')}"
        return block(title, curves([line], "target steps", "return"))

    def __post_init__(self) -> None:
        steps = _whole("steps", self.steps)
        if steps.ndim != 1 or steps.size == 0:
            raise SettingError(f"steps must have shape (T,) with T at least 1: got {steps.shape}")
        if steps[0] < 0:
            raise SettingError(f"steps must be at least 0: checkpoint 0 is {steps[0]}")
        if np.any(np.diff(steps) <= 0):
            place = int(np.argmax(np.diff(steps) <= 0)) + 1
            raise SettingError(
                f"steps must be increasing: checkpoint {place} is {steps[place]}"
                f" after {steps[place - 1]}"
            )
        values = np.array(self.values, dtype=np.float64)
        if values.ndim != 2 or values.shape[0] == 0 or values.shape[1] != steps.size:
            raise SettingError(
                f"values must have shape (K, {steps.size}) with K at least 1: got {values.shape}"
            )
        _check_measured(values)
        source = _whole("source_steps", self.source_steps)
        if source.ndim != 0 and source.shape != values.shape[:1]:
            raise SettingError(
                f"source_steps must have shape ({values.shape[0]},), one per seed:"
                f" got {source.shape}"
            )
        if np.any(source < 0):
            raise SettingError(f"source_steps must be at least 0: got {source.min()}")
        source = np.array(np.broadcast_to(source, values.shape[:1]))
        for name, array in (("steps", steps), ("values", values), ("source_steps", source)):
            object.__setattr__(self, name, frozen(array))

    @classmethod
    def of(cls, result: Any, source_steps: npt.ArrayLike = 0) -> Curve:
        """Return the greedy returns of a :class:`LearningResult` as a curve.

        `source_steps` is an int or (K,), as :meth:`CurriculumResult.source_steps` gives them.
        """
        return cls(result.steps, result.greedy_return, np.asarray(source_steps))

    def filled(self) -> FloatArray:
        """Return the values with each seed's first measured value in its leading NaN, (K, T).

        Examples
        --------
        >>> Curve(np.array([0, 100]), np.array([[np.nan, -4.0]])).filled()
        array([[-4., -4.]])
        """
        missing = np.isnan(self.values)
        first = np.take_along_axis(self.values, missing.sum(axis=1, keepdims=True), axis=1)
        return np.where(missing, first, self.values)


def smooth(values: FloatArray, window: int) -> FloatArray:
    """Return the trailing mean of each row over the last `window` checkpoints.

    smooth_t = mean(values_{t - window + 1}, ..., values_t), over fewer at the start. Leading NaN is
    left out and stays. A constant row stays exactly constant, so that rounding moves no threshold.
    """
    mean = values.copy()
    if not 1 <= window <= mean.shape[1] or int(window) != window:
        raise SettingError(
            f"window must be a whole number of checkpoints from 1 to {mean.shape[1]}: got {window}"
        )
    original = mean.copy()
    for lag in range(1, int(window)):
        step = (original[:, :-lag] - mean[:, lag:]) / (lag + 1)  # running mean, newest first
        mean[:, lag:] += np.where(np.isnan(step), 0.0, step)
    return mean


def charge_source(baseline: Curve, transfer: Curve) -> Curve:
    """Return a transfer curve over total steps, source steps included (strong transfer).

    At checkpoint x, seed k has the baseline's first value while x < source_steps_k + steps_0, and
    from there on its own value at x - source_steps_k target steps. Any measure of the result is
    that measure under strong transfer, at the same total budget (Narvekar et al. 2020). Values
    between checkpoints are interpolated, so the start of learning is exact to one checkpoint.

    Where learning falls below its first value, that value would be a gift: the baseline itself,
    begun later, would have a larger area. What it would gain, mean over seeds, is taken off the
    first value. So a source that teaches nothing gains nothing, and no strong gain exceeds the weak
    one over the same target steps.
    """
    require_pair(baseline, transfer)
    require_no_source(baseline)
    steps, alone = baseline.steps, baseline.filled()
    target = steps - transfer.source_steps[:, np.newaxis]
    training = target < transfer.steps[0]
    late, own = (
        np.stack([np.interp(x, steps, row) for x, row in zip(target, rows, strict=True)])
        for rows in (alone, transfer.filled())
    )
    first = np.broadcast_to(alone[:, :1], alone.shape)
    gift = np.trapezoid(np.where(training, first, late) - alone, steps, axis=1).mean()
    if gift > 0:
        first = first - gift / np.trapezoid(1.0 * training, steps, axis=1).mean()
    return Curve(steps, np.where(training, first, own))


def require_pair(baseline: Curve, transfer: Curve) -> None:
    """Raise SettingError unless two curves have the same seeds K and checkpoints (T,)."""
    ours, theirs = baseline.values.shape, transfer.values.shape
    if ours[0] != theirs[0]:
        raise SettingError(
            "baseline and transfer must hold the same seeds, row by row:"
            f" got {ours[0]} and {theirs[0]} seeds"
        )
    if not np.array_equal(baseline.steps, transfer.steps):
        raise SettingError(
            "baseline and transfer must share their checkpoints:"
            f" got {ours[1]} ending at {baseline.steps[-1]} and"
            f" {theirs[1]} ending at {transfer.steps[-1]}"
        )


def require_no_source(baseline: Curve) -> None:
    """Raise SettingError if any seed of the baseline spent steps on source tasks."""
    if np.any(baseline.source_steps):
        raise SettingError(
            "the baseline of a strong comparison must have no source steps:"
            f" got {baseline.source_steps.max()}"
        )


def _whole(name: str, array: IntArray) -> IntArray:
    """Return an int64 copy of `array`, refusing anything but integers."""
    copy = np.array(array)
    if copy.dtype.kind not in "iu":
        raise SettingError(f"{name} must be integers: got dtype {copy.dtype}")
    return copy.astype(np.int64)


def _check_measured(values: FloatArray) -> None:
    """Raise unless `values` (K, T) is finite but for NaN in leading places."""
    infinite = np.isinf(values)
    if infinite.any():
        seed, place = np.argwhere(infinite)[0]
        raise SettingError(
            f"values must not be infinite: seed {seed}, checkpoint {place} is {values[seed, place]}"
        )
    missing = np.isnan(values)
    leading = np.logical_and.accumulate(missing, axis=1)
    leading[:, -1] = False  # the last checkpoint is always measured
    if np.any(missing & ~leading):
        seed, place = np.argwhere(missing & ~leading)[0]
        raise SettingError(
            "values may be NaN only before a seed's first measurement:"
            f" seed {seed}, checkpoint {place} is NaN"
        )
