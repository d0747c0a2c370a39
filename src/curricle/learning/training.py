"""Training one task over many seeds: :func:`learn`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, whole_number
from curricle.errors import SettingError
from curricle.learning.learners import Learner, OptimisticQLearning, QLearning
from curricle.learning.record import WarmUp
from curricle.learning.result import LearningResult, learning_result
from curricle.learning.run import Outcome, Run
from curricle.learning.seeds import SeedSettings, over_seeds, seed_settings, threads_for
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import (
    NEVER_STOPS,
    Budget,
    StoppingKernel,
    StoppingRule,
    levels,
    limits,
    longest_run,
    spacing,
)
from curricle.learning.storage import Storage, rows_allowed
from curricle.planning.greedy import TIED
from curricle.planning.policy_evaluation import (
    EvaluationKernel,
    ExactEvaluation,
    GreedyEvaluation,
    RolloutEvaluation,
)
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.tasks.kernel import stream_start
from curricle.tasks.mdp import Task, generative_model

MOST_ACTIONS = int(TIED)
"""Actions that 15 bits can tell apart."""
SHORT = 2**20
"""Steps, of evaluations too, for which an interrupt can wait: 5 to 200 ms; a thread costs .15."""


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
        Default :class:`QLearning`.
    budget : int, Episodes or StoppingRule
        Steps (the last episode may be cut), episodes, or steps until learning is good enough.
    seeds : int or sequence of int
        K means seeds 0 .. K-1. The result of a seed does not depend on the other seeds or on
        `workers`.
    shaping : Shaping or sequence of K Shaping, optional
        How a potential enters learning, one for all seeds or one for each:
        :class:`QInitialisation`, :class:`LookAheadAdvice`, :class:`LookBackAdvice`,
        :class:`StateShaping`, :class:`DecayingAdvice` or :class:`RewardBonus`. A potential given as
        an array is set to 0 in terminal states.
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
        against the budget and are at the start of the curves.
    charged : sequence of K int, optional
        Steps of the budget that each seed used elsewhere, in sources say.
    snapshots : int
        At most so many value tables of the first seed are kept on the way (:class:`Snapshots`);
        dense ones only.
    workers : int, optional
        Threads over seeds; as many as there are processors by default. A live task has one.
    progress : bool or callable, optional
        True shows a bar; a function is called with each seed when it is done.

    Returns
    -------
    LearningResult

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
    asked, learner = learner, learner.for_task(task)
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
    threads = _threads(generative, workers, len(settings), _most_steps(longest, eval_freq, kernel))
    guarded = any(seed.shaping is not None and seed.shaping.guard is not None for seed in settings)
    rows = rows_allowed(
        storage,
        generative,
        tables=learner.tables * (2 if guarded else 1),
        counts=learner.counts,
        seeds=len(settings) if storage.save_values else max(1, threads),
        steps=longest,
    )
    run = Run(generative, learner, most, eval_freq, longest, kernel, stopping, storage, rows)
    if rows:
        _check_sparse(run, settings)
    with shown(progress) as bars:
        values, outcomes = train_all(run, settings, stream, snapshots, threads, bars)
    numbers = tuple(seed.seed for seed in settings)
    return learning_result(task, asked, numbers, values, outcomes, eval_freq)


def _threads(task: Any, workers: int | None, seeds: int, steps: int) -> int:
    """Return the number of threads, 0 for the caller's where starting another takes long."""
    threads = threads_for(task, workers, seeds)
    return 0 if threads == 1 and seeds * steps <= SHORT else threads


def _most_steps(longest: int, eval_freq: int, evaluation: EvaluationKernel) -> int:
    """Return the most steps of a seed; a sweep of an exact evaluation counts as one a pair."""
    work = 0
    if isinstance(evaluation, RolloutEvaluation):
        work = evaluation.episodes * evaluation.horizon
    elif isinstance(evaluation, ExactEvaluation):
        work = evaluation.tables.outcome_row.size * evaluation.horizon
    return longest + (longest // eval_freq + 1) * work


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
    run: Run,
    settings: Sequence[SeedSettings],
    stream: str,
    snapshots: int,
    threads: int,
    bars: Bars,
) -> tuple[Any, list[Outcome]]:
    """Return the values of all seeds, None unless they are saved, and what each seed left.

    A bar with the name of their random streams shows how many seeds are done.
    """
    save, values = run.storage.save_values, None
    if save and not run.rows:
        values = np.empty((len(settings), *run.shape), run.storage.dtype)

    def train(k: int) -> Outcome:
        out = None if values is None else values[k]
        start = stream_start(settings[k].seed, stream)
        return run.train(settings[k], start, out, 0 if k else snapshots)

    grow = bars.bar(stream or "learning", len(settings))

    def ended(k: int) -> None:
        grow()
        bars.tell(settings[k].seed)

    outcomes = over_seeds(train, len(settings), threads, ended)
    return tuple(outcome.values for outcome in outcomes) if save and run.rows else values, outcomes


def _check_sparse(run: Run, settings: Sequence[SeedSettings]) -> None:
    """Raise SettingError unless the loop for sparse tables can train every seed."""
    for shaping in (seed.shaping for seed in settings):
        if not run.plain(shaping) or isinstance(run.learner, OptimisticQLearning):
            entering = "no shaping" if shaping is None else shaping.name
            raise SettingError(
                "sparse tables are for QLearning with QInitialisation or LookAheadAdvice, without "
                f"a guard: got {type(run.learner).__name__} with {entering}"
                f"{' and a guard' if shaping is not None and shaping.guard else ''}"
            )
        potential = None if shaping is None else shaping.potential
        if potential is not None and potential.kernel is None:
            raise SettingError(
                "a sparse table is made from a potential that is read through mappings by name "
                f"(project): got {type(potential).__name__}, which is an array"
            )
