"""Grid worlds of fire, pits and treasure, drawn as text (paper, section on the maze; F1-F3).

Rules: four moves; leaving the grid or walking into a wall is staying, and the cell is paid again;
the reward is that of the cell *entered*.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from textwrap import dedent
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, number, one_of
from curricle.errors import TaskError
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.spaces import MISSING, Component, Space, frozen, whole

OBJECTS = {"T": "treasure", "F": "fire", "P": "pit"}
CHARACTERS = "STFP#."
LARGEST = 1e100
"""Rewards are at most this large, so that no return overflows."""
MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
_STEPS = np.array(list(MOVES.values()))

Cell = tuple[int, int]
Start = Literal["map", "uniform"] | tuple[Cell, ...]


@dataclass(frozen=True)
class Rewards:
    """What a step pays, by what the entered cell holds (return units).

    Parameters
    ----------
    step : float
        Paid by every step (or, with ``combine="worst"``, by a step where nothing else pays).
    treasure, fire, pit : float
        Paid on entering such a cell.
    near_fire : float
        Paid once on entering a cell that has a fire north, east, south or west of it.
    bump : float
        Paid when the agent stays because the grid's edge or a wall is in the way.

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
            value = number(name, getattr(self, f.name), TaskError, -LARGEST, LARGEST)
            object.__setattr__(self, f.name, value)


