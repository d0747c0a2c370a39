"""The graph of a curriculum for a page: cards and arrows with their positions."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from textwrap import wrap
from typing import Any

import numpy as np

from curricle.arrays import FloatArray
from curricle.learning.result import LearningResult
from curricle.show.plots import places
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import extremes, mean_interval
from curricle.study.record import ArmRecord, CurriculaRecord
from curricle.text import rounded

# All in CSS pixels.
CARD, GAP, FALL = 156, 14, 64  # width of a card, and the space between cards, across and down
SIDE, LANE = 44, 26  # space for an arrow that goes round other cards, and for each further one
LINE, NAME_LETTERS, LETTERS = 17, 13, 18  # height of a line; its letters in the name and below
PLAIN, CURVE_SPACE = 20, 52  # height of a card without text, and of a curve on it
BADGE = 24  # space between the middles of two arrows' numbers, which are circles 20 wide


Learnt = Mapping[str, Mapping[str, LearningResult]]  # arm -> task -> its training
Data = dict[str, Any]
Reasons = Mapping[tuple[str, str], Sequence[str]]  # (arm, task) -> why each seed's ended

SWATCH = "\xa0" * 4  # as wide as the sample of a line before the returns of an arm
CURVE, CURVE_HEIGHT, CURVE_POINTS = 140.0, 44.0, 60  # size of a curve, its most checkpoints


def graphs(curricula: CurriculaRecord, learnt: Learnt, reasons: Reasons) -> list[Data]:
    """Return the graphs of a study; arms with equal tasks and transfers share a graph."""
    return [_graph(arms, curricula, learnt, reasons) for arms in curricula.groups()]


def _graph(
    arms: Sequence[str], curricula: CurriculaRecord, learnt: Learnt, reasons: Reasons
) -> Data:
    arm = curricula.arms[arms[0]]
    compared = {name: learnt[name] for name in (*arms, SCRATCH) if name in learnt}
    cards = dict[str, Data]()
    for name in arm.nodes:
        spent = np.concatenate([learnt[owner][name].steps_used for owner in arms])
        least, most = int(spent.min()), int(spent.max())
        ended = Counter(chain.from_iterable(reasons[owner, name] for owner in arms)).most_common()
        several = (f"{reason} ({n} of {len(spent)})" for reason, n in ended)
        curves = card_curves({a: nodes[name] for a, nodes in compared.items() if name in nodes})
        texts = {
            "kind": curricula.task(arms[0], name).kind,
            "steps": f"{least:,} steps" if least == most else f"{least:,} to {most:,} steps",
            "reason": ended[0][0] if len(ended) == 1 else "; ".join(several),
        }
        # As high as its name and its texts need that stand in lines of so many letters.
        written = [*texts.values(), *(SWATCH + curve["words"] for curve in curves)]
        lines = len(wrap(name, NAME_LETTERS)) + sum(len(wrap(text, LETTERS)) for text in written)
        height = PLAIN + CURVE_SPACE * bool(curves) + LINE * lines
        cards[name] = {"name": name, "curves": curves, "height": height, **texts}
    width, height = _lay_out(cards, [(t.source, t.target) for t in arm.transfers])
    # How several transfers into a task become one potential.
    notes: dict[str, list[str]] = {}
    for owner in arms:
        for name, node in curricula.arms[owner].nodes.items():
            if node.aggregate is not None:
                note = f"{name} uses the {node.aggregate} of its transfers."
                notes.setdefault(note, []).append(owner)
    return {
        "arms": tuple(arms),
        "cards": [*cards.values()],
        "edges": [*_edges(arm, cards)],
        "notes": [f"{'; '.join(a)}: " * (len(notes) > 1) + note for note, a in notes.items()],
        "width": width,
        "height": height,
    }


def card_curves(trained: Mapping[str, LearningResult]) -> list[Data]:
    """Return the curves of a task in one scale; arms with equal results share a curve."""
    within = extremes([result.greedy_return for result in trained.values()])
    alike: dict[bytes, list[str]] = {}
    for arm, result in trained.items():
        if not np.isnan(result.greedy_return).all():
            alike.setdefault(result.greedy_return.tobytes(), []).append(arm)
    if not alike:
        return []
    drawn = []
    for arms in alike.values():
        result = trained[arms[0]]
        place = places(len(result.steps), CURVE_POINTS)
        interval = mean_interval(result.greedy_return[:, place]).within(within)
        values = np.array([interval.estimate, interval.low, interval.high])
        values = np.where(np.isnan(values), values[0], values)
        drawn.append((tuple(arms), result, result.steps[place], values))
    low = min(float(np.nanmin(values)) for *_, values in drawn)
    high = max(float(np.nanmax(values)) for *_, values in drawn)
    last = max(int(steps[-1]) for *_, steps, _ in drawn) or 1
    curves = []
    for owners, result, steps, values in drawn:
        x = steps / last * CURVE
        mean, lower, upper = (high - values) / ((high - low) or 1.0) * CURVE_HEIGHT
        band = points([*x, *x[::-1]], [*lower, *upper[::-1]]) * (len(result.seeds) > 1)
        start, end = result.greedy_return[:, [0, -1]].mean(axis=0)
        ends = f"{rounded(start)} → {rounded(end)}"
        curves.append({"arms": owners, "line": points(x, mean), "band": band, "words": ends})
    return curves


def points(x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> str:
    """Return the points of a polyline."""
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


# -- where cards are, sources above their targets, and the arrows between them ---------------------


def _lay_out(cards: Mapping[str, Data], pairs: Sequence[tuple[str, str]]) -> tuple[int, int]:
    """Add left and top to cards, sources above their targets; return width and height of all."""
    depth = dict[str, int]()
    for name in cards:
        depth[name] = max((depth[source] + 1 for source, to in pairs if to == name), default=0)
    rows: dict[int, list[str]] = {}
    for name, row in sorted(depth.items(), key=lambda pair: pair[1]):
        rows.setdefault(row, []).append(name)
    around = {(source, target) for source, target in pairs if depth[target] - depth[source] > 1}
    side = SIDE + (len(around) - 1) * LANE if around else 0
    width = max(len(names) for names in rows.values()) * (CARD + GAP) - GAP + 2 * side
    top = 0
    for names in rows.values():
        left = (width - len(names) * (CARD + GAP) + GAP) // 2
        for place, name in enumerate(names):
            cards[name].update(left=left + place * (CARD + GAP), top=top)
        top += max(cards[name]["height"] for name in names) + FALL
    return width, top - FALL


def _free(curve: FloatArray, taken: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the place of a number on a curve: near the middle, but away from taken places."""
    along = 0.5 + np.array([0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5]) / 14
    rest = 1 - along
    weights = np.stack([rest**3, 3 * rest**2 * along, 3 * rest * along**2, along**3])
    spots = [(float(x), float(y)) for x, y in weights.T @ curve]
    room = [min((math.dist(spot, other) for other in taken), default=math.inf) for spot in spots]
    first = next((n for n, free in enumerate(room) if free >= BADGE), int(np.argmax(room)))
    return spots[first]


