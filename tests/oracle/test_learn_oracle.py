"""The compiled learning loops against a learner in plain Python, draw for draw."""

import numpy as np
import pytest

import curricle as cr
from curricle.learning.schedules import constant

LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]
EXPLORATIONS = [{"epsilon": 0.2}, {"inverse_temperature": 2.0}]
SCHEDULES = {
    "constant": constant(0.3),
    "linear": cr.learning.linear(0.9, 0.1, steps=700),
    "exponential": cr.learning.exponential(0.9, 0.1, half_life=300),
    "harmonic": cr.learning.harmonic(0.9, 0.05, half=20),
}
STEPS, EVERY = 1500, 100


def assert_same(result, naive, *, exact=True):
    """Equal to the last bit, or to 1e-12 where an exponential may round differently."""
    if exact:
        np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_allclose(result.values[0], naive.values, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)
    np.testing.assert_array_equal(result.episodes[0], naive.episodes)
    assert result.steps_used[0] == naive.steps_used
    assert result.episodes_used[0] == naive.episodes_used


@pytest.mark.parametrize("time_limit", [None, 4])
@pytest.mark.parametrize("exploration", EXPLORATIONS, ids=["greedy", "softmax"])
@pytest.mark.parametrize("kind", LEARNERS)
def test_learner_equals_the_naive_one(kind, exploration, time_limit, random_mdp, naive_learn):
    task = random_mdp(1, time_limit=time_limit)
    learner = kind(learning_rate=0.3, **exploration)
    result = cr.learn(task, learner, STEPS, eval_freq=EVERY, stream="x")
    naive = naive_learn(task, learner, STEPS, eval_freq=EVERY, stream="x")
    assert_same(result, naive, exact=kind is not cr.ExpectedSARSA or "epsilon" in exploration)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", LEARNERS)
def test_learner_equals_the_naive_one_on_other_shapes(kind, seed, random_mdp, naive_learn):
    shape = {"n_states": 3 + 3 * seed, "n_actions": 1 + seed, "width": 1 + seed % 3}
    task = random_mdp(seed, time_limit=20, discount=[0.0, 0.5, 1.0][seed % 3], **shape)
    learner = kind(learning_rate=0.5, epsilon=0.5, initial_value=seed - 2.0)
    result = cr.learn(task, learner, 400, eval_freq=7, seeds=[seed])
    assert_same(result, naive_learn(task, learner, 400, eval_freq=7, seed=seed))


@pytest.mark.parametrize("kind", [cr.QLearning, cr.SARSA, cr.DoubleQLearning])
@pytest.mark.parametrize("name", SCHEDULES)
def test_schedules_of_the_learning_rate(name, kind, random_mdp, naive_learn):
    task, learner = random_mdp(2, time_limit=9), kind(learning_rate=SCHEDULES[name])
    assert_same(
        cr.learn(task, learner, STEPS, eval_freq=EVERY),
        naive_learn(task, learner, STEPS, eval_freq=EVERY),
        exact=name != "exponential",
    )


@pytest.mark.parametrize("setting", ["epsilon", "inverse_temperature"])
@pytest.mark.parametrize("kind", [cr.QLearning, cr.ExpectedSARSA])
@pytest.mark.parametrize("name", SCHEDULES)
def test_schedules_of_exploration(name, kind, setting, random_mdp, naive_learn):
    task, learner = random_mdp(3, time_limit=9), kind(**{setting: SCHEDULES[name]})
    assert_same(
        cr.learn(task, learner, STEPS, eval_freq=EVERY),
        naive_learn(task, learner, STEPS, eval_freq=EVERY),
        exact=kind is cr.QLearning or (setting == "epsilon" and name != "exponential"),
    )


SHAPINGS = {
    cr.QInitialisation: {},
    cr.LookAheadAdvice: {},
    cr.RewardBonus: {},
    cr.StateShaping: {
        "frame_steps": (0, 13, 700),
        "weight": cr.learning.linear(0.5, 2.0, steps=900),
    },
}


@pytest.mark.parametrize("time_limit", [None, 5])
@pytest.mark.parametrize("kind", LEARNERS)
@pytest.mark.parametrize("way", SHAPINGS)
def test_shapings(way, kind, time_limit, random_mdp, random_shaping, naive_learn):
    task = random_mdp(4, time_limit=time_limit)
    learner = kind(learning_rate=0.2, epsilon=0.3)
    options = {"shaping": random_shaping(task, way, **SHAPINGS[way]), "eval_freq": EVERY}
    result = cr.learn(task, learner, STEPS, **options)
    assert_same(result, naive_learn(task, learner, STEPS, **options))


