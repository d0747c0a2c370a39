"""Intervals over seeds, against SciPy and against numbers worked out by hand."""

import time
import tracemalloc

import numpy as np
import pytest
import scipy.stats

from curricle.errors import SettingError
from curricle.statistics.intervals import (
    Interval,
    bootstrap,
    interquartile_mean,
    paired_difference,
    stratified_bootstrap,
)

NAN, INF = np.nan, np.inf


def normal(*shape, seed=7):
    return np.random.default_rng(seed).normal(size=shape)


# Interquartile mean


@pytest.mark.parametrize("seeds", range(1, 14))
def test_interquartile_mean_leaves_out_a_quarter_at_each_end(seeds):
    values = normal(seeds, 3)
    cut = seeds // 4
    expected = np.sort(values, axis=0)[cut : seeds - cut].mean(axis=0)
    np.testing.assert_allclose(interquartile_mean(values), expected)
    np.testing.assert_allclose(interquartile_mean(values.T, axis=1), expected)


def test_interquartile_mean_by_hand():
    assert interquartile_mean([100.0, 0.0, 2.0, 4.0]) == 3.0
    assert interquartile_mean([1.0, 2.0, 6.0]) == 3.0  # floor(3 / 4) = 0: nothing trimmed
    assert isinstance(interquartile_mean([1, 2]), float)


def test_interquartile_mean_does_not_trim_nan_away():
    assert np.isnan(interquartile_mean([1.0, 2.0, 3.0, NAN]))


def test_interquartile_mean_refuses_no_seeds():
    with pytest.raises(SettingError, match="at least 1 seed"):
        interquartile_mean([])


# Bootstrap


def test_bootstrap_of_two_seeds_by_hand():
    # Resample means are 0, 1, 2 with chances 1/4, 1/2, 1/4.
    interval = bootstrap([0.0, 2.0], confidence=0.95)
    assert (interval.estimate, interval.low, interval.high) == (1.0, 0.0, 2.0)
    half = bootstrap([0.0, 2.0], confidence=0.3)
    assert (half.low, half.high) == (1.0, 1.0)


@pytest.mark.parametrize("statistic", [np.mean, np.median, interquartile_mean])
def test_bootstrap_agrees_with_scipy(statistic):
    # Both draw 20,000 resamples, so a bound differs by about 1 % of the interval's width.
    values = normal(25)
    ours = bootstrap(values, statistic, resamples=20_000)
    theirs = scipy.stats.bootstrap(
        (values,),
        lambda x, axis: np.apply_along_axis(statistic, axis, x),
        n_resamples=20_000,
        method="percentile",
        rng=np.random.default_rng(3),
    ).confidence_interval
    width = theirs.high - theirs.low
    assert ours.estimate == pytest.approx(float(statistic(values, axis=0)))
    assert ours.low == pytest.approx(theirs.low, abs=0.06 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.06 * width)


def test_the_fast_mean_equals_the_general_path():
    values = normal(12, 5)
    fast = bootstrap(values)
    general = bootstrap(values, lambda x, axis: np.mean(x, axis=axis))
    np.testing.assert_allclose(fast.low, general.low, atol=1e-14)
    np.testing.assert_allclose(fast.high, general.high, atol=1e-14)


def test_chunks_do_not_change_the_result(monkeypatch):
    values = normal(12, 5)
    whole = bootstrap(values, np.median, resamples=101)
    monkeypatch.setattr("curricle.statistics.intervals.CHUNK", 7)
    assert np.array_equal(bootstrap(values, np.median, resamples=101).low, whole.low)


def test_checkpoints_share_their_draws():
    values = normal(9)
    curve = bootstrap(np.column_stack([values, values + 1.0]))
    single = bootstrap(values)
    np.testing.assert_allclose(curve.low, [single.low, single.low + 1.0])
    np.testing.assert_allclose(curve.high, [single.high, single.high + 1.0])


def test_equal_seeds_agree_and_different_seeds_differ():
    values = normal(9)
    assert bootstrap(values, seed=1).low == bootstrap(values, seed=1).low
    assert bootstrap(values, seed=1).low != bootstrap(values, seed=2).low


def test_one_seed_has_no_interval():
    scalar = bootstrap([3.0])
    assert (scalar.estimate, scalar.n) == (3.0, 1)
    assert np.isnan([scalar.low, scalar.high]).all()
    assert np.isnan(bootstrap([[1.0, 2.0]]).high).all()


def test_a_nan_seed_makes_its_checkpoint_nan():
    values = normal(6, 3)
    values[2, 0] = NAN
    interval = bootstrap(values)
    for numbers in (interval.estimate, interval.low, interval.high):
        assert np.isnan(numbers).tolist() == [True, False, False]
    robust = bootstrap(values, interquartile_mean)
    assert np.isnan(robust.low).tolist() == [True, False, False]


