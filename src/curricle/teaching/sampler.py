"""The draws of a teacher in one seed: what it remembers, its stream, which tasks it has drawn."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.errors import SettingError
from curricle.tasks.draws import ALL, STRIDE, splitmix64, uniform
from curricle.teaching.episode import Episode
from curricle.teaching.teachers import Teacher

SUM_TOLERANCE = 1e-9
"""By which probabilities may miss 1; they are divided by their sum."""


@dataclass
class TaskSampler:
    """Draws the task of each episode of one seed from a stream of its own.

    Examples
    --------
    >>> from curricle.teaching import Uniform
    >>> sampler = TaskSampler(Uniform(), n_tasks=3, counter=0, eval_freq=10)
    >>> sampler.draw(step=0), sampler.draw(step=12), sampler.begun_at
    (2, 1, [0, 12])
    """

    teacher: Teacher
    n_tasks: int
    counter: int
    """Where the stream is."""
    eval_freq: int
    """Steps between checkpoints."""
    tasks: list[int] = field(default_factory=list)
    """That of each episode begun."""
    begun_at: list[int] = field(default_factory=list)
    """Steps, in all tasks, before each."""
    changes: list[tuple[int, FloatArray]] = field(default_factory=list)
    """The checkpoint before which an episode was the last to begin, and its probabilities."""
    memory: Any = field(init=False)

    def __post_init__(self) -> None:
        self.memory = self.teacher.start(self.n_tasks)

    def draw(self, step: int) -> int:
        """Return the task of the episode that begins after so many steps."""
        probabilities = self._asked()
        self.counter = (self.counter + int(STRIDE)) & ALL
        task = drawn(probabilities, uniform(splitmix64(self.counter)))
        checkpoint = -(-step // self.eval_freq)
        if self.changes and self.changes[-1][0] == checkpoint:
            self.changes.pop()
        self.changes.append((checkpoint, probabilities))
        self.tasks.append(task)
        self.begun_at.append(step)
        return task

    def ended(self, episode: Episode) -> None:
        """Let the teacher see an episode."""
        self.memory = self.teacher.update(self.memory, episode)

    def _asked(self) -> FloatArray:
        """Return the teacher's probabilities, or raise SettingError unless they are some."""
        given = self.teacher.probabilities(self.memory)
        found = np.asarray(given, dtype=np.float64)
        right = found.shape == (self.n_tasks,) and bool((found >= 0).all())
        if not right or not abs(found.sum() - 1) <= SUM_TOLERANCE:
            raise SettingError(
                f"a teacher's probabilities must be {self.n_tasks} numbers from 0 up that sum to "
                f"1: after {len(self.tasks):,} episodes {self.teacher!r} gives {given!r}"
            )
        return found


def drawn(probabilities: FloatArray, chance: float) -> int:
    """Return the task that a number in [0, 1) draws; none of probability 0.

    Examples
    --------
    >>> drawn(np.array([0.0, 0.5, 0.5, 0.0]), 0.0), drawn(np.array([0.0, 0.5, 0.5, 0.0]), 0.5)
    (1, 2)
    """
    rising = np.cumsum(probabilities)
    place = int(np.searchsorted(rising, chance * rising[-1], side="right"))
    return min(place, int(np.flatnonzero(probabilities)[-1]))


def check_teacher(teacher: Any) -> None:
    """Raise SettingError unless a teacher has the methods of :class:`Teacher`."""
    for name in ("start", "update", "probabilities"):
        if not callable(getattr(teacher, name, None)) or isinstance(teacher, type):
            raise SettingError(
                "a teacher must have the methods start, update and probabilities, as Uniform() "
                f"has: got {teacher!r}"
            )
