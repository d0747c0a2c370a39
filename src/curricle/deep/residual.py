"""Networks that compute phi(s, a) + residual(s, a): Q-initialisation for deep Q-learning.

Wiewiora 2003: look-ahead advice learns what Q-learning from phi learns. A network cannot be started
at phi, but the sum of phi and a network that starts at 0 can be learnt; acting, bootstrapping and
evaluation all read the sum, so nothing else of the algorithm changes.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3.dqn import policies as dqn
from stable_baselines3.dqn.policies import QNetwork

from curricle.checks import one_of
from curricle.deep.networks import plain_layers
from curricle.errors import SettingError
from curricle.transfer.observation_mapping import no_actions
from curricle.transfer.potential import ObservationPotential

READS = "actions", "state", "nothing"
"""What a residual reads beside the observation: phi(s, .), Phi(s) = max_a phi(s, a), or nothing."""
MANY_ACTIONS = 32
"""From so many actions on it reads Phi(s) by default: a wider network costs more."""
MAX_BYTES = 2**28
"""Of cached values of phi, with their observations."""


class _Residual:
    """Makes a policy of DQN residual; its potential is saved with it."""

    potential: ObservationPotential
    cache: "PotentialCache"
    reads: str

    def __init__(
        self, *args: Any, potential: ObservationPotential, reads: str | None = None, **settings: Any
    ):
        if not potential.of_actions:
            raise no_actions(potential)
        self.potential, self.cache = potential, PotentialCache(potential)
        self.reads = reads or ("actions" if self.cache.n_actions < MANY_ACTIONS else "state")
        one_of("what a residual reads of phi", self.reads, READS, SettingError)
        super().__init__(*args, **settings)

    @property
    def device(self) -> torch.device:
        """The device of a network: SB3 searches all parameters for it, at every action."""
        for network in self._modules.values():  # type: ignore[attr-defined]
            if isinstance(network, ResidualQNetwork):
                return network.running_shift.device
        return super().device  # type: ignore[misc]

    def obs_to_tensor(self, observation: Any) -> tuple[Any, bool]:
        """Return observations as tensors, usual stacks at once, and whether they are several."""
        wanted = self.observation_space.shape  # type: ignore[attr-defined]
        several = isinstance(observation, np.ndarray) and observation.ndim > 0
        if several and observation.shape[1:] == wanted:
            return torch.as_tensor(observation, device=self.device), True
        return super().obs_to_tensor(observation)  # type: ignore[misc, no-any-return]

    def set_training_mode(self, mode: bool) -> None:
        """Switch between learning and acting; SB3 calls this before every action."""
        if mode != self.training:  # type: ignore[attr-defined]
            super().set_training_mode(mode)  # type: ignore[misc]

    def make_q_net(self) -> Any:
        """Return a network that starts at phi."""
        given = self._update_features_extractor(self.net_args, features_extractor=None)  # type: ignore[attr-defined]
        network = ResidualQNetwork(**given, cache=self.cache, reads=self.reads)
        return network.to(self.device)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        own = {"potential": self.potential, "reads": self.reads}
        return {**super()._get_constructor_parameters(), **own}  # type: ignore[misc]


class ResidualMlpPolicy(_Residual, dqn.MlpPolicy):
    """DQN's ``MlpPolicy`` on phi + residual."""


class ResidualCnnPolicy(_Residual, dqn.CnnPolicy):
    """DQN's ``CnnPolicy`` on phi + residual; phi gets pictures as the network does."""


class ResidualMultiInputPolicy(_Residual, dqn.MultiInputPolicy):
    """DQN's ``MultiInputPolicy`` on phi + residual."""


POLICIES: dict[str, type] = {
    "MlpPolicy": ResidualMlpPolicy,
    "CnnPolicy": ResidualCnnPolicy,
    "MultiInputPolicy": ResidualMultiInputPolicy,
}


