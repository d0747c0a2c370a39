"""The trainers of one seed, one for each kind of table: each fills tables and runs a loop on them.

Q-learning on unshaped rewards has a fast loop: on dense tables, on sparse ones, or on those of a
portfolio, side by side; so has planning in a learnt model. All else has the general loop.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatArray, FloatTable, IntArray, frozen
from curricle.errors import SettingError
from curricle.learning.general_loop import Acting, Course, GeneralTables, train
from curricle.learning.learners import Q_LEARNING, Learner, OptimisticQLearning, RMax, Visits
from curricle.learning.model_based import LearntModel
from curricle.learning.portfolio import (
    OPTIMIST,
    SOBER,
    Floor,
    Members,
    Portfolio,
    Tally,
    longest_turn,
    source_is_ahead,
)
from curricle.learning.potential import PairPotential
from curricle.learning.q_learning import Beside, train_q_learning
from curricle.learning.record import Checkpoint, Record, note
from curricle.learning.result import Outcome, ended_by
from curricle.learning.seeds import SeedSettings
from curricle.learning.shaping import QInitialisation, Shaping
from curricle.learning.stopping import MEMORY_FULL, Budget, StoppingKernel, limits
from curricle.learning.storage import (
    DenseTable,
    SparseTable,
    SparseValues,
    StaticInt,
    Storage,
    reorder,
)
from curricle.learning.value_lookup import ValueLookup, no_sources, read_rows
from curricle.planning.policy_evaluation import EvaluationKernel, steps_of
from curricle.tasks.kernel import address_of, compiled, splitmix64
from curricle.tasks.live import masks_actions, open_model
from curricle.tasks.mdp import NO_LIMIT, GenerativeModel, available_actions, closed
from curricle.tasks.models import has_users_code

NEAR = 32_768  # bytes of a table that stays in the processor's nearest cache
AS_PHI = np.array([[0.0, -np.inf, np.inf]])  # the start of a table's only row of a state
UNROLLED = 64  # actions up to which a loop is compiled for their number: an eighth faster


class Seed(NamedTuple):
    """A seed in its run."""

    start: int  # of its random stream
    settings: SeedSettings
    out: FloatTable | None  # (S, A) where its dense values go; they are dropped without it
    record: Record
    evaluation: EvaluationKernel

    @property
    def initial(self) -> PairPotential | None:
        """The potential that Q starts at; None for the learner's initial value."""
        shaping = self.settings.shaping
        return shaping.potential if shaping is not None and shaping.starts_at_potential else None


class Totals(NamedTuple):
    """What a loop returns."""

    steps: int
    episodes: int


