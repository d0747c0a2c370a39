"""Greedy rollouts of a potential, and the fit of its scale to them, within a budget."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from curricle.errors import CalibrationError, CurriculumError, PotentialError, SettingError
from curricle.learning.record import WarmUp
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer import FunctionValues, ObservationPotential
from curricle.transfer.calibration import fit_calibration, fitted_scale
from curricle.transfer.potential import mapped_potential
from curricle.transfer.rollouts import greedy_rollouts
from curricle.transfer.transfer import Calibrate
from tests.refusals import check_refusal
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
    quarter = cr.StateActionPotential(ring, cr.solve(ring).action_values / 4)
    assert cr.calibrate(quarter, episodes=1).scale == pytest.approx(4.0)


def high_where_no_episode_leads():
    """The way to the treasure is underestimated; a far corner has values that no episode saw."""
    far = cr.GridWorld(["S..T", "####", "...."], discount=0.5, time_limit=10)
    values = np.concatenate([optimum(LINE).values / 4, np.full((4, 4), 1000.0)])
    return cr.StateActionPotential(far, values)


def unrelated():
    values = np.random.default_rng(1).normal(-9, 3, size=(729, 25))
    return cr.StateActionPotential(HUNT, values)


@pytest.mark.parametrize(
    ("phi", "says"),
    [
        (
            lambda: cr.StateActionPotential(LINE, np.tile([0.0, 0.0, 0.0, 8.0], (4, 1))),  # away
            "episodes that reach something: none of 20 ended, and each of their 200 steps had "
            "the reward -1",
        ),
        (lambda: cr.StateActionPotential(LINE, np.zeros((4, 4))), "phi was 0 in 100% of"),
        # Still towards the treasure.
        (lambda: optimum(LINE).rescaled(1.0, -300.0), "a calibration needs a positive scale"),
        (unrelated, "must explain 25% of the returns to go"),
        (high_where_no_episode_leads, "that its episodes did not come near: a factor of 4"),
    ],
)
def test_what_cannot_be_fitted_is_refused_and_charged(phi, says):
    phi = phi()
    with pytest.raises(CalibrationError, match=says) as caught:
        cr.calibrate(phi)
    refused = fit_calibration(phi, Calibrate())
    assert (refused.refusal, refused.scale) == (str(caught.value), 1.0)
    assert refused.potential is phi
    assert refused.steps > 0


@pytest.mark.parametrize(
    ("error", "call", "says"),
    [
        (PotentialError, lambda: cr.calibrate(optimum(LINE).to_state()), "must be a StateActionP"),
        (
            SettingError,
            lambda: cr.calibrate(optimum(cr.GridWorld("S..T", time_limit=1_000_000))),
            "must not exceed 50,000,000 steps in all",
        ),
        (
            CurriculumError,
            lambda: cr.Transfer("chase", "hunt", EDGES[0].mapping, calibrate=3),
            "must be True, False or a Calibrate: got 3",
        ),
    ],
)
def test_bad_calibrations_are_refused_in_one_sentence(error, call, says):
    check_refusal(error, call, says)


@pytest.mark.parametrize("bad", ["x", {"x": 1}, None, float("nan"), 1e400])
def test_a_potential_is_rescaled_by_finite_numbers_alone(bad):
    for phi in (mapped(cr.mean), optimum(LINE)):
        with pytest.raises(PotentialError, match="scale must be"):
            phi.rescaled(bad)
        with pytest.raises(PotentialError, match="shift must be"):
            phi.rescaled(1.0, bad)


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
        phi, how = raw.potentials["hunt"][k], {"seed": seed, "stream": "hunt/calibration"}
        again = fit_calibration(phi, Calibrate(max_steps=250), **how)
        assert result.calibrations["hunt"][k].scale == again.scale > 1.1
        np.testing.assert_array_equal(result.potentials["hunt"][k].values, again.potential.values)


def test_calibration_is_charged_to_the_target():
    result = curriculum().train(seeds=2)
    hunt = result["hunt"]
    assert hunt.steps_used.tolist() == [5000, 5000]
    for k, fitted in enumerate(result.calibrations["hunt"]):
        ends = np.cumsum(fitted.warm_up.lengths)
        spent = hunt.steps <= fitted.steps
        np.testing.assert_array_equal(
            hunt.episodes[k, spent], np.searchsorted(ends, hunt.steps[spent], side="right")
        )
        first = fitted.warm_up.returns[ends <= 100].mean()
        assert hunt.training_return[k, 1] == pytest.approx(first)
        assert (hunt.greedy_return[k, spent] == hunt.greedy_return[k, 0]).all()


@pytest.mark.parametrize(
    ("learner", "portfolio"),
    [(cr.QLearning(), None), (cr.QLearning(), cr.Portfolio()), (cr.SARSA(), None)],
)
def test_learning_starts_after_the_warm_up(learner, portfolio):
    shaping = cr.QInitialisation(mapped(), portfolio)
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
    assert all(fitted.refusal for fitted in result.calibrations["hunt"])


@pytest.mark.parametrize(
    ("budget", "n"), [(130, 1), (cr.Episodes(3), 1), (1000, 2)], ids=["steps", "episodes", "number"]
)
def test_a_budget_must_exceed_its_warm_up(budget, n):
    warm_up = WarmUp(np.array([30, 40, 60]), np.zeros(3))
    with pytest.raises(SettingError, match=r"must exceed what was used|an entry per seed"):
        cr.learn(HUNT, budget=budget, warm_up=[warm_up] * n)


LOOP = cr.FiniteMDP.from_outcomes(
    [[[(1.0, 1, -1.0)], [(1.0, 0, -2.0)]], [[(1.0, 0, -1.5)], [(1.0, 1, -3.0)]]],
    terminal=[False, False], start=0, discount=1.0, time_limit=10,
)  # fmt: skip


@pytest.mark.parametrize("function", [cr.minimum, cr.mean, cr.maximum, cr.total])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_calibration_does_not_depend_on_how_phi_is_stored(function, sign):
    """The highest of the sources' values, a bound of phi, refused what the array of it allowed."""
    q = cr.solve(CHASE).action_values
    high = q.copy()
    high[CHASE.states.encode(prey=0, predator=1), 0] = 50.0  # where the other is low
    lazy = mapped_potential(HUNT, EDGES, [sign * high, sign * q], function)
    array = cr.StateActionPotential(HUNT, lazy.values)
    by_lookup, by_array = (fit_calibration(phi, Calibrate(50)) for phi in (lazy, array))
    assert str(by_lookup) == str(by_array)
    assert (by_lookup.scale, by_lookup.refusal) == (by_array.scale, by_array.refusal)
    np.testing.assert_array_equal(by_lookup.explained, by_array.explained)
    np.testing.assert_array_equal(by_lookup.potential.values, by_array.potential.values)