class ResidualQNetwork(QNetwork):
    """Q(s, a) = phi(s, a) + residual(s, a) for DQN; the residual starts at 0.

    The residual reads a part of phi, `reads`, beside its features: where phi jumps, as tables do
    between cells, a smooth residual of the observation alone cannot follow, and bootstraps from its
    own errors.
    """

    running_shift: torch.Tensor  # so named, they are copied into the target network
    running_scale: torch.Tensor

    def __init__(
        self, *args: Any, cache: "PotentialCache", reads: str, features_dim: int, **settings: Any
    ):
        inputs = features_dim + {"actions": cache.n_actions, "state": 1, "nothing": 0}[reads]
        super().__init__(*args, features_dim=inputs, **settings)
        self.cache, self.reads, self.untrained = cache, reads, True
        self.register_buffer("running_shift", torch.zeros(()))
        self.register_buffer("running_scale", torch.ones(()))
        torch.nn.init.zeros_(self._last.weight)
        torch.nn.init.zeros_(self._last.bias)
        self._plain = plain_layers([*self.q_net], self.features_extractor, self.observation_space)

    @property
    def _last(self) -> Any:
        """The last layer, which is 0 at first."""
        return self.q_net[-1]

    def forward(self, obs: Any) -> torch.Tensor:
        """Return Q(s, a), (n, A)."""
        phi, best = self.cache.of(obs)
        return self.q_net(self._features(obs, phi, best)) + phi

    def _predict(self, observation: Any, deterministic: bool = True) -> torch.Tensor:
        """Return the best action of each observation, (n,), with NumPy where that is quicker."""
        plain = self._plain
        if plain is None or not plain.is_quicker_for(len(observation)):
            return super()._predict(observation, deterministic)
        inputs = observation.numpy()
        phi, best = self.cache.read(inputs)
        if self.reads != "nothing":
            read = phi if self.reads == "actions" else best
            scaled = read * self.running_scale.item() + self.running_shift.item()
            inputs = np.concatenate([inputs, scaled], axis=1, dtype=np.float32)
        return torch.from_numpy((plain.read(inputs) + phi).argmax(axis=1))

    def _features(self, obs: Any, phi: torch.Tensor, best: torch.Tensor) -> torch.Tensor:
        """Return what the residual reads, (n, features); phi is (n, A), best Phi(s), (n, 1)."""
        own: torch.Tensor = self.extract_features(obs, self.features_extractor)
        if self.reads == "nothing":
            return own
        read = phi if self.reads == "actions" else best
        if self.untrained and torch.is_grad_enabled():
            self._standardise(read)
        scaled = torch.addcmul(self.running_shift, read, self.running_scale)
        return torch.cat([own, scaled], dim=1)

    def _standardise(self, read: torch.Tensor) -> None:
        """Set shift and scale by the mean and spread of a batch, until something is learnt."""
        if self._last.weight.any():
            self.untrained = False
            return
        spread = read.std(correction=0)
        self.running_scale.copy_(1 / spread if spread > 0 else torch.ones(()))
        self.running_shift.copy_(-read.mean() * self.running_scale)


class PotentialCache:
    """phi(s, a) of every action, cached, so that replayed observations are not computed anew.

    Both networks of a policy share one. It is emptied when it is too large. Observations that are
    dicts are not cached.
    """

    def __init__(self, potential: ObservationPotential):
        self.potential, self.n_actions = potential, potential.task.n_actions or 0
        self.places: dict[bytes, int] = {}
        self.values = np.empty((0, 1 + self.n_actions), dtype=np.float32)

    def of(self, obs: Any) -> tuple[torch.Tensor, torch.Tensor]:
        """Return phi(s, a), (n, A), and Phi(s) = max_a phi(s, a), (n, 1), of tensors."""
        if isinstance(obs, dict):
            device = next(iter(obs.values())).device
            found = self.read({name: part.cpu().numpy() for name, part in obs.items()})
        else:
            device, found = obs.device, self.read(obs.cpu().numpy())
        phi, best = map(torch.from_numpy, found)
        return phi.to(device), best.to(device)

    def read(self, seen: Any) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return phi(s, a), (n, A), and Phi(s), (n, 1), of arrays."""
        if isinstance(seen, dict):
            found = self._computed(seen)
        else:
            found = self._cached(np.ascontiguousarray(seen))
        return found[:, 1:], found[:, :1]

    def _computed(self, seen: Any) -> npt.NDArray[np.float32]:
        """Return Phi(s) and phi(s, a), (n, 1 + A)."""
        phi = self.potential.pairs(seen)
        return np.concatenate([phi.max(axis=1, keepdims=True), phi], axis=1, dtype=np.float32)

    def _cached(self, seen: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        keys = seen.reshape(len(seen), -1).view(f"V{seen.nbytes // len(seen)}")[:, 0].tolist()
        if not all(map(self.places.__contains__, keys)):
            self._add(keys, seen)
        return self.values[list(map(self.places.__getitem__, keys))]

    def _add(self, keys: list[bytes], seen: npt.NDArray[Any]) -> None:
        """Cache phi of the new ones among some observations."""
        if len(self.places) * (len(keys[0]) + 4 * (1 + self.n_actions)) > MAX_BYTES:
            self.places.clear()
        new = {key: i for i, key in enumerate(keys) if key not in self.places}
        used, needed = len(self.places), len(self.places) + len(new)
        if needed > len(self.values):
            larger = np.empty((max(2 * needed, 1024), 1 + self.n_actions), np.float32)
            larger[:used] = self.values[:used]
            self.values = larger
        self.values[used:needed] = self._computed(seen[list(new.values())])
        self.places |= zip(new, range(used, needed), strict=True)
