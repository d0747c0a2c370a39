"""The referee's tables, in Markdown: one for each domain, one of all, and the verdict on racing."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.referee.domains import MAKERS, domain_names, left_out
from benchmarks.referee.lines import Lines, Record
from benchmarks.referee.players import PLAYERS, RACING, SCRATCH
from benchmarks.referee.playing import Settings, path_of, records
from benchmarks.referee.verdicts import MANY_TARGETS, Match, Unit, against, count, paid_after

HEAD = (
    "designer",
    "rate",
    "learnt",
    "steps",
    "saved of scratch",
    "with search",
    "saved of the best fixed",
    "paid after",
    "tuning",
)
"""Learning rate; trainings that learnt; mean steps; saved as a share of scratch's; steps with the
search for them as a multiple of scratch's; saved as a share of the best fixed recipe's; trainings
of each target after which the search has paid; steps of tuning."""
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
    for name in played.units:
        yield from of_domain(played, name)
        yield ""
    yield from of_all(played)
    yield ""
    yield from (left_out(name) for name in MAKERS if left_out(name))
    yield on_racing(played)


def of_domain(played: Match, name: str) -> Iterator[str]:
    """Yield the table of a domain."""
    units, fixed = played.units[name], played.best_fixed(name)
    targets, seeds = units[SCRATCH].steps.shape
    over = "targets" if targets >= MANY_TARGETS else "seeds"
    held = f"{targets} held-out target{'s' * (targets > 1)}"
    best = f"; the best fixed recipe is {fixed}" if fixed else ""
    yield f"**{name}**: {held}, {seeds} seeds; intervals over {over}{best}"
    yield ""
    yield from markdown([HEAD, *(_row(one, units, fixed) for one in units)])


def _row(designer: str, units: Mapping[str, Unit], fixed: str | None) -> tuple[str, ...]:
    """Return the row of a designer."""
    unit, base = units[designer], units[SCRATCH]
    own = designer == SCRATCH
    all_steps = 1 - float(against(unit, base, search=True).share.estimate)
    than_fixed = "" if fixed in (None, designer) else str(against(unit, units[fixed]))
    refused = f", no design for {unit.refused}" if unit.refused else ""
    paid = paid_after(unit, base)
    return (
        f"{designer}{refused}",
        f"{unit.rate:g}",
        f"{unit.learnt.mean():.0%}",
        f"{unit.steps.mean():,.0f}",
        "" if own else str(against(unit, base)),
        f"{all_steps:.1f} x" if unit.search.any() else "",
        than_fixed,
        "" if not unit.search.any() else "never" if paid is None else f"{paid:,}",
        f"{unit.tuning:,}",
    )


def of_all(played: Match) -> Iterator[str]:
    """Yield the table of all domains: where each designer beats scratch and the fixed recipe."""
    yield "Domains in which a designer takes fewer steps, shown by the interval"
    yield ""
    search = "with search"
    head = ("designer", "than scratch", search, "than the best fixed", search)
    yield from markdown([head, *(_beaten(played, one) for one in played.designers)])


def _beaten(played: Match, designer: str) -> tuple[str, ...]:
    """Return the row of a designer: domains in which it beats scratch, and the fixed recipe."""
    cells = (
        count(played.beaten(designer, fixed=fixed, search=search))
        for fixed in (False, True)
        for search in (False, True)
    )
    return designer, *cells


def on_racing(played: Match) -> str:
    """Return the sentence on racing."""
    beaten = played.beaten(RACING, fixed=True)
    if len(beaten) < LEAST_DOMAINS:
        return (
            f"{RACING} and a fixed recipe have met in {len(beaten)} domains: a verdict needs "
            f"{LEAST_DOMAINS}"
        )
    where = ", ".join(name for name, beats in beaten.items() if beats) or "none"
    enough = sum(beaten.values()) >= LEAST_BEATEN
    default = "" if enough else ": the fixed recipe is the default"
    return f"{RACING} beats the best fixed recipe in {count(beaten)} domains ({where}){default}"


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
