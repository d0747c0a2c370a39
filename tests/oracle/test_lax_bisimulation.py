"""The distances of lax bisimulation against a naive fixed point with linear programs."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog

from curricle.errors import MappingError
from curricle.transfer import TaskPair, bisimulation, by_lax_bisimulation
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


def distances_of_states(tasks):
    """Return d of all states, (S, S')."""
    target, source, states, _ = bisimulation.distances(tasks, tolerance=1e-9)
    return states[target.blocks.states][:, source.blocks.states]


@given(mdps(discounts=(0.3,), max_states=3, max_actions=2), mdps(max_states=3, max_actions=2))
@settings(max_examples=12)
def test_distances_are_those_of_the_naive_fixed_point(first, second):
    target = first.task()
    source = type(second)(second.p, second.r, second.terminal, first.discount).task()
    tasks = TaskPair(target, source)
    d, pairs = distance_naively(target, source, sweeps=12)
    left = 0.3**12 / 0.7 * 20 + 1e-6
    np.testing.assert_allclose(distances_of_states(tasks), d, atol=left)
    index = next(by_lax_bisimulation(tasks)).mapping.index
    for s, a in np.argwhere((index >= 0) & ~target.terminal[:, None]):
        read = np.divmod(index[s, a], source.actions.size)
        assert pairs[s, a][read] <= pairs[s, a].min() + 2e-3 * d.max() + 2 * left


@pytest.mark.parametrize("width", [1, 3])
def test_a_larger_task_agrees_with_the_naive_one(width):
    target = random_mdp(1, n_states=5, n_actions=2, width=width, discount=0.5)
    source = random_mdp(2, n_states=4, n_actions=2, width=width, discount=0.5)
    d, _ = distance_naively(target, source, sweeps=10)
    distances = distances_of_states(TaskPair(target, source))
    np.testing.assert_allclose(distances, d, atol=0.5**10 * 20)


def test_work_is_bounded(monkeypatch):
    tasks = TaskPair(*[random_mdp(1, n_states=5, n_actions=2, width=3, discount=0.9)] * 2)
    monkeypatch.setattr(bisimulation, "LARGEST_ROUND", 10)
    with pytest.raises(MappingError, match="up to 10 pairs of outcomes in a round: these tasks"):
        next(by_lax_bisimulation(tasks))
