"""From a deep learner and a shaping to a model of Stable-Baselines3, ready to learn."""

import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from curricle.deep.learner import DeepLearner
from curricle.deep.networks import NetworkValues
from curricle.deep.shaping import PolicyReuse, WeightTransfer, residual_policy
from curricle.deep.vec_env import ShapedVecEnv
from curricle.deep.ways_in import begin_near, carry_over, check_mappings, kickstarted, reusing
from curricle.errors import CurricleError, SettingError
from curricle.interop.tabulated_task import needs_of
from curricle.learning.shaping import Shaping, StateShaping
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.potential import ObservationPotential


def model_for(
    task: ObservationTask,
    learner: DeepLearner,
    shaping: Shaping | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
) -> Any:
    """Return a model, ready to learn, with its shaping; `seed` is below 2^32."""
    if shaping is not None and shaping.potential is None:
        shaping = None  # nothing is added
    check_learner(learner, shaping)
    algorithm, settings = learner.algorithm_class(), dict(learner.settings)
    policy: Any = learner.policy
    if "buffer_size" in learner.takes and steps is not None:
        size = settings.get("buffer_size", 1_000_000)
        settings["buffer_size"] = max(min(size, steps), learner.envs)
    if shaping is not None and shaping.starts_at_potential:
        policy = residual_policy(algorithm, learner.policy)
        kwargs = settings.get("policy_kwargs") or {}
        settings["policy_kwargs"] = {**kwargs, "potential": shaping.potential}
    guide = None  # the action values that an off-policy learner acts on at first
    if isinstance(shaping, PolicyReuse) and "buffer_size" in learner.takes:
        guide = shaping.potential if shaping.potential.of_actions else None
    if guide is not None:
        algorithm = reusing(algorithm)
    if _pull_of(shaping) > 0:
        algorithm, policy = kickstarted(algorithm, policy)
    venv = environments(task, learner, shaping)
    try:
        model = algorithm(policy, venv, gamma=task.discount, seed=seed, **settings)
    except CurricleError:
        raise
    except (AssertionError, TypeError, ValueError) as error:
        # Its spaces, the name of its policy and some of its settings are only checked there.
        said = " ".join(str(error).split())
        raise SettingError(
            f"{learner.algorithm} must take its task and its settings: with {task} "
            f"Stable-Baselines3 says {said!r}"
        ) from error
    if needs_of(model) == "masks of actions" and not venv.has_attr("action_masks"):
        raise SettingError(
            f"{learner.algorithm} needs environments with a method action_masks, which "
            f"sb3_contrib.common.wrappers.ActionMasker adds as encode=: {task} has none"
        )
    if guide is not None:
        model.guide = guide
    elif isinstance(shaping, PolicyReuse | WeightTransfer):
        check_mappings(shaping)
        carry_over(model, shaping.potential, actor_alone=isinstance(shaping, PolicyReuse))
        if shaping.kl > 0:
            begin_near(model, shaping.kl)
    return model


def environments(task: ObservationTask, learner: DeepLearner, shaping: Shaping | None) -> VecEnv:
    """Return new sub-environments, with their rewards shaped where the shaping does so."""
    venv = DummyVecEnv([lambda: Monitor(task.environment())] * learner.envs)
    phi = subtracted(shaping)
    return venv if phi is None else ShapedVecEnv(venv, phi)


def subtracted(shaping: Shaping | None) -> ObservationPotential | None:
    """Return Phi where rewards are shaped by it, so that Q is learnt as Q* - Phi; else None."""
    return shaping.potential if isinstance(shaping, StateShaping) else None


def check_learner(
    learner: DeepLearner, shaping: Shaping | None = None, in_tables: Sequence[str] = ()
) -> None:
    """Raise SettingError unless an algorithm takes settings and shaping of sources `in_tables`."""
    algorithm, known = learner.algorithm_class(), learner.takes
    for name in learner.settings:
        if name not in known:
            meant = get_close_matches(name, known, n=1)
            raise SettingError(
                f"a setting of {learner.algorithm} must be one of {', '.join(known)}: got {name!r}"
                + (f", did you mean {meant[0]!r}?" if meant else "")
            )
    if shaping is None:
        return
    if isinstance(shaping, WeightTransfer) and in_tables:
        raise SettingError(
            f"WeightTransfer takes the networks of its sources: {in_tables[0]} is learnt in a table"
        )
    if shaping.starts_at_potential:
        residual_policy(algorithm, learner.policy)
    if _pull_of(shaping) > 0 and not issubclass(algorithm, (PPO, A2C)):
        raise SettingError(
            "a pull by kl needs an actor-critic that learns on-policy, PPO or A2C: got "
            f"{learner.algorithm}"
        )


def network_values(
    task: ObservationTask,
    learner: DeepLearner,
    shaping: Shaping | None,
    parameters: Mapping[str, npt.NDArray[Any]],
) -> NetworkValues:
    """Return the values of a trained network, from :meth:`NetworkValues.parameters`."""
    known = shaping if shaping is not None and shaping.reads_values else None
    with isolated(learner.threads):
        model = model_for(task, learner, known, steps=1)
    model.env.close()
    values = NetworkValues(model.policy, subtracted(known))
    values.load(parameters)
    return values


def _pull_of(shaping: Shaping | None) -> float:
    return shaping.kl if isinstance(shaping, PolicyReuse | WeightTransfer) else 0.0


# -- the random numbers and threads of Stable-Baselines3 -------------------------------------------


def generator_states() -> tuple[Any, ...]:
    """Return the states of the generators that Stable-Baselines3 draws from."""
    state = np.random.get_state()  # noqa: NPY002 - the one it uses
    return random.getstate(), state, torch.get_rng_state()


def set_generators(states: tuple[Any, ...]) -> None:
    """Set the generators that Stable-Baselines3 draws from."""
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    torch.set_rng_state(states[2])


@contextmanager
def drawing(seed: int) -> Iterator[None]:
    """Let torch draw from a seed, and restore the generators afterwards."""
    states = generator_states()
    torch.manual_seed(seed % 2**63)
    try:
        yield
    finally:
        set_generators(states)


@contextmanager
def isolated(threads: int) -> Iterator[None]:
    """Use so many of torch's threads, and restore their number and the generators afterwards."""
    before, states = torch.get_num_threads(), generator_states()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        set_generators(states)
