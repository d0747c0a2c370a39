"""Encoders of observations: their spaces, tasks that have them, and what they refuse."""

import pickle
import subprocess
import sys
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Text
from gymnasium.wrappers import FlattenObservation, TransformObservation

import curricle as cr
from curricle.errors import SettingError, TaskError
from curricle.interop import FlatDict, FunctionEncoder, StackedFrames
from curricle.tasks.observation_task import EnvironmentMaker
from tests.refusals import check_values

HALF = Box(-np.inf, np.inf, (4,), np.float32)
PARTS = Dict(
    sight=Box(-1, 1, (2, 2), np.float32),
    card=Discrete(3, start=1),
    dice=MultiDiscrete([2, 3], start=[1, -4]),
    lamps=MultiBinary(2),
    inner=Dict(far=Discrete(2)),
    words=Text(20),
)
SEEN = {
    "sight": np.array([[0.5, -0.5], [1, 0]], np.float32),
    "card": 3,
    "dice": np.array([2, -4]),
    "lamps": np.array([1, 0], np.int8),
    "inner": {"far": 1},
    "words": "open the door",
}


def halved(cart):
    return cart / 2


def in_parts():
    return TransformObservation(gym.make("CartPole-v1"), lambda _: SEEN, PARTS)


def picture(cart, shape=(3, 5, 6)):
    return np.full(shape, cart[0], np.float32)


def camera(cart):
    return picture(cart, (5, 6, 3))


def test_a_function_with_a_space_is_an_encoder():
    task = cr.observation_task("CartPole-v1", encode=FunctionEncoder(halved, HALF))
    assert task.observations == HALF
    encoded, plain = task.environment(), gym.make("CartPole-v1")
    np.testing.assert_array_equal(encoded.reset(seed=3)[0], plain.reset(seed=3)[0] / 2)
    np.testing.assert_array_equal(encoded.step(1)[0], plain.step(1)[0] / 2)
    assert task.longest == 500


def test_tasks_are_equal_by_environment_and_encoder():
    def task(function=halved, **settings):
        return cr.observation_task(
            "CartPole-v1", encode=FunctionEncoder(function, HALF), **settings
        )

    assert task() == task()
    assert task() != task(camera)
    assert task() != cr.observation_task("CartPole-v1")
    assert task() != task(discount=0.5)
    assert pickle.loads(pickle.dumps(task())) == task()
    assert hash(EnvironmentMaker("CartPole-v1")) == hash(EnvironmentMaker("CartPole-v1"))


def test_the_text_of_a_task_is_the_same_in_every_process():
    code = (
        "import curricle as cr, tests.unit.interop.test_encoders as t\n"
        "print(cr.observation_task('CartPole-v1', encode=cr.interop.StackedFrames(3, "
        "cr.interop.FunctionEncoder(t.halved, t.HALF))))\n"
        "print(cr.observation_task(t.in_parts, encode=cr.interop.FlatDict(['words'])))"
    )
    texts = {
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    }
    (text,) = texts
    assert " at 0x" not in text
    assert "StackedFrames(n=3, of=FunctionEncoder(tests.unit.interop.test_encoders:halved" in text
    assert "in_parts(encode=FlatDict(leave_out=('words',)))" in text


def test_a_dict_of_numbers_becomes_a_vector():
    env = FlatDict(leave_out=["words"])(in_parts())
    seen, _ = env.reset(seed=0)
    parts = {
        "sight": [0.5, -0.5, 1, 0],
        "card": [0, 0, 1],  # 3 of 1..3
        "dice": [0, 1, 1, 0, 0],  # 1 of 2 and 0 of 3
        "lamps": [1, 0],
        "inner": [0, 1],
    }
    # In the order of the space.
    wanted = np.concatenate([parts[key] for key in PARTS.spaces if key in parts])
    np.testing.assert_array_equal(seen, wanted)
    assert seen.dtype == np.float32
    assert seen in env.observation_space
    assert FlatDict(["a"]) == FlatDict(("a",))


def test_frames_are_stacked_oldest_first():
    env, plain = StackedFrames(3)(gym.make("CartPole-v1")), gym.make("CartPole-v1")
    first, _ = plain.reset(seed=1)
    np.testing.assert_array_equal(env.reset(seed=1)[0], np.tile(first, 3))
    later = [plain.step(a)[0] for a in (0, 1)]
    for action in (0, 1):
        seen = env.step(action)[0]
    np.testing.assert_array_equal(seen, np.concatenate([first, *later]))
    assert seen in env.observation_space


@pytest.mark.parametrize(
    ("function", "shape", "axis"), [(picture, (3, 5, 6), 0), (camera, (5, 6, 3), -1)]
)
def test_pictures_are_stacked_by_their_channels(function, shape, axis):
    encoder = FunctionEncoder(function, Box(-9, 9, shape, np.float32))
    env, plain = StackedFrames(2, encoder)(gym.make("CartPole-v1")), gym.make("CartPole-v1")
    frames = [function(plain.reset(seed=0)[0]), function(plain.step(1)[0])]
    env.reset(seed=0)
    seen = env.step(1)[0]
    np.testing.assert_array_equal(seen, np.concatenate(frames, axis=axis))
    assert seen in env.observation_space


def test_tables_have_encoded_observations_but_no_stacked_frames():
    one_hot = EnvironmentMaker("FrozenLake-v1", {"is_slippery": False}, FlattenObservation)
    table = cr.tabulate(one_hot, discount=0.9)
    assert table.observations.batch().shape == (table.states.size, 16)
    assert table.record.environment == str(one_hot)
    env = one_hot()
    assert table.state(env.reset(seed=0)[0]) == int(np.flatnonzero(table.mdp.start)[0])
    frames = EnvironmentMaker("FrozenLake-v1", encode=StackedFrames(2, FlattenObservation))
    with pytest.raises(TaskError, match="stacked frames cannot be tabulated"):
        cr.tabulate(frames, discount=0.9)


@pytest.mark.parametrize(
    ("made", "error", "sentence"),
    [
        (lambda: FlatDict()(in_parts()), TaskError, r"'words' is Text\("),
        (lambda: StackedFrames(2)(gym.make("Taxi-v4")), TaskError, r"of a Box: got Discrete\("),
        (
            lambda: cr.observation_task("CartPole-v1", encode=halved),
            TaskError,
            "halved failed with TypeError: .*; FunctionEncoder makes an encoder",
        ),
        (
            lambda: (
                cr.observation_task("CartPole-v1", encode=FunctionEncoder(halved, Box(0, 1, (3,))))
                .environment()
                .reset()
            ),
            TaskError,
            r"test_encoders:halved returned an array of shape \(4,\)",
        ),
    ],
)
def test_a_mistake_is_one_sentence(made, error, sentence):
    with pytest.raises(error, match=sentence) as caught:
        made()
    assert "\n" not in str(caught.value)


def test_wrong_values_are_named():
    check_values(SettingError, partial(FunctionEncoder, space=HALF), {"function": [3]})
    check_values(SettingError, FlatDict, {"leave_out": ["words"]})
    check_values(SettingError, StackedFrames, {"n": [1]})
    cart = partial(cr.observation_task, "CartPole-v1")
    check_values(TaskError, cart, {"encode": ["MiniGridView"]})
