"""RecurrentPPO and MaskablePPO: evaluated and played with their memory and masks, or refused."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

import curricle as cr
from curricle.deep import DeepLearner
from curricle.deep.distillation import distil
from curricle.deep.miniature import Knowledge
from curricle.errors import PotentialError, SettingError

pytest.importorskip("sb3_contrib")
SMALL = {"n_steps": 32, "batch_size": 32, "n_epochs": 1}
RECURRENT = DeepLearner(
    "RecurrentPPO", "MlpLstmPolicy", settings={**SMALL, "policy_kwargs": {"lstm_hidden_size": 8}}
)
MASKABLE = DeepLearner("MaskablePPO", envs=2, settings=SMALL)


class Drifting(gym.Env):
    """Noise is observed; an episode lasts as long as its seed says, and pays the actions."""

    observation_space = Box(-9, 9, (2,), np.float32)
    action_space = Discrete(5)
    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - as Gymnasium has it

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def render(self):
        return np.zeros((8, 8, 3), np.uint8)

    def seen(self):
        return self.np_random.normal(size=2).astype(np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = int(self.np_random.integers(3, 20))
        return self.seen(), {}

    def step(self, action):
        assert self.possible()[action]
        self.left -= 1
        return self.seen(), float(action), self.left == 0, False, {}

    def possible(self):
        return np.ones(5, bool)


class Forbidding(Drifting):
    """An action that is not possible is an error."""

    def possible(self):
        return np.arange(5) == self.left % 5

    def action_masks(self):
        return self.possible()


DRIFTING = cr.observation_task(Drifting, time_limit=30)
FORBIDDING = cr.observation_task(Forbidding, time_limit=30)


def actions_alone(model, env, seed):
    """Return the actions of one episode, with its state passed from step to step."""
    seen, _ = env.reset(seed=seed)
    state, actions, over = None, [], False
    while not over:
        begins = np.array([not actions])
        action, state = model.predict(seen[None], state, begins, deterministic=True)
        actions.append(int(action[0]))
        seen, _, over, _, _ = env.step(actions[-1])
    return actions


def test_masked_policies_are_evaluated_and_played_with_masks():
    result = cr.deep.learn_deep(FORBIDDING, MASKABLE, 128, seeds=2, eval_freq=64)
    assert np.isfinite(result.greedy_return).all()
    for deterministic in (True, False):
        episode = result.policy.episode(seed=4, deterministic=deterministic)
        assert episode.terminated
        left = np.arange(len(episode.rewards), 0, -1)
        assert episode.rewards.tolist() == (left % 5).tolist()


def test_a_remembering_policy_is_played_with_its_memory():
    policy = cr.deep.learn_deep(DRIFTING, RECURRENT, 32, eval_freq=32).policy
    for seed in range(3):
        alone = actions_alone(policy.model, Drifting(), seed)
        assert policy.episode(seed=seed).actions.tolist() == alone


def test_environments_without_masks_are_refused_before_anything_runs():
    with pytest.raises(SettingError, match=r"MaskablePPO needs .*action_masks.*ActionMasker"):
        cr.deep.learn_deep(DRIFTING, MASKABLE, 64)


def test_what_an_observation_does_not_decide_is_not_read_by_it():
    recurrent = cr.deep.learn_deep(DRIFTING, RECURRENT, 32, eval_freq=32)
    masked = cr.deep.learn_deep(FORBIDDING, MASKABLE, 64, eval_freq=64)
    seen = np.zeros((3, 2), np.float32)
    with pytest.raises(SettingError, match=r"needs memory, which .*episode"):
        recurrent.policy.predict(seen)
    with pytest.raises(SettingError, match="needs masks of actions"):
        masked.policy.predict(seen)
    with pytest.raises(PotentialError, match="without memory"):
        recurrent.values[0].v(seen)
    assert np.isfinite(masked.values[0].v(seen)).all()
    known = Knowledge.of(seen, np.eye(3, 5), np.eye(3, 5))
    for task, learner in ((DRIFTING, RECURRENT), (FORBIDDING, MASKABLE)):
        with pytest.raises(SettingError, match="without memory or masks"):
            distil(known, task, learner)
