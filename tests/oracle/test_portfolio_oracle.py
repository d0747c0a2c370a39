"""Portfolios against members in plain Python, draw for draw."""

import numpy as np
import pytest

import curricle as cr

from .conftest import INFORMED, OPTIMIST, SOBER, SOURCE, play_portfolio_naively

STEPS = 1500


def assert_same(
    task, phi, steps=STEPS, *, seed=0, portfolio=None, way=cr.QInitialisation, bounds=()
):
    """Equal to the last bit."""
    portfolio = portfolio or cr.Portfolio()
    bounds = cr.learning.value_bounds(task) if bounds == () else bounds
    shaping = way(phi, portfolio=portfolio)
    result = cr.learn(task, budget=steps, seeds=[seed], shaping=shaping, eval_freq=50)
    known = np.where(phi.unknown, np.nan, phi.values) if hasattr(phi, "unknown") else phi
    naive = play_portfolio_naively(
        task, steps, known, portfolio, bounds=bounds, seed=seed, eval_freq=50
    )
    np.testing.assert_array_equal(result.values[0], naive.values)
    np.testing.assert_array_equal(result.training_return[0], naive.training_return)
    np.testing.assert_array_equal(result.source_share[0], naive.source_share)
    np.testing.assert_array_equal(result.episodes[0], naive.episodes)
    return naive


def drawn(task, seed=0):
    """Return values near Q* or anything, of the task's pairs."""
    rng = np.random.default_rng([seed, 1])
    noise = rng.normal(size=task.mdp.outcome_row.shape)
    if task.mdp.discount < 1 and seed % 2 == 0:
        noise = cr.solve(task).action_values + 0.1 * noise
    return np.where(task.mdp.terminal[:, None], 0.0, noise)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("way", [cr.QInitialisation, cr.LookAheadAdvice])
def test_a_portfolio_equals_the_naive_one(way, seed, random_mdp):
    task = random_mdp(seed, time_limit=[None, 6][seed % 2], discount=[0.5, 0.9, 1.0][seed % 3])
    if task.mdp.discount == 1 and task.mdp.time_limit is None:
        task = random_mdp(seed, time_limit=9, discount=1.0)
    portfolio = cr.Portfolio(margin=[0.1, 0.0, 2.0][seed % 3], optimist=[0.7, 0.3][seed % 2])
    naive = assert_same(task, drawn(task, seed), seed=seed, portfolio=portfolio, way=way)
    assert all(naive.turns.turns[member] for member in (INFORMED, OPTIMIST, SOBER, SOURCE))


@pytest.mark.parametrize("seed", range(4))
def test_without_bounds_the_lowest_rewards_lower_what_is_not_tried(seed, random_mdp, monkeypatch):
    monkeypatch.setattr("curricle.learning.run.value_bounds", lambda task: None)
    task = random_mdp(seed, time_limit=6, discount=[0.9, 1.0][seed % 2])
    naive = assert_same(task, drawn(task, 2 * seed + 1), seed=seed, bounds=None)
    assert naive.floor < 0
    phi = cr.QInitialisation(drawn(task, 2 * seed + 1), portfolio=cr.Portfolio())
    shown = cr.learn(task, budget=STEPS, seeds=[seed], shaping=phi, snapshots=3)
    live = ~task.mdp.terminal
    np.testing.assert_allclose(shown.snapshots.values[-1, live], shown.values[0, live], atol=1e-5)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_maze_whose_steps_never_differ(sign):
    maze = cr.GridWorld(["....T", ".PPP.", "S...."])
    phi = sign * cr.solve(maze).action_values
    naive = assert_same(maze, phi, 3000)
    assert naive.turns.ahead == (sign == 1)


def test_what_is_handed_on_is_phi_while_it_is_ahead():
    maze = cr.GridWorld(["....T", ".PPP.", "S...."])
    phi = cr.solve(maze).action_values
    shaping = cr.QInitialisation(phi, portfolio=cr.Portfolio())
    result = cr.learn(maze, budget=3000, seeds=4, shaping=shaping, snapshots=4)
    assert (result.source_share[:, -1] == 1).all()
    np.testing.assert_array_equal(result.values, np.broadcast_to(phi, result.values.shape))
    np.testing.assert_allclose(result.snapshots.values[-1], phi, rtol=1e-6)


def test_turns_of_a_task_without_episodes():
    """At discount 0.9 a turn has 30 steps."""
    rng = np.random.default_rng(3)
    p = rng.integers(1, 5, (4, 3, 4))
    p = p / p.sum(axis=2, keepdims=True)
    task = cr.FiniteMDP.from_dense(
        p, rng.normal(size=(4, 3, 4)), terminal=np.zeros(4, bool), start=0, discount=0.9
    )
    naive = assert_same(task, rng.normal(size=(4, 3)))
    assert {length for turns in naive.turns.turns for length, _ in turns} == {30}


@pytest.mark.parametrize("seed", range(4))
def test_unknown_pairs_start_at_the_bound(seed, random_mdp):
    task = random_mdp(seed, time_limit=6)
    values, rng = drawn(task, seed), np.random.default_rng(seed)
    unknown = rng.random(values.shape) < 0.4
    values[unknown] = 0.0
    phi = cr.StateActionPotential(task, values, unknown & ~task.mdp.terminal[:, None])
    assert_same(task, phi, seed=seed)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_far_tables_learn_a_step_later_and_the_same(dtype):
    """Rows that are prefetched are updated during the next step."""
    hunt = cr.Pursuit(size=4, predators=2)
    phi = np.random.default_rng(0).normal(size=(hunt.states.size, hunt.actions.size))
    shaping = cr.QInitialisation(phi, portfolio=cr.Portfolio())
    small = cr.learn(
        hunt, budget=4000, seeds=2, shaping=shaping, storage=cr.Storage(dtype=dtype), eval_freq=1
    )
    large = cr.learn(
        hunt, budget=4000, seeds=2, shaping=shaping, storage=cr.Storage(dtype=dtype), eval_freq=4000
    )
    np.testing.assert_array_equal(small.values, large.values)
