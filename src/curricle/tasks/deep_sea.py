"""DeepSea: a dive of N steps, of whose 2^N ways only one finds the treasure.

Osband et al. 2020, "Behaviour suite for reinforcement learning" (bsuite, ``deep_sea.py``; first in
Osband et al. 2019, "Deep exploration via randomized value functions"). The sea is N rows deep and N
columns wide. A dive starts at the top left and goes down one row a step, one column to the left or
to the right, but not past the sides; it ends on the ground after N steps. Moving right costs
move_cost / N. Moving right in the last column pays the treasure: only diving right N times gets
there.

In the stochastic version moving right fails with probability 1/N, and the cost and the treasure are
as if it had not; rewards in the first and last column of the last row have noise added, N(0, 1) in
bsuite. Here ``slip`` is that probability, and ``noise`` is added or subtracted with probability 1/2
each, which has the same mean and variance as N(0, noise^2) and keeps tables finite and exact.

bsuite draws for each cell which of the actions 0 and 1 is right. That is ``mapping_seed``; without
it, as with ``randomize_actions=False`` there, 1 is right everywhere and the moves have names.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from curricle.arrays import BoolArray, IntArray, frozen
from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import Domain, cell_space, check_sizes, read_start, tables_of
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import Component, Space

LARGEST_SIZE = 1000
"""Rows of a sea at most: half a million states."""
LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class DeepSea(Domain):
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
        Added to rewards in the first and last column of the last row, or subtracted, with
        probability 1/2 each; 1 in bsuite's stochastic version.
    mapping_seed : int, optional
        Of bsuite's random choice, cell by cell, of which action is right.
    start : "surface", "uniform" or cells
        At the top left, in any cell of the sea that a dive can reach, or in one of the given
        ``(row, column)`` cells; all are equally likely.
    origin : int
        The top row and the leftmost column. The bottom of a sea keeps the coordinates of the whole.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        When a size, a probability, a reward or a start is invalid.

    Examples
    --------
    >>> sea = DeepSea(size=3, discount=1.0)
    >>> sea.states.size  # 1 + 2 + 3 cells and 3 on the ground
    9
    >>> from curricle import solve
    >>> float(solve(sea).values[0].round(6))
    0.99
    """

    size: int = 10
    move_cost: float = 0.01
    treasure: float = 1.0
    slip: float = 0.0
    noise: float = 0.0
    mapping_seed: int | None = None
    start: Any = "surface"
    origin: int = 0
    discount: float = 0.99
    time_limit: int | None = None

    def __post_init__(self) -> None:
        check_sizes(self, size=(1, LARGEST_SIZE), origin=(0, LARGEST_SIZE))
        check_numbers(self, ("move_cost", "treasure", "noise"), ("slip",))
        if self.mapping_seed is not None:
            check_sizes(self, mapping_seed=(0, LARGEST_SEED))
        check_horizon(self)
        read_start(self, ("surface", "uniform"), "[(2, 1)]")
        if not isinstance(self.start, str):
            top, end = self.origin, self.origin + self.size
            for row, column in self.start:
                if not top <= column <= row < end:
                    raise TaskError(
                        f"a dive starts in a row {top}..{end - 1}, in a column {top}..row: got "
                        f"({row}, {column})"
                    )

    # -- variants ------------------------------------------------------------------------------

    def bottom(self, rows: int, *, start: Any = "uniform") -> Self:
        """Return the lowest rows of the sea, with as many of the last columns; moves cost as there.

        Examples
        --------
        >>> DeepSea(size=10).bottom(3).states.label(0)
        'row=7 column=7'
        """
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

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def states(self) -> Space:
        """The cells that a dive from the top left can reach, and those of the ground below."""
        n = self.size
        row, column = np.indices((n + 1, n)).reshape(2, -1)
        reached = (column <= row) | (row == n)
        cells = np.stack([row, column], axis=1)[reached] + self.origin
        return cell_space(n + 1, n, (self.origin, self.origin), cells)

    @cached_property
    def actions(self) -> Space:
        """Left and right; without names where the cells differ in which is which."""
        if self.mapping_seed is not None:
            return Space([Component("action", 2)])
        return Space([Component("move", 2, labels=("left", "right"))])

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures; the treasure is in the last row of water."""
        last = self.origin + self.size - 1
        return GridLayout(
            cells=self.states.points,
            components=("row", "column"),
            shape=(self.size + 1, self.size),
            origin=(self.origin, self.origin),
            objects=(("treasure", last, last, False),),
        )

    @cached_property
    def right(self) -> IntArray:
        """The action that moves right in each state, (S,) int64; 1 on the ground."""
        row, column = self._cells
        action, water = np.ones(len(row), dtype=np.int64), row < self.size
        if self.mapping_seed is not None:
            whole_sea = self.origin + self.size
            # bsuite's own generator, so that equal seeds give equal tasks.
            drawn = np.random.RandomState(self.mapping_seed).binomial(1, 0.5, [whole_sea] * 2)
            part = drawn[self.origin :, self.origin :]
            action[water] = part[row[water], column[water]]
        return frozen(action)

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The sea as tables: a row for each pair, its outcomes (moved, failed) x (plus, minus)."""
        (row, column), n = self._cells, self.size
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
        found = moves_right & (column == n - 1)[:, None]
        paid = self.treasure * found - self.move_cost / n * moves_right
        noisy = (row == n - 1) & np.isin(column, (0, n - 1))
        noise = np.where(noisy, self.noise, 0.0)[:, None]
        chance, next_state, reward = [1 - fails, fails], [moved, fallen], [paid, paid]
        if self.noise:
            chance = [one / 2 for one in chance for _ in range(2)]
            next_state = [one for one in next_state for _ in range(2)]
            reward = [paid + noise, paid - noise] * 2
        kept = slice(None) if self.slip else slice(len(chance) // 2)
        return tables_of(
            self,
            np.stack(chance[kept], axis=-1),
            np.stack(next_state[kept], axis=-1),
            np.stack(reward[kept], axis=-1),
            terminal=ended,
            starting=self._starting(ended),
        )

    @property
    def _cells(self) -> tuple[IntArray, IntArray]:
        """Row and column of each state, counted from the top left of this sea."""
        row, column = (self.states.points - self.origin).T
        return row, column

    def _starting(self, ended: BoolArray) -> IntArray:
        """Return the states that episodes start in."""
        if self.start == "surface":
            return np.array([0])
        if self.start == "uniform":
            return np.flatnonzero(~ended)
        row, column = np.array(self.start).T
        return self.states.encode(row=row, column=column)
