"""Aggregates of several sources into one potential: phi = g(phi_1, ..., phi_N) (paper E6).

A source whose mapping leaves a pair unmapped has NaN there, which aggregates skip. Where all
sources have NaN, phi is `unknown_value`. A new aggregate is a function here and a line of
``BUILT_IN``, which names it in study files; each adds an arm to the trials of forecasts.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from curricle.arrays import FloatArray
from curricle.errors import CurriculumError
from curricle.learning.value_lookup import MAXIMUM, MEAN, MINIMUM, TOTAL

Aggregate = Callable[[FloatArray], FloatArray]
"""Any function (N, S, A) -> (S, A) that skips NaN, as ``numpy.nanmedian`` along axis 0 does.

It is never called with pairs at which all sources are NaN.
"""


def minimum(potentials: FloatArray) -> FloatArray:
    """Return min_i phi_i(s, a), the most pessimistic source. (N, S, A) -> (S, A).

    Like all aggregates here it skips sources with NaN, and is NaN where all sources are.

    Examples
    --------
    >>> minimum(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[1., 5.]])
    """
    return np.asarray(np.fmin.reduce(_checked(potentials), axis=0))


def mean(potentials: FloatArray) -> FloatArray:
    """Return the mean of phi_i(s, a) over the sources. (N, S, A) -> (S, A).

    Examples
    --------
    >>> mean(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[2., 5.]])
    """
    counts = np.count_nonzero(~np.isnan(_checked(potentials)), axis=0)
    return np.asarray(total(potentials) / np.maximum(counts, 1))


def maximum(potentials: FloatArray) -> FloatArray:
    """Return max_i phi_i(s, a), the most optimistic source. (N, S, A) -> (S, A).

    Examples
    --------
    >>> maximum(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[3., 5.]])
    """
    return np.asarray(np.fmax.reduce(_checked(potentials), axis=0))


def total(potentials: FloatArray) -> FloatArray:
    """Return sum_i phi_i(s, a), Svetlik's aggregate (paper E4). (N, S, A) -> (S, A).

    Examples
    --------
    >>> total(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[4., 5.]])
    """
    potentials = _checked(potentials)
    unknown = np.isnan(potentials)
    if not unknown.any():
        return np.asarray(potentials.sum(axis=0))
    sums = np.where(unknown, 0.0, potentials).sum(axis=0)
    return np.where(unknown.all(axis=0), np.nan, sums)


class BuiltIn(NamedTuple):
    """An aggregate of the library; the aggregate of a single potential must be that potential."""

    function: Aggregate
    code: int  # its number in compiled loops
    of_numbers: Callable[[Sequence[float]], float]  # of N finite numbers, quicker


BUILT_IN = {
    "minimum": BuiltIn(minimum, MINIMUM, min),
    "mean": BuiltIn(mean, MEAN, lambda numbers: sum(numbers) / len(numbers)),
    "maximum": BuiltIn(maximum, MAXIMUM, max),
    "total": BuiltIn(total, TOTAL, sum),
}
"""The library's aggregates by name; a forecast compares all, in this order."""


def built_in(function: Aggregate) -> BuiltIn | None:
    """Return the entry of an aggregate in ``BUILT_IN``; None for any other function."""
    # Compared by identity: an aggregate may be any callable object, even without a hash.
    return next((entry for entry in BUILT_IN.values() if entry.function is function), None)


def _checked(values: FloatArray) -> FloatArray:
    """Return potentials as an array of at least one, or raise CurriculumError."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu" or array.ndim == 0 or len(array) == 0:
        raise CurriculumError(
            f"an aggregate takes numbers of shape (N, S, A), N at least 1: got {values!r}"
        )
    return array


def aggregate(
    function: Aggregate, potentials: FloatArray, unknown_value: float = 0.0
) -> FloatArray:
    """Return the aggregate, (N, S, A) -> (S, A), of potentials; `unknown_value` if all are NaN."""
    unknown = np.isnan(potentials)
    nowhere = unknown.all(axis=0)
    if nowhere.any():
        potentials = np.where(nowhere, unknown_value, potentials)
    result = np.asarray(function(potentials), dtype=np.float64)
    name = getattr(function, "__name__", repr(function))
    if result.shape != nowhere.shape:
        raise CurriculumError(
            f"an aggregate must return shape {nowhere.shape}: {name} returned {result.shape}"
        )
    bad = ~np.isfinite(result) & ~nowhere
    if bad.any():
        state, action = np.argwhere(bad)[0]
        returned = f"{name} returned {result[state, action]} at state {state}, action {action}"
        if skipped := int(unknown[:, state, action].sum()):
            raise CurriculumError(
                "an aggregate must skip NaN, which stands for a source that knows nothing of a "
                f"pair: {returned}, of which {skipped} of {len(potentials)} sources know nothing; "
                "numpy.nanmean skips NaN, and mappings with an unmapped_value have none"
            )
        raise CurriculumError(f"an aggregate must return finite values: {returned}")
    return np.where(nowhere, unknown_value, result) if nowhere.any() else result


def aggregate_numbers(function: Aggregate, potentials: Sequence[float]) -> float:
    """Return the aggregate of N finite numbers, as :func:`aggregate` does for one pair."""
    entry = built_in(function)
    if entry is not None:
        result = entry.of_numbers(potentials)
        if math.isfinite(result):
            return result
    return float(aggregate(function, np.array(potentials).reshape(-1, 1, 1))[0, 0])
