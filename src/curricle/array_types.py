"""Names for the types of arrays, by what they hold."""

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
FloatTable = npt.NDArray[np.floating[Any]]
"""float32 or float64, as a :class:`Storage` says."""
