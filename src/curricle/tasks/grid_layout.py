"""Where the states of a task lie on a grid: what pictures need to know of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curricle.arrays import IntArray
from curricle.checks import one_of
from curricle.errors import TaskError
from curricle.tasks.mdp import generative_model

LETTERS = {"treasure": "T", "fire": "F", "pit": "P", "goal": "G", "key": "K", "lock": "L"}
LETTERS |= {"exit": "E"}
"""Of the objects on a grid."""
SIDES = (("row", "column"), ("row", "col"), ("y", "x"))
"""Components that say in which cell a state lies, by their names."""
MOST_STATES = 20_000_000  # states of a task whose cells are read off its components


@dataclass(frozen=True, eq=False)
class GridLayout:
    """The cell of each state of a task, and what lies in cells; a task offers it as `layout`."""

    cells: IntArray  # row and column of the agent in each state, (S, 2)
    components: tuple[str, ...]
    """The components of a state that say where the agent is; a picture fixes the others."""
    shape: tuple[int, int]  # rows and columns
    origin: tuple[int, int] = (0, 0)  # row and column of the top-left cell
    objects: tuple[tuple[str, int, int, bool], ...] = ()
    """Name (treasure, goal, exit, pit, fire, key or lock), row and column of what lies in a cell,
    and whether entering it ends the episode."""
    walls: IntArray | None = None
    """Rows and columns of walls, (m, 2); None where all cells without a state are walls."""
    markers: Mapping[str, IntArray] = field(default_factory=dict)
    """What else moves: name -> its row and column in each state, (S, 2)."""

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


def layout_of(task: Any) -> GridLayout | None:
    """Return where states lie, as a task says or by its row and column; None if it has neither."""
    own = getattr(task, "layout", None)
    if isinstance(own, GridLayout):
        return own
    states = generative_model(task).states
    sides = next((names for names in SIDES if set(names) <= set(states.names)), None)
    if sides is None or states.size > MOST_STATES:
        return None
    values = states.decode()
    cells = np.stack([values[name] for name in sides], axis=1)
    origin, last = cells.min(axis=0), cells.max(axis=0)
    rows, columns = (last - origin + 1).tolist()
    return GridLayout(cells, sides, (rows, columns), tuple(origin.tolist()))
