""":func:`teach`: learning a target by episodes in several tasks, which a teacher draws."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, FloatTable, Frozen, IntArray, frozen
from curricle.checks import text
from curricle.display import printed
from curricle.errors import SettingError, TaskError
from curricle.learning.learners import Learner, OptimisticQLearning, QLearning
from curricle.learning.result import LearningResult, learning_result
from curricle.learning.run import Run, given_or_default, stopping_kernel, train_all
from curricle.learning.seeds import SeedSettings, seed_settings, threads_for
from curricle.learning.stopping import Budget, limits, longest_run, spacing
from curricle.learning.storage import Storage
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import Progress, check_progress, shown
from curricle.statistics.curves import Curve
from curricle.tasks.kernel import ALL, inlined, stream_start, uniform
from curricle.tasks.live import BROKEN_DOWN, Answer, answer
from curricle.tasks.mdp import FiniteMDP, Task, tables
from curricle.tasks.models import (
    Tables,
    evaluation_models,
    failures,
    first_states,
    table_model,
    transitions,
)
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.start_states import Goal, goal_states
from curricle.teaching.teachers import Episode, TaskSampler, Teacher, Uniform
from curricle.text import brief_value, counted


@dataclass(frozen=True, eq=False)
class TeachingResult(Frozen):
    """The result of :func:`teach`, for M tasks, K seeds and T checkpoints.

    Attributes
    ----------
    learning : LearningResult
        Its greedy returns are in the target; steps, episodes and training returns are over all
        tasks.
    tasks : tuple of str
        The names of the M tasks, in their order.
    teacher : Teacher
    drawn : tuple of K (E,) int64 arrays
        The task of every episode that began, as an index into `tasks`.
    begun_at : tuple of K (E,) int64 arrays
        Steps in all tasks before every such episode.
    probabilities : (K, T, M) float64
        The teacher's probabilities in the last draw at or before each checkpoint; repeated after a
        seed's end.
    steps_per_task : (K, M) int64

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.teaching import teach
    >>> tasks = {"near": GridWorld(".ST"), "far": GridWorld("S.T")}
    >>> result = teach(tasks, target="far", budget=500)
    >>> result.learning.steps_used, result.steps_per_task.sum(axis=1), result.counts.shape
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
        """Number of episodes that began in each task before each checkpoint, (K, T, M) int64."""
        counts = np.zeros((len(self.drawn), len(self.learning.steps), len(self.tasks)), np.int64)
        for k, (drawn, begun) in enumerate(zip(self.drawn, self.begun_at, strict=True)):
            for i in range(len(self.tasks)):
                counts[k, :, i] = np.searchsorted(begun[drawn == i], self.learning.steps)
        return frozen(counts)

    def __repr__(self) -> str:
        tasks, learning = counted(len(self.tasks), "task"), repr(self.learning)
        return f"TeachingResult({brief_value(self.teacher)}, {tasks}, {learning})"

    _repr_html_ = printed


