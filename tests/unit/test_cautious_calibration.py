"""Cautious calibration, the default: refused early and for little, never far from phi."""

import math
import warnings

import numpy as np
import pytest

import curricle as cr
from curricle.errors import CalibrationError, SettingError
from curricle.learning.potential_rollouts import greedy_rollouts
from curricle.transfer import Calibrate, FunctionValues, ObservationPotential
from curricle.transfer.calibration import fit_calibration
from curricle.transfer.calibration_refusals import too_little
from curricle.transfer.potentials import mapped_potential
from curricle.transfer.scale_fit import LARGEST_CAUTIOUS, ScaleEvidence, scale_evidence

COSTS = cr.Rewards(step=-1.0, treasure=0.0, pit=-10.0)
LINE = cr.GridWorld("S..T", COSTS, discount=0.9, time_limit=10)
HUNT, CHASE = cr.Pursuit(3, 2, time_limit=30), cr.Pursuit(3, 1, time_limit=30)
EDGES = [
    cr.Transfer("chase", "hunt", cr.project(HUNT, CHASE, predator=name), calibrate=True)
    for name in HUNT.predator_names
]


def optimum(task):
    return cr.StateActionPotential(task, cr.solve(task).action_values)


def mapped(aggregate):
    values = cr.solve(CHASE).action_values
    return mapped_potential(HUNT, EDGES, [values, values], aggregate)


def refused(phi, **settings):
    found = fit_calibration(phi, Calibrate(**settings))
    assert found.refusal
    assert found.potential is phi
    assert (found.scale, found.shift) == (1.0, 0.0)
    with pytest.raises(CalibrationError) as caught:
        cr.calibrate(phi, **settings)
    assert str(caught.value) == found.refusal
    return found


@pytest.mark.parametrize("aggregate", [cr.minimum, cr.mean])
def test_overestimated_costs_are_raised_half_way(aggregate):
    phi = mapped(aggregate)
    found, plain = cr.calibrate(phi), cr.calibrate(phi, cautious=False)
    assert 1.1 < found.scale < plain.scale
    assert abs(found.evidence.scale - plain.scale) < 3 * found.evidence.scale_error
    assert found.steps < plain.steps
    np.testing.assert_array_equal(found.potential.values, phi.rescaled(found.scale, 0.0).values)


@pytest.mark.parametrize("error", [0.0, 0.1, 0.5, 5.0])
@pytest.mark.parametrize("scale", [1.0, 1.3, 2.0, 100.0])
def test_the_scale_lies_between_1_and_the_root_of_the_fit(scale, error):
    found = ScaleEvidence(scale, error * scale, 1.0, 0.1, 10, False).cautious_scale
    assert 1.0 <= found <= min(math.sqrt(scale), LARGEST_CAUTIOUS)
    surer = ScaleEvidence(scale, error * scale / 2, 1.0, 0.1, 10, False).cautious_scale
    assert surer >= found


def test_half_the_belief_at_the_prior_error():
    assert ScaleEvidence(1.2, 0.6, 1.0, 0.1, 10, False).cautious_scale == math.sqrt(1.1)
    assert ScaleEvidence(1.44, 0.0, 1.0, 0.1, 10, False).cautious_scale == pytest.approx(1.2)


# -- refusals --------------------------------------------------------------------------------------


def test_what_may_be_gained_is_refused_without_a_step():
    maze = cr.GridWorld("S..T", discount=0.9, time_limit=10)
    found = refused(optimum(maze))
    assert "nowhere above 0: this one is 199 somewhere" in found.refusal
    assert (found.steps, found.episodes, len(found.warm_up.lengths)) == (0, 0, 0)


def test_a_potential_mostly_of_zeros_is_refused_without_a_step():
    values = np.zeros((4, 4))
    values[0] = -1.0
    found = refused(cr.StateActionPotential(LINE, values))
    assert found.refusal.endswith("this one is in 67% of all pairs")  # 8 of 12, without the end
    assert found.steps == 0


def test_right_costs_are_refused_after_few_episodes():
    found = refused(optimum(HUNT), max_steps=1000)
    assert "is not worth it" in found.refusal or "not above 1 by two" in found.refusal
    assert found.steps < 250
    assert "is not worth it" in refused(optimum(LINE)).refusal


