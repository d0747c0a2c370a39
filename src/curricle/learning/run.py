"""Training one task over many seeds: :func:`learn`, and the run of each seed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatTable, IntArray, frozen
from curricle.checks import instance, whole_number
from curricle.errors import SettingError
from curricle.learning.general_loop import Acting, Course, Learners, note, train
from curricle.learning.learners import Q_LEARNING, Learner, OptimisticQLearning, QLearning
from curricle.learning.portfolio import (
    NO_PORTFOLIO,
    UNDECIDED,
    Members,
    Tally,
    longest_turn,
    optimism,
)
from curricle.learning.q_learning import Beside, train_q_learning
from curricle.learning.record import Record, Used, WarmUp
from curricle.learning.result import LearningResult, Outcome, learning_result
from curricle.learning.seeds import SeedSettings, over_seeds, seed_settings, threads_for
from curricle.learning.shaping import QInitialisation, Shaping
from curricle.learning.stopping import (
    NEVER_STOPS,
    Budget,
    StoppingKernel,
    StoppingRule,
    levels,
    limits,
    longest_run,
    spacing,
    stops,
)
from curricle.learning.storage import (
    DenseTable,
    SparseTable,
    SparseValues,
    StaticInt,
    Storage,
    reorder,
    rows_allowed,
)
from curricle.learning.value_lookup import no_sources
from curricle.planning.greedy import TIED
from curricle.planning.policy_evaluation import (
    EvaluationKernel,
    ExactEvaluation,
    GreedyEvaluation,
    RolloutEvaluation,
    address_of,
)
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.tasks.kernel import compiled, splitmix64, stream_start
from curricle.tasks.live import masks_actions, open_model
from curricle.tasks.mdp import (
    NO_LIMIT,
    GenerativeModel,
    Task,
    availability,
    available_actions,
    generative_model,
)
from curricle.tasks.models import Functions

MOST_ACTIONS = int(TIED)  # actions that 15 bits can tell apart
SHORT = 2**20
"""Steps, of evaluations too, for which an interrupt can wait: 5 to 200 ms; a thread costs .15."""
NEAR = 32_768  # bytes of a table that stays in the processor's nearest cache
UNROLLED = 64  # actions up to which a loop is compiled for their number: an eighth faster


def learn(
    task: Task,
    learner: Learner | None = None,
    budget: Budget = 100_000,
    *,
    seeds: int | Sequence[int] = 1,
    shaping: Shaping | Sequence[Shaping] | None = None,
    eval_freq: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    storage: Storage | None = None,
    stream: str = "",
    warm_up: Sequence[WarmUp] | None = None,
    charged: Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
    snapshots: int = 0,
    workers: int | None = None,
    progress: Progress = None,
) -> LearningResult:
    """Return the result of training a learner in a task, for each of many seeds.

    Parameters
    ----------
    task : Task
    learner : Learner
        :class:`QLearning` by default.
    budget : int, Episodes or StoppingRule
        Steps (the last episode may be cut), episodes, or steps until learning is good enough.
    seeds : int or sequence of int
        K means seeds 0 .. K-1. The result of a seed does not depend on the other seeds or on
        `workers`.
    shaping : Shaping or sequence of K Shaping, optional
        How a potential enters learning, for all seeds or for each seed.
    eval_freq : int, optional
        Steps between checkpoints; by default a hundredth of a budget in steps, 100 for one in
        episodes.
    evaluation : GreedyEvaluation, optional
    storage : Storage, optional
        Precision of the values, dense or sparse tables, memory; float64 by default.
    stream : str
        Name of the random stream: several trainings of one seed draw independently.
    warm_up : sequence of K WarmUp, optional
        Episodes that each seed played in the task before. They count against the budget and are at
        the start of the curves.
    charged : sequence of K int, optional
        Steps of the budget that each seed used elsewhere, for example in sources.
    snapshots : int
        How many dense tables of the first seed are kept at most (:class:`Snapshots`).
    workers : int, optional
        Threads over seeds; as many as there are processors by default. A live task has one.
    progress : bool or callable, optional
        True shows a bar; a function is called with each seed when it is done.

    Raises
    ------
    SettingError
        When an argument is invalid, before anything runs.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> result = learn(GridWorld("S.T"), QLearning(epsilon=0.2), 1000, seeds=2)
    >>> result.values.shape, result.greedy_return[:, -1].round(2)
    ((2, 3, 4), array([196.01, 196.01]))
    """
    check_progress(progress)
    learner = given_or_default("learner", learner, Learner, QLearning)
    evaluation = given_or_default("evaluation", evaluation, GreedyEvaluation)
    storage = given_or_default("storage", storage, Storage)
    generative = generative_model(task)
    configured, learner = learner, learner.for_task(task)
    if generative.actions.size > MOST_ACTIONS:
        raise SettingError(
            f"a task to be learnt may have at most {MOST_ACTIONS:,} actions: got "
            f"{generative.actions.size:,}"
        )
    most = limits(budget)
    eval_freq = spacing(eval_freq, budget)
    longest = longest_run(generative.time_limit, budget, eval_freq)
    settings = seed_settings(
        seeds,
        learner,
        most,
        lambda shaping: shaping.for_task(task),
        shaping=shaping,
        warm_up=warm_up,
        charged=charged,
    )
    kernel = evaluation.kernel(task)
    snapshots = whole_number("snapshots", snapshots, 0, SettingError)
    stopping = stopping_kernel(budget, task, evaluation)
    threads = threads_for(generative, workers, len(settings))
    work = 0  # steps of an evaluation; a sweep of an exact one counts as one a pair
    if isinstance(kernel, RolloutEvaluation):
        work = kernel.episodes * kernel.horizon
    elif isinstance(kernel, ExactEvaluation):
        work = kernel.tables.outcome_row.size * kernel.horizon
    if threads == 1 and len(settings) * (longest + (longest // eval_freq + 1) * work) <= SHORT:
        threads = 0  # the caller's, where starting another takes long
    several = any(seed.shaping is not None and seed.shaping.portfolio for seed in settings)
    bounds = optimism(task) if several else None
    rows = rows_allowed(
        storage,
        generative,
        tables=learner.tables * (1 + several + (bounds is not None)),
        counts=learner.counts + (bounds is not None),
        seeds=len(settings) if storage.save_values else max(1, threads),
        steps=longest,
    )
    if masks_actions(task) and (rows or isinstance(learner, OptimisticQLearning)):
        raise SettingError(
            "a live task with action_masks is learnt with dense tables, and not by "
            "OptimisticQLearning, as its available actions are not known beforehand: got "
            f"{type(learner).__name__} and {'sparse' if rows else 'dense'} tables"
        )
    run = Run(
        generative, learner, most, eval_freq, longest, kernel, stopping, storage, rows, bounds
    )
    if rows:
        run.check_sparse(settings)
    with shown(progress) as bars:
        values, outcomes = train_all(run, settings, stream, snapshots, threads, bars)
    numbers = tuple(seed.seed for seed in settings)
    return learning_result(task, configured, numbers, values, outcomes, eval_freq)


def stopping_kernel(budget: Budget, task: Task, evaluation: GreedyEvaluation) -> StoppingKernel:
    """Return the stopping rule of a budget for the compiled loops, which may have none."""
    if not isinstance(budget, StoppingRule):
        return NEVER_STOPS
    return budget.kernel(*levels(budget, task, evaluation))


def given_or_default(name: str, argument: Any, kind: type, default: type | None = None) -> Any:
    """Return an argument of this kind, or its default where it is None; SettingError otherwise."""
    argument = (default or kind)() if argument is None else argument
    instance(name, argument, kind, SettingError)
    return argument


def train_all(
    run: "Run",
    settings: Sequence[SeedSettings],
    stream: str,
    snapshots: int,
    threads: int,
    bars: Bars,
) -> tuple[Any, list[Outcome]]:
    """Return the values of all seeds, None unless they are saved, and each seed's outcome.

    A bar with the name of their random streams shows how many seeds are done.
    """
    save, values = run.storage.save_values, None
    if save and not run.rows:
        values = np.empty((len(settings), *run.shape), run.storage.dtype)

    records = dict[int, Record]()  # of the seeds that are not counted yet

    def train(k: int) -> Outcome:
        out = None if values is None else values[k]
        start = stream_start(settings[k].seed, stream)
        begun = partial(records.__setitem__, k)
        return run.train(settings[k], start, out, 0 if k else snapshots, begun)

    def part() -> float:
        """Return the share of its checkpoints that the next seed to be counted has noted."""
        under_way = dict(records)
        return float(
            np.isfinite(under_way[min(under_way)].greedy_return).mean() if under_way else 0
        )

    name = stream or "learning"
    grow = bars.bar(name, len(settings))
    bars.partly(name, part)

    def ended(k: int) -> None:
        records.pop(k, None)
        grow()
        bars.tell(settings[k].seed)

    outcomes = over_seeds(train, len(settings), threads, ended)
    return tuple(outcome.values for outcome in outcomes) if save and run.rows else values, outcomes


# -- the run of a seed -----------------------------------------------------------------------------


class _Seed(NamedTuple):
    """A seed in its run."""

    start: int  # of its random stream
    settings: SeedSettings
    out: FloatTable | None  # (S, A) where its dense values go; they are dropped without it
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
    """The settings that all seeds of a call of :func:`learn` share."""

    task: GenerativeModel
    learner: Learner
    limits: tuple[int, int]  # the most steps and episodes
    eval_freq: int
    longest: int  # a bound of the steps that both limits allow
    evaluation: EvaluationKernel
    stopping: StoppingKernel
    storage: Storage
    rows: int  # that a sparse table may have; 0 for a dense table
    bounds: tuple[float, float] | None  # of values, where portfolios have an optimist

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
        n = self.longest // self.eval_freq + 1
        record = Record.empty(n, *kept, unknown_ends=unknown)
        used = settings.warm_up.write(record, self.eval_freq)
        begun(record)
        seed = _Seed(start, settings, out, record, used, self.evaluation.for_run(start))
        if self.plain(settings.shaping):
            return self._train_sparsely(seed) if self.rows else self._train_densely(seed)
        shaping, fast = settings.shaping, self.learner.update == Q_LEARNING and bool(self.bounds)
        if fast and shaping is not None and shaping.starts_at_potential:
            return self._train_members(seed)
        return self._train_learners(seed)

    def plain(self, shaping: Shaping | None) -> bool:
        """Return whether this is Q-learning on unshaped rewards, which has a loop of its own."""
        # The fast loop keeps maxima, which a mask that comes later would make wrong.
        if self.learner.update != Q_LEARNING or masks_actions(self.task):
            return False
        return shaping is None or (shaping.starts_at_potential and shaping.portfolio is None)

    def check_sparse(self, settings: Sequence[SeedSettings]) -> None:
        """Raise SettingError unless the loop for sparse tables can train every seed."""
        for shaping in (seed.shaping for seed in settings):
            if not self.plain(shaping) or isinstance(self.learner, OptimisticQLearning):
                entering = "no shaping" if shaping is None else shaping.name
                raise SettingError(
                    "sparse tables are for QLearning with QInitialisation or LookAheadAdvice, "
                    f"without a portfolio: got {type(self.learner).__name__} with {entering}"
                    f"{' and a portfolio' if shaping is not None and shaping.portfolio else ''}"
                )
            potential = None if shaping is None else shaping.potential
            if potential is not None and potential.kernel is None:
                raise SettingError(
                    "a sparse table is made from a potential that is read through mappings by name "
                    f"(project): got {type(potential).__name__}, which is an array"
                )

    def _dense(self, seed: _Seed, q: FloatTable, n: StaticInt = (None,)) -> DenseTable:
        best, greedy = np.empty(len(q), q.dtype), np.empty(len(q), np.uint16)
        key, far = np.uint64(splitmix64(seed.start)), (None,) * (q.nbytes > NEAR)
        return DenseTable(q, best, greedy, key, n, np.uint64(len(n)), self._width, far)

    def _train_densely(self, seed: _Seed) -> Outcome:
        q = self._filled(seed.initial, seed.out)
        acts, learnt = q, self._dense(seed, q)
        tables: Any = learnt, learnt, None, None
        if isinstance(self.learner, OptimisticQLearning):
            assert self.learner.value_range is not None
            assert self.learner.initial_value is not None
            highest = self.learner.value_range[1]
            acts = np.add(q, highest - float(self.learner.initial_value), dtype=q.dtype)
            if self.task.terminal is not None:
                acts[self.task.terminal] = 0.0
            tables = self._dense(seed, acts), learnt, Beside(highest), None
        steps, episodes = self._loop(train_q_learning, seed, tables, learnt, acts[None, None])
        q[self._only_ends(seed.record, q[None], seed.initial)] = 0.0
        return Outcome(seed.record, seed.out, steps, episodes, seed.evaluation.steps)

    def _train_members(self, seed: _Seed) -> Outcome:
        """Train the source's learner, an optimist and its second table, their rows side by side."""
        shaping, (lowest, highest) = seed.settings.shaping, cast(tuple[float, float], self.bounds)
        assert shaping is not None
        assert shaping.portfolio is not None
        n, n_actions = self.shape
        rows = np.zeros((4 * n + 3, n_actions), self.storage.dtype)
        q = rows[: 4 * n]
        blocks = q.reshape(n, 4, n_actions)
        blocks[:, 0] = self._filled(seed.initial)
        for k, start in ((1, highest), (2, lowest)):
            self._filled(None, blocks[:, k], start)
        table = self._dense(seed, q, (None,) * 4)

        def part(k: int) -> DenseTable:
            # Rows from k on, of which every fourth is read: a table of a type for which evaluation
            # is compiled already.
            far = (None,) * (q.nbytes // 4 > NEAR)
            best, greedy = table.row_max[k:], table.row_argmax[k:]
            of_one = table._replace(q=rows[k : k + 4 * n], n=(None,), far=far)
            return of_one._replace(row_max=best, row_argmax=greedy)

        source, learnt, tally = part(0), part(2), Tally.empty(n)
        memory = q.reshape(n, -1), q.view(f"u{q.itemsize}")
        members = Members(shaping.portfolio.kernel, tally, highest, *memory, source, learnt)
        tables = table, learnt, None, members
        steps, episodes = self._loop(train_q_learning, seed, tables, learnt, q[None, None])
        if seed.out is not None:
            seed.out[...] = blocks[:, 0 if tally.share[0] > UNDECIDED else 2]
        return Outcome(seed.record, seed.out, steps, episodes, seed.evaluation.steps)

    def _train_sparsely(self, seed: _Seed) -> Outcome:
        # Pages of np.empty and np.zeros take no memory before they are written to.
        n_actions, rows, dtype = self.task.actions.size, self.rows + 1, self.storage.dtype
        lookup = no_sources(n_actions) if seed.initial is None else seed.initial.kernel
        # These are read together, so they lie together: a cache miss takes as long as all the rest.
        fields = [("state", "u8"), ("best", dtype), ("greedy", "u2")]
        heads = np.empty(rows, np.dtype(fields, align=True))
        table = SparseTable(
            np.empty((rows, n_actions), dtype),
            heads["best"],
            heads["greedy"],
            np.empty(n_actions),
            np.empty((1, n_actions), dtype),
            heads["state"],
            np.zeros(2 ** (3 * rows // 2).bit_length(), np.int32),
            np.ones(1, np.int64),
            lookup._replace(initial=float(self.learner.initial_value)),
            availability(self.task),
            np.uint64(splitmix64(seed.start)),
            self._width,
            (None,),
        )
        steps, episodes = self._loop(
            train_q_learning, seed, (table, table, None, None), table, table.q[None, None]
        )
        checkpoint, rest = divmod(steps, self.eval_freq)
        stopped = not rest and stops(self.stopping, seed.record.greedy_return, checkpoint, steps)
        early = steps < self.limits[0] - seed.settings.charged and episodes < self.limits[1]
        values = None
        if self.storage.save_values:  # of the states that have a row, in their order
            used = slice(1, int(table.used[0]))
            order = np.argsort(table.states[used])
            states, q = table.states[used][order].astype(np.int64), table.q[used]
            reorder(q, order)
            values = SparseValues(frozen(states), frozen(q))
        full = bool(early and not stopped)
        return Outcome(seed.record, values, steps, episodes, seed.evaluation.steps, full)

    def _train_learners(self, seed: _Seed) -> Outcome:
        """Train a learner with a shaping; in a portfolio also an optimist or one without it."""
        shaping, record = seed.settings.shaping or QInitialisation(), seed.record
        portfolio, starts = shaping.portfolio, list[float | None]([None])
        if portfolio is not None:
            starts = [None, None] if self.bounds is None else [*self.bounds, None]
        q = np.empty((len(starts), self.learner.tables, *self.shape), self.storage.dtype)
        for k, (tables, start) in enumerate(zip(q, starts, strict=True)):
            for table in tables:
                self._filled(seed.initial if k == len(q) - 1 else None, table, start)
        kernel = NO_PORTFOLIO if portfolio is None else portfolio.kernel
        highest = 0.0 if self.bounds is None else self.bounds[1]
        learners = Learners.starting(q, self.learner.update, shaping.kernel(), kernel, highest)
        acting = Acting(q[0], False, learners.shaping.pair_values, 0.0, learners.values)
        steps, episodes = self._loop(train, seed, learners, acting, q)
        for checkpoint, values in zip(record.snapshot_at, record.snapshots, strict=True):
            if portfolio is None or record.source_share[checkpoint] > UNDECIDED:
                step = checkpoint * self.eval_freq
                values += shaping.offset(step) + shaping.advice(step)
        ahead = -1
        if portfolio is not None and learners.tally.share[0] <= UNDECIDED:
            shaping, ahead = QInitialisation(), 0
        if seed.out is not None:
            initial = shaping.potential if shaping.starts_at_potential else None
            seed.out[...] = q[ahead].mean(axis=0) + shaping.offset(steps)
            seed.out[self._only_ends(record, q[ahead], initial)] = 0.0
        meaning = {"own_rewards": shaping.own_rewards, "advice": shaping.advice(steps)}
        return Outcome(record, seed.out, steps, episodes, seed.evaluation.steps, **meaning)

    def _loop(
        self, loop: Callable[..., Any], seed: _Seed, learns: Any, view: Any, q: FloatTable
    ) -> Any:
        """Run a loop on a table or learners and return its result.

        It evaluates a view such as `view`; `q`, (n, m, S, A), are the m tables of each learner, the
        last of which acts first.
        """
        discount, limit = self.task.discount, self.task.time_limit
        limit = int(NO_LIMIT if limit is None else limit)
        steps, episodes = self.limits
        visits, (n_states, n_actions) = None, self.shape
        if n_tables := self.learner.counts:
            rows = self.rows + 1 if self.rows else n_tables * n_states
            visits = np.zeros((rows, n_actions), np.int64)
        noted = seed.record, self.stopping, 0, (0, 0, 0, 0.0, 0.0, 0.0)  # for the types
        with self.opened(seed.settings, seed.start, q) as model:
            course = Course(
                discount,
                limit,
                longest_turn(discount, limit),
                np.uint64(seed.start),
                seed.used,
                steps - seed.settings.charged,
                episodes,
                self.stopping,
                self.eval_freq,
                seed.evaluation.compiled_for(model, view),
                seed.record,
                address_of(compiled(note, False), *noted, q[-1, 0], q[-1, 0]),
            )
            rule = self.learner.kernel(visits)
            totals = compiled(loop, isinstance(model, Functions))(model, rule, learns, course)
        if seed.record.halted[0]:
            raise KeyboardInterrupt  # half-learnt values must not be taken for a result
        return totals

    def opened(
        self, settings: SeedSettings, start: int, q: FloatTable
    ) -> AbstractContextManager[Any]:
        """Return a context with the model that one seed's loop samples from `start` on."""
        return open_model(self.task, start, q)

    @property
    def shape(self) -> tuple[int, int]:
        """S and A."""
        return self.task.states.size, self.task.actions.size

    @property
    def _width(self) -> StaticInt:
        n_actions = self.task.actions.size
        return (None,) * (n_actions if n_actions <= UNROLLED else 0)

    def _filled(
        self, potential: Any, q: FloatTable | None = None, initial: float | None = None
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
        if self.task.terminal is not None:
            q[self.task.terminal] = 0.0
        if (available := available_actions(self.task)) is not None:
            q[~available] = -np.inf  # so that no policy takes it, and no target is read from it
        return q

    def _only_ends(self, record: Record, tables: FloatTable, potential: Any) -> IntArray:
        """Return the noted ends that still have the values that they started with, which are 0.

        A state in which an episode has ended, and another has gone on, is no end of the task's.
        """
        ends = np.flatnonzero(record.ends)
        initial = float(self.learner.initial_value)
        phi = 0.0 if potential is None else potential.pairs(ends)
        start = np.broadcast_to(phi + initial, (len(ends), tables.shape[2]))
        now = tables[:, ends]
        same: Any = ((now == start.astype(now.dtype)) | np.isneginf(now)).all(axis=(0, 2))
        return np.asarray(ends[same])