def teach(
    tasks: Mapping[str, Task],
    teacher: Teacher | None = None,
    learner: Learner | None = None,
    budget: Budget = 100_000,
    *,
    target: str,
    seeds: int | Sequence[int] = 1,
    eval_freq: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    goal: Goal = None,
    stream: str = "",
    workers: int | None = None,
    progress: Progress = None,
) -> TeachingResult:
    """Return the result of learning a target by episodes in several tasks of one space.

    A teacher draws the task of every episode, from a random stream for the teacher alone. One
    learner learns all tasks in one table. With one task the result equals that of :func:`learn`.

    Parameters
    ----------
    tasks : dict from str to Task
        M tasks with tables and the same states, actions, discount and time limit. They may
        differ in start states (:func:`with_start`), hazards, slips, rewards and goals; if goals
        differ, a component of the states must state the goal.
    teacher : Teacher
        Default :class:`Uniform`.
    learner : Learner
        Any learner but :class:`OptimisticQLearning`; default :class:`QLearning`.
    budget : int, Episodes or StoppingRule
        Steps in all tasks (the last episode may be cut off), episodes, or steps until the greedy
        return in the target is good enough.
    target : str
        The task in which the greedy policy is evaluated; the teacher may draw it too.
    seeds, eval_freq, evaluation, stream, workers, progress
        As in :func:`learn`.
    goal : optional
        The states in which an episode must end to be a success, as in :func:`goal_distance`. By
        default the terminal states of a task that are entered with the largest reward.

    Raises
    ------
    SettingError
        When an argument is invalid, before any step; when a teacher returns no probabilities.
    TaskError
        When a task has no tables, or the teacher needs a goal and there is none.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.tasks import GoalDistance, with_start
    >>> far = GridWorld("S.....T")
    >>> tasks = {"near": with_start(far, GoalDistance(1, 2)), "far": far}
    >>> result = teach(tasks, target="far", budget=2_000, seeds=2)
    >>> result.counts[0, -1] / result.counts[0, -1].sum() > 0.3
    array([ True,  True])
    """
    check_progress(progress)
    teacher = Uniform() if teacher is None else teacher
    for name in ("start", "update", "probabilities"):
        if not callable(getattr(teacher, name, None)) or isinstance(teacher, type):
            raise SettingError(
                "a teacher must have the methods start, update and probabilities, as Uniform() "
                f"has: got {teacher!r}"
            )
    text("stream", stream or "-", SettingError)
    learner = given_or_default("learner", learner, Learner, QLearning)
    if isinstance(learner, OptimisticQLearning):
        raise SettingError(
            "a teacher's learner must explore by epsilon or softmax, not by optimism: got "
            f"{learner!r}"
        )
    evaluation = given_or_default("evaluation", evaluation, GreedyEvaluation)
    needs_goal = bool(getattr(teacher, "uses_goal", False))
    task_set = _TaskSet(tasks, target, goal, needs_goal=needs_goal)
    most, eval_freq = limits(budget), spacing(eval_freq, budget)
    mdp, time_limit = task_set.target, task_set.target.time_limit
    assert time_limit is not None, "tasks of a teacher have a time limit"
    run = _TaughtRun(
        task=mdp,
        learner=learner.for_task(tasks[target]),
        limits=most,
        eval_freq=eval_freq,
        longest=longest_run(time_limit, budget, eval_freq),
        evaluation=evaluation.kernel(mdp),
        stopping=stopping_kernel(budget, tasks[target], evaluation),
        storage=Storage(),
        rows=0,
        bounds=None,
        task_set=task_set,
        teacher=teacher,
        stream=stream,
        samplers={},
    )
    of_seeds = seed_settings(
        seeds, run.learner, run.limits, lambda x: x, shaping=None, warm_up=None, charged=None
    )
    threads = threads_for(mdp, workers, len(of_seeds))
    with shown(progress) as bars:
        values, outcomes = train_all(run, of_seeds, stream, 0, threads, bars)
    values[:, mdp.terminal] = 0.0  # where the target ends, other tasks may have learnt values
    numbers = tuple(settings.seed for settings in of_seeds)
    learning = learning_result(tasks[target], learner, numbers, values, outcomes, run.eval_freq)
    return teaching_result(learning, tuple(tasks), [run.samplers[seed] for seed in numbers])


def teaching_result(
    learning: LearningResult, tasks: tuple[str, ...], samplers: Sequence[TaskSampler]
) -> TeachingResult:
    """Return the result of teaching; episodes that took no step are left out."""
    places = np.arange(len(learning.steps))
    drawn, begun_at, curves, steps = [], [], [], []
    for sampler, used in zip(samplers, learning.steps_used, strict=True):
        begun = np.array(sampler.begun_at)
        drawn.append(frozen(np.array(sampler.tasks)[begun < used]))
        begun_at.append(frozen(begun[begun < used]))
        lengths = np.diff(begun_at[-1], append=used)
        steps.append(np.bincount(drawn[-1], lengths, len(tasks)).astype(np.int64))
        since = np.array([checkpoint for checkpoint, _ in sampler.changes])
        last = np.searchsorted(since, places, side="right") - 1
        curves.append(np.stack([probabilities for _, probabilities in sampler.changes])[last])
    return TeachingResult(
        learning,
        tasks,
        samplers[0].teacher,
        tuple(drawn),
        tuple(begun_at),
        frozen(np.stack(curves)),
        frozen(np.stack(steps)),
    )


# -- The generative model of several tasks, one of which is drawn for every episode ----------------
#
# Learning loops use it like any other model: ``first_state`` asks a Python object for the next
# task, and transitions come from that task's tables. The rewards and TD errors of an episode are
# recorded, and the teacher reads them when the episode has ended.


