"""learn: budgets, checkpoints, seeds and evaluation. What the updates are, the oracle tests say."""

import numpy as np

import curricle as cr

LINE = cr.GridWorld("S..T")
ARRAYS = ("values", "steps", "training_return", "greedy_return", "episodes", "steps_used")


def same(result, other):
    pairs = ((getattr(result, name), getattr(other, name)) for name in ARRAYS)
    return all(np.array_equal(*pair, equal_nan=True) for pair in pairs)


def test_a_budget_of_steps_is_spent_to_the_last_one():
    result = cr.learn(LINE, budget=1234, seeds=3)
    assert result.steps_used.tolist() == [1234] * 3
    assert result.values.shape == (3, 4, 4)
    assert cr.learn(LINE, budget=1000).steps.tolist() == list(range(0, 1001, 10))
    assert cr.learn(LINE, budget=1000, eval_freq=300).steps.tolist() == [0, 300, 600, 900]
    assert cr.learn(LINE, budget=50).steps.tolist() == list(range(51))
    assert cr.learn(LINE, budget=np.int32(50), seeds=np.int64(1)).steps_used.tolist() == [50]
    assert cr.learn(LINE, budget=5e1).steps_used.tolist() == [50]
    assert cr.learn(LINE, budget=1000, eval_freq=1000).steps.tolist() == [0, 1000]


def test_a_budget_of_episodes_is_spent_exactly():
    result = cr.learn(LINE, budget=cr.Episodes(30), seeds=4, eval_freq=10)
    assert result.episodes_used.tolist() == [30] * 4
    assert len(set(result.steps_used.tolist())) > 1
    assert result.steps[-1] == result.steps_used.max() // 10 * 10
    result = cr.learn(cr.GridWorld("S..T", time_limit=50, ends=()), budget=cr.Episodes(7))
    assert result.steps.tolist() == [0, 100, 200, 300]
    assert result.steps_used.tolist() == [350]


def test_the_last_value_stands_after_a_seed_has_spent_its_episodes():
    result = cr.learn(LINE, budget=cr.Episodes(30), seeds=4, eval_freq=10)
    for k, used in enumerate(result.steps_used):
        taken = result.steps <= used
        last = taken.sum() - 1
        assert (result.greedy_return[k, ~taken] == result.greedy_return[k, last]).all()
        assert (result.episodes[k, ~taken] == result.episodes[k, last]).all()
        assert np.isnan(result.training_return[k, ~taken]).all()
        alone = cr.learn(LINE, budget=cr.Episodes(30), seeds=[k], eval_freq=10)
        assert (alone.greedy_return[0] == result.greedy_return[k, taken]).all()


def test_auto_is_exact_on_small_tasks_and_rolls_out_on_large_ones():
    exact, auto = cr.GreedyEvaluation("exact"), cr.GreedyEvaluation("auto")
    assert same(
        cr.learn(LINE, budget=200, evaluation=exact), cr.learn(LINE, budget=200, evaluation=auto)
    )
    large, rolled = cr.Pursuit(size=3, predators=2), cr.GreedyEvaluation("rollouts")
    assert large.mdp.outcome_row.size * 5 > 20_000
    assert same(
        cr.learn(large, budget=50, eval_freq=50, evaluation=rolled),
        cr.learn(large, budget=50, eval_freq=50, evaluation=auto),
    )


def test_each_seed_may_have_its_own_potential():
    low, high = (cr.StateActionPotential(LINE, np.full((4, 4), v)) for v in (1.0, 2.0))
    frozen = cr.QLearning(learning_rate=0)
    for shaping, expected in (
        ([cr.QInitialisation(low), cr.QInitialisation(high)], [1, 2]),
        (cr.QInitialisation(low), [1, 1]),
    ):
        result = cr.learn(LINE, frozen, 10, seeds=2, shaping=shaping)
        assert result.values[:, 0, 0].tolist() == expected
