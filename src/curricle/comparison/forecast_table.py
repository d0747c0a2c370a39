"""A forecast as a table: in plain text, and as HTML for a notebook."""

from collections.abc import Callable
from typing import Any

import numpy as np

from curricle.display import block, shortened, table
from curricle.text_tables import folded, or_dash, text_table
from curricle.transfer.mapping import coverage_table

COLUMNS: dict[str, Callable[[Any], str]] = {
    "gain": lambda one: "" if one.gain is None else f"{one.gain.estimate:.3g}",
    "start": lambda one: or_dash(one.mean("start")),
    "phi > Q*": lambda one: or_dash(one.mean("optimistic"), ".0%"),
    "excess": lambda one: or_dash(one.mean("excess"), ".2g"),
    "rank": lambda one: or_dash(one.mean("rank"), ".2f"),
    "scale": lambda one: "none" if np.isnan(one.scale) else f"{one.scale:.2g}",
}
"""What each column shows of a row."""


def in_brief(forecast: Any) -> str:
    """Return a forecast in a few words: its target, its answer, its potentials."""
    names = ", ".join(one.name for one in forecast.rows)
    return shortened(f"Forecast({forecast.target!r}: {forecast.answer}; potentials: {names})")


def forecast_text(forecast: Any, width: int) -> str:
    """Return a forecast as sentences and a table, in lines of so many characters at most."""
    above = [_title(forecast), *_reasons(forecast), _start(forecast)]
    above += [f"{name}: {cover}" for name, cover in forecast.coverage.items()]
    words = [f"{one.name}: {one.verdict}" for one in forecast.rows if one.aggregate]
    return "\n".join(
        [
            *(folded(line, width) for line in above),
            *text_table(["", *columns(forecast)], _rows(forecast), width),
            *(folded(line, width) for line in words),
        ]
    )


def as_html(forecast: Any) -> str:
    """Return a forecast as its answer, what that rests on, its table and coverage."""
    words = [one.verdict if one.aggregate else "" for one in forecast.rows]
    rows = [(*row, text) for row, text in zip(_rows(forecast), words, strict=True)]
    return block(
        _title(forecast),
        *_reasons(forecast),
        _start(forecast),
        table(["potential", *columns(forecast), "start, in words"], rows, wide=["start, in words"]),
        "* the one that the curriculum uses",
        forecast.coverage and coverage_table(forecast.coverage),
    )


def columns(forecast: Any) -> list[str]:
    """Return those it has: gains where there was a trial, and values where potentials have them."""
    left_out = set[str]()
    if all(one.gain is None for one in forecast.rows):
        left_out = {"gain"}
    if not _values_are_read(forecast):
        left_out |= COLUMNS.keys() - {"gain", "start"}
    return [name for name in COLUMNS if name not in left_out]


def _rows(forecast: Any) -> list[tuple[str, ...]]:
    """Return the name of each potential, with a star if it is used, and its columns."""
    shown = [COLUMNS[name] for name in columns(forecast)]
    return [(one.name + " *" * one.used, *(cell(one) for cell in shown)) for one in forecast.rows]


def _title(forecast: Any) -> str:
    return f"Forecast for {forecast.target!r}: {forecast.answer}"


def _reasons(forecast: Any) -> list[str]:
    """Return what the answer rests on, and what speaks against it."""
    lines = [forecast.basis]
    if forecast.trial is not None and not forecast.trial.relative and not forecast.best.used:
        lines.append(f"the highest gain in the trial: {forecast.best.name}")
    lines += map(str, forecast.sources.values())
    # The transfers that may be anti-knowledge; a single one is its aggregate's row.
    alone = [one for one in forecast.rows if not one.aggregate] or forecast.rows[:1]
    return [*lines, *(f"{one.name} {one.anti_knowledge}" for one in alone if one.anti_knowledge)]


def _start(forecast: Any) -> str:
    how = "exact" if forecast.exact else "returns by rollouts"
    if not forecast.solved and _values_are_read(forecast):
        how += "; Q* estimated by the values of phi's own policy"
    optimum = "" if np.isnan(forecast.optimum) else f"optimum {forecast.optimum:.4g}, "
    return (
        f"The start with phi, {forecast.computed_from}: {optimum}random policy "
        f"{forecast.random_return:.4g} ({how})"
    )


def _values_are_read(forecast: Any) -> bool:
    """Return whether potentials are compared with values; not where networks enter."""
    return not all(np.isnan(one.mean("optimistic")) for one in forecast.rows)
