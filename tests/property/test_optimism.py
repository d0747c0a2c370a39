"""The optimistic learner: Q contains no optimism, and converges to Q*."""

from hypothesis import given, settings

import curricle as cr
from curricle.learning import OptimisticQLearning, harmonic, value_bounds
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
@given(mdp=mdps((0.3, 0.75), loose=True))
def test_q_converges_to_the_optimum(mdp):
    """Every pair is visited for ever (Watkins, Dayan 1992), whoever acts."""
    task = mdp.task()
    low, high = value_bounds(task)
    learner = OptimisticQLearning(learning_rate=harmonic(half=5), epsilon=0.5)
    learnt = cr.learn(task, learner, 40_000, eval_freq=40_000).values[0]
    best = cr.solve(task).action_values
    assert abs(learnt - best)[~mdp.terminal].max() <= 0.1 * max(1.0, high - low)


@FEW
@given(mdp=mdps((0.3, 0.75)))
def test_values_contain_no_optimism(mdp):
    """Started at the lowest value and learning by means, no value is ever above the bounds."""
    task = mdp.task(time_limit=5)
    low, high = value_bounds(task)
    learnt = cr.learn(task, OptimisticQLearning(), 200, eval_freq=200).values[0][~mdp.terminal]
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    assert (learnt <= high + slack).all()
    assert (learnt >= low - slack).all()
