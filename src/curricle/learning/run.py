"""One seed's training: its tables, the loop that fills them, what it leaves."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatTable, IntArray, frozen
from curricle.learning import general_loop
from curricle.learning.general_loop import Acting, Course, Learners
from curricle.learning.guard import (
    SCRATCH,
    UNDECIDED,
    longest_turn,
)
from curricle.learning.learners import Learner, OptimisticQLearning
from curricle.learning.potential import PairPotential
from curricle.learning.q_learning import train_q_learning
from curricle.learning.record import Bounds, Record, Used
from curricle.learning.seeds import SeedSettings
from curricle.learning.shaping import QInitialisation, Shaping
from curricle.learning.stopping import StoppingKernel, stops
from curricle.learning.storage import (
    DenseTable,
    OptimisticTables,
    SparseTable,
    SparseValues,
    StaticInt,
    Storage,
    reorder,
)
from curricle.learning.value_lookup import no_sources
from curricle.planning.policy_evaluation import EvaluationKernel
from curricle.tasks.kernel import compiled, splitmix64
from curricle.tasks.live import open_model
from curricle.tasks.mdp import NO_LIMIT, GenerativeModel
from curricle.tasks.models import Functions

NEAR = 32_768
"""Bytes of a table that stays in the processor's nearest cache."""
UNROLLED = 64
"""Actions up to which a loop is compiled for their number: an eighth faster."""


@dataclass(frozen=True)
class Outcome:
    """What one seed leaves: its record, its values if saved, its totals.

    `evaluation_steps` and `own_rewards` are as in :class:`LearningResult`, `advice` is
    what the policy acts on besides values.
    """

    record: Record
    values: FloatTable | SparseValues | None
    steps: int
    episodes: int
    evaluation_steps: int
    out_of_memory: bool = False
    own_rewards: bool = True
    advice: Any = 0.0


class _Seed(NamedTuple):
    """A seed in its run."""

    start: int
    settings: SeedSettings
    out: FloatTable | None
    record: Record
    used: Used
    evaluation: EvaluationKernel

    @property
    def initial(self) -> Any:
        """The potential that Q starts at; None for the learner's initial value."""
        shaping = self.settings.shaping
        return shaping.potential if shaping is not None and shaping.starts_at_potential else None


