"""RiverSwim: a chain against a current, in which the small reward is near and the large one far.

Strehl and Littman 2008, "An analysis of model-based interval estimation for Markov decision
processes", figure 2, has the defaults. Swimming left always succeeds. The task never ends; the
paper learns 5,000 steps of it with discount 0.95.

Osband, Russo, Van Roy 2013 ("(More) efficient reinforcement learning via posterior sampling") have
``RiverSwim(forward=0.35, back=0.05, leave_bank=0.6, stay_at_end=0.6, left_reward=0.005,
right_reward=1, start=(0,))``, paying the large reward in the last state whatever happens there.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np

from curricle.arrays import frozen
from curricle.errors import TaskError
from curricle.tasks.domain import Discount, DomainWithStart, TimeLimit, family_of
from curricle.tasks.family import FamilyMember, Rule
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import PROBABILITY_TOLERANCE, FiniteMDP
from curricle.tasks.spaces import Component, Space, whole

LARGEST_SIZE = 1_000_000  # positions of a river at most
LARGEST_OF_FAMILY = 10_000


@dataclass(frozen=True)
class RiverSwim(DomainWithStart):
    """A swimmer in a river: left with the current is sure, right against it is not.

    Parameters
    ----------
    size : int
        Positions from bank to bank, 2 to 1,000,000.
    forward, back : float
        Probabilities that swimming right moves one position on, and one back.
    leave_bank : float
        Probability that swimming right leaves the left bank; else the swimmer stays.
    stay_at_end : float
        Probability that swimming right stays at the right bank; else it is carried back.
    left_reward : float
        Of swimming left at the left bank.
    right_reward : float
        Of staying at the right bank by swimming right.
    start : "uniform" or positions
        Where episodes start, equally likely; in the paper 1 and 2.
    origin : int
        The leftmost position. A crop keeps the positions of the whole river.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> river = RiverSwim()
    >>> river.states, river.actions.components[0].labels
    (Space(6 points: position[6]), ('left', 'right'))
    >>> river.crop(positions=(3, 6)).left_reward  # the left bank is not part of it
    0.0
    """

    size: Annotated[int, Rule(2, LARGEST_SIZE, "larger")] = 6
    forward: Annotated[float, Rule(0, 1, "smaller")] = 0.3
    back: Annotated[float, Rule(0, 1, "larger")] = 0.1
    leave_bank: Annotated[float, Rule(0, 1, "smaller")] = 0.3
    stay_at_end: Annotated[float, Rule(0, 1, "smaller")] = 0.3
    left_reward: float = 5.0
    right_reward: float = 10_000.0
    start: Any = (1, 2)
    origin: Annotated[int, Rule(1 - LARGEST_SIZE, 2**31, varies=False)] = 0
    discount: Discount = 0.95
    time_limit: TimeLimit = 200

    ACTIONS = ("left", "right")

    def _check(self) -> None:
        if self.forward + self.back > 1 + PROBABILITY_TOLERANCE:
            raise TaskError(
                f"forward and back must be at most 1 together: got {self.forward:g} and "
                f"{self.back:g}"
            )
        if self.start != "uniform":
            object.__setattr__(self, "start", self._positions())

    def _positions(self) -> tuple[int, ...]:
        """Return the positions of the start, sorted."""
        listed = isinstance(self.start, Iterable) and not isinstance(self.start, str)
        positions = whole([*self.start] if listed else [], "the positions of start")
        end = self.origin + self.size
        inside = (positions >= self.origin) & (positions < end)
        if positions.ndim != 1 or not positions.size or not inside.all():
            raise TaskError(
                f"start must be 'uniform' or positions in {self.origin}..{end - 1}: got "
                f"{self.start!r}"
            )
        return tuple(sorted(set(positions.tolist())))

    def crop(self, *, positions: tuple[int, int], start: Any = "uniform") -> Self:
        """Return the part of the river in a half-open range of its positions.

        Its first and last positions are banks; the reward of a bank that is not part of it is 0.
        """
        part = whole(positions, "a crop's positions")
        end = self.origin + self.size
        if part.shape != (2,) or not self.origin <= part[0] < part[1] - 1 < end:
            raise TaskError(
                f"a crop must have 2 or more of the river's positions {self.origin}..{end}: got "
                f"{positions!r}"
            )
        first, last = part.tolist()
        return replace(
            self,
            size=last - first,
            origin=first,
            left_reward=self.left_reward if first == self.origin else 0.0,
            right_reward=self.right_reward if last == end else 0.0,
            start=start,
        )

    @cached_property
    def states(self) -> Space:
        """The swimmer's position."""
        return Space([Component("position", self.size, low=self.origin)])

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures: in one row."""
        columns = self.origin + np.arange(self.size)
        return GridLayout(
            cells=frozen(np.stack([np.zeros_like(columns), columns], axis=1)),
            components=("position",),
            shape=(1, self.size),
            origin=(0, self.origin),
        )

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The river as tables: rows 0..S-1 swim left, S..2S-1 right, O = back, stay and forward."""
        n, here = self.size, np.arange(self.size)
        to = np.clip(here[:, None] + np.array([-1, 0, 1]), 0, n - 1)
        left = np.tile([1.0, 0.0, 0.0], (n, 1))
        stay = max(0.0, 1 - self.forward - self.back)
        right = np.tile([self.back, stay, self.forward], (n, 1))
        right[0] = 0, 1 - self.leave_bank, self.leave_bank
        right[-1] = 1 - self.stay_at_end, self.stay_at_end, 0
        reward = np.zeros((2 * n, 3))
        reward[0, 0] = self.left_reward
        reward[-1, 1] = self.right_reward
        return self._tables(
            np.concatenate([left, right]),
            np.tile(to, (2, 1)),
            reward,
            terminal=np.zeros(n, bool),
            starting=here if self.start == "uniform" else np.array(self.start) - self.origin,
            outcome_row=np.stack([here, n + here], axis=1),
        )


def _river(size: Annotated[int, Rule(2, LARGEST_OF_FAMILY, "larger")] = 6, **rules: Any) -> Any:
    """Return a river whose episodes start at its second or third position, where it has them."""
    return RiverSwim(size, start=(1, 2) if size > 2 else (1,), **rules)


def _from_the_right_bank(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a river reads another: counted from the right bank, and not past the left one."""
    shift = target["size"] - source["size"]
    return lambda states, moves: ({"position": np.maximum(states["position"] - shift, 0)}, moves)


def _chances_of_a_river(parameters: dict[str, Any]) -> str | None:
    total = parameters["forward"] + parameters["back"]
    return None if total <= 1 else "forward and back of river_swim must be at most 1 together"


river_swim_family = family_of(
    RiverSwim, _river, mapping=_from_the_right_bank, constraint=_chances_of_a_river
)
"""Rivers (:class:`RiverSwim`); members map by position, counted from the right bank."""
