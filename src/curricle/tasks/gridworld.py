"""Grid worlds with fire, pits and treasure, drawn as text or at random (paper, the maze; F1-F3)."""

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import count, groupby
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np

from curricle.checks import instance, number, one_of
from curricle.errors import TaskError
from curricle.tasks.domain import Discount, MapDomain, MapStart, TimeLimit
from curricle.tasks.family import Rule, TaskFamily
from curricle.tasks.grid import Cell, landing
from curricle.tasks.kernel import STRIDE, splitmix64, stream_start, uniform
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.models import LARGEST_REWARD
from curricle.tasks.spaces import MISSING, Component, Space

OBJECTS = {"T": "treasure", "F": "fire", "P": "pit"}
DRAWN = {"start": "S", "wall": "#", "free": ".", **{name: drawn for drawn, name in OBJECTS.items()}}
"""The character of everything that a cell may be."""
LEGENDS = {"frozen_lake": {"F": "free", "H": "pit", "G": "treasure"}}
"""Legends with a name."""


@dataclass(frozen=True)
class Rewards:
    """The rewards of a step, by the object in the entered cell (return units).

    Parameters
    ----------
    step : float
        Of every step (with ``combine="worst"``, only of steps to which no other term applies).
    treasure, fire, pit, near_fire : float
        Of entering a cell with such an object; with fire north, east, south or west of it.
    bump : float
        Of a move that the edge of the grid or a wall prevents.

    Examples
    --------
    >>> Rewards(step=-5).pit
    -2500.0
    """

    step: float = -1.0
    treasure: float = 200.0
    fire: float = -500.0
    near_fire: float = -250.0
    pit: float = -2500.0
    bump: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(self):
            name = f"reward {f.name}"
            value = number(name, getattr(self, f.name), TaskError, -LARGEST_REWARD, LARGEST_REWARD)
            object.__setattr__(self, f.name, value)


