"""Teachers: the probabilities of several tasks for the next episode, and the draws.

A teacher is a frozen value with three pure functions. Its memory of the episodes so far is not part
of it: `update` returns the new memory. So one teacher serves many seeds at once.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import number, numbers, whole_number
from curricle.errors import SettingError
from curricle.tasks.kernel import ALL, STRIDE, splitmix64, uniform
from curricle.text import brief_repr

SUM_TOLERANCE = 1e-9  # allowed error of a sum of probabilities; they are then divided by their sum


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode that has ended, as a :class:`Teacher` sees it.

    Attributes
    ----------
    task : int
        The index of the episode's task, 0 .. M-1.
    rewards : (L,) float64
        The rewards of its L steps.
    td_errors : (L,) float64
        delta_t = r_t + gamma V(s_t+1) - V(s_t), where V(s) = max_a Q(s, a) when the step was taken,
        0 in terminal states. V may lack the latest updates of tables above 32 KB.
    success : bool
        Whether the episode ended in the goal (:func:`teach`).
    discount : float

    Examples
    --------
    >>> Episode(0, np.array([0.0, 1.0]), np.zeros(2), True, 0.5).discounted_return
    0.5
    """

    task: int
    rewards: FloatArray
    td_errors: FloatArray
    success: bool
    discount: float

    __repr__ = brief_repr

    @property
    def length(self) -> int:
        """The number of steps, L."""
        return len(self.rewards)

    @property
    def discounted_return(self) -> float:
        """sum_t gamma^t r_t."""
        return float(self.rewards @ self.discount ** np.arange(self.length))


class Teacher(Protocol):
    """The three methods that make any class a teacher.

    Memory may be any object and is never changed in place. The class attribute ``uses_goal = True``
    states that the teacher reads `success`; then :func:`teach` refuses tasks without a goal.

    Examples
    --------
    >>> class RoundRobin:
    ...     def start(self, n_tasks):
    ...         return np.eye(n_tasks)[0]
    ...     def update(self, memory, episode):
    ...         return np.roll(np.eye(len(memory))[episode.task], 1)
    ...     def probabilities(self, memory):
    ...         return memory
    >>> teacher = RoundRobin()
    >>> teacher.probabilities(teacher.start(3))
    array([1., 0., 0.])
    """

    def start(self, n_tasks: int) -> Any:
        """Return the memory before the first episode in M tasks."""

    def update(self, memory: Any, episode: Episode) -> Any:
        """Return the memory after an episode."""

    def probabilities(self, memory: Any) -> FloatArray:
        """Return the probabilities of the tasks for the next episode, (M,) float64."""


@dataclass(frozen=True)
class Uniform:
    """All tasks are equally likely at every episode: p_i = 1/M.

    Examples
    --------
    >>> Uniform().probabilities(Uniform().start(4))
    array([0.25, 0.25, 0.25, 0.25])
    """

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
    known: IntArray  # (M,) number of outcomes so far, which are the rightmost entries

    @property
    def rate(self) -> FloatArray:
        """p_i, the share of successes, (M,); 0 before the first episode."""
        return np.asarray(self.success.sum(axis=1) / np.maximum(self.known, 1))


class _BySuccess:
    """A teacher that remembers the last `window` outcomes in each task."""

    window: int
    uses_goal: ClassVar[bool] = True

    def start(self, n_tasks: int) -> Outcomes:
        """Return the memory without outcomes."""
        return Outcomes(np.zeros((n_tasks, self.window), np.bool_), np.zeros(n_tasks, np.int64))

    def update(self, memory: Outcomes, episode: Episode) -> Outcomes:
        """Return the memory with this outcome in place of its task's oldest outcome."""
        success, known, i = memory.success.copy(), memory.known.copy(), episode.task
        success[i] = np.append(success[i, 1:], episode.success)
        known[i] = min(known[i] + 1, success.shape[1])
        return Outcomes(success, known)


