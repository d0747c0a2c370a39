"""Mappings f(s, a) of observations: functions on batches, with the same rules as index mappings."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import batch_space, iterate

from curricle.arrays import FloatArray, IntArray
from curricle.checks import instance, numbers
from curricle.display import block
from curricle.errors import MappingError, PotentialError
from curricle.tasks.observation_task import ObservationTask, batch_size, is_observation_task
from curricle.text import brief_repr, counted
from curricle.transfer.mapping import (
    ENDED,
    UNMAPPED,
    TaskMapping,
    check_unmapped_value,
    coverage_table,
    number_or_nan,
    rescale,
    transferred,
)

# -- the values of a source ------------------------------------------------------------------------


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
    table : (S, A) float array, finite

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


def _checked(returned: Any, shape: tuple[int, ...]) -> FloatArray:
    values = numbers("what a function of values returns", returned, PotentialError)
    if values.shape != shape:
        raise PotentialError(f"a function of values must return shape {shape}: got {values.shape}")
    return np.asarray(values, dtype=np.float64)


# -- mappings --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObservationCoverage:
    """Coverage of a mapping of observations, over a sample of them; shares sum to 1."""

    observations: int
    mapped: float  # of all pairs (s, a)
    ended: float
    unmapped: float
    # Of the mapped observations those whose counterpart lies outside the source's space, where its
    # values are extrapolated; NaN where nothing is mapped, or the source has numbered states.
    outside: float

    def __str__(self) -> str:
        text = (
            f"{self.mapped:.1%} of the pairs of "
            f"{counted(self.observations, 'observation')} mapped, "
            f"{self.ended:.1%} at the source's end, {self.unmapped:.1%} unmapped"
        )
        if math.isnan(self.outside):
            return text
        return f"{text}; {self.outside:.1%} of the counterparts outside the source's space"

    def _repr_html_(self) -> str:
        return block("Coverage", coverage_table({"": self}))


@dataclass(frozen=True, eq=False)
class ObservationMapping(TaskMapping):
    """A mapping of a target's observations and actions to a source's, n of them at once.

    Parameters
    ----------
    target : ObservationTask
    source : ObservationTask or Task
    observations : callable, optional
        The target's stacked observations -> the source's, as many; of a source with tables its
        states' numbers, (n,) ints, which may be `UNMAPPED` or `ENDED`. By default the same.
    actions : (A,) int array or callable, optional
        The source's action for each of the target's, `UNMAPPED` where none; or observations ->
        (n, A) of them. By default the same numbers.
    status : callable, optional
        observations -> (n,) bool, whether there is a counterpart; or ints, `UNMAPPED` or `ENDED`
        where there is none. The counterparts returned for these are not read.
    unmapped_value : float, optional
        A value that the source is to state for unmapped pairs. By default it states none: they are
        NaN, and aggregates skip them. 0 is optimistic where rewards are negative.
    description : str
        Printed in reports; by default the names of the functions.

    Raises
    ------
    MappingError
        When the tasks do not fit, or a function returns a wrong shape or values out of range.

    Examples
    --------
    A car without a speedometer reads the values of one that stands still.

    >>> from curricle import observation_task
    >>> from curricle.transfer.observation_mapping import FunctionValues
    >>> car = observation_task("MountainCar-v0")
    >>> still = ObservationMapping(car, car, lambda cars: cars * [1, 0])
    >>> height = FunctionValues(state_values=lambda cars: cars.sum(axis=1))
    >>> still.states(height, np.array([[0.25, 0.07], [-0.5, 0.01]]))
    array([ 0.25, -0.5 ])
    """

    target: ObservationTask
    source: Any
    observations: Callable[[Any], Any] | None = None
    actions: Any = None
    status: Callable[[Any], Any] | None = None
    unmapped_value: float | None = None
    description: str = ""

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        if not self.description:
            functions = {"observations": self.observations, "actions": self.actions}
            functions |= {} if self.status is None else {"status": self.status}
            names = [f"{part} {_function_name(how)}" for part, how in functions.items()]
            object.__setattr__(self, "description", ", ".join(names))
        instance("target of an observation mapping", self.target, ObservationTask, MappingError)
        check_unmapped_value(self.unmapped_value)
        if self.observations is None and not is_observation_task(self.source):
            raise MappingError(
                "a mapping into a task with tables needs a function from observations to its "
                "states' numbers: got none"
            )
        if self.actions is None:
            n_target, n_source = self.target.n_actions, self._source_actions
            if n_target is not None and n_source is not None and n_target > n_source:
                raise MappingError(
                    f"a mapping that leaves actions as they are needs as many of them: the target "
                    f"has {n_target}, the source {n_source}"
                )
        elif not callable(self.actions):
            table = self._checked_actions(self.actions, (self.target.n_actions,))
            object.__setattr__(self, "actions", table)

    @property
    def is_identity(self) -> bool:
        """Whether observations and actions are left as they are, all of them mapped."""
        return self.observations is None and self.actions is None and self.status is None

    @property
    def _source_actions(self) -> int | None:
        """The number of the source's actions; None where they are not numbered."""
        source = self.source
        n: int | None = source.n_actions if is_observation_task(source) else source.actions.size
        return n

    @property
    def words(self) -> str:
        """The description."""
        return self.description

    @property
    def parts(self) -> tuple[Any, ...]:
        """The functions and numbers that make the mapping."""
        actions = self.actions if callable(self.actions) else repr(self.actions)
        return self.observations, actions, self.status, self.unmapped_value

    def pairs(
        self, values: ValueSource, batch: Any, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) of n stacked observations, (n, A) float64."""
        if self.target.n_actions is None:
            raise MappingError(f"pairs need actions that are numbered: got {self.target.actions}")
        if not values.of_actions:
            raise no_actions(values)
        counterparts, status = self._counterparts(batch)
        n = batch_size(batch)
        if callable(self.actions):
            table = self._actions(batch, n)
            q = values.q(counterparts, np.maximum(table, 0))
            phi = self._transferred("Q", q, status, scale, shift)
        else:
            table, distinct, column = self._fixed_actions
            q = values.q(counterparts, distinct.repeat(n, axis=0))
            phi = self._transferred("Q", q, status, scale, shift).take(column, axis=1)
        missing = table == UNMAPPED
        return np.where(missing, number_or_nan(self.unmapped_value), phi) if missing.any() else phi

    @cached_property
    def _fixed_actions(self) -> tuple[IntArray, IntArray, IntArray]:
        """The source's action for each of the target's; those to read, (1, n); their columns."""
        table = self._actions(None, 1)[0]
        distinct, column = np.unique(np.maximum(table, 0), return_inverse=True)
        return table, distinct[None], column

    def states(
        self, values: ValueSource, observations: Any, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return Phi(s) = scale V_source(f(s)) + shift, (n,) float64; else as :meth:`pairs`."""
        counterparts, status = self._counterparts(observations)
        return self._transferred("V", values.v(counterparts), status, scale, shift)

    def coverage(self, observations: Any) -> ObservationCoverage:
        """Return how much of a sample of n stacked observations is reached."""
        counterparts, status = self._counterparts(observations)
        n = batch_size(observations)
        status = np.zeros(n, np.int64) if status is None else status
        mapped = status >= 0
        index = np.broadcast_to(status[:, None], (n, self.target.n_actions or 1))
        if self.target.n_actions is not None:
            index = np.where(self._actions(observations, n) == UNMAPPED, UNMAPPED, index)
        outside = float("nan")
        if is_observation_task(self.source) and mapped.any():
            space = self.source.observations
            inside = [space.contains(seen) for seen in iterate(batch_space(space, n), counterparts)]
            outside = 1.0 - float(np.mean(np.asarray(inside)[mapped]))
        return ObservationCoverage(
            observations=n,
            mapped=float((index >= 0).mean()),
            ended=float((index == ENDED).mean()),
            unmapped=float((index == UNMAPPED).mean()),
            outside=outside,
        )

    def _counterparts(self, observations: Any) -> tuple[Any, IntArray | None]:
        """Return a source observation or state for each, and the status: None if all are mapped."""
        n = batch_size(observations)
        seen = observations if self.observations is None else self.observations(observations)
        status = None
        if self.status is not None:
            mapped = np.asarray(self.status(observations))
            status = _integers(
                "status", np.where(mapped, 0, UNMAPPED) if mapped.dtype == np.bool_ else mapped
            )
        if not is_observation_task(self.source):
            seen = _integers("states", seen)
            n_states = self.source.states.size
            if not (seen.view(np.uint64) < n_states).all():  # both bounds at once
                bad = np.flatnonzero((seen < ENDED) | (seen >= n_states))
                if bad.size:
                    raise MappingError(
                        f"a mapping's states must lie in 0..{n_states - 1}, or be UNMAPPED or "
                        f"ENDED: observation {bad[0]} gives {seen[bad[0]]}"
                    )
                status = seen if status is None else np.where(seen < 0, seen, status)
                seen = np.maximum(seen, 0)
        if batch_size(seen) != n or (status is not None and status.shape != (n,)):
            shape = (n,) if status is None else status.shape
            raise MappingError(
                f"a mapping must return as many as it was given, {n}: got {batch_size(seen)} "
                f"counterparts and status of shape {shape}"
            )
        return seen, status

    def _actions(self, observations: Any, n: int) -> IntArray:
        """Return the source's action for each pair, (n, A)."""
        n_actions = self.target.n_actions
        if callable(self.actions):
            return self._checked_actions(self.actions(observations), (n, n_actions))
        row = np.arange(n_actions or 0) if self.actions is None else self.actions
        return np.broadcast_to(row, (n, len(row)))

    def _checked_actions(self, actions: Any, shape: tuple[int | None, ...]) -> IntArray:
        if self.target.n_actions is None:
            raise MappingError(
                "a mapping of actions needs a target with numbered actions: got "
                f"{self.target.actions}"
            )
        table, n_source = _integers("actions", actions), self._source_actions
        if table.shape != shape:
            raise MappingError(f"a mapping's actions must have shape {shape}: got {table.shape}")
        bad = table[(table < UNMAPPED) | (table >= (n_source or np.inf))]
        if bad.size:
            allowed = "be 0 or more" if n_source is None else f"lie in 0..{n_source - 1}"
            raise MappingError(f"a mapping's actions must {allowed}, or be UNMAPPED: got {bad[0]}")
        return table

    def _transferred(
        self, name: str, values: FloatArray, status: IntArray | None, scale: float, shift: float
    ) -> FloatArray:
        """Return what source values, (n,) or (n, m), are for the target."""
        if not np.isfinite(values).all():
            place = np.argwhere(~np.isfinite(values))[0]
            raise MappingError(
                f"a source's values must be finite: {name} is {values[tuple(place)]} at the "
                f"counterpart of observation {place[0]}"
            )
        if status is None:
            return rescale(values, scale, shift)
        index = status.reshape(-1, *[1] * (values.ndim - 1))
        return transferred(values, index, self.unmapped_value, scale, shift)


def _function_name(how: Any) -> str:
    if how is None:
        return "as they are"
    if not callable(how):
        return f"as {' '.join(map(str, how))}"
    name = getattr(how, "__name__", "<lambda>")
    return "by a function" if name == "<lambda>" else f"by {name}"


def _integers(name: str, array: Any) -> IntArray:
    if isinstance(array, np.ndarray) and array.dtype == np.int64:
        return array
    values = numbers(f"a mapping's {name}", array, MappingError)
    broken = values[values != values // 1]
    if broken.size:
        raise MappingError(f"a mapping's {name} must be whole numbers: got {broken[0]:g}")
    return np.asarray(array).astype(np.int64)
