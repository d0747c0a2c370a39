"""Critics that compute Phi(s) + residual(s): what shaping by Phi is for an actor-critic.

With V = Phi + r the temporal difference R + gamma V(s') - V(s) is that of the critic r with the
reward R + gamma Phi(s') - Phi(s). Advantages, and what r is fitted to, are then the same as with
shaped rewards (Wiewiora 2003, for actor-critics), while rewards and V stay the task's own.
"""

from functools import cached_property
from typing import Any

import torch
from stable_baselines3.common.policies import (
    ActorCriticCnnPolicy,
    ActorCriticPolicy,
    MultiInputActorCriticPolicy,
)

from curricle.deep.networks import NetworkValues
from curricle.transfer.potentials import ObservationPotential


class _OnPhi:
    """Makes the critic of a policy one of Phi(s) + residual(s); the residual starts at 0."""

    def __init__(self, *args: Any, potential: ObservationPotential, **settings: Any):
        self.potential = potential
        super().__init__(*args, **settings)
        torch.nn.init.zeros_(self.value_net.weight)  # type: ignore[attr-defined]
        torch.nn.init.zeros_(self.value_net.bias)  # type: ignore[attr-defined]

    def forward(
        self, obs: Any, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return actions, V(s), (n, 1), and the actions' log probabilities."""
        actions, values, log_prob = super().forward(obs, deterministic)  # type: ignore[misc]
        return actions, values + self._phi(obs), log_prob

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return V(s), (n, 1), the actions' log probabilities, and the entropy."""
        values, log_prob, entropy = super().evaluate_actions(obs, actions)  # type: ignore[misc]
        return values + self._phi(obs), log_prob, entropy

    def predict_values(self, obs: Any) -> torch.Tensor:
        """Return V(s), (n, 1)."""
        found: torch.Tensor = super().predict_values(obs) + self._phi(obs)  # type: ignore[misc]
        return found

    def _phi(self, obs: Any) -> torch.Tensor:
        if isinstance(obs, dict):
            seen: Any = {name: part.cpu().numpy() for name, part in obs.items()}
        else:
            seen = obs.cpu().numpy()
        source = self._source
        if source is None:
            phi = torch.as_tensor(self.potential.v(seen)[:, None], dtype=torch.float32)
        elif source.plain is not None and source.plain.takes(seen):
            phi = torch.from_numpy(source.plain.read(seen))
        else:
            with torch.no_grad():
                phi = source.policy.predict_values(obs)
        return phi.to(self.value_net.weight.device)  # type: ignore[attr-defined]

    @cached_property
    def _source(self) -> NetworkValues | None:
        """The network whose V is Phi, if it is that of one network as it is: quicker to read."""
        (edge, *others), phi = self.potential.edges, self.potential
        source = phi.values[0]
        if others or not isinstance(source, NetworkValues):
            return None
        unscaled = (edge.scale, edge.shift, phi.scale, phi.shift) == (1.0, 0.0, 1.0, 0.0)
        mapped = edge.mapping.observations is not None or edge.mapping.status is not None
        own = source.kind == "value_net" and source.values_offset is None
        return source if unscaled and own and not mapped else None

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "potential": self.potential}  # type: ignore[misc]


class ResidualActorCriticPolicy(_OnPhi, ActorCriticPolicy):
    """The ``MlpPolicy`` of PPO and A2C with V = Phi + residual."""


class ResidualActorCriticCnnPolicy(_OnPhi, ActorCriticCnnPolicy):
    """The ``CnnPolicy`` of PPO and A2C with V = Phi + residual."""


class ResidualActorCriticMultiInputPolicy(_OnPhi, MultiInputActorCriticPolicy):
    """The ``MultiInputPolicy`` of PPO and A2C with V = Phi + residual."""


POLICIES: dict[tuple[str, str], type] = {
    (algorithm, name): policy
    for algorithm in ("PPO", "A2C")
    for name, policy in (
        ("MlpPolicy", ResidualActorCriticPolicy),
        ("CnnPolicy", ResidualActorCriticCnnPolicy),
        ("MultiInputPolicy", ResidualActorCriticMultiInputPolicy),
    )
}