def test_overestimated_costs_of_no_use_are_refused():
    """The scale is too small, but what phi says of a step has nothing to do with what follows."""
    rng = np.random.default_rng(1)
    phi = cr.StateActionPotential(HUNT, -1 - 0.1 * rng.random((729, 25)))
    found = refused(phi, episodes=40)
    assert found.evidence.scale > 2
    assert "tells good steps from bad" in found.refusal


def test_two_episodes_in_which_nothing_happens_are_enough():
    """It goes west for ever, and each step costs."""
    away = cr.StateActionPotential(LINE, np.tile([-1.0, -1.0, -1.0, -0.5], (4, 1)))
    found = cr.calibrate(away)
    assert (found.scale, found.episodes, found.steps) == (LARGEST_CAUTIOUS, 2, 20)
    assert found.evidence.stuck


def test_a_first_episode_that_shows_that_the_steps_are_too_few_is_the_last():
    phi = optimum(HUNT).rescaled(0.3, 0.0)
    first = int(greedy_rollouts(phi, episodes=1, stream="calibrate").lengths[0])
    found = refused(phi, max_steps=5 * first - 1)
    assert f"needs 5 episodes, for which {5 * first - 1} steps are too few" in found.refusal
    assert found.steps == first


def test_few_episodes_are_refused():
    assert "needs 5 episodes: it had 3" in refused(mapped(cr.mean), episodes=3).refusal


def test_observations_above_0_are_refused_when_they_are_met():
    car = cr.observation_task("MountainCar-v0")
    push = FunctionValues(lambda cars, acts: 2 + np.sign(cars[:, 1:]) * (acts - 1.0), actions=3)
    found = refused(ObservationPotential.of(car, push))
    assert "nowhere above 0" in found.refusal
    assert found.episodes == 1


@pytest.mark.parametrize("settings", [{"shift": True}, {"quantile": 0.2}])
def test_shifts_and_quantiles_are_not_cautious(settings):
    with pytest.raises(SettingError, match="set cautious=False for a shift or a quantile"):
        Calibrate(**settings)
    assert Calibrate(**settings, cautious=False)
    with pytest.raises(SettingError, match="cautious of a calibration must be a bool: got 1"):
        Calibrate(cautious=1)


# -- in a curriculum -------------------------------------------------------------------------------


def test_a_calibration_takes_little_of_the_budget_and_a_refusal_less():
    plan = cr.Curriculum(
        {"chase": CHASE, "hunt": HUNT},
        EDGES,
        aggregate=cr.minimum,
        budget={"chase": 20_000, "hunt": 8_000},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of seeds that are refused
        result = plan.train(5)
    for one in result.calibrations["hunt"]:
        assert one.steps <= (80 if one.refusal else 400)
    assert sum(not one.refusal for one in result.calibrations["hunt"]) >= 3


def test_a_refusal_without_a_step_leaves_learning_as_it_is():
    maze = cr.GridWorld("S..T", time_limit=10)
    edges = {
        flag: cr.Transfer("easy", "maze", cr.transfer.identity(maze), calibrate=flag)
        for flag in (False, True)
    }
    plans = {
        flag: cr.Curriculum({"easy": maze, "maze": maze}, [edge], budget=2000)
        for flag, edge in edges.items()
    }
    raw = plans[False].train(2)["maze"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that both seeds are refused
        calibrated = plans[True].train(2)["maze"]
    np.testing.assert_array_equal(raw.values, calibrated.values)
    np.testing.assert_array_equal(raw.greedy_return, calibrated.greedy_return)


# -- the evidence ----------------------------------------------------------------------------------


def test_the_evidence_of_optimal_values_is_a_scale_and_a_slope_of_1():
    found = scale_evidence(greedy_rollouts(optimum(HUNT), episodes=200), HUNT.discount)
    assert abs(found.scale - 1) < 3 * found.scale_error < 0.3
    assert abs(found.slope - 1) < 3 * found.slope_error < 0.3


def test_a_constant_has_no_slope():
    phi = cr.StateActionPotential(HUNT, np.full((729, 25), -0.1))
    found = scale_evidence(greedy_rollouts(phi, episodes=10), HUNT.discount)
    assert math.isnan(found.slope)
    assert "differs: phi was the same" in too_little(found)
