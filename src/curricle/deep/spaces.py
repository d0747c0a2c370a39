"""Which spaces a policy of Stable-Baselines3 takes, told before anything runs."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space

from curricle.deep.learner import DeepLearner
from curricle.errors import SettingError
from curricle.tasks.observation_task import ObservationTask, space_text

LEAVES = (Box, Discrete, MultiDiscrete, MultiBinary)
LEAST_SIDE = 36
"""Cells of a picture's side that the convolutions of ``NatureCNN`` need."""


def check_spaces(task: ObservationTask, learner: DeepLearner) -> None:
    """Raise SettingError unless a learner's policy takes a task's observations and actions.

    Examples
    --------
    >>> from curricle import observation_task
    >>> check_spaces(observation_task("CartPole-v1"), DeepLearner(policy="CnnPolicy"))
    Traceback (most recent call last):
    curricle.errors.SettingError: CnnPolicy reads a picture, a Box of three dimensions: ...
    """
    space, policy = task.observations, learner.policy
    if not isinstance(task.actions, LEAVES):
        raise SettingError(
            "actions of a deep learner must be a Box, Discrete, MultiDiscrete or MultiBinary: got "
            f"{space_text(task.actions)}"
        )
    parts = space.spaces if isinstance(space, Dict) else {"": space}
    for key, part in parts.items():
        if not isinstance(part, LEAVES):
            name = f"the part {key!r} is" if key else "got"
            raise SettingError(
                "observations of a deep learner must be a Box, Discrete, MultiDiscrete or "
                f"MultiBinary, or a Dict of these: {name} {space_text(part)}; {_encoders(parts)}"
            )
    if isinstance(space, Dict):
        if policy.startswith(("Mlp", "Cnn")):
            raise SettingError(
                f"{policy} reads one array: got {space_text(space)}; MultiInputPolicy reads a "
                f"Dict, and {_encoders(parts)}"
            )
    elif policy.startswith("MultiInput"):
        raise SettingError(f"{policy} reads a Dict: got {space_text(space)}; MlpPolicy reads that")
    _check_pictures(parts, learner)


def _check_pictures(parts: Mapping[str, Space[Any]], learner: DeepLearner) -> None:
    """Raise SettingError where the convolutions of Stable-Baselines3 cannot read a picture."""
    kwargs = learner.settings.get("policy_kwargs") or {}
    whole = learner.policy.startswith("Cnn")
    if "features_extractor_class" in kwargs or ("" in parts and not whole):
        return
    normalised = kwargs.get("normalize_images") is False
    for key, part in parts.items():
        solid = isinstance(part, Box) and len(part.shape) == 3
        if whole and not solid:
            raise SettingError(
                f"{learner.policy} reads a picture, a Box of three dimensions: got "
                f"{space_text(part)}; MlpPolicy reads that"
            )
        if whole and not (normalised or _is_picture(part)):
            raise SettingError(
                f"{learner.policy} reads a picture of bytes from 0 to 255, unless policy_kwargs "
                "has normalize_images=False, or a features_extractor_class such as SmallCNN: got "
                f"{space_text(part)}"
            )
        # The least of the three sides are the channels.
        if (whole or _is_picture(part)) and sorted(part.shape or ())[1] < LEAST_SIDE:
            small = (
                "a features_extractor_class such as SmallCNN in policy_kwargs reads smaller ones"
            )
            raise SettingError(
                f"{learner.policy} reads pictures by NatureCNN, which needs {LEAST_SIDE} cells a "
                f"side: {f'the part {key!r} is' if key else 'got'} {space_text(part)}; "
                f"{small if whole else _encoders(parts)}"
            )


def _is_picture(space: Space[Any]) -> bool:
    """Return whether Stable-Baselines3 takes a space for a picture, by itself."""
    if not isinstance(space, Box) or len(space.shape) != 3 or space.dtype != np.uint8:
        return False
    return bool((space.low == 0).all() and (space.high == 255).all())


def _encoders(parts: Mapping[str, Space[Any]]) -> str:
    """Return which encoder makes such observations fit."""
    if any(type(part).__module__.startswith("minigrid.") for part in parts.values()):
        return "encode=MiniGridView() makes MiniGrid's observations a vector"
    if len(parts) > 1:
        return "encode=FlatDict() makes a vector of a Dict of numbers"
    return "encode=FunctionEncoder(function, space) makes other observations of them"
