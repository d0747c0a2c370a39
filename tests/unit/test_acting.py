"""Models act in episodes with the memory and the masks of actions that they were trained with."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete
from gymnasium.wrappers import TransformAction

import curricle as cr
from curricle.deep.learner import DeepLearner, check_spaces
from curricle.deep.networks import acting
from curricle.transfer.rollouts import Environments


class Countdown(gym.Env):
    """Pays the action; an episode lasts as long as its seed says."""

    observation_space = Box(0, 9, (1,), np.float32)
    action_space = Discrete(1000)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = int(self.np_random.integers(1, 9))
        return np.array([self.left], np.float32), {}

    def step(self, action):
        self.left -= 1
        return np.array([self.left], np.float32), float(action), self.left == 0, False, {}

    def action_masks(self):
        return np.arange(1000) == self.left


class Remembering:
    """Its action is the sum of the first entries of all observations of the episode."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        if state is None:
            state = (np.zeros((1, len(observation), 1)),)
        total = np.where(episode_start, 0, state[0][0, :, 0]) + observation[:, 0]
        return total.astype(int), (total[None, :, None],)


class Masked:
    def predict(
        self, observation, state=None, episode_start=None, deterministic=False, action_masks=None
    ):
        return action_masks.argmax(axis=1), None


def rewards(model):
    environments = Environments(cr.observation_task(Countdown, time_limit=20), 12, 20)
    episodes = environments.rollouts(acting(model, environments.environments), 5)
    assert len({len(episode.rewards) for episode in episodes}) > 3  # they end one after another
    return [(one.rewards, [int(seen[0]) for seen in one.observations]) for one in episodes]


def test_each_episode_keeps_its_own_memory_when_others_end():
    for paid, seen in rewards(Remembering()):
        assert paid.tolist() == np.cumsum(seen).tolist()


def test_masks_are_of_the_environments_that_are_still_running():
    for paid, seen in rewards(Masked()):
        assert paid.tolist() == seen


def test_policies_that_need_more_than_the_observation_are_not_read_by_it():
    lake = cr.tabulate("FrozenLake-v1", discount=0.9)
    with pytest.raises(cr.errors.SettingError, match="Masked needs masks of actions"):
        lake.policy(Masked())
    policy = SimpleNamespace(lstm_actor=None, predict=Remembering().predict)
    with pytest.raises(cr.errors.SettingError, match="needs memory"):
        lake.policy(SimpleNamespace(policy=policy))


class From(gym.Env):
    """Two steps in an environment of spaces of its own."""

    def __init__(self, observations=None, actions=None):
        self.observation_space = observations or Discrete(3)
        self.action_space = actions or Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return self.observation_space.start, {}

    def step(self, action):
        assert self.action_space.contains(action)
        self.steps += 1
        return self.observation_space.start + self.steps, 1.0, self.steps == 2, False, {}


FROM_1 = Discrete(2, start=1)


@pytest.mark.parametrize(
    ("spaces", "message"),
    [
        ({"actions": FROM_1}, "actions .* count from 0: got Discrete.2, start=1.*TransformAction "),
        ({"actions": MultiDiscrete([2, 2], start=[0, 1])}, "actions .* count from 0"),
        ({"observations": Discrete(3, start=-1)}, "observations .* count from 0.*Observation "),
        ({"observations": MultiDiscrete([2, 2], start=[3, 0])}, "observations .* count from 0"),
        ({"observations": Dict(far=Box(0, 1), card=FROM_1)}, "observations .* count from 0"),
    ],
)
def test_networks_take_no_spaces_that_do_not_count_from_0(spaces, message):
    policy = "MultiInputPolicy" if isinstance(spaces.get("observations"), Dict) else "MlpPolicy"
    task = cr.observation_task(From, **spaces)
    with pytest.raises(cr.errors.SettingError, match=message):
        check_spaces(task, DeepLearner("PPO", policy))


def shifted(env):
    return TransformAction(env, lambda action: action + 1, Discrete(2))


def test_actions_of_tables_count_from_0_where_a_model_is_read():
    model = SimpleNamespace(predict=lambda seen, deterministic: np.ones(len(seen), int))
    made = cr.tabulate(lambda: From(actions=FROM_1), discount=0.9)
    assert made.actions.size == 2
    with pytest.raises(cr.errors.SettingError, match=r"must count from 0.*TransformAction"):
        made.policy(model)
    assert cr.tabulate(lambda: shifted(From(actions=FROM_1)), discount=0.9).policy(model).all()
