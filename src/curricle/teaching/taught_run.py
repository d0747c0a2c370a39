"""One seed's training by a teacher: what the learning loop asks before each episode."""

from collections.abc import Generator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from curricle.array_types import FloatTable
from curricle.frozen_arrays import frozen
from curricle.learning.run import Run
from curricle.learning.seeds import SeedSettings
from curricle.learning.tables import DenseTable
from curricle.tasks.draws import ALL, stream_start
from curricle.tasks.live import BROKEN_DOWN, Answer
from curricle.teaching.episode import Episode
from curricle.teaching.sampler import TaskSampler
from curricle.teaching.task_set import TaskSet
from curricle.teaching.taught_model import EpisodeRecord, TaughtModel
from curricle.teaching.teachers import Teacher


@dataclass(frozen=True)
class TaughtRun(Run):
    """A :class:`Run` in several tasks; ``task`` is the target.

    `samplers` get the draws of the teacher, by the number of the seed.
    """

    task_set: TaskSet
    teacher: Teacher
    stream: str
    samplers: dict[int, TaskSampler]

    def opened(
        self, settings: SeedSettings, start: int, tables: Sequence[Any]
    ) -> AbstractContextManager[Any]:
        """Return a context with the model of all tasks, in which the teacher draws."""
        learnt = tables[-1]
        q = learnt.q[None] if isinstance(learnt, DenseTable) else learnt
        return self._taught(settings.seed, q)

    @contextmanager
    def _taught(self, seed: int, q: FloatTable) -> Generator[TaughtModel]:
        raised = list[BaseException]()
        record = EpisodeRecord.empty(self.task_set.limit)
        lesson = self._lesson(seed, record, q, raised)
        next(lesson)
        asked = lesson.send  # it must outlive its address
        address = np.array([id(asked)], dtype=np.uint64)
        try:
            yield TaughtModel(address, np.zeros(1, np.bool_), self.task_set.shared, q, record)
        finally:
            lesson.close()
        if raised:
            raise raised[0]

    def _lesson(
        self, seed: int, record: EpisodeRecord, q: FloatTable, raised: list[BaseException]
    ) -> Generator[Answer | None, int, None]:
        """Yield the start of an episode for each 64 bits sent; nothing is raised.

        The caller is compiled code. A generator also catches an interrupt which arrives before the
        first line of a function would be reached.
        """
        step = 0
        bits = yield None
        try:
            counter = stream_start(seed, f"{self.stream}/teacher")
            sampler = TaskSampler(self.teacher, len(self.task_set.mdps), counter, self.eval_freq)
            self.samplers[seed] = sampler
            while True:
                if sampler.tasks:
                    step += int(record.length[0])
                    sampler.ended(self._episode(record, q))
                task = sampler.draw(step)
                record.task[0] = task
                bits = yield self.task_set.start_state(task, bits & ALL), 0.0, False, False
        except GeneratorExit:
            raise
        except BaseException as error:
            raised.append(error)
        while True:
            yield BROKEN_DOWN

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
