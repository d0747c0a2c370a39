"""Ways of transfer for networks alone: the network itself, its policy, or a start at values."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

from curricle.checks import number
from curricle.errors import SettingError
from curricle.learning.shaping import Shaping


@dataclass(frozen=True)
class _OfNetworks(Shaping):
    """A source whose values are not read."""

    source: Any = field(default=None, repr=False)
    kl: float = 0.0

    for_tables: ClassVar[bool] = False
    for_networks: ClassVar[bool] = True
    reads_values: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        number(f"kl of a {self.name}", self.kl, SettingError, low=0)

    @property
    def potential(self) -> Any:
        return self.source

    def with_potential(self, potential: Any) -> Self:
        return replace(self, source=potential)


@dataclass(frozen=True)
class WeightTransfer(_OfNetworks):
    """Learning starts with the parameters of the one source's network.

    Parameters
    ----------
    source : ObservationPotential or NetworkValues, optional
        Filled in by a :class:`Curriculum`.
    kl : float
        As in :class:`PolicyReuse`.

    Examples
    --------
    >>> WeightTransfer(kl=0.1).for_tables
    False
    """


@dataclass(frozen=True)
class PolicyReuse(_OfNetworks):
    """The sources' policy is carried over, but not their values.

    An off-policy learner acts on a source of action values with a probability that falls from 1 to
    0 over the first half of the budget (Fernandez, Veloso 2006). Others start with the source's
    actor, and may be kept near it at first.

    Parameters
    ----------
    source : ObservationPotential or other ValueSource, optional
        Filled in by a :class:`Curriculum`.
    kl : float
        Weight of KL(source's policy || learner's) in the loss of an actor-critic, which falls to 0
        over the first half of the budget (kickstarting, Schmitt et al. 2018).

    Examples
    --------
    >>> PolicyReuse().reads_values
    False
    """


def residual_policy(algorithm: type, policy: str = "MlpPolicy") -> type:
    """Return the policy class with which a network computes phi + a residual.

    A DQN acts, bootstraps and is evaluated on phi(s, a) + residual(s, a), in the online and the
    target network alike. The residual starts at 0; the potential is saved with the model. Among the
    ``policy_kwargs`` are

    - ``potential``, an :class:`ObservationPotential`;
    - ``reads``, which part of phi the residual reads beside the observation, standardised by the
      first batch: "actions", phi(s, .), the default for fewer than 32 actions; "state", Phi(s) =
      max_a phi(s, a), the default for more; or "nothing". A linear residual that reads nothing
      learns what Q-learning from phi learns (Wiewiora 2003); but a network of the observation alone
      may diverge where phi jumps, as tables do between cells.

    Parameters
    ----------
    algorithm : type
        DQN, or a class derived from it; others are refused with SettingError.
    policy : {"MlpPolicy", "CnnPolicy", "MultiInputPolicy"}

    Examples
    --------
    >>> from stable_baselines3 import DQN
    >>> from curricle import observation_task
    >>> from curricle.transfer import FunctionValues, ObservationPotential
    >>> car = observation_task("MountainCar-v0", discount=0.98)
    >>> push_along = FunctionValues(
    ...     lambda cars, actions: np.sign(cars[:, 1:]) * (actions - 1.0), actions=3)
    >>> phi = ObservationPotential.of(car, push_along)
    >>> model = DQN(residual_policy(DQN), "MountainCar-v0", gamma=0.98,
    ...             policy_kwargs={"potential": phi})
    >>> import numpy as np
    >>> model.predict(np.array([-0.5, 0.01], dtype=np.float32), deterministic=True)[0]
    array(2)
    """
    from curricle.deep.ways_in import POLICIES  # needs Stable-Baselines3

    if any(kind.__name__ == "DQN" for kind in algorithm.__mro__) and policy in POLICIES:
        return POLICIES[policy]
    raise SettingError(
        f"initialising a network needs DQN and one of {', '.join(POLICIES)}: got "
        f"{algorithm.__name__} with {policy}; StateShaping serves every algorithm"
    )
