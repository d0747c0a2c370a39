"""What a search for mappings proposes."""

from dataclasses import dataclass
from typing import NamedTuple

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
