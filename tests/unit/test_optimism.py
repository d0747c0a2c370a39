"""Learners that explore by optimism: what they take from a task, and what they refuse."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from curricle.learning import OPIQ, UCBQLearning, harmonic, value_bounds
from curricle.learning.optimistic_learners import OptimisticLearner
from curricle.learning.storage import Storage
from tests.tasks import ring, ring_by_tables

KINDS = [UCBQLearning, OPIQ]


def test_bounds_count_rewards_of_ends_once():
    # Two steps to the goal: -1 each, the last pays 199; at discount .5 there are at most 2 rewards.
    assert value_bounds(cr.GridWorld("S.T", discount=0.5)) == (-2.0, 199.0)
    assert value_bounds(ring_by_tables()) == pytest.approx((-10.0, -1.0))


@pytest.mark.parametrize("kind", KINDS)
def test_settings_come_from_the_task_unless_given(kind):
    task = cr.GridWorld("S.T", discount=0.5)
    found = kind().for_task(task)
    assert (found.horizon, found.value_range, found.initial_value) == (2.0, (-2.0, 199.0), -2.0)
    assert found.learning_rate == harmonic(half=3.0)  # (H + 1) / (H + n) at visit n
    assert [found.learning_rate(n - 1) for n in (1, 4)] == pytest.approx([1.0, 3 / 6])
    own = kind(learning_rate=0.2, horizon=7, value_range=(0, 5), initial_value=1.0).for_task(task)
    assert (own.horizon, own.value_range, own.initial_value) == (7, (0.0, 5.0), 1.0)
    assert own.learning_rate(100) == 0.2


@pytest.mark.parametrize("kind", KINDS)
def test_the_horizon_is_the_time_limit_where_that_is_shorter(kind):
    task = cr.GridWorld("S.T", discount=0.99, time_limit=30)
    assert kind().for_task(task).horizon == 30


@pytest.mark.parametrize("kind", KINDS)
def test_a_task_that_does_not_tell_is_refused(kind):
    with pytest.raises(SettingError, match=r"needs value_range=.*without tables"):
        cr.learn(ring(), kind(), 10)
    unlimited = [[[(1.0, 1, 1.0)]], [[]]]  # one step, at discount 1
    endless = cr.FiniteMDP.from_outcomes(unlimited, terminal=[False, True], start=0, discount=1.0)
    with pytest.raises(SettingError, match=r"needs a horizon.*neither a discount below 1 nor"):
        cr.learn(endless, kind(), 10)
    found = cr.learn(ring(), kind(value_range=(-10, 0)), 3000)
    assert found.greedy_return[0, -1] > found.greedy_return[0, 0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"c": -1.0}, "c of .*-1"),
        ({"horizon": 0.5}, "horizon of .*0.5"),
        ({"value_range": (2, 1)}, "lowest <= highest"),
        ({"value_range": 3}, "must be .lowest, highest.: got 3"),
        ({"value_range": (0, float("inf"))}, "finite"),
        ({"learning_rate": 2.0}, "learning_rate"),
        ({"initial_value": float("nan")}, "initial_value"),
        ({"epsilon": 0.1, "inverse_temperature": 1.0}, "either"),
    ],
)
def test_settings_out_of_range_are_refused(kind, settings, rule):
    with pytest.raises(SettingError, match=rule):
        kind(**settings)


def test_an_exponent_of_zero_and_the_base_are_refused():
    with pytest.raises(SettingError, match="exponent of OPIQ must be above 0"):
        OPIQ(exponent=0.0)
    with pytest.raises(SettingError, match="must be of a kind"):
        OptimisticLearner()


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_loop_does_not_support_is_refused(kind):
    task = cr.GridWorld("S.T")
    for shaping in (
        cr.StateShaping(np.zeros(3)),
        cr.DecayingAdvice(np.zeros((3, 4))),
        cr.RewardBonus(np.zeros((3, 4))),
    ):
        with pytest.raises(SettingError, match="by QInitialisation or LookAheadAdvice alone"):
            cr.learn(task, kind(), 10, shaping=shaping)
    guarded = cr.QInitialisation(np.zeros((3, 4)), guard=cr.Guard())
    with pytest.raises(SettingError, match="a guard is for learners without a bonus"):
        cr.learn(task, kind(), 10, shaping=guarded)
    with pytest.raises(SettingError, match="sparse tables are for QLearning"):
        cr.learn(task, kind(), 10, storage=Storage(kind="sparse"))


@pytest.mark.parametrize("kind", KINDS)
def test_single_precision_learns_the_same_policy(kind):
    task = cr.GridWorld("S..T")
    single = cr.learn(task, kind(), 500, storage=Storage(dtype="float32"))
    assert single.values.dtype == np.float32
    assert single.greedy_return[0, -1] == pytest.approx(
        cr.learn(task, kind(), 500).greedy_return[0, -1]
    )


def test_a_curriculum_takes_them_as_learners():
    source, target = cr.GridWorld("S.T"), cr.GridWorld("S.T", start="uniform")
    curriculum = cr.Curriculum(
        {"source": source, "target": target},
        [cr.Transfer("source", "target", cr.from_function(target, source, lambda s, a: (s, a)))],
        learner={"source": UCBQLearning(), "target": OPIQ()},
        budget=cr.StoppingRule(500),
    )
    result = curriculum.train(seeds=2)
    assert result["target"].greedy_return[:, -1].min() > 190
    assert result["source"].steps_used.sum() == 1000
