"""How potentials and policies of sources enter networks of Stable-Baselines3.

Q-initialisation, or look-ahead advice, which learns the same (Wiewiora 2003): a network cannot
start at phi, but the sum of phi and a network that starts at 0 can be learnt.
"""

from copy import deepcopy
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Dict, Space
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.distributions import kl_divergence
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.dqn import policies as dqn
from stable_baselines3.dqn.policies import QNetwork

from curricle.checks import one_of
from curricle.deep.networks import NetworkValues, Standardized, plain_layers
from curricle.errors import SettingError
from curricle.learning.shaping import Shaping
from curricle.tasks.observation_task import Observations, shapes_of
from curricle.transfer.mapping import no_actions
from curricle.transfer.potential import ObservationPotential

Tensors: TypeAlias = torch.Tensor | dict[str, torch.Tensor]  # n observations of a policy
# Prefixes of the critic's parameters in an actor-critic.
VALUE_HEAD = ("value_net", "mlp_extractor.value_net", "vf_features_extractor")
REUSED = 0.5  # part of the budget in which the sources' policy is acted on, or pulls, less and less
READS = "actions", "state", "nothing"  # phi(s, .), Phi(s), or nothing beside the observation
MANY_ACTIONS = 32  # from so many actions on it reads Phi(s) by default: a wider network costs more
MAX_BYTES = 2**28  # of cached values of phi, with their observations


class _Residual:
    """Makes a policy of DQN residual; its potential is saved with it."""

    potential: ObservationPotential
    cache: "PotentialCache"
    reads: str

    def __init__(
        self,
        *args: object,
        potential: ObservationPotential,
        reads: str | None = None,
        **settings: object,
    ):
        if not potential.of_actions:
            raise no_actions(potential)
        self.potential, self.cache = potential, PotentialCache(potential)
        self.reads = reads or ("actions" if self.cache.n_actions < MANY_ACTIONS else "state")
        one_of("what a residual reads of phi", self.reads, READS, SettingError)
        super().__init__(*args, **settings)
        task, space = potential.task, self.observation_space  # type: ignore[attr-defined]
        n_actions = int(self.action_space.n)  # type: ignore[attr-defined]
        # Stable-Baselines3 moves pictures' channels.
        sides = [shapes_of(observed, sorted) for observed in (space, task.observations)]
        if sides[0] != sides[1] or n_actions != task.n_actions:
            raise SettingError(
                f"a potential must be made for the task it enters: it belongs to {task}, and the "
                f"policy has observations of {space} and {n_actions} actions"
            )

    @property
    def device(self) -> torch.device:
        """The device of a network: SB3 searches all parameters for it, at every action."""
        for network in self._modules.values():  # type: ignore[attr-defined]
            if isinstance(network, ResidualQNetwork):
                return network.running_shift.device
        return super().device  # type: ignore[misc]

    def obs_to_tensor(self, observation: Observations) -> tuple[Tensors, bool]:
        """Return observations as tensors, usual stacks at once, and whether they are several."""
        wanted = self.observation_space.shape  # type: ignore[attr-defined]
        several = isinstance(observation, np.ndarray) and observation.ndim > 0
        if several and observation.shape[1:] == wanted:  # type: ignore[union-attr]
            return torch.as_tensor(observation, device=self.device), True
        return super().obs_to_tensor(observation)  # type: ignore[misc, no-any-return]

    def set_training_mode(self, mode: bool) -> None:
        """Switch between learning and acting; SB3 calls this before every action."""
        if mode != self.training:  # type: ignore[attr-defined]
            super().set_training_mode(mode)  # type: ignore[misc]

    def make_q_net(self) -> "ResidualQNetwork":
        settings = self._update_features_extractor(self.net_args, features_extractor=None)  # type: ignore[attr-defined]
        network = ResidualQNetwork(**settings, cache=self.cache, reads=self.reads)
        return network.to(self.device)  # type: ignore[no-any-return]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        arguments = super()._get_constructor_parameters()  # type: ignore[misc]
        return {**arguments, "potential": self.potential, "reads": self.reads}


class ResidualMlpPolicy(_Residual, dqn.MlpPolicy):
    """DQN's ``MlpPolicy`` on phi + residual."""


class ResidualCnnPolicy(_Residual, dqn.CnnPolicy):
    """DQN's ``CnnPolicy`` on phi + residual."""


