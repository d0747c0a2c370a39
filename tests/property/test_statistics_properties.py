"""What holds for the statistics of every comparison."""

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from hypothesis.extra import numpy as hnp

from curricle.statistics.hypothesis_tests import (
    holm,
    performance_profile,
    probability_of_improvement,
    sign_flip_test,
)
from curricle.statistics.sequential import add_seeds
from curricle.statistics.thresholds import Times

SCORES = st.integers(-8, 8).map(float)  # few different ones, hence ties
ARMS = hnp.arrays(np.float64, st.integers(1, 9), elements=SCORES)
P_VALUES = st.lists(st.floats(0, 1), min_size=1, max_size=8)


@st.composite
def some_times(draw):
    seeds = draw(st.integers(1, 10))
    steps = draw(hnp.arrays(np.float64, seeds, elements=st.integers(0, 12).map(float)))
    return Times(steps, draw(hnp.arrays(np.bool_, seeds)))


# One arm


@given(ARMS, hnp.arrays(np.float64, 5, elements=SCORES))
def test_a_profile_falls_and_knows_no_order_of_seeds(scores, thresholds):
    tau = np.sort(thresholds)
    profile = performance_profile(scores, tau)
    for numbers in (profile.estimate, profile.low, profile.high):
        assert np.isnan(numbers).all() or np.all(np.diff(numbers) <= 1e-12)
    turned = performance_profile(scores[::-1], tau)
    np.testing.assert_array_equal(turned.estimate, profile.estimate)


# Two arms


@given(ARMS, ARMS)
def test_what_one_arm_wins_the_other_loses(a, b):
    there, back = (probability_of_improvement(*pair) for pair in ((a, b), (b, a)))
    assert there.estimate + back.estimate == pytest.approx(1.0)
    assert 0 <= there.estimate <= 1


@given(ARMS, ARMS)
def test_improvement_knows_only_the_order_of_scores(a, b):
    plain, bent = (probability_of_improvement(*pair) for pair in ((a, b), (a**3, b**3)))
    assert bent.estimate == plain.estimate
    turned = probability_of_improvement(a[::-1], b[::-1])
    assert turned.estimate == pytest.approx(plain.estimate)


@given(ARMS, st.floats(0.01, 100))
@example(np.array([-3.0, 4.0, 5.0, -1.0, -5.0]), 1.0)  # a sum of 0, but for rounding
def test_sign_flips_know_neither_order_nor_direction_nor_unit(differences, unit):
    p = sign_flip_test(differences)
    assert 0 < p <= 1
    for same in (differences[::-1], -differences, unit * differences):
        assert sign_flip_test(same) == p


# Several tests


def step_down(p_values, alpha):
    """Holm's rule word for word: which hypotheses are rejected at level alpha."""
    left, rejected = list(range(len(p_values))), set()
    while left:
        smallest = min(left, key=lambda place: p_values[place])
        if p_values[smallest] * len(left) > alpha:
            break
        rejected.add(smallest)
        left.remove(smallest)
    return rejected


@given(P_VALUES, st.floats(0, 0.99))
def test_holm_rejects_what_its_rule_says(p_values, alpha):
    adjusted = holm(p_values)
    assert set(np.flatnonzero(adjusted <= alpha)) == step_down(p_values, alpha)


# Times


@given(some_times())
def test_a_survival_curve_falls_from_one_to_no_less_than_zero(times):
    share = times.survival().probabilities
    assert np.all(np.diff(np.concatenate([[1.0], share])) <= 1e-12)
    assert share[-1] >= 0
    if times.reached.all():
        assert share[-1] == 0


@given(some_times(), st.randoms(use_true_random=False))
def test_the_order_of_seeds_changes_no_time(times, random):
    order = random.sample(range(times.steps.size), times.steps.size)
    turned = Times(times.steps[order], times.reached[order])
    np.testing.assert_array_equal(turned.survival().probabilities, times.survival().probabilities)
    assert turned.median().estimate == times.median().estimate


@given(some_times())
def test_waiting_longer_never_shortens_a_time(times):
    longer = Times(times.steps + 5.0 * ~times.reached, times.reached)
    assert longer.median().estimate >= times.median().estimate
    left = times.steps[~times.reached]
    ends = [0.5, float(left.min(initial=12.0))]
    if ends[1] > 0:
        means = [times.restricted_mean(min(ends[1], each)).estimate for each in ends]
        assert means[0] <= means[1] <= ends[1]


@given(st.floats(0.1, 10), st.integers(2, 8), st.integers(0, 99))
def test_adding_seeds_follows_a_change_of_unit(scale, first, seed):
    noise = np.random.default_rng(seed).normal(0.5, 1.0, size=40)
    plain, scaled = (
        add_seeds(lambda s, u=u: u * noise[np.array(s)], first=first, most=40, precision=u * 0.8)
        for u in (1.0, scale)
    )
    assert scaled.interval.estimate == pytest.approx(scale * plain.interval.estimate)
    assert (scaled.stopped_by, scaled.looks) == (plain.stopped_by, plain.looks)
