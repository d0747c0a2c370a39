"""Checks of single arguments: each returns the value made plain, or says rule, value and place."""

import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.errors import CurricleError

BEYOND_64_BITS = 2**63
"""The first whole number that a signed integer of 64 bits cannot hold."""


def whole_number(name: str, value: Any, least: int, error: type[CurricleError]) -> int:
    """Return `value` as an int, or raise `error` unless it is a whole number of at least `least`.

    Compiled loops count in 64 bits, so that larger numbers are refused too.

    Examples
    --------
    >>> from curricle.errors import SettingError
    >>> whole_number("budget", 1e4, 1, SettingError)
    10000
    """
    if _is_real(value) and not -BEYOND_64_BITS < value < BEYOND_64_BITS and value == value:
        raise error(f"{name} must be a whole number below 2^63: got {_shown(value)}")
    if not _is_real(value) or value != value // 1 or value < least:
        raise error(f"{name} must be a whole number, at least {least}: got {value!r}")
    return int(value)


def number(
    name: str,
    value: Any,
    error: type[CurricleError],
    low: float = -math.inf,
    high: float = math.inf,
) -> float:
    """Return `value` as a float, or raise `error` unless it is finite and in [low, high].

    Examples
    --------
    >>> from curricle.errors import TaskError
    >>> number("discount", 1, TaskError, low=0, high=1)
    1.0
    """
    if not _is_real(value):
        raise error(f"{name} must be a number: got {value!r}")
    if not _is_finite(value):
        raise error(f"{name} must be finite: got {_shown(value)}")
    if not low <= float(value) <= high:
        limits = f"lie in [{low:g}, {high:g}]" if high < math.inf else f"be at least {low:g}"
        raise error(f"{name} must {limits}: got {value:g}")
    return float(value)


def numbers(name: str, values: Any, error: type[CurricleError]) -> FloatArray:
    """Return a new float64 array of `values`, or raise `error` if they are no array of numbers.

    Examples
    --------
    >>> from curricle.errors import PotentialError
    >>> numbers("phi", [[1, 2]], PotentialError)
    array([[1., 2.]])
    """
    try:
        if values is None or np.iscomplexobj(values):  # NumPy would make nan and real parts of them
            raise TypeError
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise error(f"{name} must be an array of numbers: got {values!r}") from None


def one_of(name: str, value: Any, valid: Iterable[Any], error: type[CurricleError]) -> None:
    """Raise `error` unless `value` is one of the valid ones, which the message lists."""
    valid = tuple(valid)
    if not isinstance(value, str | Integral) or value is True or value not in valid:
        raise error(f"{name} must be one of {', '.join(map(str, valid))}: got {value!r}")


def instance(name: str, value: Any, kind: type, error: type[CurricleError]) -> None:
    """Raise `error` unless `value` is an instance of `kind`."""
    if not isinstance(value, kind):
        raise error(f"{name} must be a {kind.__name__}: got {value!r}")


def _is_real(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond every float
        return False


def _shown(value: Any) -> str:
    """Return a number as an error shows it; an integer of thousands of digits has no text."""
    return f"a number of {value.bit_length():,} bits" if isinstance(value, int) else repr(value)
