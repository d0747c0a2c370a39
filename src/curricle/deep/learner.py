"""Deep learners: algorithms of Stable-Baselines3, their spaces, and transfers of networks."""

import ast
import inspect
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from types import BuiltinFunctionType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space

from curricle.checks import instance, number, one_of, whole_number
from curricle.errors import SettingError
from curricle.learning.shaping import Shaping
from curricle.tasks.observation_task import ObservationTask, plain_text, stable_text

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

LIBRARIES = ("stable_baselines3", "sb3_contrib")  # where an algorithm's name is looked up
POLICIES = ("MlpPolicy", "CnnPolicy", "MultiInputPolicy")
OF_ACTIONS: dict[str, type[Space[Any]]] = {
    **dict.fromkeys(("DQN", "QRDQN"), Discrete),
    **dict.fromkeys(("CrossQ", "DDPG", "SAC", "TD3", "TQC"), Box),
}
"""Algorithms that take actions of one kind alone, and which."""
EXPLORING = ("DQN", "QRDQN")  # whose exploration falls over a share of the budget
LEAVES = (Box, Discrete, MultiDiscrete, MultiBinary)
LEAST_SIDE = 36  # cells of a picture's side that the convolutions of ``NatureCNN`` need
SMALLER = "a features_extractor_class such as SmallCNN in policy_kwargs reads smaller ones"


@dataclass(frozen=True)
class DeepLearner:
    """An algorithm of Stable-Baselines3, for tasks seen through observations.

    Parameters
    ----------
    algorithm : str
        Its name in ``stable_baselines3`` or ``sb3_contrib``, such as ``"DQN"`` or ``"PPO"``, or
        a class of yours as ``module:Class``.
    policy : str
        ``"MlpPolicy"``, ``"CnnPolicy"`` or ``"MultiInputPolicy"``.
    envs : int
        Number of sub-environments, over all of which steps are counted.
    settings : dict
        Other arguments of the algorithm, such as ``learning_rate``, ``buffer_size`` or
        ``policy_kwargs``; or what a file of RL Baselines3 Zoo says of an environment: ``normalize``
        standardises observations and rewards as ``VecNormalize`` does, but in the network, which
        keeps the statistics; ``n_timesteps``, ``env_wrapper`` and ``frame_stack`` are the budget's
        and the task's, so that they are left out with a warning; ``gamma`` must be its discount.
    callbacks : callable, optional
        Returns new callbacks (``BaseCallback``) for each seed.
    progress_bar : bool
        Whether Stable-Baselines3 shows its progress bar.
    threads : int
        Threads of torch; more than 1 helps large networks only.
    processes : bool
        Whether each sub-environment runs in a process (``SubprocVecEnv``), for slow environments.

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
    processes: bool = False

    def __post_init__(self) -> None:
        instance("settings of a deep learner", self.settings, Mapping, SettingError)
        settings = read_zoo(self.settings)
        for name, stated in {"policy": "policy", "envs": "n_envs"}.items():
            if stated in settings:
                argument, setting = getattr(self, name), settings.pop(stated)
                if argument not in (type(self).__dict__[name], setting):
                    raise SettingError(
                        f"{name} of a deep learner must be the same in its settings: got "
                        f"{argument} and {stated} = {setting}"
                    )
                object.__setattr__(self, name, setting)
        object.__setattr__(self, "settings", settings)
        for name in ("algorithm", "policy"):
            instance(f"{name} of a deep learner", getattr(self, name), str, SettingError)
        for name in ("envs", "threads"):
            whole_number(f"{name} of a deep learner", getattr(self, name), 1, SettingError)
        instance("processes of a deep learner", self.processes, bool, SettingError)
        if not (self.callbacks is None or callable(self.callbacks)):
            raise SettingError(
                "callbacks of a deep learner must be a function that returns a list of new ones "
                f"for each seed: got {self.callbacks!r}"
            )
        taken = {"env", "seed"} & set(settings)
        if taken:
            raise SettingError(
                "a deep learner's settings must leave out what Curricle sets itself: got "
                f"{', '.join(sorted(taken))}"
            )
        for name in ("policy_kwargs", "replay_buffer_kwargs"):
            if self.settings.get(name) is not None:
                instance(f"{name} of a deep learner", self.settings[name], Mapping, SettingError)

    def __repr__(self) -> str:
        settings = [f"{name}={_text(value)}" for name, value in self.settings.items()]
        envs = [f"envs={self.envs}"] * (self.envs > 1) + ["processes"] * self.processes
        return f"DeepLearner({', '.join([self.algorithm, self.policy, *envs, *settings])})"

    @property
    def takes(self) -> tuple[str, ...]:
        """The names of the algorithm's arguments."""
        return tuple(inspect.signature(self.algorithm_class()).parameters)

    @property
    def may_start_at_potential(self) -> bool:
        """Whether it is DQN with rewards as they are, or an algorithm of the user's own."""
        plain = self.policy in POLICIES and not self.normalizes("norm_reward")
        return ":" in self.algorithm or (self.algorithm == "DQN" and plain)

    @property
    def scheduled(self) -> bool:
        """Whether a setting may change over the budget; True for every algorithm of the user's."""
        values = (value for value in self.settings.values() if not isinstance(value, type))
        return ":" in self.algorithm or self.algorithm in EXPLORING or any(map(callable, values))

    @property
    def normal(self) -> dict[str, Any]:
        """The arguments of ``VecNormalize`` that its setting ``normalize`` states."""
        stated = self.settings.get("normalize")
        return {**stated} if isinstance(stated, Mapping) else {}

    def normalizes(self, what: str) -> bool:
        """Return whether it normalises observations (``norm_obs``) or rewards (``norm_reward``)."""
        stated = self.settings.get("normalize")
        return bool(self.normal.get(what, True) if isinstance(stated, Mapping) else stated)

    def algorithm_class(self) -> "type[BaseAlgorithm]":
        """Return the algorithm's class; ImportError without Stable-Baselines3."""
        module, colon, name = self.algorithm.rpartition(":")
        if colon:
            try:
                return getattr(import_module(module), name)  # type: ignore[no-any-return]
            except (ImportError, AttributeError) as error:
                raise SettingError(
                    f"an algorithm as module:Class must exist: {module}:{name} failed, {error}"
                ) from error
        libraries = {}
        for library in LIBRARIES:
            with suppress(ModuleNotFoundError):
                libraries[library] = import_module(library)
        if "stable_baselines3" not in libraries:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        for imported in libraries.values():
            if hasattr(imported, self.algorithm):
                return getattr(imported, self.algorithm)  # type: ignore[no-any-return]
        raise SettingError(
            f"an algorithm must be one of {' or '.join(LIBRARIES)} (looked in "
            f"{', '.join(libraries)}), or module:Class: got {self.algorithm!r}"
        )


