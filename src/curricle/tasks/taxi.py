"""Taxi: fetch a passenger from one stand and take them to another (Dietterich 2000).

Gymnasium's ``Taxi-v4``, and smaller towns with fewer stands. The taxi drives in a square town with
walls between some columns. Picking up and dropping off where it makes no sense costs 10, every
other step 1, and dropping off at the destination ends the episode with 20. In the rain a move that
is not blocked goes where it was meant to with probability `success_rate`, and to its left or right
with half of the rest each, where walls may stop it. Gymnasium's fickle passengers, who change their
mind once, are left out: its own table does not have them either.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import instance
from curricle.errors import TaskError
from curricle.tasks.domain import cell_space, check_sizes, landing_or_staying, tables_of
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import Component, Space

STANDS = ("red", "green", "yellow", "blue")
MOVES = {"south": (1, 0), "north": (-1, 0), "east": (0, 1), "west": (0, -1)}
SIDES = {
    "south": ("east", "west"),
    "north": ("west", "east"),
    "east": ("north", "south"),
    "west": ("south", "north"),
}
"""What is to the left and to the right of who moves that way."""
LARGEST_TOWN = 50


@dataclass(frozen=True)
class Taxi(Frozen):
    """A taxi in a town of `size` x `size` cells; Gymnasium's has 5 x 5 and 4 stands.

    Parameters
    ----------
    size : int
        Cells per side, 3 to 50. The stands are in the corners, the blue one a column from its
        corner. Walls stand as in Gymnasium's town, in proportion.
    stands : int
        2 to 4: the first of red, green, yellow and blue.
    walls : bool
        Whether there are walls.
    rainy : bool
        Whether moves may go to either side.
    success_rate : float
        Probability that a move in the rain goes where it was meant to.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        When a value is out of range.

    Examples
    --------
    >>> Taxi().states
    Space(500 points: row[5] x column[5] x passenger[5] x destination[4])
    >>> Taxi(size=3, stands=2).states.size
    54
    """

    size: int = 5
    stands: int = 4
    walls: bool = True
    rainy: bool = False
    success_rate: float = 0.8
    discount: float = 0.99
    time_limit: int | None = 200

    def __post_init__(self) -> None:
        check_sizes(self, size=(3, LARGEST_TOWN), stands=(2, len(STANDS)))
        for name in ("walls", "rainy"):
            instance(name, getattr(self, name), bool, TaskError)
        check_numbers(self, (), ("success_rate",))
        check_horizon(self)

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def states(self) -> Space:
        """The taxi's cell, where the passenger is, and the destination."""
        names = STANDS[: self.stands]
        return Space(
            [
                Component("row", self.size),
                Component("column", self.size),
                Component("passenger", self.stands + 1, labels=(*names, "taxi")),
                Component("destination", self.stands, labels=names),
            ]
        )

    @cached_property
    def actions(self) -> Space:
        """Four moves, picking up and dropping off, in Gymnasium's order."""
        return Space([Component("move", 6, labels=(*MOVES, "pick up", "drop off"))])

    @property
    def stand_cells(self) -> IntArray:
        """The cell of each stand, row * size + column, (stands,) int64."""
        last = self.size - 1
        cells = [(0, 0), (0, last), (last, 0), (last, last - 1)]
        return np.array([row * self.size + column for row, column in cells[: self.stands]])

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        values = self.states.decode()
        cells = frozen(np.stack([values["row"], values["column"]], axis=1))
        return GridLayout(cells, ("row", "column"), (self.size, self.size))

    @property
    def wall_cells(self) -> BoolArray:
        """Whether a wall stands to the east of each cell, (size, size) bool."""
        n, walls = self.size, np.zeros((self.size, self.size), dtype=bool)
        if self.walls:
            long = (n - 1) // 2
            walls[:long, n // 2 - 1] = True
            walls[n - long :, [0, n - 3]] = True
        return walls

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def landing(self) -> IntArray:
        """The cell that each move leads to from each cell, (size^2, 4) int64."""
        here = np.arange(self.size**2)[:, None]
        to = landing_or_staying(cell_space(self.size, self.size), MOVES)
        sideways = np.array([right != 0 for _, right in MOVES.values()])
        # A wall stands to the east of the more western of the two cells.
        blocked = sideways & self.wall_cells.ravel()[np.minimum(here, to)]
        return frozen(np.where(blocked, here, to))

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The town as tables, a row for each pair; in the rain O = ahead, to the left, right."""
        values, stands = self.states.decode(), self.stand_cells
        cell = values["row"] * self.size + values["column"]
        passenger, destination = values["passenger"], values["destination"]
        moved = self._state(
            self._driven[cell], passenger[:, None, None], destination[:, None, None]
        )
        picked, picked_reward = self._picked_up(cell, passenger, destination)
        dropped, dropped_reward = self._dropped_off(cell, passenger, destination)
        used = np.broadcast_to(
            np.stack([picked, dropped], axis=1)[:, :, None], (len(cell), 2, moved.shape[2])
        )
        reward = [np.full(len(cell), -1.0)] * 4 + [picked_reward, dropped_reward]
        begins = (passenger < self.stands) & (passenger != destination)
        return tables_of(
            self,
            self._probability,
            np.concatenate([moved, used], axis=1),
            np.stack(reward, axis=1)[:, :, None],
            terminal=(passenger == destination) & (cell == stands[destination]),
            starting=np.flatnonzero(begins),
        )

    def _picked_up(
        self, cell: IntArray, passenger: IntArray, destination: IntArray
    ) -> tuple[IntArray, FloatArray]:
        """Return the state after picking up, and the reward, (S,) each."""
        there = self.stand_cells[np.minimum(passenger, self.stands - 1)] == cell
        works = (passenger < self.stands) & there
        taken = np.where(works, self.stands, passenger)
        return self._state(cell, taken, destination), np.where(works, -1.0, -10.0)

    def _dropped_off(
        self, cell: IntArray, passenger: IntArray, destination: IntArray
    ) -> tuple[IntArray, FloatArray]:
        """Return the state after dropping off, and the reward, (S,) each."""
        at = cell[:, None] == self.stand_cells
        works = (passenger == self.stands) & at.any(axis=1)
        left = np.where(works, at.argmax(axis=1), passenger)
        arrived = works & (left == destination)
        reward = np.where(arrived, 20.0, np.where(works, -1.0, -10.0))
        return self._state(cell, left, destination), reward

    def _state(self, cell: IntArray, passenger: IntArray, destination: IntArray) -> IntArray:
        return (cell * (self.stands + 1) + passenger) * self.stands + destination

    @property
    def _driven(self) -> IntArray:
        """The cells that a move may lead to, (size^2, 4, O); all the same where it is blocked."""
        if not self.rainy:
            return self.landing[:, :, None]
        names, here = list(MOVES), np.arange(self.size**2)[:, None]
        moved = self.landing != here
        sides = [
            self.landing[:, [names.index(SIDES[name][side]) for name in names]] for side in (0, 1)
        ]
        return np.stack([self.landing, *(np.where(moved, one, here) for one in sides)], axis=2)

    @property
    def _probability(self) -> FloatArray:
        """The chances of the outcomes of each action, (A, O)."""
        if not self.rainy:
            return np.ones((6, 1))
        sides = (1 - self.success_rate) / 2
        drives = np.tile([self.success_rate, sides, sides], (4, 1))
        return np.concatenate([drives, np.tile([1.0, 0.0, 0.0], (2, 1))])
