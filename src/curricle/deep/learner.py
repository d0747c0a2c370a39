"""Deep learners: which algorithm of Stable-Baselines3, its settings, and which spaces it takes."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space

from curricle.checks import instance, whole_number
from curricle.errors import SettingError
from curricle.tasks.observation_task import ObservationTask, space_text

LIBRARIES = ("stable_baselines3", "sb3_contrib")  # where an algorithm's name is looked up
EXPLORING = ("DQN", "QRDQN")  # whose exploration falls over a share of the budget
SAVES = 20  # checkpoints to resume from that a run writes in all of its budget
LEAVES = (Box, Discrete, MultiDiscrete, MultiBinary)
LEAST_SIDE = 36  # cells of a picture's side that the convolutions of ``NatureCNN`` need


@dataclass(frozen=True)
class DeepLearner:
    """An algorithm of Stable-Baselines3, for tasks seen through observations.

    Parameters
    ----------
    algorithm : str
        Its name in ``stable_baselines3`` or ``sb3_contrib``, such as ``"DQN"``, ``"QRDQN"``,
        ``"PPO"`` or ``"SAC"``, or one's own class as ``module:Class``.
    policy : str
        ``"MlpPolicy"``, ``"CnnPolicy"`` or ``"MultiInputPolicy"``.
    envs : int
        Sub-environments. Steps are counted over all of them.
    settings : dict
        Other arguments of the algorithm, such as ``learning_rate``, ``buffer_size`` or
        ``policy_kwargs``. gamma is the task's discount.
    callbacks : callable, optional
        Returns new callbacks (``BaseCallback``); called for each seed.
    progress_bar : bool
        That of Stable-Baselines3.
    threads : int
        Of torch; more than one helps large networks only.

    Raises
    ------
    SettingError
        When a setting is invalid.

    Examples
    --------
    >>> DeepLearner("DQN", settings={"learning_rate": 5e-4})
    DeepLearner(DQN, MlpPolicy, learning_rate=0.0005)
    """

    algorithm: str = "DQN"
    policy: str = "MlpPolicy"
    envs: int = 1
    settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    callbacks: Callable[[], Sequence[Any]] | None = field(default=None, compare=False)
    progress_bar: bool = field(default=False, compare=False)
    threads: int = 1

    def __post_init__(self) -> None:
        for name in ("algorithm", "policy"):
            instance(f"{name} of a deep learner", getattr(self, name), str, SettingError)
        for name in ("envs", "threads"):
            whole_number(f"{name} of a deep learner", getattr(self, name), 1, SettingError)
        instance("settings of a deep learner", self.settings, Mapping, SettingError)
        taken = {"env", "policy", "seed", "gamma"} & set(self.settings)
        if taken:
            raise SettingError(
                "a deep learner's settings must leave out what Curricle sets itself: got "
                f"{', '.join(sorted(taken))}"
            )
        for name in ("policy_kwargs", "replay_buffer_kwargs"):
            if self.settings.get(name) is not None:
                instance(f"{name} of a deep learner", self.settings[name], Mapping, SettingError)
        object.__setattr__(self, "settings", dict(self.settings))

    def __repr__(self) -> str:
        settings = [f"{name}={_text(value)}" for name, value in self.settings.items()]
        envs = [f"envs={self.envs}"] if self.envs > 1 else []
        return f"DeepLearner({', '.join([self.algorithm, self.policy, *envs, *settings])})"

    @property
    def takes(self) -> tuple[str, ...]:
        """The names of the algorithm's arguments."""
        return tuple(inspect.signature(self.algorithm_class()).parameters)

    @property
    def scheduled(self) -> bool:
        """Whether a setting changes over the budget; an algorithm of one's own may have such."""
        values = (value for value in self.settings.values() if not isinstance(value, type))
        return ":" in self.algorithm or self.algorithm in EXPLORING or any(map(callable, values))

    def algorithm_class(self) -> Any:
        """Return the algorithm's class; ImportError without Stable-Baselines3."""
        module, colon, name = self.algorithm.rpartition(":")
        if colon:
            try:
                return getattr(import_module(module), name)
            except (ImportError, AttributeError) as error:
                raise SettingError(
                    f"an algorithm as module:Class must be there: {module}:{name} failed, {error}"
                ) from error
        libraries = {}
        for library in LIBRARIES:
            with suppress(ModuleNotFoundError):
                libraries[library] = import_module(library)
        if "stable_baselines3" not in libraries:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        for imported in libraries.values():
            if hasattr(imported, self.algorithm):
                return getattr(imported, self.algorithm)
        raise SettingError(
            f"an algorithm must be one of {' or '.join(LIBRARIES)} (looked in "
            f"{', '.join(libraries)}), or module:Class: got {self.algorithm!r}"
        )


def _text(value: Any) -> str:
    """Return a setting as text that is the same in every process."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {_text(inner)}" for name, inner in value.items()) + "}"
    return str(getattr(value, "__qualname__", None) or repr(value))


# -- which spaces a policy takes, told before anything runs ------------------------------------


def check_spaces(task: ObservationTask, learner: DeepLearner) -> None:
    """Raise SettingError unless a learner's policy takes a task's observations and actions."""
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
    observed = [("Observation", part) for part in parts.values()]
    for what, part in [("Action", task.actions), *observed]:
        if np.any(getattr(part, "start", 0)):
            raise SettingError(
                f"{what.lower()}s of a deep learner must count from 0: got {space_text(part)}; a "
                f"wrapper such as gymnasium.wrappers.Transform{what} makes them, as encode="
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
