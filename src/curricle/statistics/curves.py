"""Learning curves, the return of an arm at its checkpoints with a row a seed, and measures of them.

A row may begin with NaN, where no episode of the seed has ended yet. A leading NaN never counts as
reaching a threshold; everywhere else the seed's first measured value stands for it.

Weak transfer ignores the steps spent on source tasks. Strong transfer charges them, so that both
arms are compared at the same total number of steps (``charge_source``).

Sources: Taylor and Stone, "Transfer learning for reinforcement learning domains: a survey", JMLR
10, 2009; Narvekar et al., "Curriculum learning for reinforcement learning domains: a framework and
survey", JMLR 21(181), 2020.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, Frozen, IntArray, frozen
from curricle.display import block, curves
from curricle.errors import SettingError
from curricle.statistics.intervals import seed_line
from curricle.text import brief_repr, counted

SCRATCH = "scratch"  # the arm that learns the target alone, with which others are compared
ROUNDING = 1e-7  # relative difference that rounding causes between two exact mean returns


@dataclass(frozen=True, eq=False)
class Curve(Frozen):
    """The learning curves of an arm, a row a seed. The arrays are copied and frozen.

    Attributes
    ----------
    steps : (T,) int64
        Checkpoints in target steps, from 0 or later, increasing.
    values : (K, T) float64
        Unshaped return at the checkpoints; NaN only at the beginning of a row, and never at its
        end.
    source_steps : (K,) int64
        Steps of a seed in source tasks before its first target step; a single number stands for all
        seeds.

    Raises
    ------
    SettingError
        If a shape, a checkpoint or a value breaks the rules above.

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
        infinite, missing = np.isinf(values), np.isnan(values)
        if infinite.any():
            k, t = np.argwhere(infinite)[0]
            raise SettingError(
                f"values must not be infinite: seed {k}, checkpoint {t} is {values[k, t]}"
            )
        leading = np.logical_and.accumulate(missing, axis=1)
        leading[:, -1] = False  # the last checkpoint is always measured
        if (missing & ~leading).any():
            k, t = np.argwhere(missing & ~leading)[0]
            raise SettingError(
                "values may be NaN only before a seed's first measurement:"
                f" seed {k}, checkpoint {t} is NaN"
            )
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
        """Return the values with a seed's first measured value in place of its NaN, (K, T).

        Examples
        --------
        >>> Curve(np.array([0, 100]), np.array([[np.nan, -4.0]])).filled()
        array([[-4., -4.]])
        """
        missing = np.isnan(self.values)
        first = np.take_along_axis(self.values, missing.sum(axis=1, keepdims=True), axis=1)
        return np.where(missing, first, self.values)


def smooth(values: FloatArray, window: int) -> FloatArray:
    """Return the trailing mean of each row over the last `window` checkpoints; NaN stays."""
    mean = values.copy()
    if not 1 <= window <= mean.shape[1] or int(window) != window:
        raise SettingError(
            f"window must be a whole number of checkpoints from 1 to {mean.shape[1]}: got {window}"
        )
    original = mean.copy()
    for lag in range(1, int(window)):
        # A running mean, newest first: a constant row stays so, and rounding moves no threshold.
        step = (original[:, :-lag] - mean[:, lag:]) / (lag + 1)
        mean[:, lag:] += np.where(np.isnan(step), 0.0, step)
    return mean


def charge_source(baseline: Curve, transfer: Curve) -> Curve:
    """Return a transfer curve over total steps, source steps included (strong transfer).

    At checkpoint x, seed k has the baseline's first value while x < source_steps_k + steps_0, and
    then its value at x - source_steps_k target steps, interpolated between checkpoints.
    """
    require_pair(baseline, transfer)
    require_no_source(baseline)
    steps, alone = baseline.steps, baseline.filled()
    target = steps - transfer.source_steps[:, np.newaxis]
    training = target < transfer.steps[0]
    late, shifted = (
        np.stack([np.interp(x, steps, row) for x, row in zip(target, rows, strict=True)])
        for rows in (alone, transfer.filled())
    )
    first = np.broadcast_to(alone[:, :1], alone.shape)
    # Where learning falls below its first value, that value is a gift: the baseline begun later
    # has a larger area. Taken off, a source that teaches nothing gains nothing.
    gift = np.trapezoid(np.where(training, first, late) - alone, steps, axis=1).mean()
    if gift > 0:
        first = first - gift / np.trapezoid(1.0 * training, steps, axis=1).mean()
    return Curve(steps, np.where(training, first, shifted))


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


