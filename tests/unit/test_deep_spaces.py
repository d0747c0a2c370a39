"""What a policy of Stable-Baselines3 cannot take, told before anything runs; without torch."""

from functools import partial

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, Text
from gymnasium.wrappers import TransformAction, TransformObservation

import curricle as cr
from curricle.deep import DeepLearner
from curricle.deep.learner import check_spaces
from curricle.errors import SettingError


def same(observation):
    return observation


def task_of(space):
    encode = partial(TransformObservation, func=same, observation_space=space)
    return cr.observation_task("CartPole-v1", encode=encode)


PICTURE = Box(0, 255, (3, 36, 36), np.uint8)
SMALL = Box(0, 255, (7, 7, 3), np.uint8)
PLANES = Box(0, 1, (4, 40, 40), np.float32)
VECTOR = Box(0, 1, (4,), np.float32)
OWN = {"policy_kwargs": {"features_extractor_class": object}}
UNSCALED = {"policy_kwargs": {"normalize_images": False}}


@pytest.mark.parametrize(
    ("space", "policy", "settings"),
    [
        (VECTOR, "MlpPolicy", {}),
        (Discrete(3), "MlpPolicy", {}),
        (SMALL, "MlpPolicy", {}),
        (PICTURE, "CnnPolicy", {}),
        (PLANES, "CnnPolicy", UNSCALED),
        (SMALL, "CnnPolicy", OWN),
        (PLANES, "CnnPolicy", OWN),
        (Dict(a=VECTOR, b=PICTURE), "MultiInputPolicy", {}),
    ],
)
def test_these_are_taken(space, policy, settings):
    check_spaces(task_of(space), DeepLearner("PPO", policy, settings=settings))


@pytest.mark.parametrize(
    ("space", "policy", "sentence"),
    [
        (Text(4), "MlpPolicy", r"or a Dict of these: got Text\(.*TransformObservation"),
        (Dict(a=VECTOR, b=Text(4)), "MultiInputPolicy", r"the part 'b' is Text\(.*FlattenOb"),
        (Dict(a=Dict(b=VECTOR)), "MultiInputPolicy", r"the part 'a' is Dict\('b'"),
        (Dict(a=VECTOR, b=VECTOR), "MlpPolicy", r"reads one array: got Dict.*MultiInputPolicy.*Fl"),
        (VECTOR, "MultiInputPolicy", r"reads a Dict: got Box\(0.0, 1.0, \(4,\), float32\); Mlp"),
        (VECTOR, "CnnPolicy", r"three dimensions: got Box\(0.0, 1.0, \(4,\), float32\); MlpPol"),
        (PLANES, "CnnPolicy", r"normalize_images=False, .* SmallCNN: got Box\(0.0, 1.0, \(4, 40"),
        (SMALL, "CnnPolicy", r"36 cells a side: got Box\(0, 255, \(7, 7, 3\), uint8\); .*SmallC"),
    ],
)
def test_the_others_are_refused_by_name(space, policy, sentence):
    with pytest.raises(SettingError, match=sentence) as caught:
        check_spaces(task_of(space), DeepLearner("PPO", policy))
    assert "\n" not in str(caught.value)


def test_actions_must_be_numbers_too():
    def talking(env):
        return TransformAction(env, len, Text(4))

    with pytest.raises(SettingError, match=r"actions of a deep learner must be .*: got Text\("):
        check_spaces(cr.observation_task("CartPole-v1", encode=talking), DeepLearner())


def test_a_curriculum_refuses_before_its_sources_are_learnt():
    table = cr.GridWorld("S.T")
    mapping = cr.transfer.ObservationMapping(task_of(VECTOR), table, len)
    with pytest.raises(SettingError, match="CnnPolicy reads a picture"):
        cr.Curriculum(
            {"table": table, "pole": task_of(VECTOR)},
            [cr.Transfer("table", "pole", mapping)],
            learner={"table": cr.QLearning(), "pole": DeepLearner(policy="CnnPolicy")},
            budget=1000,
        )
