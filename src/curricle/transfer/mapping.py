"""Inter-task mappings f(s, a): the source pair that each target pair reads (paper E5).

A mapping maps batches: numbers of states by an index array, observations by functions.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import batch_space, iterate

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import brief, instance, number, numbers
from curricle.errors import MappingError, PotentialError
from curricle.tasks.mdp import Task, available_actions, duplicated, generative_model, live_pairs
from curricle.tasks.observation_task import (
    Observations,
    ObservationTask,
    batch_size,
    is_observation_task,
    shapes_of,
)
from curricle.tasks.spaces import MISSING, Decoded
from curricle.text import brief_repr, counted, printed

Batch: TypeAlias = Observations | Sequence[Any]
"""n stacked observations of a task, or the numbers of n of its states."""
PairFunction = Callable[[Decoded, Decoded], tuple[Decoded, Decoded]]

UNMAPPED = -1
"""Entry of a mapping for a target pair without a source pair."""
ENDED = -2
"""Entry for a target pair whose counterpart is a terminal source state, of value 0."""
MOST_LISTED = 1_000_000_000
"""Most pairs of a target for a mapping by a function: its array takes 8 GB."""

# -- the values of a source ------------------------------------------------------------------------


@runtime_checkable
class ValueSource(Protocol):
    """The values of a task, for n observations at once.

    Observations are stacked as in the task's space: an array (n, ...), or a dict or tuple of such
    arrays. For a task with tables they are the numbers of states, (n,) int64.
    """

    @property
    def of_actions(self) -> bool:
        """Whether there are action values, so that :meth:`q` can be called."""

    def q(self, observations: Batch, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`: (n,), or (n, m) for m actions in each."""

    def v(self, observations: Batch) -> FloatArray:
        """Return V(s), (n,) float64."""


