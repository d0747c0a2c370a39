"""The pictures of a design's page: its recipes by cost and saving, its races, its recipe."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from curricle.array_types import FloatArray
from curricle.design.racing import PLACEBO, Race
from curricle.design.recipe import Recipe, Stage
from curricle.design.recipe_design import FIXED
from curricle.design.trends import Trend
from curricle.report.graph import CURVE, CURVE_HEIGHT, Arrow, arrows, card_height, layout, points
from curricle.statistics.curves import SCRATCH

SIZES = {"wide": (640, 400), "narrow": (340, 340)}
"""Of the scatter on a desktop and on a phone, in CSS pixels."""
LEFT, RIGHT, TOP, BOTTOM = 44, 20, 30, 44
"""Space around its axes."""
STEPS_OF_TICKS = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
MOST_TICKS = 6
APART = 15
"""Between the labels of the scatter, down, in CSS pixels."""
CONTROLS = (SCRATCH, PLACEBO, FIXED)
MOST_ROWS = 20
"""Recipes of a race that are shown; its controls besides."""
BEYOND = 4.0
"""A trend is drawn up to so many times the states of the largest miniature."""
POINTS = 40
ENTERS = {
    "initialise": "its values are the start of Q",
    "guarded": "its values are the start of Q, with a guard",
    "look-ahead": "its values advise actions (look-ahead advice)",
    "state": "its values shape the rewards (a potential of states)",
}
"""Ways of a recipe, in words."""


@dataclass(frozen=True)
class Dot:
    """A recipe, or a control, of the scatter."""

    name: str
    kind: str  # "arm", "scratch", "placebo" or "fixed"
    winner: bool
    cost: float  # source steps over the steps of scratch
    saving: float  # 1 less its steps over those of scratch
    title: str
    x: float
    y: float


@dataclass(frozen=True)
class Scatter:
    """The recipes of a race by what their sources cost and what they save, in CSS pixels."""

    width: int
    height: int
    dots: tuple[Dot, ...]
    labels: tuple[tuple[str, float, float, str], ...]  # text, x, y, text-anchor
    across: tuple[tuple[str, float], ...]  # ticks: text, x
    down: tuple[tuple[str, float], ...]
    zero: float  # y of no saving


def last_scores(found: Race) -> dict[str, float]:
    """Return the score of each arm, scratch and the placebo in the last round that it was in."""
    return {name: score for one in found.rounds for name, score in one.scores.items()}


def scatter(found: Race, size: str = "wide") -> Scatter:
    """Return the scatter of a race.

    Parameters
    ----------
    found : Race
    size : {"wide", "narrow"}
    """
    width, height = SIZES[size]
    scores = last_scores(found)
    costs = {name: found.source_share(name) for name in scores}
    savings = {name: 1 - score for name, score in scores.items()}
    x_ticks = _ticks(0.0, max(costs.values()))
    y_ticks = _ticks(min(0.0, *savings.values()), max(0.0, *savings.values()))

    def across(cost: float) -> float:
        return LEFT + (cost - x_ticks[0]) / (x_ticks[-1] - x_ticks[0]) * (width - LEFT - RIGHT)

    def down(saving: float) -> float:
        share = (saving - y_ticks[0]) / (y_ticks[-1] - y_ticks[0])
        return height - BOTTOM - share * (height - TOP - BOTTOM)

    dots = tuple(
        Dot(
            name,
            {SCRATCH: "scratch", PLACEBO: "placebo", FIXED: "fixed"}.get(name, "arm"),
            name == found.leader,
            cost,
            savings[name],
            _title(found, name, cost, savings[name]),
            round(across(cost), 1),
            round(down(savings[name]), 1),
        )
        for name, cost in costs.items()
    )
    return Scatter(
        width,
        height,
        tuple(sorted(dots, key=lambda one: (one.winner, one.kind != "arm"))),
        tuple(_labels(dots, width)),
        tuple((f"{one:.0%}", round(across(one), 1)) for one in x_ticks),
        tuple((f"{one:.0%}".replace("-", "−"), round(down(one), 1)) for one in y_ticks),
        round(down(0.0), 1),
    )


def _title(found: Race, name: str, cost: float, saving: float) -> str:
    """Return what a dot says where it is pointed at."""
    steps, sources = (np.concatenate(of[name]).mean() for of in (found.steps, found.source_steps))
    return (
        f"{name}: saves {saving:.0%} of the steps from scratch; {steps:,.0f} steps a run, "
        f"{sources:,.0f} of them in sources ({cost:.0%} of scratch)"
    )


def _ticks(low: float, high: float) -> list[float]:
    """Return even ticks around a range; at least two.

    Examples
    --------
    >>> _ticks(-0.13, 0.6)
    [-0.2, 0.0, 0.2, 0.4, 0.6]
    """
    for step in STEPS_OF_TICKS:
        first, last = math.floor(low / step + 1e-9), max(1, math.ceil(high / step - 1e-9))
        if last - first < MOST_TICKS:
            break
    return [round(n * step, 10) + 0.0 for n in range(first, last + 1)]


def _labels(dots: Sequence[Dot], width: int) -> Iterator[tuple[str, float, float, str]]:
    """Yield the labels of the winner and the controls, none on another."""
    named = sorted((one for one in dots if one.winner or one.kind != "arm"), key=lambda one: one.y)
    last = -math.inf
    for one in named:
        text = one.name if one.kind != "arm" else ""
        text += (", winner" if text else "winner") if one.winner else ""
        y = max(one.y + (-5 if one.kind == "scratch" else 4), last + APART)  # above the line
        last = y
        left = one.x > width * 0.7
        yield text, one.x + (-9 if left else 9), y, "end" if left else "start"


@dataclass(frozen=True)
class BracketRow:
    """An arm of a race, and how it went."""

    name: str
    control: bool
    winner: bool
    cells: tuple[tuple[str, str], ...]  # of each round: "in", "kept" or "out", and its saving


@dataclass(frozen=True)
class BracketRound:
    """What a round of a race was."""

    arms: int  # besides scratch and the placebo
    runs: int
    cost: float


@dataclass(frozen=True)
class Bracket:
    """A race, its rounds from left to right."""

    rounds: tuple[BracketRound, ...]
    rows: tuple[BracketRow, ...]  # the last to stay first
    more: int  # arms that are not shown
    cost: float
    ended: str


def bracket(found: Race) -> Bracket:
    """Return a race as its rounds, and a row for each of the best arms and its controls."""
    names = list(found.ranking)
    shown = [name for n, name in enumerate(names) if n < MOST_ROWS or name in CONTROLS]
    if PLACEBO in last_scores(found):
        shown.append(PLACEBO)
    rows = []
    for name in shown:
        cells = []
        for number, one in enumerate(found.rounds):
            later = found.rounds[number + 1 :]
            going = "kept" if later and name in later[0].scores else "in"
            score = one.scores.get(name)
            cells.append(("out", "") if score is None else (going, _percent(1 - score)))
        rows.append(BracketRow(name, name in CONTROLS, name == found.leader, tuple(cells)))
    rounds = tuple(
        BracketRound(len(set(one.scores) - {SCRATCH, PLACEBO}), one.runs, one.cost)
        for one in found.rounds
    )
    more = len(names) - len([name for name in shown if name != PLACEBO])
    return Bracket(rounds, tuple(rows), more, sum(one.cost for one in rounds), found.ended)


@dataclass(frozen=True)
class TrendCurve:
    """Steps a state over the states of the target, both axes logarithmic."""

    line: str  # over the miniatures
    beyond: str  # up to :data:`BEYOND` times the largest of them
    band: str  # of the 95 % interval; empty without one
    words: str


@dataclass(frozen=True)
class StageCard:
    """A source of a recipe, or its target, as a card."""

    name: str
    words: tuple[str, ...]
    curve: TrendCurve | None
    target: bool
    left: int
    top: int
    height: int


@dataclass(frozen=True)
class RecipeGraph:
    """A recipe: its stages and the target, and how the values of one enter the next."""

    cards: tuple[StageCard, ...]
    edges: tuple[Arrow, ...]
    words: tuple[tuple[str, str, str], ...]  # of each edge: its source, target, and how
    width: int
    height: int


def recipe_graph(recipe: Recipe, sizes: Sequence[int]) -> RecipeGraph:
    """Return the graph of a recipe that has stages.

    Parameters
    ----------
    recipe : Recipe
    sizes : sequence of int
        States of the miniatures, over which trends are drawn; empty where they have none.

    Examples
    --------
    >>> from curricle.design.relations import Relation
    >>> graph = recipe_graph(Recipe([Stage(Relation("crop", 0.5), 40)]), [9, 16])
    >>> [(card.name, card.words) for card in graph.cards]
    [('crop 0.5', ('40 steps a state',)), ('target', ('until it is learnt',))]
    """
    keys = [f"{n}" for n in range(len(recipe.stages) + 1)]
    curves = [trend_curve(stage.steps, sizes) for stage in recipe.stages]
    names = [str(one.relation) for one in recipe.stages] + ["target"]
    words = [tuple(_stage_words(recipe, one)) for one in recipe.stages] + [("until it is learnt",)]
    heights = {
        key: card_height(name, text, curve=curve is not None)
        for key, name, text, curve in zip(keys, names, words, [*curves, None], strict=True)
    }
    placed = layout(heights, list(_pairs(recipe, keys)))
    cards = tuple(
        StageCard(name, text, curve, name == "target", *placed.corners[key], placed.heights[key])
        for key, name, text, curve in zip(keys, names, words, [*curves, None], strict=True)
    )
    edges = tuple(arrows(placed))  # by the number of their stages: names may be alike
    known = dict(zip(keys, names, strict=True))
    how = tuple(
        (known[one.source], known[one.target], _enters(recipe, known[one.target])) for one in edges
    )
    return RecipeGraph(cards, edges, how, placed.width, placed.height)


def _pairs(recipe: Recipe, keys: Sequence[str]) -> Iterator[tuple[str, str]]:
    for n, key in enumerate(keys[:-1]):
        yield key, keys[n + 1] if recipe.chain else keys[-1]


def _stage_words(recipe: Recipe, stage: Stage) -> Iterator[str]:
    steps = stage.steps
    if steps.slope:
        yield (
            "steps a state grow with the target"
            if steps.slope > 0
            else ("steps a state fall with the target")
        )
    else:
        yield f"{steps.level:.3g}{_limits(steps, steps.around)} steps a state"
    if stage.settled:
        yield "less where its return has settled"
    if recipe.annealed:
        yield "annealed learning rate"


def _enters(recipe: Recipe, target: str) -> str:
    """Return how values enter a card."""
    if target != "target":
        return ENTERS["initialise"]
    scale = recipe.scale
    how = [ENTERS[recipe.shaping]]
    how += [f"the {recipe.aggregate} of several"] if recipe.aggregate != "mean" else []
    if isinstance(scale, str):
        how.append(scale)
    elif str(scale) != "1":
        how.append(f"times {scale}")
    return ", ".join(how)


def trend_curve(steps: Trend, sizes: Sequence[int]) -> TrendCurve | None:
    """Return a number over the states of the target; None for a constant, or without sizes.

    Examples
    --------
    >>> print(trend_curve(Trend(40.0, slope=0.5, around=16.0), [9, 36]).words)
    30 steps a state at 9 states, 60 at 36
    """
    if steps.slope == 0 or not sizes:
        return None
    low, middle = min(sizes), max(sizes)
    states = np.geomspace(low, middle * BEYOND, POINTS)
    values = np.log([steps.at(one) for one in states])
    bounds = np.log(np.array([steps.interval(one) for one in states]))
    drawn = np.where(np.isnan(bounds), values[:, None], bounds)
    bottom, top = float(drawn.min()), float(drawn.max())
    x = np.linspace(0, CURVE, POINTS)

    def y(found: FloatArray) -> FloatArray:
        return np.asarray((top - found) / ((top - bottom) or 1.0) * CURVE_HEIGHT)

    seen = int(np.searchsorted(states, middle * (1 + 1e-9)))
    outline = np.concatenate([y(drawn[:, 0]), y(drawn[::-1, 1])])
    return TrendCurve(
        points(x[:seen], y(values[:seen])),
        points(x[seen - 1 :], y(values[seen - 1 :])),
        points(np.concatenate([x, x[::-1]]), outline) if len(np.asarray(steps.draws)) else "",
        f"{steps.at(low):.3g}{_limits(steps, low)} steps a state at {low:,} states, "
        f"{steps.at(middle):.3g}{_limits(steps, middle)} at {middle:,}",
    )


def _limits(trend: Trend, states: float) -> str:
    low, high = trend.interval(states)
    return "" if math.isnan(low) else f" [{low:.3g}, {high:.3g}]"


def _percent(share: float) -> str:
    return f"{round(share, 2) + 0.0:.0%}".replace("-", "−")  # no minus before a zero
