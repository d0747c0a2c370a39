"""Values of networks of Stable-Baselines3, which NumPy computes where it is quicker; SmallCNN."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Dict, Discrete, Space

from curricle.arrays import FloatArray
from curricle.checks import whole_number
from curricle.errors import PotentialError, SettingError
from curricle.interop.tabulated_task import needs_of
from curricle.tasks.observation_task import batch_size
from curricle.transfer.mapping import Batch, no_actions
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.rollouts import Policy

try:
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.preprocessing import preprocess_obs
    from stable_baselines3.common.torch_layers import (
        BaseFeaturesExtractor,
        CombinedExtractor,
        FlattenExtractor,
        MlpExtractor,
    )
    from stable_baselines3.common.vec_env import unwrap_vec_normalize
except ModuleNotFoundError:  # the extra is not installed: SmallCNN raises ImportError
    BaseFeaturesExtractor = ActorCriticPolicy = object

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import BasePolicy
    from stable_baselines3.common.vec_env import VecEnv

FEW = 64  # observations up to which NumPy is quicker than PyTorch
MOST_PRODUCTS = 2**18
"""Products of a layer up to which OpenBLAS stays on one thread: its threads wait for each other,
ten times as long as they compute where the processors are busy."""


class NetworkValues:
    """The values of a policy of Stable-Baselines3, in its task's own rewards.

    - DQN: Q(s, a) of its network, phi included where it is a residual; QR-DQN: the mean of the
      quantiles. V(s) = max_a Q(s, a).
    - PPO, A2C and other actor-critics: V(s) of the value head; there is no Q(s, a).
    - SAC, TD3, DDPG: Q(s, a) is the least of the critics', V(s) that of the actor's action; TQC's
      critics are the means of their quantiles.

    Parameters
    ----------
    policy : stable_baselines3.common.policies.BasePolicy
        ``model.policy`` of a model. Where a ``VecNormalize`` was around its environments, these are
        values of normalised rewards, and of normalised observations: the setting ``normalize`` of a
        :class:`DeepLearner` keeps the statistics in the policy.
    values_offset : ObservationPotential, optional
        The Phi that shaped its rewards. The policy has then learnt Q - Phi, and Phi is added here.

    Raises
    ------
    PotentialError
        When the policy has no values; when it is asked about observations or actions that it lacks.

    Examples
    --------
    >>> from stable_baselines3 import DQN
    >>> values = NetworkValues(DQN("MlpPolicy", "MountainCar-v0").policy)
    >>> cars = np.zeros((5, 2), dtype=np.float32)
    >>> values.q(cars, np.zeros(5, dtype=int)).shape, values.v(cars).shape, values.of_actions
    ((5,), (5,), True)
    """

    def __init__(self, policy: object, values_offset: ObservationPotential | None = None):
        if not isinstance(policy, torch.nn.Module):
            raise PotentialError(f"values are those of model.policy: got {policy!r}")
        self.policy, self.values_offset = policy, values_offset
        kinds = ("q_net", "quantile_net", "value_net", "critic")
        present = [kind for kind in kinds if getattr(policy, kind, None) is not None]
        if not present:
            raise PotentialError(
                f"a source's policy must have one of {', '.join(kinds)}: got "
                f"{type(policy).__name__}"
            )
        self.kind = present[0]
        self.plain = plain_network(policy, self.kind)  # the same for NumPy, if of plain layers
        self._standardized = next(Standardized.of(policy), None)  # DQN's all have one spread

    @property
    def of_actions(self) -> bool:
        """Whether the policy has a Q(s, a) for each numbered action."""
        return self.kind in ("q_net", "quantile_net")

    def q(self, observations: Batch, actions: npt.NDArray[Any]) -> FloatArray:
        """Return Q(s, a) in the shape of `actions`; SAC's kind takes one action a state."""
        if self.kind == "value_net":
            raise no_actions(self)
        if self.of_actions:
            pairs, chosen = self._outputs(observations), np.asarray(actions)
            unknown = chosen[(chosen < 0) | (chosen >= pairs.shape[1])]
            if unknown.size:
                raise PotentialError(
                    f"a network has values of its own {pairs.shape[1]} actions only: action "
                    f"{unknown[0]} is asked for; a mapping's actions= names the source's"
                )
            rows = np.arange(len(pairs))
            values = pairs[rows[:, None] if chosen.ndim == 2 else rows, chosen]
        else:
            scaled = self.policy.scale_action(np.asarray(actions, dtype=np.float32))
            values = self._critics(observations, scaled)
        return self._with_offset(values, observations)

    def v(self, observations: Batch) -> FloatArray:
        """Return V(s), (n,) float64."""
        if self.kind == "critic":
            values = self._critics(observations)
        else:
            values = self._outputs(observations).max(axis=1)
        return self._with_offset(values, observations)

    def parameters(self) -> dict[str, npt.NDArray[Any]]:
        """Return the policy's parameters by name, as plain arrays."""
        state = self.policy.state_dict()
        return {name: value.detach().cpu().numpy().copy() for name, value in state.items()}

    def load(self, parameters: Mapping[str, npt.NDArray[Any]]) -> None:
        """Take over parameters, as :meth:`parameters` returned them."""
        tensors = {name: torch.as_tensor(value) for name, value in parameters.items()}
        self.policy.load_state_dict(tensors)

    def _seen(self, observations: Batch) -> Any:
        if self.policy.training:
            self.policy.set_training_mode(False)
        try:
            return self.policy.obs_to_tensor(observations)[0]
        except ValueError as error:
            raise PotentialError(
                f"a network reads observations of {self.policy.observation_space}: {error}; a "
                "mapping's observations= makes them"
            ) from None

    def _outputs(self, observations: Batch) -> FloatArray:
        """Return Q of every action, (n, A), or of an actor-critic V, (n, 1)."""
        if self.plain is not None and self.plain.takes(observations):
            outputs = self.plain.read(observations).astype(np.float64)
        else:
            if hasattr(self.policy, "lstm_actor"):
                raise PotentialError(
                    "values must depend on an observation alone, without memory: got "
                    f"{type(self.policy).__name__}; WeightTransfer and PolicyReuse read no values"
                )
            heads = self.kind == "value_net"
            network = self.policy.predict_values if heads else getattr(self.policy, self.kind)
            with torch.no_grad():
                outputs = network(self._seen(observations)).cpu().numpy().astype(np.float64)
        if self.kind == "quantile_net":
            n_actions = int(self.policy.action_space.n)
            outputs = outputs.reshape(len(outputs), -1, n_actions).mean(axis=1)
        return outputs

    def _critics(self, observations: Batch, actions: object = None) -> FloatArray:
        """Return the critics' least Q of scaled actions, by default of the actor's, (n,)."""
        with torch.no_grad():
            inputs = self._seen(observations)
            if actions is None:
                taken = self.policy._predict(inputs, deterministic=True)
            else:
                taken = torch.as_tensor(actions, device=self.policy.device)
            critics = self.policy.critic(inputs, taken)
            if isinstance(critics, torch.Tensor):  # TQC's quantiles, (n, critics, quantiles)
                critics = critics.mean(dim=2, keepdim=True).unbind(1)
            values = [q[:, 0].cpu().numpy() for q in critics]
        return np.min(values, axis=0).astype(np.float64)  # type: ignore[no-any-return]

    def _with_offset(self, values: FloatArray, observations: Batch) -> FloatArray:
        if self._standardized is not None:  # of normalised rewards
            values = values * float(self._standardized.running_reward)
        if self.values_offset is None:
            return values
        phi = self.values_offset.v(observations)
        return values + (phi[:, None] if values.ndim == 2 else phi)


