"""From a deep learner and a potential to a model of Stable-Baselines3.

:func:`model_for` returns the model. What a source hands on beside its values comes after it: a
policy that is acted on at first, parameters, and a pull to the source's policy.
"""

import inspect
from collections.abc import Mapping, Sequence
from copy import deepcopy
from difflib import get_close_matches
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.distributions import kl_divergence
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from curricle.deep.checkpoint import isolated
from curricle.deep.learner import DeepLearner
from curricle.deep.networks import NetworkValues
from curricle.deep.shaping import PolicyReuse, WeightTransfer, residual_policy
from curricle.deep.vec_env import ShapedVecEnv
from curricle.errors import CurricleError, SettingError
from curricle.interop.tabulation.tabulated_task import needs_of
from curricle.learning.shaping import Shaping, StateShaping
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.potential import ObservationPotential

VALUE_HEAD = ("value_net", "mlp_extractor.value_net", "vf_features_extractor")
"""Prefixes of the critic's parameters in an actor-critic."""
REUSED = 0.5
"""Part of the budget in which the sources' policy is acted on, or pulls, less and less."""


def model_for(
    task: ObservationTask,
    learner: DeepLearner,
    shaping: Shaping | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
) -> Any:
    """Return a model, ready to learn, with its shaping.

    `seed` is below 2^32; a replay buffer is not made larger than the `steps` it will learn.
    SettingError when the algorithm does not take a setting or the shaping.
    """
    if shaping is not None and shaping.potential is None:
        shaping = None  # nothing is added
    check_learner(learner, shaping)
    algorithm, settings = learner.algorithm_class(), dict(learner.settings)
    policy: Any = learner.policy
    if "buffer_size" in inspect.signature(algorithm).parameters and steps is not None:
        size = settings.get("buffer_size", 1_000_000)
        settings["buffer_size"] = max(min(size, steps), learner.envs)
    if shaping is not None and shaping.starts_at_potential:
        policy = residual_policy(algorithm, learner.policy)
        kwargs = settings.get("policy_kwargs") or {}
        settings["policy_kwargs"] = {**kwargs, "potential": shaping.potential}
    guide = _guide(shaping, learner)
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
        _check_mappings(shaping)
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
    """Return the values of a network that was trained on a task by a learner with a shaping.

    `parameters` are as :meth:`NetworkValues.parameters` returned them.
    """
    known = shaping if shaping is not None and shaping.reads_values else None
    with isolated(learner.threads):
        model = model_for(task, learner, known, steps=1)
    model.env.close()
    values = NetworkValues(model.policy, subtracted(known))
    values.load(parameters)
    return values


# -- what a source hands on beside its values --------------------------------------------------


def _check_mappings(shaping: Shaping) -> None:
    """Raise SettingError where a mapping would not be heeded, as no values are read by it."""
    for edge in shaping.potential.edges:
        mapping = edge.mapping
        # Weights are compared by shape, so that a mapping may bridge spaces of other bounds.
        if mapping.actions is not None or mapping.status is not None:
            raise SettingError(
                f"{shaping.name} from this source takes observations and actions as they are: the "
                f"mapping of {edge.source!r} has {mapping.description}"
            )


def carry_over(model: Any, potential: ObservationPotential, *, actor_alone: bool) -> None:
    """Load the parameters of the one source into a model: all of them, or those of its actor.

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
    left = (*VALUE_HEAD, "critic") if actor_alone else ()
    names = [name for name in theirs if not name.startswith(left)]
    for name in names:
        if name not in mine or mine[name].shape != theirs[name].shape:
            here = tuple(mine[name].shape) if name in mine else "missing"
            raise SettingError(
                "weights are carried over between networks of one shape: "
                f"{name} is {tuple(theirs[name].shape)} in the source and {here} in the target"
            )
    model.policy.load_state_dict({**mine, **{name: theirs[name] for name in names}})


def pull(progress_remaining: float) -> float:
    """Return what is left of a source's pull: 1 at the start, 0 from the half of the budget on."""
    return max(0.0, 1.0 - (1.0 - progress_remaining) / REUSED)


