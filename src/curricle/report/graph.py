"""The curriculum graph of a study: a card for each task, an arrow for each pair that transfers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.curriculum.curriculum import Curriculum, CurriculumResult
from curricle.learning.budget import ended_by
from curricle.learning.result import LearningResult
from curricle.plotting.scales import minus, rounded
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import mean_interval
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model, same_task
from curricle.transfer.component_mapping import ComponentMapping, describe_renaming
from curricle.transfer.edges import Transfer
from curricle.transfer.observation_mapping import ObservationMapping

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
LARGEST_COVERAGE = 5_000_000
"""Target pairs up to which a mapping's coverage is counted."""


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


def graphs(results: Mapping[str, CurriculumResult], reasons: Reasons) -> tuple[Graph, ...]:
    """Return the graphs of a study; arms whose tasks and transfers are alike share one.

    Parameters
    ----------
    results : dict of str to CurriculumResult
        Of each arm; the scratch baseline has no graph.
    reasons : dict of (str, str) to sequence of str
        From :func:`reasons_by_task`.

    Examples
    --------
    >>> from curricle import GridWorld, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))], budget=1000)
    >>> results = {"corner first": plan.train()}
    >>> graph, = graphs(results, reasons_by_task(results, {}))
    >>> [card.name for card in graph.cards], graph.cards[0].steps, graph.cards[0].reason
    (['corner', 'maze'], '1,000 steps', 'all steps used')
    """
    groups = list[list[str]]()
    for arm, result in results.items():
        if arm == SCRATCH:
            continue
        same = (arms for arms in groups if _alike(results[arms[0]].curriculum, result.curriculum))
        if (group := next(same, None)) is None:
            groups.append([arm])
        else:
            group.append(arm)
    return tuple(_graph(arms, results, reasons) for arms in groups)


def _alike(one: Curriculum, other: Curriculum) -> bool:
    """Return whether two curricula have the same tasks and transfers."""
    if one.order != other.order or len(one.transfers) != len(other.transfers):
        return False
    tasks = all(same_task(one.tasks[name], other.tasks[name]) for name in one.order)
    pairs = zip(one.transfers, other.transfers, strict=True)
    return tasks and all(_same_transfer(mine, yours) for mine, yours in pairs)


def _same_transfer(one: Transfer, other: Transfer) -> bool:
    names = ("source", "target", "scale", "shift", "calibration")
    if any(getattr(one, name) != getattr(other, name) for name in names):
        return False
    return one.mapping is other.mapping or _parts(one.mapping) == _parts(other.mapping)


def _parts(mapping: Any) -> tuple[Any, ...]:
    """Return what tells a mapping from others."""
    if isinstance(mapping, ComponentMapping):
        return (repr(mapping),)
    if isinstance(mapping, ObservationMapping):
        actions = mapping.actions if callable(mapping.actions) else repr(mapping.actions)
        return mapping.observations, actions, mapping.status, mapping.unmapped_value
    return mapping.index.shape, mapping.index.tobytes()


def _graph(arms: Sequence[str], results: Mapping[str, CurriculumResult], reasons: Reasons) -> Graph:
    curriculum = results[arms[0]].curriculum
    compared = {arm: results[arm].nodes for arm in (*arms, SCRATCH) if arm in results}
    curves = {
        name: _curves({arm: nodes[name] for arm, nodes in compared.items() if name in nodes})
        for name in curriculum.order
    }
    heights = {name: CARD_HEIGHT + LINE * len(found) for name, found in curves.items()}
    corners, width, height = _layout(curriculum, heights)
    cards = tuple(
        Card(
            name,
            _kind(curriculum.tasks[name]),
            *corners[name],
            heights[name],
            curves[name],
            _steps([results[arm][name] for arm in arms]),
            _ended([reasons[arm, name] for arm in arms]),
        )
        for name in curriculum.order
    )
    edges = []
    for source, target in dict.fromkeys((t.source, t.target) for t in curriculum.transfers):
        left, top = corners[source]
        start, end = (left, top + heights[source]), corners[target]
        between = [x + CARD for x, y in corners.values() if start[1] < y < end[1]]
        words = [_transfer_words(t) for t in curriculum.in_edges(target) if t.source == source]
        edges.append(Edge(source, target, *_arrow(start, end, between), tuple(words)))
    notes = _notes(arms, results)
    return Graph(tuple(arms), cards, tuple(edges), notes, width, height)


