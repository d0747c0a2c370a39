"""Observations that are numbers, cut into bins, so that tables can be learnt."""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatTable, IntArray
from curricle.checks import numbers
from curricle.errors import TaskError
from curricle.tasks.spaces import Component, Space


@dataclass(frozen=True, eq=False)
class Bins:
    """An observation of n numbers as n components, each cut into bins at its edges.

    For `encode` of :func:`from_gymnasium`. What lies outside the outermost edges falls into the
    first or the last bin. Equal edges make equal bins.

    Parameters
    ----------
    edges : dict of str to (m + 1,) float array
        For each entry of an observation, in order, the name of its component and the ascending
        edges of its m bins; a bin includes its lower edge.

    Raises
    ------
    TaskError
        When edges do not ascend or make no bin; when called, on an observation that is not n
        numbers.

    Examples
    --------
    >>> bins = Bins({"position": [-1.2, -0.5, 0.6], "velocity": [-0.07, -0.01, 0.01, 0.07]})
    >>> bins.states
    Space(6 points: position[2] x velocity[3])
    >>> bins.states.label(bins(np.array([-0.5, -9.0])))
    'position=-0.5 and above velocity=below -0.01'
    """

    edges: Mapping[str, npt.ArrayLike]

    def __post_init__(self) -> None:
        if not isinstance(self.edges, Mapping) or not self.edges:
            raise TaskError(f"bins need a dict from names to edges: got {self.edges!r}")
        checked = {}
        for name, edges in self.edges.items():
            given = numbers(f"the edges of {name!r}", edges, TaskError)
            if given.ndim != 1 or given.size < 2 or not (np.diff(given) > 0).all():
                raise TaskError(
                    f"edges must be two or more ascending numbers: {name!r} has {given.tolist()}"
                )
            checked[str(name)] = tuple(given.tolist())
        object.__setattr__(self, "edges", checked)

    @cached_property
    def states(self) -> Space:
        """The space of all combinations of bins."""
        named = zip(self.edges, self._inner, strict=True)
        return Space(
            [Component(name, len(inner) + 1, labels=_labels(inner)) for name, inner in named]
        )

    @cached_property
    def _inner(self) -> list[tuple[float, ...]]:
        """The edges between the bins of each component."""
        each: Any = self.edges.values()
        return [edges[1:-1] for edges in each]

    def __call__(self, observation: FloatTable) -> int:
        """Return the number of the state that an observation, (n,) float, falls into."""
        values = observation.tolist()
        if len(values) != len(self._inner):
            raise TaskError(f"an observation must have {len(self._inner)} entries: got {values}")
        if any(value != value for value in values):
            raise TaskError(f"an observation must be of numbers: got {values}")
        return self.states.encode_one(tuple(map(bisect_right, self._inner, values)))

    def many(self, observations: FloatTable) -> IntArray:
        """Return the numbers of the states that N observations, (N, n) float, fall into, (N,).

        An :class:`ObservationMapping` reads a source's table with it.

        Examples
        --------
        >>> Bins({"position": [-1.2, -0.5, 0.6]}).many(np.array([[-0.7], [0.1]]))
        array([0, 1])
        """
        values = np.asarray(observations)
        if values.ndim != 2 or values.shape[1] != len(self._inner) or np.isnan(values).any():
            raise TaskError(
                f"observations must be numbers of shape (N, {len(self._inner)}): got shape "
                f"{values.shape}{', some of them NaN' * bool(np.isnan(values).any())}"
            )
        bins = map(partial(np.searchsorted, side="right"), self._inner, values.T)
        return self.states.encode(**dict(zip(self.edges, bins, strict=True)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Bins):
            return NotImplemented
        return list(self.edges.items()) == list(other.edges.items())

    def __hash__(self) -> int:
        return hash(tuple(self.edges.items()))


def _labels(inner: tuple[float, ...]) -> tuple[str, ...]:
    """Return different names for the bins between these edges."""
    if not inner:
        return ("any",)
    shown = [f"{edge:g}" for edge in inner]
    if len(set(shown)) < len(shown):
        shown = [repr(edge) for edge in inner]
    between = (f"{low} to {high}" for low, high in pairwise(shown))
    return f"below {shown[0]}", *between, f"{shown[-1]} and above"
