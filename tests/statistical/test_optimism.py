"""Curricula whose gain is their optimism do not pay, with 20 seeds each.

In a long chain a learner from scratch whose values start at 0 hardly ever meets the reward at the
end. Any potential far above 0 makes it look there. Seeds are fixed.
"""

import numpy as np
import pytest

import curricle as cr
from curricle import FiniteMDP, QLearning, Transfer
from curricle.transfer import StateActionMapping
from tests.support.tasks import predator_edges

pytestmark = pytest.mark.slow


def chain(n):
    """Return places in a row, left and right; 1 at the end."""
    moves = [[[(1.0, max(s - 1, 0), 0.0)], [(1.0, s + 1, float(s == n - 2))]] for s in range(n - 1)]
    ends = np.arange(n) == n - 1
    return FiniteMDP.from_outcomes(
        [*moves, [[], []]], terminal=ends, start=0, discount=0.99, time_limit=60
    )


@pytest.fixture(scope="module")
def of_chain():
    """The curriculum in which each place of a chain reads the one as far along a shorter one."""
    long, short = chain(30), chain(8)
    place = np.minimum(np.arange(30) * 7 // 29, 6)
    pairs = StateActionMapping(long, short, place[:, None] * 2 + np.arange(2))
    return cr.Curriculum(
        tasks={"short": short, "long": long},
        transfers=[Transfer("short", "long", pairs)],
        budget={"short": cr.StoppingRule(5_000), "long": 100_000},
        learner={"short": QLearning(epsilon=0.5)},
        shaping=cr.QInitialisation(),
    )


def test_optimism_does_not_pay(of_chain):
    """It gains much over scratch, and an opponent without a source gains as much within a tenth."""
    comparison = cr.compare(of_chain, seeds=20)
    assert comparison.against("scratch")["transfer"].answer == "yes"
    assert comparison.contrasts["transfer"].verdict != "pays"
    gains = {
        name: (returns - comparison.returns["scratch"]).mean()
        for name, returns in comparison.returns.items()
    }
    best = comparison.best_opponent("transfer")
    assert gains[best] > 0.9 * gains["transfer"] > 0


def test_one_predator_teaches_two_by_what_it_knows():
    """A source and a mapping by hand, against all opponents and placebos."""
    hunt, chase = cr.Pursuit(4, 2), cr.Pursuit(4, 1)
    plan = cr.Curriculum(
        {"chase": chase, "hunt": hunt},
        predator_edges(hunt, chase),
        aggregate=cr.minimum,
        budget={"chase": cr.StoppingRule(5_000), "hunt": 50_000},
        learner=QLearning(initial_value=-10.0),
    )
    comparison = cr.compare(plan, seeds=10, controls=["placebo"])
    assert comparison.contrasts["transfer"].answer == "pays, by what it knows"
