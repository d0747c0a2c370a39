"""Episodes before and after learning: one each, from the same start, to be watched."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.learning.snapshots import Snapshots
from curricle.planning.rollouts import Trajectory, rollout
from curricle.planning.solution import greedy_policy
from curricle.report.findings import figures
from curricle.report.stage import Stage
from curricle.tasks.task import generative_model, has_tables

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LONGEST = 200
"""Steps of an episode that are shown."""
APART = 0.2
"""Distance of actors from the middle of a cell, where there are several."""
LARGEST_TABLE = 20_000_000
"""Pairs (S x A) of a task up to which its episodes are shown."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of n steps on a stage.

    Attributes
    ----------
    cells : (n + 1, actors) int64
        Where each actor is, as ``row * columns + column``.
    columns : int
    earned : (n + 1,) float64
        Return so far.
    over : bool
        Whether it ended by itself, not by being cut off.
    """

    cells: IntArray
    columns: int
    earned: FloatArray
    over: bool

    @property
    def words(self) -> str:
        """How it ended."""
        how = "over" if self.over else "cut off"
        n = len(self.cells) - 1
        return f"{how} after {n} step{'s' * (n > 1)}, return {figures(self.earned[-1])}"

    @property
    def places(self) -> FloatArray:
        """Column and row of each actor, (n + 1, actors, 2); several keep apart within a cell."""
        actors = self.cells.shape[1]
        turn = 2 * np.pi * np.arange(actors) / actors
        aside = APART * (actors > 1) * np.stack([-np.cos(turn), -np.sin(turn)], axis=1)
        corner = np.stack([self.cells % self.columns, self.cells // self.columns], axis=-1)
        return np.asarray((corner + 0.5 + aside).round(2))

    def trail(self, actor: int) -> str:
        """Return the points of an actor's way."""
        return " ".join(f"{x:g},{y:g}" for x, y in self.places[:, actor])

    def start(self, actor: int) -> str:
        """Return where an actor starts, as CSS moves it there."""
        x, y = self.places[0, actor]
        return f"{x:g}px, {y:g}px"

    def data(self) -> dict[str, Any]:
        """Return it for the page's script."""
        return {
            "places": self.places.reshape(len(self.cells), -1).tolist(),
            "earned": [figures(value) for value in self.earned],
            "words": self.words,
        }


def before_and_after(
    snapshots: Snapshots, stage: Stage, *, discounted: bool, seed: int = 0
) -> tuple[Episode, Episode] | None:
    """Return an episode of the first and one of the last greedy policy of a snapshots.

    Ties are broken uniformly; both have the same start and the same random stream.

    Parameters
    ----------
    snapshots : Snapshots
    stage : Stage
        Of its task.
    discounted : bool
        Whether returns are.
    seed : int
        Of the random stream.

    Returns
    -------
    (Episode, Episode) or None
        None where the task has no tables, or too large ones, or where a state has no place.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from curricle import GridWorld
    >>> from curricle.report.stage import stage
    >>> values = np.zeros((2, 3, 4), np.float32)
    >>> values[1, :2, 1] = 1.0
    >>> snapshots = SimpleNamespace(seed=0, steps=np.array([0, 10]), values=values)
    >>> _, after = before_and_after(snapshots, stage(GridWorld("S.T")), discounted=False)
    >>> after.cells.ravel(), after.words
    (array([0, 1, 2]), 'over after 2 steps, return 198')
    """
    task = stage.board.task
    generative = generative_model(task)
    pairs = generative.states.size * generative.actions.size
    if pairs > LARGEST_TABLE or not has_tables(task):
        return None
    weight = generative.discount if discounted else 1.0
    steps = min(generative.time_limit or LONGEST, LONGEST)
    followed = [
        rollout(task, greedy_policy(snapshots.values[place]), seed=seed, steps=steps)
        for place in (0, -1)
    ]
    before, after = (_on_stage(one, stage, weight) for one in followed)
    shown = (before.cells >= 0).all() and (after.cells >= 0).all()
    return (before, after) if shown else None


def _on_stage(followed: Trajectory, stage: Stage, weight: float) -> Episode:
    cells = np.stack([actor.cells[followed.states] for actor in stage.actors], axis=1)
    rewards = followed.rewards * weight ** np.arange(len(followed))
    return Episode(
        cells, stage.size[0], np.concatenate([[0.0], rewards.cumsum()]), followed.terminated
    )
