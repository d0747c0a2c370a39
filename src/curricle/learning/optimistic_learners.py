"""Learners that explore by optimism about pairs seldom tried: UCB-Hoeffding Q-learning and OPIQ."""

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.checks import number
from curricle.errors import SettingError
from curricle.learning import general_loop
from curricle.learning.learners import Learner
from curricle.learning.optimism import DecayingOptimism, HoeffdingBonus, hoeffding
from curricle.learning.schedules import Schedule, harmonic, schedule
from curricle.tasks.task import Task, generative_model, has_tables, tables

FAILURE = 0.05
"""Probability with which the bonus of the theorem may be too small."""


@dataclass(frozen=True)
class OptimisticLearner(Learner):
    """What the learners share that explore by a bonus for pairs seldom tried.

    Two tables learn from the same steps. The learner acts on U, which starts at the highest value
    that the task allows and contains the bonus. Q is Q-learning without a bonus; it is evaluated,
    returned and handed on, and it converges to Q* under the usual conditions. Q starts at the
    lowest value, so that its greedy policy keeps to what it has tried.

    A potential by :class:`QInitialisation` or :class:`LookAheadAdvice` is added to the start of
    both tables. Other shapings, guards and sparse tables are refused. Further training goes on from
    Q and the counts of visits, with U = Q plus the bonus of each count.

    Parameters
    ----------
    learning_rate : float or Schedule, optional
        alpha of both tables; here every schedule counts the visits of each pair. By default
        (H + 1) / (H + n) at visit n.
    initial_value : float, optional
        Q before learning; the lowest value by default.
    horizon : float, optional
        Effective horizon H in steps, at least 1. By default min(time limit, 1 / (1 - discount)).
    value_range : (float, float), optional
        Lowest and highest value of a state. By default from the rewards in the task's tables: H of
        the lowest or highest, of those that end an episode at most one (:func:`value_bounds`).

    Raises
    ------
    SettingError
        When a number is out of range; by :func:`learn` when the task does not tell the horizon or
        the range.

    Examples
    --------
    >>> isinstance(UCBQLearning(), OptimisticLearner)
    True
    """

    learning_rate: float | Schedule | None = None  # type: ignore[assignment]
    initial_value: float | None = None  # type: ignore[assignment]
    horizon: float | None = None
    value_range: tuple[float, float] | None = None

    update: ClassVar[int] = general_loop.Q_LEARNING
    tables: ClassVar[int] = 2
    counts: ClassVar[int] = 1
    default_epsilon: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        name = type(self).__name__
        if type(self) is OptimisticLearner:
            raise SettingError("a learner must be of a kind, such as OPIQ: got OptimisticLearner")
        if self.horizon is not None:
            number(f"horizon of {name}", self.horizon, SettingError, 1.0)
        if self.value_range is not None:
            object.__setattr__(self, "value_range", _range(name, self.value_range))
        super().__post_init__()

    def _check_initial_value(self) -> None:
        if self.initial_value is not None:
            super()._check_initial_value()

    @property
    def _rate(self) -> float | Schedule:
        return harmonic() if self.learning_rate is None else self.learning_rate

    def for_task(self, task: Task) -> Self:
        """Return the learner with the settings that it takes from the task filled in.

        Raises
        ------
        SettingError
            When the task does not tell them.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> learner = OPIQ().for_task(GridWorld("S.T", discount=0.9))
        >>> round(learner.horizon), [round(x) for x in learner.value_range]
        (10, [-10, 199])
        """
        name, horizon, bounds = type(self).__name__, self.horizon, self.value_range
        if horizon is None:
            horizon = _horizon(name, task)
        if bounds is None:
            if not has_tables(task):
                raise SettingError(
                    f"{name} needs value_range=(lowest, highest), as a task without tables does "
                    f"not tell its rewards: got {task!r}"
                )
            bounds = value_bounds(task)
        rate: Any = self.learning_rate
        return replace(
            self,
            horizon=horizon,
            value_range=bounds,
            learning_rate=harmonic(half=horizon + 1.0) if rate is None else schedule(rate),
            initial_value=bounds[0] if self.initial_value is None else self.initial_value,
        )

    def bonus(self, visits: IntArray) -> Any:
        """Return the bonus as compiled loops read it; `visits`, (S, A), are counted there."""
        raise NotImplementedError

    def starting_bonus(self, visits: IntArray) -> FloatArray:
        """Return U - Q, (S, A), from which learning goes on after so many visits, (S, A)."""
        raise NotImplementedError

    @property
    def _width(self) -> float:
        """Highest less lowest value."""
        assert self.value_range is not None
        return self.value_range[1] - self.value_range[0]


