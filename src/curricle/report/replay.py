"""Replays of training: one seed's values and greedy actions, and an episode before and after.

The page holds three drawn moments of each; its script draws the others from :meth:`Replay.data`.
"""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, FloatTable, IntArray
from curricle.learning.record import Snapshots
from curricle.plotting.grids import MOST_NUMBERS
from curricle.plotting.scales import minus, rounded
from curricle.plotting.styles import DIVERGING, SEQUENTIAL, SHADES, shades_of
from curricle.report.graph import Learnt
from curricle.report.svg import GridDrawing, move_path, shifted, squares
from curricle.study.record import (
    Analysis,
    CurriculaRecord,
    EpisodePair,
    EpisodeRecord,
    TaskRecord,
)
from curricle.tasks.grid_view import GridView
from curricle.text import counted

CellTexts = tuple[tuple[int, int, str], ...]
"""Column, row and text of cells."""

MOST_MOMENTS = 48
"""Moments of one training at most."""
MOST_CELLS = 16_000
"""Cells of all replays together; each is printed at three moments, under four megabytes."""
MOST_CELL_MOMENTS = 400_000
"""Cells times moments of all replays together: a megabyte and a half."""
LEVELS = 2**16
"""Levels between the lowest and the highest value to which values are rounded."""
LONGEST_WORD = 9
"""Letters of an action's name up to which it is written into a cell."""
APART = 0.2
"""Distance of markers from the middle of a cell, where there are several."""


