"""Curricula whose gain is their optimism do not pay, with 20 seeds each.

In a long chain and in RiverSwim a learner from scratch whose values start at 0 hardly ever meets
the reward at the end. Any potential far above 0 makes it look there. Seeds are fixed.
"""

import numpy as np
import pytest

import curricle as cr
from curricle import FiniteMDP, QLearning, Transfer
from curricle.transfer import StateActionMapping
from tests.support.tasks import predator_edges

pytestmark = pytest.mark.slow


def line(outcomes, ends=0, **settings):
    """Return places in a row; the last `ends` of them are terminal."""
    n = len(outcomes) + ends
    return FiniteMDP.from_outcomes(
        [*outcomes, *[[[], []]] * ends],
        terminal=[False] * len(outcomes) + [True] * ends,
        start=0,
        states=cr.Space([cr.Component("place", n)]),
        actions=cr.Space([cr.Component("move", 2, labels=("left", "right"))]),
        discount=0.99,
        **settings,
    )


def chain(n):
    """Left and right; 1 at the end."""
    moves = [[[(1.0, max(s - 1, 0), 0.0)], [(1.0, s + 1, float(s == n - 2))]] for s in range(n - 1)]
    return line(moves, ends=1, time_limit=60)


def river_swim(n):
    """Strehl and Littman 2008: 0.005 for staying at the source of the river, 1 at its other end."""
    moves = [
        [[(1.0, s - 1, 0.0)], [(0.05, s - 1, 0.0), (0.6, s, 0.0), (0.35, s + 1, 0.0)]]
        for s in range(1, n - 1)
    ]
    first = [[(1.0, 0, 0.005)], [(0.4, 0, 0.0), (0.6, 1, 0.0)]]
    last = [[(1.0, n - 2, 0.0)], [(0.4, n - 2, 0.0), (0.6, n - 1, 1.0)]]
    return line([first, *moves, last], time_limit=300)


def stretched(long, short, source_learner, source_steps):
    """Return the curriculum in which each place of a line reads the one as far along another."""
    n, m = (len(task.terminal) - task.terminal.sum() for task in (long, short))
    place = np.minimum(np.arange(len(long.terminal)) * m // n, m - 1)
    pairs = StateActionMapping(long, short, place[:, None] * 2 + np.arange(2))
    return cr.Curriculum(
        tasks={"short": short, "long": long},
        transfers=[Transfer("short", "long", pairs)],
        budget={"short": cr.StoppingRule(source_steps), "long": 100_000},
        learner={"short": source_learner},
        shaping=cr.QInitialisation(),
    )


@pytest.fixture(scope="module")
def of_chain():
    return stretched(chain(30), chain(8), QLearning(epsilon=0.5), 5_000)


@pytest.fixture(scope="module")
def of_river():
    return stretched(river_swim(20), river_swim(6), QLearning(initial_value=50.0), 10_000)


@pytest.mark.parametrize("plan", ["of_chain", "of_river"])
def test_optimism_does_not_pay(plan, request):
    """It gains much over scratch, and an opponent without a source gains as much within a tenth."""
    plan = request.getfixturevalue(plan)
    comparison = cr.compare(plan, seeds=20)
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
