"""Ways of transfer that only networks have: they carry over a network, or what it does."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

from curricle.learning.shaping import Shaping


@dataclass(frozen=True)
class _OfNetworks(Shaping):
    """What both share: a source, whose values are not read."""

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
    """The parameters of the one source's network are those with which learning starts.

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
    """The sources' policy is carried over, and not their values.

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
