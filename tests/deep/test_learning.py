"""Training deep learners: curves, budgets, stopping and shapings."""

import random
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback

import curricle as cr
from curricle.deep import models
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues, acting
from curricle.errors import CurriculumError
from curricle.tasks.kernel import splitmix64, stream_start
from curricle.transfer import FunctionValues, ObservationPotential
from curricle.transfer.rollouts import Environments, mean_episode_return

from .worlds import ACTOR as PPO, MAZE, generator_states, one_hot, table_potential

QUICK = {"learning_starts": 20, "train_freq": 4, "policy_kwargs": {"net_arch": [16]}}
DQN = cr.deep.DeepLearner("DQN", settings={**QUICK, "learning_rate": 1e-3})


@pytest.fixture(scope="module")
def observed():
    return one_hot(MAZE)


def parts(values):
    return [values.parameters()[name] for name in sorted(values.parameters())]


def test_checkpoints_between_the_steps_of_many_environments_are_recorded(observed):
    many = cr.deep.DeepLearner("DQN", envs=8, settings=QUICK)
    result = cr.deep.learn_deep(observed, many, 20, seeds=2, eval_freq=1)
    assert result.steps_used.tolist() == [24, 24]
    assert result.steps.tolist() == list(range(25))
    assert np.isfinite(result.greedy_return).all()


def test_a_seed_depends_on_nothing_but_itself_and_leaves_no_trace(observed):
    torch.manual_seed(1)
    before = generator_states()
    alone = cr.deep.learn_deep(observed, DQN, 200, seeds=[3])
    after = generator_states()
    assert random.getstate() == before[0]
    assert torch.equal(before[2], after[2])
    random.seed(5)
    both = cr.deep.learn_deep(observed, DQN, 200, seeds=[8, 3])
    assert np.array_equal(alone.greedy_return[0], both.greedy_return[1])
    for part, other in zip(parts(alone.values[0]), parts(both.values[1]), strict=True):
        assert np.array_equal(part, other)


def test_a_run_ends_at_its_budget_in_steps_or_episodes(observed):
    assert cr.deep.learn_deep(observed, PPO, 150).steps_used.tolist() == [150]
    counted = cr.deep.learn_deep(observed, DQN, cr.Episodes(4))
    assert counted.episodes_used.tolist() == [4]
    assert counted.steps_used[0] <= 4 * 30


LAST = [
    (PPO, 64),
    (PPO, 192),
    (cr.deep.DeepLearner("A2C", envs=2, settings={"n_steps": 5}), 10),
    (DQN, 40),
    (cr.deep.DeepLearner("DQN", envs=2, settings={**QUICK, "train_freq": 32}), 64),
]


@pytest.mark.parametrize(("learner", "budget"), LAST)
def test_the_last_rollout_is_learnt_from_and_what_it_taught_is_reported(observed, learner, budget):
    sampled = cr.GreedyEvaluation(episodes=40, sampled=True)
    result = cr.deep.learn_deep(observed, learner, budget, eval_freq=budget, evaluation=sampled)
    start = stream_start(0, "")
    with models.isolated(1):
        alone = model_for(observed, learner, seed=splitmix64(start) >> 33, steps=budget)
        before = NetworkValues(alone.policy).parameters()
        alone.learn(budget)
        environments = Environments(observed, 40, sampled.horizon(observed))
        act = acting(alone.policy, environments.environments, sampled=True)
        with models.isolated(seed=splitmix64(start ^ 2)):
            episodes = environments.rollouts(act, splitmix64(start ^ 2))
    learnt = result.values[0].parameters()
    for name, wanted in NetworkValues(alone.policy).parameters().items():
        assert np.array_equal(learnt[name], wanted)
    assert any(not np.array_equal(learnt[name], before[name]) for name in before)
    assert result.steps_used.tolist() == [budget]
    assert result.greedy_return[0, -1] == mean_episode_return(episodes, 1.0)


def test_a_stopping_rule_ends_a_run_where_it_says(observed):
    rule = cr.StoppingRule(max_steps=2000, threshold=-1e9, patience=2)
    result = cr.deep.learn_deep(observed, DQN, rule, eval_freq=50)
    assert result.steps_used.tolist() == [50]
    assert result.steps.tolist() == [0, 50]
    with pytest.raises(cr.errors.SettingError, match="give a return instead"):
        cr.deep.learn_deep(observed, DQN, cr.StoppingRule(max_steps=2000, fraction=0.5))


