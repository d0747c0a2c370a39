"""Intervals and tests over seeds, against SciPy, naive code and numbers worked out by hand."""

from functools import partial

import numpy as np
import pytest
import scipy.stats

from curricle.errors import SettingError
from curricle.statistics.hypothesis_tests import (
    holm,
    performance_profile,
    probability_of_improvement,
    sign_flip_test,
)
from curricle.statistics.intervals import (
    Interval,
    interquartile_interval,
    mean_interval,
    paired_difference,
)
from tests.support.refusals import check_values

NAN, INF = np.nan, np.inf
BOTH = pytest.mark.parametrize("interval_of", [mean_interval, interquartile_interval])


def bounds(interval):
    return interval.low, interval.high


def normal(*shape, seed=7):
    return np.random.default_rng(seed).normal(size=shape)


@pytest.mark.parametrize("seeds", range(1, 14))
def test_interquartile_mean_leaves_out_a_quarter_at_each_end(seeds):
    values = normal(seeds, 3)
    cut = seeds // 4
    expected = np.sort(values, axis=0)[cut : seeds - cut].mean(axis=0)
    np.testing.assert_allclose(interquartile_interval(values).estimate, expected)


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("seeds", [2, 3, 10])
def test_the_mean_has_the_interval_of_a_t_test(seeds, confidence):
    values = normal(seeds)
    expected = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(confidence)
    interval = mean_interval(values, confidence=confidence)
    assert bounds(interval) == pytest.approx((expected.low, expected.high), rel=1e-12)
    assert interval.estimate == pytest.approx(values.mean())
    assert (interval.confidence, interval.n) == (confidence, seeds)


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
    np.testing.assert_allclose(interval_of(values).low, [column.low for column in single])
    np.testing.assert_allclose(interval_of(values).high, [column.high for column in single])


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


def test_profile_by_hand():
    profile = performance_profile([0.1, 0.5, 0.5, 0.9], [0.0, 0.5, 0.9])
    assert profile.estimate.tolist() == [1.0, 0.25, 0.0]
    assert profile.n == 4
    profile = performance_profile([1.0], [0.5])
    assert profile.estimate.tolist() == [1.0]
    assert np.isnan(bounds(profile)).all()
    assert performance_profile([-INF, 0.0, INF], [-INF, 0.0]).estimate.tolist() == [2 / 3, 1 / 3]
    profile = performance_profile([NAN, 1.0, 2.0], [0.0, 1.5])
    assert np.isnan([profile.estimate, profile.low, profile.high]).all()


@pytest.mark.parametrize("confidence", [0.5, 0.95])
@pytest.mark.parametrize("above", [0, 1, 4, 9])
def test_profile_has_wilsons_interval(above, confidence):
    profile = performance_profile([1.0] * above + [0.0] * (9 - above), [0.5], confidence=confidence)
    expected = scipy.stats.binomtest(above, 9).proportion_ci(confidence, method="wilson")
    assert bounds(profile) == (pytest.approx([expected.low]), pytest.approx([expected.high]))
    assert profile.high[0] - profile.low[0] > 0.04


def test_improvement_by_hand():
    assert probability_of_improvement([1.0, 3.0], [2.0]).estimate == 0.5
    assert probability_of_improvement([1.0, 2.0], [2.0, 3.0]).estimate == 0.125
    assert probability_of_improvement([INF, INF], [0.0, INF]).estimate == 0.75
    interval = probability_of_improvement([NAN, 9.0, 9.0], [1.0, 2.0])
    assert np.isnan([interval.estimate, *bounds(interval)]).all()
    single = probability_of_improvement([1.5], [1.0, 2.0])
    assert single.estimate == 0.5
    assert np.isnan(bounds(single)).all()


@pytest.mark.parametrize("digits", [1, 16])  # the first makes ties
def test_improvement_is_mann_whitneys_u_per_pair(digits):
    a, b = normal(13, seed=1).round(digits), normal(8, seed=2).round(digits)
    expected = scipy.stats.mannwhitneyu(a, b).statistic / (13 * 8)
    assert probability_of_improvement(a, b).estimate == pytest.approx(expected)