@dataclass(frozen=True)
class Run:
    """The settings that all seeds of a call of :func:`learn` share."""

    task: GenerativeModel
    learner: Learner
    budget: Budget
    eval_freq: int
    longest: int  # a bound of the steps that both limits allow
    evaluation: EvaluationKernel
    stopping: StoppingKernel
    storage: Storage
    rows: int  # that a sparse table may have; 0 for a dense table
    horizon: float | None  # H of optimists; None where a stated rate holds
    bounds: tuple[float, float] | None  # of values, where a portfolio's task has tables
    floor_steps: int  # that it took to estimate the floor of the stopping rule

    @property
    def limits(self) -> tuple[int, int]:
        """The most steps and episodes."""
        return limits(self.budget)

    @property
    def shape(self) -> tuple[int, int]:
        """S and A."""
        return self.task.states.size, self.task.actions.size

    @property
    def width(self) -> StaticInt:
        """A, where loops along a row are to be unrolled."""
        n_actions = self.task.actions.size
        return (None,) * (n_actions if n_actions <= UNROLLED else 0)

    def train(
        self,
        settings: SeedSettings,
        start: int,
        out: FloatTable | None,
        snapshots: int = 0,
        begun: Callable[[Record], Any] = lambda record: None,
    ) -> Outcome:
        """Train a seed, its stream starting at `start`, into `out`; `begun` gets its record."""
        kept = () if self.rows else (snapshots, self.shape)
        unknown = out is not None and self.task.terminal is None
        checkpoints = self.longest // self.eval_freq + 1
        record = Record.empty(checkpoints, *kept, unknown_ends=unknown)
        begun(record)
        seed = Seed(start, settings, out, record, self.evaluation.for_run(start))
        return self.trainer(settings.shaping)(self, seed)

    def trainer(self, shaping: Shaping | None) -> "Trainer":
        """Return the trainer of the tables that a shaping needs."""
        if isinstance(self.learner, RMax):
            return train_model
        if self.plain(shaping):
            return train_sparse if self.rows else train_dense
        if shaping is not None and shaping.portfolio is not None:
            return train_portfolio
        return train_learner

    def plain(self, shaping: Shaping | None) -> bool:
        """Return whether this is Q-learning on unshaped rewards, which has a loop of its own."""
        # The fast loop keeps maxima, which a mask that comes later would make wrong.
        if self.learner.update != Q_LEARNING or masks_actions(self.task):
            return False
        return shaping is None or (shaping.starts_at_potential and shaping.portfolio is None)

    def loop(
        self, loop: Callable[..., Any], seed: Seed, learns: object, view: object, q: FloatTable
    ) -> Totals:
        """Run a loop on a table or learners.

        It evaluates a view such as `view`; `q`, (m, S, A), are the m tables of the learner.
        """
        discount, limit = self.task.discount, self.task.time_limit
        limit = int(NO_LIMIT if limit is None else limit)
        steps, episodes = self.limits
        visits, (n_states, n_actions) = None, self.shape
        if n_tables := self.learner.counts:
            rows = self.rows + 1 if self.rows else n_tables * n_states
            visits = np.zeros((rows, n_actions), np.int64)
        noted = seed.record, self.stopping, Checkpoint(0, 0, 0, 0, *[0.0] * 4)  # for the types
        with open_model(self.task, seed.start, q) as model:
            course = Course(
                discount,
                limit,
                longest_turn(discount, limit),
                np.uint64(seed.start),
                steps - seed.settings.charged,
                episodes,
                self.stopping,
                self.eval_freq,
                seed.evaluation.compiled_for(model, view),
                seed.record,
                address_of(compiled(note, False), *noted, q[0], q[0]),
            )
            rule = self.learner.kernel(visits)
            totals = compiled(loop, has_users_code(model))(model, rule, learns, course)
        if seed.record.halted[0]:
            raise KeyboardInterrupt  # half-learnt values must not be taken for a result
        return Totals(*totals)

    def outcome(
        self,
        seed: Seed,
        values: FloatTable | SparseValues | None,
        totals: Totals,
        *,
        out_of_memory: bool = False,
    ) -> Outcome:
        """Return the outcome of a seed, with what ended its run."""
        ending, last = MEMORY_FULL, totals.steps // self.eval_freq
        if not out_of_memory:
            ending = ended_by(self.budget, self.stopping, seed.record, last, self.eval_freq)
        counts = *totals, steps_of(seed.evaluation)
        bounds = self.stopping.level, self.stopping.floor
        return Outcome(seed.record, values, *counts, ending, *bounds, self.floor_steps)

    # -- tables, filled and cleared ----------------------------------------------------------------

    def filled(
        self,
        potential: PairPotential | None,
        q: FloatTable | None = None,
        initial: float | None = None,
    ) -> FloatTable:
        """Fill a table, a new one without `q`, with an initial value plus the potential.

        By default it is that of the learner.
        """
        q = np.empty(self.shape, self.storage.dtype) if q is None else q
        initial = float(self.learner.initial_value) if initial is None else initial
        if potential is None:
            q[...] = initial
        else:
            potential.fill(q, initial)
        return self.closed(q)

    def closed(self, q: FloatTable) -> FloatTable:
        """Return a table with 0 in terminal states and -inf at pairs that are not available."""
        if self.task.terminal is not None:
            q[self.task.terminal] = 0.0
        if (available := available_actions(self.task)) is not None:
            q[~available] = -np.inf  # so that no policy takes it, and no target is read from it
        return q

    def dense(self, seed: Seed, q: FloatTable, n: StaticInt = (None,)) -> DenseTable:
        """Return a table, or n whose rows alternate, as the fast loop reads it."""
        row_max, row_argmax = np.empty(len(q), q.dtype), np.empty(len(q), np.uint16)
        key, far = np.uint64(splitmix64(seed.start)), (None,) * (q.nbytes > NEAR)
        return DenseTable(q, row_max, row_argmax, key, n, np.uint64(len(n)), self.width, far)

    def only_ends(
        self,
        record: Record,
        tables: FloatTable,
        potential: PairPotential | None,
        initial: float | None = None,
    ) -> IntArray:
        """Return the noted ends that still have the values that they started with, which are 0.

        A state in which an episode has ended, and another has gone on, is no end of the task's.
        """
        ends = np.flatnonzero(record.ends)
        initial = float(self.learner.initial_value) if initial is None else initial
        phi = 0.0 if potential is None else potential.pairs(ends)
        start = np.broadcast_to(phi + initial, (len(ends), tables.shape[2]))
        values = tables[:, ends]
        untouched = (values == start.astype(values.dtype)) | np.isneginf(values)
        return np.asarray(ends[untouched.all(axis=(0, 2))])