class SharedTables(NamedTuple):
    """The tables of M tasks in W worlds; tasks that differ only in their start share a world."""

    world: IntArray  # (M,) the world of a task
    outcome_row: npt.NDArray[np.integer[Any]]  # (W, S, A)
    cumulative: FloatArray  # (Y, O) the rows of all worlds, one world after the other
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O)
    reward: FloatArray  # (Y, O)
    terminal: BoolArray  # (W, S)
    target: Tables
    discount: float

    @classmethod
    def of(cls, mdps: Sequence[FiniteMDP], target: int) -> "SharedTables":
        """Return the tables of tasks; `target` is the index of the target."""
        names = ("outcome_row", "probability", "next_state", "reward", "terminal")
        worlds, world = list[FiniteMDP](), list[int]()
        for mdp in mdps:
            same = (  # tasks that differ only in their start states
                place
                for place, other in enumerate(worlds)
                if all(np.array_equal(getattr(mdp, name), getattr(other, name)) for name in names)
            )
            world.append(next(same, len(worlds)))
            worlds += [mdp] if world[-1] == len(worlds) else []
        n_outcomes = max(mdp.probability.shape[1] for mdp in worlds)
        rows = np.cumsum([0, *(len(mdp.probability) for mdp in worlds)])

        def stacked(name: str, filling: float) -> Any:
            arrays = [np.asarray(getattr(mdp, name)) for mdp in worlds]
            widths = [((0, 0), (0, n_outcomes - array.shape[1])) for array in arrays]
            return np.concatenate([*map(partial(np.pad, constant_values=filling), arrays, widths)])

        return cls(
            np.array(world),
            np.stack([mdp.outcome_row + rows[w] for w, mdp in enumerate(worlds)]),
            stacked("cumulative", 1.0),  # no draw exceeds 1, so filled outcomes are never taken
            stacked("next_state", 0),
            stacked("reward", 0.0),
            np.stack([mdp.terminal for mdp in worlds]),
            table_model(mdps[target]),
            mdps[target].discount,
        )


class EpisodeRecord(NamedTuple):
    """The steps of the current episode; L is the time limit."""

    task: IntArray  # (1,) task of the episode
    length: IntArray  # (1,) steps so far
    rewards: FloatArray  # (L,)
    td_errors: FloatArray  # (L,) r + gamma V(s') - V(s), with V = max_a Q when the step was taken
    last_state: IntArray  # (1,)
    terminated: BoolArray  # (1,) whether the last state is terminal


class TaughtModel(NamedTuple):
    """Several tasks, the record of the current episode, and the callable that draws the next."""

    address: npt.NDArray[np.uint64]  # (1,) of the callable of :func:`answer`
    failed: BoolArray  # (1,) whether the callable has failed
    tables: SharedTables
    q: FloatTable  # (n, S, A) the learner's n tables
    episode: EpisodeRecord


@first_states.body(TaughtModel)
def _taught_start(model, bits):
    state = answer(model.address[0], np.int64(bits))[0]
    model.episode.length[0] = 0  # also after a failure, since a loop may take one more step
    if state < 0:
        model.failed[0] = True
        return np.uint64(0)
    return np.uint64(state)


@inlined
def _highest_mean(q, state):
    """Return max_a of the mean of the learner's tables."""
    best = -np.inf
    for action in range(q.shape[2]):
        value = 0.0
        for n in range(q.shape[0]):
            value += q[n, state, action]
        best = max(best, value / q.shape[0])
    return best


@transitions.body(TaughtModel)
def _taught_step(model, state, action, bits):
    tables, episode = model.tables, model.episode
    world = tables.world[episode.task[0]]
    row, outcome = tables.outcome_row[world, state, action], np.uint64(0)
    last = np.uint64(tables.cumulative.shape[1] - 1)
    if last > np.uint64(0):
        chance = uniform(bits)
        for i in range(last):
            outcome += np.uint64(chance >= tables.cumulative[row, i])
    next_state = np.uint64(tables.next_state[row, outcome])
    reward, terminated = tables.reward[row, outcome], tables.terminal[world, next_state]
    ahead = 0.0 if terminated else tables.discount * _highest_mean(model.q, next_state)
    n = episode.length[0]
    episode.rewards[n] = reward
    episode.td_errors[n] = reward + ahead - _highest_mean(model.q, state)
    episode.length[0] = n + 1
    episode.last_state[0], episode.terminated[0] = next_state, terminated
    return next_state, reward, terminated


@failures.body(TaughtModel)
def _taught_failure(model):
    return model.failed[0]


@evaluation_models.body(TaughtModel)
def _target_model(model):
    return model.tables.target


# -- the tasks -----------------------------------------------------------------------------------