def test_nanmean_takes_the_seeds_that_measured():
    interval = bootstrap([NAN, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0], np.nanmean)
    assert (interval.estimate, interval.low, interval.high) == (4.0, 4.0, 4.0)


def test_results_are_floats_or_frozen_arrays():
    assert isinstance(bootstrap([1.0, 2.0]).low, float)
    curve = bootstrap(normal(4, 3))
    for numbers in (curve.estimate, curve.low, curve.high):
        assert numbers.shape == (3,)
        assert not numbers.flags.writeable


def test_bootstrap_leaves_its_argument_alone():
    values = normal(4, 3)
    before = values.copy()
    bootstrap(values)
    assert np.array_equal(values, before)
    assert values.flags.writeable


@pytest.mark.parametrize(
    ("values", "settings", "message"),
    [
        ([], {}, r"shape \(K,\) or \(K, T\), neither 0: got \(0,\)"),
        (np.zeros((2, 2, 2)), {}, r"got \(2, 2, 2\)"),
        ([1.0, np.inf], {}, "values must not be infinite: got inf"),
        ([1.0, 2.0], {"confidence": 1.0}, "confidence must be between 0 and 1: got 1.0"),
        ([1.0, 2.0], {"confidence": 95}, "confidence must be between 0 and 1: got 95"),
        ([1.0, 2.0], {"resamples": 0}, "resamples must be a whole number, at least 1: got 0"),
        ([1.0, 2.0], {"resamples": 1.5}, "resamples must be a whole number"),
        ([1.0, 2.0], {"statistic": np.cumsum}, "one number per column: got shape"),
    ],
)
def test_bootstrap_refuses(values, settings, message):
    with pytest.raises(SettingError, match=message):
        bootstrap(values, **settings)


def test_a_long_curve_is_quick_and_small():
    values = normal(100, 1000)
    bootstrap(values[:2])
    start = time.perf_counter()
    bootstrap(values)
    assert time.perf_counter() - start < 3.0  # about 0.1 s on a laptop; loose for a busy machine
    tracemalloc.start()
    bootstrap(values)
    mean_peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    bootstrap(values, np.median, resamples=200)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert max(mean_peak, peak) < 200e6


@pytest.mark.slow
def test_coverage_of_the_mean_of_thirty_normal_seeds():
    """Covers about 93.3 %: of 2,000 studies 1,866 +- 11, so [0.91, 0.96] is 4 deviations wide.

    False-alarm rate over random seeds below 1 in 10,000; the seed is fixed.
    """
    rng = np.random.default_rng(2024)
    studies = 2000
    intervals = [bootstrap(rng.normal(size=30), resamples=1000, seed=k) for k in range(studies)]
    covered = np.mean([each.low <= 0.0 <= each.high for each in intervals])
    assert 0.91 <= covered <= 0.96


# Paired difference


def test_paired_difference_cancels_what_the_seed_gives_to_both():
    seeds = 100 * normal(20)
    interval = paired_difference(seeds + 3.0, seeds)
    assert interval.estimate == pytest.approx(3.0)
    assert interval.high - interval.low < 1e-9
    assert interval.n == 20


def test_paired_difference_is_the_bootstrap_of_the_differences():
    a, b = normal(8, seed=1), normal(8, seed=2)
    paired, scratch = paired_difference(a, b, seed=5), bootstrap(a - b, seed=5)
    assert (paired.estimate, paired.low, paired.high) == (
        scratch.estimate,
        scratch.low,
        scratch.high,
    )


def test_paired_difference_changes_sign_with_its_arms():
    a, b = normal(8, seed=1), normal(8, seed=2)
    there, back = paired_difference(a, b), paired_difference(b, a)
    assert there.low == pytest.approx(-back.high)
    assert there.high == pytest.approx(-back.low)


def test_paired_difference_with_nan_is_nan():
    interval = paired_difference([1.0, NAN], [0.0, 0.0])
    assert np.isnan([interval.estimate, interval.low, interval.high]).all()


@pytest.mark.parametrize(("a", "b"), [([1.0], [1.0, 2.0]), ([[1.0]], [[1.0]])])
def test_paired_difference_refuses_arms_that_do_not_match(a, b):
    with pytest.raises(SettingError, match="a and b must both have shape"):
        paired_difference(a, b)


# Printing


@pytest.mark.parametrize(
    ("numbers", "n", "text"),
    [
        ((11.04, 9.82, 12.13), 30, "11.0 [9.8, 12.1], 30 seeds"),
        ((27412.0, 25100.4, 29950.0), 30, "27,412 [25,100, 29,950], 30 seeds"),
        ((-0.001, -0.02, 0.01), 5, "-0.0010 [-0.0200, 0.0100], 5 seeds"),
        ((-0.01, -12.0, 12.0), 5, "0.0 [-12.0, 12.0], 5 seeds"),
        ((0.0, 0.0, 0.0), 2, "0.0 [0.0, 0.0], 2 seeds"),
        ((3.0, NAN, NAN), 1, "3.00, 1 seed (no interval)"),
        ((NAN, NAN, NAN), 4, "nan, 4 seeds"),
    ],
)
def test_interval_prints(numbers, n, text):
    assert str(Interval(*numbers, confidence=0.95, n=n)) == text


