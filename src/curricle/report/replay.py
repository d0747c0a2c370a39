"""Stories: what each arm's training of each task looks like, ready to be shown."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curricle.curriculum.curriculum import CurriculumResult
from curricle.learning.snapshots import Snapshots
from curricle.report.episodes import Episode, before_and_after
from curricle.report.sharing import shared
from curricle.report.stage import Stage, stage
from curricle.report.storyboard import MOST_FRAMES, Storyboard, storyboard
from curricle.tasks.task import Task, same_task

SnapshotsByTask = Mapping[tuple[str, str], Snapshots]
"""(arm, task) -> snapshots."""

MOST_CELLS = 16_000
"""Cells of all stories together; each is printed at three moments, under four megabytes."""
MOST_CELL_FRAMES = 400_000
"""Cells, times moments, of all stories together: a megabyte and a half."""


@dataclass(frozen=True, eq=False)
class Story:
    """One training of one task.

    Attributes
    ----------
    key : str
        Unique in the page.
    task : str
    arms : tuple of str
        That trained it alike.
    board : Storyboard
    before, after : Episode or None
        None where episodes cannot be shown.
    """

    key: str
    task: str
    arms: tuple[str, ...]
    board: Storyboard
    before: Episode | None
    after: Episode | None

    def data(self) -> dict[str, Any]:
        """Return it for the page's script."""
        episodes = {}
        if self.before is not None and self.after is not None:
            episodes = {"before": self.before.data(), "after": self.after.data()}
        return {**self.board.data(), "episodes": episodes}


def stories(
    results: Mapping[str, CurriculumResult], snapshots: SnapshotsByTask
) -> tuple[tuple[Story, ...], tuple[str, ...]]:
    """Return the stories, task by task with the last first, and the tasks that cannot be shown.

    Arms whose snapshots of a task are equal share a story.

    Parameters
    ----------
    results : dict of str to CurriculumResult
        Of each arm.
    snapshots : dict of (str, str) to Snapshots

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from curricle import Curriculum, GridWorld
    >>> maze = GridWorld("S.T")
    >>> result = Curriculum({"maze": maze}, budget=100).train()
    >>> snapshots = SimpleNamespace(seed=0, steps=np.array([0, 100]), values=np.zeros((2, 3, 4)))
    >>> (found,), left_out = stories({"scratch": result}, {("scratch", "maze"): snapshots})
    >>> found.task, found.arms, found.board.steps
    ('maze', ('scratch',), array([  0, 100]))
    """
    shown, left_out, cells = list[tuple[_Own, Stage]](), dict[str, None](), 0
    for own in reversed(_by_task(results, snapshots)):
        found = stage(own.task)
        size = 0 if found is None else len(own.snapshots) * found.board.states.size
        if found is None or cells + size > MOST_CELLS:
            left_out[own.name] = None
        else:
            shown.append((own, found))
            cells += size
    most = max(3, min(MOST_FRAMES, MOST_CELL_FRAMES // max(1, cells)))
    told = list[Story]()
    for own, found in shown:
        for arms, kept in shared(own.snapshots, _same_film):
            evaluation = results[arms[0]].curriculum.setting("evaluation", own.name)
            pair = before_and_after(kept, found, discounted=evaluation.discounted)
            board = storyboard(kept, found, most)
            told.append(Story(f"s{len(told)}", own.name, arms, board, *(pair or (None, None))))
    return tuple(told), tuple(left_out)


class _Own(NamedTuple):
    """The snapshots of one task, by arm."""

    name: str
    task: Task
    snapshots: dict[str, Snapshots]


def _by_task(results: Mapping[str, CurriculumResult], snapshots: SnapshotsByTask) -> list[_Own]:
    """Return the snapshots of each task, sources first; arms may call different tasks by one name."""
    place, tasks = dict[str, int](), dict[tuple[str, str], tuple[str, Task]]()
    for arm, result in results.items():
        for depth, name in enumerate(result.curriculum.order):
            place[name] = max(depth, place.get(name, 0))
            if (arm, name) in snapshots:
                tasks[arm, name] = name, result.curriculum.tasks[name]
    found = [
        _Own(name, task, {arm: snapshots[arm, name] for arm, _ in keys})
        for keys, (name, task) in shared(tasks, _same_task)
    ]
    return sorted(found, key=lambda own: place[own.name])


def _same_task(one: tuple[str, Task], other: tuple[str, Task]) -> bool:
    return one[0] == other[0] and same_task(one[1], other[1])


def _same_film(one: Snapshots, other: Snapshots) -> bool:
    same = one.seed == other.seed and np.array_equal(one.steps, other.steps)
    return same and np.array_equal(one.values, other.values)
