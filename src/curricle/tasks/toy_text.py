"""Gymnasium's toy texts (Towers et al. 2024), of any size: FrozenLake, CliffWalking and Taxi."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from gymnasium.envs.toy_text.frozen_lake import MAPS, generate_random_map

from curricle.arrays import BoolArray, FloatArray, IntArray, frozen
from curricle.tasks.domain import (
    Discount,
    Domain,
    GridDomain,
    MapDomain,
    MapStart,
    TimeLimit,
    family_of,
)
from curricle.tasks.family import ComponentsByName, Rule
from curricle.tasks.grid import Cell, Grid, GridLayout, cell_space, landing
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Component, Space


def _slipping(to: IntArray, *, slippery: bool) -> IntArray:
    """Return where moves may land, (S, A, O): by the move before, the move, the move after."""
    turns = (1, 0, -1) if slippery else (0,)
    return np.stack([np.roll(to, turn, axis=1) for turn in turns], axis=2)


# -- frozen lakes ----------------------------------------------------------------------------------

LARGEST_LAKE = 100
LEAST_FROZEN = 0.6  # large lakes with a way to the goal are too rare below
LAKE_MOVES = {"west": (0, -1), "south": (1, 0), "east": (0, 1), "north": (-1, 0)}
"""In Gymnasium's order."""


@dataclass(frozen=True)
class FrozenLake(MapDomain):
    """A lake of ice with holes, drawn as text; episodes end at the goal and in holes.

    Gymnasium's ``FrozenLake-v1`` (``toy_text/frozen_lake.py``). A move off the map stays where it
    is.

    Parameters
    ----------
    map : str or sequence of str
        The name of one of Gymnasium's maps, or one line a row, north first: ``S`` start, ``F``
        frozen, ``H`` hole and ``G`` goal.
    slippery : bool
        Whether moves may go to either side.
    success_rate : float
        Probability that a move on slippery ice goes where it was meant to.
    goal_reward, hole_reward, step_reward : float
        Rewards of entering the goal, a hole, any other cell.
    start : "map", "uniform" or cells
        At an ``S``, on any cell that does not end the episode, or in one of these cells.
    origin : (int, int)
        Row and column of the top-left cell. A part keeps the coordinates of the whole lake.
    discount, time_limit
        As in :class:`FiniteMDP`; Gymnasium's lakes have a limit of 100 steps, and 200 if 8x8.

    Examples
    --------
    >>> lake = FrozenLake("8x8", slippery=False, time_limit=200)
    >>> part = lake.crop(rows=(4, 8), columns=(4, 8))
    >>> part.map, part.states.label(0)
    (('FFFF', 'FFHF', 'HFHF', 'FFFG'), 'row=4 column=4')
    """

    map: Any = "4x4"
    slippery: Annotated[bool, Rule(harder="larger")] = True
    success_rate: Annotated[float, Rule(0, 1, "smaller")] = 1 / 3
    goal_reward: float = 1.0
    hole_reward: float = 0.0
    step_reward: float = 0.0
    start: MapStart = "map"
    origin: Cell = (0, 0)
    discount: Discount = 0.99
    time_limit: TimeLimit = 100

    ACTIONS = tuple(LAKE_MOVES)
    CHARACTERS = "SFHG"
    OBJECTS: ClassVar = {"G": "goal", "H": "pit"}
    ENDS = "GH"

    def _check(self) -> None:
        drawn = MAPS.get(self.map, self.map) if isinstance(self.map, str) else self.map
        self._read_map(drawn, "G", "a lake needs a goal G")
        super()._check()

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The lake as tables: on slippery ice O = to the one side, ahead, to the other side."""
        entered = np.where(self.grid.holds("G"), self.goal_reward, self.step_reward)
        entered = np.where(self.grid.holds("H"), self.hole_reward, entered)
        after = _slipping(self.grid.landing(LAKE_MOVES), slippery=self.slippery)
        sides = (1 - self.success_rate) / 2
        return self._tables(
            [sides, self.success_rate, sides] if self.slippery else [1.0], after, entered[after]
        )


def _part_of_lake(
    map: Literal["4x4", "8x8", "random"] = "4x4",
    part: Annotated[int | None, Rule(2, LARGEST_LAKE - 1, "larger")] = None,
    size: Annotated[int, Rule(2, LARGEST_LAKE, "larger")] = 8,
    frozen_share: Annotated[float, Rule(LEAST_FROZEN, 1, "smaller")] = 0.8,
    seed: Annotated[int, Rule(0)] = 0,
    **rules: Any,
) -> FrozenLake:
    """Return one of Gymnasium's lakes or random lakes, or the `part` of rows around the goal."""
    drawn = generate_random_map(size, frozen_share, seed) if map == "random" else map
    lake = FrozenLake(drawn, **rules)
    if part is None:
        return lake
    rows = len(lake.map) - part, len(lake.map)
    return lake.crop(rows=rows, columns=rows)


