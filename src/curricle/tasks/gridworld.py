"""Grid worlds with fire, pits and treasure, drawn as text (paper, section on the maze; F1-F3).

The agent moves one cell north, east, south or west. A move off the grid or into a wall leaves it
where it is. The reward depends on the cell entered; an agent that stays enters its cell again.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import instance, number, one_of
from curricle.errors import TaskError
from curricle.tasks.domain import Cell, CellDomain, MapDomain, landing, read_start, tables_of
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import LARGEST_REWARD
from curricle.tasks.spaces import MISSING, Component, Space

OBJECTS = {"T": "treasure", "F": "fire", "P": "pit"}
CHARACTERS = "STFP#."


@dataclass(frozen=True)
class Rewards:
    """The rewards of a step, by what the entered cell holds (return units).

    Parameters
    ----------
    step : float
        Of every step (with ``combine="worst"``, only of steps to which no other term applies).
    treasure, fire, pit : float
        For entering a cell with such an object.
    near_fire : float
        For entering a cell with fire north, east, south or west of it, however many.
    bump : float
        For a move that the edge of the grid or a wall prevents.

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
class GridWorld(MapDomain, CellDomain):
    """A maze drawn as a text map.

    Parameters
    ----------
    map : str or sequence of str
        One line a row, north first. ``S`` start, ``T`` treasure (at least one), ``F`` fire,
        ``P`` pit, ``#`` wall, ``.`` free.
    rewards : Rewards
    combine : {"sum", "worst"}
        Whether all terms that apply to a step add up, the step reward included, or only the lowest
        counts (the step reward then only where no other term applies).
    ends : iterable of {"treasure", "pit", "fire"}
        Objects that end the episode when their cell is entered.
    start : "map", "uniform" or cells
        At an ``S``, at any cell that does not end the episode, or at one of the given
        ``(row, column)`` cells; all are equally likely.
    representation : {"absolute", "relative"}
        The components of a state: the agent's ``row`` and ``column``, or the position of each
        object relative to the agent (Svetlik et al. 2017; paper E4, F1).
    origin : (int, int)
        Row and column of the top-left cell. A crop keeps the coordinates of the whole map.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        On a ragged map, an unknown character, no treasure, no start, or an unknown rule.

    Examples
    --------
    >>> maze = GridWorld('''
    ...     S.P
    ...     ..T
    ... ''')
    >>> maze.states
    Space(6 points: row[2] x column[3])
    >>> maze.crop(rows=(0, 2), columns=(1, 3)).states.label(0)
    'row=0 column=1'
    """

    map: Any
    rewards: Rewards = Rewards()
    combine: Literal["sum", "worst"] = "sum"
    ends: Any = ("pit", "treasure")
    start: Any = "map"
    representation: Literal["absolute", "relative"] = "absolute"
    origin: Cell = (0, 0)
    discount: float = 0.99
    time_limit: int | None = 200

    def __post_init__(self) -> None:
        self._read_map(self.map, CHARACTERS, "T", "a map needs a treasure T")
        instance("rewards", self.rewards, Rewards, TaskError)
        one_of("combine", self.combine, ("sum", "worst"), TaskError)
        one_of("representation", self.representation, ("absolute", "relative"), TaskError)
        ends = (self.ends,) if isinstance(self.ends, str) else self.ends
        if not isinstance(ends, Iterable):
            raise TaskError(f"ends must be names of objects: got {ends!r}")
        ends = tuple(ends)
        for name in ends:
            one_of("each of ends", name, OBJECTS.values(), TaskError)
        object.__setattr__(self, "ends", tuple(sorted(set(ends))))
        check_horizon(self)
        read_start(self)
        self._start_states()

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def objects(self) -> tuple[tuple[str, int, int], ...]:
        """Every object as (class, row, column), in reading order."""
        return tuple(self._objects(OBJECTS))

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        return GridLayout(
            cells=self.cells,
            components=self.states.names,
            shape=self._grid.shape,
            origin=self.origin,
            objects=tuple((*one, one[0] in self.ends) for one in self.objects),
        )

    @cached_property
    def states(self) -> Space:
        """One state for each cell that is not a wall."""
        if self.representation == "relative":
            return self._relative_states()
        return self._cell_space

    def _relative_states(self) -> Space:
        height, width = self._grid.shape
        axes, points, counts = [], [], Counter[str]()
        for name, row, column in self.objects:
            counts[name] += 1
            label = f"{name}_{counts[name]}"
            axes.append(Component(f"{label}_row", 2 * height - 1, low=1 - height))
            axes.append(Component(f"{label}_column", 2 * width - 1, low=1 - width))
            points += [row - self.cells[:, 0], column - self.cells[:, 1]]
        return Space(axes, np.stack(points, axis=1))

    @cached_property
    def _landing(self) -> IntArray:
        """The state that each move leads to, (S, 4); MISSING off the grid and in walls."""
        return landing(self._cell_space)

    def state(self, row: int, column: int) -> int:
        """Return the number of the state in which the agent is at (row, column).

        Examples
        --------
        >>> GridWorld("S#T").state(0, 2)
        1
        """
        number = int(self.states_at(row, column))
        if number == MISSING:
            raise TaskError(f"a state needs a free cell of the map: got ({row}, {column})")
        return number

    def states_at(self, row: npt.ArrayLike, column: npt.ArrayLike) -> IntArray:
        """Return the states of these cells, `MISSING` off the map and for walls."""
        return self._cell_space.encode(row=row, column=column)

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The maze as tables: each cell has an outcome row for entering it and one for bumping."""
        entered = np.arange(len(self.cells))
        bumps = len(entered) + entered[:, None]
        return tables_of(
            self,
            np.ones((2 * len(entered), 1)),
            np.tile(entered, 2)[:, None],
            np.append(self._rewards(bumped=False), self._rewards(bumped=True))[:, None],
            terminal=self._holds(*self.ends),
            starting=self._start_states(),
            outcome_row=np.where(self._landing == MISSING, bumps, self._landing),
        )

    def _holds(self, *names: str) -> BoolArray:
        """Return which cells hold one of the named objects, (S,) bool."""
        return np.isin(self._contents, [c for c, name in OBJECTS.items() if name in names])

    def _rewards(self, bumped: bool) -> FloatArray:
        """Return the reward of entering each cell, or of bumping there, (S,) float64."""
        pays, fire = self.rewards, self._holds("fire")
        near_fire = (fire[self._landing] & (self._landing != MISSING)).any(axis=1)
        terms = [
            np.where(self._holds("treasure"), pays.treasure, np.nan),
            np.where(fire, pays.fire, np.nan),
            np.where(near_fire, pays.near_fire, np.nan),
            np.where(self._holds("pit"), pays.pit, np.nan),
            np.full(len(fire), pays.bump if bumped and pays.bump else np.nan),
        ]
        if self.combine == "sum":
            return np.asarray(pays.step + np.nansum(terms, axis=0))
        worst = np.fmin.reduce(terms)
        return np.where(np.isnan(worst), pays.step, worst)

    def _start_states(self) -> IntArray:
        if self.start == "map":
            found = np.flatnonzero(self._contents == "S")
            if not found.size:
                raise TaskError("start='map' needs an S on the map: there is none")
            return found
        if self.start == "uniform":
            free = np.flatnonzero(~self._holds(*self.ends))
            if not free.size:
                raise TaskError("start='uniform' needs a cell that does not end the episode")
            return free
        return np.array([self.state(*cell) for cell in self.start])
