"""Learning a target by episodes in several tasks, of which a teacher draws each: :func:`teach`."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.array_types import BoolArray, FloatTable
from curricle.checks import text
from curricle.errors import SettingError, TaskError
from curricle.frozen_arrays import frozen
from curricle.learning.learners import Learner, QLearning
from curricle.learning.optimistic_learning import OptimisticQLearning
from curricle.learning.result import learning_result
from curricle.learning.run import Run
from curricle.learning.seeds import SeedSettings, seed_settings, threads_for
from curricle.learning.stopping import Budget, limits, longest_run, spacing
from curricle.learning.storage import Storage
from curricle.learning.tables import DenseTable
from curricle.learning.training import given_or_default, stopping_kernel, train_all
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import Progress, check_progress, shown
from curricle.tasks.draws import ALL, stream_start, uniform
from curricle.tasks.live import BROKEN_DOWN, Answer
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.start_states import Goal, goal_states
from curricle.tasks.task import Task, tables
from curricle.teaching.result import TeachingResult, teaching_result
from curricle.teaching.taught_model import EpisodeRecord, SharedTables, TaughtModel
from curricle.teaching.teachers import Episode, TaskSampler, Teacher, Uniform, check_teacher


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

    A teacher draws the task of each episode. One learner learns all of them in one table, with the
    loops, schedules and random streams of :func:`learn`; steps in any task count alike. The teacher
    draws from a stream of its own. With one task the learning is that of :func:`learn` on its
    tables, bit for bit.

    Parameters
    ----------
    tasks : dict from str to Task
        M of them, with tables, the same states and actions, discount and time limit. They may
        differ in where episodes start (:func:`with_start`), in hazards, slips, rewards and goals.
        Goals that differ need a component of the states that tells them apart: one table cannot
        hold values for several. :class:`ReverseCurriculum` reads their order.
    teacher : Teacher
        Default :class:`Uniform`.
    learner : Learner
        Default :class:`QLearning`; any but :class:`OptimisticQLearning`.
    budget : int, Episodes or StoppingRule
        Steps in all tasks (the last episode may be cut), episodes, or steps until the greedy return
        in the target is good enough.
    target : str
        The name of the task in which the greedy policy is evaluated; the teacher may draw it too.
    seeds, eval_freq, evaluation, stream, workers, progress
        As in :func:`learn`.
    goal : optional
        What an episode has to end in to be a success, as in :func:`goal_distance`. By default the
        terminal states of each task that are entered with the largest reward.

    Returns
    -------
    TeachingResult

    Raises
    ------
    SettingError
        When an argument is invalid, before anything runs; when a teacher's probabilities are none.
    TaskError
        When a task has no tables, or the teacher needs a goal and there is none.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.tasks import GoalDistance, with_start
    >>> far = GridWorld("S.....T")
    >>> tasks = {"near": with_start(far, GoalDistance(1, 2)), "far": far}
    >>> found = teach(tasks, target="far", budget=2_000, seeds=2)
    >>> found.counts[0, -1] / found.counts[0, -1].sum() > 0.3
    array([ True,  True])
    """
    check_progress(progress)
    teacher = Uniform() if teacher is None else teacher
    check_teacher(teacher)
    text("stream", stream or "-", SettingError)
    learner = given_or_default("learner", learner, Learner, QLearning)
    if isinstance(learner, OptimisticQLearning):
        raise SettingError(
            "a teacher's learner must explore by epsilon or softmax, not by a start: got "
            f"{learner!r}"
        )
    evaluation = given_or_default("evaluation", evaluation, GreedyEvaluation)
    needs_goal = bool(getattr(teacher, "uses_goal", False))
    task_set = _TaskSet(tasks, target, goal, needs_goal=needs_goal)
    run = _run(task_set, tasks[target], teacher, learner, budget, eval_freq, evaluation, stream)
    each = seed_settings(
        seeds, run.learner, run.limits, lambda one: one, shaping=None, warm_up=None, charged=None
    )
    threads = threads_for(task_set.target, workers, len(each))
    with shown(progress) as bars:
        values, outcomes = train_all(run, each, stream, 0, threads, bars)
    values[:, task_set.target.terminal] = 0.0  # other tasks may go on where the target ends
    numbers = tuple(one.seed for one in each)
    learning = learning_result(tasks[target], learner, numbers, values, outcomes, run.eval_freq)
    return teaching_result(learning, task_set.names, [run.samplers[seed] for seed in numbers])


# -- the tasks -----------------------------------------------------------------------------------