@dataclass(frozen=True)
class UCBQLearning(OptimisticLearner):
    """Q-learning with upper confidence bounds by Hoeffding's inequality (Jin et al. 2018).

    At the n-th visit of a pair U(s,a) += alpha (r + b + gamma min(highest, max_a' U(s',a')) -
    U(s,a)), where alpha = (H + 1) / (H + n) and b = c W sqrt(H iota / n) with W the width of the
    value range (H rewards of the paper's [0, 1], so that b is its c sqrt(H^3 iota / n)) and
    iota = ln(S A (n + 1) (n + 2) / 0.05), as in Dong, Wang, Chen and Wang 2019, who treat
    discounted tasks without a horizon.

    What is kept of the theorems are the rates, the form of the bonus and the optimistic start. The
    table is stationary, not one for each step of an episode, H is an effective horizon and `c` is
    far smaller than the proofs need, so that none of their bounds of the regret holds here.

    Parameters
    ----------
    c : float
        Factor of the bonus; about 1 in the theorems, where it outlasts 100,000 steps in small
        tasks. With 0 only the optimistic start is left (Even-Dar, Mansour 2001). The default is the
        largest that explores within .01 of the best in the development families of the benchmark.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learn(GridWorld("S..T"), UCBQLearning(), budget=500).greedy_return[0, -1].round(2)
    np.float64(193.05)
    """

    c: float = 3e-5

    def __post_init__(self) -> None:
        number("c of UCBQLearning", self.c, SettingError, 0.0)
        super().__post_init__()

    def bonus(self, visits: IntArray) -> HoeffdingBonus:
        """Return the bonus as compiled loops read it; `visits`, (S, A), are counted there."""
        assert self.value_range is not None
        assert self.horizon is not None
        return HoeffdingBonus(
            self._width,
            self.value_range[1],
            self.c * self._width * math.sqrt(self.horizon),
            math.log(visits.size / FAILURE),
            visits,
        )

    def starting_bonus(self, visits: IntArray) -> FloatArray:
        """Return U - Q, (S, A), from which learning goes on after so many visits, (S, A)."""
        bonus, n = self.bonus(visits), np.maximum(visits, 1.0)
        extra: FloatArray = np.where(visits == 0, bonus.start, hoeffding(bonus, n))
        return extra


@dataclass(frozen=True)
class OPIQ(OptimisticLearner):
    """Q-learning with an optimistic start that fades with visits (Rashid et al. 2020).

    The learner acts on, and bootstraps from, U(s,a) = X(s,a) + c W / (n + 1)^exponent, n the visits
    of the pair and W the width of the value range: X(s,a) += alpha (r + gamma min(highest,
    max_a' U(s',a')) - X(s,a)). X starts at the lowest value, so that U starts at the highest. The
    paper's tabular algorithm also adds the bonus of :class:`UCBQLearning` to rewards; here there is
    none. Its bound of the regret does not hold for a stationary table.

    Parameters
    ----------
    c : float
        The start's optimism as a share of the value range.
    exponent : float
        How fast it fades with visits, the paper's M; above 0. The default is fitted like the `c` of
        :class:`UCBQLearning`.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learn(GridWorld("S..T"), OPIQ(), budget=500).greedy_return[0, -1].round(2)
    np.float64(193.05)
    """

    c: float = 1.0
    exponent: float = 3.0

    def __post_init__(self) -> None:
        number("c of OPIQ", self.c, SettingError, 0.0)
        if number("exponent of OPIQ", self.exponent, SettingError, 0.0) == 0.0:
            raise SettingError("exponent of OPIQ must be above 0, or the optimism stays: got 0")
        super().__post_init__()

    def bonus(self, visits: IntArray) -> DecayingOptimism:
        """Return the bonus as compiled loops read it; `visits`, (S, A), are counted there."""
        assert self.value_range is not None
        start = float(self.c * self._width)
        return DecayingOptimism(start, self.value_range[1], float(self.exponent), visits)

    def starting_bonus(self, visits: IntArray) -> FloatArray:
        """Return U - Q, (S, A), from which learning goes on after so many visits, (S, A)."""
        faded: FloatArray = np.power(visits + 1.0, -self.exponent) * (self.c * self._width)
        return faded


def value_bounds(task: Task) -> tuple[float, float]:
    """Return a lower and an upper bound of the values of a task's states, from its rewards alone.

    An episode has at most H rewards, H = 1 / (1 - discount) or the time limit where the discount is
    1; of those paid on entering a terminal state it has at most one.

    Raises
    ------
    SettingError
        When the task has neither a discount below 1 nor a time limit.
    TaskError
        When it has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> value_bounds(GridWorld("S.T", discount=0.5))
    (-2.0, 199.0)
    """
    mdp = tables(task)
    horizon = 1.0 / (1.0 - mdp.discount) if mdp.discount < 1.0 else _horizon("value_bounds", task)
    rows = np.unique(mdp.outcome_row[~mdp.terminal])
    possible, ends = mdp.probability[rows] > 0, mdp.terminal[mdp.next_state[rows]]
    on, last = mdp.reward[rows][possible & ~ends], mdp.reward[rows][possible & ends]
    going = [horizon * on.min(), horizon * on.max()] if on.size else []
    low = high = 0.0
    if on.size and horizon > 1.0:
        low, high = (horizon - 1.0) * min(on.min(), 0.0), (horizon - 1.0) * max(on.max(), 0.0)
    ending = [low + last.min(), high + last.max()] if last.size else []
    return float(min(going + ending)), float(max(going + ending))


def _horizon(name: str, task: Task) -> float:
    """Return min(time limit, 1 / (1 - discount)), or raise SettingError where both are infinite."""
    model = generative_model(task)
    limit = math.inf if model.time_limit is None else float(model.time_limit)
    ahead = 1.0 / (1.0 - model.discount) if model.discount < 1.0 else math.inf
    if math.isinf(min(limit, ahead)):
        raise SettingError(
            f"{name} needs a horizon, as the task has neither a discount below 1 nor a time limit: "
            f"got {task!r}"
        )
    return max(1.0, min(limit, ahead))


def _range(name: str, given: Any) -> tuple[float, float]:
    """Return a range of values as two floats, or raise SettingError unless low < high."""
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise SettingError(f"value_range of {name} must be (lowest, highest): got {given!r}")
    low, high = (number(f"value_range of {name}", one, SettingError) for one in given)
    if low > high:
        raise SettingError(f"value_range of {name} must have lowest <= highest: got {given!r}")
    return low, high
