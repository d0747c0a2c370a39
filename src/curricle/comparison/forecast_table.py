"""A forecast as a table: in plain text, and as HTML for a notebook."""

from textwrap import fill
from typing import Any

import numpy as np

from curricle.display import block, shortened, table
from curricle.transfer.coverage import coverage_table


def in_brief(forecast: Any) -> str:
    """Return a forecast in a few words: its target, its answer, its potentials."""
    names = ", ".join(one.name for one in forecast.rows)
    return shortened(f"Forecast({forecast.target!r}: {forecast.answer}; potentials: {names})")


def as_text(forecast: Any) -> str:
    """Return a forecast as sentences and a table that fit a terminal of 80 columns."""
    lines = [f"{_title(forecast)}", *_reasons(forecast), _start(forecast)]
    lines += [f"{name}: {cover}" for name, cover in forecast.coverage.items()]
    lines = [_wrapped(line) for line in lines]
    width = max(len(one.name) for one in forecast.rows) + 2
    widths = dict(zip(ALL, (10, 11, 10, 10, 7, 7), strict=True))
    head = columns(forecast)
    lines.append(f"{'':{width}}" + "".join(f"{name:>{widths[name]}}" for name in head))
    for one in forecast.rows:
        texts = zip(head, cells(forecast, one), strict=True)
        line = "".join(f"{text:>{widths[name]}}" for name, text in texts)
        lines.append(f"{one.name + ' *' * one.used:{width}}{line}")
    lines += [_wrapped(f"{one.name}: {one.verdict}") for one in forecast.rows if one.aggregate]
    return "\n".join(lines)


def as_html(forecast: Any) -> str:
    """Return a forecast as its answer, what that rests on, its table and coverage."""
    rows = [
        (one.name + " *" * one.used, *cells(forecast, one), one.verdict if one.aggregate else "")
        for one in forecast.rows
    ]
    return block(
        _title(forecast),
        *_reasons(forecast),
        _start(forecast),
        table(["potential", *columns(forecast), "start, in words"], rows, wide=["start, in words"]),
        "* the one that the curriculum uses",
        forecast.coverage and coverage_table(forecast.coverage),
    )


ALL = ("gain", "start", "phi > Q*", "excess", "rank", "scale")
"""The columns that a forecast may have."""


def columns(forecast: Any) -> tuple[str, ...]:
    """Return those it has: gains where there was a trial, and values where potentials have them."""
    gains = any(one.gain is not None for one in forecast.rows)
    return (*ALL[: int(gains)], "start", *(ALL[2:] if _values_are_read(forecast) else ()))


def cells(forecast: Any, one: Any) -> list[str]:
    """Return the texts of a row, one for each column."""
    start = "-" if np.isnan(one.mean("start")) else f"{one.mean('start'):.3g}"
    texts = {"gain": "" if one.gain is None else f"{one.gain.estimate:.3g}", "start": start}
    if _values_are_read(forecast):
        texts["phi > Q*"] = f"{one.mean('optimistic'):.0%}"
        texts["excess"] = f"{one.mean('excess'):.2g}"
        texts["rank"] = f"{one.mean('rank'):.2f}"
        texts["scale"] = "none" if np.isnan(one.scale) else f"{one.scale:.2g}"
    return [texts[name] for name in columns(forecast)]


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


def _wrapped(line: str) -> str:
    """Return a line as lines that fit a terminal of 80 columns."""
    return fill(line, 80, subsequent_indent="  ", break_on_hyphens=False)