class ResidualMultiInputPolicy(_Residual, dqn.MultiInputPolicy):
    """DQN's ``MultiInputPolicy`` on phi + residual."""


RESIDUAL: tuple[type, ...] = ResidualMlpPolicy, ResidualCnnPolicy, ResidualMultiInputPolicy
POLICIES = {policy.__name__.removeprefix("Residual"): policy for policy in RESIDUAL}


class ResidualQNetwork(QNetwork):
    """Q(s, a) = phi(s, a) + residual(s, a) for DQN; the residual starts at 0."""

    running_shift: torch.Tensor  # so named, they are copied into the target network
    running_scale: torch.Tensor

    def __init__(
        self,
        *args: object,
        cache: "PotentialCache",
        reads: str,
        features_dim: int,
        **settings: object,
    ):
        inputs = features_dim + {"actions": cache.n_actions, "state": 1, "nothing": 0}[reads]
        super().__init__(*args, features_dim=inputs, **settings)
        self.cache, self.reads, self.untrained = cache, reads, True
        self.register_buffer("running_shift", torch.zeros(()))
        self.register_buffer("running_scale", torch.ones(()))
        torch.nn.init.zeros_(self.q_net[-1].weight)
        torch.nn.init.zeros_(self.q_net[-1].bias)
        self._plain = plain_layers([*self.q_net], self.features_extractor, self.observation_space)

    def forward(self, obs: Tensors) -> torch.Tensor:
        """Return Q(s, a), (n, A)."""
        phi, best = self.cache.of(obs)
        return self.q_net(self._features(obs, phi, best)) + phi

    def _predict(self, observation: torch.Tensor, deterministic: bool = True) -> torch.Tensor:
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

    def _features(self, obs: Tensors, phi: torch.Tensor, best: torch.Tensor) -> torch.Tensor:
        """Return the residual's input, (n, features); phi is (n, A), best is Phi(s), (n, 1)."""
        features: torch.Tensor = self.extract_features(obs, self.features_extractor)
        if self.reads == "nothing":
            return features
        read = phi if self.reads == "actions" else best
        if self.untrained and torch.is_grad_enabled():
            # Shift and scale are by the mean and spread of a batch, until something is learnt.
            self.untrained = not self.q_net[-1].weight.any()
            if self.untrained:
                spread = read.std(correction=0)
                self.running_scale.copy_(1 / spread if spread > 0 else torch.ones(()))
                self.running_shift.copy_(-read.mean() * self.running_scale)
        scaled = torch.addcmul(self.running_shift, read, self.running_scale)
        return torch.cat([features, scaled], dim=1)


def as_observed(space: Space[Any], observations: Any) -> Any:
    """Return n observations as a task has them: Stable-Baselines3 moves pictures' channels."""
    if isinstance(space, Dict):
        return {key: as_observed(space[key], part) for key, part in observations.items()}
    shape: tuple[int, ...] = space.shape or ()
    if observations.shape[1:] != shape and observations.ndim == 4:
        return np.moveaxis(observations, 1, -1)
    return observations.reshape(len(observations), *shape)


