"""Teachers: they draw the start of every episode of a run from several groups of a task's starts.

A teacher is a frozen value with three pure functions: `start(n_tasks)` returns its memory before
the first episode, `update(memory, episode)` the memory after an episode, `probabilities(memory)`
those of the M tasks, the groups of starts. Its memory is not part of it, so that one teacher
serves many seeds.
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

import curricle as cr
from curricle.arrays import BoolArray, FloatArray, FloatTable, IntArray
from curricle.tasks.kernel import ALL, STRIDE, inlined, splitmix64, stream_start, uniform
from curricle.tasks.live import BROKEN_DOWN, Answer, answer
from curricle.tasks.mdp import FiniteMDP, table_model, tables
from curricle.tasks.models import (
    Tables,
    evaluation_model,
    first_state,
    has_failed,
    transition,
)
from curricle.tasks.start_states import goal_states

# -- teachers --------------------------------------------------------------------------------------


class Episode(NamedTuple):
    """An episode that has ended, of L steps."""

    task: int  # 0 .. M-1
    rewards: FloatArray  # (L,)
    td_errors: FloatArray  # (L,) r + gamma V(s') - V(s), with V = max_a Q when the step was taken
    success: bool  # whether it ended in the goal
    discount: float


class Teacher(Protocol):
    """What makes a class a teacher; a memory may be anything, and is never changed in place."""

    def start(self, n_tasks: int) -> Any: ...
    def update(self, memory: Any, episode: Episode) -> Any: ...
    def probabilities(self, memory: Any) -> FloatArray: ...


class Uniform:
    """All tasks are equally likely at every episode: p_i = 1/M."""

    def start(self, n_tasks: int) -> FloatArray:
        """Return the probabilities, which never change."""
        return np.full(n_tasks, 1 / n_tasks)

    def update(self, memory: FloatArray, episode: Episode) -> FloatArray:
        """Return the memory unchanged."""
        return memory

    def probabilities(self, memory: FloatArray) -> FloatArray:
        """Return 1/M for all tasks."""
        return memory


class Outcomes(NamedTuple):
    """The last `n` successes and failures in each task, the oldest first."""

    success: BoolArray  # (M, n)
    number: IntArray  # (M,) of outcomes so far, which are the rightmost entries


class _BySuccess:
    """A teacher that remembers the last `window` outcomes in each task."""

    window: int

    def start(self, n_tasks: int) -> Outcomes:
        """Return the memory without outcomes."""
        return Outcomes(np.zeros((n_tasks, self.window), np.bool_), np.zeros(n_tasks, np.int64))

    def update(self, memory: Outcomes, episode: Episode) -> Outcomes:
        """Return the memory with this outcome in place of its task's oldest outcome."""
        success, number, i = memory.success.copy(), memory.number.copy(), episode.task
        success[i] = np.append(success[i, 1:], episode.success)
        number[i] = min(number[i] + 1, success.shape[1])
        return Outcomes(success, number)


@dataclass(frozen=True)
class Learnability(_BySuccess):
    """Sampling for learnability (SFL; Rutherford et al. 2024).

    With probability rho it draws one of the `top` tasks whose learnability p_i (1 - p_i) is highest
    (and ties with the last), else any task. p_i is the share of successes in the last `window`
    episodes in task i; the paper estimates p_i by additional episodes.
    """

    rho: float = 0.5
    top: int = 1
    window: int = 10

    def probabilities(self, memory: Outcomes) -> FloatArray:
        """Return rho spread over the most learnable tasks plus 1 - rho spread over all, (M,)."""
        wins, number = memory.success.sum(axis=1), np.maximum(memory.number, 1)
        learnability = wins * (number - wins) / number**2  # p (1 - p), equal for p and 1 - p
        last = np.sort(learnability)[-min(self.top, len(learnability))]
        best = equally(learnability >= last)
        return self.rho * best + (1 - self.rho) / len(best)


class Scores(NamedTuple):
    """The memory of :class:`PrioritizedLevelReplay`."""

    score: FloatArray  # (M,)
    drawn: IntArray  # (M,) the number of the latest episode in each task; 0 if there was none
    episodes: int  # in all tasks


