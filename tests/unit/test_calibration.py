"""Greedy rollouts of a potential, and the fit of its scale to them."""

import numpy as np
import pytest

import curricle as cr
from curricle.learning.record import WarmUp
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.transfer.calibration import fit_calibration
from curricle.transfer.potential import mapped_potential
from curricle.transfer.rollouts import greedy_rollouts, greedy_start
from curricle.transfer.transfer import Calibrate
from tests.tasks import predator_edges

LINE = cr.GridWorld("S..T", discount=0.5, time_limit=10)
HUNT, CHASE = cr.Pursuit(3, 2, time_limit=30), cr.Pursuit(3, 1, time_limit=30)
EDGES = predator_edges(HUNT, CHASE)


def optimum(task):
    return cr.StateActionPotential(task, cr.solve(task).action_values)


def mapped(aggregate=cr.minimum):
    values = cr.solve(CHASE).action_values
    return mapped_potential(HUNT, EDGES, [values, values], aggregate)


def test_predicted_values_of_the_optimum_are_its_returns_to_go():
    rollouts = greedy_rollouts(optimum(LINE), episodes=2)
    assert rollouts.states.tolist() == [0, 1, 2, 0, 1, 2]
    np.testing.assert_allclose(rollouts.predicted, rollouts.return_to_go)
    assert rollouts.lengths.tolist() == [3, 3]
    assert rollouts.ended.all()
    assert rollouts.returns.tolist() == [197.0, 197.0]
    assert not rollouts.bootstrap_discount.any()
    assert not rollouts.bootstrapped_value.any()


def test_a_truncated_episode_is_bootstrapped():
    away = cr.StateActionPotential(LINE, np.tile([0.0, 0.0, 0.0, 8.0], (4, 1)))  # west, for ever
    rollouts = greedy_rollouts(away, episodes=1)
    assert rollouts.lengths.tolist() == [10]
    assert not rollouts.ended.any()
    assert rollouts.one_reward
    np.testing.assert_allclose(rollouts.bootstrap_discount, 0.5 ** np.arange(10, 0, -1))
    assert (rollouts.bootstrapped_value == 8.0).all()
    np.testing.assert_allclose(rollouts.return_to_go, -2 * (1 - rollouts.bootstrap_discount))


@pytest.mark.parametrize("aggregate", [cr.minimum, cr.mean, cr.maximum, cr.total])
def test_a_mapped_potential_has_the_rollouts_of_its_array(aggregate):
    lazy = mapped(aggregate)
    array = cr.StateActionPotential(HUNT, lazy.values)
    one, other = (greedy_rollouts(phi, episodes=50, seed=3) for phi in (lazy, array))
    for name in vars(one):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for method in ("exact", "rollouts"):
        evaluation = GreedyEvaluation(method=method)
        assert greedy_start(lazy, evaluation) == greedy_start(array, evaluation)


@pytest.mark.parametrize("factor", [0.1, 1.0, 3.0])
def test_a_scaled_optimum_is_scaled_back(factor):
    found = cr.calibrate(optimum(LINE).rescaled(1 / factor), episodes=5)
    assert found.scale == pytest.approx(factor)
    assert found.explained == pytest.approx(1.0)
    np.testing.assert_allclose(found.potential.values, optimum(LINE).values)


def test_the_scale_is_the_least_squares_one():
    phi = mapped(cr.mean)
    rollouts = greedy_rollouts(phi, episodes=200, seed=7, stream="calibrate")
    assert rollouts.ended.all()
    expected, *_ = np.linalg.lstsq(rollouts.predicted[:, None], rollouts.return_to_go)
    assert cr.calibrate(phi, seed=7).scale == pytest.approx(expected[0])


