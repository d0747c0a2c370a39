"""The distances of lax bisimulation against a naive fixed point with linear programs."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog

from curricle.errors import MappingError
from curricle.planning import solve
from curricle.transfer import bisimulation, lax_bisimulation
from curricle.transfer.bisimulation import UNSET, scratch, transport_cost
from tests.tasks import dense_of, mdps, random_mdp


def transport_naively(p, q, cost):
    n, m = cost.shape
    rows = np.kron(np.eye(n), np.ones(m))
    columns = np.kron(np.ones(n), np.eye(m))
    solved = linprog(cost.ravel(), A_eq=np.vstack([rows, columns]), b_eq=np.append(p, q))
    return solved.fun


@given(st.integers(2, 6), st.integers(2, 6), st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=60)
def test_transport_is_exact_also_from_the_last_basis(n, m, seed, even):
    """Even masses and whole costs are the degenerate ones, which tie."""
    rng = np.random.default_rng(seed)
    p, q = rng.dirichlet(np.ones(n)), rng.dirichlet(np.ones(m))
    if even:
        p, q = np.full(n, 1 / n), np.full(m, 1 / m)
    space, tree = scratch(7, 8), np.full((2, n + m), UNSET, np.uint8)
    for _ in range(3):
        cost = rng.integers(0, 4, (n, m)).astype(float) if even else rng.random((n, m))
        space.cost[:n, :m] = cost
        least = transport_cost(p, q, tree[0], tree[1], space)
        assert least == pytest.approx(transport_naively(p, q, cost), abs=1e-8)


def dense(task):
    """Return P (S, A, S) and r (S, A), terminal states absorbing and without reward."""
    p, r = dense_of(task)
    ends = np.flatnonzero(task.terminal)
    p[ends, :, ends] = 1
    return p, r


def distance_naively(target, source, sweeps):
    """Return d of states and of pairs after so many sweeps from 0."""
    (p, r), (q, w) = dense(target), dense(source)
    d = np.zeros((len(p), len(q)))
    pairs = np.zeros((*r.shape, *w.shape))
    for _ in range(sweeps):
        for s, a, u, b in np.ndindex(pairs.shape):
            cost = transport_naively(p[s, a], q[u, b], d)
            pairs[s, a, u, b] = abs(r[s, a] - w[u, b]) + target.discount * cost
        one_way = pairs.min(axis=3).max(axis=1)
        other_way = pairs.min(axis=1).max(axis=2)
        d = np.maximum(one_way, other_way)
    return d, pairs


@given(mdps(discounts=(0.3,), max_states=3, max_actions=2), mdps(max_states=3, max_actions=2))
@settings(max_examples=12)
def test_distances_are_those_of_the_naive_fixed_point(first, second):
    target = first.task()
    source = type(second)(second.p, second.r, second.terminal, first.discount).task()
    lax = lax_bisimulation(target, source, tolerance=1e-9)
    d, pairs = distance_naively(target, source, sweeps=12)
    left = 0.3**12 / 0.7 * 20
    np.testing.assert_allclose(lax.states, d, atol=left + 1e-6)
    live = ~target.terminal
    nearest = pairs.reshape(*pairs.shape[:2], -1).min(axis=2)
    np.testing.assert_allclose(lax.pairs[live], nearest[live], atol=left + 1e-6)


@pytest.mark.parametrize("width", [1, 3])
def test_a_larger_task_agrees_with_the_naive_one(width):
    target = random_mdp(1, n_states=5, n_actions=2, width=width, discount=0.5)
    source = random_mdp(2, n_states=4, n_actions=2, width=width, discount=0.5)
    lax = lax_bisimulation(target, source, tolerance=1e-9)
    d, _ = distance_naively(target, source, sweeps=10)
    np.testing.assert_allclose(lax.states, d, atol=0.5**10 * 20)


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_bounds_hold_where_iteration_ends_early(monkeypatch, rounds):
    target = random_mdp(1, n_states=5, n_actions=2, width=3, discount=0.9)
    source = random_mdp(2, n_states=4, n_actions=2, width=3, discount=0.9)
    whole = lax_bisimulation(target, source, tolerance=1e-9)
    monkeypatch.setattr(bisimulation, "MOST_ROUNDS", rounds)
    lax = lax_bisimulation(target, source, tolerance=1e-9)
    assert lax.error > 1e3 * whole.error
    assert (whole.states <= lax.states + 1e-6).all()
    assert (lax.states <= whole.states + 2 * lax.error + 1e-6).all()
    apart = abs(solve(target).values[:, None] - solve(source).values)
    assert (apart <= lax.states).all()


def test_work_is_bounded(monkeypatch):
    target = random_mdp(1, n_states=5, n_actions=2, width=3, discount=0.9)
    whole = lax_bisimulation(target, target, tolerance=1e-9)
    monkeypatch.setattr(bisimulation, "MOST_WORK", 1)
    assert lax_bisimulation(target, target, tolerance=1e-9).error > whole.error
    monkeypatch.setattr(bisimulation, "LARGEST_ROUND", 10)
    with pytest.raises(MappingError, match="up to 10 pairs of outcomes in a round: these tasks"):
        lax_bisimulation(target, target)