@dataclass(frozen=True)
class Run:
    """What the seeds of one call of :func:`learn` share.

    `limits` are the most steps and episodes, `longest` is a bound of the steps that both allow.
    `rows` are those that a sparse table may have; 0 means a dense table.
    """

    task: GenerativeModel
    learner: Learner
    limits: tuple[int, int]
    eval_freq: int
    longest: int
    evaluation: EvaluationKernel
    stopping: StoppingKernel
    storage: Storage
    rows: int

    def train(
        self, settings: SeedSettings, start: int, out: FloatTable | None, snapshots: int = 0
    ) -> Outcome:
        """Return what one seed learns, its random stream starting at `start`.

        `out`, (S, A), is where dense values are to go; they are dropped without it.
        """
        kept = () if self.rows else (snapshots, self.shape)
        unknown = out is not None and self.task.terminal is None
        n = self.longest // self.eval_freq + 1
        record = Record.empty(n, *kept, unknown_ends=unknown)
        used = settings.warm_up.write(record, self.eval_freq)
        evaluation = self.evaluation.for_run(start)
        seed = _Seed(start, settings, out, record, used, evaluation)
        if not self.plain(settings.shaping):
            return self._train_learners(seed)
        return self._train_sparsely(seed) if self.rows else self._train_densely(seed)

    def plain(self, shaping: Shaping | None) -> bool:
        """Return whether this is Q-learning on unshaped rewards, which has a loop of its own."""
        if self.learner.update != general_loop.Q_LEARNING:
            return False
        return shaping is None or (shaping.starts_at_potential and shaping.guard is None)

    def _train_densely(self, seed: _Seed) -> Outcome:
        q = self._filled(seed.initial, seed.out)
        acts, table = q, self._dense(q, seed)
        if isinstance(self.learner, OptimisticQLearning):
            assert self.learner.value_range is not None
            lowest, highest = self.learner.value_range
            acts = np.add(q, highest - lowest, dtype=q.dtype)
            if self.task.terminal is not None:
                acts[self.task.terminal] = 0.0
            table = OptimisticTables(self._dense(acts, seed), table, highest)
        steps, episodes = self._loop(train_q_learning, seed, table, acts[None])
        q[self._only_ends(seed.record, q[None], seed.initial)] = 0.0
        return self._outcome(seed, q, steps, episodes)

    def _dense(self, q: FloatTable, seed: _Seed) -> Any:
        best, greedy = np.empty(len(q), q.dtype), np.empty(len(q), np.uint16)
        key, far = np.uint64(splitmix64(seed.start)), (None,) * (q.nbytes > NEAR)
        return DenseTable(q, best, greedy, key, self._width, far)

    def _train_sparsely(self, seed: _Seed) -> Outcome:
        table = self._sparse(seed.initial, np.uint64(splitmix64(seed.start)))
        steps, episodes = self._loop(train_q_learning, seed, table, table.q[None])
        checkpoint, rest = divmod(steps, self.eval_freq)
        stopped = not rest and stops(self.stopping, seed.record.greedy_return, checkpoint, steps)
        early = steps < self.limits[0] - seed.settings.charged and episodes < self.limits[1]
        values = _visited(table) if self.storage.save_values else None
        return self._outcome(seed, values, steps, episodes, out_of_memory=early and not stopped)

    def _train_learners(self, seed: _Seed) -> Outcome:
        """Train one learner with a shaping, under a guard another one beside it."""
        shaping, record = seed.settings.shaping or QInitialisation(), seed.record
        guard, n = shaping.guard, 1 if shaping.guard is None else 2
        q = np.empty((n, self.learner.tables, *self.shape), self.storage.dtype)
        for k, tables in enumerate(q):
            for table in tables:
                self._filled(None if guard is not None and k == SCRATCH else seed.initial, table)
        kernel = None if guard is None else guard.kernel
        start = Learners.starting(q, self.learner.update, shaping.kernel(), kernel)
        steps, episodes, ahead = self._loop(general_loop.train, seed, start, q[-1])
        for checkpoint, values in zip(record.snapshot_at, record.snapshots, strict=True):
            if guard is None or record.guard_share[checkpoint] > UNDECIDED:
                step = checkpoint * self.eval_freq
                values += shaping.offset(step) + shaping.advice(step)
        if guard is not None and ahead == SCRATCH:
            shaping = QInitialisation()
        if seed.out is not None:
            initial = shaping.potential if shaping.starts_at_potential else None
            seed.out[...] = q[ahead].mean(axis=0) + shaping.offset(steps)
            seed.out[self._only_ends(record, q[ahead], initial)] = 0.0
        own, advice = shaping.own_rewards, shaping.advice(steps)
        return self._outcome(seed, seed.out, steps, episodes, own_rewards=own, advice=advice)

    def _outcome(self, seed: _Seed, values: Any, steps: int, episodes: int, **more: Any) -> Outcome:
        return Outcome(
            seed.record,
            None if seed.out is None and not self.rows else values,
            steps,
            episodes,
            seed.evaluation.steps,
            **more,
        )

    def _loop(self, loop: Callable[..., Any], seed: _Seed, learns: Any, q: FloatTable) -> Any:
        """Run a loop on a table or learners and return what it returns.

        `q`, (m, S, A), are the tables of the learner that acts first.
        """
        discount, limit = self.task.discount, self.task.time_limit
        steps, episodes = self.limits
        with self.opened(seed.settings, seed.start, q) as model:
            course = Course(
                discount,
                limit := int(NO_LIMIT if limit is None else limit),
                longest_turn(discount, limit),
                np.uint64(seed.start),
                seed.used,
                Bounds(steps - seed.settings.charged, episodes, self.stopping),
                self.eval_freq,
                seed.evaluation.compiled_for(model, _evaluated(learns)),
                seed.record,
                general_loop.address_of_note(seed.record, self.stopping, q[0]),
            )
            rule = self.learner.kernel(self._visits())
            totals = compiled(loop, isinstance(model, Functions))(model, rule, learns, course)
        if seed.record.halted[0]:
            raise KeyboardInterrupt  # what is half learnt must not be taken for a result
        return totals

    def opened(
        self, settings: SeedSettings, start: int, q: FloatTable
    ) -> AbstractContextManager[Any]:
        """Return a context with the model that one seed's loop samples.

        `start` is where its random stream starts, `q`, (m, S, A), the tables that are acted on.
        """
        return open_model(self.task, start)

    @property
    def shape(self) -> tuple[int, int]:
        """S and A."""
        return self.task.states.size, self.task.actions.size

    @property
    def _width(self) -> StaticInt:
        n_actions = self.task.actions.size
        return (None,) * (n_actions if n_actions <= UNROLLED else 0)

    def _visits(self) -> IntArray | None:
        """Return counts of updates, of which there are none yet; None if none are needed."""
        n_tables, n_actions = self.learner.counts, self.task.actions.size
        if not n_tables:
            return None
        rows = self.rows + 1 if self.rows else n_tables * self.task.states.size
        return np.zeros((rows, n_actions), np.int64)

    def _filled(self, potential: Any, q: FloatTable | None = None) -> FloatTable:
        """Return a table, a new one unless given, of the initial value plus the potential."""
        q = np.empty(self.shape, self.storage.dtype) if q is None else q
        initial = float(self.learner.initial_value)
        if potential is None:
            q[...] = initial
        else:
            potential.fill(q, initial)
        if self.task.terminal is not None:
            q[self.task.terminal] = 0.0
        return q

    def _only_ends(self, record: Record, tables: FloatTable, potential: Any) -> IntArray:
        """Return the noted ends that still have the values that they started with, which are 0.

        A state in which an episode has ended, and another has gone on, is no end of the task's.
        """
        ends = np.flatnonzero(record.ends)
        initial = float(self.learner.initial_value)
        phi = 0.0 if potential is None else potential.pairs(ends)
        start = np.broadcast_to(phi + initial, (len(ends), tables.shape[2]))
        same: Any = (tables[:, ends] == start.astype(tables.dtype)).all(axis=(0, 2))
        return np.asarray(ends[same])

    def _sparse(self, potential: PairPotential | None, key: np.uint64) -> SparseTable:
        # Pages of np.empty and np.zeros take no memory before they are written to.
        n_actions, rows, dtype = self.task.actions.size, self.rows + 1, self.storage.dtype
        lookup = no_sources(n_actions) if potential is None else potential.kernel
        assert lookup is not None
        # These are read together, so they lie together: a cache miss takes as long as all the rest.
        heads = np.empty(
            rows, np.dtype([("state", "u8"), ("best", dtype), ("greedy", "u2")], align=True)
        )
        return SparseTable(
            np.empty((rows, n_actions), dtype),
            heads["best"],
            heads["greedy"],
            np.empty(n_actions),
            np.empty((1, n_actions), dtype),
            heads["state"],
            np.zeros(2 ** (3 * rows // 2).bit_length(), np.int32),
            np.ones(1, np.int64),
            lookup._replace(initial=float(self.learner.initial_value)),
            key,
            self._width,
            (None,),
        )


def _evaluated(learns: Any) -> Any:
    """Return the view of a table, or of learners, that their loop evaluates."""
    if not isinstance(learns, Learners):
        return learns.learnt if isinstance(learns, OptimisticTables) else learns
    return Acting(learns.q[0], False, learns.shaping.pair_values, 0.0, learns.values)


def _visited(table: SparseTable) -> SparseValues:
    """Return the values of the states that have a row; the table is put in their order."""
    rows = slice(1, int(table.used[0]))
    order = np.argsort(table.states[rows])
    states, q = table.states[rows][order].astype(np.int64), table.q[rows]
    reorder(q, order)
    return SparseValues(frozen(states), frozen(q))
