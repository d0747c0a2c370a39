"""The optimistic learners: what they take from a task, and what they refuse."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from curricle.learning import OptimisticQLearning, RMax, learners, value_bounds
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


def test_r_max_has_rules_of_its_own():
    wrong = {"min_visits": [0, 1.5], "epsilon": [2.0], "value_range": [(2, 1)]}
    check_values(SettingError, RMax, wrong)
    with pytest.raises(TypeError, match="learning_rate"):
        RMax(learning_rate=0.1)
    filled = RMax().for_task(cr.GridWorld("S.T", discount=0.5))
    assert (filled.value_range, filled.initial_value) == ((-2.0, 199.0), -2.0)
    with pytest.raises(SettingError, match=r"RMax needs value_range=.*without tables"):
        cr.learn(ring(), RMax(), 10)
    learnt = cr.learn(ring(), RMax(value_range=(-10, 0)), 300, seeds=2, workers=1)
    assert (learnt.greedy_return[:, -1] > learnt.greedy_return[:, 0]).all()
    again = cr.learn(ring(), RMax(value_range=(-10, 0)), 300, seeds=2, workers=2)
    np.testing.assert_array_equal(learnt.values, again.values)


def test_a_model_is_bounded(monkeypatch):
    monkeypatch.setattr(learners, "MOST_MODELLED", 2 * ring().states.size)
    with pytest.raises(SettingError, match=r"pairs for RMax \(.*must lie in \[1, 18\]: got 20"):
        cr.learn(ring(10), RMax(value_range=(-10, 0)), 10)


def test_r_max_takes_a_potential_as_the_start_of_untried_pairs():
    task = cr.GridWorld("S....T", discount=0.9)
    phi = np.random.default_rng(2).normal(size=(6, 4)) * 50
    ways = [cr.QInitialisation(phi), cr.LookAheadAdvice(phi), None]
    learnt = [cr.learn(task, RMax(), 60, eval_freq=5, shaping=way) for way in ways]
    np.testing.assert_array_equal(learnt[0].values, learnt[1].values)
    assert (learnt[0].values != learnt[2].values).any()


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_r_max_learns_a_long_hall_in_few_steps(dtype):
    hall = cr.GridWorld("S" + "." * 60 + "T")
    storage = Storage(dtype=dtype, save_values=False)
    learnt = [cr.learn(hall, of, 1_000, storage=storage) for of in (RMax(), OptimisticQLearning())]
    assert learnt[0].greedy_return[0, -1] > learnt[1].greedy_return[0, -1]


PAIRS = np.zeros((3, 4))
REFUSED = [
    ({"shaping": cr.StateShaping(np.zeros(3))}, "takes a potential by QInitialisation.* alone"),
    ({"shaping": cr.RewardBonus(PAIRS)}, "takes a potential by QInitialisation.* alone"),
    ({"shaping": cr.QInitialisation(PAIRS, portfolio=cr.Portfolio())}, "portfolio"),
    ({"storage": Storage(kind="sparse")}, "sparse tables are for QLearning"),
]


@pytest.mark.parametrize("learner", [OptimisticQLearning(), RMax()])
@pytest.mark.parametrize(("settings", "message"), REFUSED)
def test_what_the_loop_does_not_support_is_refused(learner, settings, message):
    with pytest.raises(SettingError, match=message):
        cr.learn(cr.GridWorld("S.T"), learner, 10, **settings)


def test_the_optimistic_table_starts_at_the_highest_value_whatever_q_starts_at():
    hall = cr.GridWorld("S" + "." * 30 + "T")
    returns = [
        cr.learn(hall, OptimisticQLearning(initial_value=value), 20_000).greedy_return[0, -1]
        for value in (None, -10_000.0)
    ]
    assert returns[0] == returns[1] > 100


@pytest.mark.parametrize("kind", [OptimisticQLearning, RMax])
def test_optimistic_learners_are_learners_of_sources_and_targets(kind):
    near, far = cr.GridWorld("S..T"), cr.GridWorld("S" + "." * 12 + "T")
    plan = cr.Curriculum(
        {"near": near, "far": far},
        [cr.Transfer("near", "far", cr.project(far, near))],
        learner=kind(),
        budget={"near": 300, "far": 300},
    )
    assert plan.node("far").shaping == cr.QInitialisation()
    learnt = plan.train(2)["far"]
    alone = cr.learn(far, kind(), 300, seeds=2, stream="far")
    assert learnt.learner == kind()
    assert (learnt.values != alone.values).any()
