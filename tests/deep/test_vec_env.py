"""The shaped vector environments of Stable-Baselines3: what a step is paid, and what is refused."""

from functools import partial
from itertools import count

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers import TimeLimit
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnvWrapper, VecMonitor, VecNormalize

import curricle as cr
from curricle.deep.networks import NetworkValues
from curricle.deep.vec_env import ShapedVecEnv
from curricle.errors import SettingError
from tests.unit.interop import shaping

torch.set_num_threads(1)
DISCOUNT = 0.9


class World(shaping.World):
    """A finite MDP, P and r (S, A, S), that ends in its last state; each has a seed of its own."""

    made = count()

    def __init__(self, p, r, observe=int, space=None):
        super().__init__(np.arange(len(p)) == len(p) - 1, observe, space, p, r)
        self.np_random = np.random.default_rng(next(World.made))


@pytest.fixture(autouse=True)
def the_same_worlds():
    """Have each test play the same worlds whenever it runs."""
    World.made = count()


RNG = np.random.default_rng(0)
SIZE = 6
P = RNG.dirichlet(np.full(SIZE, 0.5), size=(SIZE, 2))
R = RNG.normal(size=(SIZE, 2, SIZE))
PHI = 3 * RNG.normal(size=SIZE)
LIMIT = 4


def one_hot(state, size=SIZE):
    return np.eye(size, dtype=np.float32)[state]


def world(limit=LIMIT, observe=one_hot):
    size = len(P)
    space = gym.spaces.Box(0, 1, (size,)) if observe is one_hot else None
    return TimeLimit(World(P, R, observe, space), limit)


def worlds(n=2, **settings):
    return DummyVecEnv([partial(world, **settings)] * n)


def height(observations):
    return observations @ PHI


def shape(venv, **settings):
    return ShapedVecEnv(venv, height, **{"discount": DISCOUNT, **settings})


class Calls:
    """Values that count how often and how many they were asked."""

    of_actions = False

    def __init__(self):
        self.sizes = []

    def q(self, observations, actions):
        raise NotImplementedError

    def v(self, observations):
        self.sizes.append(len(observations))
        return height(observations)


@pytest.mark.parametrize("source", ["function", "values", "encoded table"])
@pytest.mark.parametrize("n", [1, 3])
def test_each_step_is_shaped_as_defined(n, source):
    task = cr.FiniteMDP.from_dense(P, R, terminal=np.zeros(SIZE, bool), start=0, discount=DISCOUNT)
    made = {
        "function": {"potential": height},
        "values": {"potential": Calls()},
        "encoded table": {"potential": cr.StatePotential(task, PHI), "encode": np.argmax},
    }[source]
    plain, venv = worlds(n), ShapedVecEnv(worlds(n), discount=DISCOUNT, **made)
    plain.seed(1), venv.seed(1)
    before, first = plain.reset(), venv.reset()
    np.testing.assert_array_equal(before, first)
    totals, ends = np.zeros(n), {"terminated": 0, "truncated": 0}
    for action in RNG.integers(2, size=(200, n)):
        observations, rewards, dones, infos = plain.step(action)
        got = venv.step(action)
        np.testing.assert_array_equal(got[0], observations)
        np.testing.assert_array_equal(got[2], dones)
        totals += rewards
        for i, info in enumerate(infos):
            arrived = info.get("terminal_observation", observations[i])
            truncated = info["TimeLimit.truncated"]
            after = 0.0 if dones[i] and not truncated else height(arrived)
            shaping = DISCOUNT * after - height(before[i])
            step_info = got[3][i]
            assert got[1][i] == pytest.approx(rewards[i] + shaping, abs=1e-6)
            assert step_info["shaping"] == pytest.approx(shaping, abs=1e-6)
            assert step_info["potential"] == pytest.approx(after, abs=1e-6)
            assert step_info["original_reward"] == pytest.approx(rewards[i], abs=1e-6)
            assert ("original_return" in step_info) == dones[i]
            if dones[i]:
                ends["truncated" if truncated else "terminated"] += 1
                assert step_info["original_return"] == pytest.approx(totals[i], abs=1e-5)
                assert abs(step_info["telescoping_residual"]) < 1e-6
                totals[i] = 0.0
        before = observations
    assert min(ends.values()) > 5