Trainer = Callable[[Run, Seed], Outcome]


# -- one trainer a kind of table -------------------------------------------------------------------


def train_dense(run: Run, seed: Seed) -> Outcome:
    """Train on a row for every state; an optimistic learner also on the table that it acts on."""
    q = run.filled(seed.initial, seed.out)
    acting, sober = q, run.dense(seed, q)
    tables: Any = sober, sober, None, None, None
    if isinstance(run.learner, OptimisticQLearning):
        assert run.learner.value_range is not None
        assert run.learner.initial_value is not None
        lowest, highest = run.learner.value_range
        acting = run.closed(np.add(q, highest - run.learner.initial_value, dtype=q.dtype))
        visits = Visits.none(np.zeros(run.shape, np.uint64), run.horizon or 0.0)
        beside = Beside(highest, highest - lowest or 1.0, visits)
        tables = run.dense(seed, acting), sober, beside, None, None
    totals = run.loop(train_q_learning, seed, tables, sober, acting[None])
    q[run.only_ends(seed.record, q[None], seed.initial)] = 0.0
    return run.outcome(seed, seed.out, totals)


def train_model(run: Run, seed: Seed) -> Outcome:
    """Train a learner that plans in a model: the table that it acts on, and that of Q."""
    learner: Any = run.learner
    q, phi, bounds = run.filled(None, seed.out), seed.initial, learner.value_range
    acting = np.full_like(q, bounds[1])
    if phi is not None:
        acting[...] = Portfolio().informed(phi, bounds)
    tables = run.dense(seed, run.closed(acting)), run.dense(seed, q)
    model = LearntModel.empty(tables, learner, run.task.discount, run.longest)
    totals = run.loop(train_q_learning, seed, (*tables, None, None, model), tables[1], acting[None])
    q[run.only_ends(seed.record, q[None], None)] = 0.0
    return run.outcome(seed, seed.out, totals)


def train_sparse(run: Run, seed: Seed) -> Outcome:
    """Train on a row for every state that is visited."""
    lookup = no_sources(run.shape[1]) if seed.initial is None else seed.initial.kernel()
    initial = float(run.learner.initial_value)
    table = empty_sparse_table(run, seed, lookup._replace(initial=initial))
    tables = table, table, None, None, None
    totals = run.loop(train_q_learning, seed, tables, table, table.q[None])
    return sparse_outcome(run, seed, totals, table)


def sparse_outcome(
    run: Run, seed: Seed, totals: Totals, table: SparseTable, phi: ValueLookup | None = None
) -> Outcome:
    """Return the outcome of a seed with a table's rows of the states visited, or with phi's."""
    (steps, episodes), (most_steps, most_episodes) = totals, run.limits
    ended_early = steps < most_steps - seed.settings.charged and episodes < most_episodes
    values = None
    if run.storage.save_values:  # of the states that have a row, in their order
        n = len(table.starts)  # the rows of a state
        used = slice(n, int(table.used[0]), n)
        order = np.argsort(table.states[used])
        states, q = table.states[used][order].astype(np.int64), np.ascontiguousarray(table.q[used])
        reorder(q, order)
        if phi is not None:
            rows = np.empty(q.shape)
            read_rows(phi, states, rows)
            q[...] = closed(rows, available_actions(run.task, states))
        values = SparseValues(frozen(states), frozen(q))
    full = bool(ended_early and not seed.record.stopped[0])
    return run.outcome(seed, values, totals, out_of_memory=full)


