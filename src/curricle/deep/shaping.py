"""Ways of transfer for networks alone: the network itself, or its policy."""

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
    kl : float
        Weight of a pull to the source's policy, as that of :class:`PolicyReuse`.

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
    actor, and may be kept near it at first. The optimal policies stay the same, as the pull ends.

    Parameters
    ----------
    source : ObservationPotential or other ValueSource, optional
        Filled in by a :class:`Curriculum`.
    kl : float
        Weight of KL(source's policy || learner's) in the loss of an actor-critic. It falls to 0
        over the first half of the budget (kickstarting, Schmitt et al. 2018).

    Examples
    --------
    >>> PolicyReuse().reads_values
    False
    """
