"""Teachers: the probability of each of several tasks for the next episode, and its draws.

A teacher is a frozen value with three pure functions. What it has to remember of the episodes so
far is what `update` returns, so that a teacher can be used for many seeds at once.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import number, whole_number
from curricle.display import brief_repr
from curricle.errors import SettingError
from curricle.tasks.kernel import ALL, STRIDE, splitmix64, uniform

SUM_TOLERANCE = 1e-9
"""By which probabilities may miss 1; they are divided by their sum."""


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode that has ended, as a :class:`Teacher` sees it.

    Attributes
    ----------
    task : int
        In which of the M tasks it was played, 0 .. M-1 in their order.
    rewards : (L,) float64
        Those of its L steps.
    td_errors : (L,) float64
        delta_t = r_t + gamma V(s_t+1) - V(s_t), where V(s) = max_a Q(s, a) when the step was taken,
        0 in ends. An update that a loop still held back then is not in it (tables above 32 KB).
    success : bool
        Whether it ended in the goal (:func:`teach`).
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
        """L, its steps."""
        return len(self.rewards)

    @property
    def discounted_return(self) -> float:
        """sum_t gamma^t r_t."""
        return float(self.rewards @ self.discount ** np.arange(self.length))


class Teacher(Protocol):
    """What teaching needs of a teacher; a class of one's own with these three methods is one.

    Memory is anything, never changed in place: `update` returns a new one. A class attribute
    ``uses_goal = True`` says that it reads `success`: tasks without a goal are then refused.

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
        """Return the probability of each task for the next episode, (M,) float64."""


@dataclass(frozen=True)
class Uniform:
    """Every task is as likely at every episode: p_i = 1/M.

    Examples
    --------
    >>> Uniform().probabilities(Uniform().start(4))
    array([0.25, 0.25, 0.25, 0.25])
    """

    def start(self, n_tasks: int) -> FloatArray:
        """Return the probabilities, which never change."""
        return np.full(n_tasks, 1 / n_tasks)

    def update(self, memory: FloatArray, episode: Episode) -> FloatArray:
        """Return the memory as it was."""
        return memory

    def probabilities(self, memory: FloatArray) -> FloatArray:
        """Return 1/M for each task."""
        return memory


class Progress(NamedTuple):
    """What :class:`TSCL` remembers."""

    progress: FloatArray  # (M,) Q_i
    last: FloatArray  # (M,) the latest return in each task; NaN before the first


@dataclass(frozen=True)
class TSCL:
    """Teacher-student curriculum learning, algorithm "Online" (Matiisen et al. 2017).

    After an episode with discounted return x in task i, whose last one returned x':
    Q_i += learning_rate ((x - x') - Q_i). The next task is the one whose learning progress
    ``|Q_i|`` is largest, ties at random, and with probability epsilon any. Tasks whose return falls
    are practised again, too. The first return in a task only sets x': the paper's scores begin at
    0, returns need not.

    Parameters
    ----------
    learning_rate, epsilon : float
        In [0, 1].

    Examples
    --------
    >>> teacher = TSCL(epsilon=0.2)
    >>> teacher.probabilities(Progress(np.array([0.5, -2.0]), np.zeros(2)))
    array([0.1, 0.9])
    """

    learning_rate: float = 0.1
    epsilon: float = 0.1

    def __post_init__(self) -> None:
        for name in ("learning_rate", "epsilon"):
            number(f"{name} of TSCL", getattr(self, name), SettingError, 0.0, 1.0)

    def start(self, n_tasks: int) -> Progress:
        """Return no progress anywhere."""
        return Progress(np.zeros(n_tasks), np.full(n_tasks, np.nan))

    def update(self, memory: Progress, episode: Episode) -> Progress:
        """Return the memory with the change of return since the last episode in this task."""
        progress, last, i = memory.progress.copy(), memory.last.copy(), episode.task
        now = episode.discounted_return
        if not np.isnan(last[i]):
            progress[i] += self.learning_rate * ((now - last[i]) - progress[i])
        last[i] = now
        return Progress(progress, last)

    def probabilities(self, memory: Progress) -> FloatArray:
        """Return epsilon / M for each task, and the rest for those of the largest size of Q."""
        size = np.abs(memory.progress)
        return mixed(equally(size == size.max()), self.epsilon)


class Outcomes(NamedTuple):
    """The last `n` successes and failures in each task, the oldest first."""

    success: BoolArray  # (M, n)
    known: IntArray  # (M,) how many of them there are yet, at the right

    @property
    def rate(self) -> FloatArray:
        """p_i, the share of successes, (M,); 0 where nothing is known."""
        return np.asarray(self.success.sum(axis=1) / np.maximum(self.known, 1))