class PotentialCache:
    """phi(s, a) of every action, cached for arrays; both networks of a policy share it."""

    def __init__(self, potential: ObservationPotential):
        self.potential, self.n_actions = potential, potential.task.n_actions or 0
        self.places: dict[bytes, int] = {}
        self.values = np.empty((0, 1 + self.n_actions), dtype=np.float32)

    def of(self, obs: Tensors) -> tuple[torch.Tensor, torch.Tensor]:
        """Return phi(s, a), (n, A), and Phi(s) = max_a phi(s, a), (n, 1), of tensors."""
        if isinstance(obs, dict):
            device = next(iter(obs.values())).device
            arrays = self.read({name: part.cpu().numpy() for name, part in obs.items()})
        else:
            device, arrays = obs.device, self.read(obs.cpu().numpy())
        phi, best = map(torch.from_numpy, arrays)
        return phi.to(device), best.to(device)

    def read(self, arrays: Observations) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return phi(s, a), (n, A), and Phi(s), (n, 1), of arrays."""
        if isinstance(arrays, dict):
            both = self._computed(arrays)
        else:
            arrays = np.ascontiguousarray(arrays)
            rows = arrays.reshape(len(arrays), -1)
            keys = rows.view(f"V{arrays.nbytes // len(arrays)}")[:, 0].tolist()
            if not all(map(self.places.__contains__, keys)):
                self._add(keys, arrays)
            both = self.values[list(map(self.places.__getitem__, keys))]
        return both[:, 1:], both[:, :1]

    def _computed(self, arrays: Observations) -> npt.NDArray[np.float32]:
        phi = self.potential.pairs(as_observed(self.potential.task.observations, arrays))
        return np.concatenate([phi.max(axis=1, keepdims=True), phi], axis=1, dtype=np.float32)

    def _add(self, keys: list[bytes], rows: npt.NDArray[Any]) -> None:
        """Cache phi of the observations that are not cached yet."""
        if len(self.places) * (len(keys[0]) + 4 * (1 + self.n_actions)) > MAX_BYTES:
            self.places.clear()
        new = {key: i for i, key in enumerate(keys) if key not in self.places}
        used, needed = len(self.places), len(self.places) + len(new)
        if needed > len(self.values):
            larger = np.empty((max(2 * needed, 1024), 1 + self.n_actions), np.float32)
            larger[:used] = self.values[:used]
            self.values = larger
        self.values[used:needed] = self._computed(rows[list(new.values())])
        self.places |= zip(new, range(used, needed), strict=True)


# -- a source's parameters ------------------------------------------------------------------------


def carry_over(model: BaseAlgorithm, shaping: Shaping, *, actor_alone: bool) -> None:
    """Load the only source's parameters into a model: all, or the actor's."""
    for edge in shaping.potential.edges:
        mapping = edge.mapping
        # Weights are compared by shape, so that a mapping may bridge spaces of other bounds.
        if mapping.actions is not None or mapping.status is not None:
            raise SettingError(
                f"{shaping.name} needs a mapping that keeps observations and actions as they are: "
                f"that of {edge.source!r} has {mapping.description}"
            )
    (source, *further_sources) = shaping.potential.values
    if further_sources or not isinstance(source, NetworkValues):
        raise SettingError(
            "weights must come from a single source, a network: got "
            f"{', '.join(type(values).__name__ for values in shaping.potential.values)}"
        )
    if hasattr(source.policy, "potential"):
        raise SettingError(
            "weights must come from a network that computes all of Q: got a residual on a potential"
        )
    (edge,), spreads = shaping.potential.edges, Standardized.of(source.policy)
    normalized = any(part.running_reward != 1 for part in spreads)
    foreign = ["learnt from normalised rewards"] * normalized
    foreign += ["learnt from shaped rewards"] * (source.values_offset is not None)
    rescaled = (edge.scale, edge.shift, shaping.potential.scale) != (1, 0, 1)
    foreign += ["has values with a scale or a shift"] * rescaled
    if foreign and not actor_alone:
        raise SettingError(
            f"{shaping.name} takes over a critic, whose values must be of the task's own rewards: "
            f"{edge.source!r} {foreign[0]}; PolicyReuse takes over the actor"
        )
    in_target, in_source = model.policy.state_dict(), source.policy.state_dict()
    critic = (*VALUE_HEAD, "critic") if actor_alone else ()
    names = [name for name in in_source | in_target if not name.startswith(critic)]
    names = [name for name in names if not name.endswith("running_reward")]  # of its own rewards
    for name in names:
        shapes = [tuple(x[name].shape) if name in x else "missing" for x in (in_source, in_target)]
        if shapes[0] != shapes[1]:
            raise SettingError(
                "weights can be copied between networks of one shape only: "
                f"{name} is {shapes[0]} in the source and {shapes[1]} in the target"
            )
    layers = [
        {name: type(part).__name__ for name, part in policy.named_modules() if name}
        for policy in (source.policy, model.policy)
    ]
    for name in layers[1]:
        if not name.startswith(critic) and layers[0].get(name) != layers[1][name]:
            raise SettingError(
                "weights can be copied between networks of the same layers only: "
                f"{name} is {layers[0].get(name)} in the source and {layers[1][name]} in the target"
            )
    model.policy.load_state_dict({**in_target, **{name: in_source[name] for name in names}})


def pull(progress_remaining: float) -> float:
    """Return the strength of a source's pull: from 1 at the start to 0 at half the budget."""
    return max(0.0, 1.0 - (1.0 - progress_remaining) / REUSED)


