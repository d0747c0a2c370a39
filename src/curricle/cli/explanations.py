"""What the words under ``curricle check``, ``show`` and ``compare`` mean; the one place of it."""

import io
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from curricle.cli.terminal_tables import print_text

INTERVAL = "[low, high]"
EXPLANATIONS = {
    "arm": "one of the ways to learn the target that the study compares",
    "scratch": "the arm that learns the target without any source",
    "aggregate": "how the values of several sources become one potential",
    "greedy return": "the mean return of an episode in which the best known action is always taken",
    "charged": "steps in sources count as steps of the arm, which starts that much later",
    "evaluations are free": "steps of episodes that only measure the policy are not counted",
    "steps to threshold": "steps until the greedy return, smoothed, reaches the threshold, "
    'sources included; "> 1,000 (2 never)": 2 seeds do not get there, so the mean is more',
    "threshold": "the return that counts as learnt; by default nine tenths of the way from the "
    "random policy's to the optimum",
    "mean return": "the mean height of the learning curve: its area, divided by all steps",
    "IQM": "interquartile mean: the mean of the middle half of the seeds",
    INTERVAL: "after a number: its interval of 95 % confidence over seeds",
    "strong gain": "mean return above that of scratch, source steps charged (strong transfer)",
    "weak gain": "the same with the source steps free (weak transfer)",
    "verdict": "whether the arm gains more than learning from scratch, by a test over the seeds",
    "p =": "the probability of such a difference by chance, corrected for the number of arms",
    "whole checkpoints": "budgets are rounded up to a multiple of the steps between evaluations",
    "phi": "the potential: what the sources say of each state and action of the target",
    "gain": "strong gain in a trial, the comparison played in the model beforehand",
    "start": "greedy return of phi alone, before the first step of learning",
    "phi > Q*": "share of state-action pairs that phi holds for better than they can be",
    "excess": "the mean of phi - Q*; above 0 phi is optimistic",
    "rank": "rank correlation of phi and Q*: 1 is the right order everywhere, 0 none",
    "scale": "what phi would be multiplied with to fit the returns of its own greedy policy; "
    '"none" if nothing fits',
    "mapped": "pairs of the target that have a counterpart in the source",
    "unmapped": "pairs of which the source knows nothing",
    "learnt": "how far a source came from the random policy's return to its optimum",
}
"""Words, and what each means."""
HINT = "(--explain says what the words mean)"


class _Copied(io.TextIOBase):
    """Standard output, of which a copy is kept."""

    def __init__(self, out: Any):
        self.out, self.copy = out, io.StringIO()

    def write(self, text: str) -> int:
        """Write a text to both."""
        self.copy.write(text)
        return int(self.out.write(text))

    def flush(self) -> None:
        """Flush standard output."""
        self.out.flush()

    def isatty(self) -> bool:
        """Return whether standard output is a terminal."""
        return bool(self.out.isatty())


@contextmanager
def explained(wanted: bool) -> Iterator[None]:
    """Print under what is printed what its words mean if that is `wanted`.

    If not, a terminal is told that it can be.
    """
    out = sys.stdout
    if not wanted:
        yield
        if out.isatty():
            print(HINT)
        return
    copied: Any = _Copied(out)
    sys.stdout = copied
    try:
        yield
    finally:
        sys.stdout = out
    print()
    for word, meaning in used(copied.copy.getvalue()).items():
        print_text(f"{word}: {meaning}")


def used(text: str) -> dict[str, str]:
    """Return the words that a text has, and what each means.

    Examples
    --------
    >>> list(used("maze  strong gain  0.1 [0.05, 0.15]"))
    ['[low, high]', 'strong gain']
    >>> list(used("transfer gains more"))
    []
    """
    left, found = " ".join(text.split()), set[str]()
    for word in sorted(EXPLANATIONS, key=len, reverse=True):  # a "strong gain" is no "gain"
        left, times = _pattern(word).subn(" ", left)
        if times:
            found.add(word)
    return {word: EXPLANATIONS[word] for word in EXPLANATIONS if word in found}


def _pattern(word: str) -> re.Pattern[str]:
    """Return what finds a word, and not a part of another."""
    if word == INTERVAL:
        return re.compile(r"\[[-+]?\d")
    plural = "" if word == "gain" else "s?"  # an arm that "gains more" is no column of gains
    return re.compile(rf"(?<!\w){re.escape(word)}" + rf"{plural}(?!\w)" * word[-1].isalpha())