@pytest.mark.parametrize("kind", LEARNERS)
def test_budget_in_episodes(kind, random_mdp, naive_learn):
    task, learner = random_mdp(6, time_limit=11), kind()
    result = cr.learn(task, learner, cr.Episodes(90), eval_freq=10)
    naive = naive_learn(task, learner, 10**9, episodes=90, eval_freq=10)
    assert result.episodes_used[0] == 90
    assert_same(result, naive)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rate", [0.5, 1.0])
def test_fast_loop_breaks_ties_like_the_naive_learner(rate, seed, naive_learn):
    # Whole-number rewards and learning rates keep rows full of ties all along.
    maze = cr.GridWorld(["S....", ".P.P.", "....T"])
    learner = cr.QLearning(learning_rate=rate, epsilon=0.3)
    result = cr.learn(maze, learner, 5000, seeds=[seed], eval_freq=EVERY)
    assert_same(result, naive_learn(maze, learner, 5000, eval_freq=EVERY, seed=seed))


@pytest.mark.parametrize("exploration", EXPLORATIONS, ids=["greedy", "softmax"])
@pytest.mark.parametrize("kind", [cr.QLearning, cr.SARSA, cr.ExpectedSARSA])
@pytest.mark.parametrize("seed", range(4))
def test_literal_look_ahead_advice_is_look_ahead_advice(
    seed, kind, exploration, random_mdp, random_shaping, naive_learn
):
    # phi is continuous, so no two acting values tie and rounding alone never changes an action.
    task = random_mdp(10 + seed, n_states=5, time_limit=[None, 8][seed % 2])
    shaping = random_shaping(task, cr.LookAheadAdvice, seed)
    learner = kind(learning_rate=0.1, **exploration)
    result = cr.learn(task, learner, 3000, shaping=shaping)
    naive = naive_learn(task, learner, 3000, shaping=shaping, literal=True)
    np.testing.assert_allclose(result.values[0], naive.values, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)


def propagate(task, values, horizon, *, discounted):
    """Return the greedy policy's return by matrix products over the states."""
    mdp, policy = task.mdp, cr.planning.greedy_policy(values)
    n_states, n_actions = policy.shape
    step, pay = np.zeros((n_states, n_states)), np.zeros(n_states)
    for s in range(n_states):
        for a in range(n_actions):
            row = mdp.outcome_row[s, a]
            np.add.at(step[s], mdp.next_state[row], policy[s, a] * mdp.probability[row])
            pay[s] += policy[s, a] * (mdp.probability[row] @ mdp.reward[row])
    step[mdp.terminal], pay[mdp.terminal] = 0.0, 0.0
    mass, total = mdp.start, 0.0
    for t in range(horizon):
        total += (mdp.discount**t if discounted else 1.0) * (mass @ pay)
        mass = mass @ step
    return total


@pytest.mark.parametrize("discounted", [True, False])
@pytest.mark.parametrize("seed", range(10))
def test_exact_greedy_return_equals_propagation(seed, discounted, random_mdp):
    task = random_mdp(seed, time_limit=3 + 5 * seed, n_states=8)
    evaluation = cr.GreedyEvaluation(method="exact", discounted=discounted)
    # A whole-number table has ties; a rate of 0 keeps it.
    table = np.random.default_rng(seed).integers(0, 2, size=(8, 3))
    result = cr.learn(
        task, cr.QLearning(learning_rate=0.0), 10, evaluation=evaluation,
        shaping=cr.QInitialisation(cr.StateActionPotential(task, table)),
    )  # fmt: skip
    expected = propagate(task, table, task.time_limit, discounted=discounted)
    np.testing.assert_allclose(result.greedy_return[0], expected, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("way", [cr.QInitialisation, cr.StateShaping])
def test_greedy_return_is_that_of_the_values_acted_on(way, random_mdp, random_shaping):
    task = random_mdp(8, time_limit=15)
    shaping = random_shaping(task, way)
    result = cr.learn(task, cr.SARSA(), 500, shaping=shaping)
    expected = propagate(task, result.values[0], 15, discounted=True)
    assert result.greedy_return[0, -1] == pytest.approx(expected, abs=1e-8)


def test_rollouts_agree_with_exact_evaluation(random_mdp):
    # One test of 40 means of 2,000 episodes each, 5 standard errors: a false alarm in 4e4 seeds.
    task = random_mdp(9, time_limit=12, n_states=8)
    settings = {"seeds": 40, "eval_freq": 1}
    learner = cr.QLearning(learning_rate=0.0)
    rollouts = cr.GreedyEvaluation(method="rollouts", episodes=2000)
    exact = cr.learn(task, learner, 1, evaluation=cr.GreedyEvaluation(method="exact"), **settings)
    rough = cr.learn(task, learner, 1, evaluation=rollouts, **settings).greedy_return[:, 0]
    error = rough.std(ddof=1) / np.sqrt(len(rough))
    assert 0 < error < 0.02
    assert abs(rough.mean() - exact.greedy_return[0, 0]) < 5 * error
