"""Two tasks of the literature in which the large reward is far: DeepSea and RiverSwim."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from curricle.arrays import frozen
from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import Discount, Domain, GridDomain, TimeLimit, family_of
from curricle.tasks.family import FamilyMember, Rule
from curricle.tasks.grid import Grid, GridLayout
from curricle.tasks.mdp import PROBABILITY_TOLERANCE, FiniteMDP
from curricle.tasks.spaces import Component, Space, whole

# -- DeepSea: of the 2^N ways of a dive only one finds the treasure --------------------------------

LARGEST_SEA = 1000  # rows at most: half a million states


@dataclass(frozen=True)
class DeepSea(GridDomain):
    """A dive of `size` steps to the left or right; only always right finds the treasure.

    Osband et al. 2020, "Behaviour suite for reinforcement learning" (bsuite, ``deep_sea.py``; first
    in Osband et al. 2019, "Deep exploration via randomized value functions"). A dive starts at the
    top left and goes down one row a step, one column to the left or to the right, but not past the
    sides; it ends on the ground. A move that slips costs and pays as if it had not. Actions are the
    same everywhere, as with bsuite's ``randomize_actions=False``, and rewards have no noise.

    Parameters
    ----------
    size : int
        N, the rows and columns of the sea, 1 to 1000.
    move_cost, treasure : float
        A move to the right costs ``move_cost / N``, and in the last column pays the treasure.
    slip : float
        Probability that a move to the right goes straight down; 1/N in bsuite's stochastic version.
    start : "surface", "uniform" or cells
        At the top left, in any cell that a dive can reach, or in one of these ``(row, column)``.
    origin : int
        The top row and the leftmost column. The bottom of a sea keeps the coordinates of the whole.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> DeepSea(size=3).states.size  # 1 + 2 + 3 cells and 3 on the ground
    9
    """

    size: Annotated[int, Rule(1, LARGEST_SEA, "larger")] = 10
    move_cost: float = 0.01
    treasure: float = 1.0
    slip: Annotated[float, Rule(0, 1, "larger")] = 0.0
    start: Annotated[Any, Rule(values=("surface", "uniform"))] = "surface"
    origin: Annotated[int, Rule(0, LARGEST_SEA, varies=False)] = 0
    discount: Discount = 0.99
    time_limit: TimeLimit = None

    ACTIONS = ("left", "right")
    OBJECTS: ClassVar = {"T": "treasure"}  # in the last row of water; it ends no episode
    ENDS = "_"

    def bottom(self, rows: int, *, start: object = "uniform") -> Self:
        """Return the lowest rows, with as many of the last columns; moves cost as in the whole."""
        least = whole_number("the rows of a part of a sea", rows, 1, TaskError)
        number("the rows of a part of a sea", least, TaskError, 1, self.size)
        return replace(
            self,
            size=least,
            origin=self.origin + self.size - least,
            move_cost=self.move_cost * least / self.size,
            start=start,
        )

    @cached_property
    def grid(self) -> Grid:
        """The cells that a dive from the top left can reach, and the cells of the ground below."""
        n = self.size
        drawn = np.where(np.tri(n + 1, n, dtype=bool), ".", "#")
        drawn[n - 1, n - 1], drawn[n] = "T", "_"
        return Grid(drawn, (self.origin, self.origin), listed=True)

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The sea as tables: a row for each pair, O = moved and, where moves slip, failed."""
        row, column = (self.cells - self.origin).T[:, :, None]
        last, ways = self.size - 1, 2 if self.slip else 1
        moves_right = np.arange(2) == 1
        to = np.clip(column + np.where(moves_right, 1, -1), 0, last)
        to = np.stack([to, np.broadcast_to(column, to.shape)], axis=-1)[..., :ways]
        below = np.minimum(row + 1, self.size)[..., None]
        fails = np.where(moves_right, self.slip, 0.0)
        paid = self.treasure * (moves_right & (column == last))
        paid = paid - self.move_cost / self.size * moves_right
        return self._tables(
            np.stack([1 - fails, fails], axis=-1)[..., :ways],
            self.states.encode(row=below + self.origin, column=to + self.origin),
            np.stack([paid] * ways, axis=-1),
        )


