"""Training one task over many seeds: :func:`learn` and what it returns."""

import hashlib
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, one_of, whole_number
from curricle.errors import SettingError
from curricle.learning import kernels
from curricle.learning.budget import Episodes, limits, longest_run, seed_tuple, spacing
from curricle.learning.evaluation import GreedyEvaluation
from curricle.learning.learners import SARSA, Learner, QLearning
from curricle.learning.potential import StateActionPotential, StatePotential
from curricle.learning.schedules import HARMONIC, constant
from curricle.tasks.mdp import FiniteMDP, Task, same_task, tables
from curricle.tasks.spaces import frozen

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Potential = StatePotential | StateActionPotential

How = Literal["initialise", "look_ahead", "look_back", "state", "bonus", "advice"]
"""The ways a potential enters learning; :func:`learn` says what each does."""


@dataclass(frozen=True, eq=False)
class LearningResult:
    """What :func:`learn` found, for K seeds and T checkpoints.

    Attributes
    ----------
    task : Task
    learner : Learner
    seeds : tuple of int
        K of them.
    values : (K, S, A) float64
        The values each seed's policy ends up acting on, in the task's own rewards: Q, plus
        what shaping had taken off it (phi, or Phi(s)). What a transfer hands on.
    steps : (T,) int64
        Steps taken at each checkpoint, from 0.
    training_return : (K, T) float64
        Mean undiscounted, unshaped return of the episodes that ended since the last checkpoint;
        NaN where none did.
    greedy_return : (K, T) float64
        Expected return of the greedy policy (:class:`GreedyEvaluation`). After a seed's budget
        of episodes is spent its last value stands.
    episodes : (K, T) int64
        Episodes ended by each checkpoint.
    steps_used, episodes_used : (K,) int64
        What each seed spent in all.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> learn(GridWorld("S.T"), budget=500, seeds=3).steps_used
    array([500, 500, 500])
    """

    task: Task
    learner: Learner
    seeds: tuple[int, ...]
    values: FloatArray
    steps: IntArray
    training_return: FloatArray
    greedy_return: FloatArray
    episodes: IntArray
    steps_used: IntArray
    episodes_used: IntArray

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
    every: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    stream: str = "",
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
    potential : StatePotential or StateActionPotential, or K of them, optional
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
    every : int, optional
        Steps between checkpoints; by default a hundredth of a step budget, 100 steps for a budget
        of episodes.
    evaluation : GreedyEvaluation, optional
    stream : str
        Name of the random stream, so that several trainings of one seed draw independently.
    workers : int, optional
        Threads over seeds; as many as there are processors by default.

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
    mdp = tables(task)
    seeds = seed_tuple(seeds)
    steps, episodes = limits(budget)
    every = spacing(every, budget)
    longest = longest_run(mdp.time_limit, budget, every)
    potentials = _potentials(task, learner, potential, how, len(seeds))
    evaluation = GreedyEvaluation() if evaluation is None else evaluation
    instance("evaluation", evaluation, GreedyEvaluation, SettingError)
    judge = evaluation.settings(mdp)
    if workers is not None:
        workers = whole_number("workers", workers, 1, SettingError)

    model, rule = _model(mdp), learner.rule()
    counted = rule.learning_rate.shape == HARMONIC
    shape = (mdp.states.size, mdp.actions.size)
    learnt = np.empty((len(seeds), learner.tables, *shape))
    initial = np.where(mdp.terminal[:, None], 0.0, float(learner.initial_value))

    def train(k: int) -> tuple[kernels.Record, int, int]:
        q, mine, shaping = learnt[k], potentials[k], _shaping(potentials[k], how)
        q[...] = initial
        if mine is not None and how in ("initialise", "look_ahead"):
            q += mine.values
        record = _empty_record(longest // every + 1)
        visits = np.zeros(shape if counted else (1, 1), dtype=np.int64)
        random = np.array([stream_start(seeds[k], stream)], dtype=np.uint64)
        ends = (np.int64(steps), np.int64(episodes))
        plain = learner.update == kernels.Q_LEARNING and shaping.way == kernels.PLAIN
        loop = kernels.train_q_learning if plain else kernels.train
        done = loop(model, rule, shaping, judge, q, visits, random, ends, every, record)
        q[...] = q.mean(axis=0) + _taken_off(mine, how, done[0])
        return record, *done

    with ThreadPoolExecutor(min(workers or os.cpu_count() or 1, len(seeds))) as pool:
        done = list(pool.map(train, range(len(seeds))))
    return _result(task, learner, seeds, learnt[:, 0], done, every)


def stream_start(seed: int, stream: str) -> int:
    """Return where the random stream of this seed and name starts, a 64-bit number."""
    return int.from_bytes(hashlib.blake2b(f"{seed}/{stream}".encode(), digest_size=8).digest())


def _potentials(
    task: Task,
    learner: Learner,
    potential: Potential | Sequence[Potential] | None,
    how: How,
    n_seeds: int,
) -> list[Potential | None]:
    """Return the potential of each seed, checked against the task, the learner and `how`."""
    one_of("how", how, get_args(How), SettingError)
    if how == "look_back" and (not isinstance(learner, SARSA) or task.mdp.discount == 0):
        raise SettingError(
            "look_back is valid for on-policy SARSA at a positive discount only: got "
            f"{type(learner).__name__} at discount {task.mdp.discount:g}"
        )
    if potential is None:
        return [None] * n_seeds
    each: list[Any] = list(potential) if isinstance(potential, Sequence) else [potential] * n_seeds
    if len(each) != n_seeds:
        raise SettingError(f"one potential a seed means {n_seeds} of them: got {len(each)}")
    wanted = StatePotential if how == "state" else StateActionPotential
    for one in each:
        if not isinstance(one, wanted):
            raise SettingError(f"how={how!r} takes a {wanted.__name__}: got a {type(one).__name__}")
        if not same_task(one.task, task):
            raise SettingError(
                f"a potential must be made for the task it shapes: it belongs to {one.task}"
            )
        if how not in ("state", "advice") and one.weight != constant(1.0):
            raise SettingError(
                f"only state and advice take a potential with a weight: got how={how!r}"
            )
    return each


def _shaping(potential: Potential | None, how: How) -> kernels.Shaping:
    """Return what the general loop is to add; nothing where phi is written into the table."""
    # Read-only like every potential: another kind of array would be another compilation.
    none = frozen(np.zeros((1, 1)))
    nothing = kernels.Shaping(
        kernels.PLAIN, constant(1.0), frozen(np.zeros(1, np.int64)), none, none
    )
    if isinstance(potential, StatePotential):
        return nothing._replace(
            way=kernels.STATE,
            weight=potential.weight,
            frame_steps=potential.frame_steps,
            state_values=potential.values,
        )
    if potential is None or how not in _WAYS:
        return nothing
    return nothing._replace(way=_WAYS[how], weight=potential.weight, pair_values=potential.values)


_WAYS = {"look_back": kernels.LOOK_BACK, "bonus": kernels.BONUS, "advice": kernels.ADVICE}


def _taken_off(potential: Potential | None, how: How, step: int) -> Any:
    """Return what to add to Q so that it speaks of unshaped rewards and of the policy acted on."""
    if isinstance(potential, StatePotential):
        return potential.at(step)[:, None]
    if potential is not None and how == "advice":
        return potential.weight(step) * potential.values
    return 0.0


def _model(mdp: FiniteMDP) -> kernels.Model:
    limit = np.int64(kernels.NO_LIMIT if mdp.time_limit is None else mdp.time_limit)
    return kernels.Model(
        mdp.outcome_row,
        mdp.probability,
        mdp.cumulative,
        mdp.next_state,
        mdp.reward,
        mdp.terminal,
        mdp.start_states,
        mdp.start_cumulative,
        float(mdp.discount),
        limit,
    )


def _empty_record(n: int) -> kernels.Record:
    return kernels.Record(
        np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, np.int64), np.zeros(n, np.int64)
    )


def _result(
    task: Task,
    learner: Learner,
    seeds: tuple[int, ...],
    values: FloatArray,
    done: list[tuple[kernels.Record, int, int]],
    every: int,
) -> LearningResult:
    """Put the seeds' records on one axis of checkpoints."""
    n = max(steps for _, steps, _ in done) // every + 1
    training = np.stack([record.training_return[:n] for record, _, _ in done])
    greedy = np.stack([record.greedy_return[:n] for record, _, _ in done])
    episodes = np.stack([record.episodes[:n] for record, _, _ in done])
    for k, (_, steps, _) in enumerate(done):
        last = steps // every
        greedy[k, last + 1 :], episodes[k, last + 1 :] = greedy[k, last], episodes[k, last]
    return LearningResult(
        task=task,
        learner=learner,
        seeds=seeds,
        values=frozen(values),
        steps=frozen(np.arange(n) * every),
        training_return=frozen(training),
        greedy_return=frozen(greedy),
        episodes=frozen(episodes),
        steps_used=frozen(np.array([steps for _, steps, _ in done])),
        episodes_used=frozen(np.array([count for _, _, count in done])),
    )
