"""The learners: an update rule, a learning rate and an exploration, for :func:`learn`."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from curricle.arrays import IntArray
from curricle.checks import number
from curricle.errors import SettingError
from curricle.learning import general_loop
from curricle.learning.exploration import EpsilonGreedy, LearnerKernel, Softmax
from curricle.learning.schedules import HARMONIC, ByVisits, Schedule, within
from curricle.tasks.task import Task


@dataclass(frozen=True)
class Learner:
    """What the tabular learners share.

    Parameters
    ----------
    learning_rate : float or Schedule
        alpha in [0, 1]; a schedule counts steps, :func:`harmonic` the updates of each pair (of each
        table, where there are two).
    epsilon : float or Schedule, optional
        Epsilon-greedy exploration: a uniform action with this probability, else a greedy one,
        ties broken at random. The default, 0.1, holds unless `inverse_temperature` is given.
    inverse_temperature : float or Schedule, optional
        Softmax exploration instead: P(a) proportional to exp(beta Q(s, a)).
    initial_value : float
        Q before learning, in every state that is not terminal.

    Raises
    ------
    SettingError
        When a number is out of range, or both kinds of exploration are asked for.

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

    def __post_init__(self) -> None:
        if type(self) is Learner:
            raise SettingError("a learner must be of a kind, such as QLearning: got Learner itself")
        if self.epsilon is not None and self.inverse_temperature is not None:
            raise SettingError(
                "exploration is either epsilon-greedy or softmax: got epsilon="
                f"{self.epsilon} and inverse_temperature={self.inverse_temperature}"
            )
        self._check_initial_value()
        self.kernel()

    def _check_initial_value(self) -> None:
        number("initial_value", self.initial_value, SettingError)

    @property
    def counts(self) -> int:
        """The tables of counted updates: one for each table where the rate is harmonic, else 0."""
        rate = self.learning_rate
        return self.tables if isinstance(rate, Schedule) and rate.shape == HARMONIC else 0

    def for_task(self, task: Task) -> Self:
        """Return the learner with the settings that it takes from the task filled in."""
        return self

    @property
    def _rate(self) -> float | Schedule:
        return self.learning_rate

    def kernel(self, visits: IntArray | None = None) -> LearnerKernel:
        """Return the learner as compiled loops read it.

        `visits`, (rows of all tables, A), count the updates from here on if its rate depends on it.
        """
        given: Any = within("learning_rate", self._rate, 0.0, 1.0)
        visits = np.zeros((1, 1), np.int64) if visits is None else visits
        rate = ByVisits(given, visits) if self.counts else given.kernel
        if self.inverse_temperature is not None:
            beta = within("inverse_temperature", self.inverse_temperature, 0.0, 1e100)
            return LearnerKernel(self.update, rate, Softmax(beta.kernel))
        given = self.default_epsilon if self.epsilon is None else self.epsilon
        epsilon = within("epsilon", given, 0.0, 1.0)
        return LearnerKernel(self.update, rate, EpsilonGreedy(epsilon.kernel))


@dataclass(frozen=True)
class QLearning(Learner):
    """Q(s,a) += alpha (r + gamma max_b Q(s',b) - Q(s,a)) (paper E1; Watkins 1989).

    Examples
    --------
    >>> QLearning(learning_rate=0.2)
    QLearning(learning_rate=0.2, epsilon=None, inverse_temperature=None, initial_value=0.0)
    """

    update: ClassVar[int] = general_loop.Q_LEARNING


@dataclass(frozen=True)
class SARSA(Learner):
    """Q(s,a) += alpha (r + gamma Q(s',a') - Q(s,a)), a' the action taken next.

    Rummery, Niranjan 1994.

    Examples
    --------
    >>> SARSA(epsilon=0.2).epsilon
    0.2
    """

    update: ClassVar[int] = general_loop.SARSA


@dataclass(frozen=True)
class ExpectedSARSA(Learner):
    """Q(s,a) += alpha (r + gamma sum_b pi(b|s') Q(s',b) - Q(s,a)) (van Seijen et al. 2009).

    Examples
    --------
    >>> ExpectedSARSA(inverse_temperature=2.0).inverse_temperature
    2.0
    """

    update: ClassVar[int] = general_loop.EXPECTED_SARSA


@dataclass(frozen=True)
class DoubleQLearning(Learner):
    """Two tables; a coin chooses which one is updated from the other's value (van Hasselt 2010).

    It acts on, and reports, the mean of both. A harmonic learning rate counts the updates of each
    table by themselves, so that each is a sample mean.

    Examples
    --------
    >>> DoubleQLearning().tables
    2
    """

    update: ClassVar[int] = general_loop.DOUBLE_Q_LEARNING
    tables: ClassVar[int] = 2
