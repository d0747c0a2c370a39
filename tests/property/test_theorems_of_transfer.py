"""Theorems about mappings, aggregates and the pursuit, on random tasks and tables."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.comparison import Comparison, Reference
from curricle.transfer.aggregate import BUILT_IN, aggregate
from tests.support.comparisons import arm_of

stacks = arrays(
    np.float64, st.tuples(*(st.integers(1, 4) for _ in range(3))), elements=st.floats(-1e6, 1e6)
)
AGGREGATES = [known.function for known in BUILT_IN.values()]


@st.composite
def partly_known(draw):
    """Return potentials (N, S, A) that are NaN where a source knows nothing."""
    potentials = draw(stacks)
    hidden = draw(arrays(np.bool_, potentials.shape))
    return np.where(hidden, np.nan, potentials)


@given(stacks | partly_known())
def test_minimum_is_below_mean_is_below_maximum(potentials):
    known = ~np.isnan(potentials).all(axis=0)
    rounding = 1e-9 * (1 + np.nan_to_num(abs(potentials)).max())
    low, middle, high, summed = (g(potentials) for g in (cr.minimum, cr.mean, cr.maximum, cr.total))
    assert (low[known] <= middle[known] + rounding).all()
    assert (middle[known] <= high[known] + rounding).all()
    n = np.count_nonzero(~np.isnan(potentials), axis=0)
    np.testing.assert_allclose(summed[known], (n * middle)[known], atol=rounding)
    for potential in low, middle, high, summed:
        np.testing.assert_array_equal(np.isnan(potential), ~known)


@pytest.mark.parametrize("function", AGGREGATES)
@given(stacks | partly_known(), st.randoms(use_true_random=False), st.integers(0, 4))
def test_neither_order_nor_who_knows_nothing_changes_an_aggregate(function, potentials, random, n):
    whole, order = function(potentials), random.sample(range(len(potentials)), len(potentials))
    np.testing.assert_allclose(function(potentials[order]), whole, rtol=1e-12, atol=1e-9)
    more = np.insert(potentials, min(n, len(potentials)), np.nan, axis=0)
    np.testing.assert_array_equal(function(more), whole)
    filled = aggregate(function, potentials, -7.0)
    np.testing.assert_array_equal(aggregate(function, more, -7.0), filled)
    assert (filled[np.isnan(whole)] == -7.0).all()


@pytest.mark.parametrize("function", AGGREGATES)
@given(stacks, st.integers(0, 3), st.integers(0, 3))
def test_the_aggregate_of_one_known_source_is_that_source(function, potentials, before, after):
    alone = np.full((before + 1 + after, *potentials.shape[1:]), np.nan)
    alone[before] = potentials[0]
    np.testing.assert_array_equal(aggregate(function, alone), potentials[0])


@given(
    st.integers(2, 3), st.booleans(), st.sampled_from([0.5, 0.95]), st.sampled_from([4, 5]),
    st.floats(-5.0, -0.1),
)  # fmt: skip
def test_phi_min_bounds_the_optimum_from_above(size, torus, discount, moves, step_reward):
    """To catch the prey together takes no less than alone."""
    rules = {
        "size": size, "torus": torus, "discount": discount, "moves": moves,
        "step_reward": step_reward,
    }  # fmt: skip
    hunt, chase = cr.Pursuit(predators=2, **rules), cr.Pursuit(predators=1, **rules)
    alone, both = cr.solve(chase, tolerance=1e-6), cr.solve(hunt, tolerance=1e-6)
    potentials = np.stack([
        cr.project(hunt, chase, predator=name).read(alone.action_values)
        for name in hunt.predator_names
    ])  # fmt: skip
    above = cr.minimum(potentials) - both.action_values
    assert above.min() >= -(alone.error_bound + both.error_bound + 1e-12)


@given(
    arrays(np.float64, (4, 3, 6), elements=st.floats(-50.0, 10.0)),
    st.sampled_from([0, 10, 30]),
    st.floats(-100.0, 9.0),
)
def test_no_source_gains_more_than_the_best_learner_without_one_leaves(curves, spent, random):
    names = ("scratch", "scratch, other", "a", "b")
    kinds = ({}, {"scratch": True}, {"spent": spent}, {})
    arms = {n: arm_of(c, **kind) for n, c, kind in zip(names, curves, kinds, strict=True)}
    reference = Reference(0.0, random_return=random, optimum=10.0)
    comparison = Comparison("t", arms, 50, 50, reference, 1)
    for name in () if comparison.nobody else ("a", "b"):
        gain = comparison.contrasts[name].strong_gain.estimate
        assert gain <= comparison.headroom(name) * (10.0 - random) + 1e-9