def test_charges_are_on_the_budget(observed):
    result = cr.deep.learn_deep(observed, DQN, 300, eval_freq=50, charged=[100])
    assert result.steps_used.tolist() == [200]
    assert np.isfinite(result.greedy_return[0, :5]).all()


def test_ones_own_callbacks_are_called_and_may_end_a_run(observed):
    class Until(BaseCallback):
        def _on_step(self):
            return self.num_timesteps < 120

    learner = cr.deep.DeepLearner("DQN", settings=QUICK, callbacks=lambda: [Until()])
    result = cr.deep.learn_deep(observed, learner, 300, seeds=2)
    assert result.steps_used.tolist() == [120, 120]


def test_weights_and_a_policy_are_carried_over(observed):
    source = cr.deep.learn_deep(observed, DQN, 300).values[0]
    still = {**QUICK, "learning_starts": 10_000}
    learner = cr.deep.DeepLearner("DQN", settings=still)
    carried = cr.deep.learn_deep(
        observed, learner, 50, shaping=cr.deep.WeightTransfer(source)
    ).values[0]
    for part, other in zip(parts(source), parts(carried), strict=True):
        assert np.array_equal(part, other)
    critic = cr.deep.learn_deep(observed, PPO, 100).values[0]
    actor = cr.deep.learn_deep(
        observed, PPO, 64, shaping=cr.deep.PolicyReuse(critic), seeds=[9]
    ).values[0]
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    assert not np.array_equal(actor.v(rows), critic.v(rows))
    layers = {**QUICK, "policy_kwargs": {"net_arch": [8, 8]}}
    source = cr.deep.learn_deep(observed, cr.deep.DeepLearner("DQN", settings=layers), 50).values[0]
    for net_arch in ([8], [4, 8], [8, 8, 8]):
        other = cr.deep.DeepLearner("DQN", settings={"policy_kwargs": {"net_arch": net_arch}})
        with pytest.raises(cr.errors.SettingError, match="networks of one shape"):
            cr.deep.learn_deep(observed, other, 50, shaping=cr.deep.WeightTransfer(source))
    with pytest.raises(cr.errors.SettingError, match="in the source and missing in the target"):
        cr.deep.learn_deep(observed, DQN, 50, shaping=cr.deep.PolicyReuse(critic))
    table = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    with pytest.raises(cr.errors.SettingError, match="a single source, a network"):
        cr.deep.learn_deep(observed, DQN, 50, shaping=cr.deep.WeightTransfer(table))


def test_a_reused_policy_is_acted_on_at_first(observed):
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    lazy = cr.deep.DeepLearner("DQN", settings={**QUICK, "learning_starts": 10_000})
    plain, reusing = (
        cr.deep.learn_deep(observed, lazy, 400, eval_freq=100, shaping=cr.deep.PolicyReuse(prior))
        for prior in (None, phi)
    )
    assert reusing.training_return[0, 1] > plain.training_return[0, 1]
    assert np.array_equal(plain.greedy_return[:, 0], reusing.greedy_return[:, 0])


class Rates(BaseCallback):
    """Keeps the share of the budget that is left, and how often a learner explores."""

    seen: ClassVar = []

    def _on_step(self):
        self.seen.append((self.model._current_progress_remaining, self.model.exploration_rate))
        return True


@pytest.mark.parametrize("way", [None, cr.deep.PolicyReuse])
def test_schedules_follow_a_budget_in_episodes(observed, way):
    settings = {**QUICK, "exploration_fraction": 0.5, "exploration_final_eps": 0.1}
    learner = cr.deep.DeepLearner("DQN", settings=settings, callbacks=lambda: [Rates()])
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    shaping = None if way is None else way(phi)
    Rates.seen.clear()
    cr.deep.learn_deep(observed, learner, cr.learning.Episodes(4), shaping=shaping)
    assert dict(Rates.seen[1:]) == pytest.approx({1.0: 1.0, 0.75: 0.55, 0.5: 0.1, 0.25: 0.1})


