"""Networks that compute phi(s, a) + residual(s, a): Q-initialisation for deep Q-learning.

Wiewiora 2003: look-ahead advice learns what Q-learning learns that starts at phi. A network cannot
be started at phi, but the sum of phi and a network that starts at 0 can; acting, bootstrapping and
evaluation all read the sum, so nothing else of the algorithm changes.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3.dqn import policies as dqn
from stable_baselines3.dqn.policies import QNetwork

from curricle.transfer.observed_potential import ObservationPotential
from curricle.transfer.values import no_actions

try:
    from sb3_contrib.qrdqn import policies as qrdqn
    from sb3_contrib.qrdqn.policies import QuantileNetwork
except ModuleNotFoundError:  # sb3-contrib is not installed; asking for QR-DQN says so
    qrdqn, QuantileNetwork = None, object


MOST_BYTES = 2**28
"""That remembered values of phi may take, with the observations they are known by."""


class ResidualQNetwork(QNetwork):
    """Q(s, a) = phi(s, a) + residual(s, a) for DQN; the residual starts at 0."""

    def __init__(self, *args: Any, rows: "Rows", **settings: Any):
        super().__init__(*args, **settings)
        self.rows = rows
        _silence(self.q_net[-1])

    def forward(self, obs: Any) -> torch.Tensor:
        """Return Q(s, a), (n, A)."""
        return super().forward(obs) + self.rows.of(obs, self.device)


class ResidualQuantileNetwork(QuantileNetwork):  # type: ignore[misc, valid-type]
    """The quantiles of the return, each phi(s, a) + residual(s, a), for QR-DQN."""

    def __init__(self, *args: Any, rows: "Rows", **settings: Any):
        super().__init__(*args, **settings)
        self.rows = rows
        _silence(self.quantile_net[-1])

    def forward(self, obs: Any) -> torch.Tensor:
        """Return the quantiles, (n, quantiles, A)."""
        return super().forward(obs) + self.rows.of(obs, self.device)[:, None, :]


class Rows:
    """phi(s, a) of every action, remembered: what is replayed is not computed anew.

    Both networks of a policy share one. It forgets all when it holds too much. Observations that
    are dicts are not remembered.
    """

    def __init__(self, potential: ObservationPotential):
        self.potential = potential
        self.places: dict[bytes, int] = {}
        self.kept = np.empty((0, potential.task.n_actions or 0), dtype=np.float32)

    def of(self, obs: Any, device: Any) -> torch.Tensor:
        """Return phi of observations held as tensors, (n, A)."""
        found: npt.NDArray[Any]
        if isinstance(obs, dict):
            found = self.potential.pairs({name: part.cpu().numpy() for name, part in obs.items()})
        else:
            found = self._remembered(np.ascontiguousarray(obs.cpu().numpy()))
        return torch.as_tensor(found, dtype=torch.float32, device=device)

    def _remembered(self, seen: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        whole, size = seen.tobytes(), seen[0].nbytes
        if len(self.places) * (size + 4 * self.kept.shape[1]) > MOST_BYTES:
            self.places.clear()
        names = [whole[i * size : (i + 1) * size] for i in range(len(seen))]
        new = {name: i for i, name in enumerate(names) if name not in self.places}
        if new:
            self._learn(list(new), self.potential.pairs(seen[list(new.values())]))
        return self.kept[[self.places[name] for name in names]]

    def _learn(self, names: list[bytes], rows: npt.NDArray[np.float64]) -> None:
        used = len(self.places)
        if used + len(names) > len(self.kept):
            room = np.empty((max(2 * used, 1024, len(names)) + used, rows.shape[1]), np.float32)
            room[:used] = self.kept[:used]
            self.kept = room
        self.kept[used : used + len(names)] = rows
        self.places |= zip(names, range(used, used + len(names)), strict=True)


def _silence(last: Any) -> None:
    """Have a layer say 0."""
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)


class _Residual:
    """What makes a policy of DQN or QR-DQN residual; its potential is saved with it."""

    potential: ObservationPotential
    rows: Rows

    def __init__(self, *args: Any, potential: ObservationPotential, **settings: Any):
        if not potential.of_actions:
            raise no_actions(potential)
        self.potential, self.rows = potential, Rows(potential)
        super().__init__(*args, **settings)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "potential": self.potential}  # type: ignore[misc]


class _ResidualDQN(_Residual):
    def make_q_net(self) -> Any:
        """Return a network that starts at phi."""
        given = self._update_features_extractor(self.net_args, features_extractor=None)  # type: ignore[attr-defined]
        return ResidualQNetwork(**given, rows=self.rows).to(self.device)  # type: ignore[attr-defined]


class _ResidualQRDQN(_Residual):
    def make_quantile_net(self) -> Any:
        """Return a network that starts at phi."""
        given = self._update_features_extractor(self.net_args, features_extractor=None)  # type: ignore[attr-defined]
        return ResidualQuantileNetwork(**given, rows=self.rows).to(self.device)  # type: ignore[attr-defined]


class ResidualMlpPolicy(_ResidualDQN, dqn.MlpPolicy):
    """DQN's ``MlpPolicy`` on phi + residual; takes ``potential`` among ``policy_kwargs``."""


class ResidualCnnPolicy(_ResidualDQN, dqn.CnnPolicy):
    """DQN's ``CnnPolicy`` on phi + residual; phi sees pictures as the network does."""


class ResidualMultiInputPolicy(_ResidualDQN, dqn.MultiInputPolicy):
    """DQN's ``MultiInputPolicy`` on phi + residual."""


POLICIES: dict[tuple[str, str], type] = {
    ("DQN", "MlpPolicy"): ResidualMlpPolicy,
    ("DQN", "CnnPolicy"): ResidualCnnPolicy,
    ("DQN", "MultiInputPolicy"): ResidualMultiInputPolicy,
}

if qrdqn is not None:

    class ResidualQuantileMlpPolicy(_ResidualQRDQN, qrdqn.MlpPolicy):  # type: ignore[name-defined, misc]
        """QR-DQN's ``MlpPolicy`` on phi + residual."""

    class ResidualQuantileCnnPolicy(_ResidualQRDQN, qrdqn.CnnPolicy):  # type: ignore[name-defined, misc]
        """QR-DQN's ``CnnPolicy`` on phi + residual."""

    class ResidualQuantileMultiInputPolicy(  # type: ignore[misc]
        _ResidualQRDQN,
        qrdqn.MultiInputPolicy,  # type: ignore[name-defined]
    ):
        """QR-DQN's ``MultiInputPolicy`` on phi + residual."""

    POLICIES |= {
        ("QRDQN", "MlpPolicy"): ResidualQuantileMlpPolicy,
        ("QRDQN", "CnnPolicy"): ResidualQuantileCnnPolicy,
        ("QRDQN", "MultiInputPolicy"): ResidualQuantileMultiInputPolicy,
    }
