"""One seed's training: its table, its loop, what it leaves behind."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.errors import SettingError
from curricle.learning import general_loop
from curricle.learning.guard import train_guarded
from curricle.learning.learners import Learner
from curricle.learning.potential import MappedPotential
from curricle.learning.q_learning import train_q_learning
from curricle.learning.record import NO_WARM_UP, Bounds, Record, Spent, WarmUp, snapshot_checkpoints
from curricle.learning.shaping import NOTHING_ADDED, Shaping
from curricle.learning.stopping import NEVER_STOPS, StoppingKernel, opens
from curricle.learning.storage import SparseValues, Storage
from curricle.learning.tables import Dense, Number, Sparse, reorder
from curricle.learning.value_lookup import no_sources, read_table
from curricle.planning.policy_evaluation import EvaluationKernel
from curricle.tasks.draws import splitmix64_number
from curricle.tasks.generative_models import Functions
from curricle.tasks.live import open_model
from curricle.tasks.mdp import NO_LIMIT
from curricle.tasks.overloads import compiled
from curricle.tasks.spaces import frozen
from curricle.tasks.task import GenerativeModel

FloatTable = npt.NDArray[np.floating[Any]]

NEAR = 32_768
"""Bytes of a table that stays in the processor's nearest cache."""
UNROLLED = 64
"""Actions up to which a loop is compiled for their number: an eighth faster."""


@dataclass(frozen=True)
class Outcome:
    """What one seed leaves: its record, its values if kept, what it spent."""

    record: Record
    values: FloatTable | SparseValues | None
    steps: int
    episodes: int
    out_of_memory: bool


class _Seed(NamedTuple):
    """What one seed brings to its loop."""

    start: int
    steps: int
    shaping: Shaping | None
    out: FloatTable | None
    record: Record
    spent: Spent

    @property
    def initial(self) -> Any:
        """The potential that Q starts at; None for the learner's initial value."""
        shaped = self.shaping
        return shaped.potential if shaped is not None and shaped.starts_at_potential else None


