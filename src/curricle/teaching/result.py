"""What teaching found: the learning of the target, and what the teacher did."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.display import block, brief_value, table
from curricle.frozen_arrays import Frozen, frozen
from curricle.learning.result import LearningResult, learnt_curve, learnt_table
from curricle.statistics.curves import Curve
from curricle.teaching.teachers import TaskSampler, Teacher
from curricle.text_tables import counted


@dataclass(frozen=True, eq=False)
class TeachingResult(Frozen):
    """What :func:`teach` found, for M tasks, K seeds and T checkpoints.

    Attributes
    ----------
    learning : LearningResult
        That of the target: greedy returns are those in the target, steps and episodes count those
        of all tasks, and so do training returns.
    tasks : tuple of str
        The names of the M tasks, in their order.
    teacher : Teacher
    drawn : tuple of K (E,) int64 arrays
        The task of each episode that was begun, as its place in `tasks`. The last one may have been
        cut off by the budget.
    begun_at : tuple of K (E,) int64 arrays
        Steps, in all tasks, before each of these episodes.
    probabilities : (K, T, M) float64
        The probability of each task when the episode of the checkpoint was drawn, the last one
        begun by then. Checkpoints after a seed's end repeat its last ones.
    steps_per_task : (K, M) int64
        Steps taken in each task; they add up to those of the seed.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.teaching import teach
    >>> found = teach({"near": GridWorld(".ST"), "far": GridWorld("S.T")}, target="far", budget=500)
    >>> found.learning.steps_used, found.steps_per_task.sum(axis=1), found.counts.shape
    (array([500]), array([500]), (1, 101, 2))
    """

    learning: LearningResult
    tasks: tuple[str, ...]
    teacher: Teacher
    drawn: tuple[IntArray, ...]
    begun_at: tuple[IntArray, ...]
    probabilities: FloatArray
    steps_per_task: IntArray

    @property
    def curve(self) -> Curve:
        """The greedy return in the target against the steps in all tasks."""
        return Curve.of(self.learning)

    @cached_property
    def counts(self) -> IntArray:
        """Episodes begun in each task before each checkpoint, (K, T, M) int64."""
        found = np.zeros((len(self.drawn), len(self.learning.steps), len(self.tasks)), np.int64)
        for k, (drawn, begun) in enumerate(zip(self.drawn, self.begun_at, strict=True)):
            for i in range(len(self.tasks)):
                found[k, :, i] = np.searchsorted(begun[drawn == i], self.learning.steps)
        return frozen(found)

    def __repr__(self) -> str:
        tasks, learning = counted(len(self.tasks), "task"), repr(self.learning)
        return f"TeachingResult({brief_value(self.teacher)}, {tasks}, {learning})"

    def _repr_html_(self) -> str:
        episodes, steps = self.counts[:, -1].mean(axis=0), self.steps_per_task.mean(axis=0)
        head = ["task", "episodes a seed", "steps a seed", "probability in the end"]
        last = self.probabilities[:, -1].mean(axis=0)
        rows = zip(self.tasks, episodes, steps, (f"{one:.0%}" for one in last), strict=True)
        title = f"Tasks chosen by {brief_value(self.teacher)}"
        learnt = learnt_table({"target": self.learning}, {})
        return block(title, learnt_curve(self.learning), learnt, table(head, rows))


def teaching_result(
    learning: LearningResult, tasks: tuple[str, ...], samplers: Sequence[TaskSampler]
) -> TeachingResult:
    """Return what teaching found, the episodes that took no step left out."""
    places = np.arange(len(learning.steps))
    drawn, begun_at, curves, steps = [], [], [], []
    for sampler, used in zip(samplers, learning.steps_used, strict=True):
        begun = np.array(sampler.begun_at)
        kept = np.array(sampler.tasks)[begun < used]
        drawn.append(frozen(kept))
        begun_at.append(frozen(begun[begun < used]))
        lengths = np.diff(begun_at[-1], append=used)
        steps.append(np.bincount(kept, lengths, len(tasks)).astype(np.int64))
        since = np.array([checkpoint for checkpoint, _ in sampler.changes])
        last = np.searchsorted(since, places, side="right") - 1
        curves.append(np.stack([found for _, found in sampler.changes])[last])
    return TeachingResult(
        learning=learning,
        tasks=tasks,
        teacher=samplers[0].teacher,
        drawn=tuple(drawn),
        begun_at=tuple(begun_at),
        probabilities=frozen(np.stack(curves)),
        steps_per_task=frozen(np.stack(steps)),
    )
