"""What a search for mappings proposes."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.errors import MappingError
from curricle.frozen_arrays import frozen
from curricle.transfer.mapping import UNMAPPED, StateActionMapping

NOT_PROVEN = float("nan")


@dataclass(frozen=True, eq=False)
class SearchedMapping(StateActionMapping):
    """A mapping that a search made pair by pair, with the words that say how.

    Parameters
    ----------
    target, source, index, unmapped_value
        As in :class:`StateActionMapping`.
    how : str
        How it was found.
    steps : int
        Steps that the search took in both tasks, where it had no tables of them; a curriculum
        charges them as it charges those of sources.
    shifts : (S, A) float64, optional
        Added to what is read of the source, before a transfer scales and shifts it; none by
        default. Where the source stands for several parts of the target, each part has its own.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer
    >>> from curricle.transfer.descriptions import mapping_words
    >>> line = GridWorld("ST")
    >>> index = [[0, 1, 2, 3], [-2, -2, -2, -2]]
    >>> mapping_words(Transfer("a", "b", SearchedMapping(line, line, index, how="nearest pair")))
    'found: nearest pair'
    """

    how: str = ""
    steps: int = 0
    shifts: FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.shifts is None:
            return
        shifts = np.array(self.shifts, dtype=np.float64)
        if shifts.shape != self.index.shape or not np.isfinite(shifts).all():
            raise MappingError(
                f"shifts of a mapping must be finite numbers of its shape {self.index.shape}: got "
                f"shape {shifts.shape}, {int((~np.isfinite(shifts)).sum())} of them not finite"
            )
        object.__setattr__(self, "shifts", frozen(shifts))

    @property
    def plain(self) -> bool:
        """Whether it reads the source's values as they are: without shifts."""
        return self.shifts is None

    def read(
        self, source_values: npt.ArrayLike, scale: float = 1.0, shift: float = 0.0
    ) -> FloatArray:
        """Return phi(s, a) = scale (Q_source(f(s, a)) + shifts(s, a)) + shift, (..., S, A) float64.

        As :meth:`StateActionMapping.read`.
        """
        phi = super().read(source_values, scale, shift)
        if self.shifts is None:
            return phi
        return phi + np.where(self.index == UNMAPPED, 0.0, scale * self.shifts)


class Proposal(NamedTuple):
    """A mapping that a search proposes.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> Proposal(identity(GridWorld("S.T")), "by hand").how
    'by hand'
    """

    mapping: StateActionMapping
    how: str  # how it was found
    bound: float = NOT_PROVEN  # proven: no mapped pair's Q* differs by more from that of its source


def search_steps(transfers: Iterable[Any]) -> int:
    """Return the steps that the searches for the mappings of transfers took.

    Mappings between the same two tasks are taken to be of one search.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer
    >>> line = GridWorld("ST")
    >>> index = [[0, 1, 2, 3], [-2, -2, -2, -2]]
    >>> search_steps([Transfer("a", "b", SearchedMapping(line, line, index, steps=50))] * 2)
    50
    """
    most: dict[tuple[str, str], int] = {}
    for one in transfers:
        edge = one.source, one.target
        most[edge] = max(most.get(edge, 0), getattr(one.mapping, "steps", 0))
    return sum(most.values())
