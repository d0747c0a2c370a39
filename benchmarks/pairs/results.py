"""What the runner stored, by pair and arm."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from curricle.statistics import Interval, mean_interval

LEAST_BASE = 0.1
"""Share of the way that scratch is taken to cover at least, where a loss is a share of that."""


@dataclass(frozen=True, eq=False)
class Played:
    """A pair as it was played.

    Attributes
    ----------
    facts : dict
        What is the same in all rows: ``family``, ``kind``, ``sensible``, ``target`` and so on.
    arms : dict of str to dict of str to (K,) array
        Arm -> column -> value of each seed.
    """

    name: str
    facts: dict[str, Any]
    arms: dict[str, dict[str, np.ndarray]]

    @property
    def way(self) -> float:
        """The way from the random policy's return to the optimum."""
        return float(self.facts["optimum"] - self.facts["random_return"])

    @property
    def label(self) -> str:
        """The pair's name within its family."""
        return self.name.partition("/")[2]

    def has(self, *arms: str) -> bool:
        """Return whether the pair was played with all these arms."""
        return all(arm in self.arms for arm in arms)

    def gains(self, arm: str, column: str = "gain") -> np.ndarray:
        """Return the gain over scratch of each seed, as shares of the way, (K,)."""
        return self.arms[arm][column] / self.way

    def gain(self, arm: str, column: str = "gain") -> Interval:
        """Return the mean of these with its Student interval."""
        return student(self.gains(arm, column))

    def difference(self, arm: str, other: str, column: str = "gain") -> Interval:
        """Return by how much one arm gains more than another, seed by seed."""
        return student(self.gains(arm, column) - self.gains(other, column))

    def base(self, column: str = "mean_return") -> float:
        """Return the share of the way that scratch covers, mean over steps and seeds."""
        height = self.arms["scratch"][column].mean() - self.facts["random_return"]
        return float(height) / self.way

    def losses(self, arm: str, column: str = "gain") -> Interval:
        """Return the loss against scratch, as a share of what scratch covers; negative: a gain."""
        of = "weak_mean_return" if column == "weak_gain" else "mean_return"
        return student(-self.gains(arm, column) / max(self.base(of), LEAST_BASE))

    @property
    def source_learnt(self) -> float:
        """How far the source learnt its own task, 1 being its optimum."""
        random, optimum = self.facts["source_random_return"], self.facts["source_optimum"]
        return (self.facts["source_return"] - random) / (optimum - random)

    def words(self, arm: str) -> str:
        """Return the verdict of the library's own comparison."""
        words = self.arms[arm]
        return ", ".join(filter(None, (str(words["verdict"][0]), str(words["reason"][0]))))


def student(values: np.ndarray) -> Interval:
    """Return the mean with Student's interval; without any spread it is the mean alone."""
    found = mean_interval(values)
    if np.isfinite(found.low):
        return found
    mean = float(found.estimate)
    return Interval(mean, mean, mean, found.confidence, found.n)


def read(paths: Iterable[Path], split: str | None = None) -> list[Played]:
    """Return the pairs in some Parquet files, in their order; only those of a split if given."""
    found: dict[str, Played] = {}
    for path in paths:
        table = pq.read_table(path).to_pylist()
        for row in table:
            if split is None or row["split"] == split:
                pair = found.setdefault(row["pair"], Played(row["pair"], row, {}))
                pair.arms.setdefault(row["arm"], {}).setdefault("rows", []).append(row)  # type: ignore[arg-type]
    for pair in found.values():
        for arm, held in pair.arms.items():
            rows: Sequence[dict[str, Any]] = sorted(held["rows"], key=lambda row: row["seed"])
            pair.arms[arm] = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    return list(found.values())


def realised(paths: Iterable[Path], arm: str = "raw") -> dict[str, tuple[float, float, float]]:
    """Return the charged gain of an arm in each pair with its interval: mean, low and high.

    Shares of the way from the random policy to the optimum; predictions are joined by pair.
    """
    found = {pair.name: pair.gain(arm) for pair in read(paths) if pair.has(arm)}
    return {
        name: (float(one.estimate), float(one.low), float(one.high)) for name, one in found.items()
    }
