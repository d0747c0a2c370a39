"""What a teacher sees of an episode."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from curricle.array_types import FloatArray
from curricle.display import brief_repr
from curricle.errors import SettingError


def _without_tables() -> FloatArray:
    raise SettingError(
        "exact returns are computed from the tasks' tables: an episode of a vector environment has "
        "none, and a teacher that reads them says so by uses_tables = True"
    )


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode that has ended, as a :class:`Teacher` sees it.

    Attributes
    ----------
    task : int
        In which of the M tasks it was played, 0 .. M-1 in their order.
    rewards : (L,) float64
        Those of its L steps.
    td_errors : (L,) float64 or None
        delta_t = r_t + gamma V(s_t+1) - V(s_t), where V(s) = max_a Q(s, a) when the step was taken,
        0 in ends. An update that a loop still held back then is not in it (tables above 32 KB).
        In a vector environment V is the network's at the end of the episode, and None means that
        there is none to read, or that the teacher does not ask for it.
    success : bool
        Whether it ended in the goal (:func:`teach`, :class:`CurriculumVecEnv`).
    discount : float
    greedy_returns : callable
        ``greedy_returns()`` is V^pi of the policy that is greedy now, discounted, at the start of
        each task, (M,) float64: exact, by the tasks' tables. To be called in `update`; SettingError
        where there are none.
    optimal_returns : callable
        ``optimal_returns()`` is V* there, (M,) float64.

    Examples
    --------
    >>> Episode(0, np.array([0.0, 1.0]), np.zeros(2), True, 0.5).discounted_return
    0.5
    """

    task: int
    rewards: FloatArray
    td_errors: FloatArray | None
    success: bool
    discount: float
    greedy_returns: Callable[[], FloatArray] = _without_tables
    optimal_returns: Callable[[], FloatArray] = _without_tables

    __repr__ = brief_repr

    @property
    def length(self) -> int:
        """L, its steps."""
        return len(self.rewards)

    @property
    def discounted_return(self) -> float:
        """sum_t gamma^t r_t."""
        return float(self.rewards @ self.discount ** np.arange(self.length))
