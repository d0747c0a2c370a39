"""Agents that share one model of Stable-Baselines3: episodes, ends, seeds, what it refuses."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("pettingzoo")

import torch
from gymnasium.spaces import Box, Dict, Discrete
from pettingzoo import ParallelEnv
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from curricle import Pursuit, Transfer, solve
from curricle.deep.vec_env import AgentsVecEnv, ShapedVecEnv
from curricle.errors import SettingError
from curricle.interop.pettingzoo import to_pettingzoo
from curricle.interop.vector_pursuit import VectorPursuit, observed_pursuit, predator_mapping
from curricle.transfer import TableValues
from curricle.transfer.potentials import ObservationPotential

FORMS = ["index", "components", "vector"]


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Pair(ParallelEnv):
    """Two agents that count to 3; what they see and how they end is the test's."""

    def __init__(self, render_mode=None, spaces=None, ends=(True, True), born=("a", "b")):
        self.possible_agents, self.agents = ["a", "b"], []
        self.render_mode, self.metadata = render_mode, {}
        self._spaces = spaces or {agent: Discrete(9) for agent in self.possible_agents}
        self._ends, self._born, self._time = ends, born, 0

    def observation_space(self, agent):
        return self._spaces[agent]

    def action_space(self, agent):
        return Discrete(2)

    def _observed(self):
        if isinstance(self._spaces["a"], Dict):
            return {
                a: {"time": np.array([self._time], np.float32), "own": i}
                for i, a in enumerate(self.agents)
            }
        return dict.fromkeys(self.agents, self._time)

    def reset(self, seed=None, options=None):
        self.agents, self._time = list(self._born), 0
        return self._observed(), {
            agent: {"seed": seed, "options": options} for agent in self.agents
        }

    def step(self, actions):
        self._time += 1
        observed, agents = self._observed(), self.agents
        ends = {a: self._time == 3 and end for a, end in zip(agents, self._ends, strict=True)}
        if any(ends.values()):
            self.agents = []
        rewards = {agent: float(action) for agent, action in actions.items()}
        told = {agent: {"time": self._time} for agent in agents}
        return observed, rewards, ends, dict.fromkeys(agents, False), told

    def double(self, number):
        self.doubled = getattr(self, "doubled", 0) + 1
        return 2 * number


# -- episodes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_agents_live_as_sub_environments_do(form):
    """Against a plain loop over the PettingZoo environment."""
    hunt = Pursuit(3, 2, time_limit=6)
    agents, plain = (to_pettingzoo(hunt, observation=form) for _ in range(2))
    together = AgentsVecEnv(agents)
    together.seed(3)
    seen, (expected, infos) = together.reset(), plain.reset(seed=3)
    rng = np.random.default_rng(0)
    kinds = set()
    for step in range(300):
        assert np.array_equal(seen, list(expected.values()))
        assert seen.dtype == together.observation_space.dtype
        assert all(together.observation_space.contains(row) for row in seen)
        moves = rng.integers(5, size=2)
        seen, rewards, over, infos = together.step(moves)
        expected, paid, ended, cut, _ = plain.step(dict(zip(plain.agents, moves, strict=True)))
        assert rewards.tolist() == list(paid.values())
        assert (rewards.dtype, over.dtype) == (np.float32, np.bool_)
        kind = ended["predator_1"], cut["predator_1"]
        assert over.tolist() == [any(kind)] * 2
        assert [info["TimeLimit.truncated"] for info in infos] == [kind[1]] * 2
        assert [("terminal_observation" in info) for info in infos] == [any(kind)] * 2
        if any(kind):
            last = [info["terminal_observation"] for info in infos]
            assert np.array_equal(last, list(expected.values()))
            expected, told = plain.reset()
            assert together.reset_infos == list(told.values())
        kinds.add(kind)
        assert together.joint_steps == step + 1
    assert kinds == {(False, False), (True, False), (False, True)}


def test_one_agent_is_what_dummyvecenv_makes_of_it():
    hunt = Pursuit(3, 1, time_limit=5)
    alone = DummyVecEnv([lambda: VectorPursuit(hunt)])
    agent = AgentsVecEnv(to_pettingzoo(hunt, observation="vector"))
    for each in (alone, agent):
        each.seed(11)
    assert np.array_equal(alone.reset(), agent.reset())
    rng = np.random.default_rng(0)
    for _ in range(100):
        moves = rng.integers(5, size=1)
        expected, found = alone.step(moves), agent.step(moves)
        for one, other in zip(expected[:3], found[:3], strict=True):
            assert np.array_equal(one, other)
            assert one.dtype == other.dtype
        assert expected[3][0].keys() == found[3][0].keys()
        for name, value in expected[3][0].items():
            assert np.array_equal(found[3][0][name], value)


def test_seeds_and_options_are_used_once():
    pair = AgentsVecEnv(Pair())
    pair.seed(7)
    pair.set_options({"start": 1})
    pair.reset()
    assert pair.reset_infos == [{"seed": 7, "options": {"start": 1}}] * 2
    pair.reset()
    assert pair.reset_infos == [{"seed": None, "options": None}] * 2


def test_observations_may_be_dicts():
    space = Dict({"time": Box(0, 9, (1,)), "own": Discrete(2)})
    pair = AgentsVecEnv(Pair(spaces={"a": space, "b": space}))
    assert {name: rows.tolist() for name, rows in pair.reset().items()} == {
        "time": [[0], [0]],
        "own": [0, 1],
    }
    for _ in range(3):
        seen, rewards, over, infos = pair.step(np.array([0, 1]))
    assert rewards.tolist() == [0, 1]
    assert over.all()
    assert seen["time"].tolist() == [[0], [0]]  # of the next episode
    assert [info["terminal_observation"]["own"] for info in infos] == [0, 1]
    assert infos[0]["terminal_observation"]["time"] == [3]
    assert infos[0]["time"] == 3


