"""Algorithms that learn in tasks a teacher draws: ends, logs, potentials, and what is refused."""

from functools import partial
from itertools import cycle, islice

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv

import curricle as cr
from curricle.deep import CurriculumCallback, CurriculumVecEnv, ShapedVecEnv
from curricle.errors import SettingError
from curricle.teaching import (
    TSCL,
    Learnability,
    TrueLearningProgress,
    TrueRegret,
)
from tests.refusals import cases, check_refusal

from .walks import TASKS, Recorder, Walk, curriculum, played, walk

torch.set_num_threads(1)


# -- learning ------------------------------------------------------------------------------------


ALGORITHMS = {
    "A2C": partial(A2C, "MlpPolicy", seed=0),
    "PPO": partial(PPO, "MlpPolicy", n_steps=64, n_epochs=1, seed=0),
    "DQN": partial(DQN, "MlpPolicy", learning_starts=20, buffer_size=600, seed=0),
}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_algorithms_learn_and_log_each_task(algorithm):
    check_env(Walk(4))
    venv = curriculum(envs=2)
    model = ALGORITHMS[algorithm](venv)
    model.learn(600, callback=CurriculumCallback(), log_interval=10**9)
    logged = model.logger.name_to_value
    shares = [logged[f"curriculum/{name}/share"] for name in TASKS]
    assert sum(shares) == pytest.approx(1)
    assert all(0 <= logged[f"curriculum/{name}/ep_rew_mean"] <= 1 for name in TASKS)
    assert venv.steps_per_task.sum() == model.num_timesteps
    assert {info["r"] for info in model.ep_info_buffer} <= {0.0, 1.0}


def test_the_replay_buffer_holds_the_true_ends():
    venv = curriculum(envs=1)
    model = DQN("MlpPolicy", venv, learning_starts=10**6, buffer_size=300, seed=0)
    model.learn(300)
    stored = model.replay_buffer
    before, after = stored.observations[:, 0], stored.next_observations[:, 0]
    np.testing.assert_array_equal(before[:, 0], after[:, 0])  # one task
    np.testing.assert_array_equal(before[:, 2] + 1, after[:, 2])  # one step later
    at_end = after[:, 1] == after[:, 0] - 1
    np.testing.assert_array_equal(stored.dones[:, 0] * (1 - stored.timeouts[:, 0]), at_end)
    np.testing.assert_array_equal(stored.rewards[:, 0], at_end)
    assert 0 < at_end.sum() < stored.dones.sum()


def height(observations):
    return 3.0 * observations[:, 1]


def test_a_potential_goes_around_it_and_the_teacher_sees_the_tasks_own_rewards():
    teachers = Recorder(), Recorder()
    bare = curriculum(teachers[0])
    inside = curriculum(teachers[1])
    shaped = ShapedVecEnv(inside, height, discount=0.9, batched=True)
    one, other = played(bare), played(shaped)
    before = one[0][0]
    for mine, yours in zip(one[1:], other[1:], strict=True):
        np.testing.assert_array_equal(mine[0], yours[0])
        for i, info in enumerate(yours[3]):
            last = info.get("terminal_observation", yours[0][i])
            ended = yours[2][i] and not info["TimeLimit.truncated"]
            f = 0.9 * (0 if ended else 3 * last[1]) - 3 * before[i][1]
            assert yours[1][i] == pytest.approx(mine[1][i] + f, abs=1e-5)
            assert info["task"] == mine[3][i]["task"]
        before = mine[0]
    for a, b in zip(teachers[0].seen, teachers[1].seen, strict=True):
        np.testing.assert_array_equal(a.rewards, b.rewards)
    model = PPO("MlpPolicy", shaped, n_steps=64, n_epochs=1, gamma=0.9)
    model.learn(128, callback=CurriculumCallback(), log_interval=10**9)
    assert "curriculum/long/share" in model.logger.name_to_value


def test_runs_of_one_seed_are_equal_bit_for_bit():
    found = []
    for _ in range(2):
        model = ALGORITHMS["PPO"](curriculum(TSCL()))
        model.learn(512)
        found.append([weight.detach().clone() for weight in model.policy.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


# -- what is refused -----------------------------------------------------------------------------

TWO = {"short": TASKS["short"], "long": TASKS["long"]}
MAZE = cr.GridWorld("S..T", time_limit=9)


def without_successes():
    make = partial(gym.make, "CartPole-v1")
    tasks = {n: cr.observation_task(make, time_limit=k) for n, k in (("a", 3), ("b", 4))}
    venv = CurriculumVecEnv(tasks, Learnability(), target="b")
    venv.reset()
    for action in islice(cycle([0, 1]), 4):
        venv.step([action])


def log_without():
    A2C("MlpPolicy", DummyVecEnv([lambda: Walk(4)])).learn(5, callback=CurriculumCallback())


@pytest.mark.parametrize(
    ("error", "call", "says"),
    cases(
        {
            SettingError: {
                "target": (lambda: curriculum(target="x"), "one of short, middle, long: got 'x'"),
                "one": (
                    lambda: CurriculumVecEnv({"long": TASKS["long"]}, target="long"),
                    "two tasks or more: got 'long' alone",
                ),
                "list": (lambda: curriculum(tasks=[1]), "tasks must be a dict"),
                "tables": (
                    lambda: CurriculumVecEnv({**TWO, "maze": MAZE}, target="long"),
                    "through observations: 'maze' is",
                ),
                "regret": (lambda: curriculum(TrueRegret()), "without exact values.*TrueRegret"),
                "progress": (lambda: curriculum(TrueLearningProgress()), "which need tables"),
                "teacher": (lambda: curriculum(TSCL), "must have the methods start"),
                "observations": (
                    lambda: CurriculumVecEnv({**TWO, "o": walk(3, size=4)}, target="long"),
                    "share their observations: 'o' has Box.*4.* and 'long' has Box.*8",
                ),
                "actions": (
                    lambda: CurriculumVecEnv({**TWO, "o": walk(3, actions=3)}, target="long"),
                    r"share their actions: 'o' has Discrete\(3\) and 'long' has Discrete\(2\)",
                ),
                "discount": (
                    lambda: CurriculumVecEnv({**TWO, "o": walk(3, discount=0.5)}, target="long"),
                    "share their discount: 'o' has 0.5 and 'long' has 0.9",
                ),
                "envs": (lambda: curriculum(envs=0), "envs must be a whole number"),
                "success": (lambda: curriculum(success="yes"), "success must be a number"),
                "no success": (without_successes, "by success=: 'a' ended one without|'b' ended"),
                "log": (log_without, "a CurriculumVecEnv must be inside"),
            },
        }
    ),
)
def test_refusals(error, call, says):
    check_refusal(error, call, says)
