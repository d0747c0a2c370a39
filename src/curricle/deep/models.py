"""From a deep learner and a potential to a model of Stable-Baselines3."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import numpy.typing as npt
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from curricle.deep.checkpoint import isolated
from curricle.deep.demonstrations import fill_replay_buffer
from curricle.deep.kickstarting import begin_near, kickstarted
from curricle.deep.learner import DeepLearner
from curricle.deep.networks import WITHOUT_SOURCE, NetworkValues
from curricle.deep.residual import residual_policy
from curricle.deep.shaping import Demonstrations, PolicyReuse, WeightTransfer, reusing
from curricle.deep.vec_env import ShapedVecEnv
from curricle.errors import CurricleError, SettingError
from curricle.learning.shaping import Shaping, StateShaping
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.potentials import ObservationPotential

VALUE_HEAD = ("value_net", "mlp_extractor.value_net", "vf_features_extractor")
"""Prefixes of the critic's parameters in an actor-critic."""


def model_for(
    task: ObservationTask,
    learner: DeepLearner,
    shaping: Shaping | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
    derived: Callable[[type], type] | None = None,
) -> Any:
    """Return a model, ready to learn, with its shaping; a guard is not heeded.

    `seed` is below 2^32; a replay buffer is not made larger than the `steps` it will learn; the
    model's class is what is `derived` from the algorithm. SettingError when the algorithm does not
    take a setting or the shaping.

    Examples
    --------
    >>> from curricle import observation_task
    >>> model = model_for(observation_task("CartPole-v1", discount=0.9), DeepLearner("PPO"))
    >>> type(model).__name__, model.gamma
    ('PPO', 0.9)
    """
    check_learner(learner, shaping)
    algorithm, settings = learner.algorithm_class(), dict(learner.settings)
    policy: Any = learner.policy
    if "buffer_size" in inspect.signature(algorithm).parameters and steps is not None:
        size, added = settings.get("buffer_size", 1_000_000), 0
        if isinstance(shaping, Demonstrations):
            added = shaping.steps
        settings["buffer_size"] = max(min(size, steps + added), learner.envs)
    potential = None if shaping is None else shaping.potential
    if shaping is not None and shaping.starts_at_potential and potential is not None:
        policy = residual_policy(algorithm, learner.policy)
        given = settings.get("policy_kwargs") or {}
        settings["policy_kwargs"] = {**given, "potential": potential}
    guided = _is_guided(shaping, learner)
    if guided:
        algorithm = reusing(algorithm)
    near = potential is not None and _pull(shaping) > 0
    if near:
        algorithm, policy = kickstarted(algorithm, policy)
    if derived is not None:
        algorithm = derived(algorithm)
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
    if potential is not None:
        _begin(model, shaping, potential, guided=guided)
    return model


def _is_guided(shaping: Shaping | None, learner: DeepLearner) -> bool:
    """Return whether an off-policy learner explores by what its sources do."""
    if not isinstance(shaping, PolicyReuse) or shaping.potential is None:
        return False
    values = shaping.potential.values
    acts = len(values) == 1 and getattr(values[0], "kind", "") == "value_net"
    return "buffer_size" in learner.takes and (shaping.potential.of_actions or acts)


def _begin(
    model: Any, shaping: Shaping | None, potential: ObservationPotential, *, guided: bool
) -> None:
    """Give a new model what its sources hand on beside their values."""
    if shaping is not None and not shaping.reads_values:
        _check_mappings(shaping, potential, guided=guided)
    if guided:
        model.guide = potential
    elif isinstance(shaping, PolicyReuse):
        carry_over(model, potential, "actor")
    elif isinstance(shaping, WeightTransfer):
        carry_over(model, potential, shaping.parts)
    elif isinstance(shaping, Demonstrations):
        fill_replay_buffer(model, potential, shaping.steps)
    if _pull(shaping) > 0:
        begin_near(model, _pull(shaping))


def _check_mappings(shaping: Shaping, potential: ObservationPotential, *, guided: bool) -> None:
    """Raise SettingError where a mapping would not be heeded, as no values are read by it."""
    if guided and potential.of_actions:
        return
    # Weights are compared by shape, so that there a mapping may bridge spaces of other bounds.
    weights = not guided and not isinstance(shaping, Demonstrations)
    for edge in potential.edges:
        mapping = edge.mapping
        kept = mapping.actions is None and mapping.status is None
        if not kept or not (weights or mapping.observations is None):
            raise SettingError(
                f"{shaping.name} from this source takes observations and actions as they are: the "
                f"mapping of {edge.source!r} has {mapping.description}"
            )


def _pull(shaping: Shaping | None) -> float:
    """Return the weight of the pull to the source's policy, 0 where there is none."""
    return shaping.kl if isinstance(shaping, PolicyReuse | WeightTransfer) else 0.0


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
    """Raise SettingError unless the algorithm exists, takes these settings and this shaping.

    `in_tables` are the sources that are learnt in tables.
    """
    algorithm = learner.algorithm_class()
    known = inspect.signature(algorithm).parameters
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
    if isinstance(shaping, Demonstrations) and "buffer_size" not in known:
        raise SettingError(
            f"demonstrations need an algorithm with a replay buffer: {learner.algorithm} has none"
        )
    if _pull(shaping) > 0 and not issubclass(algorithm, (PPO, A2C)):
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
    """Return the values of a network that was trained on a task by a learner with a shaping.

    `parameters` are as :meth:`NetworkValues.parameters` returned them.
    """
    known = shaping if shaping is not None and shaping.reads_values else None
    if WITHOUT_SOURCE in parameters:
        known = None
    with isolated(learner.threads):
        model = model_for(task, learner, known, steps=1)
    model.env.close()
    values = NetworkValues(
        model.policy, subtracted(known), without_source=WITHOUT_SOURCE in parameters
    )
    values.load(parameters)
    return values


def carry_over(model: Any, potential: ObservationPotential, parts: str) -> None:
    """Load "all" parameters of the one source, or those of its "actor" or "critic", into a model.

    What actor and critic share goes with the actor.
    """
    (source, *others) = potential.values
    if others or not isinstance(source, NetworkValues):
        raise SettingError(
            "weights are carried over from one source that is a network: got "
            f"{', '.join(type(each).__name__ for each in potential.values)}"
        )
    if hasattr(source.policy, "potential"):
        raise SettingError(
            "weights are carried over from a network that computes all of Q: got a residual on a "
            "potential"
        )
    mine, theirs = model.policy.state_dict(), source.policy.state_dict()
    names = [
        name
        for name in theirs
        if parts == "all" or name.startswith((*VALUE_HEAD, "critic")) == (parts == "critic")
    ]
    if not names:
        raise SettingError(
            f"a critic is carried over from an actor-critic: a {type(source.policy).__name__} has "
            "none apart from its policy"
        )
    for name in names:
        if name not in mine or mine[name].shape != theirs[name].shape:
            here = tuple(mine[name].shape) if name in mine else "missing"
            raise SettingError(
                "weights are carried over between networks of one shape: "
                f"{name} is {tuple(theirs[name].shape)} in the source and {here} in the target"
            )
    model.policy.load_state_dict({**mine, **{name: theirs[name] for name in names}})
