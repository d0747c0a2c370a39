"""Replays of training: one seed's values and greedy actions, and an episode before and after.

The page holds three drawn moments of a replay; its script draws the rest from :meth:`Replay.data`.
"""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatTable, IntArray
from curricle.learning.record import Snapshots
from curricle.pictures.scenes import on_grid
from curricle.pictures.views import GridView, stacked
from curricle.show.graph import Learnt
from curricle.show.plots import places
from curricle.show.style import (
    COLOURS,
    MOST_NUMBERS,
    SHADES,
    TINTS,
    digits_of,
    shades_of,
    value_scale,
)
from curricle.study.record import Analysis, CurriculaRecord, EpisodePair, EpisodeRecord
from curricle.tasks.grid import LETTERS
from curricle.text import counted, minus, rounded

MOST_MOMENTS = 48  # moments of one training at most
MOST_CELLS = 16_000  # of all replays, each printed at three moments: under four megabytes
MOST_CELL_MOMENTS = 400_000  # cells times moments of all replays together: a megabyte and a half
LEVELS = 2**16  # levels between the lowest and the highest value to which values are rounded
IN_SCRIPT = "places", "returns", "words", "drawings", "drawn"  # of an episode
LONGEST_WORD = 9  # letters of an action's name up to which it is written into a cell
APART = 0.2  # distance of markers from the middle of a cell, where there are several
# Shapes around the middle of a cell one wide: a move north drawn alone, one of several, a stay.
_HALF = ((0.15, -0.05), (0.05, -0.05), (0.05, 0.26))
_ARROW = ((0, -0.26), *_HALF, *((-x, y) for x, y in reversed(_HALF)))
_TIP = ((0, -0.32), (0.1, -0.18), (-0.1, -0.18))
_STAY = ((0, -0.1), (0.1, 0), (0, 0.1), (-0.1, 0))


# -- a grid as SVG ---------------------------------------------------------------------------------


def squares(cells: Iterable[tuple[int, int]]) -> str:
    """Return the path of unit squares with these top-left corners, (column, row) each."""
    return "".join(f"M{x} {y}h1v1h-1z" for x, y in cells)


def grid_drawing(view: GridView) -> dict[str, Any]:
    """Return the unchanging parts of a grid, in columns and rows from its top-left cell."""
    (top, left), (rows, columns) = view.origin, view.shape
    lines = [f"M0 {y}h{columns}" for y in range(rows + 1)]
    lines += [f"M{x} 0v{rows}" for x in range(columns + 1)]
    numbered = zip(shifted(view, view.cells), view.states.tolist(), strict=True)
    return {
        "columns": columns,
        "rows": rows,
        # Paths: the lines between cells, cells in which no state lies, and terminal states.
        "lines": "".join(lines),
        "walls": squares(shifted(view, view.walls)),
        "bars": "".join(
            f"M{x} {y + 1}h1" if side else f"M{x + 1} {y}v1"
            for side, y, x in np.argwhere(on_grid(view.bars, view.shape)).tolist()
        ),
        "ended": squares(shifted(view, view.cells[view.ended])),
        # What lies in a maze: letter, colour, column, row, and whether it ends the episode.
        "objects": [
            (LETTERS[name], TINTS[name], column - left, row - top, ends)
            for name, row, column, ends in view.objects
        ],
        # Fixed components of the state, the number of each state of a strip, and what moves.
        "letters": [(x, c - left, r - top) for (r, c), x in stacked(view.letters).items()],
        "labels": [] if view.is_map else [(x, y, str(n)) for (x, y), n in numbered],
        "markers": [(marker.letter, COLOURS[marker.colour]) for marker in view.markers],
    }


def shifted(view: GridView, cells: IntArray) -> list[tuple[int, int]]:
    """Return column and row from the top-left cell of a view, for (n, 2) rows and columns."""
    return [(x, y) for y, x in (cells - np.array(view.origin)).tolist()]


def move_path(direction: int, *, alone: bool) -> str:
    """Return a move as a path around a cell's middle: an arrow, or only a tip if moves tie."""
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


# -- greedy choices in cells -----------------------------------------------------------------------


def _options(view: GridView) -> IntArray:
    """Return the move of each action, or its number where actions are no moves, (A,)."""
    return np.arange(len(view.actions)) if view.directions is None else np.array(view.directions)