@dataclass(frozen=True, eq=False)
class ShownEpisode:
    """One greedy episode of n steps on a grid."""

    record: EpisodeRecord
    columns: int

    @property
    def words(self) -> str:
        """How it ended."""
        how, n = "terminated" if self.record.terminated else "truncated", len(self.points) - 1
        return f"{how} after {counted(n, 'step')}, return {rounded(self.record.returns[-1])}"

    @cached_property
    def points(self) -> FloatArray:
        """Where each marker is drawn, (n + 1, markers, 2); several stand apart within a cell."""
        cells = self.record.cells
        markers = cells.shape[1]
        turn = 2 * np.pi * np.arange(markers) / markers
        aside = APART * (markers > 1) * np.stack([-np.cos(turn), -np.sin(turn)], axis=1)
        corner = np.stack([cells % self.columns, cells // self.columns], axis=-1)
        return np.asarray((corner + 0.5 + aside).round(2))

    def trail(self, marker: int) -> str:
        """Return the points of a marker's path."""
        return " ".join(f"{x:g},{y:g}" for x, y in self.points[:, marker])

    def start(self, marker: int) -> str:
        """Return where a marker starts, as a CSS translation."""
        x, y = self.points[0, marker]
        return f"{x:g}px, {y:g}px"

    def data(self) -> dict[str, Any]:
        """Return it for the script of the page."""
        return {
            "places": self.points.reshape(len(self.points), -1).tolist(),
            "returns": [rounded(value) for value in self.record.returns],
            "words": self.words,
        }


@dataclass(frozen=True)
class Moment:
    """One moment of training, ready to be drawn."""

    step: int
    heat: tuple[tuple[str, str], ...]  # colour, and the path of all cells that have it
    choice: str  # path of all arrows; empty where choices are words
    texts: CellTexts  # the word of each choice; empty where choices are arrows
    numbers: CellTexts  # the value of each cell; empty where there are many


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
    episodes: Mapping[str, ShownEpisode]  # "before" and "after"; empty where they are not shown

    @cached_property
    def grid(self) -> GridDrawing:
        """The unchanging parts of the drawing."""
        return GridDrawing.of(self.view)

    @property
    def arrows(self) -> bool:
        """Whether choices are drawn as arrows."""
        return self.view.directions is not None

    @property
    def palette(self) -> str:
        """The colour map: diverging where values have both signs."""
        return DIVERGING if self.low < 0 < self.high else SEQUENTIAL

    @property
    def digits(self) -> int | None:
        """Decimals of the numbers written into cells; None where there are too many cells."""
        if len(self.cells) > MOST_NUMBERS:
            return None
        return 0 if max(abs(self.low), abs(self.high)) >= 100 else 1

    def moment(self, place: int) -> Moment:
        """Return one moment; negative places count from the end."""
        shade = self.levels[place].astype(np.int64) * SHADES // LEVELS
        marks = self._placed(self.marks[number] for number in self.choices[place])
        numbers, middle = CellTexts(), 0.5
        if self.digits is not None:
            values = self.low + (self.high - self.low) * self.levels[place] / (LEVELS - 1)
            numbers = self._placed(minus(f"{value:z.{self.digits}f}") for value in values)
            middle = 0.4
        cells = np.array(self.cells)
        paths = [f"M{x}.5 {y + middle:g}{mark}" for x, y, mark in marks if mark]
        return Moment(
            step=int(self.steps[place]),
            heat=tuple(
                (colour, squares(cells[shade == one].tolist()))
                for one, colour in enumerate(shades_of(self.palette))
                if (shade == one).any()
            ),
            choice="".join(paths) if self.arrows else "",
            texts=() if self.arrows else marks,
            numbers=numbers,
        )

    def _placed(self, words: Iterable[str]) -> CellTexts:
        return tuple((x, y, word) for (x, y), word in zip(self.cells, words, strict=True))

    def data(self) -> dict[str, Any]:
        """Return all moments for the script of the page."""
        return {
            "steps": self.steps.tolist(),
            "cells": [number for cell in self.cells for number in cell],
            "levels": base64.b64encode(self.levels.astype("<u2").tobytes()).decode(),
            "choices": ["".join(chr(48 + number) for number in row) for row in self.choices],
            "marks": self.marks,
            "arrows": self.arrows,
            "low": self.low,
            "high": self.high,
            "digits": self.digits,
            "palette": self.palette,
            "episodes": {name: one.data() for name, one in self.episodes.items()},
        }


def replays(
    curricula: CurriculaRecord, learnt: Learnt, analysis: Analysis
) -> tuple[tuple[Replay, ...], tuple[str, ...]]:
    """Return the replays of all snapshots, the last task first, and the tasks too large to show.

    Arms whose snapshots of a task are equal share a replay.
    """
    shown, left_out, cells = list[tuple[str, GridView, list[str]]](), dict[str, None](), 0
    for name, task, arms in reversed(_tasks(curricula, learnt)):
        view = None if task.view is None else task.view.view
        size = 0 if view is None else len(arms) * view.states.size
        if view is None or cells + size > MOST_CELLS:
            left_out[name] = None
        else:
            shown.append((name, view, arms))
            cells += size
    most = max(3, min(MOST_MOMENTS, MOST_CELL_MOMENTS // max(1, cells)))
    found = list[Replay]()
    for name, view, arms in shown:
        alike: dict[Any, tuple[Any, list[str]]] = {}
        for arm in arms:
            kept: Any = learnt[arm][name].snapshots
            same = kept.seed, kept.steps.tobytes(), kept.values.tobytes()
            alike.setdefault(same, (kept, []))[1].append(arm)
        for kept, owners in alike.values():
            pair = analysis.episodes.get(owners[0], {}).get(name)
            named = f"r{len(found)}", name, tuple(owners)
            found.append(
                Replay(*named, view, **_values(kept, view, most), episodes=_shown(pair, view))
            )
    return tuple(found), tuple(left_out)


def _shown(pair: EpisodePair | None, view: GridView) -> dict[str, ShownEpisode]:
    """Return the episodes "before" and "after"; none where the view does not hold them."""
    each = {} if pair is None else {"before": pair.before, "after": pair.after}
    rows, columns = view.shape
    for one in each.values():
        if one.cells.shape[1] != len(view.markers) or one.cells.max() >= rows * columns:
            return {}
    return {which: ShownEpisode(one, columns) for which, one in each.items()}


def greedy_choices(view: GridView, values: FloatTable) -> BoolArray:
    """Return which moves, or else actions, are greedy, ties included: (..., A) -> (..., O)."""
    greedy = values == values.max(axis=-1, keepdims=True)
    options = _options(view)
    chosen = [greedy[..., options == one].any(axis=-1) for one in np.unique(options)]
    return np.stack(chosen, axis=-1)


def mark_of(view: GridView, chosen: BoolArray) -> str:
    """Return how greedy choices, (O,), are drawn into a cell; empty where all are equally good."""
    if chosen.all() and len(chosen) > 1:
        return ""
    best = np.unique(_options(view))[chosen].tolist()
    if view.directions is not None:
        return "".join(move_path(move, alone=len(best) == 1) for move in best)
    names = [(view.actions[one], str(one)) for one in best]
    return "/".join(name if len(name) <= LONGEST_WORD else number for name, number in names)


def _options(view: GridView) -> IntArray:
    """Return the move of each action, or its number where actions are no moves, (A,)."""
    return np.arange(len(view.actions)) if view.directions is None else np.array(view.directions)


def _tasks(curricula: CurriculaRecord, learnt: Learnt) -> list[tuple[str, TaskRecord, list[str]]]:
    """Return each task with snapshots and its arms, sources first; equal names need not be one."""
    depths, found = dict[str, int](), dict[tuple[str, int], list[str]]()
    for arm, record in curricula.arms.items():
        for depth, (name, node) in enumerate(record.nodes.items()):
            depths[name] = max(depth, depths.get(name, 0))
            if name in learnt[arm] and learnt[arm][name].snapshots is not None:
                found.setdefault((name, node.task), []).append(arm)
    each = [(name, curricula.tasks[task], arms) for (name, task), arms in found.items()]
    return sorted(each, key=lambda one: depths[one[0]])


def _values(snapshots: Snapshots, view: GridView, most: int) -> dict[str, Any]:
    """Return the fields of a replay for `most` moments, the first and the last among them."""
    n = len(snapshots.steps)
    moments = np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))
    values = snapshots.values[moments][:, view.states[~view.ended]]
    best = values.max(axis=-1)
    low, high = (float(best.min()), float(best.max())) if best.size else (0.0, 0.0)
    if low < 0 < high:
        # Zero is the middle of the colours.
        high = max(-low, high)
        low = -high
    share = (best.astype(np.float64) - low) / ((high - low) or 1.0)
    levels = (np.clip(share, 0, 1) * (LEVELS - 1)).round().astype(np.uint16)
    chosen = greedy_choices(view, values)
    kinds, choices = np.unique(chosen.reshape(-1, chosen.shape[-1]), axis=0, return_inverse=True)
    return {
        "seed": snapshots.seed,
        "steps": snapshots.steps[moments],
        "cells": tuple(shifted(view, view.cells[~view.ended])),
        "levels": levels,
        "choices": choices.reshape(levels.shape),
        "marks": tuple(mark_of(view, kind) for kind in kinds),
        "low": low,
        "high": high,
    }
