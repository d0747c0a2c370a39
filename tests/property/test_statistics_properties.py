"""What holds for all learning curves and for the statistics of every comparison."""

import numpy as np
from hypothesis import example, given, strategies as st
from hypothesis.extra import numpy as hnp

from curricle.comparison.verdicts import steps_saved_share
from curricle.statistics import Curve, mean_return, time_to_threshold
from curricle.statistics.curves import Times, charge_source, smooth
from curricle.statistics.hypothesis_tests import holm, sign_flip_test

RETURNS = st.floats(-1e4, 1e4).map(lambda value: round(value, 6))
SHAPES = st.tuples(st.integers(1, 5), st.integers(2, 12))
WINDOW = 3


@st.composite
def curves(draw, arms=1, leading_nan=True):
    """`arms` curves over the same seeds and checkpoints; the first has no source steps."""
    seeds, checkpoints = draw(SHAPES)
    distances = draw(hnp.arrays(np.int64, checkpoints, elements=st.integers(1, 500)))
    steps = np.cumsum(distances) - draw(st.sampled_from([0, int(distances[0])]))
    made = []
    for arm in range(arms):
        values = draw(hnp.arrays(np.float64, (seeds, checkpoints), elements=RETURNS))
        source = draw(hnp.arrays(np.int64, seeds, elements=st.integers(0, 3000)))
        if leading_nan:
            blanks = draw(hnp.arrays(np.int64, seeds, elements=st.integers(0, checkpoints - 1)))
            values[np.arange(checkpoints) < blanks[:, np.newaxis]] = np.nan
        made.append(Curve(steps, values, source if arm else np.zeros(seeds, dtype=np.int64)))
    return made[0] if arms == 1 else tuple(made)


def without_source(curve):
    return Curve(curve.steps, curve.values)


def window_of(curve):
    return min(WINDOW, curve.steps.size)


@given(curves(), st.data())
def test_smooth_equals_the_mean_of_each_window(curve, data):
    window = data.draw(st.integers(1, curve.steps.size))
    smoothed = smooth(curve.values, window)
    for (seed, place), value in np.ndenumerate(smoothed):
        inside = curve.values[seed, max(0, place - window + 1) : place + 1]
        inside = inside[~np.isnan(inside)]
        expected = inside.mean() if inside.size else np.nan
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9)


@given(curves(), RETURNS, RETURNS)
def test_a_higher_threshold_takes_no_less_time(curve, threshold, other):
    low, high = sorted([threshold, other])
    easy, hard = (time_to_threshold(curve, level, window=window_of(curve)) for level in (low, high))
    assert np.all(easy.steps <= hard.steps)
    assert np.all(easy.reached >= hard.reached)


@given(curves(), RETURNS)
def test_every_seed_is_kept_and_the_unreached_are_censored_at_the_end(curve, threshold):
    times = time_to_threshold(curve, threshold)
    assert times.steps.shape == times.reached.shape == (curve.values.shape[0],)
    assert np.all(np.isin(times.steps, curve.steps))
    assert np.all(times.steps[~times.reached] == curve.steps[-1])
    ever = np.nanmax(curve.values, axis=1) >= threshold
    assert np.array_equal(times.reached, ever)


@given(curves(arms=2))
def test_without_source_steps_strong_is_weak(pair):
    baseline, transfer = pair[0], without_source(pair[1])
    assert np.array_equal(charge_source(baseline, transfer).values, transfer.filled())


@given(curves(arms=2))
def test_a_charged_curve_stays_within_what_was_measured(pair):
    baseline, transfer = Curve(pair[0].steps, np.sort(pair[0].filled(), axis=1)), pair[1]
    charged = charge_source(baseline, transfer).values
    seen = np.column_stack([baseline.filled()[:, 0], transfer.filled()])
    slack = 1e-9 * (1 + np.abs(seen).max())
    assert np.all(charged >= seen.min(axis=1, keepdims=True) - slack)
    assert np.all(charged <= seen.max(axis=1, keepdims=True) + slack)


@given(curves(arms=2))
def test_a_source_that_teaches_nothing_never_gains(pair):
    """Nor does a strong gain exceed the weak one over the steps that the target has left."""
    baseline, transfer = pair
    nothing = Curve(baseline.steps, baseline.values, transfer.source_steps)
    alone = mean_return(baseline).mean()
    slack = 1e-9 * (1 + np.abs(baseline.filled()).max()) * len(baseline.steps)
    assert mean_return(charge_source(baseline, nothing)).mean() <= alone + slack
    late, learnt = (charge_source(baseline, curve).values for curve in (nothing, transfer))
    training = baseline.steps < transfer.source_steps[:, np.newaxis] + baseline.steps[0]
    weak = mean_return(Curve(baseline.steps, np.where(training, 0.0, learnt - late)))
    strong = mean_return(charge_source(baseline, transfer)).mean() - alone
    assert strong <= weak.mean() + 1e-6


SCORES = st.integers(-8, 8).map(float)  # few different ones, hence ties
ARMS = hnp.arrays(np.float64, st.integers(1, 9), elements=SCORES)
P_VALUES = st.lists(st.floats(0, 1), min_size=1, max_size=8)


@st.composite
def some_times(draw):
    seeds = draw(st.integers(1, 10))
    steps = draw(hnp.arrays(np.float64, seeds, elements=st.integers(0, 12).map(float)))
    return Times(steps, draw(hnp.arrays(np.bool_, seeds)))


@given(ARMS, st.floats(0.01, 100))
@example(np.array([-3.0, 4.0, 5.0, -1.0, -5.0]), 1.0)  # a sum of 0, but for rounding
def test_sign_flips_know_neither_order_nor_direction_nor_unit(differences, unit):
    p = sign_flip_test(differences)
    assert 0 < p <= 1
    for same in (differences[::-1], -differences, unit * differences):
        assert sign_flip_test(same) == p


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


@given(some_times())
def test_waiting_longer_never_shortens_a_time(times):
    longer = Times(times.steps + 5.0 * ~times.reached, times.reached)
    assert longer.restricted_mean().estimate >= times.restricted_mean().estimate


@st.composite
def times_of_arms(draw):
    """An arm and one to three opponents, of the same seeds."""
    seeds = draw(st.integers(1, 6))
    steps = hnp.arrays(np.float64, seeds, elements=st.integers(0, 9).map(float))
    reached = hnp.arrays(np.bool_, seeds, elements=st.sampled_from([True] * 4 + [False]))
    return draw(st.lists(st.builds(Times, steps, reached), min_size=2, max_size=4))


@given(times_of_arms(), st.sampled_from([0.25, 4.0, 1024.0]), st.randoms())
def test_a_share_of_steps_saved_is_at_most_one_and_has_no_unit(arms, unit, order):
    def share_of(arms):
        share = steps_saved_share(arms[0], arms[1:])
        return [share.low, share.estimate, share.high]

    share = share_of(arms)
    assert not np.isposinf(share).any()
    assert not np.isfinite(share[1]) or share[1] <= 1
    if not np.isnan(share).any():
        assert share == sorted(share)
        assert share[2] <= 1
    seeds = order.sample(range(arms[0].steps.size), arms[0].steps.size)
    moved = [Times(unit * times.steps[seeds], times.reached[seeds]) for times in arms]
    others = order.sample(moved[1:], len(moved) - 1)
    np.testing.assert_allclose(share_of([moved[0], *others]), share, rtol=1e-9, atol=1e-9)
    slower = [Times(times.steps + 1, times.reached) for times in arms[1:]]
    assert not share_of([arms[0], *slower])[1] < share[1]
