"""Pairs of a source and a target, from harmless to helpful to harmful.

Families are split into development and verification. The library's constants (thresholds, caps,
shares) are fitted on the development families alone, and what the library says of itself is judged
on the verification families. A family lies in one split as a whole.

    python -m benchmarks.pairs.run --split development --seeds 20 --out pairs.parquet
    python -m benchmarks.pairs.tables pairs.parquet
"""

from functools import cache

from benchmarks.pairs.families import FAMILIES, FRESH
from benchmarks.pairs.pair import Pair, Split

__all__ = ["Pair", "Split", "family_names", "pairs"]


@cache
def _family(name: str) -> tuple[Pair, ...]:
    return tuple({**FAMILIES, **FRESH}[name]().pairs.values())


def family_names() -> list[str]:
    """Return the names of all families, development first."""
    return list(FAMILIES)


def pairs(split: Split | None = None, family: str | None = None) -> list[Pair]:
    """Return the pairs, of one split or one family if asked; the same objects at every call."""
    if family is not None and family not in FAMILIES:
        raise ValueError(f"family must be one of {', '.join(FAMILIES)}: got {family!r}")
    names = FAMILIES if family is None else [family]
    return [
        pair for name in names for pair in _family(name) if split is None or pair.split == split
    ]
