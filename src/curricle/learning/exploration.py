"""Exploration: the action that a learner takes on a row of values, compiled.

Numba's disk cache does not notice that a function called from another file has changed: after an
edit here, in `schedules.py`, or in the compiled parts of `planning/` and `tasks/`, run
``make clean``.
"""

from typing import NamedTuple

import numpy as np

from curricle.learning.schedules import ByVisits, Constant, Schedule, at
from curricle.planning.greedy import ACTION, ONLY_ROW, best_of, highest
from curricle.tasks.kernel import (
    HALF,
    STRIDE,
    Overloaded,
    bernoulli,
    inlined,
    integers,
    splitmix64,
    uniform,
)


class EpsilonGreedy(NamedTuple):
    """A uniform action with probability epsilon, else a greedy one."""

    epsilon: Constant | Schedule


class Softmax(NamedTuple):
    """P(a) proportional to exp(beta Q(s, a))."""

    inverse_temperature: Constant | Schedule


class LearnerKernel(NamedTuple):
    """A learner as compiled loops read it.

    Exploration and schedules are types, so that a loop is compiled with the code of its own alone.
    """

    update: int
    learning_rate: Constant | Schedule | ByVisits
    exploration: EpsilonGreedy | Softmax


@inlined
def softmax(table, row, best, inverse_temperature, counter):
    """Return an action drawn with probability proportional to exp(beta value), and the counter.

    `best` is the row's maximum; the counter returned is one draw further than was used. Rejection
    sampling: a uniform proposal is accepted with probability exp(beta (value - best)), which spares
    the exponentials of the whole row. After A rejections the action is drawn by summing the row.
    """
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
    left = uniform(splitmix64(counter)) * total
    counter += STRIDE
    chosen = np.uint64(0)
    for action in range(n_actions):
        weight = np.exp(inverse_temperature * (table[row, action] - best))
        if weight > 0.0:
            chosen = action
            left -= weight
            if left < 0.0:
                break
    return chosen, counter


@inlined
def accepted(exponent, bits):
    """Return whether an event of probability exp(exponent) happens; exponent <= 0.

    1 + x <= exp(x) <= 1 + x + x^2 / 2 decides most cases without the exponential.
    """
    chance = np.float64(bits >> HALF) / 4294967296.0
    if chance < 1.0 + exponent:
        return True
    if chance >= 1.0 + exponent + 0.5 * exponent * exponent:
        return False
    return chance < np.exp(exponent)


def choose(exploration, values, tie, step, counter):
    """Return the action taken on these acting values, (1, A), 64 random bits and two things more.

    `tie` are bits that choose among several greedy actions. Also returned are the stream's counter
    for the next draw and whether `tie` chose. One draw serves the exploration, the action, the next
    tie and (mixed once more) the outcome.
    """


def act(exploration, q, row_max, row_argmax, row, step, counter):
    """Return action, bits and counter, for a table that keeps each row's maximum."""


def expected_value(exploration, q, state, values, step):
    """Return sum_a pi(a) q(state, a) for the policy followed on these acting values, (1, A)."""


choices, acts, expectations = Overloaded(choose), Overloaded(act), Overloaded(expected_value)


@choices.body(EpsilonGreedy)
def _choose_epsilon_greedy(exploration, values, tie, step, counter):
    bits = splitmix64(counter)
    if bernoulli(bits, at(exploration.epsilon, step)):
        return integers(bits, np.uint64(values.shape[1])), bits, counter + STRIDE, False
    return best_of(values, ONLY_ROW, tie)[1] & ACTION, bits, counter + STRIDE, True


@acts.body(EpsilonGreedy)
def _act_epsilon_greedy(exploration, q, row_max, row_argmax, row, step, counter):
    bits = splitmix64(counter)
    if bernoulli(bits, at(exploration.epsilon, step)):
        return integers(bits, np.uint64(q.shape[1])), bits, counter + STRIDE
    return np.uint64(row_argmax[row]) & ACTION, bits, counter + STRIDE


@expectations.body(EpsilonGreedy)
def _expect_epsilon_greedy(exploration, q, state, values, step):
    epsilon, best = at(exploration.epsilon, step), highest(values, ONLY_ROW)
    total, ties, mean = 0.0, 0.0, 0.0
    for action in range(values.shape[1]):
        if values[0, action] == best:
            total += q[0, state, action]
            ties += 1.0
        mean += q[0, state, action] / values.shape[1]
    return (1.0 - epsilon) * total / ties + epsilon * mean


@choices.body(Softmax)
def _choose_softmax(exploration, values, tie, step, counter):
    beta = at(exploration.inverse_temperature, step)
    action, counter = softmax(values, ONLY_ROW, highest(values, ONLY_ROW), beta, counter)
    return action, splitmix64(counter), counter + STRIDE, False


@acts.body(Softmax)
def _act_softmax(exploration, q, row_max, row_argmax, row, step, counter):
    beta = at(exploration.inverse_temperature, step)
    action, counter = softmax(q, row, row_max[row], beta, counter)
    return action, splitmix64(counter), counter + STRIDE


@expectations.body(Softmax)
def _expect_softmax(exploration, q, state, values, step):
    beta, best = at(exploration.inverse_temperature, step), highest(values, ONLY_ROW)
    total, weight = 0.0, 0.0
    for action in range(values.shape[1]):
        w = np.exp(beta * (values[0, action] - best))
        total += w * q[0, state, action]
        weight += w
    return total / weight