def empty_sparse_table(
    run: Run, seed: Seed, lookup: ValueLookup, starts: FloatArray = AS_PHI
) -> SparseTable:
    """Return a sparse table that reads the rows of new states from a potential."""
    # Pages of np.empty and np.zeros take no memory before they are written to.
    n, states, dtype = len(starts), run.rows + 1, run.storage.dtype
    n_states, n_actions = run.shape
    # These are read together, so they lie together: a cache miss takes as long as all the rest.
    fields = [("state", "u8"), ("best", dtype), ("greedy", "u2")]
    heads = np.empty(n * states, np.dtype(fields, align=True))
    return SparseTable(
        np.empty((n * states, n_actions), dtype),
        heads["best"],
        heads["greedy"],
        np.empty(n_actions),
        np.empty((1, n_actions), dtype),
        heads["state"],
        np.zeros(2 ** (3 * states // 2).bit_length(), np.int32),
        np.full(1, n, np.int64),
        lookup,
        starts,
        getattr(run.task.model, "available", None),
        np.uint64(splitmix64(seed.start)),
        np.uint64(n_states),
        (None,) * n,
        run.width,
        (None,),
    )


def check_sparse(run: Run, settings: Sequence[SeedSettings]) -> None:
    """Raise SettingError unless sparse tables can be trained with every seed's shaping."""
    for shaping in (seed.shaping for seed in settings):
        several = shaping is not None and shaping.portfolio is not None
        if not (run.plain(shaping) or several) or run.learner.asks_task:
            raise SettingError(
                "sparse tables are for QLearning with QInitialisation or LookAheadAdvice: got "
                f"{type(run.learner).__name__} with {shaping.name if shaping else 'no shaping'}"
            )


def train_portfolio(run: Run, seed: Seed) -> Outcome:
    """Train a portfolio: rows of the optimists, the sober learner and visits lie side by side."""
    shaping: Any = seed.settings.shaping
    portfolio, phi = shaping.portfolio, shaping.potential
    stated = portfolio.value_range or run.bounds
    starts, (n_states, n_actions), first = portfolio.starts(phi, stated), run.shape, int(SOBER)
    lowest, highest = starts[[SOBER, OPTIMIST], 1]
    table: Any
    if run.rows:
        table = empty_sparse_table(run, seed, phi.kernel(gaps=True), starts)
        rows = q = table.q
        sober = table._replace(lookup=no_sources(n_actions, lowest))
        # No state has a row of its own: phi is read where it is asked for.
        source = table._replace(lookup=phi.kernel(), slots=np.zeros(1, np.int32), n=(None,))
    else:
        rows = np.zeros((4 * n_states + 3, n_actions), run.storage.dtype)
        q = rows[: 4 * n_states]
        for member, start in enumerate((portfolio.informed(phi, stated), highest, lowest)):
            q[member::4] = start
            run.closed(q[member::4])
        sober = table = run.dense(seed, q, (None,) * 4)
        source = run.dense(seed, run.filled(phi, initial=0.0))
    # The sober rows are every fourth from theirs on: a table of a type for which evaluation is
    # compiled already.
    row_max, row_argmax = table.row_max[first:], table.row_argmax[first:]
    sober = sober._replace(q=rows[first : first + len(q)], n=(None,), far=source.far)
    sober = sober._replace(row_max=row_max, row_argmax=row_argmax)
    ceiling, lost = highest if stated else np.inf, np.zeros(1)
    horizon, tally = run.horizon or 0.0, Tally.empty()
    floor = None if stated else Floor(np.zeros(2), lost, horizon)
    memory = q.reshape(-1), Visits.none(q.view(f"u{q.itemsize}"), horizon)
    members = Members(portfolio.shares, tally, ceiling, floor, *memory, sober, source)
    tables = table, sober, None, members, None
    totals = run.loop(train_q_learning, seed, tables, sober, q[None])
    ahead = source_is_ahead(tally)
    if lost[0] < 0.0:
        sober.q[: int(table.used[0]) if run.rows else len(q) : 4] += lost
        for k, values in zip(seed.record.snapshot_at, seed.record.snapshots, strict=True):
            values += lost * (seed.record.source_share[k] == 0.0)
    if run.rows:
        return sparse_outcome(run, seed, totals, sober, source.lookup if ahead else None)
    if seed.out is not None:
        sober_values = q[first::4]
        seed.out[...] = source.q if ahead else sober_values
        run.closed(seed.out)
        seed.out[run.only_ends(seed.record, sober_values[None], None, lowest + lost[0])] = 0.0
    return run.outcome(seed, seed.out, totals)


def train_learner(run: Run, seed: Seed) -> Outcome:
    """Train a learner of any rule with any shaping."""
    shaping, record = seed.settings.shaping or QInitialisation(), seed.record
    q = np.empty((run.learner.tables, *run.shape), run.storage.dtype)
    for table in q:
        run.filled(seed.initial, table)
    learner = GeneralTables.starting(q, run.learner.update, shaping.kernel())
    totals = run.loop(train, seed, learner, Acting(q, learner.values), q)
    for checkpoint, values in zip(record.snapshot_at, record.snapshots, strict=True):
        values += shaping.offset(checkpoint * run.eval_freq)
    if seed.out is not None:
        seed.out[...] = q.mean(axis=0) + shaping.offset(totals.steps)
        seed.out[run.only_ends(record, q, seed.initial)] = 0.0
    return replace(run.outcome(seed, seed.out, totals), own_rewards=shaping.own_rewards)