def _edges(arm: ArmRecord, cards: Mapping[str, Data]) -> Iterator[Data]:
    """Yield an arrow for each pair of tasks; arrows avoid cards, and numbers avoid each other."""
    pairs: dict[tuple[str, str], list[str]] = {}
    for transfer in arm.transfers:
        pairs.setdefault((transfer.source, transfer.target), []).append(transfer.words)
    taken, around = list[tuple[float, float]](), 0
    for (source, target), labels in pairs.items():
        above, below = cards[source], cards[target]
        bottom, top = above["top"] + above["height"], below["top"]
        passed = [card["left"] + CARD for card in cards.values() if bottom < card["top"] < top]
        x0, x3, y3 = above["left"] + CARD / 2, below["left"] + CARD / 2, top - 7
        x1, x2, middle = x0, x3, (bottom + y3) / 2
        if passed:
            # A cubic's middle is an eighth of each end and three eighths of each inner point: it is
            # right of the cards that the arrow goes round.
            beside = max(passed) + SIDE / 2 + around * LANE
            x1 = x2 = (beside - (x0 + x3) / 8) * 4 / 3
            around += 1
        curve = np.array([(x0, bottom), (x1, middle), (x2, middle), (x3, y3)])
        taken.append(_free(curve, taken))
        path = f"M{x0:g} {bottom:g}C{x1:g} {middle:g} {x2:g} {middle:g} {x3:g} {y3:g}"
        names = {"source": source, "target": target}
        yield {**names, "path": path, "place": taken[-1], "words": labels}
