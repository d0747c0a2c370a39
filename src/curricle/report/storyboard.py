"""Storyboards: values and choices of one task at several moments of its training."""

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.colors import to_hex

from curricle.learning.snapshots import Snapshots
from curricle.plotting.potentials import DIVERGING, MOST_NUMBERS, SEQUENTIAL
from curricle.plotting.scales import minus
from curricle.report.stage import Stage, squares

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Written = tuple[tuple[int, int, str], ...]

MOST_FRAMES = 48
"""Moments of one training at most."""
LEVELS = 2**16
"""Values are rounded to so many between the lowest and the highest."""
SHADES = 64
"""Colours of a map."""


@dataclass(frozen=True)
class Frame:
    """One moment, ready to be drawn.

    Attributes
    ----------
    step : int
    heat : tuple of (str, str)
        Colour, and the path of all cells that have it.
    choice : str
        Path of all arrows; empty where choices are words.
    texts : tuple of (int, int, str)
        Column, row and word of each choice; empty where choices are arrows.
    numbers : tuple of (int, int, str)
        Column, row and value of each cell; empty where there are many.
    """

    step: int
    heat: tuple[tuple[str, str], ...]
    choice: str
    texts: Written
    numbers: Written


@dataclass(frozen=True, eq=False)
class Storyboard:
    """What one seed's values and greedy choices were at F moments, in n cells of a stage.

    Attributes
    ----------
    stage : Stage
    seed : int
    steps : (F,) int64
    cells : (n, 2) int64
        Column and row of each state that is no end.
    levels : (F, n) uint16
        max_a Q(s, a), from `low` (0) to `high` (65,535).
    choices : (F, n) int64
        Numbers of `marks`.
    marks : tuple of str
        How choices look.
    low, high : float
        Return.
    """

    stage: Stage
    seed: int
    steps: IntArray
    cells: IntArray
    levels: npt.NDArray[np.uint16]
    choices: IntArray
    marks: tuple[str, ...]
    low: float
    high: float

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

    def frame(self, place: int) -> Frame:
        """Return one moment; negative places count from the end."""
        shades = shades_of(self.palette)
        shade = self.levels[place].astype(np.int64) * SHADES // LEVELS
        marks = self._placed(self.marks[number] for number in self.choices[place])
        numbers: Written = ()
        middle = 0.5
        if self.digits is not None:
            values = self.low + (self.high - self.low) * self.levels[place] / (LEVELS - 1)
            numbers = self._placed(minus(f"{value:z.{self.digits}f}") for value in values)
            middle = 0.4
        paths = [f"M{x}.5 {y + middle:g}{mark}" for x, y, mark in marks if mark]
        return Frame(
            step=int(self.steps[place]),
            heat=tuple(
                (shades[one], squares(self.cells[shade == one])) for one in np.unique(shade)
            ),
            choice="".join(paths) if self.stage.arrows else "",
            texts=() if self.stage.arrows else marks,
            numbers=numbers,
        )

    def _placed(self, words: Iterable[str]) -> Written:
        cells = self.cells.tolist()
        return tuple((x, y, word) for (x, y), word in zip(cells, words, strict=True))

    def data(self) -> dict[str, Any]:
        """Return all moments for the page's script."""
        return {
            "steps": self.steps.tolist(),
            "cells": self.cells.ravel().tolist(),
            "levels": base64.b64encode(self.levels.astype("<u2").tobytes()).decode(),
            "choices": ["".join(chr(48 + number) for number in row) for row in self.choices],
            "marks": self.marks,
            "arrows": self.stage.arrows,
            "low": self.low,
            "high": self.high,
            "digits": self.digits,
            "palette": self.palette,
        }


def storyboard(snapshots: Snapshots, stage: Stage, most: int = MOST_FRAMES) -> Storyboard:
    """Return the storyboard of a snapshots: `most` of its moments, the first and the last among them.

    Parameters
    ----------
    snapshots : Snapshots
    stage : Stage
        Of its task.
    most : int
        Moments, at least 2 where the snapshots has more than one.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from curricle import GridWorld
    >>> from curricle.report.stage import stage
    >>> values = np.zeros((3, 3, 4), np.float32)
    >>> values[2, :2, 1] = 4.0, 8.0
    >>> snapshots = SimpleNamespace(seed=0, steps=np.array([0, 10, 20]), values=values)
    >>> shown = storyboard(snapshots, stage(GridWorld("S.T")))
    >>> shown.frame(-1).numbers, shown.frame(0).choice
    (((0, 0, '4.0'), (1, 0, '8.0')), '')
    """
    n = len(snapshots.steps)
    moments = np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))
    shown = stage.board
    alive = shown.states[~shown.ended]
    values = snapshots.values[moments][:, alive]
    best = values.max(axis=-1)
    low, high = _limits(best)
    share = (best.astype(np.float64) - low) / ((high - low) or 1.0)
    levels = (np.clip(share, 0, 1) * (LEVELS - 1)).round().astype(np.uint16)
    chosen = stage.choices(values)
    kinds, choices = np.unique(chosen.reshape(-1, chosen.shape[-1]), axis=0, return_inverse=True)
    return Storyboard(
        stage=stage,
        seed=snapshots.seed,
        steps=snapshots.steps[moments],
        cells=(shown.cells[~shown.ended] - np.array(shown.origin))[:, ::-1],
        levels=levels,
        choices=choices.reshape(levels.shape),
        marks=tuple(stage.mark(kind) for kind in kinds),
        low=low,
        high=high,
    )


def _limits(best: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Return the lowest and the highest value; equally far from 0 where both signs are there."""
    low, high = (float(best.min()), float(best.max())) if best.size else (0.0, 0.0)
    if low < 0 < high:
        high = max(-low, high)
        low = -high
    return low, high


def shades_of(palette: str) -> list[str]:
    """Return a colour map as 64 colours, ``#rrggbb``, from low to high."""
    colours = matplotlib.colormaps[palette](np.linspace(0, 1, SHADES))
    return [to_hex(colour) for colour in colours]
