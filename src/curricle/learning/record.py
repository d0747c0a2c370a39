"""The records of a run: curves and snapshots."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray
from curricle.learning.stopping import stops
from curricle.progress import HALTED
from curricle.tasks.kernel import inlined
from curricle.text import brief_repr

MAX_SNAPSHOT_BYTES = 128_000_000  # of a run: a large task has fewer than asked for, or none


@dataclass(frozen=True, eq=False)
class Snapshots(Frozen):
    """The values that a seed acted on at M checkpoints of its learning, the first at step 0.

    Attributes
    ----------
    seed : int
    steps : (M,) int64
        Steps done; closer together early, when most is learnt.
    values : (M, S, A) float32
        As ``LearningResult.values``.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> snapshots = learn(GridWorld("S.T"), budget=1000, snapshots=4).snapshots
    >>> snapshots.steps, snapshots.values.shape
    (array([   0,  110,  440, 1000]), (4, 3, 4))
    """

    seed: int
    steps: IntArray
    values: npt.NDArray[np.float32]

    __repr__ = brief_repr


class Record(NamedTuple):
    """The records of a run, one entry per checkpoint."""

    training_return: FloatArray  # (T,) mean return of the episodes ended since the last checkpoint
    greedy_return: FloatArray  # (T,)
    source_share: FloatArray  # (T,) 1 where a portfolio's source is evaluated, else 0
    agreement: FloatArray  # (T,) of an optimistic learner's two values of an episode's start
    episodes: IntArray  # (T,)
    snapshot_at: IntArray  # (M,) checkpoints whose tables are kept
    snapshots: npt.NDArray[np.float32]  # (M, S, A)
    ends: BoolArray  # (S,) in which episodes have terminated, where only steps tell; else (0,)
    stopped: BoolArray  # (1,) true once the stopping rule has ended the run
    halted: BoolArray  # (1,) true once nobody waits for the run

    @classmethod
    def empty(
        cls,
        checkpoints: int,
        snapshots: int = 0,
        shape: tuple[int, int] = (0, 0),
        *,
        unknown_ends: bool = False,
    ) -> Self:
        """Return the record to be filled, with up to so many snapshots of tables of a shape."""
        returns, greedy, source_share, agreement = np.full((4, checkpoints), np.nan)
        fitting = min(snapshots, MAX_SNAPSHOT_BYTES // (4 * max(1, shape[0] * shape[1])))
        place = np.linspace(0.0, 1.0, fitting if fitting > 1 else 0) ** 2 * (checkpoints - 1)
        kept = np.unique(place.astype(np.int64))
        tables = np.zeros((len(kept), *shape), np.float32)
        ends = np.zeros(shape[0] if unknown_ends else 0, np.bool_)
        episodes = np.zeros(checkpoints, np.int64)
        stopped = np.zeros(1, np.bool_)
        kinds = kept, tables, ends, stopped, HALTED.get()
        return cls(returns, greedy, source_share, agreement, episodes, *kinds)


class Checkpoint(NamedTuple):
    """What a loop has to note at a checkpoint."""

    number: int  # 0 before the first step
    step: int
    episodes: int
    ended: int  # episodes since the last checkpoint
    ended_return: float  # their returns
    greedy_return: float
    source_share: float
    agreement: float


def note(record, stopping, reached, q, other):
    """Fill a checkpoint of a record; return 1 where the stopping rule ends the run there, else 0.

    `q` and `other`, (S, A), have Q as mean; or every n-th row of (n S, A).
    """
    number = reached.number
    record.training_return[number] = (
        reached.ended_return / reached.ended if reached.ended > 0 else np.nan
    )
    record.greedy_return[number] = reached.greedy_return
    record.source_share[number] = reached.source_share
    record.agreement[number] = reached.agreement
    record.episodes[number] = reached.episodes
    curves = record.greedy_return, record.agreement
    record.stopped[0] = stops(stopping, *curves, number, reached.step)
    missing = record.stopped[0]  # the next snapshot is of the end, where a rule ends the run
    for i in range(record.snapshot_at.shape[0]):
        if missing and record.snapshot_at[i] >= number:
            record.snapshot_at[i], missing = number, False
        if record.snapshot_at[i] == number:
            apart = q.shape[0] // record.snapshots.shape[1]
            for state in range(record.snapshots.shape[1]):
                for action in range(q.shape[1]):
                    mean = 0.5 * (q[apart * state, action] + other[apart * state, action])
                    record.snapshots[i, state, action] = mean
    return 1.0 if record.stopped[0] else 0.0


@inlined
def noted_end(record, state, terminated):
    """Return `terminated`, the end noted where only the steps of a task tell them."""
    if terminated and record.ends.shape[0] > 0:
        record.ends[state] = True
    return terminated
