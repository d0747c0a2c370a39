"""The tasks and settings of the paper's figures, and what the function of a figure returns."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle import GreedyEvaluation, GridWorld, QLearning, Rewards
from curricle.show import COLOURS
from curricle.statistics import Interval, mean_interval

MAP = resources.files("curricle.paper").joinpath("maze.txt").read_text(encoding="utf-8")

LEARNING_RATE = 0.1
DISCOUNT = 0.99
EPSILON = 0.1
LEARNER = QLearning(learning_rate=LEARNING_RATE, epsilon=EPSILON)
EPISODE_CAP = 200
INVERSE_TEMPERATURE = 0.2

SUMMED = GreedyEvaluation(discounted=False)
"""The paper's measure: the undiscounted return of a greedy episode, truncated at the cap."""

Progress = Callable[[str], object]
"""Called with a short message whenever a part of a figure is done."""

Verdict = Literal["reproduced", "not reproduced", "explained"]


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, or an answer to an open question of it, and the verdict."""

    id: str
    claim: str  # the statement
    setting: str  # where it was tested
    verdict: Verdict
    evidence: Mapping[str, Any]  # name -> number, text, or interval over seeds


@dataclass(frozen=True)
class FigureResult:
    """A figure with its caption, data, settings and claims."""

    name: str
    title: str
    caption: str
    figure: Figure
    tables: Mapping[str, Mapping[str, Any]]
    claims: Sequence[Claim]
    settings: Mapping[str, str]


def maze(step: float) -> GridWorld:
    """Return the paper's 10x10 maze; `step` is -1 in its text and -5 in its runs."""
    return GridWorld(MAP, rewards=Rewards(step=step), discount=DISCOUNT, time_limit=EPISODE_CAP)


def verdict(holds: Any) -> Verdict:
    """Return the verdict on a claim that holds or does not."""
    return "reproduced" if holds else "not reproduced"


def answer(holds: Any) -> Verdict:
    """Return the verdict on an open question that a control answers or does not."""
    return "explained" if holds else "not reproduced"


def over_seeds(values: npt.ArrayLike) -> Interval:
    """Return the mean over seeds, (K,), with Student's 95 % interval."""
    return mean_interval(np.asarray(values, dtype=np.float64))


def whiskers(interval: Interval) -> list[list[Any]]:
    """Return an interval as distances below and above the estimate, for Matplotlib."""
    return [[interval.estimate - interval.low], [interval.high - interval.estimate]]


def in_thousands(panel: Axes) -> None:
    """Write the horizontal axis in thousands."""
    panel.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}")


def draw_threshold(panel: Axes, threshold: float) -> None:
    """Draw a return to be reached as a dotted line."""
    panel.axhline(threshold, color=COLOURS["grey"], lw=0.8, ls=":")


def stacked(parts: Iterable[Mapping[str, npt.ArrayLike]]) -> dict[str, npt.NDArray[Any]]:
    """Return parts of a tidy table below each other; the columns of a part are broadcast."""
    names, columns = list[str](), list[list[npt.NDArray[Any]]]()
    for part in parts:
        names = list(part)
        columns.append([np.ravel(column) for column in np.broadcast_arrays(*part.values())])
    whole = [np.concatenate(column) for column in zip(*columns, strict=True)]
    return dict(zip(names, whole, strict=True))
