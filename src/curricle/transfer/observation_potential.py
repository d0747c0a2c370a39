"""Potentials over observations: value sources, mapped, scaled and aggregated."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.checks import instance
from curricle.errors import PotentialError
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.aggregation import UNCHANGED_ALONE, Aggregate, aggregate, mean
from curricle.transfer.edges import Transfer
from curricle.transfer.mapping import rescale
from curricle.transfer.observation_mapping import ObservationMapping
from curricle.transfer.value_sources import ValueSource, no_actions

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ObservationPotential:
    """phi(s, a) = scale g(phi_1, ..., phi_N) + shift, read for n observations at once.

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

    @property
    def highest(self) -> float:
        """NaN: the maximum over all observations is not known."""
        return float("nan")

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
        """Return scale phi + shift."""
        return replace(self, scale=scale * self.scale, shift=scale * self.shift + shift)

    def _aggregate(self, each: Iterable[FloatArray]) -> FloatArray:
        """Return scale g + shift of the sources' potentials, N of (n, A) -> (n, A)."""
        found = list(each)
        alone = len(found) == 1 and self.function in UNCHANGED_ALONE
        phi = found[0] if alone else aggregate(self.function, np.array(found))
        return rescale(phi, self.scale, self.shift)