class _BySuccess:
    """A teacher that remembers the last `window` outcomes in each task."""

    window: int
    uses_goal: ClassVar[bool] = True

    def start(self, n_tasks: int) -> Outcomes:
        """Return no outcomes."""
        none = np.zeros((n_tasks, self.window), np.bool_)
        return Outcomes(none, np.zeros(n_tasks, np.int64))

    def update(self, memory: Outcomes, episode: Episode) -> Outcomes:
        """Return the memory with one more outcome; the oldest of its task is dropped."""
        success, known, i = memory.success.copy(), memory.known.copy(), episode.task
        success[i] = np.append(success[i, 1:], episode.success)
        known[i] = min(known[i] + 1, success.shape[1])
        return Outcomes(success, known)


@dataclass(frozen=True)
class Learnability(_BySuccess):
    """Sampling for learnability (SFL; Rutherford et al. 2024).

    With probability rho one of the `top` tasks whose learnability p_i (1 - p_i) is highest, equally
    likely (more of them where several have the last one's), else any. p_i is the share of
    successes in the last `window` episodes in task i. The paper draws thousands of new levels for
    each estimate and keeps the best; here there are M tasks, and estimates come from the episodes
    that are learnt from, so that they cost no further steps.

    Parameters
    ----------
    rho : float
        In [0, 1].
    top, window : int
        Chosen for few tasks; the paper's numbers are for thousands of levels.

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
        number("rho of Learnability", self.rho, SettingError, 0.0, 1.0)
        for name in ("top", "window"):
            whole_number(f"{name} of Learnability", getattr(self, name), 1, SettingError)

    def probabilities(self, memory: Outcomes) -> FloatArray:
        """Return (1 - rho) / M for each task, and the rest for the most learnable."""
        learnability = memory.rate * (1 - memory.rate)
        last = np.sort(learnability)[-min(self.top, len(learnability))]
        return mixed(equally(learnability >= last), 1 - self.rho)


class Scores(NamedTuple):
    """What :class:`PrioritizedLevelReplay` remembers."""

    score: FloatArray  # (M,)
    drawn: IntArray  # (M,) the number of the latest episode in each task; 0 before the first
    episodes: int  # in all


@dataclass(frozen=True)
class PrioritizedLevelReplay:
    """Prioritised level replay (PLR; Jiang, Grefenstette, Rocktäschel 2021).

    The score of a task is the L1 value loss of its latest episode, the mean size of its
    generalised advantages: ``S_i = (1/L) sum_t |sum_{k>=t} (gamma lambda)^(k-t) delta_k|``, with
    the learner's own V = max_a Q. Of the tasks seen so far one is replayed with probability
    p_i = (1 - rho) P_S + rho P_C, where P_S is proportional to rank(S_i)^(-1/beta), the
    highest score having rank 1, and P_C to the episodes since task i was last drawn. A task not yet
    seen is drawn, all equally likely, with probability 1 - (share of tasks seen).

    Parameters
    ----------
    temperature : float
        beta > 0; small ones replay the highest score alone. Defaults are the paper's for Procgen.
    staleness : float
        rho, in [0, 1].
    gae_lambda : float
        lambda, in [0, 1].

    Examples
    --------
    >>> teacher = PrioritizedLevelReplay(temperature=1.0, staleness=0.0)
    >>> memory = Scores(np.array([1.0, 5.0]), np.array([1, 2]), 2)
    >>> teacher.probabilities(memory).round(3)
    array([0.333, 0.667])
    """

    temperature: float = 0.1
    staleness: float = 0.1
    gae_lambda: float = 0.95

    def __post_init__(self) -> None:
        what = "temperature of PrioritizedLevelReplay"
        if not number(what, self.temperature, SettingError) > 0:
            raise SettingError(f"{what} must be positive: got {self.temperature}")
        for name in ("staleness", "gae_lambda"):
            given = getattr(self, name)
            number(f"{name} of PrioritizedLevelReplay", given, SettingError, 0.0, 1.0)

    def start(self, n_tasks: int) -> Scores:
        """Return that no task has been seen."""
        return Scores(np.zeros(n_tasks), np.zeros(n_tasks, np.int64), 0)

    def update(self, memory: Scores, episode: Episode) -> Scores:
        """Return the memory with the score of this episode."""
        score, drawn, now = memory.score.copy(), memory.drawn.copy(), memory.episodes + 1
        decay = episode.discount * self.gae_lambda
        score[episode.task], drawn[episode.task] = value_loss(episode.td_errors, decay), now
        return Scores(score, drawn, now)

    def probabilities(self, memory: Scores) -> FloatArray:
        """Return the mixture of tasks to replay and tasks not yet seen."""
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


def value_loss(td_errors: FloatArray, decay: float) -> float:
    """Return the mean size of an episode's generalised advantages (Schulman et al. 2016).

    `decay` is gamma lambda.
    """
    total, advantage = 0.0, 0.0
    for delta in td_errors[::-1].tolist():
        advantage = delta + decay * advantage
        total += abs(advantage)
    return total / len(td_errors)


@dataclass(frozen=True)
class ReverseCurriculum(_BySuccess):
    """Reverse curriculum generation for a finite order of starts (Florensa et al. 2017).

    Tasks are in order from the goal outwards. With p_i the share of successes in the last `window`
    episodes in task i, 0 before the first, new starts are the tasks that are not yet mastered,
    p_i <= r_max, and whose predecessor is good, p_(i-1) >= r_min (the goal itself is, so the first
    task has one). Old ones are those with p_i >= r_min. A task is drawn from the old with
    probability `replay`, else from the new, equally likely within each; from the other where one
    is empty. In the paper new starts are reached by Brownian motion from good ones, 200 of them for
    100 old ones; here they are the next task in the order.

    Parameters
    ----------
    r_min, r_max : float
        0 <= r_min <= r_max <= 1. An r_max of 1 means that nothing is ever mastered.
    replay : float
        In [0, 1]; by default the paper's 100 of 300.
    window : int
        Episodes that a success rate is taken over.

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
        for name in ("r_min", "r_max", "replay"):
            number(f"{name} of ReverseCurriculum", getattr(self, name), SettingError, 0.0, 1.0)
        whole_number("window of ReverseCurriculum", self.window, 1, SettingError)
        if self.r_min > self.r_max:
            raise SettingError(
                f"r_min of ReverseCurriculum must not exceed r_max: got {self.r_min} and "
                f"{self.r_max}"
            )

    def probabilities(self, memory: Outcomes) -> FloatArray:
        """Return the mixture of new starts and old ones."""
        rate = memory.rate
        old = (rate >= self.r_min) & (memory.known > 0)
        new = (rate <= self.r_max) & np.append(True, old[:-1])
        if not (old.any() and new.any()):
            return equally(old | new)
        return self.replay * equally(old) + (1 - self.replay) * equally(new)


