"""What a search for mappings proposes."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from curricle.transfer.mapping import StateActionMapping

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
