"""Checks of single arguments: a check returns the plain value, or states rule, value and place."""

import math
import os
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.errors import CurricleError

BEYOND_64_BITS = 2**63  # the first whole number that a signed integer of 64 bits cannot hold
LONGEST_NAME = 100  # characters of a name: more do not fit into tables, pictures and names of files
LONGEST_VALUE = 200  # characters of a value in an error message


def whole_number(name: str, value: Any, least: int, error: type[CurricleError]) -> int:
    """Return `value` as an int, or raise `error` unless it is a whole number >= `least`."""
    # Compiled loops count in 64 bits.
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
    """Return `value` as a float, or raise `error` unless it is finite and in [low, high]."""
    if not _is_real(value):
        raise error(f"{name} must be a number: got {value!r}")
    try:
        finite = math.isfinite(value)
    except OverflowError:  # an integer beyond every float
        finite = False
    if not finite:
        raise error(f"{name} must be finite: got {_shown(value)}")
    if not low <= float(value) <= high:
        limits = f"lie in [{low:g}, {high:g}]" if high < math.inf else f"be at least {low:g}"
        raise error(f"{name} must {limits}: got {value:g}")
    return float(value)


def numbers(name: str, values: Any, error: type[CurricleError]) -> FloatArray:
    """Return a new float64 array of `values`, or raise `error` if they are no array of numbers."""
    try:
        if values is None or np.iscomplexobj(values):  # NumPy would make nan and real parts of them
            raise TypeError
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # an integer beyond every float overflows
        raise error(f"{name} must be an array of numbers: got {brief(values)}") from None


def indices(name: str, values: object, size: int, error: type[CurricleError]) -> IntArray:
    """Return `values` as an array of whole numbers in 0..size-1, or raise `error`."""
    try:
        array = np.array(values)  # a copy: nobody changes it after the check
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "iu" or (array.size and not 0 <= array.min() <= array.max() < size):
        raise error(f"{name} must be whole numbers in 0..{size - 1}: got {brief(values)}")
    return array.astype(np.int64, copy=False)


def one_of(name: str, value: Any, valid: Iterable[Any], error: type[CurricleError]) -> None:
    """Raise `error` unless `value` is valid; the message lists the valid values."""
    valid = tuple(valid)
    if not isinstance(value, str | Integral) or value is True or value not in valid:
        raise error(f"{name} must be one of {listed(map(str, valid))}: got {value!r}")


def listed(names: Iterable[str]) -> str:
    """Return names as a list, separated by semicolons where a name contains a comma."""
    names = tuple(names)
    return ("; " if any("," in name for name in names) else ", ").join(names)


def fit_name(noun: str, value: object, error: type[CurricleError]) -> None:
    """Raise `error` unless `value` can be the name of a study, an arm or a task."""
    why = unfit_name(value) if isinstance(value, str) else f"must be text: got {value!r}"
    if why:
        raise error(f"the name of {noun} {why}")


def unfit_name(text: str) -> str:
    """Return why a text cannot be a name, as the end of a sentence; empty if it can."""
    if not 0 < len(text) <= LONGEST_NAME:
        count = f"{len(text)} of them, " if text else ""
        return f"must have 1 to {LONGEST_NAME} characters: got {count}{text[:20]!r}"
    # Control and format characters are invisible, and some reverse the text around them.
    return "" if text.isprintable() else f"must be printable: got {text!r}"


def instance(name: str, value: object, kind: type, error: type[CurricleError]) -> None:
    """Raise `error` unless `value` is an instance of `kind`."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOaeio" else "a"
        raise error(f"{name} must be {article} {kind.__name__}: got {brief(value)}")


def text(name: str, value: object, error: type[CurricleError]) -> None:
    """Raise `error` unless `value` is text that is not empty."""
    if not isinstance(value, str) or not value:
        raise error(f"{name} must be text, not empty: got {value!r}")


def brief(value: object) -> str:
    """Return a value as an error shows it: on one line, and cut where it is long."""
    try:
        line = " ".join(repr(value).split())
    except ValueError:  # an integer of thousands of digits has no text
        return f"a {type(value).__name__}"
    return line if len(line) <= LONGEST_VALUE else f"{line[: LONGEST_VALUE - 6]} [...]"


def physical_memory() -> int:
    """Return the machine's memory in bytes, 8 GiB where it is unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 8 * 2**30


def check_memory(name: str, needed: int, error: type[CurricleError]) -> None:
    """Raise `error` unless `needed` bytes are at most half of the machine's memory."""
    # Otherwise an allocation fails with an exception of NumPy's, or succeeds and ends the process.
    limit = physical_memory() // 2
    if needed > limit:
        size = f"{needed / 1e9:.3g} GB" if needed < 2**64 else "more than 2^64 bytes"
        raise error(
            f"{name} must fit half of the machine's memory, {limit / 1e9:.3g} GB: it takes {size}"
        )


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _shown(value: object) -> str:
    """Return a number as an error shows it; an integer of thousands of digits has no text."""
    return f"a number of {value.bit_length():,} bits" if isinstance(value, int) else repr(value)
