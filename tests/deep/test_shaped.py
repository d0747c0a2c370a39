"""The shaped vector environments of Stable-Baselines3: what a step is paid, and what is refused."""

import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from curricle.interop.gymnasium import observation_task

pytest.importorskip("stable_baselines3")

import cloudpickle
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnvWrapper,
    VecMonitor,
    VecNormalize,
)

import curricle as cr
from curricle.deep.networks import NetworkValues
from curricle.deep.vec_env import ShapedVecEnv
from curricle.errors import SettingError
from curricle.transfer.observation_mapping import FunctionValues
from curricle.transfer.potential import ObservationPotential

from .shaped_worlds import (
    DISCOUNT,
    LIMIT,
    PHI,
    RNG,
    SIZE,
    P,
    R,
    World,
    height,
    monitored,
    one_hot,
    shape,
    world,
    worlds,
)

torch.set_num_threads(1)


# -- what a step is paid -------------------------------------------------------------------------


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


@pytest.mark.parametrize("source", ["batched", "one by one", "values", "encoded table"])
@pytest.mark.parametrize("n", [1, 3])
def test_each_step_is_shaped_as_defined(n, source):
    task = cr.FiniteMDP.from_dense(P, R, terminal=np.zeros(SIZE, bool), start=0, discount=DISCOUNT)
    made = {
        "batched": {"potential": height, "batched": True},
        "one by one": {"potential": height},
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
            told = got[3][i]
            assert got[1][i] == pytest.approx(rewards[i] + shaping, abs=1e-6)
            assert told["shaping"] == pytest.approx(shaping, abs=1e-6)
            assert told["potential"] == pytest.approx(after, abs=1e-6)
            assert told["original_reward"] == pytest.approx(rewards[i], abs=1e-6)
            assert ("original_return" in told) == dones[i]
            if dones[i]:
                ends["truncated" if truncated else "terminated"] += 1
                assert told["original_return"] == pytest.approx(totals[i], abs=1e-5)
                assert abs(told["telescoping_residual"]) < 1e-6
                totals[i] = 0.0
        before = observations
    assert min(ends.values()) > 5


def test_values_are_read_once_a_step_and_never_of_a_terminal_state():
    values = Calls()
    venv = ShapedVecEnv(worlds(3), values, discount=DISCOUNT)
    venv.reset()
    for action in RNG.integers(2, size=(50, 3)):
        values.sizes.clear()
        _, _, dones, infos = venv.step(action)
        cut = sum(info["TimeLimit.truncated"] for info in infos)
        # those returned, those in which episodes were cut off, those with which ended ones began
        assert values.sizes == [3 + cut + dones.sum()]


def test_a_potential_over_observations_brings_its_discount_and_its_space():
    task = observation_task(world, discount=0.8)
    phi = ObservationPotential.of(task, FunctionValues(state_values=height))
    assert ShapedVecEnv(worlds(), phi).discount == 0.8
    with pytest.raises(SettingError, match=r"0.8 by the task of 'potential', 0.9 by the argument"):
        ShapedVecEnv(worlds(), phi, discount=0.9)
    with pytest.raises(SettingError, match="must be read from those of its task"):
        ShapedVecEnv(worlds(observe=int), phi)


@st.composite
def tables(draw):
    n, a = draw(st.integers(2, 4)), draw(st.integers(1, 3))
    weights = draw(arrays(np.int64, (n, a, n), elements=st.integers(0, 3)))
    weights[:, :, -1] += 1
    reward = draw(arrays(np.int64, (n, a, n), elements=st.integers(-5, 5)))
    return weights / weights.sum(axis=2, keepdims=True), reward.astype(float)


@given(tables(), st.sampled_from([0.0, 0.3, 0.95, 1.0]), st.integers(1, 5), st.data())
@settings(max_examples=30, deadline=None)
def test_every_episodes_shaping_telescopes(tables, discount, limit, data):
    phi = data.draw(arrays(np.float64, len(tables[0]), elements=st.floats(-1e3, 1e3)))
    n, tolerance = 3, 1e-12 * max(1, abs(phi).max())
    made = DummyVecEnv([lambda: TimeLimit(World(*tables), limit)] * n)
    venv = ShapedVecEnv(made, phi.__getitem__, discount=discount)
    venv.seed(0)
    first = venv.reset()
    total, steps = np.zeros(n), np.zeros(n, int)
    for _ in range(20):
        observations, rewards, dones, infos = venv.step(np.zeros(n, int))
        total += discount**steps * (rewards - [info["original_reward"] for info in infos])
        steps += 1
        for i in np.flatnonzero(dones):
            cut = infos[i]["TimeLimit.truncated"]
            last = phi[infos[i]["terminal_observation"]] if cut else 0.0
            expected = discount ** steps[i] * last - phi[first[i]]
            assert abs(total[i] - expected) <= steps[i] * (tolerance + 1e-13)
            assert abs(infos[i]["telescoping_residual"]) <= steps[i] * tolerance
            total[i], steps[i], first[i] = 0.0, 0, observations[i]


# -- a good citizen of Stable-Baselines3 ---------------------------------------------------------


def picklable(n=2):
    return DummyVecEnv([monitored] * n)


@pytest.mark.parametrize("library", [pickle, cloudpickle])
def test_a_copy_goes_on_where_the_original_is(library):
    weight = cr.learning.linear(1.0, 0.2, steps=80)
    venv = ShapedVecEnv(picklable(), height, discount=DISCOUNT, batched=True, weight=weight)
    venv.seed(0)
    venv.reset()
    venv.step([0, 1])
    twin = library.loads(library.dumps(venv))
    for _ in range(20):
        for one, other in zip(venv.step([0, 1])[:3], twin.step([0, 1])[:3], strict=True):
            np.testing.assert_array_equal(one, other)
    assert twin.get_attr("observe") == venv.get_attr("observe")
    assert twin.action_space == venv.action_space


def test_what_stands_inside_can_be_reached():
    venv = shape(picklable())
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


def test_rewards_of_hindsight_would_lack_the_shaping():
    with pytest.raises(SettingError, match="as in hindsight replay"):
        shape(worlds()).env_method("compute_reward", None, None, None, indices=[0])


def test_normalised_rewards_inside_would_be_stored_unshaped():
    with pytest.raises(SettingError, match="VecNormalize must be outside"):
        shape(VecMonitor(VecNormalize(worlds())))
    outside = VecNormalize(shape(worlds(1)), gamma=DISCOUNT, norm_obs=False)
    model = DQN("MlpPolicy", outside, gamma=DISCOUNT, buffer_size=20, learning_starts=10**6, seed=0)
    model.learn(20)
    stored = model.replay_buffer
    before, after = (
        each[:, 0].argmax(axis=1) for each in (stored.observations, stored.next_observations)
    )
    phi = np.where(after == SIZE - 1, 0.0, PHI[after])
    expected = R[before, stored.actions[:, 0, 0], after] + DISCOUNT * phi - PHI[before]
    np.testing.assert_allclose(stored.rewards[:, 0], expected, atol=1e-5)


def some_steps(venv):
    return [venv.step([0] * venv.num_envs)[3] for _ in range(LIMIT + 1)]


class Forgetful(VecEnvWrapper):
    """Loses the observations in which episodes were cut off."""

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        *rest, infos = self.venv.step_wait()
        return *rest, [{k: v for k, v in info.items() if "terminal" not in k} for info in infos]


def test_missing_final_observations_are_refused():
    venv = shape(Forgetful(worlds(2, limit=1)))
    venv.reset()
    with pytest.raises(SettingError, match=r"info\['terminal_observation'\]: sub-environment "):
        some_steps(venv)


def test_networks_may_round():
    policy = PPO("MlpPolicy", worlds(), n_steps=8, batch_size=8).policy
    values = NetworkValues(policy)
    venv = ShapedVecEnv(worlds(5), values, discount=DISCOUNT, tolerance=0.0)
    venv.reset()
    residuals = [
        info.get("telescoping_residual", 0.0) for _ in range(50) for info in venv.step([0] * 5)[3]
    ]
    assert max(map(abs, residuals)) < 1e-4


# -- pictures and dicts --------------------------------------------------------------------------


class Parts(World):
    """A world whose observations are dicts."""

    def __init__(self):
        spaces = {"state": gym.spaces.Discrete(SIZE), "hot": gym.spaces.Box(0, 1, (SIZE,))}
        super().__init__(P, R, self.part, gym.spaces.Dict(spaces))

    def part(self, state):
        return {"state": state, "hot": one_hot(state)}


@pytest.mark.parametrize(
    ("potential", "batched"),
    [
        (lambda o: PHI[o["state"]], True),
        (lambda o: PHI[o["state"]], False),
        (FunctionValues(state_values=lambda o: o["hot"] @ PHI), False),
    ],
)
def test_dicts_are_read_as_they_are_stacked(potential, batched):
    runs = []
    plain = partial(World, P, R), PHI.__getitem__, False
    for make, phi, how in ((Parts, potential, batched), plain):
        made = DummyVecEnv([partial(TimeLimit, make(), LIMIT) for _ in range(2)])
        venv = ShapedVecEnv(made, phi, discount=DISCOUNT, batched=how)
        venv.seed(4)
        venv.reset()
        runs.append([venv.step([0, 1])[1] for _ in range(40)])
    np.testing.assert_allclose(*runs, atol=1e-6)
