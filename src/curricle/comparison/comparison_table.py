"""A comparison as a table: in plain text, and with its curves as HTML for a notebook."""

from typing import Any

from curricle.display import COLOURS, OWN_COLOURS, block, curves, shortened, table
from curricle.errors import in_words
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import Interval
from curricle.statistics.seed_lines import seed_line

HEAD = ("steps to threshold", "mean return (IQM)", "strong gain", "weak gain", "verdict")


def in_brief(comparison: Any) -> str:
    """Return a comparison in a few words: its target, its arms and what they came to."""
    verdicts = [f"{name}: {one.against_scratch}" for name, one in comparison.verdicts.items()]
    return shortened(
        f"Comparison({comparison.target!r}, {len(comparison.arms)} arms, "
        f"{_seeds(comparison)}; {'; '.join(verdicts)})"
    )


def as_text(comparison: Any) -> str:
    """Return a comparison as a table for a terminal, and sentences below it."""
    width = max(len(name) for name in comparison.arms) + 2
    threshold, mean, strong, weak, verdict = HEAD
    lines = [
        title(comparison),
        f"{'':{width}}{threshold:>20}  {mean:<23}{strong:<22}{weak:<22}{verdict}",
    ]
    for name in comparison.arms:
        threshold, mean, strong, weak, verdict = cells(comparison, name)
        line = f"{name:{width}}{threshold:>20}  {mean:<21}  {strong:<20}  {weak:<20}  {verdict}"
        lines.append(line.rstrip())
    return "\n".join([*lines, *_below(comparison)])


def as_html(comparison: Any) -> str:
    """Return a comparison as its charged curves, the table, and sentences below it."""
    rows = [(name, *cells(comparison, name)) for name in comparison.arms]
    return block(
        title(comparison),
        curves(_lines(comparison), "target and source steps", "greedy return"),
        table(["", *HEAD], rows, wide=[HEAD[-1]]),
        *_below(comparison),
    )


def title(comparison: Any) -> str:
    """Return what was compared, and how."""
    return (
        f"{comparison.target!r} in {comparison.total:,} steps, sources charged, evaluations free; "
        f"{_seeds(comparison)}{comparison.stopped and f' ({comparison.stopped})'}; "
        f"threshold {comparison.threshold:.4g}"
    )


def cells(comparison: Any, name: str) -> tuple[str, str, str, str, str]:
    """Return the texts of an arm's row: as many as `HEAD` has."""
    times = comparison.times(name)
    missed = int((~times.reached).sum())
    steps = f"{times.steps.mean():,.0f}" + (f" ({missed} never)" if missed else "")
    steps = "> " * (missed > 0) + steps
    mean = short(comparison.mean_return(name))
    if name in comparison.contrasts:
        contrast, verdict = comparison.contrasts[name], comparison.verdicts.get(name)
        words = contrast.verdict
        if verdict is not None and not verdict.too_few:
            words += f" (p = {contrast.adjusted_p:.2g})"
        words += f", {contrast.reason}" if contrast.reason else ""
        return steps, mean, short(contrast.strong_gain), short(contrast.weak_gain), words
    several = name == comparison.best_scratch and len(comparison.scratches) > 1
    return steps, mean, "", "", "the best from scratch: gains are over it" * several


def short(interval: Interval) -> str:
    """Return an interval without its number of seeds."""
    return str(interval).rsplit(",", 1)[0]


def _seeds(comparison: Any) -> str:
    return f"{comparison.seeds} seed{'s' * (comparison.seeds > 1)}"


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
