"""Mappings that are found for the pairs of the families, beside those of the pairs themselves.

    python -m benchmarks.found_mappings families --split verification --seeds 10
    python -m benchmarks.found_mappings families --split unseen --seeds 10

Everything is as by default, the portfolio too; sources' steps are charged. Gains are in units of
the way from the random policy's return to the optimum. A pair is harmful through its mapping, its
source or its budget; a search may find another mapping of the same source, so that a pair that is
harmful by hand need not be so by search. Negated pairs are left out: they have no mapping of their
own. `source free` is the gain without the charge, which says whether the mapping itself helps.
"""

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple, cast

import numpy as np

import curricle as cr
from benchmarks.pairs import Pair, Split, pairs
from benchmarks.pairs.pair import levels
from benchmarks.unseen_pairs import unseen
from curricle.errors import MappingError
from curricle.statistics import mean_return
from curricle.statistics.curves import SCRATCH
from curricle.transfer import auto_mapping

SHARE = 0.95
"""Of the gain by hand, which a mapping that is found is to reach."""
HARMLESS = -0.02
"""Gain without the charge down to which a mapping is called harmless."""


class Row(NamedTuple):
    """One pair, played."""

    pair: Pair
    how: str  # empty if refused
    by_hand: float
    auto: float  # 0 if refused: nothing is learnt and nothing charged
    free: float  # the same without the charge
    error: float  # standard error of auto - by_hand

    @property
    def reaches(self) -> bool:
        """Whether the share of the gain by hand is reached, where there is one."""
        return self.auto >= SHARE * self.by_hand if self.by_hand > 0 else self.auto >= self.by_hand


def played(pair: Pair, seeds: int) -> Row:
    """Return the gains of a pair's own mapping and of the one that is found."""
    own = pair.curriculum(shaping=None)
    arms, how = {"by hand": own}, ""
    try:
        best = auto_mapping(pair.target, pair.source)
    except MappingError:
        pass
    else:
        edge = cr.Transfer("source", "target", best.mapping)
        arms["auto"], how = replace(own, transfers=(edge,)), best.how
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cr.compare(arms, seeds=seeds, opponents=())
    random_return, optimum = levels(pair.target)
    gains = {
        arm: found.arms[arm].strong_gain(found.scratch) / (optimum - random_return) for arm in arms
    }
    free = 0.0
    if how:
        each = (mean_return(found._weak(arm)) for arm in ("auto", SCRATCH))
        free = float(np.subtract(*each).mean()) / (optimum - random_return)
    auto = gains.get("auto", np.zeros(seeds))
    error = float((auto - gains["by hand"]).std(ddof=1)) / math.sqrt(seeds)
    return Row(pair, how, float(gains["by hand"].mean()), float(auto.mean()), free, error)


def families(split: str, seeds: int, only: str) -> None:
    """Print each pair of a split, or of those that are unseen, and what they come to by kind."""
    print(f"\nfamilies: gains of the {split} pairs, all steps charged, {seeds} seeds")
    print(f"  {'':46} by hand    auto    +-   source free")
    rows = []
    for pair in unseen() if split == "unseen" else pairs(split=cast(Split, split)):
        if pair.kind != "negated" and pair.name.startswith(only):
            row = played(pair, seeds)
            rows.append(row)
            gains = f"{row.by_hand:7.3f} {row.auto:7.3f} {row.error:5.3f} {row.free:7.3f}"
            print(
                f"  {pair.kind + ': ' + pair.name:46} {gains}  {row.how or 'refused'}", flush=True
            )
    summary(rows)


def summary(rows: Sequence[Row]) -> None:
    """Print the counts by kind; sensible pairs first."""
    print(
        f"\n  kind, pairs: refused; taken with at least {SHARE:.0%} of the gain by hand; taken and "
        f"harmless without the charge; mean gain by hand, and of auto"
    )
    ordered = sorted(rows, key=lambda row: (not row.pair.sensible, row.pair.kind))
    for kind, of_kind in groupby(ordered, key=lambda row: row.pair.kind):
        print(f"  {line(kind, list(of_kind))}")
    for words, sensible in (("sensible", True), ("others", False)):
        print(f"  {line(words, [row for row in rows if row.pair.sensible is sensible])}")


def line(words: str, rows: Iterable[Row]) -> str:
    """Return the counts of some pairs."""
    rows = list(rows)
    taken = [row for row in rows if row.how]
    if not rows:
        return f"{words}, 0"
    by_hand, auto = (float(np.mean([getattr(row, k) for row in rows])) for k in ("by_hand", "auto"))
    return (
        f"{words}, {len(rows)}: {len(rows) - len(taken)}; {sum(row.reaches for row in taken)}; "
        f"{sum(row.free >= HARMLESS for row in taken)} of {len(taken)}; {by_hand:.3f}, {auto:.3f}"
    )