def acting(
    model: "BaseAlgorithm | BasePolicy", environments: Sequence[Any], *, sampled: bool = False
) -> Policy:
    """Return how a model acts in episodes side by side, with its memory and masks of actions."""
    masked = needs_of(model) == "masks of actions"
    layers = None if sampled else greedy_layers(model)
    memory: Any = None  # arrays (layers, episodes, size), of those that ran before
    before: Sequence[int] = ()

    def policy(observations: object, running: Sequence[int]) -> npt.NDArray[Any]:
        nonlocal memory, before
        if layers is not None:
            with torch.no_grad():  # the operations of `predict`, without what surrounds them
                logits = layers(torch.as_tensor(observations).float())
                logits = logits - logits.logsumexp(-1, keepdim=True)
                return np.asarray(torch.softmax(logits, -1).argmax(1))
        kept, masks = np.isin(before, running), {}
        if masked:
            rows = [environments[k].get_wrapper_attr("action_masks")() for k in running]
            masks["action_masks"] = np.stack(rows)
        state = memory and tuple(part[:, kept] for part in memory)
        begins = np.full(len(running), not before)
        actions, memory = model.predict(observations, state, begins, not sampled, **masks)
        before = running
        return np.asarray(actions)

    return policy


def greedy_layers(policy: Any) -> "torch.nn.Module | None":
    """Return a plain actor's layers, on whose largest output it acts; None if any is unusual."""
    if type(policy) is not ActorCriticPolicy or type(policy.mlp_extractor) is not MlpExtractor:
        return None
    modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    plain = plain_layers(modules, policy.pi_features_extractor, policy.observation_space)
    usual = plain and isinstance(policy.action_space, Discrete)
    return torch.nn.Sequential(*modules) if usual and policy.device.type == "cpu" else None