@pytest.mark.parametrize("sizes", [(2, 3), (7, 7), (5, 20)])
def test_improvements_bounds_are_where_newcombes_score_is_z(sizes):
    n_a, n_b = sizes
    interval = probability_of_improvement(normal(n_a, seed=1) + 0.3, normal(n_b, seed=2))
    for p in bounds(interval):
        between = (1 - p) / (2 - p) + p / (1 + p)
        variance = p * (1 - p) * (1 + ((n_a + n_b) / 2 - 1) * between) / (n_a * n_b)
        assert abs(interval.estimate - p) == pytest.approx(1.959964 * np.sqrt(variance), rel=1e-5)


@pytest.mark.parametrize(("seeds", "low"), [(3, 0.501), (5, 0.643), (50, 0.960)])
def test_improvement_without_overlap_still_has_a_width(seeds, low):
    ahead, behind = np.arange(seeds) + 100.0, np.arange(seeds)
    interval = probability_of_improvement(ahead, behind)
    assert (interval.estimate, interval.high, interval.n) == (1.0, 1.0, seeds)
    assert interval.low == pytest.approx(low, abs=1e-3)
    back = probability_of_improvement(behind, ahead)
    assert (back.low, back.high) == (0.0, pytest.approx(1 - low, abs=1e-3))


def test_sign_flips_by_hand():
    # Of (+-1 +-2 +-3) only +6 and -6 are as far out as 6.
    assert sign_flip_test([1.0, 2.0, 3.0]) == 2 / 8
    assert sign_flip_test(np.zeros(50), resamples=20) == 1.0
    for seeds in (5, 14):
        assert sign_flip_test(np.arange(1.0, seeds + 1)) == 2.0 ** (1 - seeds)
    assert sign_flip_test(np.arange(1.0, 41.0), resamples=999) == 1 / 1000


def exact_p(differences):
    """The p-value of all 2^K sign vectors, with sums that are equal but for rounding."""
    sums = np.zeros(1)
    for difference in differences:
        sums = np.concatenate([sums - difference, sums + difference])
    slack = 1e-12 * np.abs(differences).sum()
    return np.mean(np.abs(sums) >= abs(differences.sum()) - slack)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
@pytest.mark.parametrize("digits", [0, 1, 16])  # the first two make ties and zeros
@pytest.mark.parametrize("seeds", [1, 2, 5, 10, 14])
def test_all_signs_are_counted(seeds, digits, unit):
    differences = unit * (normal(seeds) + 0.4).round(digits)
    assert sign_flip_test(differences) == exact_p(differences)


def test_random_signs_follow_the_seed():
    differences = normal(20)
    first, same, other = (sign_flip_test(differences, resamples=500, seed=s) for s in (1, 1, 2))
    assert first == same != other


WRONG = {
    partial(performance_profile, thresholds=[0.0]): {"scores": [[], ["good"]]},
    partial(performance_profile, [1.0]): {"thresholds": [0.5, [0.5, NAN]]},
    partial(performance_profile, [1.0], [0.5]): {"confidence": [0]},
    partial(probability_of_improvement, b=[1.0]): {"a": [[]]},
    partial(probability_of_improvement, [1.0]): {"b": [[[1.0]], "b"]},
    partial(probability_of_improvement, [1.0], [1.0]): {"confidence": [1.5]},
    sign_flip_test: {"differences": [[], [1.0, NAN], ["x"]]},
    partial(sign_flip_test, [1.0]): {"resamples": [0]},
}


@pytest.mark.parametrize("call", WRONG, ids=lambda call: getattr(call, "func", call).__name__)
def test_wrong_values_are_named(call):
    check_values(SettingError, call, WRONG[call])


@pytest.mark.parametrize("p_values", [[], [0.5, 1.5], [NAN], ["low"]])
def test_holm_refuses(p_values):
    with pytest.raises(SettingError, match="p-values must"):
        holm(p_values)
