"""What the quality of a potential means, in words: where learning starts, whether that lasts.

The words are about the start and about what the potential knows. What learning then gains is
another question: from a low start it can gain more than from scratch.
"""

from typing import Any, Protocol

import numpy as np

from curricle.planning.target import Target
from curricle.statistics.intervals import mean_interval
from curricle.tasks.spaces import state_name
from curricle.transfer.observation_rollouts import ObservationTarget
from curricle.transfer.quality import PotentialQuality

AnyTarget = Target | ObservationTarget

# Thresholds of the verdicts; benchmarks/check_forecast.py compares them with training.
GAIN, GOOD = 0.1, 0.5
"""Shares of the way from the random policy's return to the optimum: weak start, good start."""
OPTIMISTIC = 0.5
"""Share of optimistic pairs above which learning keeps lowering values."""
SLIPS, COLLAPSES = 0.2, 0.25
"""Mean excess, in units of mean abs(V*), above which returns then fall under epsilon-greedy."""
ESTIMATED = 0.45
"""The same if the excess is over the value of phi's own policy, which is less than V*."""
UNDERESTIMATE = 20.0
"""Typical rewards by which phi may be too low in states that the optimal policy visits."""
RAISED = 1.15
"""Scale above which a calibration is worth its steps."""


class Judged(Protocol):
    """A row of a forecast."""

    @property
    def seeds(self) -> tuple[PotentialQuality, ...]: ...  # noqa: D102
    @property
    def scale(self) -> float: ...  # noqa: D102
    def mean(self, measure: str) -> float: ...  # noqa: D102


def start_words(row: Judged, target: AnyTarget, optimum: float, random_return: float) -> str:
    """Return what the start with a potential is, whether it lasts, and what to do, in words."""
    if np.isnan(row.mean("start")):
        return "is the same for all actions, so it has no greedy policy: use StateShaping"
    start = row.mean("start")
    excess = row.mean("excess") / max(row.mean("mean_absolute_value"), 1e-12)
    words = [f"starts at {start:.3g}"]
    # If the optimum is unknown, any better start is a good one.
    gain, whole = start - random_return, np.nan_to_num(optimum - random_return)
    good = gain > GOOD * whole
    if not good:
        weak = gain > GAIN * whole
        words.append("a weak start" if weak else "near or below the random policy")
    words.append(f"{row.mean('optimistic'):.0%} optimistic")
    slips, collapses = (SLIPS, COLLAPSES) if row.seeds[0].exact else (ESTIMATED, ESTIMATED)
    advice = []
    # A weak start has little to lose, and its policy is little evidence of phi's scale.
    if good and row.mean("optimistic") > OPTIMISTIC and excess >= slips:
        fall = "expect a fall" if excess >= collapses else "returns may fall"
        advice.append(f"{fall} from there under epsilon-greedy")
    elif good:
        advice.append("expect no fall from there")
    else:
        advice.append("what learning gains from there is open")
    if good and excess > 0 and row.scale > RAISED:
        advice.append(f"calibrate with c = {row.scale:.1f}")
    worst = max(row.seeds, key=lambda seed: np.nan_to_num(seed.largest_underestimate))
    if worst.largest_underestimate > UNDERESTIMATE * target.typical_reward:
        task: Any = target.task
        where = state_name(task.states, worst.most_underestimated_state)
        advice.append(
            f"underestimates {where}, which the optimal policy visits, by"
            f" {worst.largest_underestimate:.3g}: a guard bounds what that costs"
        )
    return ", ".join(words) + (": " + "; ".join(advice) if advice else "")


def network_words(row: Judged) -> str:
    """Return what enters where values are not read, and what its policy returns, in words."""
    start = row.mean("start")
    policy = "" if np.isnan(start) else f", which returns {start:.3g} in the target as it is"
    return f"its network or policy enters{policy}; its values are not read"


def anti_knowledge(row: Judged, random_return: float) -> str:
    """Return in what a potential is worse than knowing nothing, in words; empty if in nothing.

    Its greedy policy returns less than the random one by more than the seeds differ (Student's
    interval of 95 %; for a single seed, or where all agree, at all), or its order of the pairs is
    against that of Q* in every seed. The words are weak because some such potentials pay all the
    same: ``docs/trust.md`` says how many.
    """
    found = []
    starts, ranks = (np.array([getattr(k, of) for k in row.seeds]) for of in ("start", "rank"))
    high, mean = float(mean_interval(starts).high), float(starts.mean())
    if (mean if np.isnan(high) else high) < random_return:
        found.append(
            f"its policy starts at {mean:.3g}, below the random policy's {random_return:.3g}"
        )
    if (ranks < 0).all():
        other = "Q*" if row.seeds[0].exact else "the returns of its own policy"
        words = f"its order of the pairs is against that of {other}"
        found.append(f"{words} (rank {ranks.mean():.2f})")
    return f"may be anti-knowledge: {'; '.join(found)}" if found else ""
