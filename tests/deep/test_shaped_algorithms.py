"""Shaping inside algorithms: what they store, bootstrap from, learn and report."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

pytest.importorskip("stable_baselines3")

import torch
from stable_baselines3 import A2C, DQN, PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecMonitor,
)

import curricle as cr
from curricle.deep.vec_env import ShapedVecEnv

from .shaped_worlds import (
    DISCOUNT,
    PHI,
    SIZE,
    R,
    World,
    height,
    one_hot,
    shape,
    world,
    worlds,
)

torch.set_num_threads(1)


# -- what algorithms store -----------------------------------------------------------------------


def test_a_replay_buffer_holds_what_the_theory_asks_for():
    venv = shape(worlds(2))
    model = DQN(
        "MlpPolicy", venv, gamma=DISCOUNT, learning_starts=10**6, buffer_size=400, seed=0,
        replay_buffer_kwargs={"handle_timeout_termination": True},
        exploration_initial_eps=1.0, exploration_final_eps=1.0,
    )  # fmt: skip
    model.learn(400)
    buffer = model.replay_buffer
    kinds = {"on": 0, "terminated": 0, "truncated": 0}
    for t in range(200):
        for i in range(2):
            before, after = (
                int(each[t, i].argmax()) for each in (buffer.observations, buffer.next_observations)
            )
            action = int(buffer.actions[t, i, 0])
            done, timeout = buffer.dones[t, i] == 1, buffer.timeouts[t, i] == 1
            terminal = after == SIZE - 1
            phi = 0.0 if terminal else PHI[after]
            expected = R[before, action, after] + DISCOUNT * phi - PHI[before]
            assert buffer.rewards[t, i] == pytest.approx(expected, abs=1e-5)
            assert terminal == (done and not timeout)
            sampled = buffer._get_samples(np.array([t]))  # what learners are given
            assert sampled.dones.shape == (1, 1)
            kind = "terminated" if terminal else "truncated" if timeout else "on"
            kinds[kind] += 1
            given_as_done = buffer.dones[t, i] * (1 - buffer.timeouts[t, i])
            assert given_as_done == (kind == "terminated")
            if kind == "on" and t < 199:
                following = buffer.observations[t + 1, i]
                np.testing.assert_array_equal(buffer.next_observations[t, i], following)
    assert min(kinds.values()) > 10


class Collected(BaseCallback):
    """Keeps what the environment returned, before an algorithm adds to its rewards."""

    def __init__(self):
        super().__init__()
        self.steps = []

    def _on_step(self):
        found = self.locals
        self.steps.append((found["rewards"].copy(), found["dones"].copy(), found["infos"]))
        return True


def test_an_on_policy_algorithm_bootstraps_from_where_it_was_cut_off():
    venv, collected = shape(worlds(2)), Collected()
    model = PPO("MlpPolicy", venv, gamma=DISCOUNT, n_steps=64, batch_size=64, n_epochs=1, seed=0)
    _, callback = model._setup_learn(128, collected)
    model.collect_rollouts(venv, callback, model.rollout_buffer, 64)
    stored, met = model.rollout_buffer, {"cut": 0, "terminated": 0}
    for t, (rewards, dones, infos) in enumerate(collected.steps):
        for i, info in enumerate(infos):
            before, action = int(stored.observations[t, i].argmax()), int(stored.actions[t, i, 0])
            expected = info["original_reward"] + info["shaping"]
            assert rewards[i] == pytest.approx(expected, abs=1e-9)
            if dones[i]:
                after = int(info["terminal_observation"].argmax())
                cut = info["TimeLimit.truncated"]
                met["cut" if cut else "terminated"] += 1
                phi = PHI[after] if cut else 0.0
                expected = R[before, action, after] + DISCOUNT * phi - PHI[before]
                if cut:
                    seen = torch.as_tensor(info["terminal_observation"])[None]
                    with torch.no_grad():
                        expected += DISCOUNT * float(model.policy.predict_values(seen)[0])
            assert stored.rewards[t, i] == pytest.approx(expected, abs=1e-5)
    assert min(met.values()) > 3


# -- the optimum survives ------------------------------------------------------------------------


@pytest.mark.parametrize("shaped", [False, True])
def test_a_network_of_one_weight_a_pair_learns_an_optimal_policy(shaped):
    p, r = np.zeros((SIZE, 2, SIZE)), np.full((SIZE, 2, SIZE), -1.0)
    for cell in range(SIZE):  # a corridor, back and forth, that ends at its last cell
        p[cell, 0, max(cell - 1, 0)] = p[cell, 1, min(cell + 1, SIZE - 1)] = 1.0
    r[2, 1, 3] = -4.0  # a hill in the middle
    task = cr.FiniteMDP.from_dense(
        p, r, terminal=np.arange(SIZE) == SIZE - 1, start=0, discount=DISCOUNT
    )
    space = gym.spaces.Box(0, 1, (SIZE,))
    venv = DummyVecEnv([lambda: TimeLimit(World(p, r, one_hot, space), 6)] * 4)
    phi = np.array([3.0, -2.0, 5.0, 1.0, -4.0, 7.0])  # bad advice
    if shaped:
        venv = ShapedVecEnv(venv, lambda o: o @ phi, discount=DISCOUNT, batched=True)
    model = DQN(
        "MlpPolicy", venv, gamma=DISCOUNT, learning_rate=0.1, buffer_size=2000, seed=0,
        learning_starts=400, batch_size=64, train_freq=1, gradient_steps=2, tau=1.0,
        target_update_interval=20, exploration_initial_eps=1.0, exploration_final_eps=1.0,
        policy_kwargs={
            "net_arch": [], "features_extractor_class": FlattenExtractor,
            "optimizer_class": torch.optim.SGD,
        },
    )  # fmt: skip
    model.learn(6000)
    with torch.no_grad():
        q = model.policy.q_net(torch.eye(SIZE)).numpy()[:-1]
    solution = cr.solve(task)
    expected = solution.action_values[:-1] - (phi[:-1, None] if shaped else 0.0)
    assert abs(q - expected).max() < 0.25
    chosen = q.argmax(axis=1)
    assert solution.optimal[np.arange(SIZE - 1), chosen].all()


# -- algorithms report the task's own returns ----------------------------------------------------

FEW = {
    "PPO": (PPO, {"n_steps": 32, "batch_size": 32, "n_epochs": 1}),
    "A2C": (A2C, {"n_steps": 8}),
    "DQN": (DQN, {"learning_starts": 50, "buffer_size": 500, "train_freq": 8}),
    "SAC": (SAC, {"learning_starts": 50, "buffer_size": 500, "train_freq": 8}),
}


def pendulum():
    return gym.make("Pendulum-v1", max_episode_steps=40)


def upright(observations):
    return 10 * observations[:, 0]


class Returns(BaseCallback):
    """Adds up the original rewards of each episode."""

    def __init__(self):
        super().__init__()
        self.returns = []

    def _on_step(self):
        infos = self.locals["infos"]
        self.returns += [info["original_return"] for info in infos if "original_return" in info]
        return True


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("algorithm", FEW)
def test_a_monitor_inside_reports_the_tasks_own_returns(algorithm, inside):
    make, phi = (pendulum, upright) if algorithm == "SAC" else (world, height)
    venv = DummyVecEnv([(lambda: Monitor(make())) if inside else make] * 2)
    venv = ShapedVecEnv(venv if inside else VecMonitor(venv), phi, discount=DISCOUNT, batched=True)
    kind, few = FEW[algorithm]
    model, returns = kind("MlpPolicy", venv, gamma=DISCOUNT, seed=0, **few), Returns()
    model.learn(200, callback=returns)
    assert len(returns.returns) > 3
    reported = [each["r"] for each in model.ep_info_buffer]
    assert reported == pytest.approx(returns.returns[-len(reported) :], abs=1e-3)
