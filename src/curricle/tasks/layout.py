"""Where the states of a task lie on a grid: what a task may say of it, and pictures read."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from curricle.arrays import IntArray
from curricle.checks import one_of
from curricle.errors import TaskError

Cell = tuple[int, int]  # row and column
LETTERS = {"treasure": "T", "fire": "F", "pit": "P", "goal": "G", "key": "K", "lock": "L"}
LETTERS |= {"exit": "E"}
"""Of the objects on a grid."""


@dataclass(frozen=True, eq=False)
class GridLayout:
    """The cell of each state of a task, and the objects in cells; a task offers it as `layout`."""

    cells: IntArray  # row and column of the agent in each state, (S, 2)
    components: tuple[str, ...]
    """The components of a state that say where the agent is; a picture fixes the others."""
    shape: tuple[int, int]  # rows and columns
    origin: Cell = (0, 0)  # row and column of the top-left cell
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    """Name (treasure, goal, exit, pit, fire, key or lock), row and column of an object in a cell,
    and whether entering it ends the episode."""
    walls: IntArray | None = None
    """Rows and columns of walls, (m, 2); None where all cells without a state are walls."""
    markers: Mapping[str, IntArray] = field(default_factory=dict)
    """Other moving objects: name -> row and column in each state, (S, 2)."""

    def __post_init__(self) -> None:
        for name, *_ in self.objects:
            one_of("an object of a layout", name, tuple(LETTERS), TaskError)

    @property
    def wall_cells(self) -> IntArray:
        """Row and column of each wall, (m, 2)."""
        if self.walls is not None:
            return self.walls
        free = np.zeros(self.shape, bool)
        free[tuple((self.cells - self.origin).T)] = True
        return np.argwhere(~free) + self.origin