@dataclass(frozen=True)
class Learnability(_BySuccess):
    """Sampling for learnability (SFL; Rutherford et al. 2024).

    With probability rho it draws one of the `top` tasks whose learnability p_i (1 - p_i) is
    highest (and ties with the last), else any task. p_i is the share of successes in the
    last `window` episodes in task i; the paper estimates p_i by additional episodes.

    Parameters
    ----------
    rho : float
        In [0, 1].
    top, window : int
        The defaults are for few tasks; the paper's numbers are for thousands of levels.

    Examples
    --------
    >>> memory = Outcomes(np.array([[True, True], [False, True], [False, False]]), np.full(3, 2))
    >>> Learnability(rho=0.5).probabilities(memory).round(3)
    array([0.167, 0.667, 0.167])
    """

    rho: float = 0.5
    top: int = 1
    window: int = 10

    def __post_init__(self) -> None:
        _check_shares(self, "rho")
        for name in ("top", "window"):
            whole_number(f"{name} of Learnability", getattr(self, name), 1, SettingError)

    def probabilities(self, memory: Outcomes) -> FloatArray:
        """Return rho spread over the most learnable tasks plus 1 - rho spread over all, (M,)."""
        wins, known = memory.success.sum(axis=1), np.maximum(memory.known, 1)
        learnability = wins * (known - wins) / known**2  # p (1 - p), equal for p and 1 - p
        last = np.sort(learnability)[-min(self.top, len(learnability))]
        return mixed(equally(learnability >= last), 1 - self.rho)


class Scores(NamedTuple):
    """The memory of :class:`PrioritizedLevelReplay`."""

    score: FloatArray  # (M,)
    drawn: IntArray  # (M,) the number of the latest episode in each task; 0 if there was none
    episodes: int  # episodes in all tasks


@dataclass(frozen=True)
class PrioritizedLevelReplay:
    """Prioritised level replay (PLR; Jiang, Grefenstette, Rocktäschel 2021).

    The score of a task is the L1 value loss of its latest episode, the mean size of its
    generalised advantages: ``S_i = (1/L) sum_t |sum_{k>=t} (gamma lambda)^(k-t) delta_k|``, with
    the learner's V = max_a Q. A task seen before is replayed with probability
    p_i = (1 - rho) P_S + rho P_C, where P_S is proportional to rank(S_i)^(-1/beta), the
    highest score having rank 1, and P_C to the episodes since task i was last drawn. With
    probability 1 - (share of tasks seen) a new task is drawn, all equally likely. Defaults are the
    paper's for Procgen.

    Parameters
    ----------
    temperature : float
        beta > 0; with a small beta only the task with the highest score is replayed.
    staleness, gae_lambda : float
        rho and lambda, in [0, 1].

    Examples
    --------
    >>> teacher = PrioritizedLevelReplay(temperature=1.0, staleness=0.0)
    >>> teacher.probabilities(Scores(np.array([1.0, 5.0]), np.array([1, 2]), 2)).round(3)
    array([0.333, 0.667])
    """

    temperature: float = 0.1
    staleness: float = 0.1
    gae_lambda: float = 0.95

    def __post_init__(self) -> None:
        name = "temperature of PrioritizedLevelReplay"
        if not number(name, self.temperature, SettingError) > 0:
            raise SettingError(f"{name} must be positive: got {self.temperature}")
        _check_shares(self, "staleness", "gae_lambda")

    def start(self, n_tasks: int) -> Scores:
        """Return the memory in which no task has been seen."""
        return Scores(np.zeros(n_tasks), np.zeros(n_tasks, np.int64), 0)

    def update(self, memory: Scores, episode: Episode) -> Scores:
        """Return the memory with this episode's score for its task."""
        score, drawn, now = memory.score.copy(), memory.drawn.copy(), memory.episodes + 1
        total, advantage = 0.0, 0.0
        for delta in episode.td_errors[::-1].tolist():
            advantage = delta + episode.discount * self.gae_lambda * advantage
            total += abs(advantage)
        score[episode.task], drawn[episode.task] = total / episode.length, now
        return Scores(score, drawn, now)

    def probabilities(self, memory: Scores) -> FloatArray:
        """Return the mixture of replayed tasks and new tasks, (M,)."""
        seen = memory.drawn > 0
        if not seen.any():
            return equally(~seen)
        rank = np.empty(len(seen))
        rank[np.argsort(np.where(seen, -memory.score, np.inf), kind="stable")] = range(len(seen))
        replay = np.where(seen, (1.0 + rank) ** (-1 / self.temperature), 0.0)
        age = np.where(seen, memory.episodes - memory.drawn, 0)
        rest = age / age.sum() if age.any() else replay / replay.sum()
        replay = (1 - self.staleness) * replay / replay.sum() + self.staleness * rest
        share = seen.mean()
        new = np.zeros(len(seen)) if seen.all() else equally(~seen)
        return np.asarray(share * replay + (1 - share) * new)


