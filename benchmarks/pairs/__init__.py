"""Pairs of a source and a target, from harmless to helpful to harmful, and studies of them.

Families are split. The library's constants (thresholds, caps, shares) are fitted on the development
families alone; what the library says of itself is judged on the verification families and on the
fresh and the blind ones, which were written before they were played. A family lies in one split as
a whole.

The TOML files here are studies of a target from all its sources, with nothing set but budgets:

    curricle run benchmarks/pairs/river.toml
    python -m benchmarks.pairs river-results          # the tables of docs/trust.md
"""

from benchmarks.pairs.families import BLIND, DEVELOPMENT, FAMILIES, FRESH, VERIFICATION, pairs_of
from benchmarks.pairs.pair import Pair, Split

__all__ = ["Pair", "Split", "family_names", "pairs"]
SPLITS = {
    "development": DEVELOPMENT,
    "verification": VERIFICATION,
    "fresh": FRESH,
    "blind": BLIND,
}


def family_names() -> list[str]:
    """Return the names of the development families, then of the verification ones."""
    return [*DEVELOPMENT, *VERIFICATION]


def pairs(split: Split | None = None, family: str | None = None) -> list[Pair]:
    """Return the pairs of a split or a family; by default all but the fresh and the blind."""
    if family is not None and family not in FAMILIES:
        raise ValueError(f"family must be one of {', '.join(FAMILIES)}: got {family!r}")
    names = {**DEVELOPMENT, **VERIFICATION} if split is None else SPLITS[split]
    if family is not None:
        names = {family: FAMILIES[family]} if split is None or family in names else {}
    return [pair for name in names for pair in pairs_of(name)]
