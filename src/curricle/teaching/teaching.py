"""Learning a target by episodes in several tasks, of which a teacher draws each: :func:`teach`."""

from collections.abc import Mapping, Sequence

from curricle.checks import text
from curricle.errors import SettingError
from curricle.learning.budget import Budget, limits, longest_run, spacing
from curricle.learning.learners import Learner, QLearning
from curricle.learning.optimistic_learning import OptimisticQLearning
from curricle.learning.result import learning_result
from curricle.learning.seeds import seed_settings, threads_for
from curricle.learning.storage import Storage
from curricle.learning.training import given_or_default, stopping_kernel, train_all
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import Progress, check_progress, shown
from curricle.tasks.start_states import Goal
from curricle.tasks.task import Task
from curricle.teaching.result import TeachingResult, teaching_result
from curricle.teaching.sampler import check_teacher
from curricle.teaching.task_set import TaskSet
from curricle.teaching.taught_run import TaughtRun
from curricle.teaching.teachers import Teacher, Uniform


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
            f"a teacher's learner must explore by epsilon or softmax, not by a start: got {learner!r}"
        )
    evaluation = given_or_default("evaluation", evaluation, GreedyEvaluation)
    needs_goal = bool(getattr(teacher, "uses_goal", False))
    task_set = TaskSet(tasks, target, goal, needs_goal=needs_goal)
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


def _run(
    task_set: TaskSet,
    target: Task,
    teacher: Teacher,
    learner: Learner,
    budget: Budget,
    eval_freq: int | None,
    evaluation: GreedyEvaluation,
    stream: str,
) -> TaughtRun:
    """Return the run that all seeds share, its arguments checked."""
    most, eval_freq = limits(budget), spacing(eval_freq, budget)
    return TaughtRun(
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
