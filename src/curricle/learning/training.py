"""Training one task over many seeds: :func:`learn`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, whole_number
from curricle.errors import SettingError
from curricle.learning.budget import Budget, limits, longest_run, seed_tuple, spacing
from curricle.learning.learners import Learner, QLearning
from curricle.learning.potential import MappedPotential
from curricle.learning.record import WarmUp, warm_ups
from curricle.learning.result import LearningResult, learning_result
from curricle.learning.run import (
    Outcome,
    Run,
    rows_allowed,
)
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import NEVER_STOPS, StoppingRule, stopping_level
from curricle.learning.storage import Storage
from curricle.learning.threads import over_seeds, threads_for
from curricle.planning.greedy import TIED
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.tasks.draws import stream_start
from curricle.tasks.task import Task, generative_model

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MOST_ACTIONS = int(TIED)
"""Actions that 15 bits can tell apart."""


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
) -> LearningResult:
    """Return what a learner learns in a task, for each of many seeds.

    Parameters
    ----------
    task : Task
    learner : Learner
        Default :class:`QLearning`.
    budget : int, Episodes or StoppingRule
        Steps (the last episode may be cut), episodes, or steps until learning is good enough.
    seeds : int or sequence of int
        K means seeds 0 .. K-1. The result of a seed depends on nothing but the seed, the stream
        and the other arguments; not on the other seeds or the number of workers.
    shaping : Shaping or sequence of K Shaping, optional
        How a potential enters learning, one for all seeds or one for each:
        :class:`QInitialisation`, :class:`LookAheadAdvice`, :class:`LookBackAdvice`,
        :class:`StateShaping`, :class:`DecayingAdvice` or :class:`RewardBonus`, which say what they
        do. A potential given as an array is set to 0 in terminal states.
    eval_freq : int, optional
        Steps between checkpoints; by default a hundredth of a budget in steps, 100 for one in
        episodes.
    evaluation : GreedyEvaluation, optional
    storage : Storage, optional
        Precision of the values, dense or sparse tables, memory; float64 by default.
    stream : str
        Name of the random stream, so that several trainings of one seed draw independently.
    warm_up : sequence of K WarmUp, optional
        Episodes that each seed acted in the task already, as :func:`calibrate` does. They count
        against the budget and stand at the start of the curves.
    charged : sequence of K int, optional
        Steps that each seed spent elsewhere, in sources say, on the account of this budget.
    snapshots : int
        Value tables of the first seed to keep on the way (:class:`Snapshots`), at most; dense ones.
    workers : int, optional
        Threads over seeds; as many as there are processors by default. A live task has one.

    Returns
    -------
    LearningResult

    Raises
    ------
    SettingError
        When an argument makes no sense; nothing has run then.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> result = learn(GridWorld("S.T"), QLearning(epsilon=0.2), 1000, seeds=2)
    >>> result.values.shape, result.greedy_return[:, -1].round(2)
    ((2, 3, 4), array([196.01, 196.01]))
    """
    learner = QLearning() if learner is None else learner
    instance("learner", learner, Learner, SettingError)
    generative = generative_model(task)
    if generative.actions.size > MOST_ACTIONS:
        raise SettingError(
            f"a task to be learnt may have at most {MOST_ACTIONS:,} actions: got "
            f"{generative.actions.size:,}"
        )
    seeds = seed_tuple(seeds)
    steps, episodes = limits(budget)
    eval_freq = spacing(eval_freq, budget)
    longest = longest_run(generative.time_limit, budget, eval_freq)
    each_shaping = [
        None if one is None else one.for_task(task)
        for one in one_a_seed(learner, shaping, len(seeds))
    ]
    spent = charges(charged, len(seeds), steps)
    acted = warm_ups(warm_up, spent, steps, episodes)
    evaluation = GreedyEvaluation() if evaluation is None else evaluation
    instance("evaluation", evaluation, GreedyEvaluation, SettingError)
    storage = Storage() if storage is None else storage
    instance("storage", storage, Storage, SettingError)
    kernel = evaluation.kernel(task)
    snapshots = whole_number("snapshots", snapshots, 0, SettingError)
    stopping = (
        budget.kernel(stopping_level(budget, task, evaluation))
        if isinstance(budget, StoppingRule)
        else NEVER_STOPS
    )
    threads = threads_for(generative, workers, len(seeds))
    guarded = any(one is not None and one.guard is not None for one in each_shaping)
    n_tables = 2 if guarded else learner.tables
    rows = rows_allowed(generative, n_tables, storage, len(seeds), threads, longest)
    run = Run(
        generative, learner, steps, episodes, eval_freq, longest, kernel, storage, rows, stopping
    )
    if rows:
        _check_sparse(run, each_shaping)
    starts = [stream_start(seed, stream) for seed in seeds]
    kept = [snapshots, *[0] * (len(seeds) - 1)]
    each = list(zip(starts, each_shaping, acted, spent, kept, strict=True))
    values, done = _train(run, each, threads)
    return learning_result(task, learner, seeds, values, done, eval_freq)


def _train(run: Run, each: Sequence[Any], threads: int) -> tuple[Any, list[Outcome]]:
    """Return the values of all seeds, and what each left; `each` are their arguments."""
    task, storage = run.task, run.storage
    kept = storage.save_values and not run.rows
    shape = (len(each), task.states.size, task.actions.size)
    values = np.empty(shape, storage.dtype) if kept else None

    def train(k: int) -> Outcome:
        start, shaping, warm_up, charged, snapshots = each[k]
        return run.train(
            start, shaping, None if values is None else values[k], warm_up, charged, snapshots
        )

    done = over_seeds(train, len(each), threads)
    if kept or not storage.save_values:
        return values, done
    return tuple(outcome.values for outcome in done), done


def one_a_seed(learner: Any, shaping: Any, n_seeds: int) -> list[Any]:
    """Return the shaping of each seed, or None, checked against the learner."""
    if shaping is None:
        return [None] * n_seeds
    each: list[Any] = list(shaping) if isinstance(shaping, Sequence) else [shaping] * n_seeds
    if len(each) != n_seeds:
        raise SettingError(f"one shaping a seed means {n_seeds} of them: got {len(each)}")
    for one in each:
        if not isinstance(one, Shaping):
            raise SettingError(
                "shaping must be a Shaping, such as QInitialisation(potential): got a "
                f"{type(one).__name__}"
            )
        one.check(learner)
        if one.guard is not None and one.potential is None:
            raise SettingError("a guard needs a potential to watch: got a shaping without one")
    return each


def charges(charged: Any, n_seeds: int, steps: int) -> Sequence[int]:
    """Return what each seed is charged, checked against the budget."""
    if charged is None:
        return [0] * n_seeds
    each = [whole_number("each of charged", one, 0, SettingError) for one in charged]
    if len(each) != n_seeds:
        raise SettingError(f"one charge a seed means {n_seeds} of them: got {len(each)}")
    if max(each) >= steps:
        raise SettingError(
            f"a budget must exceed what is charged on it: got {steps:,} and {max(each):,} steps"
        )
    return each


def _check_sparse(run: Run, each: Sequence[Shaping | None]) -> None:
    """Raise SettingError unless this learner can fill sparse tables."""
    for shaping in each:
        if not run.plain(shaping):
            entering = "no shaping" if shaping is None else shaping.name
            raise SettingError(
                "sparse tables are for QLearning with QInitialisation or LookAheadAdvice, without "
                f"a guard: got {type(run.learner).__name__} with {entering}"
                f"{' and a guard' if shaping is not None and shaping.guard else ''}"
            )
        potential = None if shaping is None else shaping.potential
        if potential is not None and not isinstance(potential, MappedPotential):
            raise SettingError(
                "a sparse table is made from a potential that is read through mappings by name "
                f"(project): got a {type(potential).__name__}, which is an array"
            )
