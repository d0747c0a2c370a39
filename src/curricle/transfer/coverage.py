"""Coverage: how much of the target a mapping reaches, and how much of the source it uses."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Coverage:
    """Coverage of a mapping between tasks with numbered states.

    Attributes
    ----------
    target_pairs : int
        Pairs (s, a) of the target, s not terminal.
    mapped, ended, unmapped : float
        Shares of them that read a source pair, that fall on a terminal state of the source (value
        0), and that have no counterpart. They sum to 1.
    source_pairs : int
        Pairs of the source, s not terminal.
    never_used : int
        Source pairs that no target pair reads.
    most_readers : int
        The largest number of target pairs that read one source pair.
    mean_readers : float
        The mean of that number over the source pairs that are read.

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


@dataclass(frozen=True)
class ObservationCoverage:
    """Coverage of a mapping of observations, over a sample of them.

    Attributes
    ----------
    observations : int
        Size of the sample.
    mapped, ended, unmapped : float
        Shares of its pairs (s, a); they sum to 1.
    outside : float
        Share of the mapped observations whose counterpart lies outside the source's observation
        space, where the source's values are extrapolated; NaN where nothing is mapped, or the
        source has numbered states.

    Examples
    --------
    >>> print(ObservationCoverage(200, 0.75, 0.0, 0.25, 0.0))
    75.0% of the pairs of 200 observations mapped, 0.0% at the source's end, 25.0% unmapped; ...
    """

    observations: int
    mapped: float
    ended: float
    unmapped: float
    outside: float

    def __str__(self) -> str:
        text = (
            f"{self.mapped:.1%} of the pairs of {self.observations:,} observations mapped, "
            f"{self.ended:.1%} at the source's end, {self.unmapped:.1%} unmapped"
        )
        if math.isnan(self.outside):
            return text
        return f"{text}; {self.outside:.1%} of the counterparts outside the source's space"
