"""Stopping rules end a run at the right checkpoint, give the reason, and change nothing before."""

from functools import partial

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

import curricle as cr
from curricle.errors import SettingError
from curricle.learning.stopping import stops
from tests.support.refusals import check_values

MAZE = cr.GridWorld(["S...", "..P.", "...T"])
LEARNERS = [(cr.QLearning(), None), (cr.QLearning(), cr.Portfolio()), (cr.SARSA(), None)]


def oracle(rule: cr.StoppingRule, greedy: list[float], checkpoint: int, step: int) -> bool:
    """The rule in plain words, written anew."""
    n = rule.patience
    last = greedy[: checkpoint + 1][-n:]
    reached = len(last) == n and all(value >= rule.threshold for value in last)
    return reached and step > 0 and step >= rule.min_steps


@given(
    greedy=st.lists(st.integers(-5, 5).map(float) | st.just(np.nan), min_size=1, max_size=12),
    value=st.integers(-5, 5).map(float),
    evaluations=st.integers(1, 4),
    least=st.integers(0, 60),
)
@example(greedy=[0.0, 0.0, 5.0], value=3.0, evaluations=2, least=0)
def test_rule_is_what_the_docstring_says(greedy, value, evaluations, least):
    """An unknown return among the last reaches no level."""
    rule = cr.StoppingRule(100, min_steps=least, threshold=value, patience=evaluations)
    unknown = np.full(len(greedy), np.nan)
    for checkpoint in range(len(greedy)):
        ends = stops(rule.kernel(), np.array(greedy), unknown, checkpoint, 10 * checkpoint)
        assert ends == oracle(rule, greedy, checkpoint, 10 * checkpoint)


@pytest.mark.parametrize(("learner", "portfolio"), LEARNERS)
def test_a_stopped_run_is_the_beginning_of_the_whole_one(learner, portfolio):
    settings = {"eval_freq": 50, "seeds": 4}
    if portfolio:
        phi = np.full(MAZE.mdp.outcome_row.shape, 5.0)
        settings["shaping"] = cr.QInitialisation(phi, portfolio=portfolio)
    whole = cr.learn(MAZE, learner, 4000, **settings)
    rule = cr.StoppingRule(4000, threshold=150.0, patience=3)
    stopped = cr.learn(MAZE, learner, rule, **settings)
    ended = False
    for k in range(4):
        steps = int(stopped.steps_used[k])
        n = steps // 50 + 1
        np.testing.assert_array_equal(stopped.greedy_return[k, :n], whole.greedy_return[k, :n])
        np.testing.assert_array_equal(stopped.training_return[k, :n], whole.training_return[k, :n])
        decisions = rule.decisions(stopped.steps, stopped.greedy_return[k], used=steps)
        assert decisions[-1].step == steps
        assert [d.ends for d in decisions[:-1]] == [False] * (len(decisions) - 1)
        assert decisions[-1].ends or steps == 4000
        assert not stopped.out_of_memory[k]
        ended |= decisions[-1].ends
        shorter = cr.learn(MAZE, learner, steps, **{**settings, "seeds": [k]})
        np.testing.assert_array_equal(shorter.values[0], stopped.values[k])
    assert ended


def test_fraction_stands_for_a_return_between_random_and_optimal():
    whole = cr.learn(
        MAZE, budget=cr.StoppingRule(20_000, fraction=0.9, patience=2), eval_freq=100, seeds=3
    )
    assert (whole.steps_used < 20_000).all()
    last = whole.greedy_return[:, -1]
    optimum = cr.learn(MAZE, budget=40_000, eval_freq=40_000).greedy_return[0, -1]
    assert (last > 0.8 * optimum).all()
    with pytest.raises(SettingError, match="not both"):
        cr.StoppingRule(10, threshold=1.0, fraction=0.5)


def test_every_policy_reaches_a_fraction_where_all_are_optimal():
    rng = np.random.default_rng(0)
    for _ in range(10):  # rounding puts some optima above the random policy's return, some below
        p, r = rng.dirichlet(np.ones(4), size=(4, 1)), rng.normal(size=(4, 1))
        equal = cr.FiniteMDP.from_dense(
            p.repeat(3, axis=1), r.repeat(3, axis=1), terminal=[False] * 4, start=0, discount=0.9,
            time_limit=50,
        )  # fmt: skip
        rule = cr.StoppingRule(1000, fraction=1.0, patience=2)
        assert cr.learn(equal, budget=rule, eval_freq=10).steps_used.tolist() == [10]


def test_without_the_discount_an_optimum_may_lie_below_random_play():
    # 1 and the end at once, or 5 in three steps, which the discount makes the worse.
    ways = [[(1.0, 4, 1.0, True)], [(1.0, 1, 0.0, False)]]
    later = [
        [[(1.0, 2, 0.0, False)]] * 2,
        [[(1.0, 3, 0.0, False)]] * 2,
        [[(1.0, 4, 5.0, True)]] * 2,
    ]
    task = cr.FiniteMDP.from_outcomes(
        [ways, *later, [[], []]], start=0, discount=0.5, time_limit=50
    )
    settings = {"evaluation": cr.GreedyEvaluation(discounted=False), "seeds": 2}
    result = cr.learn(task, budget=cr.StoppingRule(1000, settled=0.05), **settings)
    assert result.floor.tolist() == [-np.inf] * 2
    with pytest.raises(SettingError, match="they return 1 and 3; give a return instead"):
        cr.learn(task, budget=cr.StoppingRule(1000, fraction=0.5), **settings)