def jumpstart(baseline: Curve, transfer: Curve, *, strong: bool = False) -> FloatArray:
    """Return how much better transfer starts than learning from scratch (Taylor and Stone 2009).

    transfer_k(steps_0) - baseline_k(steps_0 + c_k), with c_k = 0 if weak and source_steps_k if
    strong: the baseline has then learnt for as many steps as the sources took.

    Parameters
    ----------
    baseline, transfer : Curve
        The same K seeds and T checkpoints.
    strong : bool
        Whether to charge the source steps.

    Returns
    -------
    (K,) float64
        Return; NaN if the source steps exceed the baseline's curve, which is interpolated.

    Raises
    ------
    SettingError
        If the curves do not pair, or if strong and `baseline` has source steps.

    Examples
    --------
    >>> steps = np.array([0, 100, 200])
    >>> scratch = Curve(steps, np.array([[0.0, 1.0, 5.0]]))
    >>> helped = Curve(steps, np.array([[4.0, 5.0, 5.0]]), np.array([150]))
    >>> jumpstart(scratch, helped), jumpstart(scratch, helped, strong=True)
    (array([4.]), array([1.]))
    """
    require_pair(baseline, transfer)
    first, rows = transfer.filled()[:, 0], baseline.filled()
    by_then: FloatArray = rows[:, 0]
    if strong:
        require_no_source(baseline)
        start = transfer.steps[0] + transfer.source_steps
        pairs = zip(start, rows, strict=True)
        by_then = np.array([np.interp(x, baseline.steps, row, right=np.nan) for x, row in pairs])
    return np.subtract(first, by_then)


def asymptotic_performance(curve: Curve, *, fraction: float = 0.1) -> FloatArray:
    """Return the mean return over the last checkpoints, (K,) (Taylor and Stone 2009).

    mean(values_{T - n}, ..., values_{T - 1}), n = fraction T rounded, at least 1; `fraction` is
    above 0 and at most 1, or SettingError. For strong transfer pass ``charge_source(baseline,
    transfer)``.

    Examples
    --------
    >>> asymptotic_performance(Curve(np.array([0, 1, 2]), np.array([[0.0, 3.0, 5.0]])))
    array([5.])
    """
    if not 0 < fraction <= 1:
        raise SettingError(f"fraction must be above 0 and at most 1: got {fraction}")
    last = max(1, round(fraction * curve.steps.size))
    mean: FloatArray = curve.filled()[:, -last:].mean(axis=1)
    return mean


def mean_return(curve: Curve) -> FloatArray:
    """Return the normalised area under the learning curve, (K,), in return.

    (area from the first to the last checkpoint) / (steps between them), by the trapezoid rule: the
    total reward of Taylor and Stone (2009) divided by the steps. For strong transfer pass
    ``charge_source(baseline, transfer)``. SettingError if the curve has a single checkpoint.

    Examples
    --------
    >>> mean_return(Curve(np.array([0, 100, 400]), np.array([[0.0, 4.0, 4.0]])))
    array([3.5])
    """
    if curve.steps.size < 2:
        raise SettingError(f"an area needs at least 2 checkpoints: got {curve.steps.size}")
    area = np.asarray(np.trapezoid(curve.filled(), curve.steps, axis=1), dtype=np.float64)
    return area / float(curve.steps[-1] - curve.steps[0])


def _whole(name: str, array: IntArray) -> IntArray:
    """Return an int64 copy of `array`, or raise SettingError unless it holds integers."""
    copy = np.array(array)
    if copy.dtype.kind not in "iu":
        raise SettingError(f"{name} must be integers: got dtype {copy.dtype}")
    return copy.astype(np.int64)
