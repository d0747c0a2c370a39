"""A shaping to be certified, checked against its task."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from curricle.arrays import FloatArray, IntArray, frozen
from curricle.checks import number, one_of
from curricle.errors import SettingError
from curricle.learning.potential import MappedPotential, Potential, StatePotential
from curricle.learning.schedules import constant
from curricle.learning.shaping import Claim, Shaping
from curricle.tasks.task import Task, generative_model

RewardFunction = Callable[..., Any]
"""F(s, a, s'), which shaping adds to the reward of E transitions, (E,) float."""
Ends = Literal["zero", "given"]
"""Whether an array is read as 0 at the ends, as by :func:`learn`, or as given."""
CHUNK = 10_000
"""States whose phi is read from the sources at a time."""


@dataclass(frozen=True)
class ShapingReward:
    """A shaping reward of one's own, F(s, a, s'), for :func:`certify`.

    Parameters
    ----------
    function : callable
        Takes three (E,) int64 arrays (states, actions, next states) of transitions that can happen
        and returns (E,) floats.

    Examples
    --------
    >>> ShapingReward(lambda state, action, after: 5.0 * (after == state)).claim
    'added_rewards'
    """

    function: RewardFunction

    claim: ClassVar[Claim] = "added_rewards"
    name: ClassVar[str] = "ShapingReward"
    last_weight: ClassVar[float] = 1.0

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise SettingError(
                f"ShapingReward takes a function F(s, a, s'): got {type(self.function).__name__}"
            )


@dataclass(frozen=True, eq=False)
class CheckedShaping:
    """A shaping that fits its task."""

    task: Task
    shaping: Shaping | ShapingReward
    potential: Any  # of the library, or an array (S,) or (S, A) that keeps its values at the ends
    discount: float  # gamma of F: the task's, or another tool's
    ignored: FloatArray  # Phi that an array gives ends and learn() ignores, (S,)

    @property
    def task_discount(self) -> float:
        """The discount of the task."""
        return generative_model(self.task).discount

    @property
    def is_array(self) -> bool:
        """Whether the potential is an array, which need not be 0 at the ends."""
        return isinstance(self.potential, np.ndarray)

    @property
    def changing(self) -> bool:
        """Whether it is a state potential that changes while learning."""
        phi = self.potential
        if not isinstance(phi, StatePotential):
            return False
        return len(phi.values) > 1 or phi.weight != constant(phi.weight.last)

    @property
    def last_weight(self) -> float:
        """The weight of the potential in the long run."""
        return self.shaping.last_weight

    def last_values(self) -> FloatArray:
        """Return the weighted potential in the long run, (S,) or (S, A)."""
        values = self.potential if self.is_array else self.potential.values
        if isinstance(self.potential, StatePotential):
            values = values[-1]
        return np.asarray(self.last_weight * values)

    def end_values(self) -> FloatArray:
        """Return Phi(s), or max_a phi(s, a), (S,): what F contains where s is an end."""
        values = self.last_values()
        return values if values.ndim == 1 else np.asarray(values.max(axis=1))

    def at_pairs(self, state: IntArray, action: IntArray) -> FloatArray:
        """Return phi(s, a) of n pairs, (n,), reading no others; their states are no ends."""
        if not isinstance(self.potential, MappedPotential):
            values = self.potential if self.is_array else self.potential.values
            return np.asarray(values[state, action])
        phi = np.empty(len(state))
        for first in range(0, len(state), CHUNK):
            part = slice(first, first + CHUNK)
            rows = self.potential.rows(state[part])
            phi[part] = np.take_along_axis(rows, action[part, None], axis=1)[:, 0]
        return phi

    def reward(self) -> RewardFunction:
        """Return F(s, a, s') of a :class:`RewardBonus` or :class:`ShapingReward`."""
        if isinstance(self.shaping, ShapingReward):
            return self.shaping.function
        return lambda state, action, after: self.at_pairs(state, action)


def check_shaping(
    task: Task, shaping: Any, shaping_discount: float | None = None, ends: Ends = "zero"
) -> CheckedShaping:
    """Return a shaping that fits its task, or raise PotentialError or SettingError."""
    if not isinstance(shaping, Shaping | ShapingReward):
        raise SettingError(
            "what is certified must be a shaping, such as StateShaping(potential), or a "
            f"ShapingReward(function): got {type(shaping).__name__}"
        )
    if isinstance(shaping, Shaping) and not (shaping.for_tables and shaping.potential is not None):
        raise SettingError(
            f"a shaping to be certified must be for tables and have a potential: got {shaping!r}"
        )
    one_of("ends", ends, ("zero", "given"), SettingError)
    generative = generative_model(task)
    discount = generative.discount
    if shaping_discount is not None:
        if shaping.claim != "telescoping":
            raise SettingError(
                "shaping_discount is the discount of F = gamma Phi(s') - Phi(s) and goes with "
                f"StateShaping: got {shaping.name}"
            )
        discount = number("shaping_discount", shaping_discount, SettingError, low=0, high=1)
    ignored = np.zeros(0)
    if isinstance(shaping, ShapingReward):
        return CheckedShaping(task, shaping, None, discount, ignored)
    potential: Any = shaping.for_task(task).potential
    if not isinstance(shaping.potential, Potential):
        array = np.array(shaping.potential, dtype=np.float64)
        if isinstance(potential, StatePotential) and array.ndim == 2:
            array = array.max(axis=1)
        if ends == "given":
            potential = frozen(array)
        elif generative.terminal is not None:
            at_states = array if array.ndim == 1 else array.max(axis=1)
            ignored = np.where(generative.terminal, at_states, 0.0)
    return CheckedShaping(task, shaping, potential, discount, ignored)
