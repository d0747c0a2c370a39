"""FrozenLake: from the start to the goal over ice that has holes and may be slippery.

Gymnasium's ``FrozenLake-v1`` (Towers et al. 2024; its rules in ``toy_text/frozen_lake.py``), with
its maps, its random maps and its parameters, and parts of a lake. A move off the map stays where it
is. Episodes end at the goal and in holes.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from gymnasium.envs.toy_text.frozen_lake import MAPS, generate_random_map

from curricle.arrays import BoolArray
from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.domain import (
    Cell,
    CellDomain,
    Discount,
    MapDomain,
    MapStart,
    TimeLimit,
    family_of,
    slipping,
)
from curricle.tasks.family import Rule
from curricle.tasks.mdp import FiniteMDP

MOVES = {"west": (0, -1), "south": (1, 0), "east": (0, 1), "north": (-1, 0)}  # in Gymnasium's order
LARGEST_LAKE = 100
LEAST_FROZEN = 0.6  # large lakes with a way to the goal are too rare below


@dataclass(frozen=True)
class FrozenLake(MapDomain, CellDomain):
    """A lake of ice with holes, drawn as text.

    Parameters
    ----------
    map : str or sequence of str
        The name of one of Gymnasium's maps, or one line a row, north first: ``S`` start, ``F``
        frozen, ``H`` hole and ``G`` goal.
    slippery : bool
        Whether moves may go to either side.
    success_rate : float
        Probability that a move on slippery ice goes where it was meant to, not to either side.
    goal_reward, hole_reward, step_reward : float
        Of entering the goal, a hole, any other cell.
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

    ACTIONS = tuple(MOVES)
    CHARACTERS = "SFHG"
    OBJECTS: ClassVar = {"G": "goal", "H": "pit"}
    ENDS = "GH"

    def _check(self) -> None:
        drawn = MAPS.get(self.map, self.map) if isinstance(self.map, str) else self.map
        self._read_map(drawn, "G", "a lake needs a goal G")
        super()._check()

    @property
    def goal_states(self) -> BoolArray:
        """Which states are the goal, (S,) bool."""
        return self._holds("G")

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The lake as tables: on slippery ice O = to the one side, ahead, to the other side."""
        entered = np.where(self.goal_states, self.goal_reward, self.step_reward)
        entered = np.where(self._holds("H"), self.hole_reward, entered)
        to = self._landing(MOVES)
        sides = (1 - self.success_rate) / 2
        after = slipping(to) if self.slippery else to[:, :, None]
        return self._tables(
            [sides, self.success_rate, sides] if self.slippery else [1.0],
            after,
            entered[after],
            terminal=self._ends,
            starting=self._start_states(),
        )


def random_lake(size: int = 8, frozen_share: float = 0.8, seed: int = 0) -> tuple[str, ...]:
    """Return the map of a random lake that has a way to the goal, as Gymnasium draws it."""
    size = whole_number("size of a lake", size, 2, TaskError)
    number("size of a lake", size, TaskError, 2, LARGEST_LAKE)
    number("frozen_share of a lake", frozen_share, TaskError, LEAST_FROZEN, 1)
    seed = whole_number("seed of a lake", seed, 0, TaskError)
    return tuple(generate_random_map(size=size, p=frozen_share, seed=seed))


def part_of_lake(
    map: Literal["4x4", "8x8", "random"] = "4x4",
    part: Annotated[int | None, Rule(2, LARGEST_LAKE - 1, "larger")] = None,
    size: Annotated[int, Rule(2, LARGEST_LAKE, "larger")] = 8,
    frozen_share: Annotated[float, Rule(LEAST_FROZEN, 1, "smaller")] = 0.8,
    seed: Annotated[int, Rule(0)] = 0,
    **rules: Any,
) -> FrozenLake:
    """Return one of Gymnasium's frozen lakes, or the `part` of so many rows around the goal."""
    lake = FrozenLake(random_lake(size, frozen_share, seed) if map == "random" else map, **rules)
    if part is None:
        return lake
    whole = len(lake.map)
    return lake.crop(rows=(whole - part, whole), columns=(whole - part, whole))


def _parts_of_maps(parameters: dict[str, Any]) -> str | None:
    """Return what is wrong with the size of a map or of its part."""
    drawn = MAPS.get(parameters["map"])
    if drawn is not None and parameters["size"] != 8:
        return "size of frozen_lake is of random lakes: leave it out with other maps"
    whole = parameters["size"] if drawn is None else len(drawn)
    if parameters["part"] is not None and parameters["part"] >= whole:
        return f"part of frozen_lake must be less than the lake's {whole} rows"
    return None


frozen_lake_family = family_of(FrozenLake, part_of_lake, constraint=_parts_of_maps)
"""Frozen lakes: a `map` of Gymnasium, or a random one, or its `part` around the goal.

`part` is its rows and columns, 2 or more; `size`, `frozen_share` and `seed` are of random lakes.
Members map cell by cell, by the lake's coordinates.
"""
