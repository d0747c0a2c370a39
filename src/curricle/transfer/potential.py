"""Potentials of transfers: as an array, looked up during learning, or over observations."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, FloatTable, IntArray, frozen
from curricle.checks import instance
from curricle.errors import CurriculumError, PotentialError
from curricle.learning.potential import (
    LARGEST_POTENTIAL,
    PairPotential,
    StateActionPotential,
    finite_scale,
    numbered_states,
    too_large,
)
from curricle.learning.value_lookup import MEAN, MINIMUM, ValueLookup, read_row
from curricle.tasks.kernel import compiled_once, inverse_of
from curricle.tasks.mdp import Task, available_actions, duplicated, generative_model
from curricle.tasks.observation_task import ObservationTask
from curricle.tasks.spaces import MISSING, Space
from curricle.text import brief_repr
from curricle.transfer.aggregate import BUILT_IN, Aggregate, aggregate, built_in, mean
from curricle.transfer.by_components import LARGEST_INDEX, ComponentMapping
from curricle.transfer.mapping import (
    ENDED,
    UNMAPPED,
    ObservationMapping,
    ValueSource,
    no_actions,
    rescale,
    terminal_states,
    transferred,
)
from curricle.transfer.transfer import Transfer

MOST_SOURCES = 64  # most sources of a lookup, which has a bit for each source

# -- looked up during learning ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MappedPotential(PairPotential):
    """phi(s, a) computed from the sources' values one state at a time, without an array.

    :class:`Curriculum` makes it from transfers with mappings by name (:func:`project`) and an
    aggregate of the library. The lookup holds the sources' values, and tables that lead from the
    task's states and actions to these values.

    Raises
    ------
    PotentialError
        When the lookup does not fit the task, or the size of a value exceeds 1e15.

    Examples
    --------
    >>> from curricle import Curriculum, Pursuit, Transfer, project
    >>> hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    >>> edge = Transfer("chase", "hunt", project(hunt, chase, predator="predator_1"))
    >>> curriculum = Curriculum({"chase": chase, "hunt": hunt}, [edge], budget=1000)
    >>> phi = curriculum.train().potentials["hunt"][0]
    >>> type(phi).__name__, phi.values.shape
    ('MappedPotential', (729, 25))
    """

    task: Task
    lookup: ValueLookup

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        generative = generative_model(self.task)
        if not fits_task(self.lookup, generative.states, generative.actions.size):
            raise PotentialError(f"a lookup must be made for its task: {self.task} needs another")
        values = self.lookup.values
        known = np.isfinite(values)  # NaN where a pair is unmapped
        sizes = values.max(initial=0.0, where=known), -values.min(initial=0.0, where=known)
        largest = abs(self.lookup.scale) * max(sizes) + abs(self.lookup.shift)
        if largest > LARGEST_POTENTIAL:
            raise too_large("phi", f"the sources' values give {largest:g}")

    @property
    def kernel(self) -> ValueLookup:
        """The lookup."""
        return self.lookup

    @cached_property
    def values(self) -> FloatArray:
        """phi(s, a) as an array, (S, A) float64, computed at first use."""
        return frozen(self.pairs(np.arange(generative_model(self.task).states.size)))

    def fill(self, q: FloatTable, initial: float) -> None:
        """Write initial + phi(s, a) into a table, (S, A)."""
        read_table(self.lookup._replace(initial=initial), q)

    def pairs(self, states: npt.NDArray[np.integer[Any]]) -> FloatArray:
        """Return phi(s, a) of n states, (n, A) float64, without computing other states."""
        states = numbered_states(self.task, states)
        generative = generative_model(self.task)
        phi = np.empty((len(states), generative.actions.size))
        read_rows(self.lookup, states, phi)
        if generative.terminal is not None:
            phi[generative.terminal[states]] = 0.0
        return duplicated(phi, available_actions(generative, states))

    def rescaled(self, scale: float, shift: float = 0.0) -> Self:
        """Return the potential scale phi(s, a) + shift."""
        lookup, (scale, shift) = self.lookup, finite_scale(scale, shift)
        lookup = lookup._replace(scale=scale * lookup.scale, shift=scale * lookup.shift + shift)
        return replace(self, lookup=lookup)


def fits_task(lookup: Any, states: Space, n_actions: int) -> bool:
    """Return whether all lookups of a task's states stay within the sources: loops do not check."""
    if not isinstance(lookup, ValueLookup) or not states.is_box:
        return False
    n, c = len(lookup.first), len(states.components)
    if n == 0:
        return lookup.action.shape == (0, n_actions)
    shapes = lookup.strides_at.shape, lookup.action.shape, lookup.unmapped_row.shape
    sizes = states.shape[::-1]
    inverses = tuple(inverse_of(size, states.size) for size in sizes)
    if shapes != ((n, c), (n, n_actions), (n,)):
        return False
    if (*lookup.size, *lookup.inverse) != (*sizes, *inverses):
        return False
    ends = lookup.strides_at + np.array(sizes)
    if lookup.strides_at.min() < 0 or ends.max() > len(lookup.strides):
        return False
    last = lookup.first.copy()  # the offset of each source's last mapped state
    for source, component in np.ndindex(n, c):
        at, end = lookup.strides_at[source, component], ends[source, component]
        last[source] += max(int(lookup.strides[at:end].max()), 0)
    last = np.maximum(last, lookup.unmapped_row) + lookup.action.max(axis=1)
    lowest = min(part.min() for part in (lookup.first, lookup.unmapped_row, lookup.action))
    return bool(lowest >= 0 and last.max() < len(lookup.values))


