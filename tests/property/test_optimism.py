"""Learners that explore by optimism: Q has no bonus, and converges to Q*."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.learning import OPIQ, UCBQLearning, harmonic, value_bounds
from tests.tasks import mdps

FEW = settings(max_examples=25, deadline=None)
COUNTS = st.lists(st.integers(0, 10**6), min_size=2, max_size=2, unique=True)


@FEW
@given(mdps((0.3, 0.75, 0.95)))
def test_no_value_is_outside_the_bounds(mdp):
    task = mdp.task()
    low, high = value_bounds(task)
    solution = cr.solve(task)
    live = ~mdp.terminal
    slack = solution.error_bound + 1e-9 * max(1.0, abs(low), abs(high))
    assert (solution.values[live] <= high + slack).all()
    worst = cr.FiniteMDP.from_dense(
        mdp.p, -mdp.r, terminal=mdp.terminal, start=task.mdp.start, discount=mdp.discount
    )
    assert (-cr.solve(worst).values[live] >= low - slack).all()


@pytest.mark.parametrize("kind", [UCBQLearning, OPIQ])
@FEW
@given(mdp=mdps((0.3, 0.75)), counts=COUNTS, c=st.floats(0.01, 5.0))
def test_the_bonus_shrinks_with_visits_and_vanishes(kind, mdp, counts, c):
    learner = kind(c=c).for_task(mdp.task())
    less, more = (learner.starting_bonus(np.full(mdp.shape, n))[0, 0] for n in sorted(counts))
    low, high = learner.value_range
    assert learner.starting_bonus(np.zeros(mdp.shape, int))[0, 0] >= 0.0
    if sorted(counts)[0] > 0:
        assert more <= less
    assert learner.starting_bonus(np.full(mdp.shape, 10**14))[0, 0] <= 1e-4 * c * (high - low)


@pytest.mark.parametrize("learner", [UCBQLearning(c=0.01), OPIQ(exponent=0.5)])
@FEW
@given(mdp=mdps((0.3, 0.75), loose=True))
def test_q_converges_to_the_optimum(learner, mdp):
    """Every pair is visited for ever (Watkins, Dayan 1992), whoever acts and whatever the bonus."""
    task = mdp.task()
    low, high = value_bounds(task)
    on = learner.__class__(learning_rate=harmonic(half=5), epsilon=0.5)
    found = cr.learn(task, on, 40_000, eval_freq=40_000).values[0]
    best = cr.solve(task).action_values
    assert abs(found - best)[~mdp.terminal].max() <= 0.1 * max(1.0, high - low)


@pytest.mark.parametrize("kind", [UCBQLearning, OPIQ])
@FEW
@given(mdp=mdps((0.3, 0.75)), c=st.floats(0.0, 3.0))
def test_values_contain_no_bonus(kind, mdp, c):
    """Started at the lowest value and learning by means, no value is ever above the bounds."""
    task = mdp.task(time_limit=5)
    low, high = value_bounds(task)
    found = cr.learn(task, kind(c=c), 200, eval_freq=200).values[0][~mdp.terminal]
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    assert (found <= high + slack).all()
    assert (found >= low - slack).all()
