"""Potentials of transfers: an array, looked up while learning, or over observations."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, IntArray, frozen
from curricle.checks import instance
from curricle.errors import PotentialError
from curricle.learning.potential import MappedPotential, StateActionPotential, finite_scale
from curricle.learning.value_lookup import (
    MAXIMUM,
    MEAN,
    MINIMUM,
    MOST_SOURCES,
    TOTAL,
    ValueLookup,
)
from curricle.tasks.observation_task import ObservationTask
from curricle.tasks.simd import inverse_of
from curricle.tasks.spaces import MISSING
from curricle.tasks.task import Task, generative_model
from curricle.text import brief_repr
from curricle.transfer.aggregation import (
    UNCHANGED_ALONE,
    Aggregate,
    aggregate,
    maximum,
    mean,
    minimum,
    total,
)
from curricle.transfer.component_mapping import ComponentMapping
from curricle.transfer.edges import Transfer
from curricle.transfer.mapping import ENDED, UNMAPPED, rescale, terminal_states, transferred
from curricle.transfer.observation_mapping import ObservationMapping, ValueSource, no_actions

COMPILED_AGGREGATES: dict[Aggregate, int] = {
    minimum: MINIMUM,
    maximum: MAXIMUM,
    mean: MEAN,
    total: TOTAL,
}


def combined_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
    unknown_value: float = 0.0,
) -> MappedPotential | StateActionPotential:
    """Return the aggregated potential of N transfers, as an array where it cannot be looked up.

    `source_values` are N (S', A') float arrays; phi is `unknown_value` where no source knows
    anything.
    """
    mapped = mapped_potential(task, transfers, source_values, function, unknown_value)
    if mapped is not None:
        return mapped
    each = [edge.potential(q) for edge, q in zip(transfers, source_values, strict=True)]
    return StateActionPotential(task, aggregate(function, np.stack(each), unknown_value))


def mapped_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
    unknown_value: float = 0.0,
) -> MappedPotential | None:
    """Return the aggregated potential, looked up while learning; None if it cannot be.

    It can where all mappings, at most 64, go by component names between whole boxes and the
    aggregate is one of the library's own.
    """
    found = [t.mapping.lookups() for t in transfers if isinstance(t.mapping, ComponentMapping)]
    offsets = [one for one in found if one is not None]
    # By identity: an aggregate may be any object that can be called, also one without a hash.
    combine = next((code for known, code in COMPILED_AGGREGATES.items() if known is function), None)
    if combine is None or len(offsets) < len(transfers) or len(transfers) > MOST_SOURCES:
        return None
    tables = [_padded_table(edge, q) for edge, q in zip(transfers, source_values, strict=True)]
    actions, strides = list[IntArray](), list[IntArray]()
    for edge, table, of_components in zip(transfers, tables, offsets, strict=True):
        width, action = table.shape[1], edge.mapping.actions
        actions.append(np.where(action == MISSING, width - 1, action))
        strides += [np.where(one == MISSING, -1, one * width) for one in reversed(of_components)]
    first = _starts(tables)
    states = generative_model(task).states
    sizes = [part.size for part in reversed(states.components)]
    # In tables, a row and a column are for unmapped pairs also where no pair is.
    complete = all(
        edge.mapping.unmapped_value is not None
        or not any((one == MISSING).any() for one in (edge.mapping.actions, *of_components))
        for edge, of_components in zip(transfers, offsets, strict=True)
    )
    lookup = ValueLookup(
        values=frozen(np.concatenate([table.ravel() for table in tables])),
        first=frozen(first),
        unmapped_row=frozen(first + [table.size - table.shape[1] for table in tables]),
        size=frozen(np.array(sizes, np.uint64)),
        inverse=frozen(np.array([inverse_of(n, states.size) for n in sizes], np.uint64)),
        strides_at=frozen(_starts(strides).reshape(len(transfers), -1)),
        strides=frozen(np.concatenate(strides)),
        action=frozen(np.stack(actions)),
        combine=combine,
        partial=not complete,
        unknown=float(unknown_value),
        scale=1.0,
        shift=0.0,
        initial=0.0,
    )
    return MappedPotential(task, lookup)


def _starts(arrays: Sequence[npt.NDArray[Any]]) -> IntArray:
    """Return where each array begins when they are put one after the other."""
    ends: IntArray = np.cumsum([array.size for array in arrays])
    return np.concatenate([[0], ends[:-1]])


def _padded_table(transfer: Transfer, source_values: npt.ArrayLike) -> FloatArray:
    """Return what a target reads of a source, (S' + 1, A' + 1).

    Pairs that are unmapped read the last row or column, which are NaN where nothing is known.
    """
    mapping = transfer.mapping
    q = np.pad(np.asarray(source_values, dtype=np.float64), (0, 1))
    index = np.zeros(q.shape, dtype=np.int64)
    index[:-1][terminal_states(mapping.source)] = ENDED
    index[-1], index[:, -1] = UNMAPPED, UNMAPPED
    return transferred(q, index, mapping.unmapped_value, transfer.scale, transfer.shift)


@dataclass(frozen=True, eq=False)
class ObservationPotential:
    """phi(s, a) = scale g(phi_1, ..., phi_N) + shift, read for n observations at once.

    g skips the sources whose mapping leaves an observation unmapped.

    It is a :class:`ValueSource` itself. Where all sources have action values, and the actions are
    numbered, Phi(s) = max_a phi(s, a); else it is the aggregate of the sources' V(s).

    Parameters
    ----------
    task : ObservationTask
        The target.
    edges : sequence of N Transfer
        With an :class:`ObservationMapping` each.
    values : sequence of N ValueSource
        Of the source of each.
    function : callable
        g, (N, S, A) -> (S, A) as everywhere; called with n observations as S, of states with A = 1.
    scale, shift : float
    unknown_value : float
        g where no source knows anything.

    Raises
    ------
    PotentialError
        When there is no source, or a mapping was made for another target.

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

    def _aggregate(self, each: Iterable[FloatArray]) -> FloatArray:
        """Return scale g + shift of the sources' potentials, N of (n, A) -> (n, A)."""
        found = list(each)
        if len(found) == 1 and self.function in UNCHANGED_ALONE and not np.isnan(found[0]).any():
            return rescale(found[0], self.scale, self.shift)
        phi = aggregate(self.function, np.array(found), self.unknown_value)
        return rescale(phi, self.scale, self.shift)