@dataclass(frozen=True)
class GridWorld:
    """A maze read from a text map.

    Parameters
    ----------
    map : str or sequence of str
        North on top. ``S`` start, ``T`` treasure, ``F`` fire, ``P`` pit, ``#`` wall, ``.`` free.
        At least one ``T``.
    rewards : Rewards
    combine : {"sum", "worst"}
        Whether the step reward and the terms of the entered cell add up, or only the worst term
        counts (the step reward then stands where no other term applies).
    ends : iterable of {"treasure", "pit", "fire"}
        Objects whose entry ends the episode.
    start : "map", "uniform" or cells
        At the ``S`` cells; anywhere that does not end the episode; or at the given
        ``(row, column)`` cells. Several cells are equally likely.
    representation : {"absolute", "relative"}
        What a state is made of: the agent's ``row`` and ``column``, or where each object lies
        relative to the agent (Svetlik et al. 2017; paper E4, F1).
    origin : (int, int)
        Row and column of the top-left cell; a crop keeps the coordinates of its map.
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
        object.__setattr__(self, "map", _read_map(self.map))
        origin = whole(self.origin, "the origin's row and column")
        if origin.shape != (2,):
            raise TaskError(f"origin must be a row and a column: got {self.origin!r}")
        object.__setattr__(self, "origin", (int(origin[0]), int(origin[1])))
        instance("rewards", self.rewards, Rewards, TaskError)
        one_of("combine", self.combine, ("sum", "worst"), TaskError)
        one_of("representation", self.representation, ("absolute", "relative"), TaskError)
        ends = (self.ends,) if isinstance(self.ends, str) else tuple(self.ends or ())
        for name in ends:
            one_of("each of ends", name, OBJECTS.values(), TaskError)
        object.__setattr__(self, "ends", tuple(sorted(set(ends))))
        check_horizon(self)
        if not isinstance(self.start, str):
            object.__setattr__(self, "start", _read_cells(self.start))
        self._start_states()

    @classmethod
    def from_file(cls, path: str | Path, **rules: Any) -> Self:
        """Return the maze drawn in a text file; `rules` as in the class."""
        return cls(Path(path).read_text(encoding="utf-8"), **rules)

    # -- variants ------------------------------------------------------------------------------

    def with_start(self, start: Literal["map", "uniform"] | Iterable[Cell]) -> Self:
        """Return the same maze with another start: ``"map"``, ``"uniform"`` or cells.

        Examples
        --------
        >>> GridWorld("S.T").with_start("uniform").mdp.start
        array([0.5, 0.5, 0. ])
        """
        return replace(self, start=start)

    def crop(
        self,
        *,
        rows: tuple[int, int],
        columns: tuple[int, int],
        start: Literal["map", "uniform"] | Iterable[Cell] = "uniform",
    ) -> Self:
        """Return the part in the half-open ranges `rows` x `columns`, in this maze's coordinates.

        Objects outside the part are gone, the fire next to its edge included. The default start
        is uniform, as in the paper's source tasks.

        Raises
        ------
        TaskError
            When the part reaches beyond the map, is empty, or has no treasure.
        """
        for name, given, first, size in (
            ("rows", rows, self.origin[0], len(self.map)),
            ("columns", columns, self.origin[1], len(self.map[0])),
        ):
            if whole(given, f"a crop's {name}").shape != (2,):
                raise TaskError(f"a crop's {name} must be a first and an end: got {given!r}")
            low, high = given
            if not first <= low < high <= first + size:
                raise TaskError(
                    f"a crop must lie within the map's {name} {first}..{first + size}: got "
                    f"{low}..{high}"
                )
        top, left = rows[0] - self.origin[0], columns[0] - self.origin[1]
        part = [
            line[left : left + columns[1] - columns[0]]
            for line in self.map[top : top + rows[1] - rows[0]]
        ]
        return replace(self, map=part, start=start, origin=(rows[0], columns[0]))

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def cells(self) -> npt.NDArray[np.int64]:
        """The cells that are no wall, (S, 2) row and column, in state order."""
        return frozen(np.argwhere(self._grid != "#") + self.origin)

    @cached_property
    def objects(self) -> tuple[tuple[str, int, int], ...]:
        """Every object as (class, row, column), in reading order."""
        return tuple(
            (
                OBJECTS[self._grid[row, column]],
                int(row) + self.origin[0],
                int(column) + self.origin[1],
            )
            for row, column in np.argwhere(np.isin(self._grid, list(OBJECTS)))
        )

    @cached_property
    def states(self) -> Space:
        """One state a free cell; components as :attr:`representation` says."""
        if self.representation == "relative":
            return self._relative_states()
        return self._cell_space

    @cached_property
    def actions(self) -> Space:
        """The moves north, east, south and west."""
        return Space([Component("move", len(MOVES), labels=tuple(MOVES))])

    @cached_property
    def _cell_space(self) -> Space:
        height, width = self._grid.shape
        axes = [
            Component("row", height, low=self.origin[0]),
            Component("column", width, low=self.origin[1]),
        ]
        return Space(axes, None if len(self.cells) == height * width else self.cells)

    def _relative_states(self) -> Space:
        height, width = self._grid.shape
        axes, points = [], []
        counts: dict[str, int] = {}
        for name, row, column in self.objects:
            counts[name] = counts.get(name, 0) + 1
            label = f"{name}_{counts[name]}"
            axes.append(Component(f"{label}_row", 2 * height - 1, low=1 - height))
            axes.append(Component(f"{label}_column", 2 * width - 1, low=1 - width))
            points += [row - self.cells[:, 0], column - self.cells[:, 1]]
        return Space(axes, np.stack(points, axis=1))

    @cached_property
    def _grid(self) -> npt.NDArray[np.str_]:
        return np.array([list(line) for line in self.map])

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

    def states_at(self, row: npt.ArrayLike, column: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Return the states of these cells, `MISSING` where there is no free cell."""
        return self._cell_space.encode(row=row, column=column)

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The maze as tables: one outcome row for arriving in each cell, one for bumping there."""
        n_states = len(self.cells)
        arrival = np.arange(n_states)
        landing = self.states_at(
            self.cells[:, 0, None] + _STEPS[:, 0], self.cells[:, 1, None] + _STEPS[:, 1]
        )
        bumped = landing == MISSING
        reward = np.stack([self._pay(bumped=False), self._pay(bumped=True)])
        start = np.zeros(n_states)
        starting = self._start_states()
        start[starting] = 1 / len(starting)
        return FiniteMDP(
            states=self.states,
            actions=self.actions,
            outcome_row=np.where(bumped, n_states + arrival[:, None], landing),
            probability=np.ones((2 * n_states, 1)),
            next_state=np.tile(arrival, 2)[:, None],
            reward=reward.reshape(-1, 1),
            terminal=self._holds(*self.ends),
            start=start,
            discount=self.discount,
            time_limit=self.time_limit,
        )

    def _holds(self, *names: str) -> npt.NDArray[np.bool_]:
        """Which states' cells hold one of the named objects, (S,) bool."""
        there = {(row, column) for name, row, column in self.objects if name in names}
        return np.array([(int(r), int(c)) in there for r, c in self.cells])

    def _near_fire(self) -> npt.NDArray[np.bool_]:
        fires = np.array([(row, column) for name, row, column in self.objects if name == "fire"])
        if not len(fires):
            return np.zeros(len(self.cells), dtype=bool)
        distance = abs(self.cells[:, None, :] - fires[None, :, :]).sum(axis=2)
        return np.asarray((distance == 1).any(axis=1))

    def _pay(self, bumped: bool) -> npt.NDArray[np.float64]:
        """The reward of entering each cell, (S,) float64."""
        everywhere = np.ones(len(self.cells), dtype=bool)
        terms = [
            (self._holds("treasure"), self.rewards.treasure),
            (self._holds("fire"), self.rewards.fire),
            (self._near_fire(), self.rewards.near_fire),
            (self._holds("pit"), self.rewards.pit),
            (everywhere & bumped & (self.rewards.bump != 0), self.rewards.bump),
        ]
        if self.combine == "sum":
            added = np.sum([np.where(on, value, 0.0) for on, value in terms], axis=0)
            return np.asarray(self.rewards.step + added)
        worst = np.min([np.where(on, value, np.inf) for on, value in terms], axis=0)
        return np.where(np.isinf(worst), self.rewards.step, worst)

    def _start_states(self) -> npt.NDArray[np.int64]:
        if self.start == "map":
            found = np.flatnonzero(self._grid[self._grid != "#"] == "S")
            if not found.size:
                raise TaskError("start='map' needs an S on the map: there is none")
            return found
        if self.start == "uniform":
            free = np.flatnonzero(~self._holds(*self.ends))
            if not free.size:
                raise TaskError("start='uniform' needs a cell that does not end the episode")
            return free
        if isinstance(self.start, str):
            raise TaskError(f"start must be 'map', 'uniform' or cells: got {self.start!r}")
        return np.array([self.state(*cell) for cell in self.start])


