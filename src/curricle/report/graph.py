"""The graph of a curriculum for a page: cards, arrows, and where they are."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from textwrap import wrap

import numpy as np

from curricle.arrays import FloatArray
from curricle.learning.result import LearningResult
from curricle.plotting.learning_curves import places
from curricle.plotting.scales import rounded
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import mean_interval
from curricle.study.record import ArmRecord, CurriculaRecord

# -- The places of a graph's cards, sources above their targets, and of the arrows between them ----

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


Corners = dict[str, tuple[int, int]]
"""Left and top of each card, in CSS pixels."""


def layout(
    heights: Mapping[str, int], pairs: Sequence[tuple[str, str]]
) -> tuple[Corners, int, int]:
    """Return where cards are, sources above their targets, and width and height of all.

    `heights` holds the height of each card, sources before their targets, `pairs` the source and
    the target of each transfer.
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
    corners, top = Corners(), 0
    for names in rows.values():
        left = (width - len(names) * (CARD + GAP) + GAP) // 2
        for place, name in enumerate(names):
            corners[name] = (left + place * (CARD + GAP), top)
        top += max(heights[name] for name in names) + FALL
    return corners, width, top - FALL


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


# -- The curriculum graph of a study: a card for each task, an arrow for each pair that transfers --

Learnt = Mapping[str, Mapping[str, LearningResult]]
"""Arm -> task -> its training."""
Reasons = Mapping[tuple[str, str], Sequence[str]]
"""(arm, task) -> for each seed why its training ended."""

SWATCH = "\xa0" * 4
"""As wide as the sample of a line before the returns of an arm."""
CURVE, CURVE_HEIGHT, CURVE_POINTS = 140.0, 44.0, 60
"""Size of the curve on a card, and its checkpoints at most."""


@dataclass(frozen=True)
class CardCurve:
    """A small learning curve on a card."""

    arms: tuple[str, ...]  # those that learnt alike; it has the colour of the first
    line: str  # the points of its mean
    band: str  # the points of its band; empty for a single seed
    words: str  # mean return at its start and its end


@dataclass(frozen=True)
class Card:
    """A task of the graph, as a card."""

    name: str
    kind: str
    curves: tuple[CardCurve, ...]  # of the arms, and of scratch where it is the target
    steps: str  # how many steps the arms trained it
    reason: str  # why that ended
    left: int = 0  # in CSS pixels
    top: int = 0

    @property
    def height(self) -> int:
        """The height at which it holds its name and its texts whole, in CSS pixels."""
        returns = (SWATCH + curve.words for curve in self.curves)
        texts = self.kind, *returns, self.steps, self.reason
        lines = len(wrap(self.name, NAME_LETTERS)) + sum(len(wrap(x, LETTERS)) for x in texts)
        return PLAIN + CURVE_SPACE * bool(self.curves) + LINE * lines


@dataclass(frozen=True)
class Edge:
    """All transfers from one task to another."""

    source: str
    target: str
    path: str  # of its arrow
    place: tuple[float, float]  # middle of its number
    words: tuple[str, ...]  # a sentence for each transfer


@dataclass(frozen=True)
class Graph:
    """A graph that one or several arms share."""

    arms: tuple[str, ...]
    cards: tuple[Card, ...]  # in the order of training
    edges: tuple[Edge, ...]
    notes: tuple[str, ...]  # how each arm combines several transfers into one task
    width: int  # in CSS pixels, as the height
    height: int


def graphs(curricula: CurriculaRecord, learnt: Learnt, reasons: Reasons) -> tuple[Graph, ...]:
    """Return the graphs of a study; arms whose tasks and transfers are alike share one."""
    return tuple(_graph(arms, curricula, learnt, reasons) for arms in curricula.groups())


def _graph(
    arms: Sequence[str], curricula: CurriculaRecord, learnt: Learnt, reasons: Reasons
) -> Graph:
    arm = curricula.arms[arms[0]]
    compared = {name: learnt[name] for name in (*arms, SCRATCH) if name in learnt}
    cards = {
        name: Card(
            name,
            curricula.task(arms[0], name).kind,
            card_curves({one: nodes[name] for one, nodes in compared.items() if name in nodes}),
            _steps([learnt[one][name] for one in arms]),
            _ended([reasons[one, name] for one in arms]),
        )
        for name in arm.nodes
    }
    heights = {name: card.height for name, card in cards.items()}
    corners, width, height = layout(heights, [(t.source, t.target) for t in arm.transfers])
    for name, (left, top) in corners.items():
        cards[name] = replace(cards[name], left=left, top=top)
    notes = _notes({one: curricula.arms[one] for one in arms})
    edges = tuple(_edges(arm, cards))
    return Graph(tuple(arms), tuple(cards.values()), edges, notes, width, height)