def test_an_endless_loop_has_its_long_run_cost():
    """The 10 steps before truncation are not all that the loop costs."""
    ring = cr.FiniteMDP.from_dense(
        np.array([[[0.0, 1.0]], [[1.0, 0.0]]]),
        np.array([[-1.0], [-1.5]]),
        terminal=[False, False],
        start=[1.0, 0.0],
        discount=0.9,
        time_limit=10,
    )
    found = cr.calibrate(
        cr.StateActionPotential(ring, cr.solve(ring).action_values / 4), episodes=1
    )
    assert found.scale == pytest.approx(4.0)


# -- refusals ------------------------------------------------------------------------------------


def refused(phi):
    with pytest.raises(cr.errors.CalibrationError) as caught:
        cr.calibrate(phi)
    found = fit_calibration(phi, Calibrate())
    assert found.refusal == str(caught.value)
    assert found.potential is phi
    assert found.scale == 1.0
    assert found.steps > 0  # the steps are charged all the same
    return found


def test_a_potential_that_reaches_nothing_is_refused_early():
    away = cr.StateActionPotential(LINE, np.tile([0.0, 0.0, 0.0, 8.0], (4, 1)))
    found = refused(away)
    assert found.refusal == (
        "a calibration needs episodes that reach something: none of 20 ended, and each of their "
        "200 steps had the reward -1"
    )
    assert found.episodes == 20


def test_a_potential_of_zeros_is_refused():
    found = refused(cr.StateActionPotential(LINE, np.zeros((4, 4))))
    assert "phi was 0 in 100% of" in found.refusal


def test_a_potential_of_the_opposite_sign_is_refused():
    found = refused(optimum(LINE).rescaled(1.0, -300.0))  # still towards the treasure
    assert "a calibration needs a positive scale" in found.refusal


def test_a_potential_unrelated_to_the_returns_is_refused():
    rng = np.random.default_rng(1)
    phi = cr.StateActionPotential(HUNT, rng.normal(-9, 3, size=(729, 25)))
    assert "must explain 25% of the returns to go" in refused(phi).refusal


def test_values_far_above_those_of_the_rollouts_are_not_raised():
    """The way to the treasure is underestimated; a far corner has values that no episode saw."""
    values = optimum(LINE).values / 4
    far = cr.GridWorld(["S..T", "####", "...."], discount=0.5, time_limit=10)
    q = np.zeros((8, 4))
    q[:4], q[4:] = values, 1000.0
    found = refused(cr.StateActionPotential(far, q))
    assert "that its episodes did not come near: a factor of 4" in found.refusal


def test_a_state_potential_cannot_be_calibrated():
    with pytest.raises(cr.errors.PotentialError, match="must be a StateActionPotential"):
        cr.calibrate(optimum(LINE).to_state())


def test_episodes_without_a_near_end_are_refused():
    long = cr.GridWorld("S..T", time_limit=1_000_000)
    with pytest.raises(cr.errors.SettingError, match=r"must not exceed 50,000,000 steps in all"):
        cr.calibrate(optimum(long))


@pytest.mark.parametrize("bad", ["x", {"x": 1}, None, float("nan"), 1e400])
def test_a_potential_is_rescaled_by_finite_numbers_alone(bad):
    for phi in (mapped(cr.mean), optimum(LINE)):
        with pytest.raises(cr.errors.PotentialError, match="scale must be"):
            phi.rescaled(bad)
        with pytest.raises(cr.errors.PotentialError, match="shift must be"):
            phi.rescaled(1.0, bad)


# -- in a curriculum -----------------------------------------------------------------------------


def curriculum(**changes):
    edges = [
        cr.Transfer("chase", "hunt", edge.mapping, **{"calibrate": True, **changes})
        for edge in EDGES
    ]
    return cr.Curriculum(
        tasks={"chase": CHASE, "hunt": HUNT},
        transfers=edges,
        aggregate=cr.minimum,
        budget={"chase": 20_000, "hunt": 5_000},
        eval_freq={"hunt": 100},
    )


