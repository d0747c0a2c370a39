"""Policies of Stable-Baselines3, evaluated exactly on tables."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import DQN, PPO

import curricle as cr
from tests.worlds_to_tabulate import Corridor


@pytest.mark.parametrize("algorithm", [PPO, DQN])
def test_a_policy_is_worth_what_it_earns(algorithm):
    task = cr.tabulate(Corridor, discount=0.9, seeds=[0])
    for seed in range(3):
        model = algorithm("MlpPolicy", Corridor(), seed=seed, device="cpu")
        env = Corridor()
        seen, _ = env.reset(seed=0)
        total = 0.0
        for step in range(200):
            action, _ = model.predict(seen, deterministic=True)
            seen, reward, over, _, _ = env.step(int(action))
            total += 0.9**step * reward
            if over:
                break
        assert cr.evaluate(task, model).start_value == pytest.approx(total, abs=1e-8)


def test_a_policy_that_draws_is_worth_the_mean():
    task = cr.tabulate("FrozenLake-v1", discount=0.9)
    model = PPO("MlpPolicy", gym.make("FrozenLake-v1"), seed=0, device="cpu")
    policy = task.policy(model, deterministic=False)
    assert policy.shape == (16, 4)
    np.testing.assert_allclose(policy.sum(axis=1), 1)
    one = task.state(6)
    drawn = [int(model.predict(np.array([6]))[0][0]) for _ in range(2000)]
    shares = np.bincount(drawn, minlength=4) / 2000
    # Five standard deviations of a share of 2,000.
    np.testing.assert_allclose(policy[one], shares, atol=5 * 0.0112)
    assert 0 < cr.evaluate(task, policy).start_value < cr.solve(task).start_value
    with pytest.raises(cr.CurricleError, match="must have a distribution"):
        task.policy(DQN("MlpPolicy", gym.make("FrozenLake-v1")), deterministic=False)
