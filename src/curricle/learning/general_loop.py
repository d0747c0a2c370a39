"""The general learning loop: all update rules and shapings.

Q-learning on unshaped rewards has a faster loop (q_learning.py), and so has a portfolio.
"""

# This loop is compiled once for all rules and shapings: with bodies chosen by type it would be
# compiled anew for each combination, and compiling takes far longer than the few comparisons that a
# step of the loop makes. The code for checkpoints is compiled by itself (`called`).

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, FloatTable, IntArray
from curricle.learning.learners import (
    DOUBLE_Q_LEARNING,
    EXPECTED_SARSA,
    Q_LEARNING,
    SARSA_RULE,
    expected_value,
    explore,
)
from curricle.learning.record import Checkpoint, Record, noted_end
from curricle.learning.schedules import Schedule, at, rate_of
from curricle.learning.stopping import StoppingKernel
from curricle.learning.storage import tie_bits
from curricle.planning.greedy import ACTION, ONLY_ROW, acting_row, best_of, greedy_action, highest
from curricle.planning.policy_evaluation import SLICE, EvaluationKernel, greedy_return
from curricle.tasks.kernel import LINE, STRIDE, called, first_above, inlined, splitmix64
from curricle.tasks.models import first_state, has_failed, transition, truncated

# What is added to the reward.
PLAIN, STATE, BONUS = range(3)

FIRST, SECOND = np.uint64(0), np.uint64(1)  # tables of a learner


class ShapingKernel(NamedTuple):
    """The additions of a :class:`Shaping` while learning, as compiled loops read them."""

    kind: int
    weight: Schedule
    steps: IntArray  # (M,) the step from which each state potential holds
    state_values: FloatArray  # (M, S) Phi(s)
    pair_values: FloatArray  # (S, A) phi(s, a)


