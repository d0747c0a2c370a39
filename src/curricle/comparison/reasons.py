"""Why a curriculum pays: by what it knows, or by its optimism alone.

Whether it pays is asked against learning from scratch. Why is asked against its controls that know
nothing of the task (``constant``, and ``placebo`` beside it): a question of its own, with a family
of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from curricle.comparison.verdicts import Verdict
from curricle.display import brief_repr

SHARE = 0.1
"""Up to this share of a gain is nothing beside the rest."""
ASKING = 'cr.compare(..., controls=["constant", "placebo"])'
"""How the question is asked; a study file has no such key."""

Why = Literal["", "not asked", "knowledge", "mostly level", "level", "not shown"]


@dataclass(frozen=True)
class Reason:
    """Why a curriculum pays.

    Attributes
    ----------
    pays : Verdict
        Whether it gains more than learning from scratch.
    over_controls : Verdict or None
        Whether it gains more than each of its controls that know nothing; None if it has none.
    level : float
        What the strongest of these controls adds to every value, on average.

    Examples
    --------
    >>> import numpy as np
    >>> from curricle.comparison.verdicts import verdicts_of
    >>> noise = np.arange(8.0) % 3
    >>> returns = {"scratch": noise, "mean": 9 + noise[::-1], "mean, constant": 9 + noise}
    >>> pays, = verdicts_of(returns, {"mean": ["scratch"]}).values()
    >>> over, = verdicts_of(returns, {"mean": ["mean, constant"]}).values()
    >>> Reason(pays, over, 20.0).words, Reason(pays, None).words
    ('by optimism alone', '')
    """

    pays: Verdict = field(repr=False)
    over_controls: Verdict | None
    level: float = 0.0

    __repr__ = brief_repr

    @property
    def why(self) -> Why:
        """The reason; empty unless the curriculum is shown to pay.

        "knowledge": it is shown to gain more than each control that knows nothing. "level": it is
        shown to gain less than one of them, or at most a tenth of its gain over scratch more;
        "mostly level": both it gains more and this little. The share is the upper bound of the one
        gain by the lower bound of the other: it is larger in at most 5 % of comparisons.
        """
        if self.pays.direction <= 0:
            return ""
        over = self.over_controls
        if over is None or over.too_few:
            return "not asked" if over is None else "not shown"
        little = self.share <= SHARE
        if over.direction > 0:
            return "mostly level" if little else "knowledge"
        return "level" if little or over.direction < 0 else "not shown"

    @property
    def share(self) -> float:
        """The largest share of its gain that may be by what it knows: a bound at 95 %, or 1."""
        over, whole = self.over_controls, float(self.pays.gain.low)
        if over is None or not whole > 0:
            return 1.0
        return min(1.0, max(0.0, float(over.gain.high)) / whole)

    @property
    def words(self) -> str:
        """The reason in words; empty if it was not asked for, or if the curriculum does not pay."""
        optimism = "optimism" if self.level >= 0 else "pessimism"
        return {
            "": "",
            "not asked": "",
            "knowledge": "by what it knows",
            "mostly level": f"nearly all by {optimism}",
            "level": f"by {optimism} alone",
            "not shown": "not shown to be by what it knows",
        }[self.why]


def not_asked(reasons: Sequence[Reason]) -> str:
    """Return that some of the curricula that pay were not asked why, in words; else nothing."""
    open_ = any(one.why == "not asked" for one in reasons)
    return f"by what it knows, or by optimism alone? Not asked: {ASKING}" if open_ else ""