def test_attributes_and_methods_are_the_environment_s():
    pair = AgentsVecEnv(Pair())
    assert pair.env_method("double", 4) == [8, 8]
    assert pair.env_method("double", 4, indices=1) == [8]
    assert pair.env_method("double", 4, indices=[]) == []
    assert pair.get_attr("doubled") == [2, 2]  # a method is called once, whoever asks
    pair.set_attr("doubled", 0, indices=[0])
    assert pair.get_attr("doubled", [1]) == [0]
    assert not pair.has_attr("tripled")
    assert pair.env_is_wrapped(Monitor) == [False, False]


def test_a_picture_shows_all_agents():
    agents = to_pettingzoo(Pursuit(3, 2), render_mode="rgb_array")
    together = AgentsVecEnv(agents)
    together.reset()
    assert np.array_equal(together.render(), agents.render())
    together.close()


# -- what it refuses ---------------------------------------------------------------------------


def test_other_environments_are_refused():
    with pytest.raises(SettingError, match="must be a ParallelEnv"):
        AgentsVecEnv(VectorPursuit(Pursuit()))


def test_agents_must_see_alike():
    with pytest.raises(SettingError, match=r"one observation space: a has .*3.* b has .*4"):
        AgentsVecEnv(Pair(spaces={"a": Discrete(3), "b": Discrete(4)}))


def test_agents_must_end_together():
    pair = AgentsVecEnv(Pair(ends=(False, True)))
    pair.reset()
    pair.step(np.array([0, 0]))
    pair.step(np.array([0, 0]))
    with pytest.raises(SettingError, match="ended for b alone"):
        pair.step(np.array([0, 0]))


def test_agents_must_begin_together():
    pair = AgentsVecEnv(Pair(born=("a",)))
    with pytest.raises(SettingError, match="begin and end together: b observed nothing"):
        pair.reset()


# -- learning ----------------------------------------------------------------------------------


@pytest.mark.parametrize("acting", ["all", "first"])
def test_vectors_pass_stable_baselines_checks(acting):
    check_env(VectorPursuit(Pursuit(10, 4), acting=acting), warn=True)


@pytest.mark.parametrize(
    "make",
    [
        lambda agents: PPO("MlpPolicy", agents, n_steps=32, batch_size=32, n_epochs=1, seed=0),
        lambda agents: DQN("MlpPolicy", agents, learning_starts=30, train_freq=10, seed=0),
    ],
)
def test_one_model_learns_for_all_agents_and_counts_their_steps(make):
    agents = AgentsVecEnv(to_pettingzoo(Pursuit(3, 3, time_limit=10), observation="vector"))
    monitored = VecMonitor(agents)
    model = make(monitored)
    before = [weight.clone() for weight in model.policy.parameters()]
    model.learn(240)
    assert model.num_timesteps == 3 * agents.joint_steps >= 240
    assert any(
        not torch.equal(a, b) for a, b in zip(before, model.policy.parameters(), strict=True)
    )
    lengths = [episode["l"] for episode in model.ep_info_buffer]
    assert lengths
    assert lengths[::3] == lengths[1::3] == lengths[2::3]  # an episode is recorded for each agent
    assert max(lengths) <= 10


def potential_of_one(hunt, chase):
    """What one predator alone valued, as each agent reads it."""
    task = observed_pursuit(hunt, acting="first")
    mapping = predator_mapping(task, chase, predator="predator_1")
    edge = Transfer("chase", "hunt", mapping)
    return ObservationPotential(task, [edge], [TableValues(solve(chase).action_values)])


def test_each_agent_s_rewards_are_shaped_by_what_it_sees():
    hunt = Pursuit(3, 2, time_limit=8)
    phi = potential_of_one(hunt, Pursuit(3, 1))
    agents = AgentsVecEnv(to_pettingzoo(hunt, observation="vector"))
    shaped = ShapedVecEnv(agents, phi, discount=0.99)
    shaped.seed(1)
    here, rng, kinds = shaped.reset(), np.random.default_rng(0), set()
    for _ in range(200):
        there, rewards, over, infos = shaped.step(rng.integers(5, size=2))
        last = np.stack([info.get("terminal_observation", there[0]) for info in infos])
        cut = infos[0]["TimeLimit.truncated"]
        reached = phi.v(last if over[0] else there) * (not over[0] or cut)
        paid = np.array([info["original_reward"] for info in infos])
        np.testing.assert_allclose(rewards, paid + 0.99 * reached - phi.v(here), atol=1e-12)
        kinds.add((bool(over[0]), cut))
        here = there
    assert kinds == {(False, False), (True, False), (True, True)}


def test_a_potential_of_one_predator_guides_every_agent():
    """Agents that follow what one predator alone valued catch the prey far sooner than others."""
    hunt = Pursuit(4, 2)
    phi = potential_of_one(hunt, Pursuit(4, 1))
    task = phi.task
    agents = VecMonitor(AgentsVecEnv(to_pettingzoo(hunt, observation="vector")))
    assert agents.observation_space == task.observations
    assert agents.action_space == task.actions

    class Advised:
        def predict(self, observation, **_):
            return phi.pairs(observation).argmax(axis=1), None

    class Untaught:
        rng = np.random.default_rng(0)

        def predict(self, observation, **_):
            return self.rng.integers(5, size=len(observation)), None

    agents.seed(0)
    guided, _ = evaluate_policy(Advised(), agents, n_eval_episodes=200)
    random_return, _ = evaluate_policy(Untaught(), agents, n_eval_episodes=60)
    assert guided > -8  # about 5 steps; the optimum together is 4.6
    assert random_return < 10 * guided