# -- acting on a source's values at first (Fernandez, Veloso 2006) -----------------------------


def _guide(shaping: Shaping | None, learner: DeepLearner) -> ObservationPotential | None:
    """Return the action values that an off-policy learner acts on at first; None without them."""
    if not isinstance(shaping, PolicyReuse) or "buffer_size" not in learner.takes:
        return None
    potential: ObservationPotential = shaping.potential
    return potential if potential.of_actions else None


class _Reuse:
    """Acts on phi with a probability that falls from 1 to 0; learning is unchanged."""

    guide: ObservationPotential

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> Any:
        left = pull(self._current_progress_remaining)  # type: ignore[attr-defined]
        if np.random.rand() < left:  # noqa: NPY002 - as Stable-Baselines3 draws
            actions = self.guide.pairs(self._last_obs).argmax(axis=1)  # type: ignore[attr-defined]
            return actions, actions
        return super()._sample_action(learning_starts, action_noise, n_envs)  # type: ignore[misc]


def reusing(algorithm: type) -> type:
    """Return an off-policy algorithm that explores by its attribute ``guide``, a potential."""
    return type(f"Reusing{algorithm.__name__}", (_Reuse, algorithm), {})


# -- an actor-critic that is kept near a source's policy at first (Schmitt et al. 2018) --------


def _pull_of(shaping: Shaping | None) -> float:
    """Return the weight of the pull to the source's policy, 0 where there is none."""
    return shaping.kl if isinstance(shaping, PolicyReuse | WeightTransfer) else 0.0


class _WithLoss(torch.autograd.Function):
    """x as it is; whatever loss is computed from it, a further loss is added to that."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, loss: torch.Tensor) -> torch.Tensor:
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, *gradient: torch.Tensor) -> Any:
        return *gradient, gradient[0].new_ones(())


class _NearSource:
    """Makes an actor-critic policy add w KL(source || pi) to the loss that is computed from it.

    PPO and A2C compute their losses within one method, which has no place for a further term: it
    comes in where they differentiate, through the log probabilities that every loss reads.
    """

    source: Any  # the frozen policy to be near to
    kl_weight: float

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        values, log_prob, entropy = super().evaluate_actions(obs, actions)  # type: ignore[misc]
        if self.kl_weight > 0:
            loss = self.kl_weight * self._distance(obs).mean()
            log_prob = _WithLoss.apply(log_prob, loss)
        return values, log_prob, entropy

    def _distance(self, obs: Any) -> torch.Tensor:
        """Return KL(source's policy || this one) in the observations just evaluated, (n,)."""
        with torch.no_grad():
            wanted = self.source.get_distribution(obs)
        each = kl_divergence(wanted, self.action_dist)  # type: ignore[attr-defined]
        return each if each.dim() == 1 else each.sum(dim=1)


class _Kickstarted:
    """Makes an on-policy algorithm lower the weight of the KL before each of its updates."""

    kl: float

    def train(self) -> None:
        self.policy.kl_weight = self.kl * pull(self._current_progress_remaining)  # type: ignore[attr-defined]
        super().train()  # type: ignore[misc]
        self.logger.record("train/kl_weight", self.policy.kl_weight)  # type: ignore[attr-defined]


def kickstarted(algorithm: type, policy: Any) -> tuple[type, type]:
    """Return the algorithm and the policy class of a learner that is kept near a source."""
    plain = algorithm.policy_aliases[policy] if isinstance(policy, str) else policy  # type: ignore[attr-defined]
    near = type(f"Near{plain.__name__}", (_NearSource, plain), {})
    return type(f"Kickstarted{algorithm.__name__}", (_Kickstarted, algorithm), {}), near


def begin_near(model: Any, kl: float) -> None:
    """Let a model, whose actor is that of its source now, stay near it with a weight."""
    policy = model.policy
    source = deepcopy(policy)
    source.set_training_mode(False)
    for parameter in source.parameters():
        parameter.requires_grad_(requires_grad=False)
    # Not as a part of the policy: it is neither learnt nor saved with it.
    object.__setattr__(policy, "source", source)
    policy.kl_weight = model.kl = kl
