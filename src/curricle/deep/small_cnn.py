"""A small convolutional network, for pictures of a few cells a side."""

from typing import Any

from gymnasium.spaces import Box

from curricle.checks import whole_number
from curricle.errors import SettingError

try:
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    BaseFeaturesExtractor = object


class SmallCNN(BaseFeaturesExtractor):
    """Two convolutions of 3 x 3 and a layer, for pictures from 5 x 5 cells, channels first.

    It is for ``CnnPolicy``, among the ``policy_kwargs`` of a :class:`DeepLearner`:
    ``{"features_extractor_class": SmallCNN, "normalize_images": False}``, which reads pictures as
    they are. (Stable-Baselines3 divides pictures by 255 if they are bytes from 0 to 255, and no
    others.)

    Parameters
    ----------
    observation_space : gymnasium.spaces.Box
        (channels, height, width).
    features_dim : int
        Numbers that it returns.
    channels : int
        Of the first convolution; the second has twice as many.

    Raises
    ------
    SettingError
        When the space is no such picture, or a number is below 1.

    Examples
    --------
    >>> import numpy as np, torch
    >>> network = SmallCNN(Box(0, 1, (24, 7, 7), np.float32), features_dim=64)
    >>> network(torch.zeros(5, 24, 7, 7)).shape
    torch.Size([5, 64])
    """

    def __init__(self, observation_space: Any, features_dim: int = 128, channels: int = 16):
        if BaseFeaturesExtractor is object:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        from torch import nn

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
        self.layers = nn.Sequential(
            nn.Conv2d(shape[0], channels, 3),
            nn.ReLU(),
            nn.Conv2d(channels, 2 * channels, 3),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(2 * channels * height * width, features_dim),
            nn.ReLU(),
        )

    def forward(self, observations: Any) -> Any:
        """Return the features of n pictures, (n, features_dim)."""
        return self.layers(observations)