class _TaskSet:
    """M tasks of one space and the target; SettingError or TaskError if tasks do not fit."""

    def __init__(self, tasks: Any, target: str, goal: Goal = None, *, needs_goal: bool = False):
        if not isinstance(tasks, Mapping) or not tasks:
            raise SettingError(
                f"tasks must be a dict from names to tasks, not empty: got {tasks!r}"
            )
        for name in tasks:
            if not isinstance(name, str):
                raise SettingError(f"the name of a task must be text: got {name!r}")
        if target not in tasks:
            raise SettingError(f"target must be one of {', '.join(tasks)}: got {target!r}")
        for name, task in tasks.items():
            if is_observation_task(task):
                raise TaskError(
                    f"a task seen through observations has no tables: got {task!r} as {name!r}"
                )
        self.mdps = tuple(tables(task) for task in tasks.values())
        place = tuple(tasks).index(target)
        self.target = self.mdps[place]
        for name, mdp in zip(tasks, self.mdps, strict=True):
            for part in ("states", "actions", "discount", "time_limit"):
                value, of_target = getattr(mdp, part), getattr(self.target, part)
                if value != of_target:
                    equal = ", with equal components" if part in ("states", "actions") else ""
                    raise SettingError(
                        f"tasks of a teacher must share their {part}{equal}: {name!r} has "
                        f"{value!r} and {target!r} has {of_target!r}"
                    )
            allowed: list[Any] = [mdp.available, self.target.available]
            if not np.array_equal(*allowed):
                raise SettingError(
                    "tasks of a teacher must allow the same actions in each state, as they share "
                    f"a table of values: {name!r} and {target!r} do not"
                )
        if self.target.time_limit is None:
            raise SettingError(f"tasks of a teacher need a time limit: {target!r} has none")
        # (M, S), the goal states of each task; none for a task without a goal.
        self.goals = np.zeros((len(self.mdps), self.target.states.size), np.bool_)
        for goals, name, mdp in zip(self.goals, tasks, self.mdps, strict=True):
            try:
                goals[:] = goal_states(mdp, goal)
            except TaskError as error:
                if needs_goal or goal is not None:
                    raise TaskError(f"{error} (task {name!r})") from error
        self.shared = SharedTables.of(self.mdps, place)


# -- one seed ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TaughtRun(Run):
    """A :class:`Run` in several tasks; ``task`` is the target."""

    task_set: _TaskSet
    teacher: Teacher
    stream: str
    samplers: dict[int, TaskSampler]  # by seed; they record the teacher's draws

    @contextmanager
    def opened(self, settings: SeedSettings, start: int, q: FloatTable) -> Generator[TaughtModel]:
        """Return a context with the model of all tasks, whose tasks the teacher draws."""
        raised = list[BaseException]()
        n, last = np.zeros((2, 1), np.int64)
        steps = np.zeros(self.task_set.target.time_limit or 0)
        ended = np.zeros(1, np.bool_)
        record = EpisodeRecord(np.full(1, -1), n, steps, steps.copy(), last, ended)
        lesson = self._lesson(settings.seed, record, raised)
        next(lesson)
        send = lesson.send  # it must outlive its address
        address = np.array([id(send)], dtype=np.uint64)
        try:
            yield TaughtModel(address, np.zeros(1, np.bool_), self.task_set.shared, q[-1], record)
        finally:
            lesson.close()
        if raised:
            raise raised[0]

    def _lesson(
        self, seed: int, record: EpisodeRecord, raised: list[BaseException]
    ) -> Generator[Answer | None, int, None]:
        """Yield the start of an episode for every 64 bits sent; raise nothing."""
        # The caller is compiled code, through which no exception can pass. A generator, unlike a
        # function, can also catch an interrupt that arrives before its first line.
        step = 0
        bits = yield None
        try:
            counter = stream_start(seed, f"{self.stream}/teacher")
            sampler = TaskSampler(self.teacher, len(self.task_set.mdps), counter, self.eval_freq)
            self.samplers[seed] = sampler
            while True:
                if sampler.tasks:
                    n, last = int(record.length[0]), int(record.task[0])
                    reached = self.task_set.goals[last, record.last_state[0]]
                    paid, errors = (x[:n].copy() for x in (record.rewards, record.td_errors))
                    success = bool(record.terminated[0] and reached)
                    discount = self.task_set.target.discount
                    episode = Episode(last, frozen(paid), frozen(errors), success, discount)
                    step += episode.length
                    sampler.memory = self.teacher.update(sampler.memory, episode)
                task = sampler.draw(step)
                record.task[0], mdp = task, self.task_set.mdps[task]
                # The start state is drawn as in compiled loops.
                place = np.searchsorted(mdp.start_cumulative, uniform(bits & ALL), side="right")
                bits = yield int(mdp.start_states[place]), 0.0, False, False
        except GeneratorExit:
            raise
        except BaseException as error:
            raised.append(error)
        while True:
            yield BROKEN_DOWN