def _edges(arm: ArmRecord, cards: Mapping[str, Card]) -> Iterator[Edge]:
    """Yield an arrow for each pair of tasks: none on a card, and no number on another."""
    pairs: dict[tuple[str, str], list[str]] = {}
    for transfer in arm.transfers:
        pairs.setdefault((transfer.source, transfer.target), []).append(transfer.words)
    taken, around = list[tuple[float, float]](), 0
    for (source, target), words in pairs.items():
        above, below = cards[source], cards[target]
        start, end = (above.left, above.top + above.height), (below.left, below.top)
        between = [one.left + CARD for one in cards.values() if start[1] < one.top < end[1]]
        curve = _arrow(start, end, max(between) + SIDE / 2 + around * LANE if between else None)
        around += bool(between)
        taken.append(_free(curve, taken))
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = curve.tolist()
        path = f"M{x0:g} {y0:g}C{x1:g} {y1:g} {x2:g} {y2:g} {x3:g} {y3:g}"
        yield Edge(source, target, path, taken[-1], tuple(words))


def _notes(arms: Mapping[str, ArmRecord]) -> tuple[str, ...]:
    """Return how several transfers into a task become one potential."""
    notes: dict[str, list[str]] = {}
    for arm, record in arms.items():
        for name, node in record.nodes.items():
            if node.aggregate is not None:
                words = f"{name} uses the {node.aggregate} of its transfers"
                notes.setdefault(words, []).append(arm)
    if len(notes) == 1:
        return (f"{next(iter(notes))}.",)
    return tuple(f"{'; '.join(owners)}: {words}." for words, owners in notes.items())


def card_curves(trained: Mapping[str, LearningResult]) -> tuple[CardCurve, ...]:
    """Return the curves of one task in one scale; arms that learnt it alike share one.

    An arm that was not evaluated in the task has none.
    """
    alike: dict[bytes, list[str]] = {}
    for arm, one in trained.items():
        if not np.isnan(one.greedy_return).all():
            alike.setdefault(one.greedy_return.tobytes(), []).append(arm)
    if not alike:
        return ()
    kept = [(tuple(arms), trained[arms[0]]) for arms in alike.values()]
    curves = []
    for _, one in kept:
        place = places(len(one.steps), CURVE_POINTS)
        band = mean_interval(one.greedy_return[:, place])
        drawn = np.array([band.estimate, band.low, band.high])
        curves.append((one.steps[place], np.where(np.isnan(drawn), drawn[0], drawn)))
    low = min(float(np.nanmin(values)) for _, values in curves)
    high = max(float(np.nanmax(values)) for _, values in curves)
    last = max(int(steps[-1]) for steps, _ in curves) or 1
    found = []
    for (arms, one), (steps, values) in zip(kept, curves, strict=True):
        x = steps / last * CURVE
        mean, lower, upper = (high - values) / ((high - low) or 1.0) * CURVE_HEIGHT
        outline = [*x, *x[::-1]], [*lower, *upper[::-1]]
        ends = one.greedy_return[:, [0, -1]].mean(axis=0)
        band_points = points(*outline) if len(one.seeds) > 1 else ""
        words = f"{rounded(ends[0])} → {rounded(ends[1])}"
        found.append(CardCurve(arms, points(x, mean), band_points, words))
    return tuple(found)


def points(x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> str:
    """Return the points of a polyline."""
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def _steps(trained: Sequence[LearningResult]) -> str:
    spent = np.concatenate([one.steps_used for one in trained])
    least, most = int(spent.min()), int(spent.max())
    return f"{least:,} steps" if least == most else f"{least:,} to {most:,} steps"


def _ended(reasons: Sequence[Sequence[str]]) -> str:
    """Return why trainings of a task ended, the most frequent reason first."""
    counts = Counter(chain.from_iterable(reasons))
    if len(counts) == 1:
        return next(iter(counts))
    return "; ".join(f"{reason} ({n} of {counts.total()})" for reason, n in counts.most_common())
