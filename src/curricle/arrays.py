"""Types of arrays by what they hold, and arrays that nobody can write to.

Compiled loops read successors and strides without bounds checks: an array that could be changed
after its validation would let them read and write anywhere.
"""

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
FloatTable = npt.NDArray[np.floating[Any]]  # float32 or float64, as a :class:`Storage` says
Array = TypeVar("Array", bound=npt.NDArray[Any])


class _ReadOnly:
    """The memory of an array as NumPy may see it: it cannot be made writable again."""

    def __init__(self, array: npt.NDArray[Any]):
        self._array = array
        shown = array.__array_interface__
        self.__array_interface__ = {**shown, "data": (shown["data"][0], True)}


def frozen(array: Array) -> Array:
    """Freeze a new array, to which the caller has the only reference, and return it uncopied."""
    if _for_good(array):
        return array
    array.flags.writeable = False
    shown: Any = np.asarray(_ReadOnly(array))
    return shown  # type: ignore[no-any-return]


def adopted(values: npt.ArrayLike, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return `values` as a frozen array of this type: itself if it is one, else a copy."""
    array: Any = values
    fits = type(array) is np.ndarray and array.dtype == dtype and array.flags.c_contiguous
    if fits and _for_good(array):
        return array  # type: ignore[no-any-return]
    return frozen(np.array(values, dtype=dtype, order="C"))


def _for_good(array: npt.NDArray[Any]) -> bool:
    """Return whether nobody can write to an array."""
    # Memory of `bytes` does not suffice: NumPy makes such arrays writable if asked to.
    owner: Any = array
    while type(owner) is np.ndarray:
        owner = owner.base
    return isinstance(owner, _ReadOnly)


class Frozen:
    """A frozen dataclass whose copies and pickles have frozen arrays, and its fields alone."""

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, refrozen(value))


def refrozen(value: object) -> Any:
    """Return an array frozen, also within named tuples; anything else as it is."""
    if isinstance(value, np.ndarray):  # of a subclass too, such as a file mapped into memory
        return adopted(value, value.dtype)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(refrozen, value))
    return value
