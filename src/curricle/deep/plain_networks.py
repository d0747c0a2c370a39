"""Networks of plain layers, computed by NumPy, which is quicker for few observations."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box, Space
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor, MlpExtractor
from torch.nn import Linear, ReLU, Tanh

FEW = 64
"""Observations up to which NumPy is quicker than PyTorch."""
MOST_PRODUCTS = 2**18
"""Products of a layer up to which OpenBLAS stays on one thread: its threads wait for each other,
ten times as long as they compute where the processors are busy."""


def _relu(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.asarray(np.maximum(values, 0))


ACTIVATIONS: dict[type, Any] = {ReLU: _relu, Tanh: np.tanh}


class Layer(NamedTuple):
    """x -> activation(W x + b)."""

    weight: torch.nn.Parameter  # the parameter itself, as it is when read
    bias: torch.nn.Parameter
    activation: Callable[[npt.NDArray[Any]], npt.NDArray[Any]] | None


@dataclass(frozen=True)
class PlainNetwork:
    """Layers one after the other, computed by NumPy.

    Examples
    --------
    >>> layer = Linear(2, 1)
    >>> _ = torch.nn.init.ones_(layer.weight), torch.nn.init.zeros_(layer.bias)
    >>> network = PlainNetwork((Layer(layer.weight, layer.bias, np.abs),))
    >>> network.read(np.array([[1.0, 2.0], [-3.0, 1.0]]))
    array([[3.],
           [2.]], dtype=float32)
    """

    layers: tuple[Layer, ...]

    def is_quicker_for(self, n: int) -> bool:
        """Return whether n observations are few and the network is not on another device."""
        few = n <= FEW and n * self.widest <= MOST_PRODUCTS
        return few and self.layers[0].weight.device.type == "cpu"

    @cached_property
    def widest(self) -> int:
        """The weights of the largest layer."""
        return max(int(layer.weight.numel()) for layer in self.layers)

    def takes(self, observations: Any) -> bool:
        """Return whether these are vectors, (n, D), for which this is quicker."""
        vectors = isinstance(observations, np.ndarray) and observations.ndim == 2
        fits = vectors and observations.shape[1] == self.layers[0].weight.shape[1]
        return fits and self.is_quicker_for(len(observations))

    def read(self, observations: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Return the outputs for n vectors, (n, outputs)."""
        found = observations.astype(np.float32, copy=False)
        for weight, bias, activation in self.layers:
            found = found @ weight.detach().numpy().T + bias.detach().numpy()
            if activation is not None:
                found = activation(found)
        return found


def plain_network(policy: Any, kind: str) -> PlainNetwork | None:
    """Return the network from vectors to a policy's values; None if anything in it is unusual.

    Values are Q(s, a) of DQN (kind "q_net"), the quantiles of QR-DQN ("quantile_net") or V(s) of an
    actor-critic ("value_net"), each of ``MlpPolicy``.
    """
    if kind == "value_net":
        usual = type(policy).predict_values is ActorCriticPolicy.predict_values
        usual = usual and type(policy.mlp_extractor) is MlpExtractor
        modules = [*policy.mlp_extractor.value_net, policy.value_net] if usual else []
        return plain_layers(modules, policy.vf_features_extractor, policy.observation_space)
    if kind in ("q_net", "quantile_net"):
        network = getattr(policy, kind)
        usual = type(network).__module__.startswith(("stable_baselines3.", "sb3_contrib."))
        modules = [*getattr(network, kind)] if usual else []
        return plain_layers(modules, network.features_extractor, policy.observation_space)
    return None


def plain_layers(
    modules: Sequence[torch.nn.Module], extractor: torch.nn.Module, space: Space[Any]
) -> PlainNetwork | None:
    """Return modules in a row that follow the usual extractor; None if any of it is unusual."""
    if not isinstance(space, Box) or len(space.shape) != 1:
        return None
    layers: list[Layer] = []
    for module in modules:
        if type(module) is Linear and module.bias is not None:
            layers.append(Layer(module.weight, module.bias, None))
        elif type(module) in ACTIVATIONS and layers and layers[-1].activation is None:
            layers[-1] = layers[-1]._replace(activation=ACTIVATIONS[type(module)])
        else:
            return None
    return PlainNetwork(tuple(layers)) if layers and type(extractor) is FlattenExtractor else None
