"""What a teacher sees of an episode."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from curricle.array_types import FloatArray
from curricle.display import brief_repr


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode that has ended, as a :class:`Teacher` sees it.

    Attributes
    ----------
    task : int
        In which of the M tasks it was played, 0 .. M-1 in their order.
    rewards : (L,) float64
        Those of its L steps.
    td_errors : (L,) float64
        delta_t = r_t + gamma V(s_t+1) - V(s_t), where V(s) = max_a Q(s, a) when the step was taken,
        0 in ends. An update that a loop still held back then is not in it (tables above 32 KB).
    success : bool
        Whether it ended in the goal of :func:`teach`.
    discount : float
    greedy_returns : callable
        ``greedy_returns()`` is V^pi of the policy that is greedy now, discounted, at the start of
        each task, (M,) float64: exact, by the tasks' tables. To be called in `update`.
    optimal_returns : callable
        ``optimal_returns()`` is V* there, (M,) float64.

    Examples
    --------
    >>> values = lambda: np.zeros(1)
    >>> Episode(0, np.array([0.0, 1.0]), np.zeros(2), True, 0.5, values, values).discounted_return
    0.5
    """

    task: int
    rewards: FloatArray
    td_errors: FloatArray
    success: bool
    discount: float
    greedy_returns: Callable[[], FloatArray]
    optimal_returns: Callable[[], FloatArray]

    __repr__ = brief_repr

    @property
    def length(self) -> int:
        """L, its steps."""
        return len(self.rewards)

    @property
    def discounted_return(self) -> float:
        """sum_t gamma^t r_t."""
        return float(self.rewards @ self.discount ** np.arange(self.length))
