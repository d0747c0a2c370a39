"""Ways of transfer for networks alone: the network itself, its policy, or demonstrations."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np

from curricle.checks import number, one_of, whole_number
from curricle.errors import SettingError
from curricle.learning.guard import Guard
from curricle.learning.shaping import Shaping
from curricle.transfer.potentials import ObservationPotential

REUSED = 0.5
"""Part of the budget in which the sources' policy is acted on, or pulls, less and less."""
Parts = Literal["all", "critic"]
"""What of a network is carried over."""


@dataclass(frozen=True)
class _OfNetworks(Shaping):
    """A source whose values are not read."""

    source: Any = field(default=None, repr=False)
    guard: Guard | None = None

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
    parts : {"all", "critic"}
        Of an actor-critic, the whole or the critic alone; :class:`PolicyReuse` is for the actor.
    kl : float
        Weight of a pull to the source's policy, as that of :class:`PolicyReuse`. 0 for a critic
        alone.
    source : ObservationPotential or NetworkValues, optional
        Filled in by a :class:`Curriculum`.
    guard : Guard, optional
        Bounds what a harmful source costs.

    Examples
    --------
    >>> WeightTransfer().for_tables
    False
    """

    parts: Parts = "all"
    kl: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("parts of a WeightTransfer", self.parts, get_args(Parts), SettingError)
        number("kl of a WeightTransfer", self.kl, SettingError, low=0)
        if self.kl > 0 and self.parts == "critic":
            raise SettingError(
                f"a critic alone has no policy to be kept near: got kl {self.kl:g} with parts "
                "'critic'"
            )


@dataclass(frozen=True)
class PolicyReuse(_OfNetworks):
    """The sources' policy is carried over, but not their values.

    An off-policy learner of numbered actions acts on it with a probability that falls from 1 to 0
    over the first half of the budget (Fernandez, Veloso 2006): greedily where the source has action
    values, else with actions drawn from its actor. Others start with the source's actor, and may be
    kept near it at first. The optimal policies stay the same, as the pull ends.

    Parameters
    ----------
    kl : float
        Weight of KL(source's policy || learner's) in the loss of an actor-critic. It falls to 0
        over the first half of the budget (kickstarting, Schmitt et al. 2018).
    source : ObservationPotential or other ValueSource, optional
        Filled in by a :class:`Curriculum`.
    guard : Guard, optional
        As for :class:`WeightTransfer`.

    Examples
    --------
    >>> PolicyReuse().reads_values
    False
    """

    kl: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        number("kl of a PolicyReuse", self.kl, SettingError, low=0)


@dataclass(frozen=True)
class Demonstrations(_OfNetworks):
    """An off-policy learner's replay buffer starts with optimal episodes of miniatures.

    They are played in the miniatures' tables, from starts drawn as resets draw them, with optimal
    actions; rewards are those of the tables. No step of any environment is taken.

    Parameters
    ----------
    steps : int
    source : ObservationPotential, optional
        Filled in by a :class:`Curriculum`; its source is :class:`Miniatures`.
    guard : Guard, optional
        As for :class:`WeightTransfer`.

    Examples
    --------
    >>> Demonstrations(steps=500).steps
    500
    """

    steps: int = 5_000

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_number("steps of Demonstrations", self.steps, 1, SettingError)


def pull(progress_remaining: float) -> float:
    """Return what is left of a source's pull: 1 at the start, 0 from the half of the budget on.

    Examples
    --------
    >>> pull(1.0), pull(0.75), pull(0.5), pull(0.0)
    (1.0, 0.5, 0.0, 0.0)
    """
    return max(0.0, 1.0 - (1.0 - progress_remaining) / REUSED)


class _Reuse:
    """Acts on phi or an actor with a probability that falls from 1 to 0; learning is unchanged."""

    guide: ObservationPotential

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> Any:
        left = pull(self._current_progress_remaining)  # type: ignore[attr-defined]
        if np.random.rand() < left:  # noqa: NPY002 - as Stable-Baselines3 draws
            actions = guided_actions(self.guide, self._last_obs)  # type: ignore[attr-defined]
            return actions, actions
        return super()._sample_action(learning_starts, action_noise, n_envs)  # type: ignore[misc]


def guided_actions(guide: ObservationPotential, observations: Any) -> Any:
    """Return the actions of a source: the best by its values, else drawn from its actor."""
    if guide.of_actions:
        return guide.pairs(observations).argmax(axis=1)
    (actor,) = guide.values
    return actor.act(observations, sampled=True)  # type: ignore[attr-defined]


def reusing(algorithm: type) -> type:
    """Return an off-policy algorithm that explores by its attribute ``guide``, a potential."""
    return type(f"Reusing{algorithm.__name__}", (_Reuse, algorithm), {})
