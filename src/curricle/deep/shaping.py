"""Ways of transfer for networks alone: the network itself, or its policy, is carried over."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from curricle.learning.shaping import Shaping
from curricle.transfer.potentials import ObservationPotential

REUSED = 0.5
"""Part of the budget in which the sources' policy is acted on, with falling probability."""


@dataclass(frozen=True)
class _OfNetworks(Shaping):
    """A source whose values are not read."""

    source: Any = field(default=None, repr=False)

    for_tables: ClassVar[bool] = False
    for_networks: ClassVar[bool] = True
    reads_values: ClassVar[bool] = False

    @property
    def potential(self) -> Any:
        """The source."""
        return self.source

    def with_potential(self, potential: Any) -> Self:
        """Return the same way of transfer from another source."""
        return replace(self, source=potential)


@dataclass(frozen=True)
class WeightTransfer(_OfNetworks):
    """Learning starts with the parameters of the one source's network.

    Parameters
    ----------
    source : ObservationPotential or NetworkValues, optional
        Filled in by a :class:`Curriculum`.

    Examples
    --------
    >>> WeightTransfer().for_tables
    False
    """


@dataclass(frozen=True)
class PolicyReuse(_OfNetworks):
    """The sources' policy is carried over, but not their values.

    An off-policy learner of numbered actions acts on it with a probability that falls from 1 to 0
    over the first half of the budget (Fernandez, Veloso 2006); others start with the source's
    actor.

    Parameters
    ----------
    source : ObservationPotential or other ValueSource, optional
        Filled in by a :class:`Curriculum`.

    Examples
    --------
    >>> PolicyReuse().reads_values
    False
    """


class _Reuse:
    """Acts greedily on phi with a probability that falls from 1 to 0; learning is unchanged."""

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
    """Return an off-policy algorithm that explores by its attribute ``guide``, a potential."""
    return type(f"Reusing{algorithm.__name__}", (_Reuse, algorithm), {})