def equally(chosen: BoolArray) -> FloatArray:
    """Return the distribution in which the chosen tasks, at least one, are equally likely."""
    return np.asarray(chosen / np.count_nonzero(chosen))


def mixed(distribution: FloatArray, epsilon: float) -> FloatArray:
    """Return (1 - epsilon) of a distribution and epsilon of the uniform one."""
    return (1 - epsilon) * distribution + epsilon / len(distribution)


# -- the draws -----------------------------------------------------------------------------------


@dataclass
class TaskSampler:
    """Draws the task of each episode of one seed from a stream of its own."""

    teacher: Teacher
    n_tasks: int
    counter: int
    """Where the stream is."""
    eval_freq: int
    """Steps between checkpoints."""
    tasks: list[int] = field(default_factory=list)
    """That of each episode begun."""
    begun_at: list[int] = field(default_factory=list)
    """Steps, in all tasks, before each."""
    changes: list[tuple[int, FloatArray]] = field(default_factory=list)
    """The checkpoint before which an episode was the last to begin, and its probabilities."""
    memory: Any = field(init=False)

    def __post_init__(self) -> None:
        self.memory = self.teacher.start(self.n_tasks)

    def draw(self, step: int) -> int:
        """Return the task of the episode that begins after so many steps."""
        probabilities = self._asked()
        self.counter = (self.counter + int(STRIDE)) & ALL
        task = drawn(probabilities, uniform(splitmix64(self.counter)))
        checkpoint = -(-step // self.eval_freq)
        if self.changes and self.changes[-1][0] == checkpoint:
            self.changes.pop()
        self.changes.append((checkpoint, probabilities))
        self.tasks.append(task)
        self.begun_at.append(step)
        return task

    def ended(self, episode: Episode) -> None:
        """Let the teacher see an episode."""
        self.memory = self.teacher.update(self.memory, episode)

    def _asked(self) -> FloatArray:
        """Return the teacher's probabilities, or raise SettingError unless they are some."""
        given = self.teacher.probabilities(self.memory)
        found = np.asarray(given, dtype=np.float64)
        right = found.shape == (self.n_tasks,) and bool((found >= 0).all())
        if not right or not abs(found.sum() - 1) <= SUM_TOLERANCE:
            raise SettingError(
                f"a teacher's probabilities must be {self.n_tasks} numbers from 0 up that sum to "
                f"1: after {len(self.tasks):,} episodes {self.teacher!r} gives {given!r}"
            )
        return found


def drawn(probabilities: FloatArray, chance: float) -> int:
    """Return the task that a number in [0, 1) draws; none of probability 0."""
    rising = np.cumsum(probabilities)
    place = int(np.searchsorted(rising, chance * rising[-1], side="right"))
    return min(place, int(np.flatnonzero(probabilities)[-1]))


def check_teacher(teacher: Any) -> None:
    """Raise SettingError unless a teacher has the methods of :class:`Teacher`."""
    for name in ("start", "update", "probabilities"):
        if not callable(getattr(teacher, name, None)) or isinstance(teacher, type):
            raise SettingError(
                "a teacher must have the methods start, update and probabilities, as Uniform() "
                f"has: got {teacher!r}"
            )
