"""The places of a graph's cards, sources above their targets, and of the arrows between them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np

from curricle.array_types import FloatArray

CARD, GAP, FALL = 156, 14, 64
"""Width of a card, and the space between cards, across and down, in CSS pixels."""
SIDE, LANE = 44, 26
"""Space at the sides for an arrow that goes round other cards, and for each further one."""
LINE, NAME_LETTERS, LETTERS = 17, 13, 18
"""Height of a line of a card in CSS pixels; letters that it holds, in its name and below."""
PLAIN, CURVE_SPACE = 20, 52
"""Height of a card without text, and of a curve on it, in CSS pixels."""
BADGE = 24
"""Space between the middles of two arrows' numbers, which are circles 20 wide."""


@dataclass(frozen=True)
class Layout:
    """Where the cards of a graph are, in CSS pixels."""

    corners: Mapping[str, tuple[int, int]]  # left and top of each card
    heights: Mapping[str, int]
    pairs: tuple[tuple[str, str], ...]  # source and target of each arrow
    width: int
    height: int


@dataclass(frozen=True)
class Arrow:
    """An arrow from one card to another."""

    source: str
    target: str
    path: str
    place: tuple[float, float]  # middle of its number


def card_height(name: str, texts: Sequence[str], *, curve: bool = True) -> int:
    """Return the height at which a card holds its name and its texts whole, in CSS pixels.

    Examples
    --------
    >>> card_height("maze", ["GridWorld"]), card_height("maze", ["25 states x 4 actions"])
    (106, 123)
    """
    lines = len(wrap(name, NAME_LETTERS)) + sum(len(wrap(text, LETTERS)) for text in texts)
    return PLAIN + CURVE_SPACE * curve + LINE * lines


def layout(heights: Mapping[str, int], pairs: Sequence[tuple[str, str]]) -> Layout:
    """Return where cards are: sources above their targets.

    Parameters
    ----------
    heights : dict of str to int
        Of each card, sources before their targets.
    pairs : sequence of (str, str)
        Source and target of each transfer; those that are equal have one arrow.

    Examples
    --------
    >>> layout({"corner": 100, "maze": 100}, [("corner", "maze")]).corners
    {'corner': (0, 0), 'maze': (0, 164)}
    """
    depth = dict[str, int]()
    for name in heights:
        depth[name] = max((depth[source] + 1 for source, to in pairs if to == name), default=0)
    rows: dict[int, list[str]] = {}
    for name, row in sorted(depth.items(), key=lambda one: one[1]):
        rows.setdefault(row, []).append(name)
    around = {(source, target) for source, target in pairs if depth[target] - depth[source] > 1}
    side = SIDE + (len(around) - 1) * LANE if around else 0
    width = max(len(names) for names in rows.values()) * (CARD + GAP) - GAP + 2 * side
    corners, top = dict[str, tuple[int, int]](), 0
    for names in rows.values():
        left = (width - len(names) * (CARD + GAP) + GAP) // 2
        for place, name in enumerate(names):
            corners[name] = (left + place * (CARD + GAP), top)
        top += max(heights[name] for name in names) + FALL
    return Layout(corners, dict(heights), tuple(dict.fromkeys(pairs)), width, top - FALL)


def arrows(placed: Layout) -> Iterator[Arrow]:
    """Yield an arrow for each pair of cards; none on another, and no number on another.

    Examples
    --------
    >>> [one.path for one in arrows(layout({"a": 10, "b": 10}, [("a", "b")]))]
    ['M78 10C78 38.5 78 38.5 78 67']
    """
    places, around = list[tuple[float, float]](), 0
    for source, target in placed.pairs:
        left, top = placed.corners[source]
        start, end = (left, top + placed.heights[source]), placed.corners[target]
        between = [x + CARD for x, y in placed.corners.values() if start[1] < y < end[1]]
        curve = _arrow(start, end, max(between) + SIDE / 2 + around * LANE if between else None)
        around += bool(between)
        places.append(_free(curve, places))
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = curve.tolist()
        path = f"M{x0:g} {y0:g}C{x1:g} {y1:g} {x2:g} {y2:g} {x3:g} {y3:g}"
        yield Arrow(source, target, path, places[-1])


def _arrow(start: tuple[int, int], end: tuple[int, int], beside: float | None) -> FloatArray:
    """Return the curve from below one card to above another: the points of a cubic, (4, 2).

    Its middle is at the horizontal position `beside`, right of the cards that it goes round.
    """
    (x0, y0), (x1, y1) = (start[0] + CARD / 2, start[1]), (end[0] + CARD / 2, end[1] - 7)
    middle, inner = (y0 + y1) / 2, (x0, x1)
    if beside is not None:
        # A cubic's middle is an eighth of each end and three eighths of each inner point.
        inner = ((beside - (x0 + x1) / 8) * 4 / 3,) * 2
    return np.array([(x0, y0), (inner[0], middle), (inner[1], middle), (x1, y1)])


def _free(curve: FloatArray, taken: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the place of a number on a curve: near its middle, but apart from those taken."""
    along = 0.5 + np.array([0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5]) / 14
    rest = 1 - along
    weights = np.stack([rest**3, 3 * rest**2 * along, 3 * rest * along**2, along**3])
    spots = [(float(x), float(y)) for x, y in weights.T @ curve]
    room = [min((math.dist(spot, one) for one in taken), default=math.inf) for spot in spots]
    first = next((n for n, free in enumerate(room) if free >= BADGE), int(np.argmax(room)))
    return spots[first]
