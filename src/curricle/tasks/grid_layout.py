"""Where the states of a task lie on a grid: what pictures need to know of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from curricle.array_types import IntArray
from curricle.checks import one_of
from curricle.errors import TaskError

LETTERS = {"treasure": "T", "fire": "F", "pit": "P", "goal": "G", "key": "K", "lock": "L"}
LETTERS |= {"exit": "E"}
"""Of the objects on a grid."""


@dataclass(frozen=True, eq=False)
class GridLayout:
    """The cell of each state of a task, and what lies in cells; a task offers it as `layout`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> drawn = GridWorld("S.T").layout
    >>> drawn.shape, drawn.objects
    ((1, 3), (('treasure', 0, 2, True),))
    """

    cells: IntArray
    """Row and column of the agent in each state, (S, 2)."""
    components: tuple[str, ...]
    """The components of a state that say where the agent is; a picture fixes the others."""
    shape: tuple[int, int]
    """Rows and columns."""
    origin: tuple[int, int] = (0, 0)
    """Row and column of the top-left cell."""
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
