"""Profiles, tests and their correction, against SciPy, naive code and numbers found by hand."""

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
from tests.refusals import check_values
from tests.unit.test_intervals import bounds, normal

NAN, INF = np.nan, np.inf


# Performance profile


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


# Probability of improvement


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


# Sign flips


def test_sign_flips_by_hand():
    # Of (+-1 +-2 +-3) only +6 and -6 are as far out as 6; of (+-1 +-2 -+3), all reach 0.
    assert sign_flip_test([1.0, 2.0, 3.0]) == 2 / 8
    assert sign_flip_test([1.0, 2.0, -3.0]) == 1.0
    assert sign_flip_test([1.0, 1.0, -1.0]) == 1.0
    assert sign_flip_test([4.0]) == 1.0
    assert sign_flip_test(np.zeros(5)) == 1.0
    assert sign_flip_test(np.zeros(50), resamples=20) == 1.0
    # 0.1 + 0.2 - 0.3 is 0 on paper only, and 0.1 + 0.2 + 0.3 is not 0.3 + 0.2 + 0.1.
    assert sign_flip_test([0.1, 0.2, -0.3]) == 1.0
    assert sign_flip_test([0.1, 0.2, 0.3]) == sign_flip_test([0.3, 0.2, 0.1]) == 0.25
    for seeds in (5, 14):
        assert sign_flip_test(np.arange(1.0, seeds + 1)) == 2.0 ** (1 - seeds)
    assert sign_flip_test(np.arange(1.0, 41.0), resamples=999) == 1 / 1000


def exact_p(differences):
    """The p-value of all 2^K sign vectors, with sums that are equal but for rounding."""
    sums = np.zeros(1)
    for each in differences:
        sums = np.concatenate([sums - each, sums + each])
    slack = 1e-12 * np.abs(differences).sum()
    return np.mean(np.abs(sums) >= abs(differences.sum()) - slack)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
@pytest.mark.parametrize("digits", [0, 1, 16])  # the first two make ties and zeros
@pytest.mark.parametrize("seeds", [1, 2, 5, 10, 14])
def test_all_signs_are_counted(seeds, digits, unit):
    differences = unit * (normal(seeds) + 0.4).round(digits)
    assert sign_flip_test(differences) == exact_p(differences)


def test_random_signs_come_close_to_all_signs():
    # 20,000 draws miss the p-value of all 2^18 sign vectors by 5 standard errors at most.
    differences = normal(18) + 0.3
    exact = exact_p(differences)
    drawn = sign_flip_test(differences, resamples=20_000)
    assert drawn == pytest.approx(exact, abs=5 * np.sqrt(exact * (1 - exact) / 20_000))
    assert 0.01 < exact < 0.99


def test_random_signs_follow_the_seed():
    differences = normal(20)
    one, same, other = (sign_flip_test(differences, resamples=500, seed=s) for s in (1, 1, 2))
    assert one == same != other


# Holm


@pytest.mark.parametrize(
    ("p_values", "adjusted"),
    [
        ([0.01, 0.04, 0.03, 0.005], [0.03, 0.06, 0.06, 0.02]),
        ([0.01, 0.02, 0.03, 0.04, 0.05], [0.05, 0.08, 0.09, 0.09, 0.09]),  # R: p.adjust
        ([0.3, 0.9, 0.0], [0.6, 0.9, 0.0]),
        ([0.5, 0.6], [1.0, 1.0]),
        ([0.2], [0.2]),
    ],
)
def test_holm_by_hand(p_values, adjusted):
    assert holm(p_values) == pytest.approx(np.array(adjusted))


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