@dataclass(frozen=True)
class PrioritizedLevelReplay:
    """Prioritised level replay (PLR; Jiang, Grefenstette, Rocktäschel 2021).

    The score of a task is the L1 value loss of its latest episode, the mean size of its generalised
    advantages: ``S_i = (1/L) sum_t |sum_{k>=t} (gamma lambda)^(k-t) delta_k|``, with the learner's
    V = max_a Q. A task that was drawn before is replayed with probability p_i = (1 - rho) P_S +
    rho P_C, where P_S is proportional to rank(S_i)^(-1/beta), the highest score having rank 1, and
    P_C to the episodes since task i was last drawn. With probability 1 - (share of tasks drawn
    before) a new task is drawn, all equally likely. Defaults are the paper's for Procgen.
    """

    temperature: float = 0.1  # beta
    staleness: float = 0.1  # rho
    gae_lambda: float = 0.95

    def start(self, n_tasks: int) -> Scores:
        """Return the memory in which no task has been drawn."""
        return Scores(np.zeros(n_tasks), np.zeros(n_tasks, np.int64), 0)

    def update(self, memory: Scores, episode: Episode) -> Scores:
        """Return the memory with this episode's score for its task."""
        score, drawn, number = memory.score.copy(), memory.drawn.copy(), memory.episodes + 1
        total, advantage = 0.0, 0.0
        for delta in episode.td_errors[::-1].tolist():
            advantage = delta + episode.discount * self.gae_lambda * advantage
            total += abs(advantage)
        score[episode.task], drawn[episode.task] = total / len(episode.td_errors), number
        return Scores(score, drawn, number)

    def probabilities(self, memory: Scores) -> FloatArray:
        """Return the mixture of replayed tasks and new tasks, (M,)."""
        old = memory.drawn > 0
        if not old.any():
            return equally(~old)
        rank = np.empty(len(old))
        rank[np.argsort(np.where(old, -memory.score, np.inf), kind="stable")] = range(len(old))
        replay = np.where(old, (1.0 + rank) ** (-1 / self.temperature), 0.0)
        age = np.where(old, memory.episodes - memory.drawn, 0)
        rest = age / age.sum() if age.any() else replay / replay.sum()
        replay = (1 - self.staleness) * replay / replay.sum() + self.staleness * rest
        share = old.mean()
        new = np.zeros(len(old)) if old.all() else equally(~old)
        return np.asarray(share * replay + (1 - share) * new)


@dataclass(frozen=True)
class ReverseCurriculum(_BySuccess):
    """Reverse curriculum generation for a finite order of starts (Florensa et al. 2017).

    Tasks are in order from the goal outwards; p_i is the share of successes in the last `window`
    episodes in task i, 0 before the first. New starts are tasks that are not mastered, p_i <=
    r_max, and whose predecessor is good, p_(i-1) >= r_min (the first task's is the goal). Old
    starts are the tasks with p_i >= r_min. With probability `replay` (the paper's 100 of 300) an
    old start is drawn, else a new start, all equally likely; if there is no start of the drawn
    kind, the other kind is used. In the paper Brownian motion from good starts reaches new starts.
    """

    r_min: float = 0.1
    r_max: float = 0.9
    replay: float = 1 / 3
    window: int = 10

    def probabilities(self, memory: Outcomes) -> FloatArray:
        """Return the mixture of new and old starts, (M,)."""
        rate = memory.success.sum(axis=1) / np.maximum(memory.number, 1)
        old = (rate >= self.r_min) & (memory.number > 0)
        new = (rate <= self.r_max) & np.append(True, old[:-1])
        if not (old.any() and new.any()):
            return equally(old | new)
        return self.replay * equally(old) + (1 - self.replay) * equally(new)


def equally(chosen: BoolArray) -> FloatArray:
    """Return the distribution in which the chosen tasks, at least one, are equally likely."""
    return np.asarray(chosen / np.count_nonzero(chosen))


# -- the model of the task, the start of whose episodes is drawn -----------------------------------
#
# Learning loops use it like any other model: ``first_state`` asks a Python object for the next
# start, and transitions come from the task's tables. The rewards and TD errors of an episode are
# recorded, and the teacher reads them when the episode has ended.


class EpisodeRecord(NamedTuple):
    """The steps of the current episode; L is the time limit."""

    length: IntArray  # (1,) steps so far
    rewards: FloatArray  # (L,)
    td_errors: FloatArray  # (L,)
    last_state: IntArray  # (1,)


class TaughtModel(NamedTuple):
    """A task's tables, the record of the current episode, and the callable that draws the next."""

    address: npt.NDArray[np.uint64]  # (1,) of the callable of `answer`
    failed: BoolArray  # (1,) whether the callable has failed
    tables: Tables
    discount: float
    q: FloatTable  # (S, A) the learner's table
    episode: EpisodeRecord


@first_state.body(TaughtModel)
def _taught_start(model, bits):
    state = answer(model.address[0], np.int64(bits))[0]
    model.episode.length[0] = 0  # also after a failure, since a loop may take one more step
    if state < 0:
        model.failed[0] = True
        return np.uint64(0)
    return np.uint64(state)


@inlined
def _highest(q, state):
    """Return max_a Q(s, a)."""
    best = -np.inf
    for action in range(q.shape[1]):
        best = max(best, q[state, action])
    return best


@transition.body(TaughtModel)
def _taught_step(model, state, action, bits):
    episode, bootstrapped = model.episode, 0.0
    next_state, reward, terminated = transition(model.tables, state, action, bits)
    if not terminated:
        bootstrapped = model.discount * _highest(model.q, next_state)
    n = episode.length[0]
    episode.rewards[n] = reward
    episode.td_errors[n] = reward + bootstrapped - _highest(model.q, state)
    episode.length[0] = n + 1
    episode.last_state[0] = next_state
    return next_state, reward, terminated


has_failed.body(TaughtModel)(lambda model: model.failed[0])
evaluation_model.body(TaughtModel)(lambda model: model.tables)


# -- one seed --------------------------------------------------------------------------------------