@dataclass(frozen=True)
class ReverseCurriculum(_BySuccess):
    """Reverse curriculum generation for a finite order of starts (Florensa et al. 2017).

    Tasks are in order from the goal outwards; p_i is the share of successes in the last `window`
    episodes in task i, 0 before the first. New starts are tasks that are not mastered, p_i <=
    r_max, and whose predecessor is good, p_(i-1) >= r_min (the first task's is the goal).
    Old starts are the tasks with p_i >= r_min. With probability `replay` an old start is drawn,
    else a new start, all equally likely; if there is no start of the drawn kind, the other kind is
    used. In the paper Brownian motion from good starts reaches new starts.

    Parameters
    ----------
    r_min, r_max : float
        0 <= r_min <= r_max <= 1. With r_max = 1 no task is ever mastered.
    replay : float
        In [0, 1]; by default the paper's 100 of 300.
    window : int

    Examples
    --------
    >>> memory = Outcomes(np.array([[True, True], [False, True], [False, False]]), np.full(3, 2))
    >>> ReverseCurriculum(replay=0.0).probabilities(memory)
    array([0. , 0.5, 0.5])
    """

    r_min: float = 0.1
    r_max: float = 0.9
    replay: float = 1 / 3
    window: int = 10

    def __post_init__(self) -> None:
        _check_shares(self, "r_min", "r_max", "replay")
        whole_number("window of ReverseCurriculum", self.window, 1, SettingError)
        if self.r_min > self.r_max:
            bounds = f"{self.r_min} and {self.r_max}"
            raise SettingError(f"r_min of ReverseCurriculum must not exceed r_max: got {bounds}")

    def probabilities(self, memory: Outcomes) -> FloatArray:
        """Return the mixture of new and old starts, (M,)."""
        rate = memory.rate
        old = (rate >= self.r_min) & (memory.known > 0)
        new = (rate <= self.r_max) & np.append(True, old[:-1])
        if not (old.any() and new.any()):
            return equally(old | new)
        return self.replay * equally(old) + (1 - self.replay) * equally(new)


def _check_shares(teacher: Any, *names: str) -> None:
    """Raise SettingError unless these settings are numbers in [0, 1]."""
    for name in names:
        label = f"{name} of {type(teacher).__name__}"
        number(label, getattr(teacher, name), SettingError, 0.0, 1.0)


def equally(chosen: BoolArray) -> FloatArray:
    """Return the distribution in which the chosen tasks, at least one, are equally likely."""
    return np.asarray(chosen / np.count_nonzero(chosen))


def mixed(distribution: FloatArray, epsilon: float) -> FloatArray:
    """Return (1 - epsilon) of a distribution and epsilon of the uniform distribution."""
    return (1 - epsilon) * distribution + epsilon / len(distribution)


# -- the draws -----------------------------------------------------------------------------------


@dataclass
class TaskSampler:
    """Draws the tasks of a seed's episodes from the seed's random stream for the teacher."""

    teacher: Teacher
    n_tasks: int
    counter: int  # the state of the stream
    eval_freq: int  # steps between checkpoints
    tasks: list[int] = field(default_factory=list)  # the task of every episode begun
    begun_at: list[int] = field(default_factory=list)  # steps in all tasks before every episode
    # Checkpoint -> the probabilities in the last draw at or before it.
    changes: list[tuple[int, FloatArray]] = field(default_factory=list)
    memory: Any = field(init=False)

    def __post_init__(self) -> None:
        self.memory = self.teacher.start(self.n_tasks)

    def draw(self, step: int) -> int:
        """Return the task of the episode that begins after `step` steps."""
        answer = self.teacher.probabilities(self.memory)
        probabilities = numbers("a teacher's probabilities", answer, SettingError)
        fits = probabilities.shape == (self.n_tasks,) and bool((probabilities >= 0).all())
        if not fits or not abs(probabilities.sum() - 1) <= SUM_TOLERANCE:
            raise SettingError(
                f"a teacher's probabilities must be {self.n_tasks} numbers from 0 up that sum to "
                f"1: after {len(self.tasks):,} episodes {self.teacher!r} gives {answer!r}"
            )
        self.counter = (self.counter + int(STRIDE)) & ALL
        task = drawn(probabilities, uniform(splitmix64(self.counter)))
        checkpoint = -(-step // self.eval_freq)
        if self.changes and self.changes[-1][0] == checkpoint:
            self.changes.pop()
        self.changes.append((checkpoint, probabilities))
        self.tasks.append(task)
        self.begun_at.append(step)
        return task


def drawn(probabilities: FloatArray, chance: float) -> int:
    """Return the task that `chance`, in [0, 1), draws; never a task of probability 0."""
    rising = np.cumsum(probabilities)
    place = int(np.searchsorted(rising, chance * rising[-1], side="right"))
    return min(place, int(np.flatnonzero(probabilities)[-1]))
