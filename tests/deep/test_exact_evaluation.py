"""Exact evaluation of networks: what many rollouts tend to, in curricula and in study files."""

import numpy as np
import pytest

import curricle as cr
from curricle.deep import exact_evaluation
from curricle.errors import SettingError
from curricle.planning.solution import expected_return
from curricle.study import StudyResults, read_study, run_study
from curricle.transfer.observation_rollouts import target_of

LIMIT, RESETS = 12, 3
LAKE = cr.observation_task("FrozenLake-v1", is_slippery=False, time_limit=LIMIT)
SLIPPERY = cr.observation_task("FrozenLake-v1", time_limit=LIMIT, discount=0.9)
PPO = cr.deep.DeepLearner(
    "PPO",
    settings={"n_steps": 64, "ent_coef": 0.05, "policy_kwargs": {"net_arch": [16]}},
)
DQN = cr.deep.DeepLearner(
    "DQN", settings={"learning_starts": 20, "policy_kwargs": {"net_arch": [16]}}
)


def exact(**settings):
    return cr.GreedyEvaluation("exact", episodes=RESETS, **settings)


def returns_of_rollouts(task, values, evaluation, episodes):
    """Return the returns of episodes in the environment, one after another."""
    returns, discount = [], evaluation.discount(task)
    environment = task.environment()
    for k in range(episodes):
        observation, _ = environment.reset(seed=k)
        total, weight, over = 0.0, 1.0, False
        while not over:
            action = values.act(np.array([observation]), sampled=evaluation.sampled)[0]
            observation, reward, terminated, truncated, _ = environment.step(action)
            total, weight, over = (
                total + weight * reward,
                weight * discount,
                terminated or truncated,
            )
        returns.append(total)
    return np.array(returns)


@pytest.fixture(scope="module")
def network():
    """A network that has learnt a little, so that it goes somewhere."""
    unseen = cr.GreedyEvaluation("off")
    return cr.deep.learn_deep(SLIPPERY, PPO, 1500, evaluation=unseen).values[0]


@pytest.mark.parametrize("discounted", [None, True])
@pytest.mark.parametrize("sampled", [True, False])
def test_it_is_the_mean_of_many_rollouts(network, sampled, discounted):
    """False alarm below 1e-5: the mean lies within 4.5 standard errors."""
    evaluation = exact(sampled=sampled, discounted=discounted)
    table = exact_evaluation.evaluation_table(SLIPPERY, evaluation)
    found = exact_evaluation.exact_return(table, network, evaluation, SLIPPERY)
    returns = returns_of_rollouts(SLIPPERY, network, evaluation, 3000)
    error = returns.std() / np.sqrt(len(returns))
    assert error > 0
    assert abs(found - returns.mean()) < 4.5 * error


@pytest.mark.parametrize("learner", [PPO, DQN])
def test_where_nothing_is_random_it_is_the_return_of_rollouts_to_the_bit(learner):
    """And learning does not depend on how it is evaluated."""
    settings = {"eval_freq": 50, "seeds": 2}
    by_rollouts = cr.deep.learn_deep(LAKE, learner, 200, **settings)
    result = cr.deep.learn_deep(LAKE, learner, 200, evaluation=exact(), **settings)
    assert np.array_equal(result.greedy_return, by_rollouts.greedy_return)
    assert np.array_equal(result.training_return, by_rollouts.training_return, equal_nan=True)
    assert result.evaluation_steps.tolist() == [0, 0]
    assert (by_rollouts.evaluation_steps > 0).all()


def test_a_network_without_probabilities_is_greedy():
    greedy, drawn = (
        cr.deep.learn_deep(SLIPPERY, DQN, 100, evaluation=exact(sampled=sampled)).greedy_return
        for sampled in (False, True)
    )
    assert np.array_equal(greedy, drawn)