class GeneralTables(NamedTuple):
    """The tables of a learner of any rule, and the shaping of its rewards."""

    q: FloatTable  # (m, S, A)
    shaping: ShapingKernel
    values: FloatArray  # (1, A) work space: the values that the learner acts on
    ties: npt.NDArray[np.uint64]  # (S,) bits that break the ties of each state, or (0,)

    @classmethod
    def starting(cls, q: FloatTable, update: int, shaping: ShapingKernel) -> "GeneralTables":
        """Return the tables before the first step, with their first values."""
        n_actions = q.shape[2]
        room = np.zeros(n_actions + LINE // 8)
        # It is written value by value and then read as a vector, for which the processor waits less
        # where the vector begins in the middle of a cache line: by up to 17 ns a step.
        start = (LINE // 2 - room.ctypes.data) % LINE // 8
        return cls(
            q=q,
            shaping=shaping,
            values=room[start : start + n_actions].reshape(1, n_actions),
            ties=np.empty(q.shape[1] if update == Q_LEARNING else 0, np.uint64),
        )


class Course(NamedTuple):
    """The settings and records of a run that the loops need besides a model and learners."""

    discount: float
    limit: int  # steps of an episode
    turn: int  # steps after which a portfolio's turn ends, if no episode has ended before
    stream: np.uint64  # where the run's random stream starts
    steps: int  # at which learning ends, or
    episodes: int  # at which it ends, or
    stopping: StoppingKernel  # which may end it before
    eval_freq: int  # steps between checkpoints; checkpoint 0 is before the first step
    evaluation: EvaluationKernel
    record: Record
    noting: int  # the address of :func:`note`


class Choice(NamedTuple):
    """What a target depends on beside the values."""

    table: np.uint64  # that is updated
    coin: np.uint64  # the bits that chose it
    step: int
    next_action: np.uint64  # of SARSA


@inlined
def is_spent(course, step, episodes):
    """Return whether a run has used its steps or its episodes, or was interrupted a while ago."""
    if step >= course.steps or episodes >= course.episodes:
        return True
    return step % SLICE == 0 and course.record.halted[0]


class Acting(NamedTuple):
    """The values a policy acts on: Q, or the mean of two tables."""

    q: FloatTable  # (1 or 2, S, A)
    values: FloatArray  # (1, A) work space


@acting_row.body(Acting)
def _write_acting_row(view, state, out):
    for action in range(np.uint64(out.shape[1])):
        value = np.float64(view.q[FIRST, state, action])
        if view.q.shape[0] == 2:
            value = 0.5 * (value + view.q[SECOND, state, action])
        out[ONLY_ROW, action] = value


write_acting_row = inlined(_write_acting_row)


@greedy_action.body(Acting)
def _acting_greedy(view, state, bits):
    write_acting_row(view, state, view.values)
    return best_of(view.values, ONLY_ROW, bits)[1]


# -- the loop ------------------------------------------------------------------------------------


def train(model, rule, tables, course):
    """Learn in place on ``tables.q``, fill the record.

    Return the steps and episodes done.
    """
    return learn_all(model, rule, tables, course)


@inlined  # so that no reference to an array is counted, which takes time to run and to compile
def learn_all(model, rule, tables, course):
    """Learn as :func:`train` says."""
    # Unsigned indices of tables and actions need no test for being negative.
    q, last = tables.q, np.uint64(tables.q.shape[0] - 1)
    discount, record, real = course.discount, course.record, tables.q.dtype.type
    shaping, ties, acting = tables.shaping, tables.ties, Acting(tables.q, tables.values)
    looks_ahead = rule.update in (SARSA_RULE, EXPECTED_SARSA)
    key = splitmix64(course.stream)
    for place in range(np.uint64(ties.shape[0])):
        ties[place] = tie_bits(key, place)
    step = episodes = ended = checkpoint = np.int64(0)  # a literal would be a type of its own
    ended_return, counter = 0.0, course.stream + STRIDE
    fresh, state, length, episode_return = True, np.uint64(0), 0, 0.0
    action, bits, drawn = np.uint64(0), np.uint64(0), False
    next_action, next_bits = np.uint64(0), np.uint64(0)  # what SARSA has chosen
    weight, carried = at(shaping.weight, step), 0.0  # of the potential, and from step to step
    while True:
        if step == checkpoint * course.eval_freq:
            value = greedy_return(course.evaluation, model, acting)
            curves = ended, ended_return, value, np.nan, np.nan
            reached = Checkpoint(checkpoint, step, episodes, *curves)
            if called(course.noting, (record, course.stopping, reached, q[FIRST], q[last])) > 0.0:
                return step, episodes
            checkpoint += 1
            ended, ended_return = 0, 0.0
        if is_spent(course, step, episodes) or has_failed(model):
            return step, episodes
        if fresh:
            state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
            length, episode_return = 0, 0.0
            carried = 0.0
            if shaping.kind == STATE:
                carried = weight * state_potential(shaping, state, step)
        if fresh or rule.update != SARSA_RULE:
            write_acting_row(acting, state, tables.values)
            action, bits, counter, drawn = decide(tables, rule, state, step, counter)
        else:
            action, bits = next_action, next_bits
        next_state, reward, terminated = transition(model, state, action, splitmix64(bits))
        step, length, episode_return = step + 1, length + 1, episode_return + reward
        weight = at(shaping.weight, step)
        table, coin = FIRST, np.uint64(0)
        if rule.update == DOUBLE_Q_LEARNING:
            coin, counter = splitmix64(counter), counter + STRIDE
            table = coin & np.uint64(1)
        row = table * np.uint64(q.shape[1]) + state  # each table counts its own updates
        rate = rate_of(rule.learning_rate, row, action, step - 1)
        next_potential, extra = 0.0, 0.0
        if shaping.kind == STATE and not terminated:
            next_potential = weight * state_potential(shaping, next_state, step)
        if shaping.kind != PLAIN:
            extra, carried = shaping_reward(
                shaping, discount, state, action, carried, next_potential
            )
        target = reward + extra
        # Cutting off at the time limit is not termination: it bootstraps like any other step.
        if not terminated:
            if looks_ahead:
                write_acting_row(acting, next_state, tables.values)
            if rule.update == SARSA_RULE:
                drawn_next = decide(tables, rule, next_state, step, counter)
                next_action, next_bits, counter, _ = drawn_next
            choice = Choice(table, coin, step, next_action)
            target = td_target(rule, tables, discount, target, next_state, choice)
        old = q[table, state, action]
        new = old + real(rate) * (real(target) - old)  # in the tables' precision
        q[table, state, action] = new
        if ties.shape[0] > 0:
            if not drawn:  # a drawn action was among the highest
                drawn = draws_again(tables.values, ties[state], np.float64(new), action)
            if drawn:
                ties[state] = bits
        ends = noted_end(record, next_state, terminated)
        state, fresh = next_state, ends or length >= course.limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return


# -- what an action is drawn by ------------------------------------------------------------------
#
# Q-learning has a fast loop too and draws among ties as there, a visit ahead; others at once.


@inlined
def decide(tables, rule, state, step, counter):
    """Return the decision on ``tables.values`` in a state, as :func:`explore` does."""
    values, best = tables.values, highest(tables.values, ONLY_ROW)
    action, bits, after, exploits = explore(rule.exploration, values, ONLY_ROW, best, step, counter)
    if exploits:
        tie = tables.ties[state] if tables.ties.shape[0] > 0 else splitmix64(counter)
        action = best_of(values, ONLY_ROW, tie)[1] & ACTION
    return action, bits, after, exploits


@inlined
def draws_again(values, tie, new, action):
    """Return whether the fast loop would draw again among a state's ties after an update."""
    # That is where the action's value, which was in `values` and is `new`, changed and is or was
    # the highest, or where it did not change and `tie` had drawn the action.
    old = values[0, action]
    if new == old:
        return best_of(values, ONLY_ROW, tie)[1] & ACTION == action
    return (old if old > new else new) >= highest(values, ONLY_ROW)


# -- update rules: the target of Q(s, a) where the episode goes on from s' -----------------------


@inlined
def q_learning_target(q, reward, discount, next_state):
    """Return r + gamma max_b Q(s', b), as precise as in the fast loop (E1; Watkins 1989)."""
    real = q.dtype.type
    return np.float64(real(reward) + real(discount) * highest(q[FIRST], next_state))


@inlined
def sarsa_target(q, reward, discount, next_state, next_action):
    """Return r + gamma Q(s', a'), a' taken next (Rummery, Niranjan 1994)."""
    return reward + discount * np.float64(q[FIRST, next_state, next_action])


@inlined
def expected_sarsa_target(q, reward, discount, next_state, exploration, values, step):
    """Return r + gamma sum_b pi(b|s') Q(s', b) (van Seijen et al. 2009)."""
    return reward + discount * expected_value(exploration, q, next_state, values, step)


@inlined
def double_q_learning_target(q, reward, discount, next_state, table, coin):
    """Return r + gamma Q_other(s', argmax_b Q(s', b)), of two tables (van Hasselt 2010)."""
    best = best_of(q[table], next_state, coin)[1] & ACTION
    return reward + discount * np.float64(q[SECOND - table, next_state, best])


@inlined
def td_target(rule, tables, discount, reward, next_state, choice):
    """Return the target of the learner's update rule.

    ``tables.values`` are those that a policy acts on in s'.
    """
    q = tables.q
    if rule.update == SARSA_RULE:
        return sarsa_target(q, reward, discount, next_state, choice.next_action)
    if rule.update == EXPECTED_SARSA:
        return expected_sarsa_target(
            q, reward, discount, next_state, rule.exploration, tables.values, choice.step
        )
    if rule.update == DOUBLE_Q_LEARNING:
        return double_q_learning_target(q, reward, discount, next_state, choice.table, choice.coin)
    return q_learning_target(q, reward, discount, next_state)


# -- shaping rewards: what is added to a reward, and what is carried to the next step ------------


@inlined
def state_potential(shaping, state, step):
    """Return Phi(s, t), of the potential that holds at `step`."""
    return shaping.state_values[first_above(shaping.steps, step) - np.uint64(1), state]


@inlined
def shaping_reward(shaping, discount, state, action, carried, next_potential):
    """Return the number that shaping adds to a step's reward, and its carry to the next step.

    `next_potential` is w(t') Phi(s', t'), 0 where an episode has ended (Grzes 2017).
    """
    if shaping.kind == STATE:  # F = gamma Phi(s', t') - Phi(s, t) (Ng, Harada, Russell 1999)
        return discount * next_potential - carried, next_potential
    return shaping.pair_values[state, action], 0.0  # a bonus
