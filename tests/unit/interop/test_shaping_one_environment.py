"""Shaping one environment, beside a slow oracle that writes F = gamma Phi(s') - Phi(s) out."""

import copy
import pickle
from contextlib import contextmanager

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import Autoreset, RecordEpisodeStatistics, TimeLimit

import curricle as cr
from curricle.interop.potential_shaping import PotentialShaping

from .shaping import (
    DISCOUNT,
    LIMIT,
    NONE,
    PHI,
    SOME,
    actions_of,
    episodes_of,
    shaped_steps,
    table,
    world,
)


@pytest.mark.parametrize("discount", [0.0, DISCOUNT, 1.0])
@pytest.mark.parametrize(("terminal", "limit"), [(SOME, LIMIT), (SOME, 10**6), (NONE, LIMIT)])
def test_each_step_gets_what_the_oracle_writes_out(terminal, limit, discount):
    actions = actions_of(300)
    env = PotentialShaping(world(terminal, limit), table, discount=discount)
    steps = iter(shaped_steps(env, actions))
    for episode in episodes_of(world(terminal, limit), actions):
        total = 0.0
        for place, (state, reward, following, terminated) in enumerate(episode):
            after = 0.0 if terminated else PHI[following]
            shaping = discount * after - PHI[state]
            got, info = next(steps)
            total += reward
            assert got == reward + shaping
            assert info["original_reward"] == reward
            assert info["shaping"] == shaping
            assert info["shaping_terms"] == {"potential": shaping}
            assert info["potential"] == after
            assert info["at"] == 1
            if place == len(episode) - 1 and "original_return" in info:
                assert info["original_return"] == pytest.approx(total, abs=1e-12)
                assert abs(info["telescoping_residual"]) < 1e-12
    assert next(steps, None) is None


def test_only_ends_of_episodes_report_a_residual():
    env = PotentialShaping(world(), table, discount=DISCOUNT)
    env.reset(seed=0)
    for _ in range(100):
        _, _, terminated, truncated, info = env.step(0)
        told = {"telescoping_residual", "original_return"} & set(info)
        assert len(told) == (2 if terminated or truncated else 0)
        if told:
            env.reset()


class Corridor(gym.Env):
    """Cells in a row; the last is the end, and every step costs 1."""

    def __init__(self, cells=3):
        self.observation_space, self.action_space = (
            gym.spaces.Discrete(cells),
            gym.spaces.Discrete(2),
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.cell = 0
        return 0, {}

    def step(self, action):
        self.cell = max(0, self.cell + (1 if action else -1))
        return self.cell, -1.0, self.cell == self.observation_space.n - 1, False, {}


def test_a_hand_sized_episode():
    env = PotentialShaping(Corridor(), [10.0, 20.0, 40.0].__getitem__, discount=0.5)
    env.reset()
    assert env.step(1)[1] == -1 + 0.5 * 20 - 10
    assert env.step(1)[1] == -1 + 0 - 20  # the end is worth nothing, whatever the potential says
    env = PotentialShaping(TimeLimit(Corridor(), 1), [10.0, 20.0, 40.0].__getitem__, discount=0.5)
    env.reset()
    _, reward, terminated, truncated, info = env.step(1)
    assert (terminated, truncated, reward) == (False, True, -1 + 0.5 * 20 - 10)
    assert info["potential"] == 20.0


def test_statistics_inside_stay_unshaped():
    env = PotentialShaping(RecordEpisodeStatistics(world()), table, discount=DISCOUNT)
    ends = [info for _, info in shaped_steps(env, actions_of(100)) if "episode" in info]
    assert ends
    for info in ends:
        assert info["episode"]["r"] == pytest.approx(info["original_return"], abs=1e-12)


def test_an_environment_that_resets_itself_keeps_the_reward_of_its_reset():
    env = PotentialShaping(Autoreset(world()), table, discount=DISCOUNT)
    state, _ = env.reset(seed=0)
    over, resets = False, 0
    for action in actions_of(100).tolist():
        following, reward, terminated, truncated, info = env.step(action)
        if over:
            resets += 1
            assert (reward, info["shaping"], info["potential"]) == (0.0, 0.0, PHI[following])
            assert info["begun"] == 1
        else:
            after = 0.0 if terminated else PHI[following]
            assert info["shaping"] == DISCOUNT * after - PHI[state]
            assert reward == info["original_reward"] + info["shaping"]
        over, state = terminated or truncated, following
    assert resets > 5


@contextmanager
def logged_warnings(monkeypatch):
    said = []
    monkeypatch.setattr(gym.logger, "warn", lambda message, *rest, **settings: said.append(message))
    yield said


def test_gymnasiums_own_checker_passes(monkeypatch):
    lake = gym.make("FrozenLake-v1", disable_env_checker=True)
    env = PotentialShaping(lake, lambda square: square / 15, discount=0.9)
    with logged_warnings(monkeypatch) as said:
        check_env(env, skip_render_check=True)  # pictures of the lake need pygame
    # It says of every wrapper that it is one.
    assert [text for text in said if "different from the unwrapped version" not in text] == []


def lake_potential():
    lake = gym.make("FrozenLake-v1")
    mdp = cr.FiniteMDP.from_outcomes(lake.unwrapped.P, start=0, discount=0.9, time_limit=100)
    return cr.StatePotential(mdp, np.linspace(0, 1, 16))


def followed(env, actions):
    return [env.step(action)[:4] for action in actions]


def test_the_spec_makes_the_same_environment_again():
    env = PotentialShaping(gym.make("FrozenLake-v1"), lake_potential(), weight=0.5)
    again = gym.make(env.spec)
    assert isinstance(again, PotentialShaping)
    assert str(again) == str(env)
    assert again.spec.additional_wrappers[-1].kwargs["weight"] == 0.5
    env.reset(seed=1)
    again.reset(seed=1)
    assert followed(again, [1, 1, 2]) == followed(env, [1, 1, 2])


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_where_the_original_is(clone):
    env = PotentialShaping(
        gym.make("FrozenLake-v1"), lake_potential(), weight=cr.learning.linear(1.0, 0.0, steps=9)
    )
    env.reset(seed=0)
    env.step(2)
    twin = clone(env)
    assert followed(twin, [2, 2, 1]) == followed(env, [2, 2, 1])
