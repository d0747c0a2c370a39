"""Training one task over many seeds: :func:`learn` and what it returns."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, one_of
from curricle.errors import SettingError
from curricle.learning.budget import Episodes, limits, longest_run, seed_tuple, spacing
from curricle.learning.evaluation import GreedyEvaluation
from curricle.learning.guard import Guard
from curricle.learning.learners import SARSA, Learner, QLearning
from curricle.learning.potential import MappedPotential, StateActionPotential, StatePotential
from curricle.learning.run import (
    AS_VALUES,
    NO_PRELUDE,
    Outcome,
    Potential,
    Prelude,
    Run,
    rows_allowed,
    stream_start,
)
from curricle.learning.sampling import TIED
from curricle.learning.schedules import constant
from curricle.learning.storage import Storage
from curricle.learning.threads import over_seeds, threads_for
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, dynamics, same_task

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

How = Literal["initialise", "look_ahead", "look_back", "state", "bonus", "advice"]
"""The ways a potential enters learning; :func:`learn` says what each does."""
MOST_ACTIONS = int(TIED)
"""Actions that 15 bits can tell apart."""


@dataclass(frozen=True, eq=False)
class LearningResult:
    """What :func:`learn` found, for K seeds and T checkpoints.

    Attributes
    ----------
    task : Task
    learner : Learner
    seeds : tuple of int
        K of them.
    values : (K, S, A) float64 or float32
        The values each seed's policy ends up acting on, in the task's own rewards: Q, plus
        what shaping had taken off it (phi, or Phi(s)). What a transfer hands on. From sparse
        tables K :class:`SparseValues`; None if the :class:`Storage` keeps none.
    steps : (T,) int64
        Steps taken at each checkpoint, from 0.
    training_return : (K, T) float64
        Mean undiscounted, unshaped return of the episodes that ended since the last checkpoint;
        NaN where none did.
    trust : (K, T) float64
        Share of the steps that a guarded potential's learner got (:class:`Guard`); NaN without.
    greedy_return : (K, T) float64
        Expected return of the greedy policy (:class:`GreedyEvaluation`). After a seed's budget
        of episodes is spent its last value stands.
    episodes : (K, T) int64
        Episodes ended by each checkpoint.
    steps_used, episodes_used : (K,) int64
        What each seed spent in all.
    out_of_memory : (K,) bool
        Whether a sparse table was full before the budget was spent. The run then ended at the
        step that needed another row.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> learn(GridWorld("S.T"), budget=500, seeds=3).steps_used
    array([500, 500, 500])
    """

    task: Task
    learner: Learner
    seeds: tuple[int, ...]
    values: Any
    steps: IntArray
    training_return: FloatArray
    greedy_return: FloatArray
    episodes: IntArray
    steps_used: IntArray
    episodes_used: IntArray
    out_of_memory: npt.NDArray[np.bool_]
    trust: FloatArray

    def __repr__(self) -> str:
        return (
            f"LearningResult({type(self.learner).__name__}, {len(self.seeds)} seeds, "
            f"{int(self.steps_used.mean()):,} steps and {int(self.episodes_used.mean()):,} "
            f"episodes a seed, final greedy return {self.greedy_return[:, -1].mean():.4g})"
        )


def learn(
    task: Task,
    learner: Learner | None = None,
    budget: int | Episodes = 100_000,
    *,
    seeds: int | Sequence[int] = 1,
    potential: Potential | Sequence[Potential] | None = None,
    how: How = "initialise",
    guard: Guard | None = None,
    every: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    storage: Storage | None = None,
    stream: str = "",
    before: Sequence[Prelude] | None = None,
    workers: int | None = None,
) -> LearningResult:
    """Return what a learner makes of a task, for each of many seeds.

    Parameters
    ----------
    task : Task
    learner : Learner
        Default :class:`QLearning`.
    budget : int or Episodes
        Steps (the last episode may be cut), or episodes.
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
    guard : Guard, optional
        Watch over the potential, and trust it less where it does harm. For :class:`QLearning` with
        ``"initialise"`` or ``"look_ahead"``.
    every : int, optional
        Steps between checkpoints; by default a hundredth of a step budget, 100 steps for a budget
        of episodes.
    evaluation : GreedyEvaluation, optional
    storage : Storage, optional
        Precision of the values, dense or sparse tables, memory; float64 by default.
    stream : str
        Name of the random stream, so that several trainings of one seed draw independently.
    before : sequence of K Prelude, optional
        Episodes that each seed acted in the task already, as :func:`calibrate` does. They count
        against the budget and stand at the start of the curves.
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
    moving = dynamics(task)
    if moving.actions.size > MOST_ACTIONS:
        raise SettingError(
            f"a task to be learnt may have at most {MOST_ACTIONS:,} actions: got "
            f"{moving.actions.size:,}"
        )
    seeds = seed_tuple(seeds)
    steps, episodes = limits(budget)
    every = spacing(every, budget)
    longest = longest_run(moving.time_limit, budget, every)
    potentials = _potentials(task, learner, potential, how, len(seeds))
    preludes = _preludes(before, len(seeds), steps, episodes)
    evaluation = GreedyEvaluation() if evaluation is None else evaluation
    instance("evaluation", evaluation, GreedyEvaluation, SettingError)
    storage = Storage() if storage is None else storage
    instance("storage", storage, Storage, SettingError)
    judge = evaluation.settings(task)
    threads = threads_for(moving, workers, len(seeds))
    check_guard(guard, learner, how, guarded=potential is not None)
    n_tables = learner.tables if guard is None else 2
    rows = rows_allowed(moving, n_tables, storage, len(seeds), threads, longest)
    run = Run(moving, learner, how, steps, episodes, every, longest, judge, storage, rows, guard)
    if rows:
        _check_sparse(run, potentials)
    kept = storage.keep and not rows
    shape = (len(seeds), moving.states.size, moving.actions.size)
    values = np.empty(shape, storage.dtype) if kept else None

    def train(k: int) -> Outcome:
        start = stream_start(seeds[k], stream)
        out = None if values is None else values[k]
        return run.train(start, potentials[k], out, preludes[k])

    done = over_seeds(train, len(seeds), threads)
    found = values if kept else tuple(o.values for o in done) if storage.keep else None
    return _result(task, learner, seeds, found, done, every)