@dataclass(frozen=True)
class GridWorld(MapDomain):
    """A maze drawn as a text map, in which the agent moves one cell north, east, south or west.

    A move off the grid or into a wall leaves the agent where it is. The reward depends on the cell
    entered; an agent that stays enters its cell again.

    Parameters
    ----------
    map : str or sequence of str
        One line a row, north first. ``S`` start, ``T`` treasure (at least one), ``F`` fire,
        ``P`` pit, ``#`` wall, ``.`` free.
    rewards : Rewards
    combine : {"sum", "worst"}
        Whether all terms that apply to a step add up, or only the lowest counts.
    ends : iterable of {"treasure", "pit", "fire"}
        Objects that end the episode when their cell is entered.
    start : "map", "uniform" or cells
        At an ``S``, at any cell that does not end the episode, or at one of these cells.
    representation : {"absolute", "relative"}
        The components of a state: the agent's ``row`` and ``column``, or the positions of objects
        relative to the agent (Svetlik et al. 2017; paper E4, F1).
    origin : (int, int)
        Row and column of the top-left cell. A crop keeps the coordinates of the whole map.
    discount, time_limit
        As in :class:`FiniteMDP`.
    legend : dict of str to str, or "frozen_lake", optional
        What further characters of the map are: start, treasure, fire, pit, wall or free; those of
        Gymnasium's FrozenLake by its name. The maze has its map in the characters above.

    Examples
    --------
    >>> GridWorld("SFH FFG".split(), legend="frozen_lake").map
    ('S.P', '..T')
    >>> maze = GridWorld(["S.P", "..T"])
    >>> maze.crop(rows=(0, 2), columns=(1, 3)).states.label(0)
    'row=0 column=1'
    """

    map: Any
    rewards: Rewards = Rewards()
    combine: Literal["sum", "worst"] = "sum"
    ends: Any = ("pit", "treasure")
    start: MapStart = "map"
    representation: Literal["absolute", "relative"] = "absolute"
    origin: Cell = (0, 0)
    discount: Discount = 0.99
    time_limit: TimeLimit = 200
    legend: Any = None

    CHARACTERS = "STFP#."
    OBJECTS: ClassVar = OBJECTS

    def _check(self) -> None:
        self._read_map(self.map, "T", "a map needs a treasure T", _characters(self.legend))
        object.__setattr__(self, "legend", None)  # equal mazes are equal however they were drawn
        instance("rewards", self.rewards, Rewards, TaskError)
        ends = (self.ends,) if isinstance(self.ends, str) else self.ends
        if not isinstance(ends, Iterable):
            raise TaskError(f"ends must be names of objects: got {ends!r}")
        ends = tuple(ends)
        for name in ends:
            one_of("each of ends", name, OBJECTS.values(), TaskError)
        object.__setattr__(self, "ends", tuple(sorted(set(ends))))
        super()._check()

    @property
    def _ending(self) -> str:
        return "".join(character for character, name in OBJECTS.items() if name in self.ends)

    @cached_property
    def states(self) -> Space:
        """One state for each cell that is not a wall."""
        if self.representation == "absolute":
            return self.grid.space
        height, width = self.grid.drawn.shape
        axes, points, counts = [], [], Counter[str]()
        for name, row, column in self.objects:
            counts[name] += 1
            label = f"{name}_{counts[name]}"
            axes.append(Component(f"{label}_row", 2 * height - 1, low=1 - height))
            axes.append(Component(f"{label}_column", 2 * width - 1, low=1 - width))
            points += [row - self.cells[:, 0], column - self.cells[:, 1]]
        return Space(axes, np.stack(points, axis=1))

    def state(self, row: int, column: int) -> int:
        """Return the number of the state in which the agent is at (row, column)."""
        number = int(self.states_at(row, column))
        if number == MISSING:
            raise TaskError(f"a state needs a free cell of the map: got ({row}, {column})")
        return number

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The maze as tables: each cell has an outcome row for entering it and one for bumping."""
        to, entered = landing(self.grid.space), np.arange(len(self.cells))
        pays, fire = self.rewards, self.grid.holds("F")
        near_fire = (fire[to] & (to != MISSING)).any(axis=1)
        bump = pays.bump if pays.bump else np.nan
        terms = np.broadcast_arrays(
            np.where(self.grid.holds("T"), pays.treasure, np.nan),
            np.where(fire, pays.fire, np.nan),
            np.where(near_fire, pays.near_fire, np.nan),
            np.where(self.grid.holds("P"), pays.pit, np.nan),
            [[np.nan], [bump]],  # of entering, of bumping
        )
        reward = np.fmin.reduce(terms)
        reward = np.where(np.isnan(reward), pays.step, reward)
        if self.combine == "sum":
            reward = pays.step + np.nansum(terms, axis=0)
        return self._tables(
            np.ones((2 * len(entered), 1)),
            np.tile(entered, 2)[:, None],
            reward.reshape(-1, 1),
            outcome_row=np.where(to == MISSING, len(entered) + entered[:, None], to),
        )


def _characters(legend: object) -> dict[str, str]:
    """Return the character of the library that each character of a legend stands for."""
    named: Any = LEGENDS.get(legend, legend) if isinstance(legend, str) else legend or {}
    try:
        drawn = {character: DRAWN[name] for character, name in named.items()}
        fits = all(len(character) == 1 for character in drawn)
    except (AttributeError, KeyError, TypeError):
        fits = False
    if not fits:
        raise TaskError(
            f"a legend must say of single characters which of {', '.join(DRAWN)} they are, as "
            f"{{'O': 'pit'}}, or be one of {', '.join(LEGENDS)}: got {legend!r}"
        )
    return drawn


# -- random mazes, which are always solvable; a small maze is a part of a larger one ---------------

LARGEST_MAZE = 200
Corner = Literal["north-west", "north-east", "south-west", "south-east"]
CORNERS = get_args(Corner)
Share = Annotated[float, Rule(0, 1, "larger")]


def random_maze(
    size: Annotated[int, Rule(2, LARGEST_MAZE, "larger")] = 6,
    walls: Share = 0.2,
    pits: Share = 0.05,
    fires: Share = 0.0,
    seed: Annotated[int, Rule(0)] = 0,
    *,
    corner: Corner = "north-east",
    start: Literal["far", "uniform"] = "far",
    step: float = -1.0,
    treasure: float = 200.0,
    fire: float = -500.0,
    near_fire: float = -250.0,
    pit: float = -2500.0,
    discount: Discount = 0.99,
    time_limit: TimeLimit = 200,
) -> GridWorld:
    """Return a random maze: a square with the treasure in a corner, walls, pits and fires.

    It grows from the treasure, at (0, 0), outwards, one row and one column at a time. Objects are
    taken away at random until every free cell has a way to the treasure that enters neither pit nor
    fire. **A smaller maze with the same seed is the part of a larger one around the treasure**, as
    the paper's source tasks are parts of their target.

    Parameters
    ----------
    size : int
        Cells per side, 2 to 200.
    walls, pits, fires : float
        Chances that a cell becomes a wall, pit or fire, together at most 1; of many fewer remain.
    seed : int
        At least 0. Mazes with different seeds are independent.
    corner : {"north-west", "north-east", "south-west", "south-east"}
        Where the treasure lies.
    start : {"far", "uniform"}
        In the free cell with the longest way, or in any cell that does not end the episode.
    step, treasure, fire, near_fire, pit : float
        As in :class:`Rewards`.
    discount, time_limit
        As in :class:`GridWorld`.

    Examples
    --------
    >>> maze, part = random_maze(size=5, seed=3), random_maze(size=3, seed=3, start="uniform")
    >>> maze.map
    ('.#..T', '.....', '.#.#.', '...##', 'S....')
    >>> part.map == maze.crop(rows=(0, 3), columns=(-2, 1)).map
    True
    """
    rules: dict[str, Any] = {"size": size, "walls": walls, "pits": pits, "fires": fires}
    rules |= {"seed": seed, "corner": corner, "start": start}
    for name, value in rules.items():
        rules[name] = maze_family.parameter(name).checked(value, "a maze")
    if refused := _chances_sum(rules):
        raise TaskError(f"{refused}: got {walls}, {pits} and {fires}")
    size, seed = rules["size"], rules["seed"]
    cells = {(0, 0): "T"}
    for n in range(1, size):
        _grow(cells, n, {"#": walls, "P": pits, "F": fires}, seed)
    distance, waiting = {(0, 0): 0}, deque([(0, 0)])
    while waiting:
        row, column = waiting.popleft()
        for near in ((row - 1, column), (row, column + 1), (row + 1, column), (row, column - 1)):
            if cells.get(near) == "." and near not in distance:
                distance[near] = distance[row, column] + 1
                waiting.append(near)
    far = max(distance, key=lambda cell: (distance[cell], cell))
    if start == "far":
        cells[far] = "S"
    vertical, horizontal = corner.split("-")
    lines = ["".join(cells[row, column] for column in range(size)) for row in range(size)]
    lines = lines if horizontal == "west" else [line[::-1] for line in lines]
    return GridWorld(
        lines if vertical == "north" else lines[::-1],
        rewards=Rewards(step=step, treasure=treasure, fire=fire, near_fire=near_fire, pit=pit),
        start="map" if start == "far" else "uniform",
        origin=(0 if vertical == "north" else 1 - size, 0 if horizontal == "west" else 1 - size),
        discount=discount,
        time_limit=time_limit,
    )


def _grow(cells: dict[Cell, str], n: int, chances: dict[str, float], seed: int) -> None:
    """Add the cells at distance n, the larger of the distances in rows and columns."""
    # Each borders on one at distance n - 1, of which at least one is free and has a way to the
    # treasure. So if all objects were taken away, all cells would have a way.
    shell = [(n, column) for column in range(n)] + [(row, n) for row in range(n + 1)]
    states = count(stream_start(seed, f"maze/{n}"), int(STRIDE))
    draws = (uniform(splitmix64(state % 2**64)) for state in states)
    for cell in shell:
        drawn, cells[cell] = next(draws), "."
        for character, chance in chances.items():
            if drawn < chance:
                cells[cell] = character
                break
            drawn -= chance
    objects = sorted((next(draws), cell) for cell in shell if cells[cell] != ".")
    while not _joined(cells, shell, n):
        cells[objects.pop()[1]] = "."


def _joined(cells: dict[Cell, str], shell: list[Cell], n: int) -> bool:
    """Return whether cells of the shell are free, and all of them have a way to the treasure."""
    # From one end of the shell to the other free cells form runs. Each run must border on a cell at
    # distance n - 1 that is free; the corner (n, n) borders on none.
    runs = groupby(shell[:n] + shell[: n - 1 : -1], lambda cell: cells[cell] == ".")
    joined = [
        any(
            cells.get((row - (row == n), column - (column == n)), "#") in ".T"
            for row, column in run
            if min(row, column) < n
        )
        for free, run in runs
        if free
    ]
    return bool(joined) and all(joined)


def _chances_sum(parameters: dict[str, Any]) -> str | None:
    """Return the mistake, a sentence, if the chances of objects sum to more than 1."""
    total = sum(parameters[name] for name in ("walls", "pits", "fires"))
    return None if total <= 1 else "walls, pits and fires of a maze must sum to at most 1"


maze_family = TaskFamily("maze", random_maze, constraint=_chances_sum)
"""Random mazes (:func:`random_maze`); members map cell by cell, counted from the treasure."""
