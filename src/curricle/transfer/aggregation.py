"""Aggregation of several sources into one potential: phi = g(phi_1, ..., phi_N) (paper E6)."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from curricle.array_types import FloatArray
from curricle.errors import CurriculumError

Aggregate = Callable[[FloatArray], FloatArray]
"""Any function (N, S, A) -> (S, A)."""


def maximum(potentials: FloatArray) -> FloatArray:
    """Return max_i phi_i(s, a), the most optimistic source. (N, S, A) -> (S, A).

    Examples
    --------
    >>> maximum(np.array([[[1.0, 5.0]], [[3.0, 2.0]]]))
    array([[3., 5.]])
    """
    return np.asarray(potentials.max(axis=0))


def mean(potentials: FloatArray) -> FloatArray:
    """Return the mean of phi_i(s, a) over the sources. (N, S, A) -> (S, A).

    Examples
    --------
    >>> mean(np.array([[[1.0, 5.0]], [[3.0, 2.0]]]))
    array([[2. , 3.5]])
    """
    return np.asarray(potentials.sum(axis=0) / len(potentials))  # quicker than mean(axis=0)


def minimum(potentials: FloatArray) -> FloatArray:
    """Return min_i phi_i(s, a), the most pessimistic source. (N, S, A) -> (S, A).

    Examples
    --------
    >>> minimum(np.array([[[1.0, 5.0]], [[3.0, 2.0]]]))
    array([[1., 2.]])
    """
    return np.asarray(potentials.min(axis=0))


def total(potentials: FloatArray) -> FloatArray:
    """Return sum_i phi_i(s, a), Svetlik's aggregate (paper E4). (N, S, A) -> (S, A).

    Examples
    --------
    >>> total(np.array([[[1.0, 5.0]], [[3.0, 2.0]]]))
    array([[4., 7.]])
    """
    return np.asarray(potentials.sum(axis=0))


def aggregate(function: Aggregate, potentials: FloatArray) -> FloatArray:
    """Return the aggregate of potentials, (N, S, A) -> (S, A); CurriculumError unless it fits.

    Its shape must be (S, A) and its values finite.
    """
    result = np.asarray(function(potentials), dtype=np.float64)
    name = getattr(function, "__name__", repr(function))
    if result.shape != potentials.shape[1:]:
        raise CurriculumError(
            f"an aggregate must return shape {potentials.shape[1:]}: {name} returned {result.shape}"
        )
    if not np.isfinite(result).all():
        state, action = np.argwhere(~np.isfinite(result))[0]
        raise CurriculumError(
            f"an aggregate must return finite values: {name} returned {result[state, action]} at "
            f"state {state}, action {action}"
        )
    return result


def aggregate_numbers(function: Aggregate, potentials: Sequence[float]) -> float:
    """Return the aggregate of N numbers, as :func:`aggregate` does for one state and action.

    The aggregates of this module need no array, which would take most of the time.

    Examples
    --------
    >>> aggregate_numbers(mean, [1.0, 4.0])
    2.5
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