def _from_the_ground(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a sea reads another: cells counted from the ground and the right."""
    down = target["size"] - source["size"]
    return lambda states, moves: ({name: value - down for name, value in states.items()}, moves)


deep_sea_family = family_of(DeepSea, mapping=_from_the_ground)
"""Deep seas (:class:`DeepSea`); members map cell by cell, counted from the ground and the right."""


# -- RiverSwim: a chain against a current, whose small reward is near ------------------------------

LARGEST_RIVER = 1_000_000  # positions at most
LARGEST_OF_FAMILY = 10_000


@dataclass(frozen=True)
class RiverSwim(Domain):
    """A swimmer in a river: left with the current is sure, right against it is not.

    Strehl and Littman 2008, "An analysis of model-based interval estimation for Markov decision
    processes", figure 2, has the defaults. The task never ends; the paper learns 5,000 steps of it.
    Osband, Russo, Van Roy 2013 ("(More) efficient reinforcement learning via posterior sampling")
    have ``RiverSwim(forward=0.35, back=0.05, leave_bank=0.6, stay_at_end=0.6, left_reward=0.005,
    right_reward=1, start=(0,))``, paying the large reward in the last state whatever happens there.

    Parameters
    ----------
    size : int
        Positions from bank to bank, 2 to 1,000,000.
    forward, back : float
        Probabilities that swimming right moves one position on, and one back.
    leave_bank, stay_at_end : float
        Probabilities that swimming right leaves the left bank, else the swimmer stays, and that it
        stays at the right bank, else it is carried back.
    left_reward, right_reward : float
        For swimming left at the left bank, and for staying at the right bank by swimming right.
    start : "uniform" or positions
        Where episodes start, equally likely; in the paper 1 and 2.
    origin : int
        The leftmost position. A crop keeps the positions of the whole river.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> RiverSwim().crop(positions=(3, 6)).left_reward  # the left bank is not part of it
    0.0
    """

    size: Annotated[int, Rule(2, LARGEST_RIVER, "larger")] = 6
    forward: Annotated[float, Rule(0, 1, "smaller")] = 0.3
    back: Annotated[float, Rule(0, 1, "larger")] = 0.1
    leave_bank: Annotated[float, Rule(0, 1, "smaller")] = 0.3
    stay_at_end: Annotated[float, Rule(0, 1, "smaller")] = 0.3
    left_reward: float = 5.0
    right_reward: float = 10_000.0
    start: Any = (1, 2)
    origin: Annotated[int, Rule(1 - LARGEST_RIVER, 2**31, varies=False)] = 0
    discount: Discount = 0.95
    time_limit: TimeLimit = 200

    ACTIONS = ("left", "right")

    def _check(self) -> None:
        if self.forward + self.back > 1 + PROBABILITY_TOLERANCE:
            raise TaskError(
                f"forward and back must be at most 1 together: got {self.forward:g} and "
                f"{self.back:g}"
            )
        if not (isinstance(self.start, str) and self.start == "uniform"):
            listed = isinstance(self.start, Iterable) and not isinstance(self.start, str)
            positions = whole([*self.start] if listed else [], "the positions of start")
            end = self.origin + self.size
            inside = (positions >= self.origin) & (positions < end)
            if positions.ndim != 1 or not positions.size or not inside.all():
                raise TaskError(
                    f"start must be 'uniform' or positions in {self.origin}..{end - 1}: got "
                    f"{self.start!r}"
                )
            object.__setattr__(self, "start", tuple(sorted(set(positions.tolist()))))

    def with_start(self, start: object) -> Self:
        """Return the same river with another `start`."""
        return replace(self, start=start)

    def crop(self, *, positions: tuple[int, int], start: object = "uniform") -> Self:
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
        cells = frozen(np.stack([np.zeros_like(columns), columns], axis=1))
        return GridLayout(cells, ("position",), (1, self.size), (0, self.origin))

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
