"""Deep learners: which algorithm of Stable-Baselines3, and its settings."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from curricle.checks import instance, whole_number
from curricle.errors import SettingError

LIBRARIES = ("stable_baselines3", "sb3_contrib")
"""Where an algorithm's name is looked up."""
SAVES = 20
"""Checkpoints to resume from that a run writes in all of its budget."""


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
        Whether Stable-Baselines3 shows its progress bar.
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
            given = self.settings.get(name)
            if given is not None:
                instance(f"{name} of a deep learner", given, Mapping, SettingError)
        object.__setattr__(self, "settings", dict(self.settings))

    def __repr__(self) -> str:
        settings = [f"{name}={_text(value)}" for name, value in self.settings.items()]
        envs = [f"envs={self.envs}"] if self.envs > 1 else []
        return f"DeepLearner({', '.join([self.algorithm, self.policy, *envs, *settings])})"

    @property
    def takes(self) -> tuple[str, ...]:
        """The names of the algorithm's arguments."""
        return tuple(inspect.signature(self.algorithm_class()).parameters)

    def algorithm_class(self) -> Any:
        """Return the algorithm's class; ImportError without Stable-Baselines3."""
        module, colon, name = self.algorithm.rpartition(":")
        if colon:
            return _own(module, name)
        found = {}
        for library in LIBRARIES:
            with suppress(ModuleNotFoundError):
                found[library] = import_module(library)
        if "stable_baselines3" not in found:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        for imported in found.values():
            if hasattr(imported, self.algorithm):
                return getattr(imported, self.algorithm)
        raise SettingError(
            f"an algorithm must be one of {' or '.join(LIBRARIES)} (looked in "
            f"{', '.join(found)}), or module:Class: got {self.algorithm!r}"
        )


def _text(value: Any) -> str:
    """Return a setting as text that is the same in every process."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {_text(one)}" for name, one in value.items()) + "}"
    return str(getattr(value, "__qualname__", None) or repr(value))


def _own(module: str, name: str) -> Any:
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise SettingError(
            f"an algorithm as module:Class must be there: {module}:{name} failed, {error}"
        ) from error
