"""MDPs of sparse matrices: one for each action, or a row for each pair."""

import tracemalloc

import numpy as np
import pytest
from scipy.sparse import coo_array, csc_matrix, csr_array, csr_matrix, diags_array, lil_array

import curricle as cr
from curricle.errors import TaskError
from tests.support.tasks import dense_of, random_mdp, with_masks

FORMS = [csr_array, csr_matrix, csc_matrix, coo_array, lil_array, np.asarray]


def tables(seed, masks=False):
    """Return a random MDP, and its P (S, A, S) and r (S, A, S), r 0 where P is."""
    task = random_mdp(seed, n_states=7, n_actions=4)
    task = with_masks(task, seed) if masks else task
    p, _ = dense_of(task)
    r = np.random.default_rng(seed).normal(size=p.shape) * (p > 0)
    return task, np.where(task.terminal[:, None, None], np.eye(7)[:, None], p), r


def settings_of(task):
    return {"terminal": task.terminal, "start": task.start, "discount": task.discount}


def assert_same(first, second):
    """Compare what planning and learning read."""
    for x, y in zip(dense_of(first), dense_of(second), strict=True):
        np.testing.assert_allclose(x, y, atol=1e-12)
    np.testing.assert_array_equal(first.random_policy, second.random_policy)
    bound = cr.solve(first).error_bound + cr.solve(second).error_bound
    live = ~first.terminal
    difference = cr.solve(first).values[live] - cr.solve(second).values[live]
    assert abs(difference).max() <= bound + 1e-12


@pytest.mark.parametrize("kind", ["state", "pair", "transition"])
@pytest.mark.parametrize("form", FORMS)
def test_matrices_of_actions_are_a_dense_table(form, kind):
    task, p, r = tables(1)
    reward = {"state": r[:, 0, 0], "pair": r[:, :, 0], "transition": r}[kind]
    by_action = [form(r[:, a]) for a in range(4)] if kind == "transition" else reward
    sparse = cr.FiniteMDP.from_sparse(
        [form(p[:, a]) for a in range(4)], by_action, **settings_of(task)
    )
    assert_same(sparse, cr.FiniteMDP.from_dense(p, reward, **settings_of(task)))


@pytest.mark.parametrize("per_transition", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_rows_of_pairs_are_a_dense_table(form, per_transition):
    task, p, r = tables(2, masks=True)
    pairs = np.argwhere(task.available)[::-1]
    s, a = pairs.T
    reward = form(r[s, a]) if per_transition else r[s, a, 0]
    rows = cr.FiniteMDP.from_pairs(form(p[s, a]), reward, s, a, **settings_of(task))
    of_dense = r if per_transition else r[:, :, 0]
    dense = cr.FiniteMDP.from_dense(p, of_dense, available=task.available, **settings_of(task))
    assert_same(rows, dense)


def test_quantecon_and_toolbox_agree():
    # The example of QuantEcon's DiscreteDP: two states, the second with one action.
    by_rows = cr.FiniteMDP.from_pairs(
        [[0.5, 0.5], [0, 1], [0, 1]], [5, 10, -1], [0, 0, 1], [0, 1, 0], start=0, discount=0.95
    )
    by_actions = cr.FiniteMDP.from_sparse(
        [[[0.5, 0.5], [0, 1]], [[0, 1], [0, 0]]], [[5, 10], [-1, 0]], start=0, discount=0.95
    )
    assert_same(by_rows, by_actions)
    np.testing.assert_allclose(cr.solve(by_rows).values, [-60 / 7, -20], rtol=1e-9)


def test_single_precision_is_renormalised_and_less_refused():
    p = np.random.default_rng(0).dirichlet(np.ones(50), size=50).astype(np.float32)
    task = cr.FiniteMDP.from_sparse([p], np.zeros(50), start=0, discount=0.9)
    np.testing.assert_allclose(task.probability.sum(axis=1), 1.0, rtol=1e-8)
    with pytest.raises(TaskError, match=r"sum to 1: state 0, action 0 sums to 0\.99"):
        cr.FiniteMDP.from_sparse([0.99 * p], np.zeros(50), start=0, discount=0.9)


def test_nothing_of_the_size_of_a_dense_table_is_made():
    n = 50_000  # a dense matrix of one action would take 20 GB
    right = diags_array([np.ones(n - 1)], offsets=[1], format="lil")
    right[n - 1, n - 1] = 1.0
    left = diags_array([np.ones(n - 1)], offsets=[-1], format="csr")
    tracemalloc.start()
    task = cr.FiniteMDP.from_sparse([right.tocsr(), left], np.ones(n), start=0, discount=0.9)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1000 * n
    assert task.available[:2].tolist() == [[True, False], [True, True]]


EYE = np.eye(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([EYE, np.eye(3)], [0, 0]), r"\[\(2, 2\), \(3, 3\)\]"),
        (([], [0, 0]), r"transition must be a matrix \(S, S\) for each action"),
        ((1.0, [0, 0]), "transition must be a matrix"),
        ((["ab"], [0, 0]), "transition must be a matrix of numbers"),
        (([EYE], [0, 0, 0]), r"reward must have shape \(2,\) or \(2, 1\)"),
        (([EYE], [EYE, EYE]), "or a matrix"),
        (([EYE, -EYE], [0, 0]), "state 0, action 1 sums to -1"),
        (([EYE], [np.nan, 0]), "rewards must be finite"),
        (([0 * EYE], [0, 0]), "needs an available action: state 0 has none"),
        ((EYE, [0, 0], [0, 0], [0, 0]), "a pair must have one row: state 0, action 0 has 2"),
        ((EYE, [0, 0], [0, 2], [0, 0]), r"s_indices must be whole numbers in 0\.\.1"),
        ((EYE, [0, 0], [0, 1], [0]), r"must have shape \(2,\)"),
        ((EYE, [0], [0, 1], [0, 0]), r"reward must have shape \(2,\): got \(1,\)"),
        ((EYE, np.eye(3), [0, 1], [0, 0]), r"reward must have shape \(2, 2\): got \(3, 3\)"),
        ((EYE[:1], [0], [0], [0]), "state 1 has none"),
    ],
)
def test_bad_matrices_and_rows_are_named(arguments, message):
    make = cr.FiniteMDP.from_sparse if len(arguments) == 2 else cr.FiniteMDP.from_pairs
    with pytest.raises(TaskError, match=message):
        make(*arguments, start=0, discount=0.9)