@compiled_once
def read_table(lookup, q):
    """Write initial value + phi into every row of a table, (S, A)."""
    row = np.empty(q.shape[1])  # a table may have float32: numbers are rounded once, when written
    for state in range(np.uint64(q.shape[0])):
        read_row(lookup, state, row)
        for action in range(row.shape[0]):
            q[state, action] = row[action]


@compiled_once
def read_rows(lookup, states, q):
    """Write initial value + phi of n states into a table of n rows, (n, A) float64."""
    for i in range(states.shape[0]):
        read_row(lookup, np.uint64(states[i]), q[i])


# -- made of several transfers ---------------------------------------------------------------------


def combined_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
    unknown_value: float = 0.0,
) -> MappedPotential | StateActionPotential:
    """Return the aggregated potential of N transfers, as an array if it cannot be looked up."""
    mapped = mapped_potential(task, transfers, source_values, function, unknown_value)
    if mapped is not None:
        return mapped
    pairs = generative_model(task).states.size * generative_model(task).actions.size
    if pairs > LARGEST_INDEX and ((known := built_in(function)) is None or known.code is None):
        raise CurriculumError(
            f"an aggregate must be one of {', '.join(BUILT_IN)} for a target of more than "
            f"{LARGEST_INDEX:,} pairs, as any other function takes arrays of them: got "
            f"{getattr(function, '__name__', repr(function))} and {pairs:,} pairs"
        )
    phis = [edge.potential(q) for edge, q in zip(transfers, source_values, strict=True)]
    return StateActionPotential(task, aggregate(function, np.stack(phis), unknown_value))


def mapped_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
    unknown_value: float = 0.0,
) -> MappedPotential | None:
    """Return the aggregated potential as a lookup; None if it cannot be looked up."""
    # A lookup needs mappings by name between whole boxes, and an aggregate of compiled loops.
    by_name = [edge.mapping for edge in transfers if isinstance(edge.mapping, ComponentMapping)]
    offsets = [parts for parts in (mapping.lookups() for mapping in by_name) if parts is not None]
    known = built_in(function)
    if known is None or known.code is None:
        return None
    if len(offsets) < len(transfers) or len(transfers) > MOST_SOURCES:
        return None
    tables, actions, strides = list[FloatArray](), list[IntArray](), list[IntArray]()
    partial = False
    for edge, values, of_components in zip(transfers, source_values, offsets, strict=True):
        # The values of a source that the target reads, (S' + 1, A' + 1).
        q = np.pad(np.asarray(values, dtype=np.float64), (0, 1))
        if (nothing := np.isneginf(q).any()) and known.code == MEAN and len(transfers) > 1:
            return None  # a lookup counts the sources that know a pair by its state and its action
        index = np.zeros(q.shape, dtype=np.int64)
        index[:-1][terminal_states(edge.mapping.source)] = ENDED
        index[-1], index[:, -1] = UNMAPPED, UNMAPPED
        unmapped_value = edge.mapping.unmapped_value
        tables.append(transferred(q, index, unmapped_value, edge.scale, edge.shift))
        width, action = q.shape[1], edge.mapping.actions
        actions.append(np.where(action == MISSING, width - 1, action))
        strides += [np.where(at == MISSING, -1, at * width) for at in reversed(of_components)]
        # Tables have a row and a column for unmapped pairs, even if all pairs are mapped.
        missing = any((part == MISSING).any() for part in (action, *of_components))
        partial |= bool(missing or nothing) and unmapped_value is None
    first = _starts(tables)
    states = generative_model(task).states
    sizes = states.shape[::-1]
    lookup = ValueLookup(
        values=frozen(np.concatenate([table.ravel() for table in tables])),
        first=frozen(first),
        unmapped_row=frozen(first + [table.size - table.shape[1] for table in tables]),
        size=frozen(np.array(sizes, np.uint64)),
        inverse=frozen(np.array([inverse_of(n, states.size) for n in sizes], np.uint64)),
        strides_at=frozen(_starts(strides).reshape(len(transfers), -1)),
        strides=frozen(np.concatenate(strides)),
        action=frozen(np.stack(actions)),
        combine=MINIMUM if len(transfers) == 1 else known.code,
        partial=partial,
        unknown=float(unknown_value),
        scale=1.0,
        shift=0.0,
        initial=0.0,
    )
    return MappedPotential(task, lookup)


