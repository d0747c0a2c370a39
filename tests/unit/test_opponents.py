"""Opponents: the learners from scratch that play unasked, at no charge."""

import numpy as np
import pytest

import curricle as cr
from curricle import QLearning, compare
from curricle.comparison.opponents import CONSTANTS, OPPONENTS, visited_states
from curricle.errors import SettingError
from curricle.learning import OptimisticQLearning, RMax, value_bounds
from curricle.study import run_study
from curricle.study.arms import Arms
from tests.support.comparisons import HERE, MAZE, copied, corner, pursuit
from tests.support.studies import CORNER as WITHOUT, reader
from tests.support.tasks import ring

OF_PHI = [f"transfer, {label}" for label in CONSTANTS]


def test_all_of_them_play_unasked_and_each_can_be_left_out():
    low, high = (f"scratch, initial_value={bound:.4g}" for bound in value_bounds(MAZE))
    optimistic = "scratch, OptimisticQLearning"
    assert list(compare(corner(), seeds=1).arms) == [
        *("scratch", low, high, optimistic, "transfer"),
        *OF_PHI,
    ]
    for opponents, names in (
        ((), []),
        (("bounds",), [low, high]),
        (("optimistic",), [optimistic]),
        (("model-based", "optimistic"), [optimistic, "scratch, RMax"]),
        (("constant",), OF_PHI),
    ):
        comparison = compare(corner(), seeds=1, opponents=opponents)
        assert [name for name in comparison.arms if name not in ("scratch", "transfer")] == names
        assert comparison.scratches == ("scratch", *names)
        assert comparison.verdicts["transfer"].rivals == 1 + len(names)


def test_asked_for_as_a_control_a_constant_plays_as_the_opponent_that_it_is():
    comparison = compare(corner(), seeds=1, opponents=(), controls=["constant"])
    assert comparison.scratches == ("scratch", *OF_PHI)
    assert comparison.controls == {"transfer": ()}


def test_a_learner_that_plays_anyway_is_not_played_twice():
    low, high = value_bounds(MAZE)
    plan = corner(learner={"maze": QLearning(initial_value=low)})
    learners = [OptimisticQLearning(), QLearning(initial_value=high)]
    comparison = compare(plan, seeds=1, opponents=["bounds", "optimistic"], scratch=learners)
    assert len(comparison.scratches) == 3


@pytest.mark.parametrize("shaping", [cr.QInitialisation(), cr.RewardBonus(), cr.StateShaping()])
def test_a_constant_is_the_learner_with_another_initial_value_bit_for_bit(shaping):
    """For all steps and without a charge, whatever the curriculum's shaping and its guard."""
    plan = corner(shaping=shaping, learner={"maze": QLearning(initial_value=2.0, epsilon=0.3)})
    comparison = compare(plan, seeds=[4, 9], opponents=["constant"])
    maze = plan.train([4, 9], only="corner")["corner"].values
    alive = ~MAZE.mdp.terminal  # every state can be reached
    for name, of_pairs in zip(OF_PHI, CONSTANTS.values(), strict=True):
        arm = comparison[name]
        phi = [np.nan_to_num(HERE.read(q))[alive] for q in maze]
        expected = [2.0 + of_pairs(values) for values in phi]
        np.testing.assert_allclose(arm.initial_values, expected, rtol=1e-12)
        assert arm.curve.source_steps.tolist() == [0, 0]
        for k, seed in enumerate((4, 9)):
            learner = QLearning(initial_value=float(arm.initial_values[k]), epsilon=0.3)
            alone = cr.learn(MAZE, learner, 3500, seeds=[seed], eval_freq=100, stream="maze")
            np.testing.assert_array_equal(arm.curve.values[k], alone.greedy_return[0])


def test_bounds_and_optimistic_learners_are_learners_from_scratch_bit_for_bit():
    comparison = compare(corner(), seeds=2, opponents=["bounds", "optimistic", "model-based"])
    learners = [QLearning(initial_value=bound) for bound in value_bounds(MAZE)]
    for name, learner in zip(
        comparison.scratches[1:], [*learners, OptimisticQLearning(), RMax()], strict=True
    ):
        alone = cr.learn(MAZE, learner, 3500, seeds=2, eval_freq=100, stream="maze")
        np.testing.assert_array_equal(comparison[name].curve.values, alone.greedy_return)


