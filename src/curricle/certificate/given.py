"""A shaping as a user gives it: the library's potential, an array or a function; checked."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from curricle.checks import number, numbers, one_of
from curricle.errors import PotentialError, SettingError
from curricle.learning.potential import (
    MappedPotential,
    StateActionPotential,
    StatePotential,
    finite,
)
from curricle.learning.schedules import constant
from curricle.learning.training import check_potential
from curricle.learning.ways import How
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, generative_model

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Way = How | Literal["reward"]
"""The ways of :func:`learn`, and a shaping reward of one's own."""
READ = 10_000
"""States whose phi is read from the sources at once."""


@dataclass(frozen=True, eq=False)
class Given:
    """A shaping that fits its task.

    Attributes
    ----------
    task : Task
    how : str
    potential : StatePotential, StateActionPotential, MappedPotential, array or callable
        An array is frozen, (S,) or (S, A), and keeps what it says of ends.
    discount : float
        What the shaping discounts with: the task's, or another tool's.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> checked(GridWorld("S.T"), [0.0, 1.0, 5.0], "state").ending()
    array([0., 1., 5.])
    """

    task: Task
    how: str
    potential: Any
    discount: float

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
        """What the weight goes to in the long run; 1 for arrays."""
        return 1.0 if self.raw else float(self.potential.weight.last)

    def final(self) -> FloatArray:
        """Return the potential as it is in the long run, (S,) or (S, A)."""
        if self.raw:
            return np.asarray(self.potential)
        values = self.potential.values
        return np.asarray(self.share * (values[-1] if self.how == "state" else values))

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
        function: Callable[[IntArray, IntArray, IntArray], Any] = self.potential
        if self.how == "reward":
            return function
        return lambda state, action, after: self.at_pairs(state, action)


def checked(task: Task, potential: Any, how: str, shaping_discount: float | None = None) -> Given:
    """Return a shaping that fits its task, or raise PotentialError or SettingError."""
    generative = generative_model(task)
    one_of("how", how, (*get_args(How), "reward"), SettingError)
    discount = generative.discount
    if shaping_discount is not None:
        if how != "state":
            raise SettingError(
                "shaping_discount is the discount of F = gamma Phi(s') - Phi(s) and goes with "
                f"how='state': got how={how!r}"
            )
        discount = number("shaping_discount", shaping_discount, SettingError, low=0, high=1)
    if how == "look_back" and generative.discount == 0:
        raise SettingError("look_back divides by the discount, which must be positive: got 0")
    if how == "reward" or callable(potential):
        if how != "reward" or not callable(potential):
            raise SettingError(
                "a function F(s, a, s') goes with how='reward', and only it: got "
                f"how={how!r} with a {type(potential).__name__}"
            )
        return Given(task, how, potential, discount)
    own = isinstance(potential, StatePotential | StateActionPotential | MappedPotential)
    if own:
        check_potential(potential, task, how)
    return Given(task, how, potential if own else _array(task, potential, how), discount)


def _array(task: Task, given: Any, how: str) -> FloatArray:
    generative = generative_model(task)
    values = numbers("a potential", given, PotentialError)
    shape: tuple[int, ...] = (generative.states.size, generative.actions.size)[
        : 1 + (how != "state")
    ]
    if values.shape != shape:
        raise PotentialError(
            f"a potential for how={how!r} must have the task's shape {shape}: got {values.shape}"
        )
    return frozen(finite(values, "a potential"))