def _parts_of_maps(parameters: dict[str, Any]) -> str | None:
    """Return the mistake, a sentence, in the size of a map or of its part."""
    drawn = MAPS.get(parameters["map"])
    if drawn is not None and parameters["size"] != 8:
        return "size of frozen_lake is of random lakes: leave it out with other maps"
    rows = parameters["size"] if drawn is None else len(drawn)
    if parameters["part"] is not None and parameters["part"] >= rows:
        return f"part of frozen_lake must be less than the lake's {rows} rows"
    return None


frozen_lake_family = family_of(FrozenLake, _part_of_lake, constraint=_parts_of_maps)
"""Frozen lakes: a `map` of Gymnasium, or a random one, or its `part` around the goal.

`part` is its rows and columns, 2 or more; `size`, `frozen_share` and `seed` are of random lakes.
Members map cell by cell, by the lake's coordinates.
"""


# -- walks along a cliff ---------------------------------------------------------------------------

ROWS, COLUMNS = 4, 12  # of Gymnasium's cliff
LARGEST_SIDE = 1000


@dataclass(frozen=True)
class CliffWalking(GridDomain):
    """A walk along a cliff, from the bottom left to the goal at the bottom right.

    Gymnasium's ``CliffWalking-v1`` (Sutton & Barto 2018, example 6.6). A step into the cliff leads
    back to the start, and the episode goes on. The goal lies at (3, 11) in walks of every size.

    Parameters
    ----------
    rows, columns : int
        2 to 1000 and 3 to 1000.
    slippery : bool
        Whether a move goes to either side with probability 1/3 each.
    step_reward, cliff_reward : float
        Rewards of a step, and of a step into the cliff.
    start : "map", "uniform" or cells
        At the bottom left, in any cell but the cliff and the goal, or in one of these cells.
    discount, time_limit
        As in :class:`FiniteMDP`; Gymnasium's has no time limit.

    Examples
    --------
    >>> CliffWalking(columns=4).states.label(0)
    'row=0 column=8'
    """

    rows: Annotated[int, Rule(2, LARGEST_SIDE, "larger")] = ROWS
    columns: Annotated[int, Rule(3, LARGEST_SIDE, "larger")] = COLUMNS
    slippery: Annotated[bool, Rule(harder="larger")] = False
    step_reward: float = -1.0
    cliff_reward: float = -100.0
    start: MapStart = "map"
    discount: Discount = 0.99
    time_limit: TimeLimit = None

    OBJECTS: ClassVar = {"C": "pit", "G": "goal"}  # pits that end no episode
    ENDS = "G"

    @property
    def origin(self) -> Cell:
        """Row and column of the top-left cell."""
        return ROWS - self.rows, COLUMNS - self.columns

    @cached_property
    def grid(self) -> Grid:
        """The cells, and the cliff and the goal in the last row."""
        drawn = np.full((self.rows, self.columns), ".")
        drawn[-1] = ["S", *"C" * (self.columns - 2), "G"]
        return Grid(drawn, self.origin)

    @property
    def _standing(self) -> BoolArray:
        return ~self.grid.holds("CG")

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The walk as tables: on slippery ground O = to the one side, ahead, to the other side."""
        after = _slipping(self.grid.landing(), slippery=self.slippery)
        fallen = self.grid.holds("C")[after]
        return self._tables(
            1 / after.shape[2],
            np.where(fallen, self.grid.holds("S").argmax(), after),
            np.where(fallen, self.cliff_reward, self.step_reward),
        )


cliff_walking_family = family_of(CliffWalking, mapping=ComponentsByName("clip"))
"""Walks along a cliff (:class:`CliffWalking`).

