"""A shaping to be certified: checked, with its potential as the user gave it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from curricle.checks import number
from curricle.errors import SettingError
from curricle.learning.potential import MappedPotential, Potential, StatePotential
from curricle.learning.schedules import constant
from curricle.learning.shaping import Claim, DecayingAdvice, Shaping
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, generative_model

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
READ = 10_000
"""States whose phi is read from the sources at once."""


@dataclass(frozen=True)
class ShapingReward:
    """A shaping reward of one's own, F(s, a, s'), for :func:`certify`.

    Parameters
    ----------
    function : callable
        Takes three (E,) int64 arrays, states, actions and next states, and returns (E,) floats. It
        is asked only about transitions that can happen.

    Examples
    --------
    >>> ShapingReward(lambda state, action, after: 5.0 * (after == state)).claim
    'added_rewards'
    """

    function: Callable[[IntArray, IntArray, IntArray], Any]

    claim: ClassVar[Claim] = "added_rewards"
    name: ClassVar[str] = "ShapingReward"

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise SettingError(
                f"ShapingReward takes a function F(s, a, s'): got a {type(self.function).__name__}"
            )


@dataclass(frozen=True, eq=False)
class Given:
    """A shaping that fits its task.

    Attributes
    ----------
    task : Task
    shaping : Shaping or ShapingReward
    potential : StatePotential, StateActionPotential, MappedPotential, array or None
        An array is frozen, (S,) or (S, A), and keeps what it says of ends.
    discount : float
        What the shaping discounts with: the task's, or another tool's.

    Examples
    --------
    >>> from curricle import GridWorld, StateShaping
    >>> checked(GridWorld("S.T"), StateShaping([0.0, 1.0, 5.0])).ending()
    array([0., 1., 5.])
    """

    task: Task
    shaping: Shaping | ShapingReward
    potential: Any
    discount: float

    @property
    def name(self) -> str:
        """The name of the shaping."""
        return self.shaping.name

    @property
    def claim(self) -> Claim:
        """What is to be checked."""
        return self.shaping.claim

    @property
    def raw(self) -> bool:
        """Whether it is an array, whose ends may be anything."""
        return isinstance(self.potential, np.ndarray)

    @property
    def changing(self) -> bool:
        """Whether it is a state potential that changes while learning."""
        phi = self.potential
        if not isinstance(phi, StatePotential):
            return False
        return len(phi.values) > 1 or phi.weight != constant(phi.weight.last)

    @property
    def share(self) -> float:
        """The weight of the potential in the long run."""
        if isinstance(self.shaping, DecayingAdvice):
            return float(self.shaping.weight.last)
        return (
            float(self.potential.weight.last) if isinstance(self.potential, StatePotential) else 1.0
        )

    def final(self) -> FloatArray:
        """Return the potential as it is in the long run, (S,) or (S, A)."""
        values = self.potential if self.raw else self.potential.values
        if isinstance(self.potential, StatePotential):
            values = values[-1]
        return np.asarray(self.share * values)

    def ending(self) -> FloatArray:
        """Return Phi(s), or max_a phi(s, a), (S,), as an end would pay it."""
        values = self.final()
        return values if values.ndim == 1 else np.asarray(values.max(axis=1))

    def at_pairs(self, state: IntArray, action: IntArray) -> FloatArray:
        """Return phi(s, a) of n pairs, (n,), reading no others; their states are no ends."""
        if not isinstance(self.potential, MappedPotential):
            values = self.potential if self.raw else self.potential.values
            return np.asarray(values[state, action])
        phi = np.empty(len(state))
        for first in range(0, len(state), READ):
            part = slice(first, first + READ)
            rows = self.potential.rows(state[part])
            phi[part] = np.take_along_axis(rows, action[part, None], axis=1)[:, 0]
        return phi

    def bonus(self) -> Callable[[IntArray, IntArray, IntArray], Any]:
        """Return F(s, a, s') of a bonus or of a reward of one's own."""
        if isinstance(self.shaping, ShapingReward):
            return self.shaping.function
        return lambda state, action, after: self.at_pairs(state, action)


def checked(task: Task, shaping: Any, shaping_discount: float | None = None) -> Given:
    """Return a shaping that fits its task, or raise PotentialError or SettingError."""
    discount = generative_model(task).discount
    if not isinstance(shaping, Shaping | ShapingReward):
        raise SettingError(
            "what is certified must be a shaping, such as StateShaping(potential), or a "
            f"ShapingReward(function): got a {type(shaping).__name__}"
        )
    if isinstance(shaping, Shaping) and not (shaping.for_tables and shaping.potential is not None):
        raise SettingError(
            f"a shaping to be certified must be for tables and have a potential: got {shaping!r}"
        )
    if shaping_discount is not None:
        if shaping.claim != "telescoping":
            raise SettingError(
                "shaping_discount is the discount of F = gamma Phi(s') - Phi(s) and goes with "
                f"StateShaping: got {shaping.name}"
            )
        discount = number("shaping_discount", shaping_discount, SettingError, low=0, high=1)
    if isinstance(shaping, ShapingReward):
        return Given(task, shaping, None, discount)
    fitting = shaping.for_task(task).potential
    if isinstance(shaping.potential, Potential):
        return Given(task, shaping, fitting, discount)
    ends_kept = np.array(shaping.potential, dtype=np.float64)
    if isinstance(fitting, StatePotential) and ends_kept.ndim == 2:
        ends_kept = ends_kept.max(axis=1)
    return Given(task, shaping, frozen(ends_kept), discount)
