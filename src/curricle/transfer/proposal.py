"""What a search for mappings proposes."""

from typing import NamedTuple

from curricle.transfer.mapping import StateActionMapping

NOT_PROVEN = float("nan")


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
