"""The referee's tables, in Markdown: one for each domain, one of all, and the verdict on racing."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.referee.domains import MAKERS, domain_names, left_out
from benchmarks.referee.lines import Lines, Record
from benchmarks.referee.players import FIXED, PLAYERS, RACING, SCRATCH
from benchmarks.referee.playing import Settings, path_of, records
from benchmarks.referee.verdicts import MANY_TARGETS, Match, Unit, against, count, paid_after

HEAD = (
    "designer",
    "learning rate",
    "learnt",
    "steps",
    "saved of scratch's",
    "search charged too",
    "saved of the fixed recipe's",
    "search has paid after",
    "tuning, steps",
)
LEAST_DOMAINS, LEAST_BEATEN = 6, 3
"""Domains that a table needs, and of them such in which racing must beat the fixed recipe."""


class Unplayed(Exception):
    """A record is missing where nothing is to be played."""


class Stored(Lines):
    """Lines that are read only."""

    def once(self, key: list[object], make: Callable[[], Record]) -> Record:
        """Return the record of a key; Unplayed where there is none."""
        known = self.get(key)
        if known is None:
            raise Unplayed(f"{self.path} has no record of {key}")
        return known


def read(folder: Path, player: str, name: str, settings: Settings) -> Unit | None:
    """Return a unit; None where it has not been played whole."""
    stored = Stored(path_of(folder, player, name))
    try:
        found = list(records(PLAYERS[player], name, settings, stored))
    except Unplayed:
        return None
    tuning, judged = ([one for kind, one in found if kind == of] for of in ("tuning", "judged"))
    return Unit.of(tuning, judged)


def match(folder: Path, settings: Settings) -> Match:
    """Return the units that have been played whole, of domains in which scratch has."""
    units = dict[str, dict[str, Unit]]()
    for name in domain_names():
        found = {player: read(folder, player, name, settings) for player in PLAYERS}
        played = {player: unit for player, unit in found.items() if unit is not None}
        if SCRATCH in played:
            units[name] = played
    return Match(units)


def tables(played: Match) -> Iterator[str]:
    """Yield the lines of all tables."""
    for name, units in played.units.items():
        yield from of_domain(name, units)
        yield ""
    yield from of_all(played)
    yield ""
    yield from (left_out(name) for name in MAKERS if left_out(name))
    yield on_racing(played)


def of_domain(name: str, units: dict[str, Unit]) -> Iterator[str]:
    """Yield the table of a domain."""
    base = units[SCRATCH]
    targets, seeds = base.steps.shape
    over = "targets" if targets >= MANY_TARGETS else "seeds"
    held = f"{targets} held-out target{'s' * (targets > 1)}"
    yield f"**{name}**: {held}, {seeds} seeds; intervals over {over}"
    yield ""
    yield from markdown([HEAD, *(_row(one, units[one], units) for one in units)])


def _row(designer: str, unit: Unit, units: dict[str, Unit]) -> tuple[str, ...]:
    base, fixed = units[SCRATCH], units.get(FIXED)
    own = designer == SCRATCH
    with_search = str(against(unit, base, search=True)) if unit.search.any() else ""
    than_fixed = "" if fixed in (None, unit) else str(against(unit, fixed))
    refused = f", no design for {unit.refused}" if unit.refused else ""
    paid = paid_after(unit, base)
    return (
        f"{designer}{refused}",
        f"{unit.rate:g}",
        f"{unit.learnt.mean():.0%}",
        f"{unit.steps.mean():,.0f}",
        "" if own else str(against(unit, base)),
        with_search,
        than_fixed,
        "" if not unit.search.any() else "never" if paid.never else f"{paid.trainings:,}",
        f"{unit.tuning:,}",
    )


def of_all(played: Match) -> Iterator[str]:
    """Yield the table of all domains: where each designer beats scratch and the fixed recipe."""
    yield "Domains in which a designer takes fewer steps, shown by the interval"
    yield ""
    head = (
        "designer",
        "than scratch",
        "search charged too",
        "than the fixed recipe",
        "charged too",
    )
    yield from markdown([head, *(_beaten(played, one) for one in played.designers)])


def _beaten(played: Match, designer: str) -> tuple[str, ...]:
    """Return the row of a designer: domains in which it beats scratch, and the fixed recipe."""
    ways = [(base, search) for base in (SCRATCH, FIXED) for search in (False, True)]
    cells = (
        "" if designer == base else count(played.beaten(designer, base, search=search))
        for base, search in ways
    )
    return designer, *cells


def on_racing(played: Match) -> str:
    """Return the sentence on racing."""
    beaten = played.beaten(RACING, FIXED)
    if len(beaten) < LEAST_DOMAINS:
        return (
            f"{RACING} and {FIXED} have met in {len(beaten)} domains: a verdict needs "
            f"{LEAST_DOMAINS}"
        )
    where = ", ".join(name for name, beats in beaten.items() if beats) or "none"
    enough = sum(beaten.values()) >= LEAST_BEATEN
    default = "" if enough else ": the fixed recipe is the default"
    return f"{RACING} beats {FIXED} in {count(beaten)} domains ({where}){default}"


def markdown(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table in Markdown, numbers to the right.

    Examples
    --------
    >>> print("\\n".join(markdown([("who", "steps"), ("scratch", "9")])))
    | who     | steps |
    |---------|------:|
    | scratch |     9 |
    """
    widths = np.array([[len(cell) for cell in row] for row in rows]).max(axis=0)
    for number, row in enumerate(rows):
        first, *others = zip(row, widths, strict=True)
        cells = [first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in others)]
        yield f"| {' | '.join(cells)} |"
        if number == 0:
            rules = ["-" * (widths[0] + 2), *("-" * (width + 1) + ":" for width in widths[1:])]
            yield f"|{'|'.join(rules)}|"
