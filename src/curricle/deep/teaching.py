"""Learning a target by episodes in several tasks seen through observations: :func:`teach_deep`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from curricle.deep.curriculum_vec_env import Success, TeachingRecord, taught_tasks
from curricle.deep.learner import DeepLearner
from curricle.deep.learning import train_seeds
from curricle.errors import SettingError
from curricle.files import Place
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import Budget
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import Progress
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.observation_task import ObservationTask
from curricle.teaching.result import TeachingResult, teaching_result
from curricle.teaching.teachers import Teacher, Uniform


def teach_deep(
    tasks: Mapping[str, ObservationTask | FamilyMember],
    teacher: Teacher | None = None,
    learner: DeepLearner | None = None,
    budget: Budget = 100_000,
    *,
    target: str,
    seeds: int | Sequence[int] = 1,
    shaping: Shaping | Sequence[Shaping] | None = None,
    eval_freq: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    success: Success = None,
    stream: str = "",
    saves: str | Place | None = None,
    progress: Progress = None,
) -> TeachingResult:
    """Return the result of a network's learning a target by episodes in several tasks.

    It is :func:`teach` for tasks seen through observations: one network learns in all of them, in
    a :class:`CurriculumVecEnv`; steps in any task count alike. With a teacher that always draws
    the target the learning is that of :func:`learn_deep`, bit for bit.

    Parameters
    ----------
    tasks, teacher, success
        As in :class:`CurriculumVecEnv`. A :class:`PrioritizedLevelReplay` goes by the TD errors of
        the network's own values, computed at the end of each episode.
    learner, seeds, eval_freq, stream, saves, progress
        As in :func:`learn_deep`.
    budget : int, Episodes or StoppingRule
        Steps in all tasks, episodes, or steps until the greedy return in the target is good enough.
    target : str
        The name of the task in which the greedy policy is evaluated; the teacher may draw it too.
    shaping : Shaping or sequence of K Shaping, optional
        As in :func:`learn_deep`, of the target's potential; rewards are shaped by it in all tasks.
    evaluation : GreedyEvaluation, optional
        In the target, as in :func:`learn_deep`; rollouts are counted, and not charged.

    Returns
    -------
    TeachingResult

    Raises
    ------
    SettingError
        When an argument is invalid; while training, when a teacher's probabilities are none or no
        environment tells the successes that it needs.
    ImportError
        When Stable-Baselines3 is not installed.

    Examples
    --------
    >>> from curricle import observation_task
    >>> tasks = {f"{g}": observation_task("Pendulum-v1", g=g, time_limit=20) for g in (2, 10)}
    >>> learner = DeepLearner("A2C", envs=2)
    >>> found = teach_deep(tasks, None, learner, 200, target="10", eval_freq=100)
    >>> found.learning.steps_used, found.steps_per_task.sum(axis=1), found.counts.shape
    (array([200]), array([200]), (1, 3, 2))
    """
    for one in shaping if isinstance(shaping, Sequence) else [shaping]:
        if getattr(one, "guard", None) is not None:
            raise SettingError(f"a guard is for a single task, and not for a teacher's: got {one}")
    teacher = Uniform() if teacher is None else teacher
    found = taught_tasks(tasks, teacher, target, success)
    records = dict[int, TeachingRecord]()

    def run(**settings: Any) -> Any:
        from curricle.deep.taught_training import TaughtDeepRun  # needs Stable-Baselines3

        return TaughtDeepRun(
            **settings,
            tasks=found,
            teacher=teacher,
            target=target,
            success=success,
            records=records,
        )

    learning = train_seeds(
        run,
        found[target],
        learner,
        budget,
        seeds=seeds,
        shaping=shaping,
        eval_freq=eval_freq,
        evaluation=evaluation,
        stream=stream,
        saves=saves,
        progress=progress,
    )
    each = [records[seed] for seed in learning.seeds]
    steps = np.stack([record.steps_per_task for record in each])
    return teaching_result(learning, tuple(found), [record.sampler for record in each], steps)
