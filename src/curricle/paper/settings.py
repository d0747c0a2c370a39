"""The tasks and settings of the paper's figures, and what a figure consists of."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from math import isnan
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle import GreedyEvaluation, GridWorld, QLearning, Rewards
from curricle.files import as_json
from curricle.plotting import COLOURS, content_of
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
    tables: Mapping[str, Mapping[str, Any]]  # name -> column name -> values of one length
    claims: Sequence[Claim]
    settings: Mapping[str, str]

    def files(self, name: str) -> tuple[dict[str, bytes], dict[str, Any]]:
        """Return the files of the figure called `name`, and its section of the page."""
        files = {self.name + end: content_of(self.figure, end) for end in (".png", ".svg")}
        links = {"PNG": f"{self.name}.png"}
        for table, columns in self.tables.items():
            sink = pa.BufferOutputStream()
            pq.write_table(pa.table(dict(columns)), sink)
            links[f"{table}.parquet"] = f"data/{table}.parquet"
            files[f"data/{table}.parquet"] = sink.getvalue().to_pybytes()
        claims = [{"id": claim.id, "figure": name, **vars(claim)} for claim in self.claims]
        for claim in claims:
            claim["evidence"] = {key: _as_data(x) for key, x in claim["evidence"].items()}
        section = {
            "title": self.title,
            "caption": self.caption,
            "image": f"{self.name}.svg",
            "settings": dict(self.settings),
            "claims": claims,
            "links": links,
        }
        files[f"data/{self.name}.json"] = as_json(section)
        return files, section


def _as_data(value: Any) -> Any:
    """Return an interval as estimate, low, high and seeds; other evidence as it is."""
    if not isinstance(value, Interval):
        return value
    parts = {name: float(getattr(value, name)) for name in ("estimate", "low", "high")}
    # Bounds that do not exist are None, as JSON has no NaN.
    return {key: None if isnan(x) else x for key, x in parts.items()} | {"seeds": value.n}


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


def draw_level(panel: Axes, level: float, **style: Any) -> None:
    """Draw a horizontal grey line, at a return to be reached or at 0."""
    panel.axhline(level, color=COLOURS["grey"], lw=0.8, **style)


def stacked(parts: Iterable[Mapping[str, npt.ArrayLike]]) -> dict[str, npt.NDArray[Any]]:
    """Return parts of a tidy table below each other; the columns of a part are broadcast."""
    names, columns = list[str](), list[list[npt.NDArray[Any]]]()
    for part in parts:
        names = list(part)
        columns.append([np.ravel(column) for column in np.broadcast_arrays(*part.values())])
    whole = [np.concatenate(column) for column in zip(*columns, strict=True)]
    return dict(zip(names, whole, strict=True))
