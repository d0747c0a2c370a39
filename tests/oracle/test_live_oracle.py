"""Learning live against learning on the same rules as tables."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import curricle as cr
from tests.support.worlds_to_tabulate import Written

LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]
SHAPINGS = [
    cr.QInitialisation,
    cr.LookAheadAdvice,
    cr.RewardBonus,
    cr.StateShaping,
    partial(cr.QInitialisation, portfolio=cr.Portfolio()),
]
ROLLED = cr.GreedyEvaluation("rollouts", episodes=3)
STEPS, EVERY = 900, 100


@pytest.fixture
def pair(random_mdp):
    """Return tables without chance, and the same played live."""

    def make(seed, **shape):
        drawn = random_mdp(seed, width=1, n_states=12, **shape)
        mdp = replace(drawn, start=np.eye(12)[0])
        after, reward = (x[mdp.outcome_row, 0] for x in (mdp.next_state, mdp.reward))
        play = partial(Written, after, reward, mdp.terminal)
        horizon = {"discount": mdp.discount, "time_limit": mdp.time_limit}
        return mdp, cr.tasks.LiveMDP(mdp.states, mdp.actions, play, **horizon)

    return make


def assert_same(live, tabled, terminal):
    """To the last bit, but for the values of terminal states, which a live task cannot know."""
    np.testing.assert_array_equal(live.values[:, ~terminal], tabled.values[:, ~terminal])
    assert_same_curves(live, tabled)


def assert_same_curves(live, tabled):
    curves = "training_return", "greedy_return", "episodes", "source_share"
    for name in (*curves, "steps_used", "episodes_used"):
        np.testing.assert_array_equal(getattr(live, name), getattr(tabled, name))


def learn_both(pair, learner, budget=STEPS, **settings):
    mdp, live = pair
    settings = {"eval_freq": EVERY, "seeds": [4, 1], "evaluation": ROLLED, **settings}
    assert_same(
        cr.learn(live, learner, budget, **settings),
        cr.learn(mdp, learner, budget, **settings),
        mdp.terminal,
    )


@pytest.mark.parametrize("kind", LEARNERS)
def test_every_learner_learns_live_what_it_learns_on_tables(kind, pair):
    learn_both(pair(1, time_limit=9), kind(learning_rate=0.3, epsilon=0.2, initial_value=0.7))


@pytest.mark.parametrize("way", SHAPINGS)
def test_every_shaping_and_a_portfolio(way, pair, monkeypatch):
    # Only the rewards of tables bound values.
    monkeypatch.setattr("curricle.learning.run.value_bounds", lambda task: None)
    tasks = pair(2, time_limit=9)
    learner = cr.QLearning(epsilon=0.3)
    shape = (12,) if way is cr.StateShaping else (12, tasks[0].actions.size)
    learn_both(tasks, learner, shaping=way(np.random.default_rng(0).normal(size=shape)))


@pytest.mark.parametrize("kind", ["sparse", "dense"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_portfolio_with_stated_bounds_is_that_of_the_tables(sign, kind, pair):
    """Rows that are added as states are met are those of dense tables of the same rules."""
    mdp, live = pair(2, time_limit=9)
    portfolio, storage = cr.Portfolio(value_range=(-9.0, 9.0)), cr.Storage(kind)
    phi = sign * cr.solve(mdp).action_values
    shaping = cr.QInitialisation(phi, portfolio=portfolio)
    settings = {"eval_freq": EVERY, "seeds": [4, 1], "evaluation": ROLLED, "shaping": shaping}
    tabled = cr.learn(mdp, budget=STEPS, **settings)
    played = cr.learn(live, budget=STEPS, storage=storage, **settings)
    assert tabled.source_share[:, -1].any() == (sign > 0)  # phi is handed on
    if kind == "dense":
        assert_same(played, tabled, mdp.terminal)
        return
    assert_same_curves(played, tabled)
    for seed, met in enumerate(played.values):
        np.testing.assert_array_equal(met.values, tabled.values[seed, met.states])


@pytest.mark.slow
def test_sparse_tables(pair):
    mdp, live = pair(4, time_limit=9)
    storage = cr.Storage("sparse")
    lively, other = (
        cr.learn(task, budget=STEPS, eval_freq=EVERY, storage=storage, evaluation=ROLLED).values[0]
        for task in (live, mdp)
    )
    np.testing.assert_array_equal(lively.states, other.states)
    np.testing.assert_array_equal(lively.values, other.values)


@pytest.mark.parametrize("learner", [cr.QLearning(), cr.DoubleQLearning()])
def test_budgets_in_episodes(learner, pair):
    learn_both(pair(5, time_limit=9), learner, cr.Episodes(70))