def _read_map(given: Any) -> tuple[str, ...]:
    if not isinstance(given, str | list | tuple):
        raise TaskError(f"a map must be text or a list of lines: got {given!r}")
    if isinstance(given, str):
        given = [line.strip() for line in dedent(given).strip().splitlines()]
    lines = tuple(given)
    for row, line in enumerate(lines):
        if len(line) != len(lines[0]):
            raise TaskError(
                f"all lines of a map must be equally long: line {row} has {len(line)} characters, "
                f"line 0 has {len(lines[0])}"
            )
        for column, character in enumerate(line):
            if character not in CHARACTERS:
                raise TaskError(
                    f"a map is drawn with {' '.join(CHARACTERS)}: row {row}, column {column} has "
                    f"{character!r}"
                )
    if not any("T" in line for line in lines):
        raise TaskError("a map needs a treasure T: there is none")
    return lines


def _read_cells(given: Any) -> tuple[Cell, ...]:
    try:
        cells = np.array(list(given))
    except (TypeError, ValueError):
        cells = np.empty(0)
    if cells.ndim != 2 or cells.shape[1] != 2 or cells.dtype.kind not in "iu":
        raise TaskError(f"start must be 'map', 'uniform' or cells such as [(9, 0)]: got {given!r}")
    return tuple(sorted({(int(row), int(column)) for row, column in cells}))
