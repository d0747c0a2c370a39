"""Learning curves, measures of transfer and times to a threshold, checked by hand."""

from functools import partial

import numpy as np
import pytest

from curricle.errors import SettingError
from curricle.statistics import (
    Curve,
    asymptotic_performance,
    jumpstart,
    mean_return,
    time_to_threshold,
)
from curricle.statistics.curves import Times, charge_source, fraction_of_optimum, midpoint, smooth
from curricle.statistics.intervals import mean_interval
from tests.support.refusals import check_values

NAN, INF = np.nan, np.inf
STEPS = np.array([0, 100, 200, 300, 400])


def curve(*rows, steps=STEPS, source=0):
    return Curve(steps, np.array(rows, dtype=float), np.array(source))


SCRATCH = curve([0, 1, 2, 3, 4], [0, 0, 0, 0, 4])
HELPED = curve([2, 3, 4, 4, 4], [2, 2, 2, 2, 2], source=[150, 200])


@pytest.mark.parametrize(
    ("steps", "values", "source", "message"),
    [
        ([0.0, 1.0], [[1, 2]], 0, "steps must be integers: got dtype float64"),
        ([[0]], [[1]], 0, r"steps must have shape \(T,\) with T at least 1: got \(1, 1\)"),
        ([0, 5, 5], [[1, 2, 3]], 0, "steps must be increasing: checkpoint 2 is 5 after 5"),
        ([-1, 0], [[1, 2]], 0, "steps must be at least 0: checkpoint 0 is -1"),
        ([0, 1], [[1, 2, 3]], 0, r"shape \(K, 2\) with K at least 1: got \(1, 3\)"),
        ([0, 1], [[1, np.inf]], 0, "not be infinite: seed 0, checkpoint 1 is inf"),
        ([0, 1, 2], [[1, NAN, 2]], 0, "first measurement: seed 0, checkpoint 1 is nan"),
        ([0, 1], [[1, 2]], [1, 2], r"source_steps must have shape \(1,\), one per seed"),
        ([0, 1], [[1, 2]], -3, "source_steps must be at least 0: got -3"),
    ],
)
def test_curve_refuses(steps, values, source, message):
    with pytest.raises(SettingError, match=message):
        Curve(np.array(steps), np.array(values, dtype=float), np.array(source))


def test_midpoint_is_taken_on_the_smoothed_mean_over_seeds():
    made = curve([0, 8, 0, 4, 4], [0, 8, 0, 0, 8])  # mean 0 8 0 2 6
    assert midpoint(made) == 4.0
    assert midpoint(made, window=2) == 2.0  # 0 4 4 1 4
    assert midpoint(curve([NAN, 2, 4], [0, 0, 0], steps=[0, 1, 2])) == 1.5


def test_time_is_the_first_checkpoint_at_or_above_the_threshold():
    times = time_to_threshold(curve([0, 1, 0, 3, 4], [5, 0, 0, 0, 0]), 1.0)
    assert times.steps.tolist() == [100, 0]
    assert times.reached.all()
    assert time_to_threshold(curve([0, 0, 0, 0, 1]), 1.0).reached.all()
    assert time_to_threshold(curve([0, 4, 4, 4, 4]), 4.0, window=3).steps.tolist() == [300]
    assert time_to_threshold(curve([NAN, NAN, 4, 4, 4]), 1.0).steps.tolist() == [200]
    made = Curve(np.arange(50), np.full((1, 50), 0.1))
    assert time_to_threshold(made, 0.1, window=10).steps.tolist() == [0]
    assert smooth(made.values, 10).min() == 0.1


def test_the_jumpstart_is_paired_by_seed():
    assert jumpstart(SCRATCH, HELPED).tolist() == [2, 2]


def test_charge_source_by_hand():
    charged = charge_source(SCRATCH, HELPED)
    np.testing.assert_allclose(charged.values, [[0, 0, 2.5, 3.5, 4], [0, 0, 2, 2, 2]])
    assert charged.source_steps.tolist() == [0, 0]
    assert charged.steps.tolist() == STEPS.tolist()
    for steps, scratch, helped, source, expected in (
        (STEPS, [1, 2, 3, 4, 5], [9, 9, 9, 9, 9], 1000, [1, 1, 1, 1, 1]),
        (STEPS[1:4], [1, 2, 3], [7, 8, 9], 100, [1, 7, 8]),
        (STEPS, [NAN, 1, 2, 3, 4], [NAN, 5, 6, 7, 8], 100, [1, 5, 5, 6, 7]),
    ):
        given = curve(scratch, steps=steps), curve(helped, steps=steps, source=source)
        assert charge_source(*given).values.tolist() == [expected]


def test_asymptotic_performance_is_the_mean_of_the_last_checkpoints():
    assert asymptotic_performance(SCRATCH).tolist() == [4, 4]
    helped = curve([0, 1, 2, 3, 4], source=100)
    assert asymptotic_performance(charge_source(curve([0, 0, 0, 0, 0]), helped)).tolist() == [3]


def test_total_reward_is_the_mean_height_with_uneven_checkpoints():
    assert mean_return(SCRATCH).tolist() == [2, 0.5]
    assert mean_return(curve([0, 4, 4], steps=[100, 200, 500])).tolist() == [3.5]
    assert mean_return(curve([NAN, 4, 4], steps=[0, 1, 2])).tolist() == [4]


def test_measures_refuse_wrong_values():
    check_values(SettingError, partial(smooth, np.zeros((2, 3))), {"window": [0, 4, 1.5, NAN]})
    check_values(SettingError, partial(time_to_threshold, SCRATCH), {"threshold": [NAN, np.inf]})
    check_values(SettingError, partial(fraction_of_optimum, 1.0, 0.0), {"fraction": [1.1, NAN]})
    check_values(SettingError, partial(fraction_of_optimum, 0.0, fraction=0.5), {"worst": [1.0]})
    steps = [np.array(wrong) for wrong in ([1.0], [NAN, 1], [-1.0, 1])]
    check_values(SettingError, partial(Times, reached=np.array([True, True])), {"steps": steps})
    with pytest.raises(SettingError, match="an area needs at least 2 checkpoints: got 1"):
        mean_return(curve([1], steps=[0]))


@pytest.mark.parametrize(
    "measure",
    [jumpstart, charge_source],
)
def test_curves_must_pair(measure):
    with pytest.raises(SettingError, match="same seeds, row by row: got 2 and 1 seeds"):
        measure(SCRATCH, curve([0, 1, 2, 3, 4]))
    with pytest.raises(SettingError, match="got 5 ending at 400 and 2 ending at 100"):
        measure(SCRATCH, curve([0, 1], [0, 1], steps=[0, 100]))


def test_a_strong_comparison_needs_a_baseline_without_source_steps():
    with pytest.raises(SettingError, match="must have no source steps: got 200"):
        charge_source(HELPED, SCRATCH)
    assert np.isfinite(jumpstart(HELPED, SCRATCH)).all()


def times(*steps):
    """Times of these steps; a negative one was left there without having arrived."""
    return Times(np.abs(steps), np.array(steps) >= 0)


def numbers(interval):
    return (interval.estimate, interval.low, interval.high)


def test_restricted_mean_by_hand():
    assert times(200.0, 400.0, -900.0, -600.0).restricted_mean().estimate == 525.0
    mean = times(200.0, 400.0, -900.0).restricted_mean()
    plain = mean_interval([200.0, 400.0, 900.0])
    assert numbers(mean) == (500.0, max(plain.low, 0.0), INF)
    assert np.isnan(numbers(times(-900.0, -900.0).restricted_mean())[1:]).all()
