"""Aggregation of several sources into one potential: phi = g(phi_1, ..., phi_N) (paper E6).

A source that knows nothing of a pair (its mapping leaves it unmapped) has NaN there, and an
aggregate skips NaN: it is that of the sources that know something. Where none does, phi is one
stated value, 0 unless another is given.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from curricle.arrays import FloatArray
from curricle.errors import CurriculumError

Aggregate = Callable[[FloatArray], FloatArray]
"""Any function (N, S, A) -> (S, A) that skips NaN, as ``numpy.nanmedian`` along axis 0 does.

Where all sources are NaN its result does not count; it is never called with such pairs.
"""


def maximum(potentials: FloatArray) -> FloatArray:
    """Return max_i phi_i(s, a), the most optimistic source. (N, S, A) -> (S, A).

    Over the sources that are not NaN, as in all aggregates here; NaN where all are.

    Examples
    --------
    >>> maximum(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[3., 5.]])
    """
    return np.asarray(np.fmax.reduce(_given(potentials), axis=0))


def mean(potentials: FloatArray) -> FloatArray:
    """Return the mean of phi_i(s, a) over the sources. (N, S, A) -> (S, A).

    Examples
    --------
    >>> mean(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[2., 5.]])
    """
    known = np.count_nonzero(~np.isnan(_given(potentials)), axis=0)
    return np.asarray(total(potentials) / np.maximum(known, 1))


def minimum(potentials: FloatArray) -> FloatArray:
    """Return min_i phi_i(s, a), the most pessimistic source. (N, S, A) -> (S, A).

    Examples
    --------
    >>> minimum(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[1., 5.]])
    """
    return np.asarray(np.fmin.reduce(_given(potentials), axis=0))


def total(potentials: FloatArray) -> FloatArray:
    """Return sum_i phi_i(s, a), Svetlik's aggregate (paper E4). (N, S, A) -> (S, A).

    Examples
    --------
    >>> total(np.array([[[1.0, 5.0]], [[3.0, np.nan]]]))
    array([[4., 5.]])
    """
    potentials = _given(potentials)
    unknown = np.isnan(potentials)
    if not unknown.any():
        return np.asarray(potentials.sum(axis=0))
    known = np.where(unknown, 0.0, potentials).sum(axis=0)
    return np.where(unknown.all(axis=0), np.nan, known)


def _given(values: FloatArray) -> FloatArray:
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
    """Return the aggregate of potentials, (N, S, A) -> (S, A), and where all are NaN one value."""
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
        asked = f"{name} returned {result[state, action]} at state {state}, action {action}"
        skipped = int(unknown[:, state, action].sum())
        if skipped:
            raise CurriculumError(
                "an aggregate must skip NaN, which stands for a source that knows nothing of a "
                f"pair: {asked}, of which {skipped} of {len(potentials)} sources know nothing; "
                "numpy.nanmean skips NaN, and mappings with an unmapped_value have none"
            )
        raise CurriculumError(f"an aggregate must return finite values: {asked}")
    return np.where(nowhere, unknown_value, result) if nowhere.any() else result


def aggregate_numbers(function: Aggregate, potentials: Sequence[float]) -> float:
    """Return the aggregate of N finite numbers, as :func:`aggregate` does for one pair.

    The aggregates of this module need no array, which would take most of the time.
    """
    for known, plain in _OF_NUMBERS:
        if function is known and math.isfinite(result := plain(potentials)):
            return result
    return float(aggregate(function, np.array(potentials).reshape(-1, 1, 1))[0, 0])


_OF_NUMBERS: tuple[tuple[Aggregate, Callable[[Sequence[float]], float]], ...] = (
    (mean, lambda numbers: sum(numbers) / len(numbers)),
    (maximum, max),
    (minimum, min),
    (total, sum),
)
UNCHANGED_ALONE = tuple(known for known, _ in _OF_NUMBERS)
"""Aggregates for which the aggregate of one potential is that potential."""
