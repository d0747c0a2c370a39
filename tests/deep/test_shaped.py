"""Shaping inside Stable-Baselines3: what its algorithms store, bootstrap from and report."""

import pickle
from functools import partial
from itertools import count

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
from stable_baselines3 import A2C, DQN, PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnvWrapper,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
)

import curricle as cr
from curricle.deep.networks import NetworkValues
from curricle.deep.shaped import ShapedVecEnv
from curricle.errors import PotentialError, SettingError
from curricle.interop.potential_shaping import PotentialShaping
from curricle.transfer.observation_potential import ObservationPotential
from curricle.transfer.value_sources import FunctionValues, TableValues

torch.set_num_threads(1)
DISCOUNT = 0.9


class World(gym.Env):
    """A finite MDP, P and r (S, A, S), that begins anywhere but where it ends: its last state."""

    made = count()

    def __init__(self, p, r, observe=int, space=None):
        self.p, self.r, self.observe = p, r, observe
        self.observation_space = space or gym.spaces.Discrete(len(p))
        self.action_space = gym.spaces.Discrete(p.shape[1])
        self.np_random = np.random.default_rng(next(World.made))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(len(self.p) - 1))
        return self.observe(self.state), {}

    def step(self, action):
        before = self.state
        self.state = int(self.np_random.choice(len(self.p), p=self.p[before, action]))
        reward = float(self.r[before, action, self.state])
        return self.observe(self.state), reward, self.state == len(self.p) - 1, False, {}


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
    return ShapedVecEnv(venv, height, **{"discount": DISCOUNT, "batched": True, **settings})


def monitored(limit=LIMIT):
    return Monitor(world(limit))


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
def test_each_step_is_paid_what_the_definition_says(n, source):
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


def test_values_are_asked_once_a_step_and_never_for_a_terminal_state():
    values = Calls()
    venv = ShapedVecEnv(worlds(3), values, discount=DISCOUNT)
    venv.reset()
    for action in RNG.integers(2, size=(50, 3)):
        values.sizes.clear()
        _, _, dones, infos = venv.step(action)
        cut = sum(info["TimeLimit.truncated"] for info in infos)
        # those returned, those in which episodes were cut off, those with which ended ones began
        assert values.sizes == [3 + cut + dones.sum()]


def test_sources_have_terms_where_they_are_several():
    venv = ShapedVecEnv(worlds(), {"a": height, "b": lambda o: 2 * height(o)}, discount=DISCOUNT)
    venv.reset()
    info = venv.step([0, 1])[3][1]
    assert list(info["shaping_terms"]) == ["a", "b"]
    assert info["shaping"] == pytest.approx(np.mean(list(info["shaping_terms"].values())))
    alone = shape(worlds())
    alone.reset()
    assert "shaping_terms" not in alone.step([0, 1])[3][0]


def test_a_potential_over_observations_brings_its_discount_and_its_space():
    task = observation_task(world, discount=0.8)
    phi = ObservationPotential.of(task, FunctionValues(state_values=height))
    assert ShapedVecEnv(worlds(), phi).discount == 0.8
    with pytest.raises(SettingError, match=r"0.8 by the task of 'potential', 0.9 by the argument"):
        ShapedVecEnv(worlds(), phi, discount=0.9)
    with pytest.raises(SettingError, match="must be read from those of its task"):
        ShapedVecEnv(worlds(observe=int), phi)


def test_tables_of_values_read_states_that_are_numbers():
    values = TableValues(np.stack([PHI, PHI - 1], axis=1))
    runs = []
    for potential in (values, PHI.__getitem__):
        venv = ShapedVecEnv(worlds(observe=int), potential, discount=DISCOUNT)
        venv.seed(0)
        venv.reset()
        runs.append([venv.step(np.zeros(2, int))[1] for _ in range(30)])
    np.testing.assert_array_equal(*runs)


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


def test_a_monitor_outside_reports_shaped_returns():
    venv = VecMonitor(shape(worlds()))
    venv.reset()
    for _ in range(LIMIT):
        infos = venv.step([0, 0])[3]
    ended = next(info for info in infos if "episode" in info)
    assert abs(ended["episode"]["r"] - ended["original_return"]) > 0.1


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
    with pytest.raises(SettingError, match="VecNormalize must stand outside"):
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


def test_an_environment_is_shaped_once():
    twice = shape(shape(worlds()))
    twice.reset()
    with pytest.raises(SettingError, match="must be shaped once"):
        twice.step([0, 0])
    inside = DummyVecEnv([lambda: PotentialShaping(world(), height, discount=DISCOUNT)])
    venv = shape(inside)
    venv.reset()
    with pytest.raises(SettingError, match="must be shaped once"):
        venv.step([0])


def some_steps(venv):
    return [venv.step([0] * venv.num_envs)[3] for _ in range(LIMIT + 1)]


class Forgetful(VecEnvWrapper):
    """Loses the observations in which episodes were cut off."""

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        *rest, infos = self.venv.step_wait()
        return *rest, [{k: v for k, v in info.items() if "terminal" not in k} for info in infos]


def test_final_observations_are_asked_for():
    venv = shape(Forgetful(worlds(2, limit=1)))
    venv.reset()
    with pytest.raises(SettingError, match=r"info\['terminal_observation'\]: sub-environment "):
        some_steps(venv)


def test_a_potential_of_something_else_is_found_out_at_the_end():
    ticks = iter(range(1000))
    venv = ShapedVecEnv(worlds(1), lambda o: float(next(ticks)), discount=1.0)
    venv.reset()
    with pytest.raises(PotentialError, match="at the end of an episode of sub-environment 0"):
        some_steps(venv)
    ticks = iter(range(1000))
    free = ShapedVecEnv(worlds(1), lambda o: float(next(ticks)), discount=1.0, tolerance=None)
    free.reset()
    residuals = [info.get("telescoping_residual", 0.0) for (info,) in some_steps(free)]
    assert max(map(abs, residuals)) > 1


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


class Picture(World):
    """A world seen as a picture of 40 by 40, brighter by the state."""

    def __init__(self):
        space = gym.spaces.Box(0, 255, (40, 40, 3), np.uint8)
        super().__init__(P, R, self.paint, space)

    def paint(self, state):
        return np.full((40, 40, 3), 40 * state, np.uint8)


def brightness(observations):
    return PHI[observations[:, 0, 0, 0] // 40]


def test_pictures_are_transposed_outside():
    venv = ShapedVecEnv(
        DummyVecEnv([lambda: TimeLimit(Picture(), LIMIT)] * 2),
        brightness, discount=DISCOUNT, batched=True,
    )  # fmt: skip
    model = A2C("CnnPolicy", venv, gamma=DISCOUNT, n_steps=4)
    assert isinstance(model.env, VecTransposeImage)
    model.learn(16)


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