def greedy_choices(view: GridView, values: FloatTable) -> BoolArray:
    """Return which moves, or actions without moves, are greedy: (..., A) -> (..., O) bool."""
    greedy = values == values.max(axis=-1, keepdims=True)
    options = _options(view)
    chosen = [greedy[..., options == option].any(axis=-1) for option in np.unique(options)]
    return np.stack(chosen, axis=-1)


def mark_of(view: GridView, chosen: BoolArray) -> str:
    """Return the path that marks greedy choices, (O,), in a cell; empty if all are equally good."""
    if chosen.all() and len(chosen) > 1:
        return ""
    best = np.unique(_options(view))[chosen].tolist()
    if view.directions is not None:
        return "".join(move_path(move, alone=len(best) == 1) for move in best)
    names = [(view.actions[action], str(action)) for action in best]
    return "/".join(name if len(name) <= LONGEST_WORD else number for name, number in names)


# -- replays ---------------------------------------------------------------------------------------


def shown_episode(record: EpisodeRecord, columns: int) -> dict[str, Any]:
    """Return a greedy episode of n states on a grid: its end, and the cells of its markers."""
    cells, (n, markers) = record.cells, record.cells.shape
    turn = 2 * np.pi * np.arange(markers) / markers
    # Several markers stand apart within a cell.
    aside = APART * (markers > 1) * np.stack([-np.cos(turn), -np.sin(turn)], axis=1)
    corner = np.stack([cells % columns, cells // columns], axis=-1)
    points = (corner + 0.5 + aside).round(2)  # (n, markers, 2)
    how, last = "terminated" if record.terminated else "truncated", rounded(record.returns[-1])
    return {
        "words": f"{how} after {counted(n - 1, 'step')}, return {last}",
        # Of each marker the points of its path, and where it starts as a CSS translation.
        "trails": [" ".join(f"{x:g},{y:g}" for x, y in points[:, m]) for m in range(markers)],
        "drawings": record.drawings,
        "drawn": record.drawn.tolist(),
        "starts": [f"{x:g}px, {y:g}px" for x, y in points[0]],
        "places": points.reshape(n, -1).tolist(),
        "returns": [rounded(value) for value in record.returns],
    }


@dataclass(frozen=True, eq=False)
class Replay:
    """Values and greedy choices of one seed at M moments of training, in the n cells of a view."""

    key: str  # unique in the page
    task: str
    arms: tuple[str, ...]  # those that trained it alike
    view: GridView
    seed: int
    steps: IntArray  # (M,)
    cells: tuple[tuple[int, int], ...]  # column and row of the n states that are not terminal
    levels: npt.NDArray[np.uint16]  # (M, n): max_a Q(s, a), from low (0) to high (65,535)
    choices: IntArray  # (M, n): numbers of marks
    marks: tuple[str, ...]  # how choices are drawn
    low: float  # return
    high: float
    palette: str  # the colour map of values
    digits: int | None  # decimals of the numbers in cells; None where there are too many cells
    episodes: Mapping[str, Any]  # "before" and "after"; empty where they are not shown

    @cached_property
    def grid(self) -> dict[str, Any]:
        """The parts of the drawing that do not change."""
        return grid_drawing(self.view)

    def moment(self, place: int) -> dict[str, Any]:
        """Return the moment at a place, ready to be drawn."""
        shade = self.levels[place].astype(np.int64) * SHADES // LEVELS
        marks = [
            (*cell, self.marks[k]) for cell, k in zip(self.cells, self.choices[place], strict=True)
        ]
        arrows = self.view.directions is not None
        numbers, middle = list[tuple[int, int, str]](), 0.5
        if self.digits is not None:
            values = self.low + (self.high - self.low) * self.levels[place] / (LEVELS - 1)
            texts = [minus(f"{value:z.{self.digits}f}") for value in values]
            numbers = [(*cell, text) for cell, text in zip(self.cells, texts, strict=True)]
            middle = 0.4
        cells = np.array(self.cells)
        paths = [f"M{x}.5 {y + middle:g}{mark}" for x, y, mark in marks if mark]
        return {
            "step": int(self.steps[place]),
            # A colour, and the path of all cells that have it.
            "heat": [
                (colour, squares(cells[shade == number].tolist()))
                for number, colour in enumerate(shades_of(self.palette))
                if (shade == number).any()
            ],
            # Choices are arrows or texts; texts and values of cells: column, row, text.
            "choice": "".join(paths) if arrows else "",
            "texts": [] if arrows else marks,
            "numbers": numbers,
        }

    def data(self) -> dict[str, Any]:
        """Return all moments for the script of the page."""
        names = ("marks", "low", "high", "digits", "palette")
        return {name: getattr(self, name) for name in names} | {
            "arrows": self.view.directions is not None,
            "steps": self.steps.tolist(),
            "cells": [number for cell in self.cells for number in cell],
            "levels": base64.b64encode(self.levels.astype("<u2").tobytes()).decode(),
            "choices": ["".join(chr(48 + number) for number in row) for row in self.choices],
            "episodes": {
                name: {key: episode[key] for key in IN_SCRIPT}
                for name, episode in self.episodes.items()
            },
        }


def replays(
    curricula: CurriculaRecord, learnt: Learnt, analysis: Analysis
) -> tuple[tuple[Replay, ...], tuple[str, ...]]:
    """Return the replays of all snapshots, the last task first, and the tasks too large to show."""
    # Tasks with snapshots, and their arms; equal names may be two tasks.
    depths, owners_of = dict[str, int](), dict[tuple[str, int], list[str]]()
    for arm, record in curricula.arms.items():
        for depth, (name, node) in enumerate(record.nodes.items()):
            depths[name] = max(depth, depths.get(name, 0))
            if name in learnt[arm] and learnt[arm][name].snapshots is not None:
                owners_of.setdefault((name, node.task), []).append(arm)
    shown, left_out, cells = list[tuple[str, GridView, list[str]]](), dict[str, None](), 0
    sources_first = sorted(owners_of, key=lambda place: depths[place[0]])
    for name, number in reversed(sources_first):
        arms, record_of_view = owners_of[name, number], curricula.tasks[number].view
        view = None if record_of_view is None else record_of_view.view
        size = 0 if view is None else len(arms) * view.states.size
        if view is None or cells + size > MOST_CELLS:
            left_out[name] = None
        else:
            shown.append((name, view, arms))
            cells += size
    most = max(3, min(MOST_MOMENTS, MOST_CELL_MOMENTS // max(1, cells)))
    made = list[Replay]()
    for name, view, arms in shown:
        alike: dict[Any, tuple[Any, list[str]]] = {}
        for arm in arms:
            kept: Any = learnt[arm][name].snapshots
            same = kept.seed, kept.steps.tobytes(), kept.values.tobytes()
            alike.setdefault(same, (kept, []))[1].append(arm)
        for kept, owners in alike.values():
            pair = analysis.episodes.get(owners[0], {}).get(name)
            # The first and the last moment are among those that are shown.
            moments = places(len(kept.steps), most)
            thinned = replace(kept, steps=kept.steps[moments], values=kept.values[moments])
            made.append(_replay(f"r{len(made)}", name, owners, view, thinned, pair))
    return tuple(made), tuple(left_out)


def _replay(
    key: str, task: str, arms: list[str], view: GridView, kept: Snapshots, pair: EpisodePair | None
) -> Replay:
    values = kept.values[:, view.states[~view.ended]]
    best = values.max(axis=-1)
    low, high = (float(best.min()), float(best.max())) if best.size else (0.0, 0.0)
    low, high, palette = value_scale(low, high)
    share = (best.astype(np.float64) - low) / ((high - low) or 1.0)
    chosen = greedy_choices(view, values)
    kinds, choices = np.unique(chosen.reshape(-1, chosen.shape[-1]), axis=0, return_inverse=True)
    episodes, (rows, columns) = {} if pair is None else dict(pair), view.shape
    # None where the view does not hold them.
    inside = [
        episode.cells.shape[1] in (0, len(view.markers))
        and episode.cells.max(initial=0) < rows * columns
        for episode in episodes.values()
    ]
    return Replay(
        key,
        task,
        tuple(arms),
        view,
        seed=kept.seed,
        steps=kept.steps,
        cells=tuple(shifted(view, view.cells[~view.ended])),
        levels=(np.clip(share, 0, 1) * (LEVELS - 1)).round().astype(np.uint16),
        choices=choices.reshape(best.shape),
        marks=tuple(mark_of(view, kind) for kind in kinds),
        low=low,
        high=high,
        palette=palette,
        digits=digits_of(low, high) if best.shape[1] <= MOST_NUMBERS else None,
        episodes={n: shown_episode(e, columns) for n, e in episodes.items() if all(inside)},
    )
