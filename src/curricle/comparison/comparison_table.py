"""A comparison as a table: in plain text, and with its curves as HTML for a notebook."""

from typing import Any

import numpy as np

from curricle.display import COLOURS, OWN_COLOURS, block, curves, shortened, table
from curricle.errors import in_words
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import Interval, seed_line
from curricle.text_tables import counted, folded, or_dash, text_table

HEADS = ("", "steps to threshold", "mean return (IQM)", "strong gain", "weak gain", "verdict")


def in_brief(comparison: Any) -> str:
    """Return a comparison in a few words: its target, its arms and what they came to."""
    verdicts = [f"{name}: {one.against_scratch}" for name, one in comparison.verdicts.items()]
    return shortened(
        f"Comparison({comparison.target!r}, {counted(len(comparison.arms), 'arm')}, "
        f"{counted(comparison.seeds, 'seed')}; {'; '.join(verdicts)})"
    )


def comparison_text(comparison: Any, width: int) -> str:
    """Return a comparison as text in lines of so many characters at most."""
    rows = [cells(comparison, name) for name in comparison.arms]
    return "\n".join(
        [
            folded(title(comparison), width),
            *text_table(HEADS, rows, width, words=True),
            *(folded(one, width) for one in _below(comparison)),
        ]
    )


def as_html(comparison: Any) -> str:
    """Return a comparison as its charged curves, the table, and sentences below it."""
    rows = [cells(comparison, name) for name in comparison.arms]
    return block(
        title(comparison),
        curves(_lines(comparison), "target and source steps", "greedy return"),
        table(HEADS, rows, wide=[HEADS[-1]]),
        *_below(comparison),
    )


def title(comparison: Any) -> str:
    """Return what was compared, and how."""
    return (
        f"{comparison.target!r} in {comparison.total:,} steps, sources charged, evaluations free; "
        f"{counted(comparison.seeds, 'seed')}"
        f"{comparison.stopped and f' ({comparison.stopped})'}; "
        f"threshold {or_dash(comparison.threshold, '.4g')}"
    )


def cells(comparison: Any, name: str) -> tuple[str, ...]:
    """Return an arm's row of the table: as many texts as `HEADS` has."""
    times = comparison.times(name)
    missed = int((~times.reached).sum())
    steps = f"{times.steps.mean():,.0f}" + (f" ({missed} never)" if missed else "")
    steps = "> " * (missed > 0) + steps
    strong, weak, words = "", "", ""
    if name in comparison.contrasts:
        contrast = comparison.contrasts[name]
        strong, weak = short(contrast.strong_gain), short(contrast.weak_gain)
        words = contrast.verdict
        if name in comparison.verdicts and not comparison.verdicts[name].too_few:
            words += f" (p = {contrast.adjusted_p:.2g})"
        words += f", {contrast.reason}" if contrast.reason else ""
    elif name == comparison.best_scratch and len(comparison.scratches) > 1:
        words = "the best from scratch: gains are over it"
    return name, steps, short(comparison.mean_return(name)), strong, weak, words


def short(interval: Interval) -> str:
    """Return an interval without its number of seeds; a dash if there is none.

    Examples
    --------
    >>> short(Interval(11.04, 10.0, 12.0, confidence=0.95, n=5))
    '11.0 [10.0, 12.0]'
    >>> short(Interval(float("nan"), float("nan"), float("nan"), confidence=0.95, n=5))
    '-'
    """
    return "-" if np.isnan(interval.estimate) else str(interval).rsplit(",", 1)[0]


def _below(comparison: Any) -> list[str]:
    """Return the sentences below the table."""
    failed = [f"{name} failed: {in_words(error)}" for name, error in comparison.failed.items()]
    return [*comparison.sentences, *failed]


def _lines(comparison: Any) -> list[Any]:
    """Return the charged curve of each arm: controls as their curriculum, but dashed."""
    own, colour = -1, "currentColor"
    found = []
    for name, arm in comparison.arms.items():
        scratch = name in comparison.scratches
        if not (scratch or arm.control):
            own += 1
        if not scratch:
            colour = COLOURS[OWN_COLOURS[own % len(OWN_COLOURS)]]
        curve = arm.charged(comparison.scratch)
        dashed = arm.control or (scratch and name != SCRATCH)
        shade = "currentColor" if scratch else colour
        confidence = comparison.confidence
        found.append(
            seed_line(
                name, curve.steps, curve.filled(), shade, dashed=dashed, confidence=confidence
            )
        )
    return found