@dataclass(frozen=True, eq=False)
class TableValues:
    """The values of a tabular learner: Q(s, a) by the numbers of states and actions, (S, A).

    Examples
    --------
    >>> values = TableValues(np.array([[1.0, 2.0], [3.0, 0.0]]))
    >>> values.q(np.array([0, 1]), np.array([1, 0])), values.v(np.array([0, 1]))
    (array([2., 3.]), array([2., 3.]))
    """

    table: FloatArray
    of_actions: ClassVar[bool] = True

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        table = numbers("a table of values", self.table, PotentialError)
        if table.ndim != 2 or not (np.isfinite(table) | np.isneginf(table)).all():
            raise PotentialError(
                f"a table of values must be finite and have shape (S, A): got {table.shape}"
            )
        object.__setattr__(self, "table", table)

    def q(self, observations: Batch, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`."""
        states = np.asarray(observations)
        return np.asarray(self.table[states[:, None] if np.ndim(actions) == 2 else states, actions])

    def v(self, observations: Batch) -> FloatArray:
        """Return max_a Q(s, a), (n,) float64."""
        return np.asarray(self.table[np.asarray(observations)].max(axis=1))


@dataclass(frozen=True, eq=False)
class FunctionValues:
    """Values from a user's functions, at least one of which is needed.

    `action_values` is (observations, actions) -> (n,) or (n, m), as :meth:`ValueSource.q`,
    `state_values` is observations -> (n,). Without `state_values`, V(s) is max_a Q(s, a) over
    `actions`, the number of actions.

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
            args = "neither" if self.action_values is None else "action_values without actions"
            raise PotentialError(
                f"values need state_values, or action_values and the number of actions: got {args}"
            )

    @property
    def of_actions(self) -> bool:
        """Whether `action_values` is given."""
        return self.action_values is not None

    def q(self, observations: Batch, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`."""
        if self.action_values is None:
            raise no_actions(self)
        return _checked(self.action_values(observations, actions), np.shape(actions))

    def v(self, observations: Batch) -> FloatArray:
        """Return V(s), (n,) float64."""
        n = batch_size(observations)
        if self.state_values is not None:
            return _checked(self.state_values(observations), (n,))
        every_action = np.broadcast_to(np.arange(self.actions or 0), (n, self.actions or 0))
        return np.asarray(self.q(observations, every_action).max(axis=1))


def no_actions(values: object) -> PotentialError:
    """Return the error that a source has state values and no action values."""
    return PotentialError(
        "state values cannot tell actions apart, as QInitialisation and LookAheadAdvice need: "
        f"{type(values).__name__} has no action values; use StateShaping"
    )


def _checked(returned: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    values = numbers("what a function of values returns", returned, PotentialError)
    if values.shape != shape:
        raise PotentialError(f"a function of values must return shape {shape}: got {values.shape}")
    return values


# -- mappings --------------------------------------------------------------------------------------


class TaskMapping(ABC):
    """A mapping of batches of a target's states or observations, and of its actions."""

    target: Any
    source: Any
    unmapped_value: float | None
    knows_target: bool = False  # whether a search read the target's model for it; not charged

    @abstractmethod
    def pairs(
        self, values: ValueSource, batch: Batch, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) = scale Q_source(f(s, a)) + shift of every action, (n, A) float64."""

    @property
    @abstractmethod
    def description(self) -> str:
        """The mapping in words, such as "predator is predator_2, prey by name"."""

    @property
    @abstractmethod
    def parts(self) -> tuple[Any, ...]:
        """The parts by which mappings of this class differ."""

    @property
    def countable(self) -> bool:
        """Whether the pairs of both tasks are numbered and few enough to count."""
        return False

    @property
    def why_empty(self) -> str:
        """Why the mapping maps nothing; empty if it maps a pair, or its pairs are not counted."""
        return ""


class PairMapping(Frozen, TaskMapping):
    """A mapping of target pairs (s, a) to source pairs: each reads the pair of its `index`."""

    target: Task
    source: Task
    index: IntArray  # (S, A), as in :class:`StateActionMapping`

    def read(
        self, source_values: npt.ArrayLike, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) = scale Q_source(f(s, a)) + shift, (..., S', A') -> (..., S, A) float64.

        phi is `shift` where ended, and `unmapped_value` or NaN where unmapped.
        """
        q = numbers("source_values", source_values, MappingError)
        expected = (self.source.states.size, self.source.actions.size)
        if q.shape[-2:] != expected:
            raise MappingError(
                f"source values must end in the source's shape {expected}: got {q.shape}"
            )
        values = q.reshape(*q.shape[:-2], -1)[..., np.maximum(self.index, 0)]
        return transferred(values, self.index, self.unmapped_value, scale, shift)

    def pairs(
        self, values: ValueSource, batch: Batch, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) of the states with these numbers, (n, A) float64, as :meth:`read`."""
        index = self.index[np.asarray(batch)]
        state, action = np.divmod(np.maximum(index, 0), self.source.actions.size)
        q = values.q(state.ravel(), action.ravel()).reshape(index.shape)
        return transferred(q, index, self.unmapped_value, scale, shift)

    def with_unmapped_value(self, value: float) -> Self:
        """Return the same mapping with another value of unmapped pairs."""
        return replace(self, unmapped_value=value)  # type: ignore[type-var]

    def knowing_target(self) -> Self:
        """Return the same mapping, marked as found by a search in the target's model."""
        return replace(self, knows_target=True)  # type: ignore[type-var]

    @property
    def countable(self) -> bool:
        """Whether both tasks have few enough pairs for coverage to be counted."""
        models = map(generative_model, (self.target, self.source))
        return all(task.states.size * task.actions.size <= LARGEST_COVERAGE for task in models)

    def coverage(self) -> "Coverage":
        """Return how much of the target is mapped, and how much of the source is read."""
        index, available = self.index[live_pairs(self.target)], live_pairs(self.source).ravel()
        readers = np.bincount(index[index >= 0], minlength=available.size)
        used = readers[readers > 0]
        return replace(
            Coverage.of(index, index.size),
            source_pairs=int(available.sum()),
            never_used=int((available & (readers == 0)).sum()),
            most_readers=int(readers.max()),
            mean_readers=float(used.mean()) if used.size else 0.0,
        )

    @property
    def why_empty(self) -> str:
        """Why no target pair reads a source pair; empty if one does, or they are too many."""
        if not self.countable or (self.index >= 0).any():
            return ""
        return f"none of the {self.index.size:,} target pairs reads a source pair"


@dataclass(frozen=True, eq=False)
class StateActionMapping(PairMapping):
    """A mapping of target pairs (s, a) to source pairs, as an index array.

    Parameters
    ----------
    target, source : Task
        S states and A actions, S' and A'.
    index : (S, A) int array
        ``s' * A' + a'`` of the source pair, `UNMAPPED`, or `ENDED`. Rows of terminal target
        states and pairs that are not available do not count; a pair whose source pair is not
        available is unmapped.
    unmapped_value : float, optional
        phi of unmapped pairs. By default NaN, which aggregates skip: the source knows nothing. 0 is
        optimistic where rewards are negative.
    how : str
        How a search found the mapping.
    knows_target : bool
        Whether a search read the dynamics or the values of the target's model for it. No step is
        charged for that, so that gains of the mapping may not come from the source alone.

    Raises
    ------
    MappingError
        On a wrong shape, a pair out of range or in a terminal source state.

    Examples
    --------
    >>> from curricle import Pursuit, project
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> print(project(hunt, chase, predator="predator_1").coverage())
    90.0% of 18,000 target pairs mapped, 10.0% at the source's end, 0.0% unmapped; ...
    """

    target: Task
    source: Task
    index: IntArray
    unmapped_value: float | None = None
    how: str = ""
    knows_target: bool = False

    def __post_init__(self) -> None:
        target, source = generative_model(self.target), generative_model(self.source)
        numbers("a mapping", self.index, MappingError)
        index = np.array(self.index)
        shape = (target.states.size, target.actions.size)
        n_pairs = source.states.size * source.actions.size
        if index.shape != shape or not np.issubdtype(index.dtype, np.integer):
            raise MappingError(
                f"a mapping must be an integer array of the target's shape {shape}: got "
                f"{index.dtype} of shape {index.shape}"
            )
        if index.dtype not in (np.int32, np.int64):  # in which ENDED or a pair may not fit
            index = index.astype(np.int64)
        check_unmapped_value(self.unmapped_value)
        if target.terminal is not None:
            index = np.where(target.terminal[:, None], ENDED, index)
        index = duplicated(index, available_actions(target))
        bad = np.argwhere((index < ENDED) | (index >= n_pairs))
        if len(bad):
            s, a = bad[0]
            raise MappingError(
                f"a mapping's entries must lie in 0..{n_pairs - 1}, or be UNMAPPED or ENDED: "
                f"target state {s}, action {a} has {index[s, a]}"
            )
        state = np.maximum(index, 0) // source.actions.size
        bad = np.argwhere((index >= 0) & terminal_states(self.source)[state])
        if len(bad):
            s, a = bad[0]
            raise MappingError(
                "a mapping must not point at a terminal source state, whose values are never "
                f"learnt; use ENDED or UNMAPPED: target state {s}, action {a} points at source "
                f"state {state[s, a]}"
            )
        available = available_actions(self.source)
        if available is not None:
            readable = (index < 0) | available.ravel()[np.maximum(index, 0)]
            index = np.where(readable, index, UNMAPPED)
        object.__setattr__(self, "index", frozen(index))

    @property
    def description(self) -> str:
        """How the mapping was found, as text."""
        return f"found: {self.how}" if self.how else "state by state and action by action"

    @property
    def parts(self) -> tuple[Any, ...]:
        """The numbers that make the mapping."""
        return self.index.shape, self.index.tobytes(), self.unmapped_value

    def __repr__(self) -> str:
        mapped = int((self.index >= 0).sum())
        return f"{type(self).__name__}({mapped:,} of {self.index.size:,} pairs mapped)"


def rescale(values: FloatArray, scale: float, shift: float) -> FloatArray:
    """Return scale * values + shift; the array itself if scale is 1 and shift 0."""
    return values if scale == 1 and shift == 0 else scale * values + shift


def check_unmapped_value(value: float | None) -> None:
    """Raise MappingError unless an unmapped value is a finite number or None."""
    if value is not None:
        number("unmapped_value", value, MappingError)


def transferred(
    values: FloatArray, index: IntArray, unmapped_value: float | None, scale: float, shift: float
) -> FloatArray:
    """Return scale Q + shift where mapped, shift where ended, `unmapped_value` or NaN elsewhere.

    Where Q is -inf, as the action is not available in the source, the source knows nothing.
    """
    unmapped_value = math.nan if unmapped_value is None else unmapped_value
    if (nothing := np.isneginf(values)).any():
        index = np.where(nothing & (index >= 0), UNMAPPED, index)
        values = np.where(nothing, 0, values)
    fixed = np.where(index == UNMAPPED, unmapped_value, shift)
    return np.asarray(np.where(index >= 0, rescale(values, scale, shift), fixed))


def from_function(
    target: Task, source: Task, function: PairFunction, *, unmapped_value: float | None = None
) -> StateActionMapping:
    """Return the mapping that a function of decoded components computes.

    The function takes the target's decoded states (name -> (S, 1) int64) and actions (name ->
    (1, A)). It returns the source's states and actions, two dicts of arrays that broadcast to
    (S, A). Values outside the source's spaces leave a pair unmapped.

    Raises
    ------
    MappingError
        When the function asks for or returns other components than the tasks have, or the target
        has more than 1,000,000,000 pairs.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> line, half = GridWorld("S...T"), GridWorld("S.T")
    >>> coarse = from_function(line, half, lambda state, action: (
    ...     {"row": state["row"], "column": state["column"] // 2}, action))
    >>> coarse.index[:, 0]
    array([ 0,  0,  4,  4, -2])
    """
    if not callable(function):
        raise MappingError(f"a mapping needs a function of two dicts: got {brief(function)}")
    for task in (target, source):
        generative_model(task)
    pairs = target.states.size * target.actions.size
    if pairs > MOST_LISTED:
        raise MappingError(
            f"a mapping by a function lists all pairs of the target, at most {MOST_LISTED:,}: it "
            f"has {pairs:,}; map it by components"
        )
    states = _Components({k: v[:, None] for k, v in target.states.decode().items()}, "states")
    actions = _Components({k: v[None, :] for k, v in target.actions.decode().items()}, "actions")
    returned = function(states, actions)
    if not isinstance(returned, tuple) or [isinstance(p, dict) for p in returned] != [True, True]:
        raise MappingError(
            f"the function must return two dicts, of states and of actions: got {brief(returned)}"
        )
    encoded = []
    for kind, space, values in zip(
        ("state", "action"), (source.states, source.actions), returned, strict=True
    ):
        if set(values) != set(space.names):
            raise MappingError(
                f"the function must return the source's {kind} components "
                f"{', '.join(space.names)}: got {', '.join(map(str, values)) or 'none'}"
            )
        encoded.append(space.encode(**values))
    shape = target.states.size, target.actions.size
    for points in encoded:  # (S,) would be read as (A,) where there are as many actions as states
        if np.shape(points) not in ((), (1, 1), (shape[0], 1), (1, shape[1]), shape):
            raise MappingError(
                f"the function must return components of shape (S, 1), (1, A) or (S, A), (S, A) "
                f"being {shape}: got {points.shape}"
            )
    return pair_mapping(target, source, encoded[0], encoded[1], unmapped_value)


class _Components(dict[str, IntArray]):
    """The values of components by name; a missing name raises an error that lists the names."""

    def __init__(self, values: Decoded, points: str):
        super().__init__(values)
        self._points = points

    def __missing__(self, name: str) -> IntArray:
        raise MappingError(
            f"a mapping's function must ask for components of the target's {self._points}, "
            f"{', '.join(self)}: got {name!r}"
        )


def terminal_states(task: Task) -> BoolArray:
    """Return which states are known to be terminal, (S,) bool."""
    terminal = generative_model(task).terminal
    return np.zeros(task.states.size, dtype=bool) if terminal is None else terminal


def pair_mapping(
    target: Task,
    source: Task,
    state: IntArray,
    action: IntArray,
    unmapped_value: float | None = None,
) -> StateActionMapping:
    """Return the mapping to arrays of source states and actions that broadcast to (S, A)."""
    state, action = np.broadcast_arrays(state, action)
    missing = (state == MISSING) | (action == MISSING)
    ended = terminal_states(source)[np.maximum(state, 0)]
    pair = np.where(ended, ENDED, state * source.actions.size + action)
    return StateActionMapping(target, source, np.where(missing, UNMAPPED, pair), unmapped_value)


# -- of observations -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ObservationMapping(TaskMapping):
    """A mapping of a target's observations and actions to a source's, n of them at once.

    Parameters
    ----------
    target : ObservationTask
    source : ObservationTask or Task
    observations : callable, optional
        n stacked observations of the target -> n of the source; for a source with tables n numbers
        of states, which may be `UNMAPPED` or `ENDED`. By default observations are unchanged.
    actions : (A,) int array or callable, optional
        The source action of each target action, `UNMAPPED` if there is none; or a function,
        observations -> (n, A) source actions. By default actions keep their numbers.
    status : callable, optional
        observations -> (n,) bool, whether an observation has a counterpart; or ints, `UNMAPPED` or
        `ENDED` where it has none. `observations` may return anything for these.
    unmapped_value : float, optional
        As in :class:`StateActionMapping`.
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
            phrases = []
            for part in ("observations", "actions", "status"):
                how = getattr(self, part)
                name = getattr(how, "__name__", "<lambda>")
                if how is None:
                    phrases += [] if part == "status" else [f"{part} as they are"]
                elif callable(how):
                    phrases.append(f"{part} by {'a function' if name == '<lambda>' else name}")
                else:
                    phrases.append(f"{part} as {' '.join(map(str, how))}")
            object.__setattr__(self, "description", ", ".join(phrases))
        instance("target of an observation mapping", self.target, ObservationTask, MappingError)
        check_unmapped_value(self.unmapped_value)
        if self.observations is None and not is_observation_task(self.source):
            raise MappingError(
                "a mapping into a task with tables needs a function from observations to its "
                "states' numbers: got none"
            )
        if self.observations is None:
            target, source = (shapes_of(task.observations) for task in (self.target, self.source))
            if target != source:
                raise MappingError(
                    "a mapping that leaves observations as they are needs those of one shape, or "
                    f"observations=: the target's are {target}, the source's {source}"
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
        """Whether all observations and actions are mapped to themselves."""
        return self.observations is None and self.actions is None and self.status is None

    @property
    def _source_actions(self) -> int | None:
        """The number of the source's actions; None if they are not numbered."""
        source = self.source
        n: int | None = source.n_actions if is_observation_task(source) else source.actions.size
        return n

    @property
    def parts(self) -> tuple[Any, ...]:
        """The functions and numbers that make the mapping."""
        actions = self.actions if callable(self.actions) else repr(self.actions)
        return self.observations, actions, self.status, self.unmapped_value

    def pairs(
        self, values: ValueSource, batch: Batch, scale: float = 1.0, shift: float = 0.0
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
        # Actions without a counterpart are unmapped in every state.
        missing = table == UNMAPPED
        if not missing.any():
            return phi
        return transferred(phi, np.where(missing, UNMAPPED, 0), self.unmapped_value, 1.0, 0.0)

    @cached_property
    def _fixed_actions(self) -> tuple[IntArray, IntArray, IntArray]:
        """The source action of each target action; the n mapped actions, (1, n); their columns."""
        table = self._actions(None, 1)[0]
        distinct, column = np.unique(np.maximum(table, 0), return_inverse=True)
        return table, distinct[None], column

    def states(
        self, values: ValueSource, observations: Batch, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return Phi(s) = scale V_source(f(s)) + shift, (n,) float64, as :meth:`pairs`."""
        counterparts, status = self._counterparts(observations)
        return self._transferred("V", values.v(counterparts), status, scale, shift)

    def coverage(self, observations: Batch) -> "Coverage":
        """Return how much of a sample of n stacked observations is mapped."""
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
            inside = [*map(space.contains, iterate(batch_space(space, n), counterparts))]
            outside = 1.0 - float(np.mean(np.asarray(inside)[mapped]))
        return replace(Coverage.of(index, n), outside=outside)

    def _counterparts(self, observations: Batch) -> tuple[Any, IntArray | None]:
        """Return the counterparts of observations, and their status: None if all are mapped."""
        n = batch_size(observations)
        images: Any = observations
        if self.observations is not None:
            images = self.observations(observations)
        status = None
        if self.status is not None:
            status = np.asarray(self.status(observations))
            if status.dtype == np.bool_:
                status = np.where(status, 0, UNMAPPED)
            status = _integers("status", status)
            if (status < ENDED).any():
                raise MappingError(
                    f"a mapping's status must be UNMAPPED, ENDED or 0: got {status.min()}"
                )
        if not is_observation_task(self.source):
            images = _integers("states", images)
            n_states = self.source.states.size
            if not (images.view(np.uint64) < n_states).all():  # both bounds at once
                bad = np.flatnonzero((images < ENDED) | (images >= n_states))
                if bad.size:
                    raise MappingError(
                        f"a mapping's states must lie in 0..{n_states - 1}, or be UNMAPPED or "
                        f"ENDED: observation {bad[0]} gives {images[bad[0]]}"
                    )
                status = images if status is None else np.where(images < 0, images, status)
                images = np.maximum(images, 0)
        if batch_size(images) != n or (status is not None and status.shape != (n,)):
            shape = (n,) if status is None else status.shape
            raise MappingError(
                f"a mapping must return {n} counterparts, as many as observations: got "
                f"{batch_size(images)}, and status of shape {shape}"
            )
        return images, status

    def _actions(self, observations: Batch | None, n: int) -> IntArray:
        """Return the source action of each target pair, (n, A)."""
        n_actions = self.target.n_actions
        if callable(self.actions):
            return self._checked_actions(self.actions(observations), (n, n_actions))
        row = np.arange(n_actions or 0) if self.actions is None else self.actions
        return np.broadcast_to(row, (n, len(row)))

    def _checked_actions(self, actions: npt.ArrayLike, shape: tuple[int | None, ...]) -> IntArray:
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
        """Return source values, (n,) or (n, m), scaled and shifted as the target reads them."""
        finite = np.isfinite(values)
        if status is None and finite.all():  # most often, and quick
            return rescale(values, scale, shift)
        allowed = finite | np.isneginf(values)  # -inf where an action is not available
        if not allowed.all():
            place = np.argwhere(~allowed)[0]
            raise MappingError(
                f"a source's values must be finite: {name} is {values[tuple(place)]} at the "
                f"counterpart of observation {place[0]}"
            )
        if status is None:
            status = np.zeros(len(values), np.int64)
        index = status.reshape(-1, *[1] * (values.ndim - 1))
        return transferred(values, index, self.unmapped_value, scale, shift)


def _integers(name: str, array: npt.ArrayLike) -> IntArray:
    if isinstance(array, np.ndarray) and array.dtype == np.int64:
        return array
    values = numbers(f"a mapping's {name}", array, MappingError)
    broken = values[values != values // 1]
    if broken.size:
        raise MappingError(f"a mapping's {name} must be whole numbers: got {broken[0]:g}")
    return np.asarray(array).astype(np.int64)


# -- coverage --------------------------------------------------------------------------------------

LARGEST_COVERAGE = 5_000_000  # coverage is counted if neither task has more pairs


@dataclass(frozen=True)
class Coverage:
    """How much of a target a mapping covers; the shares sum to 1."""

    size: int  # target pairs (s, a), s not terminal; or observations of a sample
    mapped: float  # share of pairs that read a source pair
    ended: float  # share of pairs that read a terminal source state, of value 0
    unmapped: float  # share of pairs without a counterpart
    # Of tasks with numbered states; None of a sample of observations.
    source_pairs: int | None = None  # source pairs (s, a), s not terminal
    never_used: int = 0  # source pairs that no target pair reads
    most_readers: int = 0  # most target pairs that read the same source pair
    mean_readers: float = 0.0  # mean target pairs that read a source pair, over those that are read
    # Share of the mapped observations whose counterpart lies outside the source's space, where the
    # source's values are extrapolated; NaN if nothing is mapped, or the source has numbered states.
    outside: float = math.nan

    _repr_html_ = printed

    @classmethod
    def of(cls, index: IntArray, size: int) -> Self:
        """Return the coverage of pairs whose source pair, `UNMAPPED` or `ENDED` is `index`."""
        mapped, ended = float((index >= 0).mean()), float((index == ENDED).mean())
        return cls(size, mapped, ended, float((index == UNMAPPED).mean()))

    def __str__(self) -> str:
        counts = counted(self.size, "target pair")
        if self.source_pairs is None:
            counts = f"the pairs of {counted(self.size, 'observation')}"
        text = (
            f"{self.mapped:.1%} of {counts} mapped, {self.ended:.1%} at the source's end, "
            f"{self.unmapped:.1%} unmapped"
        )
        if self.source_pairs is not None:
            return (
                f"{text}; {self.source_pairs - self.never_used:,} of "
                f"{counted(self.source_pairs, 'source pair')} are read, by "
                f"{self.mean_readers:.1f} target pairs on average and {self.most_readers:,} at most"
            )
        if math.isnan(self.outside):
            return text
        return f"{text}; {self.outside:.1%} of the counterparts outside the source's space"
