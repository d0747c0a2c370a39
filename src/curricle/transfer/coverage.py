"""How much of a target a mapping covers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from curricle.display import block, table
from curricle.tasks.task import generative_model
from curricle.text_tables import counted

LARGEST_COVERAGE = 5_000_000
"""Pairs of either task up to which a mapping's coverage is counted."""


def few_pairs(*tasks: Any) -> bool:
    """Return whether all tasks have few enough pairs for a mapping's coverage to be counted.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> few_pairs(Pursuit(4, 2)), few_pairs(Pursuit(4, 2), Pursuit(100, 1))
    (True, False)
    """
    models = map(generative_model, tasks)
    return all(one.states.size * one.actions.size <= LARGEST_COVERAGE for one in models)


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
            f"{self.mapped:.1%} of {counted(self.target_pairs, 'target pair')} mapped, "
            f"{self.ended:.1%} at the source's end, {self.unmapped:.1%} unmapped; "
            f"{self.never_used:,} of {counted(self.source_pairs, 'source pair')} never used, the "
            f"others read by {self.mean_readers:.1f} target pairs on average, "
            f"{self.most_readers:,} at most"
        )

    def _repr_html_(self) -> str:
        readers = ["source pairs", "never used", "read on average by", "at most by"]
        used = (self.source_pairs, self.never_used, self.mean_readers, self.most_readers)
        return block("Coverage", coverage_table({"": self}), table(readers, [used]))


def coverage_table(covers: Mapping[str, Any]) -> Markup:
    """Return the coverage of mappings as a table, name -> Coverage or ObservationCoverage."""
    rows = []
    for name, cover in covers.items():
        pairs = cover.target_pairs if isinstance(cover, Coverage) else cover.observations
        parts = (cover.mapped, cover.ended, cover.unmapped)
        rows.append((name, pairs, *(f"{part:.1%}" for part in parts)))
    pairs = "pairs" if all(isinstance(one, Coverage) for one in covers.values()) else "observations"
    head = ["mapping", pairs, "mapped", "at the source's end", "unmapped"]
    named = int(not any(covers))  # the first column is left out where the names are empty
    return table(head[named:], [row[named:] for row in rows])