Members map cell by cell, counted from the goal; cells farther off than the source has are read at
its edge.
"""


# -- taxis -----------------------------------------------------------------------------------------

STANDS = ("red", "green", "yellow", "blue")
TAXI_MOVES = {"south": (1, 0), "north": (-1, 0), "east": (0, 1), "west": (0, -1)}
TURNS = [[2, 3, 1, 0], [3, 2, 0, 1]]
"""The numbers of the moves to the left and to the right of each."""
LARGEST_TOWN = 50


@dataclass(frozen=True)
class Taxi(Domain):
    """A taxi fetches a passenger from one stand and takes them to another (Dietterich 2000).

    Gymnasium's ``Taxi-v4``, whose town has 5 x 5 cells and 4 stands; like its table, it has no
    fickle passengers, who change their destination once. A pick-up or drop-off that is not possible
    costs 10, every other step 1, and dropping off at the destination ends the episode with 20. In
    the rain a move that is not blocked may go to its left or right, where walls may stop it.

    Parameters
    ----------
    size : int
        Cells per side, 3 to 50. The stands are in the corners, the blue stand one column from its
        corner. Walls stand as in Gymnasium's town, in proportion.
    stands : int
        2 to 4: the first of red, green, yellow and blue.
    walls, rainy : bool
        Whether there are walls, and whether moves may go to either side.
    success_rate : float
        Probability that a move in the rain goes where it was meant to.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Examples
    --------
    >>> Taxi().states
    Space(500 points: row[5] x column[5] x passenger[5] x destination[4])
    """

    size: Annotated[int, Rule(3, LARGEST_TOWN, "larger")] = 5
    stands: Annotated[int, Rule(2, len(STANDS), "larger")] = 4
    walls: Annotated[bool, Rule(harder="larger")] = True
    rainy: Annotated[bool, Rule(harder="larger")] = False
    success_rate: Annotated[float, Rule(0, 1, "smaller")] = 0.8
    discount: Discount = 0.99
    time_limit: TimeLimit = 200

    ACTIONS = (*TAXI_MOVES, "pick up", "drop off")  # in Gymnasium's order

    @cached_property
    def states(self) -> Space:
        """The taxi's cell, where the passenger is, and the destination."""
        names, cells = STANDS[: self.stands], cell_space(self.size, self.size).components
        passenger = Component("passenger", self.stands + 1, labels=(*names, "taxi"))
        return Space([*cells, passenger, Component("destination", self.stands, labels=names)])

    @property
    def stand_cells(self) -> IntArray:
        """The cell of each stand, row * size + column, (stands,) int64."""
        n = self.size
        return np.array([0, n - 1, (n - 1) * n, n * n - 2])[: self.stands]

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        values = self.states.decode()
        cells = frozen(np.stack([values["row"], values["column"]], axis=1))
        stands = np.stack(np.divmod(self.stand_cells, self.size), axis=1)
        riding = (values["passenger"] == self.stands)[:, None]
        waiting = stands[np.minimum(values["passenger"], self.stands - 1)]
        # Not by their components' names, so that these are written too: figures hide each other.
        moving = {
            "Destination": stands[values["destination"]],
            "Passenger": np.where(riding, cells, waiting),
        }
        shape = self.size, self.size
        return GridLayout(cells, ("row", "column"), shape, markers=moving)

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
        cell = np.arange(self.size**2)[:, None]
        to = landing(cell_space(self.size, self.size), TAXI_MOVES)
        to = np.where(to == MISSING, cell, to)
        sideways = np.array([right != 0 for _, right in TAXI_MOVES.values()])
        # A wall stands to the east of the more western of the two cells.
        blocked = sideways & self.wall_cells.ravel()[np.minimum(cell, to)]
        return frozen(np.where(blocked, cell, to))

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The town as tables, a row for each pair; in the rain O = ahead, to the left, right."""
        row, column, passenger, destination = self.states.decode().values()
        cell, stands = row * self.size + column, self.stand_cells
        waits, here = passenger < self.stands, cell[:, None] == stands
        picks = waits & (stands[np.minimum(passenger, self.stands - 1)] == cell)
        drops = ~waits & here.any(axis=1)
        left = np.where(drops, here.argmax(axis=1), passenger)

        driven, chances = self.landing[:, :, None], np.ones((6, 1))
        if self.rainy:
            sides = (1 - self.success_rate) / 2
            chances = np.array([[self.success_rate, sides, sides]] * 4 + [[1.0, 0.0, 0.0]] * 2)
            still = driven == np.arange(self.size**2)[:, None, None]  # where it is blocked it stays
            turned = np.stack([self.landing[:, turn] for turn in TURNS], axis=2)
            driven = np.concatenate([driven, np.where(still, driven, turned)], axis=2)

        def state(cell: IntArray, passenger: IntArray, destination: IntArray) -> IntArray:
            return (cell * (self.stands + 1) + passenger) * self.stands + destination

        moved = state(driven[cell], passenger[:, None, None], destination[:, None, None])
        picked = state(cell, np.where(picks, self.stands, passenger), destination)
        used = np.stack([picked, state(cell, left, destination)], axis=1)[:, :, None]
        reward: FloatArray = np.full((len(cell), 6, 1), -1.0)
        reward[~picks, 4] = reward[~drops, 5] = -10.0
        reward[drops & (left == destination), 5] = 20.0
        return self._tables(
            chances,
            np.concatenate([moved, np.repeat(used, moved.shape[2], axis=2)], axis=1),
            reward,
            terminal=(passenger == destination) & (cell == stands[destination]),
            starting=np.flatnonzero(waits & (passenger != destination)),
        )


taxi_family = family_of(Taxi, mapping=ComponentsByName("scale"))
"""Taxis (:class:`Taxi`); members map by name, rows and columns in proportion."""