def test_the_environment_is_tabulated_once(monkeypatch):
    exact_evaluation._tabulated.cache_clear()
    asked = []
    made = exact_evaluation.tabulate
    monkeypatch.setattr(
        exact_evaluation, "tabulate", lambda *a, **k: asked.append(k["seeds"]) or made(*a, **k)
    )
    for _ in range(2):
        cr.deep.learn_deep(SLIPPERY, PPO, 128, seeds=2, evaluation=exact())
    assert asked == [RESETS]


def test_minigrid_pays_its_own_reward():
    """1 - 0.9 t / T: five steps are the shortest way, two ahead, a turn, and two ahead."""
    pytest.importorskip("minigrid")
    see = cr.interop.MiniGridView()
    task = cr.observation_task("MiniGrid-Empty-5x5-v0", encode=see, max_steps=20)
    table = exact_evaluation.evaluation_table(task, exact())
    best = expected_return(table, cr.solve(table).policy, discount=1.0, horizon=20)
    environment = task.environment()
    environment.reset(seed=0)
    rewards = [float(environment.step(action)[1]) for action in (2, 2, 1, 2, 2)]
    assert best == pytest.approx(sum(rewards)) == pytest.approx(1 - 0.9 * 5 / 20)


def test_what_has_no_tables_is_refused_before_anything_is_learnt():
    swing = cr.observation_task("Pendulum-v1", time_limit=20)
    with pytest.raises(SettingError, match=r"'rollouts'\): actions must be numbered from 0"):
        cr.deep.learn_deep(swing, PPO, 64, evaluation=exact())
    pytest.importorskip("minigrid")
    see = cr.interop.MiniGridView()
    moving = cr.observation_task("MiniGrid-Dynamic-Obstacles-5x5-v0", encode=see)
    learnt = []
    plan = cr.Curriculum(
        {"lake": SLIPPERY, "moving": moving},
        learner=PPO,
        budget=64,
        evaluation={"lake": cr.GreedyEvaluation("rollouts"), "moving": exact()},
    )
    for only in (None, "lake"):
        with pytest.raises(SettingError, match=r"'rollouts'\): steps must be deterministic"):
            plan.train(only=only, progress=learnt.append)
    assert learnt == []


STUDY = """
name = "lakes"
seeds = 1
[learner]
type = "deep"
algorithm = "PPO"
settings = { n_steps = 64, policy_kwargs = { net_arch = [8] } }
[tasks.dry]
type = "observation_task"
id = "FrozenLake-v1"
arguments = { is_slippery = false }
budget = 128
[tasks.lake]
type = "observation_task"
id = "FrozenLake-v1"
budget = 256
eval_freq = 64
evaluation = { method = "exact", episodes = 3, sampled = true }
[[transfers]]
source = "dry"
target = "lake"
mapping = "identity"
"""


def test_a_study_evaluates_exactly(tmp_path):
    file = tmp_path / "lakes.toml"
    file.write_text(STUDY)
    run_study(read_study(file), tmp_path / "results")
    stored = StudyResults(tmp_path / "results")
    result = stored.result("transfer", "lake")
    assert np.isfinite(result.greedy_return).all()
    assert (result.greedy_return > 0).any()  # exact: less than what 3 rollouts can tell from 0
    assert not result.evaluation_steps.any()


def test_a_comparison_evaluates_exactly_with_random_returns_in_the_same_units():
    plan = cr.Curriculum(
        {"dry": LAKE, "lake": SLIPPERY},
        [cr.Transfer("dry", "lake")],
        learner=PPO,
        budget={"dry": 128, "lake": 256},
        eval_freq=64,
        evaluation={"lake": exact(sampled=True)},
    )
    found = cr.compare(plan, seeds=1)
    table = exact_evaluation.evaluation_table(SLIPPERY, exact())
    uniform = np.full((table.states.size, 4), 0.25)
    by_tables = expected_return(table, uniform, discount=1.0, horizon=LIMIT)
    # A network begins close to uniform: three rollouts would say 0, or a third.
    assert found.arms["scratch"].curve.values[0, 0] == pytest.approx(by_tables, abs=0.01)
    random_return = target_of(SLIPPERY, exact(), episodes=4000).random_return
    assert random_return == pytest.approx(by_tables, abs=0.01)
