"""Whose turn it is, of two networks that learn side by side, and what a harmful source then costs.

A model with the source and one without it take turns, each in sub-environments of its own, and
steps count over both. A turn lasts until an episode of its model has ended, and goes on to the end
of the rollout. The first turn of each is longer: an episode must have ended in every
sub-environment, as those that end first are the short ones, and two in all. From then on the mean
returns of their last episodes are compared; returns are undiscounted and unshaped. The model with
the higher mean is ahead, the one without the source in doubt: it is evaluated, handed on and
stored.

**Replay.** Off-policy models learn from every step of both, as tables do. The one with the source
acts in the share of the steps that is the probability that it earns more.

**Split environments.** An on-policy model learns from its own steps alone, so that what one gets
the other lacks. With p the probability that the source's model earns more, it gets a share of

    share_behind + (share_ahead - share_behind) (2 p - 1)^4

of the steps while it is ahead: little until that is nearly certain, so that a source that makes no
difference leaves nine tenths of the steps to scratch. While it is not ahead it gets share_behind,
saved up before a turn of the length of its longest.

**The bound.** In T steps, of which T0 belong to turns that began while the source's model was not
ahead, this model acts in no more than

    share_behind T0 + L

steps of such turns, where L is the length of its longest turn: its first one, before there is
anything to compare, and what is saved up. This holds for each seed, any source and any task. The
model without the source gets at least (1 - share_behind) T0 + (1 - share_ahead) (T - T0) - 2 L
steps, and an on-policy one learns what it would learn from them alone. L is no more than the
longest episode, twice that with a single sub-environment, in whole rollouts of all
sub-environments, so that a budget should hold many.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.learning.guard import (
    SCRATCH,
    SHAPED,
    UNDECIDED,
    Guard,
    Tally,
    add_return,
    empty_tally,
    superiority,
)

FIRST_EPISODES = 2
"""Episodes of each model before they are compared: the fewest that have a variance."""
CERTAINTY = 4
"""The power of 2 p - 1 in the share of an on-policy model with the source."""

# Compiled functions that loops inline have no entry from Python: these are what they compile.
_add_return, _superiority = (getattr(each, "py_func", each) for each in (add_return, superiority))


@dataclass
class Turns:
    """Whose turn it is, and what both models have earned.

    Examples
    --------
    >>> turns = Turns(Guard(), envs=1, shared=False)
    >>> for returns in ([1.0, 2.0], [5.0, 6.0]):  # of scratch the second
    ...     for one in returns:
    ...         turns.step([{}] * 9 + [{"episode": {"r": one}}])
    ...     turns.begin()
    >>> turns.ahead == SCRATCH, turns.acting == SCRATCH, turns.share
    (True, True, 0.05)
    """

    guard: Guard
    envs: int
    shared: bool
    """Whether both learn from every step."""
    tally: Tally = field(default_factory=empty_tally)
    acting: int = SHAPED
    ahead: int = SCRATCH
    share: float = UNDECIDED
    """Of the steps, for the model with the source."""
    ended: IntArray = field(init=False)
    """Episodes that ended, by model and sub-environment, (2, envs)."""
    compared: bool = False
    """Whether this turn began with both known."""
    length: int = 0
    """Steps of this turn so far."""
    turn_ended: int = 0
    """Episodes that ended in it."""
    longest: int = 0
    """Steps of the longest turn of the model with the source."""

    def __post_init__(self) -> None:
        self.ended = np.zeros((2, self.envs), np.int64)

    def step(self, infos: Sequence[Mapping[str, Any]]) -> None:
        """Note a step of each sub-environment of the model that acts."""
        self.length += len(infos)
        for i, info in enumerate(infos):
            if "episode" in info:
                earned = float(info["episode"]["r"])
                _add_return(self.tally, self.acting, earned, 1.0 / self.guard.memory)
                self.ended[self.acting, i % self.envs] += 1
                self.turn_ended += 1

    def begin(self) -> None:
        """Begin the next turn if this one is over."""
        if not self.turn_ended or not self._known(self.acting):
            return
        if self.acting == SHAPED:
            self.longest = max(self.longest, self.length)
        if self.compared:
            spent = self.length if self.acting == SHAPED else 0
            self.tally.credit[self.ahead] += self.share * self.length - spent
        self.length = self.turn_ended = 0
        if not self._known(SCRATCH):
            self.acting = SCRATCH
            return
        self.compared = True
        certain = float(_superiority(self.tally))
        self.ahead = SHAPED if certain > UNDECIDED else SCRATCH
        self.share = self._share(certain)
        saved, needed = self.tally.credit[self.ahead], self.longest if self.ahead == SCRATCH else 0
        self.acting = SHAPED if saved > needed else SCRATCH

    def _share(self, certain: float) -> float:
        behind, ahead = self.guard.share_behind, self.guard.share_ahead
        if self.ahead == SCRATCH:
            return behind
        if self.shared:
            return min(certain, ahead)
        return behind + (ahead - behind) * (2 * certain - 1) ** CERTAINTY

    def _known(self, model: int) -> bool:
        """Return whether a model's returns can be compared."""
        ended = self.ended[model]
        return bool(ended.min() >= 1 and ended.sum() >= FIRST_EPISODES)
