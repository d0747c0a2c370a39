"""Training one task over many seeds: :func:`learn`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, one_of, whole_number
from curricle.errors import SettingError
from curricle.learning.budget import Budget, limits, longest_run, seed_tuple, spacing
from curricle.learning.guard import Guard
from curricle.learning.learners import SARSA, Learner, QLearning
from curricle.learning.potential import MappedPotential, StateActionPotential, StatePotential
from curricle.learning.result import LearningResult, learning_result
from curricle.learning.run import (
    AS_VALUES,
    NO_WARM_UP,
    Outcome,
    Potential,
    Run,
    WarmUp,
    rows_allowed,
)
from curricle.learning.schedules import constant
from curricle.learning.stopping import NEVER_STOPS, StoppingRule, stopping_level
from curricle.learning.storage import Storage
from curricle.learning.threads import over_seeds, threads_for
from curricle.learning.ways import OF_TABLES, How
from curricle.planning.greedy import TIED
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.tasks.draws import stream_start
from curricle.tasks.task import Task, generative_model, same_task

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
    potential: Potential | Sequence[Potential] | None = None,
    how: How = "initialise",
    guard: Guard | None = None,
    eval_freq: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    storage: Storage | None = None,
    stream: str = "",
    warm_up: Sequence[WarmUp] | None = None,
    charged: Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
    snapshots: int = 0,
    workers: int | None = None,
) -> LearningResult:
    """Return what a learner makes of a task, for each of many seeds.

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
    potential : StatePotential, StateActionPotential or MappedPotential, or K of them, optional
        One for all seeds, or one for each.
    how : str
        What to do with the potential (theory in the order of publication):

        - ``"initialise"``: Q starts as phi(s, a); the same updates as look-ahead advice
          (Wiewiora 2003).
        - ``"look_ahead"``: rewards get F = gamma phi(s', a*) - phi(s, a), the policy acts on
          Q + phi. Carried out on Q + phi itself, which is the same to the last digit save rounding.
        - ``"look_back"``: F = phi(s_t, a_t) - phi(s_{t-1}, a_{t-1}) / gamma; :class:`SARSA` only.
          A target carries phi of the step before, averaged over all ways into a state, so the
          optimum is sure to be kept only where each state is entered in one way.
        - ``"state"``: F = gamma Phi(s', t') - Phi(s, t). Takes a StatePotential.
        - ``"advice"``: Q learns on plain rewards, the policy acts on Q + xi(t) phi with the
          potential's weight xi (explicit decaying advice, Behboudian et al. 2020). The policy
          is the task's own only as xi goes to 0: give the potential a decaying weight.
        - ``"bonus"``: rewards get phi(s, a) outright. NOT potential-based: it can change the
          optimal policy, and is here to show reward hacking.

        ``"weights"`` and ``"policy"`` are for networks only (:func:`learn_deep`).
    guard : Guard, optional
        Watch over the potential, and trust it less where it does harm. For :class:`QLearning` with
        ``"initialise"`` or ``"look_ahead"``.
    eval_freq : int, optional
        Steps between checkpoints; by default a hundredth of a budget in steps, 100 for one in
        episodes.
    evaluation : GreedyEvaluation, optional
    storage : Storage, optional
        Precision of the values, dense or sparse tables, memory; float64 by default.
    stream : str
        Name of the random stream, so that several trainings of one seed draw independently.
    before : sequence of K WarmUp, optional
        Episodes that each seed acted in the task already, as :func:`calibrate` does. They count
        against the budget and stand at the start of the curves.
    charged : sequence of K int, optional
        Steps that each seed spent elsewhere, in sources say, on the account of this budget.
    frames : int
        Tables of the first seed to keep on the way (:class:`Snapshots`), at most; not of sparse ones.
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
    potentials = _potentials(task, learner, potential, how, len(seeds))
    spent = charges(charged, len(seeds), steps)
    acted = warm_ups(warm_up, spent, steps, episodes)
    evaluation = GreedyEvaluation() if evaluation is None else evaluation
    instance("evaluation", evaluation, GreedyEvaluation, SettingError)
    storage = Storage() if storage is None else storage
    instance("storage", storage, Storage, SettingError)
    kernel = evaluation.kernel(task)
    snapshots = whole_number("frames", snapshots, 0, SettingError)
    gate = (
        budget.rule(stopping_level(budget, task, evaluation))
        if isinstance(budget, StoppingRule)
        else NEVER_STOPS
    )
    threads = threads_for(generative, workers, len(seeds))
    check_guard(guard, learner, how, guarded=potential is not None)
    n_tables = learner.tables if guard is None else 2
    rows = rows_allowed(generative, n_tables, storage, len(seeds), threads, longest)
    run = Run(
        generative,
        learner,
        how,
        steps,
        episodes,
        eval_freq,
        longest,
        kernel,
        storage,
        rows,
        guard,
        gate,
    )
    if rows:
        _check_sparse(run, potentials)
    starts = [stream_start(seed, stream) for seed in seeds]
    kept = [snapshots, *[0] * (len(seeds) - 1)]
    each = list(zip(starts, potentials, acted, spent, kept, strict=True))
    values, done = _train(run, each, threads)
    return learning_result(task, learner, seeds, values, done, eval_freq)


def _train(run: Run, each: Sequence[Any], threads: int) -> tuple[Any, list[Outcome]]:
    """Return the values of all seeds, and what each left; `each` are their arguments."""
    task, storage = run.task, run.storage
    kept = storage.save_values and not run.rows
    shape = (len(each), task.states.size, task.actions.size)
    values = np.empty(shape, storage.dtype) if kept else None

    def train(k: int) -> Outcome:
        start, potential, warm_up, charged, snapshots = each[k]
        return run.train(
            start, potential, None if values is None else values[k], warm_up, charged, snapshots
        )

    done = over_seeds(train, len(each), threads)
    if kept or not storage.save_values:
        return values, done
    return tuple(outcome.values for outcome in done), done


def _potentials(
    task: Task,
    learner: Learner,
    potential: Potential | Sequence[Potential] | None,
    how: How,
    n_seeds: int,
) -> list[Potential | None]:
    """Return the potential of each seed, checked against the task, the learner and `how`."""
    one_of("how", how, OF_TABLES, SettingError)
    if how == "look_back" and (
        not isinstance(learner, SARSA) or generative_model(task).discount == 0
    ):
        raise SettingError(
            "look_back is valid for on-policy SARSA at a positive discount only: got "
            f"{type(learner).__name__} at discount {generative_model(task).discount:g}"
        )
    if potential is None:
        return [None] * n_seeds
    each: list[Any] = list(potential) if isinstance(potential, Sequence) else [potential] * n_seeds
    if len(each) != n_seeds:
        raise SettingError(f"one potential a seed means {n_seeds} of them: got {len(each)}")
    for one in each:
        check_potential(one, task, how)
    return each


def check_potential(potential: Any, task: Task, how: str) -> None:
    """Raise SettingError unless a potential is of the kind a way takes, and made for its task."""
    pair = (StateActionPotential, MappedPotential)
    if not isinstance(potential, StatePotential if how == "state" else pair):
        wanted = "StatePotential" if how == "state" else "StateActionPotential"
        raise SettingError(f"how={how!r} takes a {wanted}: got a {type(potential).__name__}")
    if not same_task(potential.task, task):
        raise SettingError(
            f"a potential must be made for the task it shapes: it belongs to {potential.task}"
        )
    if how not in ("state", "advice") and potential.weight != constant(1.0):
        raise SettingError(f"only state and advice take a potential with a weight: got how={how!r}")


def check_guard(guard: Guard | None, learner: Learner, how: How, *, guarded: bool) -> None:
    """Raise SettingError if there is a guard, but no potential that it can watch over."""
    if guard is None:
        return
    instance("guard", guard, Guard, SettingError)
    if not isinstance(learner, QLearning) or how not in AS_VALUES or not guarded:
        raise SettingError(
            "a guard watches over the potential of a QLearning with how 'initialise' or "
            f"'look_ahead': got {type(learner).__name__} with how {how!r} and "
            f"{'a' if guarded else 'no'} potential"
        )


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


def warm_ups(
    warm_up: Sequence[WarmUp] | None, charged: Sequence[int], steps: int, episodes: int
) -> Sequence[WarmUp]:
    """Return the warm-up of each seed, checked against what is left of the budget."""
    if warm_up is None:
        return [NO_WARM_UP] * len(charged)
    if len(warm_up) != len(charged):
        raise SettingError(f"one warm-up a seed means {len(charged)} of them: got {len(warm_up)}")
    for k, one in enumerate(warm_up):
        if one.steps >= steps - charged[k] or len(one.lengths) >= episodes:
            raise SettingError(
                "a budget must exceed what was spent on it before learning: the warm-up of seed "
                f"number {k} took {one.steps:,} steps in {len(one.lengths):,} episodes"
            )
    return warm_up


def _check_sparse(run: Run, potentials: list[Any]) -> None:
    """Raise SettingError unless this learner can fill sparse tables."""
    if not run.plain:
        raise SettingError(
            "sparse tables serve Q-learning with how 'initialise' or 'look_ahead', without a "
            f"guard: got {type(run.learner).__name__} with how {run.how!r}"
            f"{' and a guard' if run.guard else ''}"
        )
    for potential in potentials:
        if potential is not None and not isinstance(potential, MappedPotential):
            raise SettingError(
                "a sparse table is made from a potential that is read through mappings by name "
                f"(project): got a {type(potential).__name__}, which is an array"
            )
