"""Potentials of transfers: an array, a lookup that learning reads, or over observations."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray
from curricle.checks import instance, numbers
from curricle.errors import CurriculumError, PotentialError, SettingError
from curricle.learning.potential import (
    MappedPotential,
    PairPotential,
    StateActionPotential,
    StatePotential,
    finite_scale,
)
from curricle.learning.shaping import QInitialisation
from curricle.learning.value_lookup import MEAN, MINIMUM, SourceTable, value_lookup
from curricle.tasks.mdp import Task, generative_model
from curricle.tasks.observation_task import ObservationTask, is_observation_task
from curricle.text import brief_repr
from curricle.transfer.aggregate import BUILT_IN, Aggregate, aggregate, built_in, mean
from curricle.transfer.by_components import LARGEST_INDEX, ComponentMapping
from curricle.transfer.mapping import (
    ENDED,
    UNMAPPED,
    Batch,
    ObservationMapping,
    ValueSource,
    no_actions,
    rescale,
    terminal_states,
    transferred,
)
from curricle.transfer.transfer import Transfer

MOST_SOURCES = 64  # most sources of a lookup, which has a bit for each source

# -- made of several transfers ---------------------------------------------------------------------


def combined_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
    unknown_value: float = 0.0,
) -> MappedPotential | StateActionPotential:
    """Return the aggregated potential of N transfers, as an array if it cannot be looked up."""
    if all(isinstance(edge.mapping, ComponentMapping) for edge in transfers):
        mapped = mapped_potential(task, transfers, source_values, function, unknown_value)
        if mapped is not None:
            return mapped
    pairs = generative_model(task).states.size * generative_model(task).actions.size
    if pairs > LARGEST_INDEX and built_in(function) is None:
        raise CurriculumError(
            f"an aggregate must be one of {', '.join(BUILT_IN)} for a target of more than "
            f"{LARGEST_INDEX:,} pairs, as any other function takes arrays of them: got "
            f"{getattr(function, '__name__', repr(function))} and {pairs:,} pairs"
        )
    each = zip(transfers, source_values, strict=True)
    phis = np.stack([edge.potential(q) for edge, q in each])
    unknown = np.isnan(phis).all(axis=0)
    phi = aggregate(function, phis, unknown_value)
    return StateActionPotential(task, phi, unknown if unknown.any() else None)


def mapped_potential(
    task: Task,
    transfers: Sequence[Transfer],
    source_values: Sequence[npt.ArrayLike],
    function: Aggregate,
    unknown_value: float = 0.0,
) -> MappedPotential | None:
    """Return the aggregated potential of mappings by name as a lookup; None if there is none."""
    # A lookup needs spaces that are whole boxes, and an aggregate of compiled loops.
    entry, several, sources = built_in(function), len(transfers) > 1, list[SourceTable]()
    if entry is None or len(transfers) > MOST_SOURCES:
        return None
    for edge, values in zip(transfers, source_values, strict=True):
        mapping: ComponentMapping = edge.mapping
        offsets = mapping.lookups()
        if offsets is None:
            return None
        q = np.asarray(values, dtype=np.float64)
        if several and entry.code == MEAN and np.isneginf(q).any():
            return None  # a lookup counts the sources that know a pair by its state and its action
        index = np.zeros(q.shape, dtype=np.int64)
        index[terminal_states(mapping.source)] = ENDED
        # A row and a column more are for pairs without a counterpart.
        index = np.pad(index, (0, 1), constant_values=UNMAPPED)
        read = transferred(np.pad(q, (0, 1)), index, mapping.unmapped_value, edge.scale, edge.shift)
        sources.append(SourceTable(read, offsets, mapping.actions))
    combine = entry.code if several else MINIMUM
    lookup = value_lookup(generative_model(task).states, sources, combine, unknown_value)
    return MappedPotential(task, lookup)


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

    def pairs(self, observations: Batch) -> FloatArray:
        """Return phi(s, a) of every action, (n, A) float64; PotentialError if not `of_actions`."""
        if not self.of_actions:
            raise no_actions(self)
        return self._aggregate(
            edge.mapping.pairs(values, observations, edge.scale, edge.shift)
            for edge, values in zip(self.edges, self.values, strict=True)
        )

    def q(self, observations: Batch, actions: npt.NDArray[Any]) -> FloatArray:
        """Return phi(s, a), of the shape of `actions`: (n,), or (n, m)."""
        pairs, chosen = self.pairs(observations), np.asarray(actions)
        if chosen.ndim == 2:
            return np.take_along_axis(pairs, chosen, axis=1)
        return np.asarray(pairs[np.arange(len(pairs)), chosen])

    def v(self, observations: Batch) -> FloatArray:
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


AnyPotential = PairPotential | ObservationPotential
"""What sources, or a user, give a target: phi of numbered states, or of observations."""

# -- written by hand -------------------------------------------------------------------------------


def written_potential(
    name: str, task: Any, potential: Any, sources: Sequence[str] = ()
) -> AnyPotential:
    """Return a potential that a user wrote for a task, as :class:`Curriculum` takes it.

    CurriculumError names the task if the potential is unfit, or if the task has `sources` too.
    """
    if sources:
        raise CurriculumError(
            f"a task's potential comes from sources or is written by hand: {name!r} has one by "
            f"hand and the source {sources[0]!r}; leave out one, or compare both as two arms"
        )
    phi = potential(task) if callable(potential) else potential
    try:
        if is_observation_task(task):
            known = isinstance(phi, ObservationPotential)
            return phi if known else ObservationPotential.of(task, phi)
        if not isinstance(phi, StatePotential | PairPotential):
            phi = numbers("a potential", phi, PotentialError)
            phi = StatePotential(task, phi) if phi.ndim == 1 else phi
        if isinstance(phi, StatePotential) and phi.changes:
            raise PotentialError(
                "it must not change with time, as learn(task, shaping=StateShaping(phi)) allows"
            )
        if isinstance(phi, StatePotential):
            # Q from Phi(s) for all a learns as with F = gamma Phi(s') - Phi(s) (Wiewiora 2003).
            actions = generative_model(task).actions.size
            phi = StateActionPotential(phi.task, np.tile(phi.at()[:, None], actions))
        return QInitialisation(phi).for_task(task).potential  # type: ignore[no-any-return]
    except (PotentialError, SettingError) as error:
        raise CurriculumError(f"the potential of {name!r} cannot be used: {error}") from None