def test_a_fit_of_0_over_0_is_refused():
    equal = cr.StateActionPotential(LOOP, np.ones((2, 2)))  # ends at the value it began with
    with pytest.raises(CalibrationError, match=r"0 of which ended, leave the scale at 0 / 0"):
        cr.calibrate(equal)


@pytest.mark.parametrize("cap", [1, 9, 10, 11, 25, 10_000])
def test_rollouts_stop_at_their_most_steps(cap):
    phi = cr.StateActionPotential(LOOP, [[3.0, 1.0], [2.0, 1.0]])
    whole = greedy_rollouts(phi, episodes=5)
    cut = greedy_rollouts(phi, episodes=5, max_steps=cap)
    n = min(cap, 50)
    assert len(cut.states) == cut.lengths.sum() == n
    np.testing.assert_array_equal(cut.states, whole.states[:n])
    assert (cut.lengths[:-1] == 10).all()
    assert not cut.ended.any()
    if n % 10:  # phi of the state in which the last was cut, which is the next one met
        assert cut.bootstrapped_value[-1] == phi.values[whole.states[n]].max()
    else:
        np.testing.assert_array_equal(cut.return_to_go, whole.return_to_go[:n])


def test_rollouts_of_observations_stop_there_too():
    car = cr.observation_task("MountainCar-v0")
    push = FunctionValues(lambda cars, acts: np.sign(cars[:, 1:]) * (acts - 1.0), actions=3)
    phi = ObservationPotential.of(car, push)
    assert isinstance(phi.task, ObservationTask)
    whole = greedy_rollouts(phi, episodes=3)
    n = int(whole.lengths[0]) + 7
    cut, uncut = (greedy_rollouts(phi, episodes=3, max_steps=most) for most in (n, 10**6))
    assert cut.lengths.tolist() == [whole.lengths[0], 7]
    assert cut.ended.tolist() == [True, False]
    np.testing.assert_array_equal(cut.predicted, whole.predicted[:n])
    np.testing.assert_array_equal(uncut.lengths, whole.lengths)


