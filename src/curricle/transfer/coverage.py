"""What a mapping reaches of its target and uses of its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Coverage:
    """How much of the target a mapping reaches, and how much of the source it uses.

    Attributes
    ----------
    target_pairs : int
        Pairs (s, a) of the target, s not terminal.
    mapped, ended, unmapped : float
        Shares of them that read a source pair, that fall on a source's terminal state (value 0),
        and that have no counterpart. They sum to 1.
    source_pairs : int
        Pairs of the source, s not terminal.
    never_used : int
        Source pairs no target pair reads.
    most_readers : int
        The largest number of target pairs that read one source pair.
    mean_readers : float
        The mean of that number over the source pairs that are read (aliasing).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> identity(GridWorld("S.T")).coverage().mapped
    1.0
    """

    target_pairs: int
    mapped: float
    ended: float
    unmapped: float
    source_pairs: int
    never_used: int
    most_readers: int
    mean_readers: float

    def __str__(self) -> str:
        return (
            f"{self.mapped:.1%} of {self.target_pairs:,} target pairs mapped, {self.ended:.1%} at "
            f"the source's end, {self.unmapped:.1%} unmapped; {self.never_used:,} of "
            f"{self.source_pairs:,} source pairs never used, the others read by "
            f"{self.mean_readers:.1f} target pairs on average, {self.most_readers:,} at most"
        )