# -- plain layers, computed by NumPy, which is quicker for few observations --------------------


class Layer(NamedTuple):
    """x -> activation(W x + b)."""

    weight: "torch.nn.Parameter"  # the parameter itself, as it is when read
    bias: "torch.nn.Parameter"
    activation: Callable[[npt.NDArray[Any]], npt.NDArray[Any]] | None


@dataclass(frozen=True)
class PlainNetwork:
    """Layers one after the other, computed by NumPy."""

    layers: tuple[Layer, ...]

    def is_quicker_for(self, n: int) -> bool:
        """Return whether n observations are few and the network is not on another device."""
        few = n <= FEW and n * self.widest <= MOST_PRODUCTS
        return few and self.layers[0].weight.device.type == "cpu"

    @cached_property
    def widest(self) -> int:
        """The weights of the largest layer."""
        return max(int(layer.weight.numel()) for layer in self.layers)

    def takes(self, observations: Batch) -> TypeGuard[npt.NDArray[Any]]:
        """Return whether observations are vectors, (n, D), for which NumPy is quicker."""
        if not isinstance(observations, np.ndarray) or observations.ndim != 2:
            return False
        fits = observations.shape[1] == self.layers[0].weight.shape[1]
        return fits and self.is_quicker_for(len(observations))

    def read(self, observations: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Return the outputs for n vectors, (n, outputs)."""
        outputs = observations.astype(np.float32, copy=False)
        for weight, bias, activation in self.layers:
            outputs = outputs @ weight.detach().numpy().T + bias.detach().numpy()
            if activation is not None:
                outputs = activation(outputs)
        return outputs


def plain_network(policy: "BasePolicy", kind: str) -> PlainNetwork | None:
    """Return a policy's network from vectors to values; None if any part of it is unusual."""
    if kind == "critic":
        return None
    if kind == "value_net":
        usual = type(policy).predict_values is ActorCriticPolicy.predict_values
        usual = usual and type(policy.mlp_extractor) is MlpExtractor
        modules = [*policy.mlp_extractor.value_net, policy.value_net] if usual else []
        return plain_layers(modules, policy.vf_features_extractor, policy.observation_space)
    network = getattr(policy, kind)
    usual = type(network).__module__.startswith(("stable_baselines3.", "sb3_contrib."))
    modules = [*getattr(network, kind)] if usual else []
    return plain_layers(modules, network.features_extractor, policy.observation_space)


def plain_layers(
    modules: "Sequence[torch.nn.Module]", extractor: "torch.nn.Module", space: Space[Any]
) -> PlainNetwork | None:
    """Return the layers of modules after the usual extractor; None if any of it is unusual."""
    if not isinstance(space, Box) or len(space.shape) != 1:
        return None
    activations: dict[type, Any] = {torch.nn.ReLU: partial(np.maximum, 0), torch.nn.Tanh: np.tanh}
    layers: list[Layer] = []
    for module in modules:
        if type(module) is torch.nn.Linear and module.bias is not None:
            layers.append(Layer(module.weight, module.bias, None))
        elif type(module) in activations and layers and layers[-1].activation is None:
            layers[-1] = layers[-1]._replace(activation=activations[type(module)])
        else:
            return None
    return PlainNetwork(tuple(layers)) if layers and type(extractor) is FlattenExtractor else None


class Standardized(BaseFeaturesExtractor):
    """Standardises boxes of numbers by their mean and spread so far, for another extractor.

    It does inside a network what ``VecNormalize`` does before it, so that whoever reads the network
    needs no statistics beside it. It also holds the spread by which rewards were divided; if
    `epsilon`, which is added to variances, is None, it does nothing else.
    """

    def __init__(
        self,
        observation_space: Space[Any],
        extractor_class: "type[BaseFeaturesExtractor] | None" = None,
        extractor_kwargs: Mapping[str, Any] | None = None,
        *,
        epsilon: float | None = 1e-8,
    ):
        usual = CombinedExtractor if isinstance(observation_space, Dict) else FlattenExtractor
        inner = (extractor_class or usual)(observation_space, **(extractor_kwargs or {}))
        super().__init__(observation_space, inner.features_dim)
        parts: dict[str, Any] = getattr(observation_space, "spaces", {"": observation_space})
        boxes = [key for key, part in parts.items() if isinstance(part, Box)]
        self.inner, self.epsilon = inner, epsilon
        self.numbers = {key: f"running_{i}" for i, key in enumerate(boxes) if epsilon is not None}
        for key, name in self.numbers.items():
            self.register_buffer(f"{name}_mean", torch.zeros(parts[key].shape))
            self.register_buffer(f"{name}_var", torch.ones(parts[key].shape))
        self.register_buffer("running_count", torch.tensor(1e-4))
        self.register_buffer("running_reward", torch.ones(()))

    @staticmethod
    def of(policy: "BasePolicy") -> "Iterator[Standardized]":
        """Yield the standardising parts of a policy."""
        return (part for part in policy.modules() if isinstance(part, Standardized))

    def see(self, policy: "BasePolicy", observations: object, venv: "VecEnv | None" = None) -> None:
        """Count n observations in, and take over the spread of a ``VecNormalize``'s returns."""
        inputs = policy.obs_to_tensor(observations)[0]
        inputs = preprocess_obs(inputs, self._observation_space, policy.normalize_images)
        count: Any = self.running_count
        n = batch_size(inputs)
        for key, name in self.numbers.items():
            part = inputs[key] if key else inputs
            mean, var = getattr(self, f"{name}_mean"), getattr(self, f"{name}_var")
            weight, shift = n / (count + n), part.mean(0) - mean
            mean.add_(shift * weight)
            var.add_((part.var(0, correction=0) - var + shift.square() * (1 - weight)) * weight)
        count.add_(n)
        normalized = None if venv is None else unwrap_vec_normalize(venv)
        if normalized is not None:
            spread = float(np.sqrt(normalized.ret_rms.var + normalized.epsilon))
            self.running_reward.fill_(spread)

    def forward(self, observations: object) -> "torch.Tensor":
        """Return the features of n observations, (n, features_dim)."""
        scaled = dict(observations) if isinstance(observations, Mapping) else {"": observations}
        for key, name in self.numbers.items():
            shift, var = getattr(self, f"{name}_mean"), getattr(self, f"{name}_var")
            scaled[key] = ((scaled[key] - shift) / torch.sqrt(var + self.epsilon)).clamp(-10, 10)
        return self.inner(scaled if isinstance(observations, Mapping) else scaled[""])


class SmallCNN(BaseFeaturesExtractor):
    """Two convolutions of 3 x 3 and a layer, for pictures from 5 x 5 cells, channels first.

    For ``CnnPolicy``, among the ``policy_kwargs`` of a :class:`DeepLearner`:
    ``{"features_extractor_class": SmallCNN, "normalize_images": False}``.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Box
        (channels, height, width); SettingError for any other shape.
    features_dim : int
        Number of features that the network returns.
    channels : int
        Channels of the first convolution; the second has twice as many.

    Examples
    --------
    >>> network = SmallCNN(Box(0, 1, (24, 7, 7), np.float32), features_dim=64)
    >>> network(torch.zeros(5, 24, 7, 7)).shape
    torch.Size([5, 64])
    """

    def __init__(self, observation_space: Space[Any], features_dim: int = 128, channels: int = 16):
        if BaseFeaturesExtractor is object:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        shape: tuple[int, ...] = observation_space.shape or ()
        if not isinstance(observation_space, Box) or len(shape) != 3 or min(shape[1:]) < 5:
            raise SettingError(
                "SmallCNN reads pictures (channels, height, width) from 5 x 5 cells: got "
                f"{observation_space}"
            )
        for name, value in {"features_dim": features_dim, "channels": channels}.items():
            whole_number(f"{name} of SmallCNN", value, 1, SettingError)
        super().__init__(observation_space, features_dim)
        height, width = (side - 4 for side in shape[1:])  # each convolution takes off 2
        self.layers = torch.nn.Sequential(
            torch.nn.Conv2d(shape[0], channels, 3),
            torch.nn.ReLU(),
            torch.nn.Conv2d(channels, 2 * channels, 3),
            torch.nn.ReLU(),
            torch.nn.Flatten(),
            torch.nn.Linear(2 * channels * height * width, features_dim),
            torch.nn.ReLU(),
        )

    def forward(self, observations: object) -> "torch.Tensor":
        """Return the features of n pictures, (n, features_dim)."""
        return self.layers(observations)
