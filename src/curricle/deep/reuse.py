"""Transfer of a policy alone: exploring by what the sources would do (Fernandez, Veloso 2006)."""

from typing import Any

import numpy as np

from curricle.transfer.observation_potential import ObservationPotential

REUSED = 0.5
"""Part of the budget in which the sources' policy is acted on, ever more rarely."""


class _Reuse:
    """Acts greedily on phi with a probability that falls from 1 to 0; learns as it is."""

    guide: ObservationPotential

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> Any:
        past = 1.0 - self._current_progress_remaining  # type: ignore[attr-defined]
        if np.random.rand() < 1.0 - past / REUSED:  # noqa: NPY002 - as Stable-Baselines3 draws
            actions = self.guide.pairs(self._last_obs).argmax(axis=1)  # type: ignore[attr-defined]
            return actions, actions
        return super()._sample_action(learning_starts, action_noise, n_envs)  # type: ignore[misc]


def reusing(algorithm: type) -> type:
    """Return an off-policy algorithm that explores by its attribute ``guide``, a potential.

    Examples
    --------
    >>> from stable_baselines3 import DQN
    >>> reusing(DQN).__name__
    'ReusingDQN'
    """
    return type(f"Reusing{algorithm.__name__}", (_Reuse, algorithm), {})
