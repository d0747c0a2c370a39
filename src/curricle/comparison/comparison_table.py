"""A comparison as text: a row for each arm, then what the table does not say."""

from typing import Any

import numpy as np

from curricle.errors import in_words
from curricle.statistics.intervals import Interval
from curricle.text_tables import counted, folded, or_dash, text_table

HEADS = ("", "steps to threshold", "mean return (IQM)", "strong gain", "weak gain", "verdict")


def comparison_text(found: Any, width: int) -> str:
    """Return a :class:`Comparison` as text in lines of so many characters at most."""
    first = (
        f"{found.target!r} in {found.total:,} steps, sources charged, evaluations free; "
        f"{counted(found.seeds, 'seed')}{found.stopped and f' ({found.stopped})'}; "
        f"threshold {or_dash(found.threshold, '.4g')}"
    )
    table = text_table(HEADS, [_cells(found, name) for name in found.arms], width, words=True)
    failed = [f"{name} failed: {in_words(error)}" for name, error in found.failed.items()]
    return "\n".join(
        [
            folded(first, width),
            *table,
            *(folded(one, width) for one in (*found.sentences, *failed)),
        ]
    )


def _cells(found: Any, name: str) -> tuple[str, ...]:
    """Return an arm's row of the table."""
    times = found.times(name)
    missed = int((~times.reached).sum())
    text = f"{times.steps.mean():,.0f}" + (f" ({missed} never)" if missed else "")
    text = "> " * (missed > 0) + text
    strong, weak, words = "", "", ""
    if name in found.contrasts:
        contrast = found.contrasts[name]
        strong, weak, words = (
            short(contrast.strong_gain),
            short(contrast.weak_gain),
            contrast.verdict,
        )
        if name in found.verdicts and not found.verdicts[name].too_few:
            words += f" (p = {contrast.adjusted_p:.2g})"
        words += f", {contrast.reason}" if contrast.reason else ""
    elif name == found.best_scratch and len(found.scratches) > 1:
        words = "the best from scratch: gains are over it"
    return name, text, short(found.mean_return(name)), strong, weak, words


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