def _starts(arrays: Sequence[npt.NDArray[Any]]) -> IntArray:
    """Return the index at which each array begins in their concatenation."""
    ends: IntArray = np.cumsum([array.size for array in arrays])
    return np.concatenate([[0], ends[:-1]])


# -- over observations -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ObservationPotential:
    """phi(s, a) = scale g(phi_1, ..., phi_N) + shift, read for n observations at once.

    It is a :class:`ValueSource`. If all sources have action values, and actions are numbered, then
    Phi(s) = max_a phi(s, a); else Phi is the aggregate of the sources' V(s).

    Parameters
    ----------
    task : ObservationTask
        The target.
    edges, values : sequences of N Transfer and N ValueSource
        Transfers, each with an :class:`ObservationMapping`, and the values of their sources.
    function : callable
        g, (N, S, A) -> (S, A), with n observations in place of S; A = 1 for state values.
    scale, shift : float
    unknown_value : float
        g at pairs that all transfers leave unmapped.

    Raises
    ------
    PotentialError
        When transfers, values and task do not fit each other.

    Examples
    --------
    >>> from curricle import observation_task
    >>> from curricle.transfer import FunctionValues
    >>> car = observation_task("MountainCar-v0")
    >>> height = FunctionValues(state_values=lambda cars: cars[:, 0])
    >>> edge = Transfer("height", "car", ObservationMapping(car, car), scale=10.0)
    >>> phi = ObservationPotential(car, [edge], [height])
    >>> phi.v(np.array([[0.5, 0.0], [-1.0, 0.0]])), phi.of_actions
    (array([  5., -10.]), False)
    """

    task: ObservationTask
    edges: Sequence[Transfer]
    values: Sequence[ValueSource]
    function: Aggregate = mean
    scale: float = 1.0
    shift: float = 0.0
    unknown_value: float = 0.0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", tuple(self.edges))
        object.__setattr__(self, "values", tuple(self.values))
        if not self.edges or len(self.edges) != len(self.values):
            raise PotentialError(
                "a potential over observations needs values for each of its transfers, at least "
                f"one: got {len(self.edges)} transfers and {len(self.values)} values"
            )
        for edge, values in zip(self.edges, self.values, strict=True):
            instance(f"values of {edge.source}", values, ValueSource, PotentialError)
            instance(f"mapping of {edge.source}", edge.mapping, ObservationMapping, PotentialError)
            if edge.mapping.target != self.task:
                raise PotentialError(
                    f"a potential's mappings must be made for its task, {self.task}: that of "
                    f"{edge.source!r} was made for {edge.mapping.target}"
                )

    @classmethod
    def of(cls, task: ObservationTask, values: ValueSource) -> Self:
        """Return the potential of a task that reads `values` unchanged."""
        edge = Transfer("values", "task", ObservationMapping(task, task))
        return cls(task, [edge], [values])

    @cached_property
    def of_actions(self) -> bool:
        """Whether it has action values."""
        return self.task.n_actions is not None and all(v.of_actions for v in self.values)

    def pairs(self, observations: Any) -> FloatArray:
        """Return phi(s, a) of every action, (n, A) float64; PotentialError if not `of_actions`."""
        if not self.of_actions:
            raise no_actions(self)
        return self._aggregate(
            edge.mapping.pairs(values, observations, edge.scale, edge.shift)
            for edge, values in zip(self.edges, self.values, strict=True)
        )

    def q(self, observations: Any, actions: npt.NDArray[Any]) -> FloatArray:
        """Return phi(s, a), of the shape of `actions`: (n,), or (n, m)."""
        pairs, chosen = self.pairs(observations), np.asarray(actions)
        if chosen.ndim == 2:
            return np.take_along_axis(pairs, chosen, axis=1)
        return np.asarray(pairs[np.arange(len(pairs)), chosen])

    def v(self, observations: Any) -> FloatArray:
        """Return Phi(s), (n,) float64."""
        if self.of_actions:
            return np.asarray(self.pairs(observations).max(axis=1))
        return self._aggregate(
            edge.mapping.states(values, observations, edge.scale, edge.shift)[:, None]
            for edge, values in zip(self.edges, self.values, strict=True)
        )[:, 0]

    def rescaled(self, scale: float, shift: float = 0.0) -> Self:
        """Return scale phi + shift; PotentialError unless both are finite numbers."""
        scale, shift = finite_scale(scale, shift)
        return replace(self, scale=scale * self.scale, shift=scale * self.shift + shift)

    def _aggregate(self, of_sources: Iterable[FloatArray]) -> FloatArray:
        """Return scale g + shift of the sources' potentials, N of (n, A) -> (n, A)."""
        phis = list(of_sources)
        if len(phis) == 1 and built_in(self.function) and not np.isnan(phis[0]).any():
            return rescale(phis[0], self.scale, self.shift)
        phi = aggregate(self.function, np.array(phis), self.unknown_value)
        return rescale(phi, self.scale, self.shift)
