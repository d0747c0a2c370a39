"""Curves of several seeds as a line of their mean with its band."""

from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.display import Line
from curricle.statistics.intervals import CONFIDENCE, mean_interval


def seed_line(
    name: str,
    steps: Any,
    values: FloatArray,
    colour: str = "currentColor",
    *,
    dashed: bool = False,
    confidence: float = CONFIDENCE,
) -> Line:
    """Return the mean over seeds of curves, (K, T) at steps (T,), with Student's interval.

    Examples
    --------
    >>> seed_line("maze", np.array([0, 50]), np.array([[0.0, 1.0], [1.0, 3.0]])).values
    array([0.5, 2. ])
    """
    found = mean_interval(np.asarray(values, np.float64), confidence=confidence)
    mean, low, high = (np.asarray(one) for one in (found.estimate, found.low, found.high))
    return Line(name, steps, mean, low, high, colour, dashed)
