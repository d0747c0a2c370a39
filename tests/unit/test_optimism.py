"""The optimistic learner: what it takes from a task, and what it refuses."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from curricle.learning import OptimisticQLearning, value_bounds
from curricle.learning.storage import Storage
from tests.support.refusals import check_values
from tests.support.tasks import ring, ring_by_tables


def test_bounds_count_rewards_of_ends_once():
    # Two steps to the goal: -1 each, the last pays 199; at discount .5 there are at most 2 rewards.
    assert value_bounds(cr.GridWorld("S.T", discount=0.5)) == (-2.0, 199.0)
    assert value_bounds(ring_by_tables()) == pytest.approx((-10.0, -1.0))
    # At discount 1 from 1 to 20 rewards; a learner bootstraps at the limit.
    endless = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 0, 2.0)]]], terminal=[False], start=0, discount=1.0, time_limit=20
    )
    assert value_bounds(endless) == (2.0, 40.0)
    assert cr.learn(endless, cr.QLearning(0.5), 1000, eval_freq=1000).values[0][0, 0] > 40.0


def test_settings_come_from_the_task_unless_given():
    task = cr.GridWorld("S.T", discount=0.5)
    filled = OptimisticQLearning().for_task(task)
    assert (filled.value_range, filled.initial_value) == ((-2.0, 199.0), -2.0)
    configured = OptimisticQLearning(learning_rate=0.2, value_range=(0, 5), initial_value=1.0)
    assert configured.for_task(task) == configured
    assert configured.value_range == (0.0, 5.0)


def test_a_task_that_does_not_tell_is_refused():
    with pytest.raises(SettingError, match=r"needs value_range=.*without tables"):
        cr.learn(ring(), OptimisticQLearning(), 10)
    unlimited = [[[(1.0, 1, 1.0)]], [[]]]  # one step, at discount 1
    endless = cr.FiniteMDP.from_outcomes(unlimited, terminal=[False, True], start=0, discount=1.0)
    with pytest.raises(SettingError, match=r"needs a horizon.*neither a discount below 1 nor"):
        cr.learn(endless, OptimisticQLearning(), 10)
    learnt = cr.learn(ring(), OptimisticQLearning(value_range=(-10, 0)), 3000)
    assert learnt.greedy_return[0, -1] > learnt.greedy_return[0, 0]


def test_settings_out_of_range_are_refused():
    nan, inf = float("nan"), float("inf")
    wrong = {"value_range": [(2, 1), 3, (0, inf)], "learning_rate": [2.0], "initial_value": [nan]}
    check_values(SettingError, OptimisticQLearning, wrong)
    with pytest.raises(SettingError, match="either"):
        OptimisticQLearning(epsilon=0.1, inverse_temperature=1.0)


PAIRS = np.zeros((3, 4))
REFUSED = [
    ({"shaping": cr.StateShaping(np.zeros(3))}, "by QInitialisation or LookAheadAdvice alone"),
    ({"shaping": cr.RewardBonus(PAIRS)}, "by QInitialisation or LookAheadAdvice alone"),
    (
        {"shaping": cr.QInitialisation(PAIRS, portfolio=cr.Portfolio())},
        "a portfolio is for QLearning alone",
    ),
    ({"storage": Storage(kind="sparse")}, "sparse tables are for QLearning"),
]


@pytest.mark.parametrize(("settings", "message"), REFUSED)
def test_what_the_loop_does_not_support_is_refused(settings, message):
    with pytest.raises(SettingError, match=message):
        cr.learn(cr.GridWorld("S.T"), OptimisticQLearning(), 10, **settings)


def test_the_optimistic_table_starts_at_the_highest_value_whatever_q_starts_at():
    hall = cr.GridWorld("S" + "." * 30 + "T")
    returns = [
        cr.learn(hall, OptimisticQLearning(initial_value=value), 20_000).greedy_return[0, -1]
        for value in (None, -10_000.0)
    ]
    assert returns[0] == returns[1] > 100