class TaskSampler:
    """The teacher's draws for a seed, from the seed's random stream for the teacher."""

    def __init__(self, teacher: Teacher, tasks: Sequence[FiniteMDP], seed: int):
        self.teacher, self.tasks = teacher, tasks
        self.counter, self.memory = stream_start(seed, "/teacher"), teacher.start(len(tasks))
        self.drawn: list[int] = []  # the task of every episode begun
        self.goal = goal_states(tasks[0])

    def draw(self, bits: int) -> int:
        """Return the state in which the next episode starts; it is drawn as compiled loops do."""
        probabilities = self.teacher.probabilities(self.memory)
        self.counter = (self.counter + int(STRIDE)) & ALL
        rising, chance = np.cumsum(probabilities), uniform(splitmix64(self.counter))
        place = int(np.searchsorted(rising, chance * rising[-1], side="right"))
        self.drawn.append(min(place, int(np.flatnonzero(probabilities)[-1])))
        task = self.tasks[self.drawn[-1]]
        start = np.searchsorted(task.start_cumulative, uniform(bits & ALL), side="right")
        return int(task.start_states[start])

    def learn(self, record: EpisodeRecord) -> None:
        """Tell the teacher of the episode that has ended."""
        n, last = int(record.length[0]), record.last_state[0]
        self.memory = self.teacher.update(
            self.memory,
            Episode(
                self.drawn[-1],
                record.rewards[:n].copy(),
                record.td_errors[:n].copy(),
                bool(self.goal[last] and self.tasks[0].terminal[last]),
                self.tasks[0].discount,
            ),
        )


class TaughtTask:
    """The target for one seed, its episodes starting as a teacher draws."""

    available = None  # all actions are, in every state

    def __init__(self, target: FiniteMDP, sampler: TaskSampler):
        self.target, self.sampler = target, sampler
        self.states, self.actions, self.terminal = target.states, target.actions, target.terminal
        self.discount, self.time_limit = target.discount, target.time_limit
        self.model = (self,)  # until it is open

    @contextmanager
    def open(self, start: int, q: FloatTable) -> Generator[TaughtModel]:
        """Return a context with the model of a run that acts on `q`, (1, S, A)."""
        raised = list[BaseException]()
        limit = self.time_limit or 0
        n, last = np.zeros((2, 1), np.int64)
        record = EpisodeRecord(n, np.zeros(limit), np.zeros(limit), last)
        starts = self._starts(record, raised)
        next(starts)
        send = starts.send  # it must outlive its address
        address, failed = np.array([id(send)], dtype=np.uint64), np.zeros(1, np.bool_)
        try:
            yield TaughtModel(
                address, failed, table_model(self.target), self.discount, q[0], record
            )
        finally:
            starts.close()
        if raised:
            raise raised[0]

    def _starts(
        self, record: EpisodeRecord, raised: list[BaseException]
    ) -> Generator[Answer | None, int, None]:
        """Yield the start of an episode for every 64 bits sent; raise nothing."""
        # The caller is compiled code, through which no exception can pass.
        bits = yield None
        try:
            while True:
                if self.sampler.drawn:
                    self.sampler.learn(record)
                bits = yield self.sampler.draw(bits), 0.0, False, False
        except GeneratorExit:
            raise
        except BaseException as error:
            raised.append(error)
        while True:
            yield BROKEN_DOWN


class InTarget(cr.GreedyEvaluation):
    """An evaluation in the target from its own starts, not from those that a teacher draws."""

    def kernel(self, task: Any) -> Any:
        """Return the evaluation of the target for compiled loops."""
        return super().kernel(task.target)


@dataclass(frozen=True)
class Taught:
    """The target's greedy return against the steps in all tasks, and the draws, of K seeds."""

    results: tuple[cr.learning.LearningResult, ...]
    drawn: tuple[tuple[int, ...], ...]  # the task of every episode begun

    @property
    def greedy_return(self) -> FloatArray:
        """The greedy return in the target at each checkpoint, (K, T)."""
        return np.concatenate([result.greedy_return for result in self.results])


def teach(
    tasks: Mapping[str, Any],
    target: Any,
    teacher: Teacher,
    learner: cr.learning.Learner,
    budget: int,
    *,
    seeds: Sequence[int],
    eval_freq: int,
    evaluation: cr.GreedyEvaluation,
) -> Taught:
    """Return the result of learning a target by episodes in tasks that a teacher draws.

    The tasks differ from the target in their start states only, and have a goal. One learner learns
    from all of them; `budget` is of steps in all of them. The values of an optimistic learner on
    which it acts are those of an episode's TD errors.
    """
    learner = learner.for_task(tables(target))  # its bounds, which the drawn tasks do not tell
    mdps, drawn, results = [tables(task) for task in tasks.values()], [], []
    in_target = InTarget(**vars(evaluation))
    for seed in seeds:
        sampler = TaskSampler(teacher, mdps, seed)
        task: Any = TaughtTask(tables(target), sampler)
        results.append(
            cr.learn(task, learner, budget, seeds=[seed], eval_freq=eval_freq, evaluation=in_target)
        )
        drawn.append(tuple(sampler.drawn))
    return Taught(tuple(results), tuple(drawn))
