"""Kickstarting: an actor-critic is kept near a source's policy at first (Schmitt et al. 2018)."""

from copy import deepcopy
from typing import Any

import torch
from stable_baselines3.common.distributions import kl_divergence

from curricle.deep.shaping import pull


class _NearSource:
    """Makes an actor-critic policy report c H(pi) - w KL(source || pi) as its entropy.

    PPO and A2C subtract ent_coef times the mean of what is reported from the loss. With ent_coef 1
    the loss gets -c H + w KL.
    """

    source: Any  # the frozen policy to be near to
    entropy_weight: float
    kl_weight: float

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        values, log_prob, entropy = super().evaluate_actions(obs, actions)  # type: ignore[misc]
        entropy = -log_prob if entropy is None else entropy
        reported = self.entropy_weight * entropy
        if self.kl_weight > 0:
            reported = reported - self.kl_weight * self._distance(obs)
        return values, log_prob, reported

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
    policy.entropy_weight, policy.kl_weight = float(model.ent_coef), kl
    model.ent_coef, model.kl = 1.0, kl
