"""A critic Phi + residual learns just what shaping by Phi lets it learn, with rewards unshaped."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

import curricle as cr
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues

from .worlds import one_hot, random_task, table_potential

SETTINGS = {
    "PPO": {"n_steps": 32, "batch_size": 16, "n_epochs": 3},
    "A2C": {"n_steps": 8},
}


def trained(algorithm, observed, shaping, *, envs=2, steps=1_000, start_at_0=True):
    settings = SETTINGS[algorithm] | {"policy_kwargs": {"net_arch": [8]}}
    learner = cr.deep.DeepLearner(algorithm, envs=envs, settings=settings)
    model = model_for(observed, learner, shaping, seed=3)
    if start_at_0:
        torch.nn.init.zeros_(model.policy.value_net.weight)
        torch.nn.init.zeros_(model.policy.value_net.bias)
    return model.learn(steps)


def world(seed, **settings):
    """Return a task with ends and cut-off episodes, seen as one-hot vectors, and a Phi."""
    rng = np.random.default_rng(seed)
    task = random_task(rng, **settings)
    observed = one_hot(task)
    table = np.where(task.terminal[:, None], 0.0, rng.normal(size=(5, 3)))
    return task, observed, table_potential(task, observed, table)


@pytest.mark.parametrize("algorithm", ["PPO", "A2C"])
@pytest.mark.parametrize("seed", range(5))
def test_a_residual_critic_learns_what_shaping_lets_it_learn(algorithm, seed):
    _, observed, phi = world(seed)
    shaped = trained(algorithm, observed, cr.StateShaping(phi))
    residual = trained(algorithm, observed, cr.QInitialisation(phi))
    for name, found in residual.policy.state_dict().items():
        assert found.numpy() == pytest.approx(shaped.policy.state_dict()[name].numpy(), abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_values_are_in_the_tasks_own_rewards_both_ways(seed):
    _, observed, phi = world(seed)
    rows = np.eye(5, dtype=np.float32)
    shaped = NetworkValues(trained("PPO", observed, cr.StateShaping(phi)).policy, phi)
    residual = NetworkValues(trained("PPO", observed, cr.QInitialisation(phi)).policy)
    assert residual.v(rows) == pytest.approx(shaped.v(rows), abs=1e-4)


def test_the_critic_says_phi_before_it_learns():
    _, observed, phi = world(0)
    rows = np.eye(5, dtype=np.float32)
    shaping = cr.QInitialisation(phi)
    model = model_for(observed, cr.deep.DeepLearner("PPO"), shaping, seed=1)
    assert NetworkValues(model.policy).v(rows) == pytest.approx(phi.v(rows), abs=1e-6)


def test_monitored_returns_are_unshaped():
    _, observed, phi = world(1)
    residual = trained("PPO", observed, cr.QInitialisation(phi))
    shaped = trained("PPO", observed, cr.StateShaping(phi))
    returns = [[one["r"] for one in model.ep_info_buffer] for model in (residual, shaped)]
    assert returns[0] == pytest.approx(returns[1], abs=1e-5)


def test_state_values_are_enough_for_a_critic_and_not_for_dqn():
    car = cr.observation_task("MountainCar-v0")
    height = cr.transfer.FunctionValues(state_values=lambda cars: cars[:, 0])
    shaping = cr.QInitialisation(height)
    ppo = cr.deep.DeepLearner("PPO", settings={"n_steps": 64})
    found = cr.deep.learn_deep(car, ppo, 128, shaping=shaping, eval_freq=64)
    assert np.isfinite(found.values[0].v(np.zeros((3, 2), np.float32))).all()
    with pytest.raises(cr.errors.SettingError, match="needs a potential of numbered actions"):
        cr.deep.learn_deep(car, cr.deep.DeepLearner("DQN"), 128, shaping=shaping)


def test_a_saved_model_keeps_its_phi(tmp_path):
    _, observed, phi = world(2)
    model = trained("PPO", observed, cr.QInitialisation(phi))
    model.save(tmp_path / "model.zip")
    rows = np.eye(5, dtype=np.float32)
    again = NetworkValues(PPO.load(tmp_path / "model.zip").policy)
    assert again.v(rows) == pytest.approx(NetworkValues(model.policy).v(rows))
