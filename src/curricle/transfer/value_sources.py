"""Value sources: the values of observations, or of actions in them, as a target reads them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.checks import numbers
from curricle.display import brief_repr
from curricle.errors import PotentialError
from curricle.tasks.observation_task import batch_size


@runtime_checkable
class ValueSource(Protocol):
    """The values of a task, of n observations at once.

    Observations are stacked as the task's space stacks them: an array (n, ...), or a dict or tuple
    of such. Those of a task with tables are its states' numbers, (n,) int64.
    """

    @property
    def of_actions(self) -> bool:
        """Whether it has action values, so that :meth:`q` can be called."""

    def q(self, observations: Any, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`: (n,), or (n, m) for m actions in each."""

    def v(self, observations: Any) -> FloatArray:
        """Return V(s), (n,) float64."""


@dataclass(frozen=True, eq=False)
class TableValues:
    """The values of a tabular learner: Q(s, a) by the numbers of states and actions.

    Parameters
    ----------
    table : (S, A) float array

    Raises
    ------
    PotentialError
        When the table is not (S, A) or not finite.

    Examples
    --------
    >>> values = TableValues(np.array([[1.0, 2.0], [3.0, 0.0]]))
    >>> values.q(np.array([0, 1]), np.array([1, 0])), values.v(np.array([0, 1]))
    (array([2., 3.]), array([2., 3.]))
    """

    table: FloatArray

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        table = numbers("a table of values", self.table, PotentialError)
        if table.ndim != 2 or not np.isfinite(table).all():
            raise PotentialError(
                f"a table of values must be finite and have shape (S, A): got {table.shape}"
            )
        object.__setattr__(self, "table", np.asarray(table, dtype=np.float64))

    @property
    def of_actions(self) -> bool:
        """True: a table has action values."""
        return True

    def q(self, observations: Any, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`."""
        states = np.asarray(observations)
        return np.asarray(self.table[states[:, None] if np.ndim(actions) == 2 else states, actions])

    def v(self, observations: Any) -> FloatArray:
        """Return max_a Q(s, a), (n,) float64."""
        return np.asarray(self.table[np.asarray(observations)].max(axis=1))


@dataclass(frozen=True, eq=False)
class FunctionValues:
    """Values that a user's functions compute.

    Parameters
    ----------
    action_values : callable, optional
        (observations, actions) -> (n,) or (n, m), as :meth:`ValueSource.q`.
    state_values : callable, optional
        observations -> (n,). At least one of the two is needed.
    actions : int, optional
        A, over which V(s) = max_a Q(s, a) is taken where only `action_values` is given.

    Raises
    ------
    PotentialError
        When neither function is given, or one returns another shape.

    Examples
    --------
    >>> height = FunctionValues(state_values=lambda cars: np.sin(3 * cars[:, 0]))
    >>> height.v(np.zeros((2, 2))), height.of_actions
    (array([0., 0.]), False)
    """

    action_values: Callable[[Any, Any], Any] | None = None
    state_values: Callable[[Any], Any] | None = None
    actions: int | None = None

    def __post_init__(self) -> None:
        if self.state_values is None and (self.action_values is None or self.actions is None):
            got = "neither" if self.action_values is None else "action_values without actions"
            raise PotentialError(
                f"values need state_values, or action_values and the number of actions: got {got}"
            )

    @property
    def of_actions(self) -> bool:
        """Whether `action_values` is given."""
        return self.action_values is not None

    def q(self, observations: Any, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`."""
        if self.action_values is None:
            raise no_actions(self)
        return _checked(self.action_values(observations, actions), np.shape(actions))

    def v(self, observations: Any) -> FloatArray:
        """Return V(s), (n,) float64."""
        n = batch_size(observations)
        if self.state_values is not None:
            return _checked(self.state_values(observations), (n,))
        every_action = np.broadcast_to(np.arange(self.actions or 0), (n, self.actions or 0))
        return np.asarray(self.q(observations, every_action).max(axis=1))


def no_actions(values: Any) -> PotentialError:
    """Return the error that these are state values, without action values."""
    return PotentialError(
        "state values cannot tell actions apart, as QInitialisation and LookAheadAdvice need: "
        f"{type(values).__name__} has no action values; use StateShaping"
    )


def _checked(found: Any, shape: tuple[int, ...]) -> FloatArray:
    values = numbers("what a function of values returns", found, PotentialError)
    if values.shape != shape:
        raise PotentialError(f"a function of values must return shape {shape}: got {values.shape}")
    return np.asarray(values, dtype=np.float64)
