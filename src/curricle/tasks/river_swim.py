"""RiverSwim: a chain against a current, in which the small reward is near and the large one far.

Strehl and Littman 2008, "An analysis of model-based interval estimation for Markov decision
processes", figure 2: six positions from the left bank to the right one. Swimming left always
succeeds. Swimming right moves one position on with probability 0.3, leaves the swimmer where it is
with 0.6 and lets it be carried back with 0.1; at the left bank it succeeds with 0.3, at the right
bank it stays there with 0.3. Swimming left at the left bank pays 5, staying at the right bank by
swimming right pays 10,000, all else nothing. Episodes start at position 1 or 2. The task never
ends; the paper learns 5,000 steps of it with discount 0.95.

Osband, Russo, Van Roy 2013 ("(More) efficient reinforcement learning via posterior sampling") have
``RiverSwim(forward=0.35, back=0.05, leave_bank=0.6, stay_at_end=0.6, left_reward=0.005,
right_reward=1, start=(0,))``, paying the large reward in the last state whatever happens there.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from curricle.arrays import frozen
from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import Domain, check_sizes, tables_of
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import PROBABILITY_TOLERANCE, check_numbers
from curricle.tasks.spaces import Component, Space, whole

LARGEST_SIZE = 1_000_000
"""Positions of a river at most."""


@dataclass(frozen=True)
class RiverSwim(Domain):
    """A swimmer in a river: left with the current is sure, right against it is not.

    Parameters
    ----------
    size : int
        Positions from bank to bank, 2 to 1,000,000.
    forward, back : float
        Probabilities that swimming right moves one position to the right, and that the current
        carries the swimmer one back; else it stays.
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

    Raises
    ------
    TaskError
        When a size, a probability, a reward or a start is invalid.

    Examples
    --------
    >>> river = RiverSwim()
    >>> river.states, river.actions.components[0].labels
    (Space(6 points: position[6]), ('left', 'right'))
    >>> river.crop(positions=(3, 6)).left_reward  # the left bank is not part of it
    0.0
    """

    size: int = 6
    forward: float = 0.3
    back: float = 0.1
    leave_bank: float = 0.3
    stay_at_end: float = 0.3
    left_reward: float = 5.0
    right_reward: float = 10_000.0
    start: Any = (1, 2)
    origin: int = 0
    discount: float = 0.95
    time_limit: int | None = 200

    def __post_init__(self) -> None:
        check_sizes(self, size=(2, LARGEST_SIZE))
        chances = ("forward", "back", "leave_bank", "stay_at_end")
        check_numbers(self, ("left_reward", "right_reward"), chances)
        if self.forward + self.back > 1 + PROBABILITY_TOLERANCE:
            raise TaskError(
                f"forward and back must be at most 1 together: got {self.forward:g} and "
                f"{self.back:g}"
            )
        origin = whole_number("origin", self.origin, 1 - LARGEST_SIZE, TaskError)
        object.__setattr__(self, "origin", int(number("origin", origin, TaskError, high=2**31)))
        check_horizon(self)
        object.__setattr__(self, "start", self._read_start())

    # -- variants ------------------------------------------------------------------------------

    def crop(self, *, positions: tuple[int, int], start: Any = "uniform") -> Self:
        """Return the part of the river in a half-open range of its positions.

        Its first and last positions are banks; the reward of a bank that is not part of it is 0.

        Raises
        ------
        TaskError
            When the part exceeds the river or has fewer than 2 positions.
        """
        given = whole(positions, "a crop's positions")
        end = self.origin + self.size
        if given.shape != (2,) or not self.origin <= given[0] < given[1] - 1 < end:
            raise TaskError(
                f"a crop must have 2 or more of the river's positions {self.origin}..{end}: got "
                f"{positions!r}"
            )
        first, last = int(given[0]), int(given[1])
        return replace(
            self,
            size=last - first,
            origin=first,
            left_reward=self.left_reward if first == self.origin else 0.0,
            right_reward=self.right_reward if last == end else 0.0,
            start=start,
        )

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def states(self) -> Space:
        """The swimmer's position."""
        return Space([Component("position", self.size, low=self.origin)])

    @cached_property
    def actions(self) -> Space:
        """Swimming left and right."""
        return Space([Component("move", 2, labels=("left", "right"))])

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

    # -- tables --------------------------------------------------------------------------------

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
        return tables_of(
            self,
            np.concatenate([left, right]),
            np.tile(to, (2, 1)),
            reward,
            terminal=np.zeros(n, bool),
            starting=here if self.start == "uniform" else np.array(self.start) - self.origin,
            outcome_row=np.stack([here, n + here], axis=1),
        )

    def _read_start(self) -> Any:
        """Return the start as ``"uniform"`` or sorted positions."""
        if isinstance(self.start, str) and self.start == "uniform":
            return self.start
        listed = list(self.start) if isinstance(self.start, Iterable) else []
        given = whole([] if isinstance(self.start, str) else listed, "the positions of start")
        end = self.origin + self.size
        inside = (given >= self.origin) & (given < end)
        if given.ndim != 1 or not given.size or not inside.all():
            raise TaskError(
                f"start must be 'uniform' or positions in {self.origin}..{end - 1}: got "
                f"{self.start!r}"
            )
        return tuple(sorted(set(given.tolist())))