# -- settings as RL Baselines3 Zoo writes them (its utils.py and exp_manager.py) -------------------

LEFT_OUT = {"n_timesteps": "the budget", "env_wrapper": "encode of the task",
            "frame_stack": "encode of the task"}  # fmt: skip
NOT_ARGUMENTS = ("gamma", "normalize", "noise_type", "noise_std")  # of algorithms
NORMAL = {"norm_obs", "norm_reward", "clip_reward", "epsilon"}  # arguments of VecNormalize
NOISE = {"normal": "NormalActionNoise", "ornstein-uhlenbeck": "OrnsteinUhlenbeckActionNoise"}


@dataclass(frozen=True)
class Linear:
    """A schedule that falls from its start to 0 over the budget."""

    start: float

    def __call__(self, progress_remaining: float) -> float:
        """Return the value with this share of the budget left."""
        return progress_remaining * self.start


def read_zoo(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with the texts of RL Baselines3 Zoo read, without the task's settings."""
    settings = {name: value for name, value in stated.items() if name not in LEFT_OUT}
    if ignored := {name: LEFT_OUT[name] for name in stated if name in LEFT_OUT}:
        whose = ", ".join(f"{name} ({owner} sets it)" for name, owner in ignored.items())
        warnings.warn(f"a deep learner leaves out {whose}", stacklevel=4)
    for name, value in settings.items():
        if isinstance(value, str) and name in ("learning_rate", "clip_range", "clip_range_vf"):
            kind, _, start = value.rpartition("_")
            try:
                settings[name] = {"lin": Linear, "": float}[kind](float(start))
            except (KeyError, ValueError):
                raise SettingError(
                    f"{name} as text must be a number or lin_NUMBER: got {value!r}"
                ) from None
        elif isinstance(value, str) and (name.endswith("_kwargs") or name == "normalize"):
            try:
                settings[name] = _literal(ast.parse(value.strip(), mode="eval").body)
            except (ImportError, SyntaxError, TypeError, ValueError, AttributeError) as error:
                raise SettingError(
                    f"{name} as text must be dict(...) of plain values and classes of nn, such as "
                    f"nn.ReLU: got {value!r}"
                ) from error
    noise = settings.get("noise_type", "normal")
    one_of("noise_type of a deep learner", noise, NOISE, SettingError)
    if "noise_type" in settings and "noise_std" not in settings:
        raise SettingError("noise_type of a deep learner needs noise_std: got none")
    normalize = settings.get("normalize")
    fits = isinstance(normalize, Mapping) and {*normalize} <= NORMAL
    if not (fits or normalize is None or isinstance(normalize, bool)):
        raise SettingError(
            "normalize of a deep learner must be true, false or a dict of "
            f"{', '.join(sorted(NORMAL))}: got {normalize!r}"
        )
    return settings


def _literal(node: ast.expr) -> Any:
    """Return what an expression means, dict(...) and nn.X included; nothing is evaluated."""
    match node:
        case ast.Call(func=ast.Name(id="dict"), args=[], keywords=pairs):
            return {pair.arg: _literal(pair.value) for pair in pairs}
        case ast.Dict(keys=keys, values=values):
            return {ast.literal_eval(k): _literal(v) for k, v in zip(keys, values, strict=True)}  # type: ignore[arg-type]
        case ast.List(elts=parts):
            return [*map(_literal, parts)]
        case ast.Attribute(value=ast.Name(id="nn"), attr=name):
            return getattr(import_module("torch.nn"), name)
    return ast.literal_eval(node)


def _text(value: object) -> str:
    """Return a setting as text that is the same in every process."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {_text(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, partial):
        arguments = [*map(_text, value.args)]
        arguments += [f"{name}={_text(x)}" for name, x in value.keywords.items()]
        return f"{_text(value.func)}({', '.join(arguments)})"
    if isinstance(value, type | BuiltinFunctionType):
        return value.__qualname__
    return plain_text(value)


# -- which spaces a policy takes, told before anything runs ------------------------------------


def check_spaces(task: ObservationTask, learner: DeepLearner) -> None:
    """Raise SettingError unless a learner's policy takes a task's observations and actions."""
    if learner.settings.get("gamma", task.discount) != task.discount:
        raise SettingError(
            f"gamma of a deep learner must be its task's discount: got {learner.settings['gamma']} "
            f"and {task.discount}; discount= of the task sets both"
        )
    space, policy = task.observations, learner.policy
    if not isinstance(task.actions, LEAVES):
        raise SettingError(
            "actions of a deep learner must be a Box, Discrete, MultiDiscrete or MultiBinary: got "
            f"{stable_text(task.actions)}"
        )
    taken = OF_ACTIONS.get(learner.algorithm, object)
    if not isinstance(task.actions, taken):
        raise SettingError(
            f"actions of {learner.algorithm} must be a {taken.__name__}: got "
            f"{stable_text(task.actions)}; PPO takes actions of every kind"
        )
    parts = space.spaces if isinstance(space, Dict) else {"": space}
    for key, part in parts.items():
        if not isinstance(part, LEAVES):
            raise SettingError(
                "observations of a deep learner must be a Box, Discrete, MultiDiscrete or "
                f"MultiBinary, or a Dict of these: {_shown(key, part)}; {_encoder(parts)}"
            )
    observed = [("Observation", part) for part in parts.values()]
    for kind, part in [("Action", task.actions), *observed]:
        if np.any(getattr(part, "start", 0)):
            raise SettingError(
                f"{kind.lower()}s of a deep learner must count from 0: got {stable_text(part)}; a "
                f"wrapper such as gymnasium.wrappers.Transform{kind} makes them, as encode="
            )
    if isinstance(space, Dict) and policy.startswith(("Mlp", "Cnn")):
        raise SettingError(
            f"{policy} reads one array: got {stable_text(space)}; MultiInputPolicy reads a "
            f"Dict, and {_encoder(parts)}"
        )
    if not isinstance(space, Dict) and policy.startswith("MultiInput"):
        raise SettingError(f"{policy} reads a Dict: got {stable_text(space)}; MlpPolicy reads that")
    _check_pictures(parts, learner)


def is_picture(space: Any) -> bool:
    """Return whether Stable-Baselines3 takes what a space holds for pictures, by itself."""
    of_bytes = isinstance(space, Box) and len(space.shape) == 3 and space.dtype == np.uint8
    return of_bytes and bool((space.low == 0).all() and (space.high == 255).all())


def _check_pictures(parts: Mapping[str, Any], learner: DeepLearner) -> None:
    """Raise SettingError where the convolutions of Stable-Baselines3 cannot read a picture."""
    kwargs, policy = learner.settings.get("policy_kwargs") or {}, learner.policy
    whole = policy.startswith("Cnn")
    if "features_extractor_class" in kwargs or ("" in parts and not whole):
        return
    for key, part in parts.items():
        picture = is_picture(part)
        if whole and not (isinstance(part, Box) and len(part.shape) == 3):
            raise SettingError(
                f"{policy} reads a picture, a Box of three dimensions: got {stable_text(part)}; "
                "MlpPolicy reads that"
            )
        if whole and not (picture or kwargs.get("normalize_images") is False):
            raise SettingError(
                f"{policy} reads a picture of bytes from 0 to 255, unless policy_kwargs has "
                "normalize_images=False, or a features_extractor_class such as SmallCNN: got "
                f"{stable_text(part)}"
            )
        # The least of the three sides are the channels.
        if (whole or picture) and sorted(part.shape or ())[1] < LEAST_SIDE:
            raise SettingError(
                f"{policy} reads pictures by NatureCNN, which needs {LEAST_SIDE} cells a side: "
                f"{_shown(key, part)}; {SMALLER if whole else _encoder(parts)}"
            )


def _shown(key: str, part: Space[Any]) -> str:
    return f"{f'the part {key!r} is' if key else 'got'} {stable_text(part)}"


def _encoder(parts: Mapping[str, Space[Any]]) -> str:
    """Return a sentence that names the encoder for such observations."""
    if any(type(part).__module__.startswith("minigrid.") for part in parts.values()):
        return "encode=MiniGridView() makes MiniGrid's observations a vector"
    if len(parts) > 1:
        return "encode=gymnasium.wrappers.FlattenObservation makes a vector of a Dict of numbers"
    return "a wrapper such as gymnasium.wrappers.TransformObservation makes others, as encode="


# -- ways of transfer for networks alone -----------------------------------------------------------


@dataclass(frozen=True)
class _OfNetworks(Shaping):
    """A source whose values are not read."""

    potential: Any = field(default=None, repr=False)
    kl: float = 0.0

    for_tables: ClassVar[bool] = False
    for_networks: ClassVar[bool] = True
    reads_values: ClassVar[bool] = False

    def __post_init__(self) -> None:
        number(f"kl of a {self.name}", self.kl, SettingError, low=0)


@dataclass(frozen=True)
class WeightTransfer(_OfNetworks):
    """The target's network starts with the parameters of its only source's network.

    Parameters
    ----------
    potential : ObservationPotential or NetworkValues, optional
        Filled in by a :class:`Curriculum`.
    kl : float
        As in :class:`PolicyReuse`.

    Examples
    --------
    >>> WeightTransfer(kl=0.1).for_tables
    False
    """


@dataclass(frozen=True)
class PolicyReuse(_OfNetworks):
    """The learner takes over the sources' policy, but not their values.

    An off-policy learner acts greedily on the sources' action values with a probability that falls
    from 1 to 0 over the first half of the budget (Fernandez, Veloso 2006). An on-policy learner
    starts with the source's actor, and `kl` may keep it near that at first.

    Parameters
    ----------
    potential : ObservationPotential or other ValueSource, optional
        Filled in by a :class:`Curriculum`.
    kl : float
        Weight of KL(source's policy || learner's) in the loss of an actor-critic, which falls to 0
        over the first half of the budget (kickstarting, Schmitt et al. 2018).

    Examples
    --------
    >>> PolicyReuse().reads_values
    False
    """


def residual_policy(algorithm: type, policy: str = "MlpPolicy") -> type:
    """Return the policy class with which a network computes phi + a residual.

    A DQN acts, bootstraps and is evaluated on phi(s, a) + residual(s, a), in the online and the
    target network alike. The residual starts at 0; phi is saved with the model. ``policy_kwargs``:

    - ``potential``, an :class:`ObservationPotential`;
    - ``reads``, the part of phi that the residual reads besides the observation, standardised by
      the first batch: "actions", phi(s, .), the default for fewer than 32 actions; "state", Phi(s)
      = max_a phi(s, a), the default for more; or "nothing", with which a linear residual learns
      what Q-learning from phi learns (Wiewiora 2003), but a network may diverge where phi jumps.

    Parameters
    ----------
    algorithm : type
        DQN, or a class derived from it; others are refused with SettingError.
    policy : {"MlpPolicy", "CnnPolicy", "MultiInputPolicy"}

    Examples
    --------
    >>> from stable_baselines3 import DQN
    >>> from curricle import observation_task
    >>> from curricle.transfer import FunctionValues, ObservationPotential
    >>> car = observation_task("MountainCar-v0", discount=0.98)
    >>> push_along = FunctionValues(
    ...     lambda cars, actions: np.sign(cars[:, 1:]) * (actions - 1.0), actions=3)
    >>> phi = {"potential": ObservationPotential.of(car, push_along)}
    >>> model = DQN(residual_policy(DQN), "MountainCar-v0", gamma=0.98, policy_kwargs=phi)
    >>> model.predict(np.array([-0.5, 0.01], dtype=np.float32), deterministic=True)[0]
    array(2)
    """
    from curricle.deep.ways_in import POLICIES  # needs Stable-Baselines3

    if any(kind.__name__ == "DQN" for kind in algorithm.__mro__) and policy in POLICIES:
        return POLICIES[policy]
    raise SettingError(
        f"initialising a network needs DQN and one of {', '.join(POLICIES)}: got "
        f"{algorithm.__name__} with {policy}; StateShaping suits every algorithm, WeightTransfer "
        "every source whose network is equal"
    )