@dataclass(frozen=True)
class Run:
    """What the seeds of one call of :func:`learn` share.

    `rows` are those that a sparse table may have; 0 means a dense table. `longest` are the steps
    that a run can take at most.
    """

    task: GenerativeModel
    learner: Learner
    steps: int
    episodes: int
    eval_freq: int
    longest: int
    evaluation: EvaluationKernel
    storage: Storage
    rows: int
    stopping: StoppingKernel = NEVER_STOPS

    def train(
        self,
        start: int,
        shaping: Shaping | None = None,
        out: FloatTable | None = None,
        warm_up: WarmUp = NO_WARM_UP,
        charged: int = 0,
        frames: int = 0,
    ) -> Outcome:
        """Return what one seed learns, its random stream starting at `start`.

        `out`, (S, A), is where dense values are to go; they are dropped without it. `charged` steps
        are off the budget. Up to `frames` tables are kept on the way.
        """
        size = self.longest // self.eval_freq + 1
        shape = (0, 0) if self.rows else (self.task.states.size, self.task.actions.size)
        frame_at = snapshot_checkpoints(
            0 if self.rows else frames, size, max(1, shape[0] * shape[1])
        )
        returns, greedy, guard_share = np.full((3, size), np.nan)
        pictures = np.zeros((len(frame_at), *shape), np.float32)
        record = Record(returns, greedy, guard_share, np.zeros(size, int), frame_at, pictures)
        spent = warm_up.write(record, self.eval_freq)
        seed = _Seed(start, self.steps - charged, shaping, out, record, spent)
        if shaping is not None and shaping.guard is not None:
            return self._train_guarded(seed)
        return self._train_plainly(seed) if self.plain(shaping) else self._train_shaped(seed)

    def plain(self, shaping: Shaping | None) -> bool:
        """Return whether this is Q-learning on unshaped rewards, which has a loop of its own."""
        if self.learner.update != general_loop.Q_LEARNING:
            return False
        return shaping is None or (shaping.starts_at_potential and shaping.guard is None)

    def _train_plainly(self, seed: _Seed) -> Outcome:
        key = np.uint64(splitmix64_number(seed.start))
        table: Dense | Sparse
        if self.rows:
            table = self._sparse(seed.initial, key)
        else:
            q = self._empty() if seed.out is None else seed.out
            self._fill(q, seed.initial)
            table = self._dense(q, key)
        steps, episodes = self._loop(train_q_learning, len(table.q), seed, table)
        values: FloatTable | SparseValues | None = seed.out
        if isinstance(table, Sparse) and self.storage.save_values:
            met = slice(1, int(table.used[0]))
            order = np.argsort(table.states[met])
            states, q = table.states[met][order].astype(np.int64), table.q[met]
            reorder(q, order)
            values = SparseValues(frozen(states), frozen(q))
        early = steps < seed.steps and episodes < self.episodes
        full = early and not self._passed(seed, steps)
        return Outcome(seed.record, values, steps, episodes, full)

    def _passed(self, seed: _Seed, steps: int) -> bool:
        """Return whether a run that ended at so many steps ended by its stopping rule."""
        checkpoint, beyond = divmod(steps, self.eval_freq)
        return not beyond and bool(
            opens(self.stopping, seed.record.greedy_return, checkpoint, steps)
        )

    def _train_shaped(self, seed: _Seed) -> Outcome:
        shaping = seed.shaping
        q = np.stack([self._empty() for _ in range(self.learner.tables)])
        for table in q:
            self._fill(table, seed.initial)
        kernel = NOTHING_ADDED if shaping is None else shaping.kernel()
        steps, episodes = self._loop(general_loop.train, q.shape[1], seed, kernel, q)
        offset = (lambda step: 0.0) if shaping is None else shaping.offset
        for checkpoint, frame in zip(seed.record.frame_at, seed.record.frames, strict=True):
            frame += offset(checkpoint * self.eval_freq)
        if seed.out is not None:
            seed.out[...] = q.mean(axis=0) + offset(steps)
        return Outcome(seed.record, seed.out, steps, episodes, False)

    def _train_guarded(self, seed: _Seed) -> Outcome:
        guard = seed.shaping.guard if seed.shaping is not None else None
        assert guard is not None
        q = np.stack([self._empty(), self._empty()])
        for table, knowledge in zip(q, (None, seed.initial), strict=True):
            self._fill(table, knowledge)
        steps, episodes, ahead = self._loop(train_guarded, q.shape[1], seed, guard.kernel, q)
        if seed.out is not None:
            seed.out[...] = q[ahead]
        return Outcome(seed.record, seed.out, steps, episodes, False)

    def _loop(self, loop: Callable[..., Any], rows: int, seed: _Seed, *tables: Any) -> Any:
        """Run a loop on its tables, of so many rows, and return the steps and episodes done."""
        limit = self.task.time_limit
        with open_model(self.task.model, seed.start) as model:
            return compiled(loop, isinstance(model, Functions))(
                model,
                (self.task.discount, np.int64(NO_LIMIT if limit is None else limit)),
                self.learner.rule(rows, self.task.actions.size),
                *tables,
                self.evaluation.for_run(seed.start),
                np.array([seed.start], dtype=np.uint64),
                seed.spent,
                Bounds(seed.steps, self.episodes, self.stopping),
                self.eval_freq,
                seed.record,
            )

    @property
    def _width(self) -> Number:
        n_actions = self.task.actions.size
        return number(n_actions if n_actions <= UNROLLED else 0)

    def _empty(self) -> FloatTable:
        return np.empty((self.task.states.size, self.task.actions.size), self.storage.dtype)

    def _fill(self, q: FloatTable, potential: Any) -> None:
        """Write the initial value, and the potential if there is one, into a table."""
        initial = float(self.learner.initial_value)
        if isinstance(potential, MappedPotential):
            read_table(potential.lookup._replace(initial=initial), q)
        elif potential is None:
            q[...] = initial
        else:
            np.add(potential.values, initial, out=q, casting="same_kind")
        if self.task.terminal is not None:
            q[self.task.terminal] = 0.0

    def _dense(self, q: FloatTable, key: np.uint64) -> Dense:
        far = number(q.nbytes > NEAR)
        best, greedy = np.empty(len(q), q.dtype), np.empty(len(q), np.uint16)
        return Dense(q, best, greedy, key, self._width, far)

    def _sparse(self, potential: MappedPotential | None, key: np.uint64) -> Sparse:
        # Pages of np.empty and np.zeros take no memory before they are written to.
        n_actions, rows, dtype = self.task.actions.size, self.rows + 1, self.storage.dtype
        initial = float(self.learner.initial_value)
        lookup = no_sources(n_actions, initial)
        if potential is not None:
            lookup = potential.lookup._replace(initial=initial)
        # What is read together lies together: a miss of the caches costs as much as all else.
        heads = np.empty(
            rows, np.dtype([("state", "u8"), ("best", dtype), ("greedy", "u2")], align=True)
        )
        return Sparse(
            np.empty((rows, n_actions), dtype),
            heads["best"],
            heads["greedy"],
            np.empty(n_actions),
            np.empty((1, n_actions), dtype),
            heads["state"],
            np.zeros(2 ** (3 * rows // 2).bit_length(), np.int32),
            np.ones(1, np.int64),
            lookup,
            key,
            self._width,
            number(1),
        )


def number(n: int) -> Number:
    """Return a number as loops are compiled for it."""
    return (None,) * n


def rows_allowed(
    task: GenerativeModel, tables: int, storage: Storage, seeds: int, at_once: int, steps: int
) -> int:
    """Return the rows a sparse table may have, or 0 if tables are dense; a run has `tables`.

    Raises
    ------
    SettingError
        Before anything is allocated, when the tables do not fit the memory.
    """
    n_states, n_actions = task.states.size, task.actions.size
    held = seeds if storage.save_values else min(at_once, seeds)
    needed = held * storage.dense_bytes(n_states, n_actions, tables)
    if storage.kind == "dense" or (storage.kind == "auto" and needed <= storage.limit):
        if needed > storage.limit:
            raise SettingError(
                f"the values of {held} seeds must fit the memory allowed, "
                f"{storage.limit / 1e9:.3g} GB: {n_states:,} states x {n_actions:,} actions in "
                f"{storage.dtype} take {needed / 1e9:.3g} GB (Storage: memory, dtype, keep, kind)"
            )
        return 0
    fitting = storage.rows_within(storage.limit // held, n_actions)
    # A step meets one state, and another when it starts an episode.
    return max(1, min(fitting, n_states, 2 * steps + 1, 2**31 - 2))