def test_arms_with_one_potential_share_their_constants(calls):
    arms = {"start": corner(), "bonus": corner(shaping=cr.RewardBonus())}
    comparison = compare(arms, seeds=1, opponents=["constant"])
    assert comparison.opponents("bonus") == (
        "scratch",
        *(f"bonus, {label}" for label in CONSTANTS),
    )
    assert len(calls) == 1 + 1 + 2 + 3  # scratch, the corner, two arms, three constants
    for label in CONSTANTS:
        first, second = (comparison[f"{name}, {label}"].curve.values for name in arms)
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("learner", [OptimisticQLearning(), cr.SARSA(epsilon=0.2)])
def test_the_learners_own_settings_stay(learner):
    comparison = compare(corner(learner={"maze": learner}), seeds=1)
    of_optimism = [name for name in comparison.scratches if "Optimistic" in name]
    assert len(comparison.scratches) == (1 if isinstance(learner, OptimisticQLearning) else 7)
    assert len(of_optimism) == (len(comparison.scratches) > 1)


def test_sparse_tables_have_constants_alone(calls):
    plan = pursuit(storage={"hunt": cr.Storage(kind="sparse")})
    comparison = compare(plan, seeds=1)
    assert comparison.scratches == ("scratch", *OF_PHI)
    used = [call["potentials"][0] for call in calls if call["potentials"]]
    assert {type(potential).__name__ for potential in used} == {"MappedPotential"}
    for name, phi in zip(OF_PHI, used[1:], strict=True):
        level = comparison[name].initial_values[0]
        np.testing.assert_allclose(phi.pairs(np.arange(1, 9)), level, rtol=1e-12)
    sampled, every = (visited_states(plan.tasks["hunt"], dense=dense) for dense in (False, True))
    assert set(sampled.tolist()) < set(every.tolist())
    assert len(sampled) > 0.5 * len(every)


def test_a_task_without_tables_has_constants_too():
    plan = copied(ring(time_limit=30), eval_freq={"far": 20})
    assert compare(plan, seeds=2).scratches == ("scratch", *OF_PHI)


def test_a_target_whose_rewards_bound_no_value_has_no_bounds():
    endless = cr.GridWorld("S.T", discount=1.0, time_limit=None)
    plan = copied(endless, evaluation=cr.GreedyEvaluation(method="off"))
    with pytest.raises(SettingError, match="evaluation"):
        compare(plan, seeds=1)
    limited = cr.GridWorld("S.T", discount=1.0, time_limit=20)
    assert len(compare(copied(limited), seeds=1, window=1).scratches) == 7


def test_states_that_no_policy_reaches_do_not_count():
    """East of the wall phi is 100."""
    walled = cr.GridWorld(["S.#.", "..#T"], time_limit=20)
    column = np.repeat(walled.mdp.states.decode()["column"][:, None], 4, axis=1)
    phi = cr.StateActionPotential(walled, np.where(column > 2, 100.0, 1.0 + column))
    values = phi.pairs(visited_states(walled, dense=True))
    assert sorted(values.ravel().tolist()) == [1.0] * 8 + [2.0] * 8


@pytest.mark.parametrize("opponents", ["optimistic", ["luck"], 3])
def test_other_names_are_refused(opponents):
    with pytest.raises(SettingError, match="opponent"):
        compare(corner(), seeds=1, opponents=opponents)


# -- in study files --------------------------------------------------------------------------------

CORNER = WITHOUT.replace("opponents = []\n", "")
SHORT = ["seeds=3", "window=1", "tasks.maze.budget=1_000", "tasks.corner.budget=200"]


def test_a_study_plays_them_as_compare_does(tmp_path):
    study = reader(tmp_path)(CORNER, set=[*SHORT, "tasks.maze.time_limit=50"])
    results = run_study(study, tmp_path / "out", progress=False)
    stored, compared = results.comparison, compare(study)
    assert list(stored.arms) == list(compared.arms)
    assert str(stored) == str(compared)
    for name in OF_PHI:
        np.testing.assert_array_equal(stored[name].initial_values, compared[name].initial_values)
    assert results.record.groups() == [("transfer",)]


@pytest.mark.parametrize("text", ["opponents=[]", "scratch=false", "compared=false"])
def test_a_study_can_leave_them_out(tmp_path, text):
    arms = Arms.of(reader(tmp_path)(CORNER, set=[*SHORT, text])).arms
    assert {*arms} <= {"scratch", "transfer"}


def test_where_arms_are_not_compared_those_that_are_named_play(tmp_path):
    text = ["compared=false", 'opponents=["constant"]']
    arms = Arms.of(reader(tmp_path)(CORNER, set=[*SHORT, *text])).arms
    assert {*arms} == {"scratch", "transfer", *OF_PHI}


def test_keys_of_other_arms_do_not_depend_on_them(tmp_path):
    read = reader(tmp_path)
    without, unasked = (
        Arms.of(read(CORNER, set=[*SHORT, *text])).keys for text in (["opponents=[]"], [])
    )
    assert without.items() <= unasked.items()
    assert len(unasked) > len(without)
    assert set(OPPONENTS) == {"constant", "bounds", "optimistic"}
