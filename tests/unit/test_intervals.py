"""Intervals over seeds, against SciPy and against numbers worked out by hand."""

from functools import partial

import numpy as np
import pytest
import scipy.stats

from curricle.errors import SettingError
from curricle.statistics.intervals import (
    Interval,
    interquartile_interval,
    interquartile_mean,
    mean_interval,
    paired_difference,
)
from tests.refusals import check_values

NAN, INF = np.nan, np.inf
BOTH = pytest.mark.parametrize("interval_of", [mean_interval, interquartile_interval])


def bounds(interval):
    return interval.low, interval.high


def normal(*shape, seed=7):
    return np.random.default_rng(seed).normal(size=shape)


# Interquartile mean


@pytest.mark.parametrize("seeds", range(1, 14))
def test_interquartile_mean_leaves_out_a_quarter_at_each_end(seeds):
    values = normal(seeds, 3)
    cut = seeds // 4
    expected = np.sort(values, axis=0)[cut : seeds - cut].mean(axis=0)
    np.testing.assert_allclose(interquartile_mean(values), expected)


# Student


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("seeds", [2, 3, 10])
def test_the_mean_has_the_interval_of_a_t_test(seeds, confidence):
    values = normal(seeds)
    expected = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(confidence)
    interval = mean_interval(values, confidence=confidence)
    assert bounds(interval) == pytest.approx((expected.low, expected.high), rel=1e-12)
    assert interval.estimate == pytest.approx(values.mean())
    assert (interval.confidence, interval.n) == (confidence, seeds)


def test_the_interquartile_interval_by_hand():
    # Left are 9, 10, 11, 14; with the ends moved inwards 9, 9, 10, 11, 14, 14, whose squared
    # deviations sum to 161 / 6. The error is sqrt(161 / 6 / (4 * 3)), with 3 degrees of freedom.
    interval = interquartile_interval([50.0, 9.0, 10.0, 1.0, 14.0, 11.0])
    half = scipy.stats.t.ppf(0.975, 3) * np.sqrt(161 / 6 / 12)
    assert interval.estimate == 11.0
    assert bounds(interval) == pytest.approx((11 - half, 11 + half), rel=1e-12)
    assert interval.n == 6


def test_nothing_trimmed_is_a_mean():
    values = normal(3, 4)
    plain, trimmed = mean_interval(values), interquartile_interval(values)
    np.testing.assert_allclose(bounds(trimmed), bounds(plain))


@pytest.mark.parametrize("seeds", [4, 8, 21])
def test_the_interquartile_interval_is_yuens(seeds):
    # Against a second sample without spread, Yuen's test is that of one trimmed mean.
    values, cut = normal(seeds) + 0.3, seeds // 4
    test = scipy.stats.ttest_ind(values, np.zeros(8) + 1e-9 * normal(8), trim=0.25, equal_var=False)
    interval = interquartile_interval(values)
    half = scipy.stats.t.ppf(0.975, seeds - 2 * cut - 1) * interval.estimate / test.statistic
    assert interval.high - interval.estimate == pytest.approx(half, rel=1e-6)


@BOTH
def test_each_checkpoint_has_the_interval_of_its_column(interval_of):
    values = normal(9, 4)
    single = [interval_of(column) for column in values.T]
    np.testing.assert_allclose(interval_of(values).low, [each.low for each in single])
    np.testing.assert_allclose(interval_of(values).high, [each.high for each in single])


@BOTH
def test_one_seed_has_no_interval(interval_of):
    scalar = interval_of([3.0])
    assert (scalar.estimate, scalar.n) == (3.0, 1)
    assert np.isnan(bounds(scalar)).all()
    assert np.isnan(interval_of([[1.0, 2.0]]).high).all()


@BOTH
@pytest.mark.parametrize("value", [0.0, 4.0, 0.1, -1e9])
def test_equal_seeds_have_no_interval_rather_than_one_without_width(value, interval_of):
    interval = interval_of(np.full(7, value))
    assert interval.estimate == pytest.approx(value)
    assert np.isnan(bounds(interval)).all()
    assert str(interval).endswith("7 seeds (no spread: no interval)")
    rounded = interval_of(np.full(7, value) * (1 + 1e-15 * np.arange(7)))
    assert np.isnan(bounds(rounded)).all()


def test_equal_middle_values_have_no_interquartile_interval():
    interval = interquartile_interval([-9.0, 4.0, 4.0, 4.0, 7.0])
    assert interval.estimate == 4.0
    assert np.isnan(bounds(interval)).all()


@BOTH
def test_a_nan_seed_makes_its_checkpoint_nan(interval_of):
    values = normal(6, 3)
    values[2, 0] = NAN
    interval = interval_of(values)
    for numbers in (interval.estimate, *bounds(interval)):
        assert np.isnan(numbers).tolist() == [True, False, False]


@BOTH
def test_an_interval_refuses(interval_of):
    wrong = {"values": [[], np.zeros((2, 2, 2)), [1.0, INF]]}
    check_values(SettingError, interval_of, wrong)
    check_values(SettingError, partial(interval_of, [1.0, 2.0]), {"confidence": [1.0, 95]})


# Paired difference


def test_paired_difference_cancels_what_the_seed_gives_to_both():
    a, b = normal(20, seed=1), normal(20, seed=2)
    common = 100 * normal(20)
    np.testing.assert_allclose(
        bounds(paired_difference(common + a, common + b)), bounds(paired_difference(a, b))
    )


def test_differences_equal_but_for_rounding_have_no_interval():
    seeds = 100 * normal(20)
    interval = paired_difference(seeds + 3.0, seeds)
    assert interval.estimate == pytest.approx(3.0)
    assert np.isnan(bounds(interval)).all()
    assert interval.n == 20


@pytest.mark.parametrize(("a", "b"), [([1.0], [1.0, 2.0]), ([[1.0]], [[1.0]])])
def test_paired_difference_refuses_arms_that_do_not_match(a, b):
    with pytest.raises(SettingError, match="a and b must both have shape"):
        paired_difference(a, b)


# Printing


@pytest.mark.parametrize(
    ("numbers", "n", "text"),
    [
        ((27412.0, 25100.4, 29950.0), 30, "27,412 [25,100, 29,950], 30 seeds"),
        ((-0.001, -0.02, 0.01), 5, "-0.0010 [-0.0200, 0.0100], 5 seeds"),
        ((118.02, 117.99, 118.04), 5, "118.02 [117.99, 118.04], 5 seeds"),
        ((3.0, NAN, NAN), 5, "3.00, 5 seeds (no spread: no interval)"),
        ((3.0, NAN, NAN), 1, "3.00, 1 seed (no interval)"),
        ((1200.4, -INF, 1300.0), 9, "1,200 [-inf, 1,300], 9 seeds"),
    ],
)
def test_interval_prints(numbers, n, text):
    assert str(Interval(*numbers, confidence=0.95, n=n)) == text