def _potentials(
    task: Task,
    learner: Learner,
    potential: Potential | Sequence[Potential] | None,
    how: How,
    n_seeds: int,
) -> list[Potential | None]:
    """Return the potential of each seed, checked against the task, the learner and `how`."""
    one_of("how", how, get_args(How), SettingError)
    if how == "look_back" and (not isinstance(learner, SARSA) or dynamics(task).discount == 0):
        raise SettingError(
            "look_back is valid for on-policy SARSA at a positive discount only: got "
            f"{type(learner).__name__} at discount {dynamics(task).discount:g}"
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


def _preludes(
    before: Sequence[Prelude] | None, n_seeds: int, steps: int, episodes: int
) -> Sequence[Prelude]:
    """Return the prelude of each seed, checked against the budget."""
    if before is None:
        return [NO_PRELUDE] * n_seeds
    if len(before) != n_seeds:
        raise SettingError(f"one prelude a seed means {n_seeds} of them: got {len(before)}")
    for k, one in enumerate(before):
        if one.steps >= steps or len(one.lengths) >= episodes:
            raise SettingError(
                "a budget must exceed what was spent on it before learning: the prelude of seed "
                f"number {k} took {one.steps:,} steps in {len(one.lengths):,} episodes"
            )
    return before


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


def _result(
    task: Task,
    learner: Learner,
    seeds: tuple[int, ...],
    values: Any,
    done: list[Outcome],
    every: int,
) -> LearningResult:
    """Put the seeds' records on one axis of checkpoints."""
    n = max(outcome.steps for outcome in done) // every + 1
    training = np.stack([outcome.record.training_return[:n] for outcome in done])
    greedy = np.stack([outcome.record.greedy_return[:n] for outcome in done])
    episodes = np.stack([outcome.record.episodes[:n] for outcome in done])
    trust = np.stack([outcome.record.trust[:n] for outcome in done])
    for k, outcome in enumerate(done):
        last = outcome.steps // every
        for held in (greedy, episodes, trust):
            held[k, last + 1 :] = held[k, last]
    return LearningResult(
        task=task,
        learner=learner,
        seeds=seeds,
        values=frozen(values) if isinstance(values, np.ndarray) else values,
        steps=frozen(np.arange(n) * every),
        training_return=frozen(training),
        greedy_return=frozen(greedy),
        episodes=frozen(episodes),
        steps_used=frozen(np.array([outcome.steps for outcome in done])),
        episodes_used=frozen(np.array([outcome.episodes for outcome in done])),
        out_of_memory=frozen(np.array([outcome.out_of_memory for outcome in done])),
        trust=frozen(trust),
    )
