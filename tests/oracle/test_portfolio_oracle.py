"""Both loops of portfolios against two learners in plain Python, draw for draw."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.learning.portfolio import Portfolio

from .conftest import learn_naively

LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]
WAYS = [cr.QInitialisation, cr.LookAheadAdvice, cr.RewardBonus, cr.StateShaping]
PORTFOLIO = Portfolio(first_turns=7, memory=9, longest_rest=20)


def assert_same(task, learner, steps, shaping, *, seed=0, optimist=True):
    """Equal to the last bit; without a time limit a turn ends after 3 / (1 - discount) steps."""
    mdp = task.mdp
    cut = mdp.time_limit is None and mdp.discount < 1
    turn = round(3 / (1 - mdp.discount)) if cut else np.inf
    options = {"shaping": shaping, "eval_freq": 50}
    result = cr.learn(task, learner, steps, seeds=[seed], **options)
    bounds = cr.learning.value_bounds(task) if optimist else None
    naive = learn_naively(task, learner, steps, seed=seed, turn=turn, bounds=bounds, **options)
    np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)
    np.testing.assert_array_equal(result.source_share[0], naive.source_share)
    np.testing.assert_array_equal(result.episodes[0], naive.episodes)
    assert {acting for acting, *_ in naive.turns} == {0, 1}
    return result, naive


@pytest.mark.parametrize("time_limit", [None, 5])
@pytest.mark.parametrize("kind", LEARNERS)
@pytest.mark.parametrize("way", WAYS)
def test_a_portfolio_equals_the_naive_one(way, kind, time_limit, random_mdp, random_shaping):
    task = random_mdp(4, time_limit=time_limit)
    learner = kind(learning_rate=0.3, epsilon=0.3, initial_value=0.5)
    shaping = random_shaping(task, way, 1)
    shaping = replace(shaping, portfolio=PORTFOLIO)
    result, naive = assert_same(task, learner, 1500, shaping)
    assert result.own_rewards[0] == (shaping.own_rewards or not naive.ahead)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate", [0.5, cr.learning.harmonic(0.9, 0.05, half=20)])
@pytest.mark.parametrize("kind", [cr.QLearning, cr.DoubleQLearning])
def test_other_tasks_portfolios_and_rates(kind, rate, seed, random_mdp, random_shaping):
    task = random_mdp(seed, time_limit=[None, 6][seed % 2], discount=[0.5, 1.0][seed % 2])
    portfolio = Portfolio(first_turns=2 + seed, memory=2 + seed, longest_rest=[2, 50][seed % 2])
    shaping = random_shaping(task, cr.QInitialisation, seed, portfolio=portfolio)
    assert_same(task, kind(learning_rate=rate, epsilon=0.2), 1500, shaping, seed=seed)


@pytest.mark.parametrize("kind", LEARNERS)
def test_without_a_horizon_the_other_learner_is_the_same_without_phi(kind, random_shaping):
    """At discount 1 without a time limit nothing bounds the values; all ways lead to the end."""
    rng = np.random.default_rng(5)
    p = np.triu(rng.integers(1, 5, (3, 5, 5)), 1).swapaxes(0, 1).astype(float)
    p[:-1] /= p[:-1].sum(axis=2, keepdims=True)
    p[-1, :, -1] = 1.0
    task = cr.FiniteMDP.from_dense(
        p, rng.normal(size=(5, 3, 5)), terminal=np.arange(5) == 4, start=0, discount=1.0
    )
    shaping = replace(random_shaping(task, cr.StateShaping, 2), portfolio=PORTFOLIO)
    evaluation = cr.GreedyEvaluation(method="rollouts", episodes=1)
    learner = kind(learning_rate=0.3, epsilon=0.3)
    options = {"shaping": shaping, "eval_freq": 50}
    result = cr.learn(task, learner, 1500, evaluation=evaluation, **options)
    naive = learn_naively(task, learner, 1500, **options)
    np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_array_equal(result.source_share[0], naive.source_share)


@pytest.mark.parametrize("kind", LEARNERS)
def test_turns_of_a_task_without_episodes(kind, endless, random_shaping):
    """At discount 0.9 a turn has 30 steps."""
    shaping = random_shaping(endless, cr.QInitialisation, 2, portfolio=PORTFOLIO)
    learner = kind(learning_rate=0.3, epsilon=0.3)
    _, naive = assert_same(endless, learner, 1500, shaping)
    assert [length for _, _, length, *_ in naive.turns] == [30] * 50


@pytest.fixture(scope="module")
def endless():
    rng = np.random.default_rng(3)
    p = rng.integers(1, 5, (4, 3, 4))
    p = p / p.sum(axis=2, keepdims=True)
    return cr.FiniteMDP.from_dense(
        p, rng.normal(size=(4, 3, 4)), terminal=np.zeros(4, bool), start=0, discount=0.9
    )


@pytest.mark.parametrize("kind", LEARNERS)
def test_the_table_handed_on_is_the_one_evaluated_last(kind, random_mdp, random_shaping):
    task = random_mdp(3, time_limit=10)
    shaping = random_shaping(task, cr.StateShaping)
    shaping = replace(shaping, portfolio=Portfolio())
    result = cr.learn(task, kind(), 2000, eval_freq=100, seeds=20, shaping=shaping, snapshots=4)
    assert len({share > 0.5 for share in result.source_share[:, -1]}) == 2  # both were handed on
    for values, last in zip(result.values, result.greedy_return[:, -1], strict=True):
        assert returned(task, values) == pytest.approx(last, abs=1e-12)
    kept = result.snapshots
    for step, values in zip(kept.steps, kept.values, strict=True):
        last_return = result.greedy_return[0, result.steps == step]
        assert returned(task, values) == pytest.approx(last_return[0], abs=1e-5)


def returned(task, values):
    phi = cr.StateActionPotential(task, np.where(task.mdp.terminal[:, None], 0, values))
    learner = cr.QLearning(learning_rate=0.0)
    return cr.learn(task, learner, 1, shaping=cr.QInitialisation(phi)).greedy_return[0, 0]