def _kind(task: Any) -> str:
    if is_observation_task(task):
        return f"observations, {task.shapes.replace('->', '→')}"
    generative = generative_model(task)
    states, actions = generative.states.size, generative.actions.size
    return f"{type(task).__name__}, {states:,} states × {actions:,} actions"


def _layout(
    curriculum: Curriculum, heights: Mapping[str, int]
) -> tuple[dict[str, tuple[int, int]], int, int]:
    """Return the corner of each card, and the size of the graph: sources above their targets."""
    depth = dict[str, int]()
    for name in curriculum.order:
        depth[name] = max((depth[t.source] + 1 for t in curriculum.in_edges(name)), default=0)
    rows: dict[int, list[str]] = {}
    for name, row in sorted(depth.items(), key=lambda one: one[1]):
        rows.setdefault(row, []).append(name)
    side = SIDE if any(depth[t.target] - depth[t.source] > 1 for t in curriculum.transfers) else 0
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


def mapping_words(transfer: Transfer) -> str:
    """Return the mapping of a transfer in words.

    Examples
    --------
    >>> from curricle import Pursuit, project
    >>> mapping = project(Pursuit(3, 2), Pursuit(3, 1), predator="predator_2")
    >>> mapping_words(Transfer("chase", "hunt", mapping))
    'predator is predator_2, prey by name'
    """
    mapping = transfer.mapping
    if isinstance(mapping, ComponentMapping):
        names = (*mapping.source.states.names, *mapping.source.actions.names)
        return describe_renaming(names, mapping.renaming)
    if isinstance(mapping, ObservationMapping):
        return mapping.description
    return "state by state and action by action"


def _transfer_words(transfer: Transfer) -> str:
    """Return a transfer in words: its mapping, coverage, scale and shift."""
    words = [mapping_words(transfer)]
    if _countable(transfer.mapping):
        cover = transfer.mapping.coverage()
        words.append(f"{cover.mapped:.0%} of {cover.target_pairs:,} pairs mapped")
        if cover.ended:
            words.append(f"{cover.ended:.0%} at the source's end")
        if cover.unmapped:
            value = minus(f"{transfer.mapping.unmapped_value:g}")
            words.append(f"{cover.unmapped:.0%} unmapped (potential {value})")
    if transfer.scale != 1:
        words.append(f"scaled by {minus(f'{transfer.scale:g}')}")
    if transfer.shift:
        words.append(f"shifted by {minus(f'{transfer.shift:g}')}")
    if transfer.calibration is not None:
        words.append("calibrated in the target")
    return "; ".join(words)


def _countable(mapping: Any) -> bool:
    """Return whether the pairs of a mapping's target are numbered, and few enough to be counted."""
    if isinstance(mapping, ObservationMapping):
        return False
    target = generative_model(mapping.target)
    return target.states.size * target.actions.size <= LARGEST_COVERAGE


def _notes(arms: Sequence[str], results: Mapping[str, CurriculumResult]) -> tuple[str, ...]:
    """Return how several transfers into a task become one potential."""
    notes: dict[str, list[str]] = {}
    for arm in arms:
        curriculum = results[arm].curriculum
        for name in curriculum.order:
            if len(curriculum.in_edges(name)) > 1:
                function = curriculum.setting("aggregate", name)
                called = getattr(function, "__name__", "a custom aggregate")
                words = f"{name} uses the {called} of its transfers"
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


def reasons_by_task(results: Mapping[str, CurriculumResult], decided: Reasons) -> Reasons:
    """Return why every training ended: as a stopping rule decided, or else by its budget."""
    reasons = dict[tuple[str, str], Sequence[str]]()
    for arm, result in results.items():
        for name, node in result.nodes.items():
            budget = result.curriculum.setting("budget", name)
            default = [ended_by(budget, full) for full in node.out_of_memory]
            reasons[arm, name] = decided.get((arm, name)) or default
    return reasons
