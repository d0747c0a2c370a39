"""FrozenLake: from the start to the goal over ice that has holes and may be slippery.

Gymnasium's ``FrozenLake-v1`` (Towers et al. 2024; its rules in ``toy_text/frozen_lake.py``), with
its maps, its random maps and its parameters, and the parts of a lake that Gymnasium does not have.
On slippery ice a move goes where it was meant to with probability `success_rate`, and to either
side with half of the rest. A move off the map stays where it is. Episodes end at the goal and in
holes.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from curricle.arrays import BoolArray, IntArray
from curricle.checks import instance, number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import (
    Cell,
    CellDomain,
    MapDomain,
    check_starts,
    landing_or_staying,
    read_start,
    tables_of,
)
from curricle.tasks.grid_layout import GridLayout
from curricle.tasks.mdp import FiniteMDP, check_horizon
from curricle.tasks.outcomes import check_numbers
from curricle.tasks.spaces import Component, Space

MAPS: dict[str, tuple[str, ...]] = {
    "4x4": ("SFFF", "FHFH", "FFFH", "HFFG"),
    "8x8": (
        *("SFFFFFFF", "FFFFFFFF", "FFFHFFFF", "FFFFFHFF"),
        *("FFFHFFFF", "FHHFFFHF", "FHFFHFHF", "FFFHFFFG"),
    ),
}
"""Gymnasium's maps: S start, F frozen, H hole, G goal."""
MOVES = {"west": (0, -1), "south": (1, 0), "east": (0, 1), "north": (-1, 0)}
CHARACTERS = "SFHG"
LARGEST_LAKE = 100
LEAST_FROZEN = 0.6  # large lakes with a way to the goal are too rare below


@dataclass(frozen=True)
class FrozenLake(MapDomain, CellDomain):
    """A lake of ice with holes, drawn as text.

    Parameters
    ----------
    map : {"4x4", "8x8"}, str or sequence of str
        One of Gymnasium's maps, or one line a row, north first: ``S`` start, ``F`` frozen, ``H``
        hole and ``G`` goal.
    slippery : bool
        Whether moves may go to either side.
    success_rate : float
        Probability that a move on slippery ice goes where it was meant to.
    goal_reward, hole_reward, step_reward : float
        Of entering the goal, a hole, any other cell.
    start : "map", "uniform" or cells
        At an ``S``, on any cell that does not end the episode, or in one of the given
        ``(row, column)`` cells; all are equally likely.
    origin : (int, int)
        Row and column of the top-left cell. A part keeps the coordinates of the whole lake.
    discount, time_limit
        As in :class:`FiniteMDP`; Gymnasium's lakes have a limit of 100 steps, and 200 if 8x8.

    Raises
    ------
    TaskError
        On a map that is no lake, a start where there is no ice, or a number out of range.

    Examples
    --------
    >>> lake = FrozenLake("8x8", slippery=False, time_limit=200)
    >>> part = lake.crop(rows=(4, 8), columns=(4, 8))
    >>> part.map, part.states.label(0)
    (('FFFF', 'FFHF', 'HFHF', 'FFFG'), 'row=4 column=4')
    """

    map: Any = "4x4"
    slippery: bool = True
    success_rate: float = 1 / 3
    goal_reward: float = 1.0
    hole_reward: float = 0.0
    step_reward: float = 0.0
    start: Any = "map"
    origin: Cell = (0, 0)
    discount: float = 0.99
    time_limit: int | None = 100

    def __post_init__(self) -> None:
        drawn = MAPS.get(self.map, self.map) if isinstance(self.map, str) else self.map
        self._read_map(drawn, CHARACTERS, "G", "a lake needs a goal G")
        instance("slippery", self.slippery, bool, TaskError)
        check_numbers(self, ("goal_reward", "hole_reward", "step_reward"), ("success_rate",))
        check_horizon(self)
        read_start(self)
        self._start_states()

    # -- spaces --------------------------------------------------------------------------------

    @cached_property
    def states(self) -> Space:
        """One state for each cell, holes and goal too."""
        return self._cell_space

    @cached_property
    def actions(self) -> Space:
        """The moves west, south, east and north, in Gymnasium's order."""
        return Space([Component("move", 4, labels=tuple(MOVES))])

    @property
    def goal_states(self) -> BoolArray:
        """Which states are the goal, (S,) bool."""
        return np.asarray(self._contents == "G")

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie, for pictures."""
        drawn = self._objects({"G": "goal", "H": "pit"})
        return GridLayout(
            cells=self.cells,
            components=("row", "column"),
            shape=self._grid.shape,
            origin=self.origin,
            objects=tuple((*one, True) for one in drawn),
        )

    # -- tables --------------------------------------------------------------------------------

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The lake as tables: on slippery ice O = to the one side, ahead, to the other side."""
        entered = np.where(self.goal_states, self.goal_reward, self.step_reward)
        entered = np.where(self._contents == "H", self.hole_reward, entered)
        to = landing_or_staying(self.states, MOVES)
        sides = (1 - self.success_rate) / 2
        after = slipping(to) if self.slippery else to[:, :, None]
        return tables_of(
            self,
            [sides, self.success_rate, sides] if self.slippery else [1.0],
            after,
            entered[after],
            terminal=self._ends,
            starting=self._start_states(),
        )

    @property
    def _ends(self) -> BoolArray:
        return np.isin(self._contents, ["G", "H"])

    def _start_states(self) -> IntArray:
        if isinstance(self.start, str):
            characters = ["S"] if self.start == "map" else ["S", "F"]
            starting = np.flatnonzero(np.isin(self._contents, characters))
            if not starting.size:
                raise TaskError(f"start={self.start!r} needs {' or '.join(characters)} on the map")
            return starting
        row, column = np.array(self.start).T
        states = self.states.encode(row=row, column=column)
        rule = "a start must be a cell of ice on the map"
        return check_starts(states, ~self._ends, self.start, rule)


def random_lake(size: int = 8, frozen_share: float = 0.8, seed: int = 0) -> tuple[str, ...]:
    """Return the map of a random lake that has a way to the goal, as Gymnasium draws it.

    It is ``gymnasium.envs.toy_text.frozen_lake.generate_random_map(size, frozen_share, seed)``.
    """
    from gymnasium.envs.toy_text.frozen_lake import generate_random_map

    size = whole_number("size of a lake", size, 2, TaskError)
    number("size of a lake", size, TaskError, 2, LARGEST_LAKE)
    number("frozen_share of a lake", frozen_share, TaskError, LEAST_FROZEN, 1)
    seed = whole_number("seed of a lake", seed, 0, TaskError)
    return tuple(generate_random_map(size=size, p=frozen_share, seed=seed))


def slipping(to: IntArray) -> IntArray:
    """Return where slipping moves may land, (S, A, 3); each move is a quarter turn from the next.

    The outcomes of a move are those of the one before it, of itself and of the one after it.
    """
    return np.stack([np.roll(to, 1, axis=1), to, np.roll(to, -1, axis=1)], axis=2)
