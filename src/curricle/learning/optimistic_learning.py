"""Q-learning that explores by an optimistic start: :class:`OptimisticQLearning` and its loop.

Two tables learn from the same steps. The *optimistic* one, U, starts at the highest value and is
acted on. The other, Q, starts at the lowest; it is evaluated, kept in snapshots and transferred.
Greedy actions of U alone lead into what was not tried yet. Q-learning is off-policy, so Q is none
the worse for who acts.

The loop is not the fast one: that would need a second table and one more type to be compiled for.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from curricle.checks import number
from curricle.errors import SettingError
from curricle.learning import general_loop
from curricle.learning.exploration import act
from curricle.learning.learners import Learner
from curricle.learning.q_learning import set_value
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import Schedule, harmonic, rate_of
from curricle.learning.tables import find_row_maxima
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.kernel import STRIDE, of_width, splitmix64
from curricle.tasks.mdp import Task, generative_model, has_tables, tables
from curricle.tasks.models import first_state, has_failed, transition, truncated


@dataclass(frozen=True)
class OptimisticQLearning(Learner):
    """Q-learning that acts on values started at the highest that the task allows.

    U(s,a) += alpha (r + gamma min(highest, max_b U(s',b)) - U(s,a)) is acted on, greedily
    (Even-Dar, Mansour 2001). Q(s,a), :class:`QLearning` from the same steps, is evaluated, returned
    and transferred; it starts at the lowest value, so that its greedy policy keeps to what was
    tried.
    The learning rate is that of Jin et al. 2018, without their bonus for pairs seldom tried.

    A potential by :class:`QInitialisation` or :class:`LookAheadAdvice` is added to the start of
    both tables. Other shapings, guards and sparse tables are refused. Further training goes on from
    Q and the counts of visits: U is Q where a pair was visited.

    Parameters
    ----------
    learning_rate : float or Schedule, optional
        alpha of both tables; here every schedule counts the visits of each pair. By default
        (H + 1) / (H + n) at visit n, H = min(time limit, 1 / (1 - discount)).
    epsilon, inverse_temperature : optional
        As for other learners, but epsilon is 0 by default.
    initial_value : float, optional
        Q before learning; the lowest value by default.
    value_range : (float, float), optional
        Lowest and highest value of a state. By default from the rewards in the task's tables
        (:func:`value_bounds`).

    Raises
    ------
    SettingError
        When a number is out of range; by :func:`learn` when the task does not tell H or the range.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learner = OptimisticQLearning()
    >>> learn(GridWorld("S..T"), learner, budget=500).greedy_return[0, -1].round(2)
    np.float64(193.05)
    """

    learning_rate: float | Schedule | None = None  # type: ignore[assignment]
    initial_value: float | None = None  # type: ignore[assignment]
    value_range: tuple[float, float] | None = None

    update: ClassVar[int] = general_loop.Q_LEARNING
    tables: ClassVar[int] = 2
    counts: ClassVar[int] = 1
    default_epsilon: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        if self.value_range is not None:
            object.__setattr__(self, "value_range", _checked_range(self.value_range))
        super().__post_init__()

    def _check_initial_value(self) -> None:
        if self.initial_value is not None:
            super()._check_initial_value()

    @property
    def _rate(self) -> float | Schedule:
        return harmonic() if self.learning_rate is None else self.learning_rate

    def for_task(self, task: Task) -> Self:
        """Return the learner with its task's settings, or SettingError if the task tells none."""
        rate: Any = self.learning_rate
        if rate is None:
            rate = harmonic(half=_horizon("OptimisticQLearning without learning_rate", task) + 1.0)
        bounds = self.value_range
        if bounds is None:
            if not has_tables(task):
                raise SettingError(
                    "OptimisticQLearning needs value_range=(lowest, highest), as a task without "
                    f"tables does not tell its rewards: got {task!r}"
                )
            bounds = value_bounds(task)
        initial = bounds[0] if self.initial_value is None else self.initial_value
        return replace(self, learning_rate=rate, initial_value=initial, value_range=bounds)


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


def _checked_range(bounds: Any) -> tuple[float, float]:
    """Return a range of values as two floats, or raise SettingError unless low <= high."""
    name = "value_range of OptimisticQLearning"
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise SettingError(f"{name} must be (lowest, highest): got {bounds!r}")
    low, high = (number(name, bound, SettingError) for bound in bounds)
    if low > high:
        raise SettingError(f"{name} must have lowest <= highest: got {bounds!r}")
    return low, high


# -- the loop ------------------------------------------------------------------------------------


def train_optimistically(
    model, horizon, rule, highest, table, optimistic, evaluation, stream, used, budget, eval_freq,
    record,
):  # fmt: skip
    """Learn in place on `table` and `optimistic`, acting on the latter; fill `record`.

    Both are dense. The optimistic values are cut off at `highest` where they are bootstrapped from:
    rewards at discount 1 could raise them above it. Return the steps and episodes done. The other
    arguments are those of ``q_learning.train_q_learning``.
    """
    q, best, greedy = of_width(table.q, table.width), table.row_max, table.row_argmax
    u, most, chosen = (
        of_width(optimistic.q, optimistic.width),
        optimistic.row_max,
        optimistic.row_argmax,
    )
    real = q.dtype.type
    discount, limit = horizon
    find_row_maxima(table)
    find_row_maxima(optimistic)
    step, episodes, ended, ended_return = used
    value = greedy_return(evaluation, model, table) if step > 0 else np.nan
    checkpoint = general_loop.warm_up_checkpoints(record, step, eval_freq, value, q, q)
    fresh, state, length, episode_return = True, np.uint64(0), 0, 0.0
    counter = stream[0] + STRIDE
    while True:
        if step == checkpoint * eval_freq:
            so_far = step, episodes, ended, ended_return, greedy_return(evaluation, model, table)
            if general_loop.write_checkpoint(record, checkpoint, so_far, q, q, budget.stopping):
                return step, episodes
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
        if is_spent(budget, record, step, episodes) or has_failed(model):
            return step, episodes
        if fresh:
            state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
            length, episode_return = 0, 0.0
        action, bits, counter = act(rule.exploration, u, most, chosen, state, step, counter)
        next_state, reward, terminated = transition(model, state, action, splitmix64(bits))
        rate = rate_of(rule.learning_rate, state, action, step)  # counts the visit
        target, hoped = reward, reward
        if not terminated:
            target += discount * np.float64(best[next_state])
            hoped += discount * min(highest, np.float64(most[next_state]))
        old, hope = np.float64(q[state, action]), np.float64(u[state, action])
        set_value(q, best, greedy, state, action, real(old + rate * (target - old)), bits)
        set_value(u, most, chosen, state, action, real(hope + rate * (hoped - hope)), bits)
        step, length, episode_return = step + 1, length + 1, episode_return + reward
        # Cutting off at the time limit is not termination: the targets were bootstrapped.
        ended_here = noted_end(record, next_state, terminated)
        state, fresh = next_state, ended_here or length >= limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
