"""Adding seeds until the answer is clear: what is measured, when it stops, what it returns."""

from functools import partial

import numpy as np
import pytest
import scipy.stats

from curricle.errors import SettingError
from curricle.statistics.hypothesis_tests import Looks, add_seeds
from tests.refusals import check_values

NAN = np.nan
NOISE = np.random.default_rng(7).normal(size=1000)


def noisy(mean=0.0, spread=1.0):
    return lambda seeds: mean + spread * NOISE[np.array(seeds)]


def recorded(measure):
    """The measure, and the list of the seeds it is asked for."""
    asked = []

    def asking(seeds):
        asked.append(list(seeds))
        return measure(seeds)

    return asking, asked


@pytest.mark.parametrize(
    ("first", "most", "totals"),
    [(10, 100, [10, 20, 40, 80, 100]), (5, 20, [5, 10, 20]), (4, 5, [4, 5]), (3, 3, [3])],
)
def test_totals_double_and_each_seed_is_asked_for_once(first, most, totals):
    measure, asked = recorded(noisy())
    result = add_seeds(measure, first=first, most=most, precision=1e-9)
    assert np.cumsum([len(new) for new in asked]).tolist() == totals
    assert [seed for batch in asked for seed in batch] == list(range(most))
    assert np.array_equal(result.values, NOISE[:most])
    assert (result.stopped_by, result.looks) == ("most", len(totals))
    assert result.planned == Looks(tuple(totals))


@pytest.mark.parametrize(("first", "most"), [(2, 2), (3, 3), (10, 100)])
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
def test_interval_is_students_at_the_shared_confidence(first, most, confidence):
    result = add_seeds(noisy(2.0), first=first, most=most, precision=1e-9, confidence=confidence)
    values = 2.0 + NOISE[:most]
    expected = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(
        Looks.doubling(first, most).confidence(confidence)
    )
    interval = result.interval
    assert (interval.low, interval.high) == pytest.approx((expected.low, expected.high), rel=1e-9)
    assert interval.estimate == pytest.approx(values.mean())
    assert (interval.confidence, interval.n) == (confidence, most)


def test_it_stops_as_soon_as_the_mean_is_precise():
    result = add_seeds(noisy(), precision=0.4)
    assert (result.stopped_by, result.looks) == ("precision", 3)
    assert result.interval.high - result.interval.low <= 2 * 0.4
    before = scipy.stats.ttest_1samp(NOISE[:20], 0.0).confidence_interval(0.986)
    assert before.high - before.low > 2 * 0.4


def test_it_stops_at_a_difference_of_either_sign():
    for mean in (3.0, -3.0):
        result = add_seeds(noisy(mean), difference=True)
        assert (result.stopped_by, result.values.size, result.looks) == ("difference", 10, 1)
        assert result.interval.low * result.interval.high > 0
    balanced = add_seeds(lambda seeds: [(-1.0) ** seed for seed in seeds], difference=True)
    assert (balanced.stopped_by, balanced.values.size) == ("most", 100)
    assert balanced.interval.low < 0 < balanced.interval.high
    zeros = add_seeds(lambda seeds: np.zeros(len(seeds)), difference=True)
    assert (zeros.stopped_by, zeros.p) == ("most", 1.0)


def test_equal_values_differ_from_0_but_have_no_precision():
    three = add_seeds(lambda seeds: np.full(len(seeds), 3.0), difference=True)
    assert (three.stopped_by, three.values.size) == ("difference", 10)
    assert np.isnan([three.interval.low, three.interval.high]).all()
    precise = add_seeds(lambda seeds: np.full(len(seeds), 3.0), precision=0.1)
    assert precise.stopped_by == "most"


# Levels


@pytest.mark.parametrize(("looks", "bound"), [(1, 1.960), (2, 2.178), (5, 2.413), (10, 2.555)])
def test_equally_spaced_looks_have_pococks_bounds(looks, bound):
    """Jennison and Turnbull, Group sequential methods, 2000, table 2.1."""
    planned = Looks(tuple(range(7, 7 * looks + 1, 7)))
    assert scipy.stats.norm.isf((1 - planned.confidence()) / 2) == pytest.approx(bound, abs=6e-4)


def test_probability_of_crossing_is_that_of_the_multivariate_normal():
    seeds = np.array([5, 10, 20])
    correlation = np.sqrt(np.minimum.outer(seeds, seeds) / np.maximum.outer(seeds, seeds))
    bound = scipy.stats.norm.isf((1 - Looks(tuple(seeds.tolist())).confidence(0.9)) / 2)
    inside = scipy.stats.multivariate_normal(cov=correlation).cdf(
        np.full(3, bound), lower_limit=np.full(3, -bound), rng=np.random.default_rng(1)
    )
    assert inside == pytest.approx(0.9, abs=2e-5)


def test_settings_are_refused_before_anything_is_measured():
    measure, asked = recorded(noisy())
    for both in ({}, {"precision": 1.0, "difference": True}):
        with pytest.raises(SettingError, match="difference=True: got precision="):
            add_seeds(measure, **both)
    check_values(SettingError, partial(add_seeds, measure), {"precision": [0.0, NAN]})
    wrong = {"first": [1, 2.5], "most": [9], "confidence": [1, "x"]}
    check_values(SettingError, partial(add_seeds, measure, difference=True), wrong)
    assert asked == []


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (lambda seeds: np.zeros((len(seeds), 1)), r"got shape \(10, 1\) for 10 seeds"),
        (lambda seeds: ["x"] * len(seeds), "that measure returns must be an array of numbers"),
        (
            lambda seeds: [NAN if seed == 13 else (-1.0) ** seed for seed in seeds],
            "measure must return finite numbers: seed 13 has nan",
        ),
    ],
)
def test_a_measure_that_does_not_measure_is_refused(measure, message):
    with pytest.raises(SettingError, match=message):
        add_seeds(measure, difference=True)
