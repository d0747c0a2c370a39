"""Training one task over many seeds: :func:`learn`."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, whole_number
from curricle.errors import SettingError
from curricle.learning.learners import (
    Learner,
    OptimisticQLearning,
    QLearning,
    horizon_of,
    value_bounds,
)
from curricle.learning.portfolio import PORTFOLIO_TABLES
from curricle.learning.potential import MOST_SHARED
from curricle.learning.record import Record
from curricle.learning.result import LearningResult, Outcome, learning_result
from curricle.learning.seeds import SeedSettings, over_seeds, seed_settings, threads_for
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import Budget, limits, longest_run, spacing, stopping_kernel
from curricle.learning.storage import Storage, rows_allowed
from curricle.learning.trainers import Run, check_sparse
from curricle.planning.greedy import TIED
from curricle.planning.policy_evaluation import ExactEvaluation, GreedyEvaluation, RolloutEvaluation
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.tasks.kernel import stream_start
from curricle.tasks.live import masks_actions
from curricle.tasks.mdp import Task, generative_model, has_tables

Kind = TypeVar("Kind")
MOST_ACTIONS = int(TIED)  # actions that 15 bits can tell apart
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
        most[0],
        lambda shaping: shaping.for_task(task),
        shaping=shaping,
        charged=charged,
    )
    kernel = evaluation.kernel(task)
    snapshots = whole_number("snapshots", snapshots, 0, SettingError)
    stopping, floor_steps = stopping_kernel(budget, task, evaluation)
    threads = threads_for(generative, workers, len(settings))
    work = 0  # steps of an evaluation; a sweep of an exact one counts as one a pair
    if isinstance(kernel, RolloutEvaluation):
        work = kernel.episodes * kernel.horizon
    elif isinstance(kernel, ExactEvaluation):
        work = kernel.tables.outcome_row.size * kernel.horizon
    if threads == 1 and len(settings) * (longest + (longest // eval_freq + 1) * work) <= SHORT:
        threads = 0  # the caller's, where starting another takes long
    several = any(seed.shaping is not None and seed.shaping.portfolio for seed in settings)
    horizon = bounds = None
    if several:
        few = generative.states.size * generative.actions.size <= MOST_SHARED
        horizon = horizon_of("a portfolio", task)
        bounds = value_bounds(task) if few and has_tables(task) else None
        if storage.kind == "auto" and not few:
            storage = replace(storage, kind="sparse")
    elif isinstance(learner, OptimisticQLearning) and learner.learning_rate is None:
        horizon = horizon_of("OptimisticQLearning without learning_rate", task)
    rows = rows_allowed(
        storage,
        generative,
        tables=PORTFOLIO_TABLES if several else learner.tables,
        counts=learner.counts,
        seeds=len(settings) if storage.save_values else max(1, threads),
        steps=longest,
    )
    if masks_actions(task) and (rows or several or learner.asks_task):
        raise SettingError(
            "a live task with action_masks is learnt with dense tables, and not by "
            "OptimisticQLearning, RMax or a portfolio, as its available actions are not known "
            f"beforehand: got {type(learner).__name__}{' in a portfolio' * several} and "
            f"{'sparse' if rows else 'dense'} tables"
        )
    run = Run(
        generative,
        learner,
        budget,
        eval_freq,
        longest,
        kernel,
        stopping,
        storage,
        rows,
        horizon,
        bounds,
        floor_steps,
    )
    if rows:
        check_sparse(run, settings)
    with shown(progress) as bars:
        values, outcomes = train_all(run, settings, stream, snapshots, threads, bars)
    numbers = tuple(seed.seed for seed in settings)
    return learning_result(task, configured, numbers, values, outcomes, eval_freq)


def given_or_default(
    name: str, argument: object, kind: type[Kind], default: type[Kind] | None = None
) -> Kind:
    """Return an argument of this kind, or its default where it is None; SettingError otherwise."""
    argument = (default or kind)() if argument is None else argument
    instance(name, argument, kind, SettingError)
    assert isinstance(argument, kind)
    return argument


def train_all(
    run: Run,
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
