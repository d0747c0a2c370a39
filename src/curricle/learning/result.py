"""What learning leaves: curves, values, what was spent; for K seeds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.learning.learners import Learner
from curricle.learning.record import Snapshots
from curricle.learning.run import Outcome
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LearningResult:
    """What :func:`learn` found, for K seeds and T checkpoints.

    Attributes
    ----------
    task : Task
    learner : Learner
    seeds : tuple of int
        K of them.
    values : (K, S, A) float64 or float32
        The values each seed's policy ends up acting on, in the task's own rewards: Q, plus
        what shaping had taken off it (phi, or Phi(s)). What a transfer hands on. From sparse
        tables K :class:`SparseValues`; None if the :class:`Storage` keeps none.
    steps : (T,) int64
        Steps taken at each checkpoint, from 0.
    training_return : (K, T) float64
        Mean undiscounted, unshaped return of the episodes that ended since the last checkpoint;
        NaN where none did.
    guard_share : (K, T) float64
        Share of the steps that a guarded potential's learner got (:class:`Guard`); NaN without.
    greedy_return : (K, T) float64
        Expected return of the greedy policy (:class:`GreedyEvaluation`). After a seed's budget
        of episodes is spent its last value stands.
    episodes : (K, T) int64
        Episodes ended by each checkpoint.
    steps_used, episodes_used : (K,) int64
        What each seed spent in all.
    out_of_memory : (K,) bool
        Whether a sparse table was full before the budget was spent. The run then ended at the
        step that needed another row.
    snapshots : Snapshots or None
        Tables of the first seed on the way, if asked for.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learn(GridWorld("S.T"), budget=500, seeds=3).steps_used
    array([500, 500, 500])
    """

    task: Task
    learner: Learner
    seeds: tuple[int, ...]
    values: Any
    steps: IntArray
    training_return: FloatArray
    greedy_return: FloatArray
    episodes: IntArray
    steps_used: IntArray
    episodes_used: IntArray
    out_of_memory: npt.NDArray[np.bool_]
    guard_share: FloatArray
    snapshots: Snapshots | None = None

    def __repr__(self) -> str:
        return (
            f"LearningResult({type(self.learner).__name__}, {len(self.seeds)} seeds, "
            f"{int(self.steps_used.mean()):,} steps and {int(self.episodes_used.mean()):,} "
            f"episodes a seed, final greedy return {self.greedy_return[:, -1].mean():.4g})"
        )


def learning_result(
    task: Task,
    learner: Learner,
    seeds: tuple[int, ...],
    values: Any,
    done: list[Outcome],
    eval_freq: int,
) -> LearningResult:
    """Put the seeds' records on one axis of checkpoints."""
    n = max(outcome.steps for outcome in done) // eval_freq + 1
    training = np.stack([outcome.record.training_return[:n] for outcome in done])
    greedy = np.stack([outcome.record.greedy_return[:n] for outcome in done])
    episodes = np.stack([outcome.record.episodes[:n] for outcome in done])
    guard_share = np.stack([outcome.record.guard_share[:n] for outcome in done])
    for k, outcome in enumerate(done):
        last = outcome.steps // eval_freq
        for held in (greedy, episodes, guard_share):
            held[k, last + 1 :] = held[k, last]
    return LearningResult(
        task=task,
        learner=learner,
        seeds=seeds,
        values=frozen(values) if isinstance(values, np.ndarray) else values,
        steps=frozen(np.arange(n) * eval_freq),
        training_return=frozen(training),
        greedy_return=frozen(greedy),
        episodes=frozen(episodes),
        steps_used=frozen(np.array([outcome.steps for outcome in done])),
        episodes_used=frozen(np.array([outcome.episodes for outcome in done])),
        out_of_memory=frozen(np.array([outcome.out_of_memory for outcome in done])),
        guard_share=frozen(guard_share),
        snapshots=_film(seeds[0], done[0], None if values is None else values[0], eval_freq),
    )


def _film(seed: int, outcome: Outcome, last: Any, eval_freq: int) -> Snapshots | None:
    """Return what was kept of a seed's tables, the last of them included; None if nothing was."""
    record = outcome.record
    if not len(record.frame_at):
        return None
    shot = record.frame_at * eval_freq <= outcome.steps
    steps, frames = record.frame_at[shot] * eval_freq, record.frames[shot]
    if isinstance(last, np.ndarray) and steps[-1] < outcome.steps:
        steps = np.append(steps, outcome.steps)
        frames = np.concatenate([frames, last[None].astype(np.float32)])
    return Snapshots(seed, frozen(steps), frozen(frames))


def one_seed(result: LearningResult, k: int) -> LearningResult:
    """Return the result of the k-th seed alone, on the axis of all.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> one_seed(learn(GridWorld("S.T"), budget=100, seeds=3), 2).seeds
    (2,)
    """
    rows = {
        name: getattr(result, name)[k : k + 1]
        for name in (
            "training_return",
            "greedy_return",
            "episodes",
            "guard_share",
            "steps_used",
            "episodes_used",
            "out_of_memory",
        )
    }
    values = None if result.values is None else result.values[k : k + 1]
    return replace(
        result,
        seeds=result.seeds[k : k + 1],
        values=values,
        snapshots=None if k else result.snapshots,
        **rows,
    )


def joined_results(parts: Sequence[LearningResult]) -> LearningResult:
    """Return the results of several groups of seeds as one, in the order of the seeds' numbers.

    After a seed's end its last greedy return, episodes and trust stand, as within one result.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> parts = [learn(GridWorld("S.T"), budget=100, seeds=[seed]) for seed in (4, 2)]
    >>> joined_results(parts).seeds
    (2, 4)
    """
    n = max(len(part.steps) for part in parts)
    seeds = [seed for part in parts for seed in part.seeds]
    order = np.argsort(seeds)

    def joined(name: str) -> Any:
        each = [getattr(part, name) for part in parts]
        if any(one is None for one in each):
            return None
        if not all(isinstance(one, np.ndarray) for one in each):
            flat = [values for one in each for values in one]
            return tuple(flat[k] for k in order)
        return frozen(np.concatenate(each)[order])

    def held(name: str) -> Any:
        rows = [
            np.pad(getattr(part, name), ((0, 0), (0, n - len(part.steps))), mode="edge")
            for part in parts
        ]
        return frozen(np.concatenate(rows)[order])

    def silent(name: str) -> FloatArray:
        rows = np.full((len(seeds), n), np.nan)
        first = 0
        for part in parts:
            rows[first : first + len(part.seeds), : len(part.steps)] = getattr(part, name)
            first += len(part.seeds)
        return frozen(rows[order])

    snapshots = [part.snapshots for part in parts if part.snapshots is not None]
    return replace(
        max(parts, key=lambda part: len(part.steps)),
        seeds=tuple(sorted(seeds)),
        values=joined("values"),
        training_return=silent("training_return"),
        greedy_return=held("greedy_return"),
        episodes=held("episodes"),
        guard_share=held("guard_share"),
        steps_used=joined("steps_used"),
        episodes_used=joined("episodes_used"),
        out_of_memory=joined("out_of_memory"),
        snapshots=min(snapshots, key=lambda snapshots: snapshots.seed) if snapshots else None,
    )
