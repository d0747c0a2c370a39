"""Learning and planning where not every action is available, against plain Python."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import ShapingReward
from curricle.learning import OptimisticQLearning, RMax, value_bounds
from tests.support.tasks import among_more_actions, dense_of, random_mdp, with_masks

from .conftest import learn_naively, play_portfolio_naively

LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]
EXPLORATIONS = {
    "greedy": {"epsilon": 0.0},
    "epsilon": {"epsilon": 0.4},
    "softmax": {"inverse_temperature": 2.0},
    "uniform": {"inverse_temperature": 0.0},
}
WAYS = [None, cr.QInitialisation, cr.RewardBonus, cr.StateShaping]


def same_as_naive(task, learner, shaping=None, *, exact=True):
    """Learn by the compiled loops and in plain Python; both results must be the same."""
    options = {"shaping": shaping, "eval_freq": 100}
    result = cr.learn(task, learner, 1200, **options)
    naive = learn_naively(task, learner, 1200, **options)
    assert (np.isneginf(result.values[0]) == ~task.available).all()
    if exact:
        np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_allclose(result.values[0], naive.values, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)
    return result


@pytest.mark.parametrize("exploration", EXPLORATIONS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", LEARNERS)
def test_learners(kind, seed, exploration):
    task = random_mdp(seed, n_actions=3 + seed, time_limit=[None, 9, 20][seed])
    learner = kind(learning_rate=0.3, initial_value=seed - 1.0, **EXPLORATIONS[exploration])
    task = with_masks(task, seed)
    same_as_naive(
        task, learner, exact="epsilon" in learner.__dict__ and learner.epsilon is not None
    )


@pytest.mark.parametrize("way", WAYS[1:])
@pytest.mark.parametrize("kind", LEARNERS)
def test_shapings(kind, way, random_shaping):
    task = with_masks(random_mdp(4, n_actions=4, time_limit=8), 4)
    same_as_naive(task, kind(learning_rate=0.2, epsilon=0.3), random_shaping(task, way))


def test_a_portfolio():
    task = with_masks(random_mdp(5, n_actions=4, time_limit=8), 5)
    phi = np.random.default_rng(5).normal(size=task.available.shape)
    phi = cr.StateActionPotential(task, np.where(task.available, phi, -np.inf)).values
    shaping = cr.QInitialisation(phi, portfolio=cr.Portfolio())
    result = cr.learn(task, budget=1200, shaping=shaping, eval_freq=100)
    naive = play_portfolio_naively(
        task, 1200, phi, cr.Portfolio(), bounds=value_bounds(task), eval_freq=100
    )
    assert (np.isneginf(result.values[0]) == ~task.available).all()
    np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)


@pytest.mark.parametrize("learner", [OptimisticQLearning(), RMax()])
def test_an_optimist_learns_no_value_of_an_unavailable_action(learner):
    task = with_masks(random_mdp(6, n_actions=4, time_limit=8), 6)
    result = cr.learn(task, learner, 5000)
    assert (np.isneginf(result.values[0]) == ~task.available).all()
    assert result.greedy_return[0, -1] > cr.planning.Target.of(task).random_return


@pytest.mark.slow  # each a loop to compile; the fast tests hold them equal with a mapped potential
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_sparse_tables_equal_dense_ones(dtype):
    task = with_masks(random_mdp(7, n_states=9, n_actions=4, time_limit=8), 7)
    results = [
        cr.learn(task, None, 3000, storage=cr.Storage(kind=kind, dtype=dtype))
        for kind in ("dense", "sparse")
    ]
    dense, sparse = (result.values[0] for result in results)
    np.testing.assert_array_equal(sparse.values, dense[sparse.states])
    np.testing.assert_array_equal(*(result.greedy_return for result in results))


def best_values(task, *, policy=None):
    """Return V* by plain sweeps over the available actions, or V of a policy."""
    p, r = dense_of(task)
    values = np.zeros(len(r))
    for _ in range(4000):
        q = r + task.discount * p @ np.where(task.terminal, 0.0, values)
        if policy is None:
            q = np.where(task.random_policy > 0, q, -np.inf).max(axis=1)
        else:
            q = (policy * q).sum(axis=1)
        values = np.where(task.terminal, 0.0, q)
    return values


@pytest.mark.parametrize("seed", range(8))
def test_planning_chooses_among_available_actions(seed):
    task = with_masks(random_mdp(seed, n_actions=2 + seed % 4, discount=[0.9, 0.0][seed % 2]), seed)
    solution = cr.solve(task)
    np.testing.assert_allclose(solution.values, best_values(task), atol=1e-9)
    assert (np.isneginf(solution.action_values) == ~task.available).all()
    assert not (solution.optimal & ~task.available).any()
    random = cr.evaluate(task, task.random_policy)
    expected = best_values(task, policy=task.random_policy)
    np.testing.assert_allclose(random.values, expected, atol=1e-9)
    visits = cr.planning.visit_distribution(task)
    np.testing.assert_allclose(visits, cr.planning.visit_distribution(task, task.random_policy))


@pytest.mark.parametrize("kind", LEARNERS)
@pytest.mark.parametrize("seed", range(4))
def test_unavailable_actions_are_as_if_they_were_not_there(seed, kind):
    # Three of five actions in each state, in any places, are three actions. Greedy learners draw
    # among ties alone, of which there are as many in the same order: equal to the last bit.
    small = random_mdp(seed, n_actions=3, time_limit=9, discount=[0.9, 1.0][seed % 2])
    small = replace(small, reward=-1 - abs(small.reward))  # no way goes on for nothing
    large, places = among_more_actions(small, seed)
    np.testing.assert_array_equal(cr.solve(large).values, cr.solve(small).values)
    learner = kind(epsilon=0.0, learning_rate=0.5)
    first, second = (cr.learn(task, learner, 1500) for task in (small, large))
    there = np.take_along_axis(second.values[0], places, axis=1)
    live = ~small.terminal
    np.testing.assert_array_equal(there[live], first.values[0][live])
    np.testing.assert_array_equal(second.greedy_return, first.greedy_return)
    returns = [cr.planning.Target.of(task).random_return for task in (small, large)]
    np.testing.assert_allclose(*returns, rtol=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_certificates_are_those_of_the_task_without_the_other_actions(seed):
    small = random_mdp(seed, n_actions=2 + seed % 2)
    large, places = among_more_actions(small, seed)
    rng = np.random.default_rng(seed)
    phi, by_next = rng.normal(size=small.outcome_row.shape), rng.normal(size=(6, 6))
    spread = np.where(large.available, 0.0, -np.inf)
    np.put_along_axis(spread, places, phi, axis=1)

    def added(s, a, after):
        return by_next[s, after]

    shapings = [
        (cr.QInitialisation(phi), cr.QInitialisation(spread)),
        (cr.StateShaping(phi), cr.StateShaping(spread)),
        (cr.RewardBonus(phi), cr.RewardBonus(spread)),
        (ShapingReward(added), ShapingReward(added)),
    ]
    for of_small, of_large in shapings:
        first, second = (cr.certify(*pair) for pair in ((small, of_small), (large, of_large)))
        assert first.holds == second.holds
        assert "inf" not in str(second)