class _TaskSet:
    """M tasks of one space, of which `target` is one.

    Raises
    ------
    SettingError
        Unless the tasks are a mapping from names, at least one, that contains the target; when
        they do not share states, actions, discount and a time limit.
    TaskError
        When one has no tables, or a goal is needed and there is none.
    """

    def __init__(self, tasks: Any, target: str, goal: Goal = None, *, needs_goal: bool = False):
        _check_names(tasks, target)
        self.names = tuple(tasks)
        self.place = self.names.index(target)
        for name, task in tasks.items():
            if is_observation_task(task):
                raise TaskError(
                    f"a task seen through observations has no tables: got {task!r} as {name!r}"
                )
        self.mdps = tuple(tables(task) for task in tasks.values())
        self.target = self.mdps[self.place]
        for name, mdp in zip(self.names, self.mdps, strict=True):
            _check_shared(name, mdp, target, self.target)
        if self.target.time_limit is None:
            raise SettingError(f"tasks of a teacher need a time limit: {target!r} has none")
        self.limit = self.target.time_limit
        self.goals = self._goals(goal, needs_goal)
        self.shared = SharedTables.of(self.mdps, self.place)

    def _goals(self, goal: Goal, needed: bool) -> BoolArray:
        """Return the states of each task that are its goal, (M, S); none where there is no goal."""
        found = np.zeros((len(self.mdps), self.target.states.size), np.bool_)
        for i, mdp in enumerate(self.mdps):
            try:
                found[i] = goal_states(mdp, goal)
            except TaskError as error:
                if needed or goal is not None:
                    raise TaskError(f"{error} (task {self.names[i]!r})") from error
        return found

    def start_state(self, task: int, bits: int) -> int:
        """Return the state in which an episode of a task starts, drawn as compiled loops do."""
        mdp = self.mdps[task]
        place = np.searchsorted(mdp.start_cumulative, uniform(bits), side="right")
        return int(mdp.start_states[place])


def _check_names(tasks: Any, target: Any) -> None:
    """Raise SettingError unless tasks are a mapping from names, at least one, with the target."""
    if not isinstance(tasks, Mapping) or not tasks:
        raise SettingError(f"tasks must be a dict from names to tasks, not empty: got {tasks!r}")
    for name in tasks:
        if not isinstance(name, str):
            raise SettingError(f"the name of a task must be text: got {name!r}")
    if target not in tasks:
        raise SettingError(f"target must be one of {', '.join(tasks)}: got {target!r}")


def _check_shared(name: str, mdp: FiniteMDP, target: str, other: FiniteMDP) -> None:
    """Raise SettingError unless a task shares with the target what one table needs."""
    for what in ("states", "actions"):
        own, wanted = getattr(mdp, what), getattr(other, what)
        if own != wanted:
            raise SettingError(
                f"tasks of a teacher must share their {what}, with equal components: {name!r} has "
                f"{own!r} and {target!r} has {wanted!r}"
            )
    for what in ("discount", "time_limit"):
        own, wanted = getattr(mdp, what), getattr(other, what)
        if own != wanted:
            raise SettingError(
                f"tasks of a teacher must share their {what}: {name!r} has {own} and {target!r} "
                f"has {wanted}"
            )


# -- one seed ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TaughtRun(Run):
    """A :class:`Run` in several tasks; ``task`` is the target.

    `samplers` get the draws of the teacher, by the number of the seed.
    """

    task_set: _TaskSet
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
        lesson = self._lesson(seed, record, raised)
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
        self, seed: int, record: EpisodeRecord, raised: list[BaseException]
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
                    sampler.ended(self._episode(record))
                task = sampler.draw(step)
                record.task[0] = task
                bits = yield self.task_set.start_state(task, bits & ALL), 0.0, False, False
        except GeneratorExit:
            raise
        except BaseException as error:
            raised.append(error)
        while True:
            yield BROKEN_DOWN

    def _episode(self, record: EpisodeRecord) -> Episode:
        """Return the episode that has just ended."""
        n, task, shared = int(record.length[0]), int(record.task[0]), self.task_set
        return Episode(
            task,
            frozen(record.rewards[:n].copy()),
            frozen(record.td_errors[:n].copy()),
            bool(record.terminated[0] and shared.goals[task, record.last_state[0]]),
            shared.target.discount,
        )


def _run(
    task_set: _TaskSet,
    target: Task,
    teacher: Teacher,
    learner: Learner,
    budget: Budget,
    eval_freq: int | None,
    evaluation: GreedyEvaluation,
    stream: str,
) -> _TaughtRun:
    """Return the run that all seeds share, its arguments checked."""
    most, eval_freq = limits(budget), spacing(eval_freq, budget)
    return _TaughtRun(
        task=task_set.target,
        learner=learner.for_task(target),
        limits=most,
        eval_freq=eval_freq,
        longest=longest_run(task_set.limit, budget, eval_freq),
        evaluation=evaluation.kernel(task_set.target),
        stopping=stopping_kernel(budget, target, evaluation),
        storage=Storage(),
        rows=0,
        task_set=task_set,
        teacher=teacher,
        stream=stream,
        samplers={},
    )