@pytest.mark.parametrize(("episodes", "envs"), [(2, 8), (1, 3), (9, 8)])
def test_episodes_are_counted_in_several_environments(observed, episodes, envs):
    many = cr.deep.DeepLearner("PPO", envs=envs, settings={"n_steps": 16, "batch_size": 16})
    result = cr.deep.learn_deep(observed, many, cr.learning.Episodes(episodes), eval_freq=10)
    assert result.episodes[0].max() <= episodes + envs - 1
    plan = cr.Curriculum({"a": observed}, learner=many, budget=cr.Episodes(episodes), eval_freq=10)
    most = plan.node("a").most_steps
    assert most == (episodes + envs - 1) * MAZE.time_limit
    assert result.steps_used[0] <= most + envs - 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"learner": cr.QLearning()}, "learner must be a DeepLearner"),
        ({"shaping": cr.QInitialisation(portfolio=cr.Portfolio())}, "portfolio is for QLearning"),
        ({"evaluation": cr.GreedyEvaluation("exact")}, "since an exact evaluation needs tables"),
        ({"learner": cr.deep.DeepLearner("PPO")}, "a budget must hold a rollout of PPO"),
        ({"learner": cr.deep.DeepLearner("DNQ")}, "an algorithm must be one of"),
    ],
)
def test_what_makes_no_sense_is_refused(observed, arguments, message):
    with pytest.raises(cr.errors.SettingError, match=message):
        cr.deep.learn_deep(observed, **{"budget": 100, **arguments})


def test_networks_have_values(observed):
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    critic = cr.deep.learn_deep(observed, PPO, 100).values[0]
    assert critic.v(rows).shape == (len(rows),)
    with pytest.raises(cr.errors.PotentialError, match="cannot tell actions apart"):
        critic.q(rows, np.tile(np.arange(4), (len(rows), 1)))
    table = cr.deep.learn_deep(observed, DQN, 30).values[0]
    for action in (-1, 4):
        with pytest.raises(cr.errors.PotentialError, match=f"4 actions only: action {action} is"):
            table.q(rows[:2], np.array([0, action]))
    soft = cr.deep.DeepLearner("SAC", settings={"learning_starts": 20})
    swing = cr.observation_task("Pendulum-v1", time_limit=20)
    values = cr.deep.learn_deep(swing, soft, 40).values[0]
    seen = np.zeros((3, 3), dtype=np.float32)
    assert values.q(seen, np.zeros((3, 1))).shape == values.v(seen).shape == (3,)
    assert not values.of_actions


def test_the_potential_is_added_to_values_learnt_with_state_shaping(observed):
    phi = table_potential(MAZE, observed, cr.solve(MAZE).action_values)
    result = cr.deep.learn_deep(observed, DQN, 60, shaping=cr.StateShaping(phi))
    (values,) = result.values
    rows = np.eye(MAZE.states.size, dtype=np.float32)
    bare = cr.deep.NetworkValues(values.policy)
    assert values.v(rows) == pytest.approx(bare.v(rows) + phi.v(rows))


def test_a_compiled_view_changes_no_result_of_training():
    pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
    ppo = cr.deep.DeepLearner("PPO", envs=2, settings={"n_steps": 32, "batch_size": 32})
    name, see = "minigrid:MiniGrid-DoorKey-5x5-v0", cr.interop.MiniGridView()
    compiled, own = (
        cr.deep.learn_deep(
            cr.observation_task(name, encode=see, compiled_view=on), ppo, 256, eval_freq=128
        )
        for on in (True, False)
    )
    np.testing.assert_array_equal(compiled.greedy_return, own.greedy_return)
    for left, right in zip(*(parts(result.values[0]) for result in (compiled, own)), strict=True):
        np.testing.assert_array_equal(left, right)


def test_a_potential_by_hand_of_observations_is_a_value_source():
    car = cr.observation_task("MountainCar-v0")
    height = FunctionValues(state_values=lambda cars: cars[:, 0])
    given_as = height, ObservationPotential.of(car, height), lambda task: height
    for potential in given_as:
        plan = cr.Curriculum({"car": car}, learner=cr.deep.DeepLearner("PPO"), potential=potential)
        (phi,) = plan.potentials("car", {})
        assert phi.v(np.array([[0.5, 0.0]])).tolist() == [0.5]
        assert plan.setting("shaping", "car") == cr.StateShaping()
    with pytest.raises(CurriculumError, match="the potential of 'car' cannot be used"):
        replace(plan, potential=np.zeros((12, 4)))
    with pytest.raises(CurriculumError, match="'placebo' needs numbered states"):
        cr.compare({"car": plan}, controls=["placebo"])
