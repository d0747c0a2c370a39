"""The curriculum graph of a study: a card for each task, an arrow for each pair that transfers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from curricle.array_types import FloatArray
from curricle.learning.result import LearningResult
from curricle.plotting.scales import rounded
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import mean_interval
from curricle.study.record import ArmRecord, CurriculaRecord

Learnt = Mapping[str, Mapping[str, LearningResult]]
"""Arm -> task -> its training."""
Reasons = Mapping[tuple[str, str], Sequence[str]]
"""(arm, task) -> for each seed why its training ended."""

CARD, GAP, FALL = 156, 14, 64
"""Width of a card, and the space between cards, across and down, in CSS pixels."""
SIDE = 44
"""Space at the sides for arrows that go round other cards."""
CARD_HEIGHT, LINE = 156, 17
"""Height of a card without its returns, and of a line."""
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
    """A task of the graph, as a card; its place is in CSS pixels."""

    name: str
    kind: str
    left: int
    top: int
    height: int
    curves: tuple[CardCurve, ...]  # of the arms, and of scratch where it is the target
    steps: str  # how many steps the arms trained it
    reason: str  # why that ended


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
    """Return the graphs of a study; arms whose tasks and transfers are alike share one.

    Parameters
    ----------
    curricula : CurriculaRecord
        The scratch baseline among its arms has no graph.
    learnt : dict of str to dict of str to LearningResult
        Arm -> task -> its training.
    reasons : dict of (str, str) to sequence of str
        (arm, task) -> for each seed why its training ended.

    Examples
    --------
    >>> from curricle import Curriculum, GridWorld, Transfer, same_position
    >>> from curricle.study.recording import curricula_record
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))], budget=1000)
    >>> learnt = {"corner first": plan.train().nodes}
    >>> reasons = {("corner first", name): ["all steps used"] for name in plan.order}
    >>> graph, = graphs(curricula_record({"corner first": plan}, {}), learnt, reasons)
    >>> [card.name for card in graph.cards], graph.cards[0].steps, graph.cards[0].reason
    (['corner', 'maze'], '1,000 steps', 'all steps used')
    """
    return tuple(_graph(arms, curricula, learnt, reasons) for arms in curricula.groups())


def _graph(
    arms: Sequence[str], curricula: CurriculaRecord, learnt: Learnt, reasons: Reasons
) -> Graph:
    arm = curricula.arms[arms[0]]
    compared = {name: learnt[name] for name in (*arms, SCRATCH) if name in learnt}
    curves = {
        name: _curves({one: nodes[name] for one, nodes in compared.items() if name in nodes})
        for name in arm.nodes
    }
    heights = {name: CARD_HEIGHT + LINE * len(found) for name, found in curves.items()}
    corners, width, height = _layout(arm, heights)
    cards = tuple(
        Card(
            name,
            curricula.task(arms[0], name).kind,
            *corners[name],
            heights[name],
            curves[name],
            _steps([learnt[one][name] for one in arms]),
            _ended([reasons[one, name] for one in arms]),
        )
        for name in arm.nodes
    )
    edges = []
    for source, target in dict.fromkeys((t.source, t.target) for t in arm.transfers):
        left, top = corners[source]
        start, end = (left, top + heights[source]), corners[target]
        between = [x + CARD for x, y in corners.values() if start[1] < y < end[1]]
        words = [t.words for t in arm.in_edges(target) if t.source == source]
        edges.append(Edge(source, target, *_arrow(start, end, between), tuple(words)))
    notes = _notes({one: curricula.arms[one] for one in arms})
    return Graph(tuple(arms), cards, tuple(edges), notes, width, height)


def _layout(
    arm: ArmRecord, heights: Mapping[str, int]
) -> tuple[dict[str, tuple[int, int]], int, int]:
    """Return the corner of each card, and the size of the graph: sources above their targets."""
    depth = dict[str, int]()
    for name in arm.nodes:
        depth[name] = max((depth[t.source] + 1 for t in arm.in_edges(name)), default=0)
    rows: dict[int, list[str]] = {}
    for name, row in sorted(depth.items(), key=lambda one: one[1]):
        rows.setdefault(row, []).append(name)
    side = SIDE if any(depth[t.target] - depth[t.source] > 1 for t in arm.transfers) else 0
    width = max(len(names) for names in rows.values()) * (CARD + GAP) - GAP + 2 * side
    corners, top = {}, 0
    for names in rows.values():
        left = (width - len(names) * (CARD + GAP) + GAP) // 2
        for place, name in enumerate(names):
            corners[name] = (left + place * (CARD + GAP), top)
        top += max(heights[name] for name in names) + FALL
    return corners, width, top - FALL


def _arrow(
    start: tuple[int, int], end: tuple[int, int], between: Sequence[int]
) -> tuple[str, tuple[float, float]]:
    """Return the path from below one card to above another, and its middle.

    It goes round the cards in `between`, given by their right edges.
    """
    (x0, y0), (x1, y1) = (start[0] + CARD / 2, start[1]), (end[0] + CARD / 2, end[1] - 7)
    half, middle, inner = (y1 - y0) / 2, (x0 + x1) / 2, (x0, x1)
    if between:
        # A cubic's middle is an eighth of each end and three eighths of each inner point.
        middle = max(between) + SIDE / 2
        inner = ((middle - (x0 + x1) / 8) * 4 / 3,) * 2
    path = f"M{x0:g} {y0}C{inner[0]:g} {y0 + half:g} {inner[1]:g} {y1 - half:g} {x1:g} {y1}"
    return path, (middle, y0 + half)


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


def _curves(trained: Mapping[str, LearningResult]) -> tuple[CardCurve, ...]:
    """Return the curves of one task in one scale; arms that learnt it alike share one."""
    alike: dict[bytes, list[str]] = {}
    for arm, one in trained.items():
        alike.setdefault(one.greedy_return.tobytes(), []).append(arm)
    kept = [(tuple(arms), trained[arms[0]]) for arms in alike.values()]
    curves = []
    for _, one in kept:
        n = len(one.steps)
        place = np.unique(np.linspace(0, n - 1, min(n, CURVE_POINTS)).round().astype(int))
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
        band_points = _points(*outline) if len(one.seeds) > 1 else ""
        words = f"{rounded(ends[0])} → {rounded(ends[1])}"
        found.append(CardCurve(arms, _points(x, mean), band_points, words))
    return tuple(found)


def _points(x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> str:
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
