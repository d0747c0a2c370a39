"""Encoders of observations: their spaces, tasks that have them, and what they refuse."""

import pickle
import subprocess
import sys
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.wrappers import FlattenObservation, FrameStackObservation, TransformObservation

import curricle as cr
from curricle.errors import TaskError
from curricle.tasks.observation_task import EnvironmentMaker
from tests.support.refusals import check_values

HALF = Box(-np.inf, np.inf, (4,), np.float32)


def halved(cart):
    return cart / 2


half = partial(TransformObservation, func=halved, observation_space=HALF)


def test_a_wrapper_is_an_encoder():
    task = cr.observation_task("CartPole-v1", encode=half)
    assert task.observations == HALF
    encoded, plain = task.environment(), gym.make("CartPole-v1")
    np.testing.assert_array_equal(encoded.reset(seed=3)[0], plain.reset(seed=3)[0] / 2)
    np.testing.assert_array_equal(encoded.step(1)[0], plain.step(1)[0] / 2)
    assert task.longest == 500


def test_an_episode_is_cut_off_by_the_least_of_all_time_limits():
    def longer(env):
        return gym.wrappers.TimeLimit(env, 900)

    assert cr.observation_task("CartPole-v1", encode=longer).longest == 500
    assert cr.observation_task("CartPole-v1", encode=longer, max_episode_steps=-1).longest == 900
    with pytest.raises(TaskError, match=r"must not exceed .* 500 steps .* got 501"):
        cr.observation_task("CartPole-v1", time_limit=501)


def test_tasks_are_equal_by_environment_and_encoder():
    def task(encode=half, **settings):
        return cr.observation_task("CartPole-v1", encode=encode, **settings)

    assert task() == task()
    assert task() == task(partial(half.func, **half.keywords))
    assert task() != task(partial(half, func=abs))
    assert task() != task(FlattenObservation)
    assert task() != cr.observation_task("CartPole-v1")
    assert task() != task(discount=0.5)
    assert pickle.loads(pickle.dumps(task())) == task()
    assert hash(EnvironmentMaker("CartPole-v1")) == hash(EnvironmentMaker("CartPole-v1"))


def test_the_text_of_a_task_is_the_same_in_every_process():
    code = (
        "import curricle as cr, tests.unit.interop.test_encoders as t\n"
        "print(cr.observation_task('CartPole-v1', encode=t.half))"
    )
    texts = {
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    }
    (text,) = texts
    assert " at 0x" not in text
    assert "TransformObservation'>, func=<function halved>, observation_space=Box(" in text


def test_tables_have_encoded_observations_but_no_stacked_frames():
    one_hot = EnvironmentMaker("FrozenLake-v1", {"is_slippery": False}, FlattenObservation)
    table = cr.tabulate(one_hot, discount=0.9)
    assert table.observations.batch().shape == (table.states.size, 16)
    assert table.record.environment == str(one_hot)
    env = one_hot()
    assert table.state(env.reset(seed=0)[0]) == int(np.flatnonzero(table.mdp.start)[0])
    stacked = partial(FrameStackObservation, stack_size=2)
    frames = EnvironmentMaker("FrozenLake-v1", encode=stacked)
    with pytest.raises(TaskError, match="stacked frames cannot be tabulated"):
        cr.tabulate(frames, discount=0.9)


def test_what_is_no_wrapper_is_refused():
    cart = partial(cr.observation_task, "CartPole-v1")
    with pytest.raises(TaskError, match=r"halved failed with TypeError: .*; gymnasium\.wrap"):
        cart(encode=halved)
    check_values(TaskError, cart, {"encode": ["MiniGridView"]})