def test_interval_of_a_curve_prints_its_ends():
    rows = [np.array([1.0, 5.0, 11.0]), np.array([0.5, 4.0, 9.8]), np.array([1.5, 6.0, 12.1])]
    text = "3 values, first 1.00 [0.50, 1.50], last 11.0 [9.8, 12.1], 30 seeds"
    assert str(Interval(*rows, confidence=0.95, n=30)) == text


# Several tasks


def test_stratified_bootstrap_of_two_tasks_by_hand():
    # The mean of all four is the lowest, 10, or the highest, 12, with chance 1/16 each.
    scores = np.array([[0.0, 20.0], [2.0, 22.0]])
    interval = stratified_bootstrap(scores, np.mean)
    assert (interval.estimate, interval.low, interval.high) == (11.0, 10.0, 12.0)
    assert interval.n == 2


def test_the_statistic_sees_all_runs_at_once():
    scores = np.array([[0.0, 4.0], [2.0, 100.0]])
    assert stratified_bootstrap(scores).estimate == 3.0
    assert stratified_bootstrap([[0.0, 2.0, 4.0], [100.0]]).estimate == 3.0


@pytest.mark.parametrize("statistic", [np.mean, interquartile_mean])
def test_one_stratum_agrees_with_scipy(statistic):
    values = normal(25)
    ours = stratified_bootstrap(values[:, np.newaxis], statistic, resamples=20_000)
    theirs = scipy.stats.bootstrap(
        (values,),
        statistic,
        n_resamples=20_000,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(3),
    ).confidence_interval
    width = theirs.high - theirs.low
    assert ours.low == pytest.approx(theirs.low, abs=0.06 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.06 * width)


def test_tasks_that_differ_do_not_widen_the_interval():
    tasks = 100 * np.arange(4) + normal(10, 4)
    near = stratified_bootstrap(tasks, np.mean)
    pooled = bootstrap(tasks.ravel())
    assert near.high - near.low < 1.0 < 50.0 < pooled.high - pooled.low


def test_stratified_mean_has_the_standard_error_of_strata():
    # The mean of M independent means: variances add. 20,000 resamples tell a width to about 2 %.
    tasks = [normal(8, seed=1), 3 * normal(20, seed=2), normal(40, seed=3)]
    interval = stratified_bootstrap(tasks, np.mean, resamples=20_000)
    error = np.sqrt(sum(len(task) * np.var(task) for task in tasks)) / 68
    assert interval.high - interval.low == pytest.approx(2 * 1.96 * error, rel=0.05)
    assert interval.n == 8


def test_a_task_with_one_seed_leaves_no_interval():
    interval = stratified_bootstrap([[1.0, 2.0, 3.0], [5.0]], np.mean)
    assert (interval.estimate, interval.n) == (2.75, 1)
    assert np.isnan([interval.low, interval.high]).all()


def test_stratified_bootstrap_hides_no_nan():
    interval = stratified_bootstrap(np.array([[1.0, NAN], [2.0, 3.0], [4.0, 5.0]]))
    assert np.isnan([interval.estimate, interval.low, interval.high]).all()


@pytest.mark.parametrize(
    ("scores", "settings", "message"),
    [
        ([], {}, r"scores must have shape \(K, M\), neither 0, .*: got \[\(0,\)\]"),
        (np.zeros((3, 0)), {}, r"or be one array \(K,\) per task: got \[\]"),
        ([[1.0], [[1.0]]], {}, r"got \[\(1,\), \(1, 1\)\]"),
        ([[1.0], None], {}, "scores must be an array of numbers: got None"),
        (np.array([[1.0, INF]]), {}, "values must not be infinite: got inf"),
        ([1.0, 2.0], {"statistic": np.cumsum}, "one number per column: got shape"),
        ([1.0, 2.0], {"confidence": 0.0}, "confidence must be between 0 and 1: got 0.0"),
        ([1.0, 2.0], {"resamples": -1}, "resamples must be a whole number, at least 1: got -1"),
    ],
)
def test_stratified_bootstrap_refuses(scores, settings, message):
    with pytest.raises(SettingError, match=message):
        stratified_bootstrap(scores, **settings)


# Printing what is infinite


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((INF, 1200.4, INF), "inf [1,200, inf], 9 seeds"),
        ((1200.4, -INF, 1300.0), "1,200 [-inf, 1,300], 9 seeds"),
        ((INF, INF, INF), "inf [inf, inf], 9 seeds"),
    ],
)
def test_an_infinite_bound_prints(numbers, text):
    assert str(Interval(*numbers, confidence=0.95, n=9)) == text
