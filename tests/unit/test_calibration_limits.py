"""Calibration: the same of every kind of potential, within its budget, and never a fit of 0 / 0."""

import warnings

import numpy as np
import pytest

import curricle as cr
from curricle.errors import CalibrationError
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer import FunctionValues, ObservationPotential
from curricle.transfer.calibration import fit_calibration
from curricle.transfer.potential import mapped_potential
from curricle.transfer.rollouts import greedy_rollouts
from curricle.transfer.transfer import Calibrate
from tests.tasks import predator_edges

HUNT, CHASE = cr.Pursuit(3, 2, time_limit=30), cr.Pursuit(3, 1, time_limit=30)
LOOP = cr.FiniteMDP.from_outcomes(
    [[[(1.0, 1, -1.0)], [(1.0, 0, -2.0)]], [[(1.0, 0, -1.5)], [(1.0, 1, -3.0)]]],
    terminal=[False, False], start=0, discount=1.0, time_limit=10,
)  # fmt: skip


def mapped(values, function):
    edges = predator_edges(HUNT, CHASE)
    return mapped_potential(HUNT, edges, values, function)


def partly_high():
    """Return two sources' values, the first with one of 50 where the other is low."""
    q = cr.solve(CHASE).action_values
    high = q.copy()
    high[CHASE.states.encode(prey=0, predator=1), 0] = 50.0
    return [high, q]


@pytest.mark.parametrize("function", [cr.minimum, cr.mean, cr.maximum, cr.total])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_calibration_does_not_depend_on_how_phi_is_stored(function, sign):
    """The highest of the sources' values, a bound of phi, refused what the array of it allowed."""
    lazy = mapped([sign * q for q in partly_high()], function)
    array = cr.StateActionPotential(HUNT, lazy.values)
    one, other = (fit_calibration(phi, Calibrate(50)) for phi in (lazy, array))
    assert str(one) == str(other)
    assert (one.scale, one.refusal) == (other.scale, other.refusal)
    np.testing.assert_array_equal(one.explained, other.explained)
    np.testing.assert_array_equal(one.potential.values, other.potential.values)


def test_a_fit_of_0_over_0_is_refused():
    equal = cr.StateActionPotential(LOOP, np.ones((2, 2)))  # ends at the value it began with
    with pytest.raises(CalibrationError, match=r"0 of which ended, leave the scale at 0 / 0"):
        cr.calibrate(equal)


@pytest.mark.parametrize("cap", [1, 9, 10, 11, 25, 10_000])
def test_rollouts_stop_at_their_most_steps(cap):
    phi = cr.StateActionPotential(LOOP, [[3.0, 1.0], [2.0, 1.0]])
    whole = greedy_rollouts(phi, episodes=5)
    found = greedy_rollouts(phi, episodes=5, max_steps=cap)
    n = min(cap, 50)
    assert len(found.states) == found.lengths.sum() == n
    np.testing.assert_array_equal(found.states, whole.states[:n])
    assert (found.lengths[:-1] == 10).all()
    assert not found.ended.any()
    if n % 10:  # phi of the state in which the last was cut, which is the next one met
        assert found.bootstrapped_value[-1] == phi.values[whole.states[n]].max()
    else:
        np.testing.assert_array_equal(found.return_to_go, whole.return_to_go[:n])


def test_rollouts_of_observations_stop_there_too():
    car = cr.observation_task("MountainCar-v0")
    push = FunctionValues(lambda cars, acts: np.sign(cars[:, 1:]) * (acts - 1.0), actions=3)
    phi = ObservationPotential.of(car, push)
    assert isinstance(phi.task, ObservationTask)
    whole = greedy_rollouts(phi, episodes=3)
    n = int(whole.lengths[0]) + 7
    found = greedy_rollouts(phi, episodes=3, max_steps=n)
    assert found.lengths.tolist() == [whole.lengths[0], 7]
    assert found.ended.tolist() == [True, False]
    np.testing.assert_array_equal(found.predicted, whole.predicted[:n])
    assert greedy_rollouts(phi, episodes=3, max_steps=10**6).lengths.tolist() == (
        whole.lengths.tolist()
    )


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
    edge = cr.Transfer(
        "chase", "hunt", cr.project(HUNT, CHASE, predator="predator_1"), calibrate=True
    )
    for budget in (400, cr.Episodes(100)):
        plan = cr.Curriculum(
            {"chase": CHASE, "hunt": HUNT}, [edge], budget={"chase": 5000, "hunt": budget}
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of seeds that are refused
            result = plan.train(2)
        for one in result.calibrations["hunt"]:
            assert one.steps <= 20 or one.episodes <= 5
            assert one.steps < result["hunt"].steps_used.max()


def test_taxi_is_compared_with_itself_calibrated_within_30_000_steps():
    taxi = cr.from_gymnasium("Taxi-v4", discount=0.99)
    edge = cr.Transfer("source", "taxi", cr.transfer.identity(taxi), calibrate=True)
    plan = cr.Curriculum(
        {"source": taxi, "taxi": taxi},
        [edge],
        budget={"source": 60_000, "taxi": 30_000},
        eval_freq=5_000,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of seeds that are refused
        found = cr.compare({"calibrated": plan}, seeds=2, controls=())
    assert list(found.arms) == ["scratch", "calibrated"]
