"""The optimistic learners: Q contains no optimism, and converges to Q*."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.learning import OptimisticQLearning, RMax, harmonic, value_bounds
from tests.support.tasks import mdps

FEW = settings(max_examples=25, deadline=None)


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


@FEW
@given(mdps((1.0,)), st.integers(1, 8))
def test_no_return_within_the_time_limit_is_outside_the_bounds(mdp, time_limit):
    """At discount 1: by backward induction, for the best and the worst policy."""
    low, high = value_bounds(mdp.task(time_limit=time_limit))
    for sign, bound in ((1, high), (-1, -low)):
        values = np.zeros(len(mdp.terminal))
        for _ in range(time_limit):
            backup = (mdp.p * (sign * mdp.r + values)).sum(axis=2).max(axis=1)
            values = np.where(mdp.terminal, 0.0, backup)
            assert (values[~mdp.terminal] <= bound + 1e-9 * max(1.0, abs(bound))).all()


@FEW
@given(mdps((0.3, 0.75, 0.95)), st.integers(1, 4), st.floats(0, 1), st.data())
def test_learners_that_bootstrap_at_the_limit_stay_within_the_bounds(mdp, limit, part, data):
    task = mdp.task(time_limit=limit)
    low, high = value_bounds(task)
    kind = data.draw(st.sampled_from([cr.QLearning, cr.SARSA, cr.ExpectedSARSA]))
    learner = kind(0.5, initial_value=low + part * (high - low))
    learnt = cr.learn(task, learner, 200, eval_freq=200).values[0][~mdp.terminal]
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    assert low - slack <= learnt.min() <= learnt.max() <= high + slack


EXPLORING = [OptimisticQLearning(learning_rate=harmonic(half=5), epsilon=0.5), RMax(epsilon=0.5)]


@pytest.mark.parametrize("learner", EXPLORING, ids=lambda learner: type(learner).__name__)
@FEW
@given(mdp=mdps((0.3, 0.75), loose=True))
def test_q_converges_to_the_optimum(learner, mdp):
    """Every pair is visited for ever (Watkins, Dayan 1992), whoever acts."""
    task = mdp.task()
    low, high = value_bounds(task)
    learnt = cr.learn(task, learner, 40_000, eval_freq=40_000).values[0]
    best = cr.solve(task).action_values
    assert abs(learnt - best)[~mdp.terminal].max() <= 0.1 * max(1.0, high - low)


@FEW
@given(mdp=mdps(), steps=st.sampled_from([20, 200, 2000]))
def test_without_chance_r_max_finds_the_optimum_from_below(mdp, steps):
    """Q is never above Q*; it is Q* where the start leads, once every pair there was tried."""
    sure = np.eye(len(mdp.p))[mdp.p.argmax(axis=2)]
    task = replace(mdp, p=sure).task(time_limit=6)
    (low, high), best = value_bounds(task), cr.solve(task)
    slack = best.error_bound + 1e-9 * max(1.0, abs(low), abs(high))
    learnt = cr.learn(task, RMax(epsilon=0.5), steps, eval_freq=steps).values[0]
    assert (learnt <= best.action_values + slack).all()
    if steps == 2000:  # what is not propagated changes a value by a thousandth of the range
        shortfall = (best.values - learnt.max(axis=1))[task.start > 0]
        assert shortfall.max() <= slack + 1e-3 * (high - low)


@pytest.mark.parametrize(
    "learner", [OptimisticQLearning(), RMax()], ids=lambda of: type(of).__name__
)
@FEW
@given(mdp=mdps((0.3, 0.75)))
def test_values_contain_no_optimism(learner, mdp):
    """Started at the lowest value and learning by means, no value is ever above the bounds."""
    task = mdp.task(time_limit=5)
    low, high = value_bounds(task)
    learnt = cr.learn(task, learner, 200, eval_freq=200).values[0][~mdp.terminal]
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    assert (learnt <= high + slack).all()
    assert (learnt >= low - slack).all()


@FEW
@given(mdp=mdps((0.3, 0.75)), cap=st.integers(1, 600), patience=st.integers(1, 5))
def test_a_source_ends_at_the_first_agreement_of_a_learnt_return_or_by_its_cap(mdp, cap, patience):
    task = mdp.task(time_limit=20)
    rule, eval_freq = cr.StoppingRule(cap, agreed=0.9, patience=patience), max(1, cap // 50)
    whole = cr.learn(task, OptimisticQLearning(), cap, eval_freq=eval_freq)
    ended = cr.learn(task, OptimisticQLearning(), rule, eval_freq=eval_freq)
    n, agreement, greedy = len(ended.steps), whole.agreement[0], whole.greedy_return[0]
    np.testing.assert_array_equal(ended.agreement[0], agreement[:n])
    met = [
        k + 1 >= patience
        and min(agreement[k + 1 - patience : k + 1]) >= 0.9
        and greedy[int(0.7 * k) + 1 : k + 1].mean() > ended.floor[0]
        for k in range(1, n)
    ]
    assert not any(met[:-1])
    if met and met[-1]:
        assert ended.ended_by[0] == "agreement reached"
        assert ended.steps_used[0] == ended.steps[-1]
    else:
        assert ended.steps_used[0] == cap
    decisions = rule.decisions(
        ended.steps, ended.greedy_return[0], agreement=ended.agreement[0], floor=ended.floor[0]
    )
    assert [decision.ends for decision in decisions] == [False, *met]


@FEW
@given(mdp=mdps((0.3, 0.75), loose=True))
def test_the_two_values_agree_in_the_end(mdp):
    """What the optimistic values lead to is tried until they are true (Even-Dar, Mansour 2001)."""
    if np.diff(value_bounds(mdp.task()))[0] < 1e-9:
        return
    learnt = cr.learn(mdp.task(), OptimisticQLearning(), 20_000, eval_freq=20_000)
    assert learnt.agreement[0, -1] > 0.9
    assert np.isnan(cr.learn(mdp.task(), cr.QLearning(), 100).agreement).all()
