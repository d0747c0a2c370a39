"""Taxi: fetch a passenger from one stand and take them to another (Dietterich 2000).

Gymnasium's ``Taxi-v4``, and smaller towns with fewer stands. Picking up and dropping off where it
makes no sense costs 10, every other step 1, and dropping off at the destination ends the episode
with 20. In the rain a move that is not blocked may go to its left or right, where walls may stop
it. Gymnasium's own table has no fickle passengers either, who change their mind once.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray, frozen
from curricle.tasks.domain import Discount, Domain, TimeLimit, cell_space, family_of, landing
from curricle.tasks.family import ComponentsByName, Rule
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Component, Space

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
class Taxi(Domain):
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

    Examples
    --------
    >>> Taxi().states
    Space(500 points: row[5] x column[5] x passenger[5] x destination[4])
    >>> Taxi(size=3, stands=2).states.size
    54
    """

    size: Annotated[int, Rule(3, LARGEST_TOWN, "larger")] = 5
    stands: Annotated[int, Rule(2, len(STANDS), "larger")] = 4
    walls: Annotated[bool, Rule(harder="larger")] = True
    rainy: Annotated[bool, Rule(harder="larger")] = False
    success_rate: Annotated[float, Rule(0, 1, "smaller")] = 0.8
    discount: Discount = 0.99
    time_limit: TimeLimit = 200

    ACTIONS = (*MOVES, "pick up", "drop off")  # in Gymnasium's order

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

    @cached_property
    def landing(self) -> IntArray:
        """The cell that each move leads to from each cell, (size^2, 4) int64."""
        here = np.arange(self.size**2)[:, None]
        to = landing(cell_space(self.size, self.size), MOVES)
        to = np.where(to == MISSING, here, to)
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
        waits, here = passenger < self.stands, cell[:, None] == stands
        picks = waits & (stands[np.minimum(passenger, self.stands - 1)] == cell)
        drops = ~waits & here.any(axis=1)
        left = np.where(drops, here.argmax(axis=1), passenger)
        arrives = drops & (left == destination)
        driven, chances = self._driving
        others = passenger[:, None, None], destination[:, None, None]
        moved = self._state(driven[cell], *others)
        picked = self._state(cell, np.where(picks, self.stands, passenger), destination)
        used = np.stack([picked, self._state(cell, left, destination)], axis=1)[:, :, None]
        reward = np.full((len(cell), 6, 1), -1.0)
        reward[~picks, 4] = reward[~drops, 5] = -10.0
        reward[arrives, 5] = 20.0
        return self._tables(
            chances,
            np.concatenate([moved, np.repeat(used, moved.shape[2], axis=2)], axis=1),
            reward,
            terminal=(passenger == destination) & (cell == stands[destination]),
            starting=np.flatnonzero(waits & (passenger != destination)),
        )

    def _state(self, cell: IntArray, passenger: IntArray, destination: IntArray) -> IntArray:
        return (cell * (self.stands + 1) + passenger) * self.stands + destination

    @property
    def _driving(self) -> tuple[IntArray, FloatArray]:
        """The cells that a move may lead to, (size^2, 4, O), and the chances of actions, (6, O)."""
        if not self.rainy:
            return self.landing[:, :, None], np.ones((6, 1))
        names, here = list(MOVES), np.arange(self.size**2)[:, None]
        outcomes, moved = [self.landing], self.landing != here  # where it is blocked all stay
        for side in (0, 1):
            turned = self.landing[:, [names.index(SIDES[name][side]) for name in names]]
            outcomes.append(np.where(moved, turned, here))
        sides = (1 - self.success_rate) / 2
        chances = [[self.success_rate, sides, sides]] * 4 + [[1.0, 0.0, 0.0]] * 2
        return np.stack(outcomes, axis=2), np.array(chances)


taxi_family = family_of(Taxi, mapping=ComponentsByName("scale"))
"""Taxis (:class:`Taxi`); members map by name, rows and columns in proportion."""