def test_what_stands_inside_can_be_reached():
    venv = shape(DummyVecEnv([lambda: Monitor(world())] * 2))
    assert venv.env_is_wrapped(Monitor) == [True, True]
    venv.reset()
    states = venv.get_attr("state")
    assert venv.env_method("get_wrapper_attr", "state", indices=[1]) == states[1:]
    venv.env_method("reset", seed=3)
    assert venv.has_attr("observe")
    assert not venv.has_attr("nothing")
    venv.set_attr("mark", 3)
    assert venv.get_attr("mark") == [3, 3]
    assert venv.discount == DISCOUNT


class Forgetful(VecEnvWrapper):
    """Loses the observations in which episodes were cut off."""

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        *rest, infos = self.venv.step_wait()
        return *rest, [{k: v for k, v in info.items() if "terminal" not in k} for info in infos]


def steps_without_final_observations():
    venv = shape(Forgetful(worlds(2, limit=1)))
    venv.reset()
    return [venv.step([0, 0]) for _ in range(2)]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: shape(worlds()).env_method("compute_reward", indices=[0]), "in hindsight replay"),
        (lambda: shape(VecMonitor(VecNormalize(worlds()))), "VecNormalize must be outside"),
        (lambda: shape(gym.make("CartPole-v1")), "environments of ShapedVecEnv must be a VecEnv"),
        (steps_without_final_observations, r"info\['terminal_observation'\]: sub-environment "),
    ],
)
def test_what_would_shape_wrongly_is_refused(call, says):
    with pytest.raises(SettingError, match=says):
        call()


def test_networks_may_round():
    policy = PPO("MlpPolicy", worlds(), n_steps=8, batch_size=8).policy
    values = NetworkValues(policy)
    venv = ShapedVecEnv(worlds(5), values, discount=DISCOUNT, tolerance=0.0)
    venv.reset()
    residuals = [
        info.get("telescoping_residual", 0.0) for _ in range(50) for info in venv.step([0] * 5)[3]
    ]
    assert max(map(abs, residuals)) < 1e-4


@pytest.mark.parametrize("normalised", [False, True])
def test_a_replay_buffer_holds_what_the_theory_asks_for(normalised):
    venv = shape(worlds(2))
    venv = VecNormalize(venv, gamma=DISCOUNT, norm_obs=False) if normalised else venv
    model = DQN(
        "MlpPolicy", venv, gamma=DISCOUNT, learning_starts=10**6, buffer_size=400,
        seed=0, exploration_initial_eps=1.0, exploration_final_eps=1.0,
    )  # fmt: skip
    model.learn(400)
    buffer, kinds = model.replay_buffer, {"on": 0, "terminated": 0, "truncated": 0}
    for t, i in np.ndindex(200, 2):
        before, after = (
            int(rows[t, i].argmax()) for rows in (buffer.observations, buffer.next_observations)
        )
        action = int(buffer.actions[t, i, 0])
        done, timeout = buffer.dones[t, i] == 1, buffer.timeouts[t, i] == 1
        terminal = after == SIZE - 1
        phi = 0.0 if terminal else PHI[after]
        expected = R[before, action, after] + DISCOUNT * phi - PHI[before]
        assert buffer.rewards[t, i] == pytest.approx(expected, abs=1e-5)
        assert terminal == (done and not timeout)
        kind = "terminated" if terminal else "truncated" if timeout else "on"
        kinds[kind] += 1
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
        self.steps.append((self.locals["rewards"].copy(), self.locals["infos"]))
        return True


def test_an_on_policy_algorithm_bootstraps_from_where_it_was_cut_off():
    venv, collected = shape(worlds(2)), Collected()
    model = PPO("MlpPolicy", venv, gamma=DISCOUNT, n_steps=64, batch_size=64, n_epochs=1, seed=0)
    _, callback = model._setup_learn(128, collected)
    model.collect_rollouts(venv, callback, model.rollout_buffer, 64)
    stored, cuts = model.rollout_buffer, 0
    for t, (rewards, infos) in enumerate(collected.steps):
        for i, info in enumerate(infos):
            expected = info["original_reward"] + info["shaping"]
            assert rewards[i] == pytest.approx(expected, abs=1e-9)
            if info["TimeLimit.truncated"]:
                cuts += 1
                seen = torch.as_tensor(info["terminal_observation"])[None]
                with torch.no_grad():
                    expected += DISCOUNT * float(model.policy.predict_values(seen)[0])
            assert stored.rewards[t, i] == pytest.approx(expected, abs=1e-5)
    assert cuts > 3