def test_a_calibration_stops_at_its_most_steps_and_says_so():
    phi = cr.StateActionPotential(HUNT, cr.solve(HUNT).action_values / 2)
    free, capped = cr.calibrate(phi), cr.calibrate(phi, max_steps=100)
    assert free.steps > capped.steps == 100
    assert (free.stopped, capped.stopped) == (False, True)
    assert "(100 steps, the most allowed, " in str(capped)
    with pytest.raises(CalibrationError, match="whole episode: its most steps, 1, ended during"):
        cr.calibrate(cr.StateActionPotential(LOOP, [[3.0, 1.0], [2.0, 1.0]]), max_steps=1)


def test_a_calibration_takes_at_most_a_twentieth_of_what_is_left_to_its_target():
    settings = Calibrate()
    assert settings.within(30_000, 10**9) == Calibrate(max_steps=1_500)
    assert settings.within(10**18, 100).episodes == 5
    assert Calibrate(max_steps=10).within(30_000, 1).max_steps == 10
    assert Calibrate(max_steps=10_000).within(30_000, 1).max_steps == 7_500
    edge = cr.Transfer("chase", "hunt", EDGES[0].mapping, calibrate=True)
    for budget in (400, cr.Episodes(100)):
        plan = cr.Curriculum(
            {"chase": CHASE, "hunt": HUNT}, [edge], budget={"chase": 5000, "hunt": budget}
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of seeds that are refused
            result = plan.train(2)
        for fitted in result.calibrations["hunt"]:
            assert fitted.steps <= 20 or fitted.episodes <= 5
            assert fitted.steps < result["hunt"].steps_used.max()


def test_taxi_is_compared_with_itself_calibrated_within_30_000_steps():
    taxi = cr.from_gymnasium("Taxi-v4", discount=0.99)
    edge = cr.Transfer("source", "taxi", cr.transfer.identity(taxi), calibrate=True)
    budget = {"source": 60_000, "taxi": 30_000}
    plan = cr.Curriculum({"source": taxi, "taxi": taxi}, [edge], budget=budget, eval_freq=5_000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of seeds that are refused
        comparison = cr.compare({"calibrated": plan}, seeds=2, opponents=())
    assert list(comparison.arms) == ["scratch", "calibrated"]


def test_a_scale_is_fitted_in_units_in_which_nothing_overflows():
    rng = np.random.default_rng(0)
    phi, returns = rng.normal(size=(2, 50))

    def fitted(by):
        zeros = np.zeros(50)
        how = {"bootstrap_discount": zeros, "bootstrapped_value": zeros}
        return fitted_scale(SimpleNamespace(predicted=by * phi, return_to_go=returns, **how))

    scale, explained = fitted(1.0)
    assert scale == pytest.approx(phi @ returns / (phi @ phi))
    assert explained == pytest.approx(scale * (phi @ returns) / (returns @ returns))
    for by in (2.0**900, 2.0**-900):
        assert fitted(by) == (scale / by, explained)
