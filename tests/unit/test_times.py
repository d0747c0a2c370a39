"""Times to a threshold with censored seeds, against naive code and numbers worked out by hand."""

import numpy as np
import pytest

from curricle.errors import SettingError
from curricle.statistics.intervals import mean_interval
from curricle.statistics.thresholds import Times
from tests.refusals import check_values

INF = np.inf


def times(*steps):
    """Times of these steps; a negative one was left there without having arrived."""
    return Times(np.abs(steps), np.array(steps) >= 0)


def random_times(seed, seeds=12):
    """Times with ties among arrivals and censored seeds, some of them early."""
    rng = np.random.default_rng(seed)
    return Times(rng.integers(1, 9, seeds).astype(float), rng.random(seeds) < 0.6)


def numbers(interval):
    return (interval.estimate, interval.low, interval.high)


# Kaplan-Meier


def test_curve_by_hand():
    # 4 of 5 remain after 10; the seed censored at 20 was followed until then; 2 of 3 remain after
    # 20; the last arrives at 40 when it alone is followed.
    curve = times(10.0, 20.0, -20.0, -30.0, 40.0).survival()
    assert curve.quantiles.tolist() == [10.0, 20.0, 30.0, 40.0]
    assert curve.probabilities == pytest.approx([4 / 5, 3 / 5, 3 / 5, 0.0])
    curve = times(3.0, 1.0, 3.0, 0.0).survival()
    assert curve.quantiles.tolist() == [0.0, 1.0, 3.0]
    assert curve.probabilities == pytest.approx([0.75, 0.5, 0.0])
    curve = times(-5.0, -5.0).survival()
    assert (curve.quantiles.tolist(), curve.probabilities.tolist()) == ([5.0], [1.0])


@pytest.mark.parametrize("seed", range(20))
def test_curve_is_the_product_over_the_arrivals(seed):
    sample = random_times(seed)
    curve = sample.survival()
    for steps, share in zip(curve.quantiles, curve.probabilities, strict=True):
        expected = 1.0
        for t in np.unique(sample.steps[sample.steps <= steps]):
            followed = np.sum(sample.steps >= t)
            expected *= 1 - np.sum(sample.reached & (sample.steps == t)) / followed
        assert share == pytest.approx(expected, abs=1e-12)


# Median


@pytest.mark.parametrize(
    ("steps", "median"),
    [
        ([10.0, 20.0, 30.0], 20.0),
        ([10.0, 20.0, 30.0, 40.0], 20.0),  # the first time at which half have arrived
        ([10.0, 20.0, -30.0, -30.0], 20.0),
        ([10.0, -30.0, -30.0], INF),
        ([-30.0], INF),
        ([0.0, 0.0, -5.0], 0.0),
        ([-10.0, 20.0, 30.0, 40.0], 30.0),  # 1, 2/3, 1/3, 0
        ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0], 7.0),
    ],
)
def test_median_by_hand(steps, median):
    assert times(*steps).median().estimate == median


def test_medians_bounds_by_hand():
    # The median of six lies outside of all six with chance 2 / 64; of eight, outside of the second
    # to the seventh with chance 18 / 256.
    six = times(10.0, 20.0, 30.0, 40.0, 50.0, -50.0)
    assert numbers(six.median()) == (30.0, 10.0, INF)
    eight = times(10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
    assert numbers(eight.median(confidence=0.93)) == (40.0, 10.0, 80.0)
    assert numbers(eight.median(confidence=0.92)) == (40.0, 20.0, 70.0)
    assert numbers(times(10.0, 20.0, 30.0, 40.0, 50.0).median()) == (30.0, 0.0, INF)
    early = times(-5.0, *[100.0 + k for k in range(7)])
    assert numbers(early.median()) == (103.0, 5.0, INF)


# Restricted mean


def test_restricted_mean_by_hand():
    sample = times(200.0, 400.0, -900.0, -600.0)
    assert sample.restricted_mean(600.0).estimate == 450.0
    assert sample.restricted_mean(300.0).estimate == 275.0
    assert times(10.0, 50.0).restricted_mean(1000.0).estimate == 30.0
    assert sample.restricted_mean().estimate == 525.0  # each for as long as it was followed
    sample = times(200.0, 400.0, -900.0, 500.0)
    plain = mean_interval([200.0, 400.0, 450.0, 450.0])
    assert numbers(sample.restricted_mean(450.0)) == (plain.estimate, plain.low, 450.0)
    mean = times(200.0, 400.0, -900.0).restricted_mean()
    plain = mean_interval([200.0, 400.0, 900.0])
    assert numbers(mean) == (500.0, max(plain.low, 0.0), INF)
    assert np.isnan(numbers(times(-900.0, -900.0).restricted_mean())[1:]).all()
    assert numbers(times(10.0, 900.0).restricted_mean(1000.0)) == (455.0, 0.0, 1000.0)


@pytest.mark.parametrize("seed", range(10))
def test_restricted_mean_is_the_area_under_the_curve(seed):
    sample = random_times(seed)
    left = sample.steps[~sample.reached]
    horizon = float(left.min()) if left.size else 7.0
    curve = sample.survival()
    edges = np.clip(np.concatenate([[0.0], curve.quantiles, [np.inf]]), 0.0, horizon)
    area = np.sum(np.diff(edges) * np.append(1.0, curve.probabilities))
    assert sample.restricted_mean(horizon).estimate == pytest.approx(area)


def test_wrong_values_are_named():
    sample = times(200.0, -900.0, -600.0)
    wrong = {"horizon": [0.0, -5, INF, "far", 601.0], "confidence": [95]}
    check_values(SettingError, sample.restricted_mean, wrong)
    check_values(SettingError, sample.median, {"confidence": [95]})
