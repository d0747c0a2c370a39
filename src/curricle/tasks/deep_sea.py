"""DeepSea: a dive of N steps, of whose 2^N ways only one finds the treasure.

Osband et al. 2020, "Behaviour suite for reinforcement learning" (bsuite, ``deep_sea.py``; first in
Osband et al. 2019, "Deep exploration via randomized value functions"). The sea is N rows deep and N
columns wide. A dive starts at the top left and goes down one row a step, one column to the left or
to the right, but not past the sides; it ends on the ground after N steps. Only diving right N times
pays the treasure. A move that slips costs and pays as if it had not.

bsuite's noise is N(0, 1). Here ``noise`` is added or subtracted with probability 1/2 each, which
has the same mean and variance and keeps tables finite and exact. Without ``mapping_seed``, as with
``randomize_actions=False`` there, 1 is right everywhere and the moves have names.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import IntArray, frozen
from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import Cell, Discount, GridDomain, TimeLimit, family_of
from curricle.tasks.family import FamilyMember, Parameter, Rule
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Component, Decoded, Space

LARGEST_SIZE = 1000  # rows of a sea at most: half a million states
LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class DeepSea(GridDomain):
    """A dive of `size` steps to the left or right; only always right finds the treasure.

    Parameters
    ----------
    size : int
        N, the rows and columns of the sea, 1 to 1000.
    move_cost : float
        Of diving right N times; a single move to the right costs ``move_cost / N``.
    treasure : float
        Reward of a move to the right in the last column.
    slip : float
        Probability that a move to the right goes straight down; 1/N in bsuite's stochastic version.
    noise : float
        Added to or taken from rewards in the last row's first and last column; 1 in that version.
    mapping_seed : int, optional
        Of bsuite's random choice, cell by cell, of which action is right.
    start : "surface", "uniform" or cells
        At the top left, in any cell that a dive can reach, or in one of these ``(row, column)``.
    origin : int
        The top row and the leftmost column. The bottom of a sea keeps the coordinates of the whole.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> sea = DeepSea(size=3, discount=1.0)
    >>> sea.states.size  # 1 + 2 + 3 cells and 3 on the ground
    9
    >>> from curricle import solve
    >>> float(solve(sea).values[0].round(6))
    0.99
    """

    size: Annotated[int, Rule(1, LARGEST_SIZE, "larger")] = 10
    move_cost: float = 0.01
    treasure: float = 1.0
    slip: Annotated[float, Rule(0, 1, "larger")] = 0.0
    noise: float = 0.0
    mapping_seed: Annotated[int | None, Rule(0, LARGEST_SEED)] = None
    start: Annotated[Any, Rule(values=("surface", "uniform"))] = "surface"
    origin: Annotated[int, Rule(0, LARGEST_SIZE, varies=False)] = 0
    discount: Discount = 0.99
    time_limit: TimeLimit = None

    ACTIONS = ("left", "right")
    OBJECTS: ClassVar = {"T": "treasure"}  # in the last row of water; it ends no episode
    ENDS = "_"
    LISTED = True

    def bottom(self, rows: int, *, start: Any = "uniform") -> Self:
        """Return the lowest rows, with as many of the last columns; moves cost as in the whole."""
        least = whole_number("the rows of a part of a sea", rows, 1, TaskError)
        number("the rows of a part of a sea", least, TaskError, 1, self.size)
        cut = self.size - least
        return replace(
            self,
            size=least,
            origin=self.origin + cut,
            move_cost=self.move_cost * least / self.size,
            start=start,
        )

    @cached_property
    def _grid(self) -> npt.NDArray[np.str_]:
        """The cells that a dive from the top left can reach, and those of the ground below."""
        n = self.size
        grid = np.where(np.tri(n + 1, n, dtype=bool), ".", "#")
        grid[n - 1, n - 1], grid[n] = "T", "_"
        return grid

    @property
    def _corner(self) -> Cell:
        return self.origin, self.origin

    @cached_property
    def actions(self) -> Space:
        """Left and right; without names where the cells differ in which is which."""
        if self.mapping_seed is not None:
            return Space([Component("action", 2)])
        return super().actions

    @cached_property
    def right(self) -> IntArray:
        """The action that moves right in each state, (S,) int64; 1 on the ground."""
        row, column = self._depths
        action, water = np.ones(len(row), dtype=np.int64), row < self.size
        if self.mapping_seed is not None:
            whole_sea = self.origin + self.size
            # bsuite's own generator, so that equal seeds give equal tasks.
            drawn = np.random.RandomState(self.mapping_seed).binomial(1, 0.5, [whole_sea] * 2)
            part = drawn[self.origin :, self.origin :]
            action[water] = part[row[water], column[water]]
        return frozen(action)

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The sea as tables: a row for each pair, its outcomes (moved, failed) x (plus, minus)."""
        (row, column), n = self._depths, self.size
        ended = row == n
        moves_right = np.arange(2) == self.right[:, None]
        step = np.where(moves_right, 1, -1)
        to = np.clip(column[:, None] + step, 0, n - 1)
        below = np.minimum(row + 1, n)[:, None] + self.origin
        moved, fallen = (
            self.states.encode(row=below, column=np.broadcast_to(c + self.origin, to.shape))
            for c in (to, column[:, None])
        )
        fails = np.where(moves_right, self.slip, 0.0)
        finds = moves_right & (column == n - 1)[:, None]
        paid = self.treasure * finds - self.move_cost / n * moves_right
        noisy = (row == n - 1) & np.isin(column, (0, n - 1))
        noise = np.where(noisy, self.noise, 0.0)[:, None]
        chance, next_state, reward = [1 - fails, fails], [moved, fallen], [paid, paid]
        if self.noise:
            chance = [share / 2 for share in chance for _ in range(2)]
            next_state = [after for after in next_state for _ in range(2)]
            reward = [paid + noise, paid - noise] * 2
        kept = slice(None) if self.slip else slice(len(chance) // 2)
        return self._tables(
            np.stack(chance[kept], axis=-1),
            np.stack(next_state[kept], axis=-1),
            np.stack(reward[kept], axis=-1),
            terminal=ended,
            starting=self._start_states(),
        )

    @property
    def _depths(self) -> tuple[IntArray, IntArray]:
        """Row and column of each state, counted from the top left of this sea."""
        row, column = (self.cells - self.origin).T
        return row, column


def _from_the_ground(target: FamilyMember, source: FamilyMember) -> Any:
    """Return how a sea reads another: counted from the ground and the right, right as right."""
    down = target["size"] - source["size"]
    whole, other = target.task, source.task

    def function(states: Decoded, actions: Decoded) -> tuple[Decoded, Decoded]:
        (action,) = actions.values()
        read = {name: value - down for name, value in states.items()}
        state, known = whole.states.encode(**states), other.states.encode(**read)
        right = other.right[np.maximum(known, 0)]
        is_right = action == whole.right[state]
        return read, {other.actions.names[0]: np.where(is_right, right, 1 - right)}

    return function


deep_sea_family = family_of(
    DeepSea, None, Parameter("noise", low=0, harder="larger"), mapping=_from_the_ground
)
"""Deep seas (:class:`DeepSea`); members map cell by cell, counted from the ground and the right."""
