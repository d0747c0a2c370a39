"""One seed's training by a teacher: what the learning loop asks before each episode."""

from collections.abc import Generator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, FloatTable
from curricle.errors import SettingError
from curricle.frozen_arrays import frozen
from curricle.learning.run import Run
from curricle.learning.seeds import SeedSettings
from curricle.learning.tables import DenseTable
from curricle.tasks.draws import ALL, STRIDE, splitmix64, stream_start, uniform
from curricle.tasks.live import BROKEN_DOWN, Answer
from curricle.teaching.episode import Episode
from curricle.teaching.task_set import TaskSet
from curricle.teaching.taught_model import EpisodeRecord, TaughtModel
from curricle.teaching.teachers import Teacher

SUM_TOLERANCE = 1e-9
"""By which probabilities may miss 1; they are divided by their sum."""


@dataclass
class Draws:
    """What a teacher did in one seed."""

    tasks: list[int] = field(default_factory=list)
    begun_at: list[int] = field(default_factory=list)
    changes: list[tuple[int, FloatArray]] = field(default_factory=list)
    """The step of each episode that is the first after a checkpoint, and its probabilities."""


@dataclass(frozen=True)
class TaughtRun(Run):
    """A :class:`Run` in several tasks; ``task`` is the target.

    `draws` get what the teacher did, by the number of the seed.
    """

    task_set: TaskSet
    teacher: Teacher
    stream: str
    draws: dict[int, Draws]

    def opened(
        self, settings: SeedSettings, start: int, tables: Sequence[Any]
    ) -> AbstractContextManager[Any]:
        """Return a context with the model of all tasks, in which the teacher draws."""
        learnt = tables[-1]
        q = learnt.q[None] if isinstance(learnt, DenseTable) else learnt
        return self._taught(settings.seed, q)

    @contextmanager
    def _taught(self, seed: int, q: FloatTable) -> Generator[TaughtModel]:
        raised, draws = list[BaseException](), Draws()
        record = EpisodeRecord.empty(self.task_set.limit)
        lesson = self._lesson(seed, record, q, draws, raised)
        next(lesson)
        asked = lesson.send  # it must outlive its address
        address = np.array([id(asked)], dtype=np.uint64)
        try:
            yield TaughtModel(address, np.zeros(1, np.bool_), self.task_set.shared, q, record)
        finally:
            lesson.close()
        if raised:
            raise raised[0]
        self.draws[seed] = draws

    def _lesson(
        self,
        seed: int,
        record: EpisodeRecord,
        q: FloatTable,
        draws: Draws,
        raised: list[BaseException],
    ) -> Generator[Answer | None, int, None]:
        """Yield the start of an episode for each 64 bits sent; nothing is raised.

        The caller is compiled code. A generator also catches an interrupt which arrives before the
        first line of a function would be reached.
        """
        counter, step = stream_start(seed, f"{self.stream}/teacher"), 0
        bits = yield None
        try:
            memory = self.teacher.start(len(self.task_set.mdps))
            while True:
                if draws.tasks:
                    step += int(record.length[0])
                    memory = self.teacher.update(memory, self._episode(record, q))
                probabilities = self.checked(self.teacher.probabilities(memory), len(draws.tasks))
                counter = (counter + int(STRIDE)) & ALL
                task = drawn(probabilities, uniform(splitmix64(counter)))
                self._note(draws, task, step, probabilities)
                record.task[0] = task
                bits = yield self.task_set.start_state(task, bits & ALL), 0.0, False, False
        except GeneratorExit:
            raise
        except BaseException as error:
            raised.append(error)
        while True:
            yield BROKEN_DOWN

    def _note(self, draws: Draws, task: int, step: int, probabilities: FloatArray) -> None:
        """Write down a draw; of episodes between two checkpoints the last one's probabilities."""
        checkpoint = -(-step // self.eval_freq)
        if draws.changes and draws.changes[-1][0] == checkpoint:
            draws.changes.pop()
        draws.changes.append((checkpoint, probabilities))
        draws.tasks.append(task)
        draws.begun_at.append(step)

    def _episode(self, record: EpisodeRecord, q: FloatTable) -> Episode:
        """Return the episode that has just ended."""
        n, task, shared = int(record.length[0]), int(record.task[0]), self.task_set
        return Episode(
            task,
            frozen(record.rewards[:n].copy()),
            frozen(record.td_errors[:n].copy()),
            bool(record.terminated[0] and shared.goals[task, record.last_state[0]]),
            shared.target.discount,
            partial(shared.greedy_returns, q),
            lambda: shared.optimal_returns,
        )

    def checked(self, given: Any, episodes: int) -> FloatArray:
        """Return a teacher's probabilities, or raise SettingError unless they are some."""
        n_tasks = len(self.task_set.mdps)
        found = np.asarray(given, dtype=np.float64)
        right = found.shape == (n_tasks,) and bool((found >= 0).all())
        if not right or not abs(found.sum() - 1) <= SUM_TOLERANCE:
            raise SettingError(
                f"a teacher's probabilities must be {n_tasks} numbers from 0 up that sum to 1: "
                f"after {episodes:,} episodes {self.teacher!r} gives {given!r}"
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