def test_a_rule_that_makes_no_sense_is_refused():
    nan = float("nan")
    check_values(SettingError, cr.StoppingRule, {"max_steps": [0]})
    wrong = {"min_steps": [11], "settled": [-0.1, "much"], "patience": [0], "fraction": [1.5]}
    wrong["threshold"] = [nan]
    check_values(SettingError, partial(cr.StoppingRule, 10), wrong)


def test_snapshots_hold_the_policy_at_their_steps():
    result = cr.learn(MAZE, budget=2000, eval_freq=100, seeds=[3, 4], snapshots=5)
    snapshots = result.snapshots
    assert snapshots.seed == 3
    assert snapshots.steps[[0, -1]].tolist() == [0, 2000]
    np.testing.assert_array_equal(snapshots.values[-1], result.values[0].astype(np.float32))
    for step, values in zip(snapshots.steps[1:], snapshots.values[1:], strict=True):
        then = cr.learn(MAZE, budget=int(step), eval_freq=100, seeds=[3])
        np.testing.assert_array_equal(values, then.values[0].astype(np.float32))


def test_snapshots_of_stopped_and_shaped_runs_end_with_what_was_learnt():
    phi = cr.StatePotential(MAZE, np.where(MAZE.mdp.terminal, 0.0, 7.0))
    rule = cr.StoppingRule(5000, threshold=150.0, patience=1)
    result = cr.learn(MAZE, budget=rule, eval_freq=50, snapshots=6, shaping=cr.StateShaping(phi))
    assert result.snapshots.steps[-1] == result.steps_used[0]
    np.testing.assert_allclose(result.snapshots.values[-1], result.values[0], rtol=1e-6)
    assert cr.learn(MAZE, budget=100).snapshots is None


def test_the_steps_of_evaluations_are_counted_and_said_to_be_free():
    rule = cr.StoppingRule(max_steps=500, threshold=1e9)
    exact, rolled = (
        cr.Curriculum(
            {"maze": MAZE},
            budget=rule,
            eval_freq=100,
            evaluation=cr.GreedyEvaluation(method, episodes=7),
        ).train(seeds=2)
        for method in ("exact", "rollouts")
    )
    assert exact["maze"].evaluation_steps.tolist() == [0, 0]
    assert str(exact.decisions("maze")[0][-1]).endswith("500 of at most 500 steps used")
    steps = int(rolled["maze"].evaluation_steps[1])
    assert 6 * 7 <= steps <= 6 * 7 * MAZE.mdp.time_limit
    assert repr(exact.decisions("maze")) == "Decisions(2 seeds: all steps used (2))"
    sentence = f"500 steps used, and {steps:,} steps of evaluations, which are free"
    assert str(rolled.decisions("maze")[1][-1]).endswith(sentence)
    assert rolled["maze"].steps_used.tolist() == [500, 500]


@pytest.mark.parametrize("limit", [None, 1000])
def test_a_goal_beyond_the_discount_is_no_goal_that_is_reached(limit):
    n = 200  # steps to the only reward, of which 0.9^199 is left
    moves, reward = np.zeros((n + 1, 2, n + 1)), np.zeros((n + 1, 2))
    for state in range(n):
        moves[state, 0, state + 1] = moves[state, 1, max(state - 1, 0)] = 1
    moves[n, :, n], reward[n - 1, 0] = 1, 1e9
    far = cr.FiniteMDP.from_dense(
        moves, reward, terminal=np.arange(n + 1) == n, start=0, discount=0.9, time_limit=limit
    )
    rule = cr.StoppingRule(2_000, fraction=0.9)
    if limit is None:
        with pytest.raises(SettingError, match="needs a time limit"):
            cr.learn(far, budget=rule)
        return
    solution = cr.solve(far)
    assert cr.learn(far, budget=rule).steps_used[0] == 2_000
    known = cr.QInitialisation(cr.StateActionPotential(far, solution.action_values))
    informed = cr.learn(far, budget=rule, shaping=known)
    assert informed.greedy_return[0, 0] == pytest.approx(solution.start_value, rel=1e-6)
    assert informed.steps_used[0] < 2_000


def test_decisions_end_with_the_steps_that_a_seed_took():
    rule, curve = cr.StoppingRule(200, settled=None), [0.0, 1.0, 1.0, 1.0]
    decided = rule.decisions([0, 50, 100, 150], curve, used=60)
    assert [decision.step for decision in decided] == [0, 50]
    assert len(rule.decisions([0, 50, 100, 150], curve)) == 4


def test_an_evaluation_that_would_seem_to_hang_is_refused():
    stay = cr.FiniteMDP.from_dense(
        [[[1, 0.0], [0, 1.0]], [[0, 1], [0, 1.0]]],
        [[0.0, -1.0], [0, 0]],
        terminal=[False, True],
        start=0,
        discount=0.999999,
    )
    with pytest.raises(SettingError, match=r"discount 0\.999999 needs a time limit"):
        cr.learn(stay, budget=100)
