"""The values of trained networks."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray
from curricle.errors import PotentialError
from curricle.transfer.observation_mapping import no_actions
from curricle.transfer.potentials import ObservationPotential

WITHOUT_SOURCE = "without_source"
"""Marks the parameters of a guarded learner's network that has nothing of the source."""


class NetworkValues:
    """The values of a policy of Stable-Baselines3, in its task's own rewards.

    - DQN: Q(s, a) of its network, phi included where it is a residual; QR-DQN: the mean of the
      quantiles. V(s) = max_a Q(s, a).
    - PPO, A2C and other actor-critics: V(s) of the value head; there is no Q(s, a).
    - SAC, TD3, DDPG: Q(s, a) is the least of the critics', V(s) that of the actor's action.

    Parameters
    ----------
    policy : stable_baselines3.common.policies.BasePolicy
        ``model.policy`` of a model.
    values_offset : ObservationPotential, optional
        The Phi that shaped its rewards. Then Q - Phi is learnt, and Phi is added here.
    without_source : bool
        Whether it is the one of two guarded networks that learnt without the source.

    Attributes
    ----------
    policy, values_offset
    plain : PlainNetwork or None
        The same network for NumPy, if it is one of plain layers.

    Raises
    ------
    PotentialError
        When the policy has no values.

    Examples
    --------
    >>> from stable_baselines3 import DQN
    >>> values = NetworkValues(DQN("MlpPolicy", "MountainCar-v0").policy)
    >>> cars = np.zeros((5, 2), dtype=np.float32)
    >>> values.q(cars, np.zeros(5, dtype=int)).shape, values.v(cars).shape, values.of_actions
    ((5,), (5,), True)
    """

    def __init__(
        self,
        policy: Any,
        values_offset: ObservationPotential | None = None,
        *,
        without_source: bool = False,
    ):
        self.policy, self.values_offset = policy, values_offset
        self.without_source = without_source
        kinds = ("q_net", "quantile_net", "value_net", "critic")
        found = [kind for kind in kinds if getattr(policy, kind, None) is not None]
        if not found:
            raise PotentialError(
                f"a source's policy must have one of {', '.join(kinds)}: got "
                f"{type(policy).__name__}"
            )
        from curricle.deep.plain_networks import plain_network

        self.kind = found[0]
        self.plain = plain_network(policy, self.kind)

    @property
    def of_actions(self) -> bool:
        """Whether there is a Q(s, a) for each of numbered actions."""
        return self.kind in ("q_net", "quantile_net")

    def q(self, observations: Any, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a), of the shape of `actions`; of SAC's kind for one action each."""
        if self.kind == "value_net":
            raise no_actions(self)
        if self.of_actions:
            pairs, chosen = self._outputs(observations), np.asarray(actions)
            rows = np.arange(len(pairs))
            found = pairs[rows[:, None] if chosen.ndim == 2 else rows, chosen]
        else:
            import torch

            scaled = self.policy.scale_action(np.asarray(actions, dtype=np.float32))
            with torch.no_grad():
                taken = torch.as_tensor(scaled, device=self.policy.device)
                found = self._critics(self._seen(observations), taken)
        return self._with_offset(found, observations)

    def v(self, observations: Any) -> FloatArray:
        """Return V(s), (n,) float64."""
        if self.kind != "critic":
            found = self._outputs(observations).max(axis=1)
        else:
            import torch

            with torch.no_grad():
                seen = self._seen(observations)
                found = self._critics(seen, self.policy._predict(seen, deterministic=True))
        return self._with_offset(found, observations)

    def act(self, observations: Any, *, sampled: bool = False) -> npt.NDArray[Any]:
        """Return the action taken in each of n observations, without exploring.

        If `sampled`, an actor-critic's actions are drawn from its policy by torch's generator.
        """
        actions, _ = self.policy.predict(observations, deterministic=not sampled)
        return np.asarray(actions)

    def parameters(self) -> dict[str, npt.NDArray[Any]]:
        """Return the policy's parameters by name, as plain arrays."""
        state = self.policy.state_dict()
        found = {name: value.detach().cpu().numpy().copy() for name, value in state.items()}
        return found | ({WITHOUT_SOURCE: np.array(True)} if self.without_source else {})

    def load(self, parameters: Mapping[str, npt.NDArray[Any]]) -> None:
        """Take over parameters, as :meth:`parameters` returned them."""
        import torch

        named = {name: each for name, each in parameters.items() if name != WITHOUT_SOURCE}
        tensors = {name: torch.as_tensor(value) for name, value in named.items()}
        self.policy.load_state_dict(tensors)

    def _seen(self, observations: Any) -> Any:
        """Return observations as tensors."""
        if self.policy.training:
            self.policy.set_training_mode(False)
        return self.policy.obs_to_tensor(observations)[0]

    def _outputs(self, observations: Any) -> FloatArray:
        """Return Q of every action, (n, A), or of an actor-critic V, (n, 1)."""
        if self.plain is not None and self.plain.takes(observations):
            found = self.plain.read(observations).astype(np.float64)
        else:
            found = self._by_torch(observations)
        if self.kind == "quantile_net":
            found = found.reshape(len(found), -1, int(self.policy.action_space.n)).mean(axis=1)
        return found

    def _by_torch(self, observations: Any) -> FloatArray:
        """Return the network's output, computed by PyTorch, (n, ...)."""
        import torch

        heads = self.kind == "value_net"
        network = self.policy.predict_values if heads else getattr(self.policy, self.kind)
        with torch.no_grad():
            return _array(network(self._seen(observations)))

    def _critics(self, seen: Any, actions: Any) -> FloatArray:
        each = np.stack([_array(values)[:, 0] for values in self.policy.critic(seen, actions)])
        return np.asarray(each.min(axis=0))

    def _with_offset(self, found: FloatArray, observations: Any) -> FloatArray:
        if self.values_offset is None:
            return found
        phi = self.values_offset.v(observations)
        return found + (phi[:, None] if found.ndim == 2 else phi)


def _array(tensor: Any) -> FloatArray:
    return np.asarray(tensor.cpu().numpy(), dtype=np.float64)