def test_a_curriculum_calibrates_the_aggregate_of_each_seed():
    result = curriculum().train(seeds=[4, 9])
    raw = curriculum(calibrate=False).train(seeds=[4, 9])
    assert raw.calibrations == {}
    for k, seed in enumerate((4, 9)):
        found = result.calibrations["hunt"][k]
        again = fit_calibration(
            raw.potentials["hunt"][k],
            Calibrate(max_steps=250),
            seed=seed,
            stream="hunt/calibration",
        )
        assert found.scale == again.scale > 1.1
        np.testing.assert_array_equal(result.potentials["hunt"][k].values, again.potential.values)


def test_calibration_is_charged_to_the_target():
    result = curriculum().train(seeds=2)
    hunt = result["hunt"]
    assert hunt.steps_used.tolist() == [5000, 5000]
    for k, found in enumerate(result.calibrations["hunt"]):
        ends = np.cumsum(found.warm_up.lengths)
        spent = hunt.steps <= found.steps
        np.testing.assert_array_equal(
            hunt.episodes[k, spent], np.searchsorted(ends, hunt.steps[spent], side="right")
        )
        first = found.warm_up.returns[ends <= 100].mean()
        assert hunt.training_return[k, 1] == pytest.approx(first)
        assert (hunt.greedy_return[k, spent] == hunt.greedy_return[k, 0]).all()


@pytest.mark.parametrize("learner", [cr.QLearning(), cr.SARSA()])
@pytest.mark.parametrize("guard", [None, cr.Guard()])
def test_learning_starts_after_the_warm_up(learner, guard):
    shaping = cr.QInitialisation(mapped(), guard)
    warm_up = WarmUp(np.array([30, 40, 60]), np.array([-30.0, -5.0, -7.0]))
    options = {"shaping": shaping, "eval_freq": 50, "seeds": [3], "snapshots": 100}
    late = cr.learn(HUNT, learner, 1130, warm_up=[warm_up], **options)
    plain = cr.learn(HUNT, learner, 1000, **options)
    np.testing.assert_array_equal(late.values, plain.values)
    before, snapshots = plain.snapshots.values[0], late.snapshots
    assert snapshots.steps[:4].tolist() == [0, 50, 100, 150]
    np.testing.assert_array_equal(snapshots.values[:3], [before] * 3)
    assert (snapshots.values[3] != before).any()
    assert late.episodes_used[0] == plain.episodes_used[0] + 3
    assert late.episodes[0, :3].tolist() == [0, 1, 2]
    assert late.training_return[0, 1:3].tolist() == [-30.0, -5.0]
    assert np.ptp(late.greedy_return[0, :3]) == 0


def test_a_refused_seed_is_learnt_uncalibrated_with_a_warning():
    """After one step the source's values are 0."""
    plan = cr.Curriculum(
        tasks={"chase": CHASE, "hunt": HUNT},
        transfers=[cr.Transfer("chase", "hunt", EDGES[0].mapping, calibrate=True)],
        budget={"chase": 1, "hunt": 10_000},
    )
    with pytest.warns(UserWarning, match="2 of 2 seeds of 'hunt' take their potential as it is"):
        result = plan.train(seeds=2)
    assert all(found.refusal for found in result.calibrations["hunt"])


def test_calibrate_of_a_transfer_is_a_bool_or_settings():
    with pytest.raises(
        cr.errors.CurriculumError, match="must be True, False or a Calibrate: got 3"
    ):
        cr.Transfer("chase", "hunt", EDGES[0].mapping, calibrate=3)


@pytest.mark.parametrize(
    ("budget", "n"), [(130, 1), (cr.Episodes(3), 1), (1000, 2)], ids=["steps", "episodes", "number"]
)
def test_a_budget_must_exceed_its_warm_up(budget, n):
    warm_up = WarmUp(np.array([30, 40, 60]), np.zeros(3))
    with pytest.raises(
        cr.errors.SettingError, match=r"must exceed what was used|one warm-up a seed"
    ):
        cr.learn(HUNT, budget=budget, warm_up=[warm_up] * n)
