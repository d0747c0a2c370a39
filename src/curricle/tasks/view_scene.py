"""Draws what moves over a grid view: all that a study's folder stores of an episode."""

import numpy as np

from curricle.array_types import IntArray
from curricle.tasks.grid_layout import LETTERS
from curricle.tasks.grid_view import GridView
from curricle.tasks.scene import AGENT, ASIDE, COATS, Pixels
from curricle.tasks.scenes import canvas_of, tile

INKS = dict(zip(("blue", "green", "vermillion", "purple", "black"), COATS[:5], strict=True))
"""Colours of markers by name."""


class ViewScene:
    """A grid view with its markers in given cells.

    Parameters
    ----------
    view : GridView

    Examples
    --------
    >>> from curricle import GridWorld
    >>> scene = ViewScene(GridView.for_replay(GridWorld(["S#T", "..."])))
    >>> print(scene.text(np.array([4])))
    .#T
    .@.
    """

    def __init__(self, view: GridView):
        self._markers, (_, self._columns) = view.markers, view.shape
        self._map = np.full(view.shape, ".")
        self._map[tuple((view.walls - view.origin).T)] = "#"
        for name, row, column, _ in view.objects:
            self._map[row - view.origin[0], column - view.origin[1]] = LETTERS[name]
        self._canvas = canvas_of(self._map)

    def image(self, cells: IntArray) -> Pixels:
        """Return the grid from above, (height, width, 3) uint8.

        `cells`, (markers,), are where each is, as row * columns + column.
        """
        places = [divmod(int(cell), self._columns) for cell in cells]
        if len(places) == 1:
            figure = AGENT if self._map[places[0]] == "." else ASIDE
            return self._canvas.with_figures([(*places[0], figure)])
        return self._canvas.with_figures(
            (*place, tile(marker.letter, INKS[marker.colour]))
            for place, marker in zip(places, self._markers, strict=True)
        )

    def text(self, cells: IntArray) -> str:
        """Return the map with each marker's letter, or ``@`` for the only one."""
        there = self._map.astype("<U9")
        taken = dict[tuple[int, int], str]()
        for cell, marker in zip(cells.tolist(), self._markers, strict=True):
            place = divmod(cell, self._columns)
            letter = marker.letter if len(self._markers) > 1 else "@"
            taken[place] = taken.get(place, "") + letter
        for place, letters in taken.items():
            there[place] = letters
        wide = max(map(len, taken.values()), default=1)
        gap = " " if len(self._markers) > 1 else ""
        lines = (gap.join(one.ljust(wide) for one in row) for row in there.tolist())
        return "\n".join(line.rstrip() for line in lines)
