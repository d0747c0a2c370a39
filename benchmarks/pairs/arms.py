"""What each pair is played with: ways in, the portfolio, and what knows nothing."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import curricle as cr
from benchmarks.pairs.pair import Pair
from curricle.comparison.controls import Control
from curricle.learning import OptimisticQLearning, linear, value_bounds

RAW = "raw"
CONTROLS: tuple[Control, ...] = ("placebo", "constant", "negated")
"""Controls of the raw potential; their arms are ``raw, placebo`` and the like."""


def raw(pair: Pair) -> cr.Curriculum:
    """Return Q started at the potential, as it is."""
    return pair.curriculum()


def guarded(pair: Pair) -> cr.Curriculum:
    """Return the same with a portfolio."""
    return pair.curriculum(shaping=cr.QInitialisation(portfolio=cr.Portfolio()))


def advice(pair: Pair) -> cr.Curriculum:
    """Return advice on actions, gone after half the target's budget."""
    fading = linear(1.0, 0.0, steps=pair.target_budget // 2)
    return pair.curriculum(shaping=cr.DecayingAdvice(weight=fading))


def state(pair: Pair) -> cr.Curriculum:
    """Return shaping by the potential of states."""
    return pair.curriculum(shaping=cr.StateShaping())


def bonus(pair: Pair) -> cr.Curriculum:
    """Return phi as a reward, which is not potential-based."""
    return pair.curriculum(shaping=cr.RewardBonus())


def default(pair: Pair) -> cr.Curriculum:
    """Return a curriculum with nothing set but the target's budget."""
    return pair.curriculum(
        shaping=None, budget={"target": pair.target_budget}, eval_freq={"target": pair.eval_freq}
    )


def default_unguarded(pair: Pair) -> cr.Curriculum:
    """Return the same without the portfolio that is the default."""
    return replace(default(pair), shaping=cr.QInitialisation())


ARMS: dict[str, Callable[[Pair], cr.Curriculum]] = {
    RAW: raw,
    "guarded": guarded,
    "default": default,
    "unguarded default": default_unguarded,
    "advice": advice,
    "state": state,
    "bonus": bonus,
}
"""Look-ahead advice is carried out as Q started at phi, so it has no arm of its own.

Look-back advice is for SARSA.
"""
AGGREGATES = ("minimum", "mean", "maximum", "total")
"""Raw potentials by other aggregates; only pairs with several mappings are played with these."""
WAYS_IN = (RAW, "advice", "state", "bonus")
DEFAULTS = ("default", "unguarded default")


def curricula(pair: Pair, names: Sequence[str]) -> dict[str, cr.Curriculum]:
    """Return the arms of these names that suit a pair."""
    found = {name: ARMS[name](pair) for name in names if name in ARMS}
    for name in AGGREGATES:
        if name in names and len(pair.mappings) > 1:
            found[name] = replace(raw(pair), aggregate=getattr(cr, name))
    return found


def scratch_learners(pair: Pair) -> dict[str, Any]:
    """Return further learners from scratch, which explore by optimism."""
    highest = value_bounds(pair.target)[1]
    high_start = {"high start": cr.QLearning(initial_value=highest)} if highest > 0 else {}
    return {**high_start, "optimistic learner": OptimisticQLearning()}