# -- acting on a source's values at first (Fernandez, Veloso 2006) -----------------------------


class _Reuse:
    """Acts on phi with a probability that falls from 1 to 0; learning is unchanged."""

    guide: ObservationPotential

    def _sample_action(
        self, learning_starts: int, action_noise: ActionNoise | None = None, n_envs: int = 1
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        share = pull(self._current_progress_remaining)  # type: ignore[attr-defined]
        if np.random.rand() < share:  # noqa: NPY002 - as Stable-Baselines3 draws
            last = as_observed(self.guide.task.observations, self._last_obs)  # type: ignore[attr-defined]
            actions = self.guide.pairs(last).argmax(axis=1)
            return actions, actions
        return super()._sample_action(learning_starts, action_noise, n_envs)  # type: ignore[misc, no-any-return]


def reusing(algorithm: type) -> type:
    """Return an off-policy algorithm that explores by its attribute ``guide``, a potential."""
    return type(f"Reusing{algorithm.__name__}", (_Reuse, algorithm), {})


# -- an actor-critic that is kept near a source's policy at first (Schmitt et al. 2018) --------


class _WithLoss(torch.autograd.Function):
    """The identity, which adds a further loss to any loss that is computed from its result."""

    @staticmethod
    def forward(ctx: object, x: torch.Tensor, loss: torch.Tensor) -> torch.Tensor:
        return x.view_as(x)

    @staticmethod
    def backward(ctx: object, *gradient: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return *gradient, gradient[0].new_ones(())


class _NearSource:
    """Makes an actor-critic policy add w KL(source || pi) to its algorithm's loss."""

    source: BasePolicy  # the frozen policy to be near to
    kl_weight: float

    def evaluate_actions(
        self, obs: Tensors, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        values, log_prob, entropy = super().evaluate_actions(obs, actions)  # type: ignore[misc]
        if self.kl_weight > 0:
            # PPO and A2C compute their losses within one method, without a place for a term: it
            # comes in where they differentiate, through the log probabilities that they all read.
            loss = self.kl_weight * self._distance(obs).mean()
            log_prob = _WithLoss.apply(log_prob, loss)
        return values, log_prob, entropy

    def _distance(self, obs: Tensors) -> torch.Tensor:
        """Return KL(source's policy || this policy) in the observations just evaluated, (n,)."""
        with torch.no_grad():
            wanted = self.source.get_distribution(obs)
        distances = kl_divergence(wanted, self.action_dist)  # type: ignore[attr-defined]
        return distances if distances.dim() == 1 else distances.sum(dim=1)


class _Kickstarted:
    """Makes an on-policy algorithm lower the weight of the KL before each of its updates."""

    kl: float

    def train(self) -> None:
        self.policy.kl_weight = self.kl * pull(self._current_progress_remaining)  # type: ignore[attr-defined]
        super().train()  # type: ignore[misc]
        self.logger.record("train/kl_weight", self.policy.kl_weight)  # type: ignore[attr-defined]


def kickstarted(algorithm: type, policy: str | type) -> tuple[type, type]:
    """Return the algorithm and the policy class of a learner that is kept near a source."""
    aliases = algorithm.policy_aliases  # type: ignore[attr-defined]
    if isinstance(policy, str):
        one_of(f"the policy of {algorithm.__name__}", policy, aliases, SettingError)
    plain = aliases.get(policy, policy)
    near = type(f"Near{plain.__name__}", (_NearSource, plain), {})
    return type(f"Kickstarted{algorithm.__name__}", (_Kickstarted, algorithm), {}), near


def begin_near(model: BaseAlgorithm, kl: float) -> None:
    """Weigh by `kl` the distance of a model's actor from its present state, that of the source."""
    policy = model.policy
    if getattr(policy, "use_sde", False):
        with torch.no_grad():
            policy.reset_noise(model.n_envs)  # noise that depends on parameters cannot be copied
    source = deepcopy(policy)
    source.set_training_mode(False)
    source.requires_grad_(requires_grad=False)
    # Not as a part of the policy: it is neither learnt nor saved with it.
    object.__setattr__(policy, "source", source)
    policy.kl_weight = model.kl = kl
