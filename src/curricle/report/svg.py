"""SVG for a page: Matplotlib's figures as elements, and the paths of a grid's cells and moves."""

import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from curricle.arrays import IntArray
from curricle.plotting.grids import TINTS
from curricle.plotting.styles import COLOURS, STYLE
from curricle.tasks.grid_layout import LETTERS
from curricle.tasks.grid_view import GridView

_REFERENCE = re.compile(r"#([\w-]+)")
_DRAWN = ("d", "transform", "x", "y", "width", "height")
"""Attributes that hold coordinates."""
# Shapes around the middle of a cell one wide: a move north drawn alone, one of several, a stay.
_HALF = ((0.15, -0.05), (0.05, -0.05), (0.05, 0.26))
_ARROW = ((0, -0.26), *_HALF, *((-x, y) for x, y in reversed(_HALF)))
_TIP = ((0, -0.32), (0.1, -0.18), (-0.1, -0.18))
_STAY = ((0, -0.1), (0.1, 0), (0, 0.1), (-0.1, 0))


def inline_svg(figure: Figure, name: str, label: str) -> Markup:
    """Return a figure as an ``<svg>`` element, its text kept as text in the font of the page.

    It scales with the width of its container, refers to nothing outside and shares no identifier
    with an element of another name.
    """
    content = io.BytesIO()
    with matplotlib.rc_context({**STYLE, "svg.fonttype": "none"}):
        figure.savefig(content, format="svg", metadata={"Date": None})
    root = ElementTree.fromstring(content.getvalue())
    for parent in list(root.iter()):
        for child in list(parent):
            # Metadata; and a style rule for *, which would apply to the whole page.
            if child.tag.endswith(("}metadata", "}style")):
                parent.remove(child)
    values = [value for element in root.iter() for value in element.attrib.values()]
    used = {found for value in values for found in _REFERENCE.findall(value)}
    for element in root.iter():
        text = element.text if element.text and element.text.strip() else None
        element.tag, element.text, element.tail = _local(element.tag), text, None
        given = {_local(key): value for key, value in element.attrib.items()}
        element.attrib.clear()
        for key, value in given.items():
            if key != "id":
                element.set(key, _plain(key, value, name))
            elif value in used:
                element.set(key, f"{name}-{value}")
    box = root.get("viewBox", "")
    root.attrib.clear()
    root.attrib.update({"viewBox": box, "role": "img", "aria-label": label})
    root.set("stroke-linejoin", "round")
    return Markup(ElementTree.tostring(root, encoding="unicode"))


def squares(cells: Iterable[tuple[int, int]]) -> str:
    """Return the path of unit squares with these top-left corners, (column, row) each."""
    return "".join(f"M{x} {y}h1v1h-1z" for x, y in cells)


@dataclass(frozen=True)
class GridDrawing:
    """The unchanging parts of a grid, in columns and rows from its top-left cell."""

    columns: int
    rows: int
    lines: str  # path of the lines between cells
    walls: str  # path of the cells in which no state lies
    ended: str  # path of the terminal states
    # What lies in a maze: letter, colour, column, row, and whether it ends the episode.
    objects: tuple[tuple[str, str, int, int, bool], ...]
    letters: tuple[tuple[str, int, int], ...]  # fixed components of the state: letters, column, row
    labels: tuple[tuple[int, int, str], ...]  # column, row and number of each state of a strip
    markers: tuple[tuple[str, str], ...]  # letter and colour of what moves

    @classmethod
    def of(cls, view: GridView) -> "GridDrawing":
        """Return the drawing of a view."""
        (top, left), (rows, columns) = view.origin, view.shape
        across = "".join(f"M0 {y}h{columns}" for y in range(rows + 1))
        down = "".join(f"M{x} 0v{rows}" for x in range(columns + 1))
        cells = shifted(view, view.cells)
        numbered = () if view.is_map else zip(cells, view.states.tolist(), strict=True)
        return cls(
            columns=columns,
            rows=rows,
            lines=across + down,
            walls=squares(shifted(view, view.walls)),
            ended=squares(shifted(view, view.cells[view.ended])),
            objects=tuple(
                (LETTERS[name], TINTS[name], column - left, row - top, ends)
                for name, row, column, ends in view.objects
            ),
            letters=tuple((x, c - left, r - top) for (r, c), x in view.stacked_letters.items()),
            labels=tuple((x, y, str(n)) for (x, y), n in numbered),
            markers=tuple((marker.letter, COLOURS[marker.colour]) for marker in view.markers),
        )


def shifted(view: GridView, cells: IntArray) -> list[tuple[int, int]]:
    """Return column and row from the top-left cell of a view, for (n, 2) rows and columns."""
    return [(x, y) for y, x in (cells - np.array(view.origin)).tolist()]


def move_path(direction: int, *, alone: bool) -> str:
    """Return a move as a path from the middle of a cell and back to it.

    Directions are 0 stay, 1 north, 2 east, 3 south, 4 west. The only greedy move is an arrow, one
    of several the tip of an arrow.
    """
    points: tuple[tuple[float, float], ...] = _STAY
    if direction:
        # A quarter turn from north for each direction after it.
        cos, sin = [(1, 0), (0, 1), (-1, 0), (0, -1)][direction - 1]
        drawn = _ARROW if alone else _TIP
        points = tuple((x * cos - y * sin, x * sin + y * cos) for x, y in drawn)
    way = np.diff(np.array([(0.0, 0.0), *points]), axis=0).round(3).tolist()
    steps = [f"{x:zg},{y:zg}" for x, y in [*way, (-points[0][0], -points[0][1])]]
    # A page may hold thousands of them: 0.5 is written .5.
    return f"m{' '.join(steps[:-1])}zm{steps[-1]}".replace("0.", ".")


def _local(name: str) -> str:
    """Return an XML name without its namespace, which HTML does not need."""
    return name.rpartition("}")[2]


def _plain(key: str, value: str, name: str) -> str:
    """Return an attribute's value: coordinates in hundredths, references renamed, no font."""
    if key in _DRAWN:
        value = re.sub(r"-?\d+\.\d{3,}", lambda found: f"{float(found[0]):z.2f}", value)
        return re.sub(r"\s+", " ", value).strip()
    if "url(" in value or key == "href":
        return _REFERENCE.sub(rf"#{name}-\1", value)
    return re.sub(r"font-family:[^;]*;\s*", "", value)
