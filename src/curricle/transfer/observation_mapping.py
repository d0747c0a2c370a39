"""Mappings f(s, a) of observations: functions on batches, with the same rules as index mappings."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, number, numbers
from curricle.errors import MappingError
from curricle.tasks.observation_task import ObservationTask, batch_size, is_observation_task
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.value_sources import ValueSource, no_actions

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class ObservationCoverage:
    """How much of what was observed a mapping reaches.

    Attributes
    ----------
    observations : int
        Looked at.
    mapped, ended, unmapped : float
        Shares of their pairs (s, a); they sum to 1.
    outside : float
        Share of the mapped observations whose counterpart lies outside the source's space, where
        its values are guesses; NaN where there is none.

    Examples
    --------
    >>> print(ObservationCoverage(200, 0.75, 0.0, 0.25, 0.0))
    75.0% of the pairs of 200 observations mapped, 0.0% at the source's end, 25.0% unmapped; ...
    """

    observations: int
    mapped: float
    ended: float
    unmapped: float
    outside: float

    def __str__(self) -> str:
        words = (
            f"{self.mapped:.1%} of the pairs of {self.observations:,} observations mapped, "
            f"{self.ended:.1%} at the source's end, {self.unmapped:.1%} unmapped"
        )
        if np.isnan(self.outside):
            return words
        return f"{words}; {self.outside:.1%} of the counterparts outside the source's space"


@dataclass(frozen=True, eq=False)
class ObservationMapping:
    """A mapping of a target's observations and actions to a source's, n of them at once.

    Parameters
    ----------
    target : ObservationTask
    source : ObservationTask or Task
    observations : callable, optional
        The target's stacked observations -> the source's, as many; of a source with tables its
        states' numbers, (n,) ints, which may be `UNMAPPED` or `ENDED`. By default the same.
    actions : (A,) int array or callable, optional
        The source's action for each of the target's, `UNMAPPED` where none; or a function
        observations -> (n, A) of them. By default the same numbers.
    status : callable, optional
        observations -> (n,) bool, whether there is a counterpart; or ints, `UNMAPPED` or `ENDED`
        where there is none. What then stands in its place is not read.
    unmapped_value : float
        What unmapped pairs are worth. 0 is optimistic where rewards are negative.
    words : str
        What it says, for people; by default the names of its functions.

    Raises
    ------
    MappingError
        When the tasks cannot be mapped so, or a function returns what it must not.

    Examples
    --------
    A car that does not know how fast it is reads the values of one that stands still.

    >>> from curricle.transfer.value_sources import FunctionValues
    >>> from curricle.tasks.observation_task import Registered
    >>> car = ObservationTask(Registered("MountainCar-v0"))
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
    unmapped_value: float = 0.0
    words: str = ""

    def __post_init__(self) -> None:
        if not self.words:
            object.__setattr__(self, "words", self._names())
        instance("target of an observation mapping", self.target, ObservationTask, MappingError)
        number("unmapped_value", self.unmapped_value, MappingError)
        if self.observations is None and not is_observation_task(self.source):
            raise MappingError(
                "a mapping into a task with tables needs a function from observations to its "
                "states' numbers: got none"
            )
        if self.actions is None:
            mine, yours = self.target.n_actions, self._source_actions
            if mine is not None and yours is not None and mine > yours:
                raise MappingError(
                    f"a mapping that leaves actions as they are needs as many of them: the target "
                    f"has {mine}, the source {yours}"
                )
        elif not callable(self.actions):
            table = self._checked_actions(self.actions, (self.target.n_actions,))
            object.__setattr__(self, "actions", table)

    def _names(self) -> str:
        """Return the functions' names."""
        parts = {"observations": self.observations, "actions": self.actions}
        said = [f"{part} {_called(given)}" for part, given in parts.items()]
        said += [f"where {_called(self.status)} finds them"] if self.status is not None else []
        return ", ".join(said)

    @property
    def _source_actions(self) -> int | None:
        """The number of the source's actions; None where they are not numbered."""
        if is_observation_task(self.source):
            return self.source.n_actions  # type: ignore[no-any-return]
        return int(self.source.actions.size)

    def pairs(
        self, values: ValueSource, observations: Any, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) = scale Q_source(f(s, a)) + shift of every action, (n, A) float64.

        It is `shift` where ended and `unmapped_value` where unmapped.
        """
        if self.target.n_actions is None:
            raise MappingError(f"pairs need actions that are numbered: got {self.target.actions}")
        if not values.of_actions:
            raise no_actions(values)
        there, status = self._there(observations)
        n = batch_size(observations)
        if callable(self.actions):
            table = self._actions(observations, n)
            read, place, missing = np.maximum(table, 0), None, table == UNMAPPED
            lacking = bool(missing.any())
        else:
            asked, place, missing, lacking = self._asked
            read = asked[None].repeat(n, axis=0)
        q = values.q(there, read)
        self._check_finite(q, "Q")
        found = self._completed(q, status, scale, shift)
        if place is not None:
            found = found.take(place, axis=1)
        return np.where(missing, self.unmapped_value, found) if lacking else found

    @cached_property
    def _asked(self) -> tuple[IntArray, IntArray, npt.NDArray[np.bool_], bool]:
        """The source's actions, each once; where each of the target's is there; which have none."""
        table = self._actions(None, 1)[0]
        asked, place = np.unique(np.maximum(table, 0), return_inverse=True)
        missing = table == UNMAPPED
        return asked, place, missing, bool(missing.any())

    def states(
        self, values: ValueSource, observations: Any, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return Phi(s) = scale V_source(f(s)) + shift, (n,) float64; else as :meth:`pairs`."""
        there, status = self._there(observations)
        v = values.v(there)
        self._check_finite(v, "V")
        return self._completed(v, status, scale, shift)

    def coverage(self, observations: Any) -> ObservationCoverage:
        """Return how much of some observations, n stacked, is reached."""
        there, said = self._there(observations)
        n = batch_size(observations)
        status = np.zeros(n, np.int64) if said is None else said
        mapped = status >= 0
        kinds = np.broadcast_to(status[:, None], (n, self.target.n_actions or 1))
        if self.target.n_actions is not None:
            lost = self._actions(observations, n) == UNMAPPED
            kinds = np.where(lost, UNMAPPED, kinds)
        outside = float("nan")
        if is_observation_task(self.source) and mapped.any():
            from gymnasium.vector.utils import iterate

            rows = list(iterate(_stacked_space(self.source, n), there))
            inside = [self.source.observations.contains(row) for row in rows]
            outside = 1.0 - float(np.mean(np.asarray(inside)[mapped]))
        return ObservationCoverage(
            observations=n,
            mapped=float((kinds >= 0).mean()),
            ended=float((kinds == ENDED).mean()),
            unmapped=float((kinds == UNMAPPED).mean()),
            outside=outside,
        )

    def _there(self, observations: Any) -> tuple[Any, IntArray | None]:
        """Return the counterparts, readable all, and the status of each, (n,): None if all map."""
        n = batch_size(observations)
        there = observations if self.observations is None else self.observations(observations)
        status = None
        if self.status is not None:
            said = np.asarray(self.status(observations))
            known = np.where(said, 0, UNMAPPED) if said.dtype == np.bool_ else said
            status = _whole("status", known)
        if not is_observation_task(self.source):
            there = _whole("states", there)
            if self._leave(there):
                status = there if status is None else np.where(there < 0, there, status)
                there = np.maximum(there, 0)
        if batch_size(there) != n or (status is not None and status.shape != (n,)):
            shape = (n,) if status is None else status.shape
            raise MappingError(
                f"a mapping must return as many as it was given, {n}: got {batch_size(there)} "
                f"counterparts and status of shape {shape}"
            )
        return there, status

    def _leave(self, states: IntArray) -> bool:
        """Return whether any of the states is UNMAPPED or ENDED; MappingError if one is none."""
        if (states.view(np.uint64) < self.source.states.size).all():  # both bounds at once
            return False
        bad = np.flatnonzero((states < ENDED) | (states >= self.source.states.size))
        if bad.size:
            raise MappingError(
                f"a mapping's states must lie in 0..{self.source.states.size - 1}, or be UNMAPPED "
                f"or ENDED: observation {bad[0]} gives {states[bad[0]]}"
            )
        return True

    def _actions(self, observations: Any, n: int) -> IntArray:
        """Return the source's action for each pair, (n, A)."""
        n_actions = self.target.n_actions
        if callable(self.actions):
            return self._checked_actions(self.actions(observations), (n, n_actions))
        row = np.arange(n_actions or 0) if self.actions is None else self.actions
        return np.broadcast_to(row, (n, len(row)))

    def _checked_actions(self, actions: Any, shape: tuple[int | None, ...]) -> IntArray:
        table, most = _whole("actions", actions), self._source_actions
        if table.shape != shape:
            raise MappingError(f"a mapping's actions must have shape {shape}: got {table.shape}")
        bad = table[(table < UNMAPPED) | (table >= (most or np.inf))]
        if bad.size:
            raise MappingError(
                f"a mapping's actions must lie in 0..{(most or 0) - 1} or be UNMAPPED: got {bad[0]}"
            )
        return table

    def _completed(
        self, values: FloatArray, status: IntArray | None, scale: float, shift: float
    ) -> FloatArray:
        """Return what values (n,) or (n, A) are worth, with what stands in for those not there."""
        if scale != 1 or shift != 0:
            values = scale * values + shift
        if status is None:
            return values
        status = status.reshape(-1, *[1] * (values.ndim - 1))
        fixed = np.where(status == UNMAPPED, self.unmapped_value, shift)
        return np.asarray(np.where(status >= 0, values, fixed))

    def _check_finite(self, values: FloatArray, what: str) -> None:
        if not np.isfinite(values).all():
            place = np.argwhere(~np.isfinite(values))[0]
            raise MappingError(
                f"a source's values must be finite: {what} is {values[tuple(place)]} at the "
                f"counterpart of observation {place[0]}"
            )


def _called(given: Any) -> str:
    if given is None:
        return "as they are"
    if not callable(given):
        return f"as {' '.join(map(str, given))}"
    name = getattr(given, "__name__", "<lambda>")
    return "by a function" if name == "<lambda>" else f"by {name}"


def _whole(what: str, given: Any) -> IntArray:
    if isinstance(given, np.ndarray) and given.dtype == np.int64:
        return given
    found = numbers(f"a mapping's {what}", given, MappingError)
    if not np.issubdtype(np.asarray(given).dtype, np.integer) and (found != found // 1).any():
        raise MappingError(f"a mapping's {what} must be whole numbers: got {found.flat[0]!r} ...")
    return np.asarray(given).astype(np.int64)


def _stacked_space(task: ObservationTask, n: int) -> Any:
    from gymnasium.vector.utils import batch_space

    return batch_space(task.observations, n)
