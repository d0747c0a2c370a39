"""How a network is fitted to what is known of observations."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from curricle.array_types import IntArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError


@dataclass(frozen=True)
class Distillation:
    """How a network is fitted.

    Parameters
    ----------
    updates : int
        Steps of Adam.
    batch_size : int
        Observations of each.
    learning_rate : float
    smoothing : float
        Share of each policy that is spread over all actions (label smoothing, Szegedy et al. 2016).
        An actor that is sure outside its training levels neither explores nor unlearns. Chosen on
        SimpleCrossing of one wall to two, LavaGap of sides 5 and 6 to 7, and DoorKey of side 5 to
        6: with 0.1 what is drawn from the actor returns .53, .25 and .38 there, with 0 .42, .09 and
        .09.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Distillation(updates=200).batch_size
    512
    """

    updates: int = 1_000
    batch_size: int = 512
    learning_rate: float = 1e-3
    smoothing: float = 0.1

    def __post_init__(self) -> None:
        for name in ("updates", "batch_size"):
            whole_number(f"{name} of a distillation", getattr(self, name), 1, SettingError)
        number("learning_rate of a distillation", self.learning_rate, SettingError, low=0)
        number("smoothing of a distillation", self.smoothing, SettingError, low=0, high=1)

    def batches(self, n: int, seed: int) -> Iterator[IntArray]:
        """Yield the rows of each update: all n in a new order, over and over."""
        rng = np.random.default_rng(seed)
        order = rng.permutation(n)
        for _ in range(self.updates):
            if len(order) < min(self.batch_size, n):
                order = np.concatenate([order, rng.permutation(n)])
            yield order[: self.batch_size]
            order = order[self.batch_size :]
