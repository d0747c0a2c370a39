"""The learners: an update rule, a learning rate and an exploration, and these compiled."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, IntArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError
from curricle.learning.schedules import HARMONIC, ByVisits, Constant, Schedule, at, harmonic, within
from curricle.planning.greedy import ONLY_ROW, highest
from curricle.tasks.graph import rows_in_use
from curricle.tasks.kernel import (
    HALF,
    STRIDE,
    bernoulli,
    inlined,
    integers,
    overloaded,
    splitmix64,
    uniform,
)
from curricle.tasks.mdp import Task, generative_model, has_tables, tables
from curricle.tasks.models import LARGEST_REWARD, OpenValues, drawn_among_available

Q_LEARNING, SARSA_RULE, EXPECTED_SARSA, DOUBLE_Q_LEARNING = range(4)  # update rules
MOST_MODELLED = 5_000_000  # pairs of which a model is kept


class EpsilonGreedy(NamedTuple):
    """A uniform available action with probability epsilon, else a greedy one."""

    epsilon: Constant | Schedule


class Softmax(NamedTuple):
    """P(a) proportional to exp(beta Q(s, a))."""

    inverse_temperature: Constant | Schedule


class LearnerKernel(NamedTuple):
    """A learner for compiled loops, each of which has the code of its kind of exploration alone."""

    update: int
    learning_rate: Constant | Schedule | ByVisits
    exploration: EpsilonGreedy | Softmax


@dataclass(frozen=True)
class Learner:
    """The settings that all tabular learners share.

    Parameters
    ----------
    learning_rate : float or Schedule
        alpha in [0, 1]; a schedule counts steps, :func:`harmonic` the updates of each pair in each
        table.
    epsilon : float or Schedule, optional
        Epsilon-greedy exploration: a uniform action, of those available, with this probability,
        else a greedy one, ties broken at random. 0.1 by default.
    inverse_temperature : float or Schedule, optional
        Softmax exploration instead: P(a) proportional to exp(beta Q(s, a)).
    initial_value : float
        Q before learning, in every state that is not terminal.

    Raises
    ------
    SettingError
        When a number is out of range, or both kinds of exploration are given.

    Examples
    --------
    >>> isinstance(QLearning(), Learner)
    True
    """

    learning_rate: float | Schedule = 0.1
    epsilon: float | Schedule | None = None
    inverse_temperature: float | Schedule | None = None
    initial_value: float = 0.0

    update: ClassVar[int]
    tables: ClassVar[int] = 1
    default_epsilon: ClassVar[float] = 0.1
    asks_task: ClassVar[bool] = False  # whether a rate and an initial value may be left to the task

    def __post_init__(self) -> None:
        if type(self) is Learner:
            raise SettingError("a learner must be of a subclass, as QLearning(): got Learner")
        if self.epsilon is not None and self.inverse_temperature is not None:
            raise SettingError(
                "exploration is either epsilon-greedy or softmax: got epsilon="
                f"{self.epsilon} and inverse_temperature={self.inverse_temperature}"
            )
        initial: float | None = self.initial_value
        if initial is not None or not self.asks_task:
            number("initial_value", initial, SettingError, -LARGEST_REWARD, LARGEST_REWARD)
        self.kernel()

    @property
    def counts(self) -> int:
        """The number of tables that count updates: `tables` if the rate is harmonic, else 0."""
        rate = self.learning_rate
        return self.tables if isinstance(rate, Schedule) and rate.shape == HARMONIC else 0

    def for_task(self, task: Task) -> Self:
        """Return the learner with the settings that it takes from the task filled in."""
        return self

    def kernel(self, visits: IntArray | None = None) -> LearnerKernel:
        """Return the learner as compiled loops read it.

        `visits`, (rows of all tables, A), count the updates from here on if its rate depends on it.
        """
        unknown = self.asks_task and self.learning_rate is None
        schedule: Any = harmonic() if unknown else self.learning_rate
        schedule = within("learning_rate", schedule, 0.0, 1.0)
        visits = np.zeros((1, 1), np.int64) if visits is None else visits
        rate = ByVisits(schedule, visits) if self.counts else schedule.kernel
        if self.inverse_temperature is not None:
            beta = within("inverse_temperature", self.inverse_temperature, 0.0, 1e100)
            return LearnerKernel(self.update, rate, Softmax(beta.kernel))
        chance = self.default_epsilon if self.epsilon is None else self.epsilon
        epsilon = within("epsilon", chance, 0.0, 1.0)
        return LearnerKernel(self.update, rate, EpsilonGreedy(epsilon.kernel))


@dataclass(frozen=True)
class QLearning(Learner):
    """Q(s,a) += alpha (r + gamma max_b Q(s',b) - Q(s,a)) (paper E1; Watkins 1989).

    Examples
    --------
    >>> QLearning(learning_rate=0.2)
    QLearning(learning_rate=0.2, epsilon=None, inverse_temperature=None, initial_value=0.0)
    """

    update: ClassVar[int] = Q_LEARNING


@dataclass(frozen=True)
class SARSA(Learner):
    """Q(s,a) += alpha (r + gamma Q(s',a') - Q(s,a)), a' taken next (Rummery, Niranjan 1994).

    Examples
    --------
    >>> SARSA(epsilon=0.2).epsilon
    0.2
    """

    update: ClassVar[int] = SARSA_RULE


@dataclass(frozen=True)
class ExpectedSARSA(Learner):
    """Q(s,a) += alpha (r + gamma sum_b pi(b|s') Q(s',b) - Q(s,a)) (van Seijen et al. 2009).

    Examples
    --------
    >>> ExpectedSARSA(inverse_temperature=2.0).inverse_temperature
    2.0
    """

    update: ClassVar[int] = EXPECTED_SARSA


@dataclass(frozen=True)
class DoubleQLearning(Learner):
    """Two tables; a coin chooses which one is updated from the other's value (van Hasselt 2010).

    It acts on, and reports, the mean of both.

    Examples
    --------
    >>> DoubleQLearning().tables
    2
    """

    update: ClassVar[int] = DOUBLE_Q_LEARNING
    tables: ClassVar[int] = 2


@dataclass(frozen=True)
class OptimisticLearner(Learner):
    """A learner that acts on values which start at the highest value of the task."""

    learning_rate: float | Schedule | None = None  # type: ignore[assignment]
    initial_value: float | None = None  # type: ignore[assignment]
    value_range: tuple[float, float] | None = None

    update: ClassVar[int] = Q_LEARNING
    tables: ClassVar[int] = 2
    asks_task: ClassVar[bool] = True

    def __post_init__(self) -> None:
        bounds = value_range_of(type(self).__name__, self.value_range)
        object.__setattr__(self, "value_range", bounds)
        super().__post_init__()

    def for_task(self, task: Task) -> Self:
        """Return the learner with its task's settings; SettingError if the task determines none."""
        bounds = self.value_range
        if bounds is None:
            if not has_tables(task):
                raise SettingError(
                    f"{type(self).__name__} needs value_range=(lowest, highest), as the rewards of "
                    f"a task without tables are unknown: got {task!r}"
                )
            bounds = value_bounds(task)
        initial = bounds[0] if self.initial_value is None else self.initial_value
        return replace(self, initial_value=initial, value_range=bounds)


@dataclass(frozen=True)
class OptimisticQLearning(OptimisticLearner):
    """Q-learning that acts on values which start at the highest value of the task.

    It acts greedily on U(s,a) += alpha (r + gamma min(highest, max_b U(s',b)) - U(s,a)) (Even-Dar,
    Mansour 2001). Q(s,a), :class:`QLearning` from the same steps, is evaluated, returned and
    transferred; it starts at the lowest value, so that its greedy policy avoids untried actions.
    The learning rate is 1 while every pair has had one outcome alone, a next state and a reward;
    then it is that of Jin et al. 2018, without their bonus for rarely tried pairs, for Q at most
    0.3.

    A potential by :class:`QInitialisation` or :class:`LookAheadAdvice` is added to the start of
    both tables. Other shapings, portfolios and sparse tables are refused.

    Parameters
    ----------
    learning_rate : float or Schedule, optional
        alpha of both tables; here every schedule counts the visits of each pair. By default 1, and
        (H + 1) / (H + n) at visit n once outcomes differ, H = min(time limit, 1 / (1 - discount)).
    epsilon, inverse_temperature : optional
        As for other learners, but epsilon is 0 by default.
    initial_value : float, optional
        Q before learning; the lowest value by default.
    value_range : (float, float), optional
        Lowest and highest value of a state. By default from the rewards in the task's tables
        (:func:`value_bounds`); at discount 1 values may lie outside.

    Raises
    ------
    SettingError
        When a number is out of range; by :func:`learn` when the task determines no H or range.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learner = OptimisticQLearning()
    >>> learn(GridWorld("S..T"), learner, budget=500).greedy_return[0, -1].round(2)
    np.float64(193.05)
    """

    counts: ClassVar[int] = 1
    default_epsilon: ClassVar[float] = 0.0


@dataclass(frozen=True)
class RMax(OptimisticLearner):
    """R-max: it plans in a model of what was seen, where untried pairs have the highest value.

    Pairs count as tried from `min_visits` visits on; their model is the mean reward and the
    frequencies of the outcomes so far (Brafman, Tennenholtz 2002). Each step updates some 20 pairs
    of two tables, back from states whose value has changed (van Seijen, Sutton 2013): of that which
    is acted on, and of Q, in which untried pairs have the lowest value. Q is evaluated, returned
    and transferred. With a potential phi, untried pairs that a source knows have phi plus a tenth
    of its range instead of the highest value (Asmuth, Littman, Zinkov 2008). What is refused is as
    for :class:`OptimisticQLearning`, and tasks of more than 5,000,000 pairs.

    Parameters
    ----------
    epsilon, inverse_temperature : optional
        As for other learners. Without exploration an unlucky outcome of a pair may rule for good.
    initial_value, value_range : optional
        As for :class:`OptimisticQLearning`.
    min_visits : int
        Visits from which on a pair's model is used, m of R-max.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learn(GridWorld("S..T"), RMax(), budget=50).greedy_return[0, -1].round(2)
    np.float64(193.05)
    """

    learning_rate: None = field(default=None, init=False, repr=False)
    min_visits: int = 2
    counts: ClassVar[int] = 6  # the model takes as much, with an outcome a pair

    def __post_init__(self) -> None:
        whole_number("min_visits of RMax", self.min_visits, 1, SettingError)
        super().__post_init__()

    def for_task(self, task: Task) -> Self:
        """Return the learner with its task's settings; SettingError if the task is too large."""
        model, name = generative_model(task), "pairs for RMax (OptimisticQLearning takes more)"
        pairs = model.states.size * model.actions.size
        number(name, pairs, SettingError, 1, MOST_MODELLED)
        return super().for_task(task)


LEARNERS_BY_NAME: dict[str, type[Learner]] = {
    kind.__name__: kind
    for kind in (QLearning, SARSA, ExpectedSARSA, DoubleQLearning, OptimisticQLearning, RMax)
}
"""The learners that study files and files of results may name; they make no other class."""


def value_range_of(owner: str, bounds: Any) -> tuple[float, float] | None:
    """Return a stated range of values as two floats, None where none is stated; SettingError."""
    if bounds is None:
        return None
    name = f"value_range of {owner}"
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise SettingError(f"{name} must be (lowest, highest): got {bounds!r}")
    low, high = (number(name, bound, SettingError) for bound in bounds)
    if low > high:
        raise SettingError(f"{name} must have lowest <= highest: got {bounds!r}")
    return low, high


def value_bounds(task: Task) -> tuple[float, float]:
    """Return a lower and an upper bound of a task's discounted returns, from its rewards alone.

    They hold from every state that is not terminal, for every policy. Below discount 1 an episode
    goes on until it terminates, as learners bootstrap at the time limit: values that start within
    the bounds, and learn by a mean of targets, stay within. At discount 1 such returns need not be
    finite, and an episode has at most `time_limit` steps: values that learners bootstrap at the
    limit, and those of :func:`solve`, may then lie outside.

    Raises
    ------
    SettingError
        When the task has neither a discount below 1 nor a time limit.
    TaskError
        When the task has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> value_bounds(GridWorld("S.T", discount=0.5))
    (-2.0, 199.0)
    """
    mdp = tables(task)
    horizon = 1.0 / (1.0 - mdp.discount) if mdp.discount < 1.0 else horizon_of("value_bounds", task)
    rows = rows_in_use(mdp.outcome_row, mdp.terminal, len(mdp.probability))
    possible, ends = mdp.probability[rows] > 0, mdp.terminal[mdp.next_state[rows]]
    on, last = mdp.reward[rows][possible & ~ends], mdp.reward[rows][possible & ends]
    # Below discount 1, H undiscounted rewards bound an endless episode. At discount 1 an episode
    # pays between one and H.
    lengths = np.array([horizon] if mdp.discount < 1.0 else [1.0, horizon])
    going = [*(lengths * on.min()), *(lengths * on.max())] if on.size else []
    low = high = 0.0
    if on.size and horizon > 1.0:
        low, high = (horizon - 1.0) * min(on.min(), 0.0), (horizon - 1.0) * max(on.max(), 0.0)
    ending = [low + last.min(), high + last.max()] if last.size else []
    return float(min(going + ending)), float(max(going + ending))


def horizon_of(name: str, task: Task) -> float:
    """Return min(time limit, 1 / (1 - discount)), or raise SettingError where both are infinite."""
    model = generative_model(task)
    limit = math.inf if model.time_limit is None else float(model.time_limit)
    discounted = 1.0 / (1.0 - model.discount) if model.discount < 1.0 else math.inf
    if math.isinf(min(limit, discounted)):
        raise SettingError(
            f"{name} needs a horizon, as the task has neither a discount below 1 nor a time limit: "
            f"got {task!r}"
        )
    return max(1.0, min(limit, discounted))


# -- the rate of optimistic learners, compiled -----------------------------------------------------

SOBER_RATE = 0.3
"""The highest rate of values that are evaluated, once outcomes differ. Fitted on the development
families of benchmarks/pairs."""


class Visits(NamedTuple):
    """How often pairs were visited, each with a hash of its last outcome in the upper half."""

    words: npt.NDArray[np.unsignedinteger]  # (n, A)
    half: np.uint64  # bits
    differ: BoolArray  # (1,) whether a pair has had two outcomes
    horizon: float  # H; 0 where a stated rate holds

    @classmethod
    def none(cls, words: npt.NDArray[Any], horizon: float) -> Self:
        """Return the visits before the first step, in a table of zeros."""
        return cls(words, np.uint64(4 * words.itemsize), np.zeros(1, np.bool_), float(horizon))


@inlined
def optimistic_rate(visits, row, action, next_state, reward):
    """Count a visit; return 1 before outcomes differ, then (H + 1) / (H + n) at visit n."""
    most = (np.uint64(1) << visits.half) - np.uint64(1)
    word = np.uint64(visits.words[row, action])
    n, last_outcome = word & most, word >> visits.half
    if not visits.differ[0]:
        outcome = splitmix64(next_state ^ splitmix64(np.float64(reward).view(np.uint64))) & most
        if n > np.uint64(0) and last_outcome != outcome:
            visits.differ[0] = True
        last_outcome = outcome
    n += np.uint64(n < most)
    visits.words[row, action] = (last_outcome << visits.half) | n
    if not visits.differ[0]:
        return 1.0
    return (visits.horizon + 1.0) / (visits.horizon + np.float64(n))


@inlined
def sober_rate(visits, rate):
    """Return the rate of the values that are evaluated beside the optimistic ones."""
    return rate if rate < SOBER_RATE or not visits.differ[0] else SOBER_RATE


# -- the action that a learner takes on a row of values, compiled ----------------------------------


@inlined
def softmax(table, row, best, inverse_temperature, counter):
    """Return an action drawn with probability proportional to exp(beta value), and the counter.

    `best` is the row's maximum; the counter returned is one draw further than was used.
    """
    # Rejection sampling: a uniform proposal is accepted with probability exp(beta (value - best)),
    # which spares the exponentials of the whole row. After A rejections the row is summed.
    n_actions = np.uint64(table.shape[1])
    for _ in range(n_actions):
        bits = splitmix64(counter)
        counter += STRIDE
        action = integers(bits, n_actions)
        if accepted(inverse_temperature * (table[row, action] - best), bits):
            return action, counter
    total = 0.0
    for action in range(n_actions):
        total += np.exp(inverse_temperature * (table[row, action] - best))
    remaining = uniform(splitmix64(counter)) * total
    counter += STRIDE
    chosen = np.uint64(0)
    for action in range(n_actions):
        weight = np.exp(inverse_temperature * (table[row, action] - best))
        if weight > 0.0:
            chosen = action
            remaining -= weight
            if remaining < 0.0:
                break
    return chosen, counter


@inlined
def accepted(exponent, bits):
    """Return whether an event of probability exp(exponent) happens; exponent <= 0."""
    # 1 + x <= exp(x) <= 1 + x + x^2 / 2 decides most cases without the exponential.
    chance = np.float64(bits >> HALF) / 4294967296.0
    if chance < 1.0 + exponent:
        return True
    if chance >= 1.0 + exponent + 0.5 * exponent * exponent:
        return False
    return chance < np.exp(exponent)


@overloaded()
def explore(exploration, values, row, best, step, counter):
    """Return an action on a row of values, 64 bits, the next counter, whether to act greedily.

    `best` is the row's maximum. A draw serves the exploration, the action, the next tie and (mixed
    once more) the outcome.
    """


@overloaded()
def expected_value(exploration, q, state, values, step):
    """Return sum_a pi(a) q(state, a) for the policy followed on these acting values, (1, A)."""


@explore.body(EpsilonGreedy)
def _explore_epsilon_greedy(exploration, values, row, best, step, counter):
    bits = splitmix64(counter)
    if bernoulli(bits, at(exploration.epsilon, step)):
        n_actions = np.uint64(values.shape[1])
        action = integers(bits, n_actions)
        action = drawn_among_available(OpenValues(values), n_actions, row, action, bits)
        return action, bits, counter + STRIDE, False
    return np.uint64(0), bits, counter + STRIDE, True


@expected_value.body(EpsilonGreedy)
def _expect_epsilon_greedy(exploration, q, state, values, step):
    epsilon, best = at(exploration.epsilon, step), highest(values, ONLY_ROW)
    total, ties, mean, n_actions = 0.0, 0.0, 0.0, 0
    for action in range(values.shape[1]):
        n_actions += values[0, action] != -np.inf
    for action in range(values.shape[1]):
        if values[0, action] == best:
            total += q[0, state, action]
            ties += 1.0
        if values[0, action] != -np.inf:
            mean += q[0, state, action] / n_actions
    return (1.0 - epsilon) * total / ties + epsilon * mean


@inlined
def positive(beta):
    """Return beta, or the smallest number for 0, by which -inf of an unavailable action stays."""
    return beta if beta > 0.0 else 5e-324


@explore.body(Softmax)
def _explore_softmax(exploration, values, row, best, step, counter):
    beta = positive(at(exploration.inverse_temperature, step))
    action, counter = softmax(values, row, best, beta, counter)
    return action, splitmix64(counter), counter + STRIDE, False


@expected_value.body(Softmax)
def _expect_softmax(exploration, q, state, values, step):
    beta = positive(at(exploration.inverse_temperature, step))
    best = highest(values, ONLY_ROW)
    total, weight = 0.0, 0.0
    for action in range(values.shape[1]):
        w = np.exp(beta * (values[0, action] - best))
        if w > 0.0:  # else q may be -inf
            total += w * q[0, state, action]
            weight += w
    return total / weight
