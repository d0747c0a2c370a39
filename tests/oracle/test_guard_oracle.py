"""The guarded loop against two learners in plain Python, draw for draw."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.learning.guard import Guard

from .conftest import learn_naively

LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]
WAYS = {
    cr.QInitialisation: {},
    cr.LookAheadAdvice: {},
    cr.LookBackAdvice: {},
    cr.RewardBonus: {},
    cr.DecayingAdvice: {"weight": cr.learning.linear(1.0, 0.0, steps=1000)},
    cr.StateShaping: {},
}
PAIRS = [
    (way, kind)
    for way in WAYS
    for kind in (LEARNERS if way is not cr.LookBackAdvice else [cr.SARSA])
]
GUARD = Guard(share_behind=0.3, share_ahead=0.8, memory=7)


def assert_same(task, learner, steps, shaping, *, seed=0):
    """Equal to the last bit; without a time limit a turn ends after 3 / (1 - discount) steps."""
    mdp = task.mdp
    cut = mdp.time_limit is None and mdp.discount < 1
    turn = round(3 / (1 - mdp.discount)) if cut else np.inf
    options = {"shaping": shaping, "eval_freq": 50}
    result = cr.learn(task, learner, steps, seeds=[seed], **options)
    naive = learn_naively(task, learner, steps, seed=seed, turn=turn, **options)
    np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)
    np.testing.assert_array_equal(result.source_share[0], naive.source_share)
    np.testing.assert_array_equal(result.episodes[0], naive.episodes)
    return result, naive


@pytest.mark.parametrize("time_limit", [None, 5])
@pytest.mark.parametrize(("way", "kind"), PAIRS)
def test_guarded_learning_equals_the_naive_one(way, kind, time_limit, random_mdp, random_shaping):
    task = random_mdp(4, time_limit=time_limit)
    learner = kind(learning_rate=0.3, epsilon=0.3, initial_value=0.5)
    shaping = random_shaping(task, way, 1, **WAYS[way])
    shaping = replace(shaping, guard=GUARD)
    result, naive = assert_same(task, learner, 1500, shaping)
    assert {acting for acting, _, _ in naive.turns} == {0, 1}
    assert result.own_rewards[0] == (shaping.own_rewards or not naive.ahead)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate", [0.5, cr.learning.harmonic(0.9, 0.05, half=20)])
@pytest.mark.parametrize("kind", [cr.QLearning, cr.DoubleQLearning])
def test_other_tasks_guards_and_rates(kind, rate, seed, random_mdp, random_shaping):
    task = random_mdp(seed, time_limit=[None, 6][seed % 2], discount=[0.5, 1.0][seed % 2])
    guard = Guard(share_behind=[0.1, 0.5][seed % 2], share_ahead=0.6, memory=2 + seed)
    shaping = random_shaping(task, cr.QInitialisation, seed, guard=guard)
    _, naive = assert_same(task, kind(learning_rate=rate, epsilon=0.2), 1500, shaping, seed=seed)
    assert {acting for acting, _, _ in naive.turns} == {0, 1}


@pytest.mark.parametrize("kind", LEARNERS)
def test_turns_of_a_task_without_episodes(kind, endless, random_shaping):
    """At discount 0.9 a turn has 30 steps."""
    shaping = random_shaping(endless, cr.QInitialisation, 2, guard=GUARD)
    learner = kind(learning_rate=0.3, epsilon=0.3)
    _, naive = assert_same(endless, learner, 1500, shaping)
    assert [length for _, _, length in naive.turns[:-1]] == [30] * 50


@pytest.fixture(scope="module")
def endless():
    rng = np.random.default_rng(3)
    p = rng.integers(1, 5, (4, 3, 4))
    p = p / p.sum(axis=2, keepdims=True)
    return cr.FiniteMDP.from_dense(
        p, rng.normal(size=(4, 3, 4)), terminal=np.zeros(4, bool), start=0, discount=0.9
    )


def test_the_bound_of_the_docstring_holds(random_mdp, random_shaping):
    """Steps of the learner with the potential in turns begun while it was not ahead."""
    behind = 0
    for seed in range(12):
        task = random_mdp(seed, time_limit=8)
        guard = Guard(share_behind=[0.05, 0.2][seed % 2], memory=5)
        shaping = random_shaping(task, cr.QInitialisation, seed, guard=guard)
        learner = cr.QLearning(learning_rate=0.2, epsilon=0.2)
        _, naive = assert_same(task, learner, 2000, shaping, seed=seed)
        without = [(acting, length) for acting, ahead, length in naive.turns if not ahead]
        steps, of_shaped = sum(n for _, n in without), sum(a * n for a, n in without)
        longest = max(n for acting, _, n in naive.turns if acting)
        assert of_shaped <= guard.share_behind * steps + 3 * longest
        behind += steps
    assert behind > 2000


@pytest.mark.parametrize("kind", LEARNERS)
def test_the_table_handed_on_is_the_one_evaluated_last(kind, random_mdp, random_shaping):
    task = random_mdp(3, time_limit=10)
    shaping = random_shaping(task, cr.StateShaping)
    shaping = replace(shaping, guard=Guard())
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
