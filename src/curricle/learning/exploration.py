"""Compiled choices among a row of values: the best, a greedy one, the one a learner takes.

Numba's disk cache does not notice that a function called from another file has changed: after an
edit here, in `schedules.py`, or in the compiled parts of `tasks/`, run ``make clean``.
"""

from typing import NamedTuple

import numpy as np

from curricle.learning.schedules import ByVisits, Constant, Schedule, at
from curricle.tasks.draws import HALF, STRIDE, bernoulli, inlined, integers, splitmix64, uniform
from curricle.tasks.overloads import Overloaded
from curricle.tasks.simd import LANES as PIECE, highest_of_piece, nth_one, ones, ties_in_piece

LANES, WORD = np.uint64(PIECE), np.uint64(64)
TIED = np.uint64(1 << 15)
"""Flag of an action that was drawn among several of the same value."""
ACTION = np.uint64((1 << 15) - 1)
"""The bits of the action itself."""
MULTIPLIER = np.uint64(0xD1342543DE82EF95)
"""Makes bits that have named an action ones that can break a tie."""


class EpsilonGreedy(NamedTuple):
    """A uniform action with probability epsilon, else a greedy one."""

    epsilon: Constant | Schedule


class Softmax(NamedTuple):
    """P(a) proportional to exp(beta Q(s, a))."""

    inverse_temperature: Constant | Schedule


class Rule(NamedTuple):
    """A learner; exploration and schedules are types, so that a loop only has code for its own."""

    update: int
    learning_rate: Constant | Schedule | ByVisits
    exploration: EpsilonGreedy | Softmax


@inlined
def highest(table, row):
    """Return the highest value of a row."""
    best = highest_of_piece(table, row, np.uint64(0))
    for first in range(LANES, np.uint64(table.shape[1]), LANES):
        best = max(best, highest_of_piece(table, row, first))
    return best


@inlined
def ties_in_word(table, row, first, value):
    """Return which of up to 64 values of a row equal `value`, from entry `first` on: a bit each."""
    tied, end = np.uint64(0), np.uint64(table.shape[1])
    for start in range(first, min(first + WORD, end), LANES):
        tied |= ties_in_piece(table, row, start, value) << (start - first)
    return tied


@inlined
def best_of(table, row, bits):
    """Return the highest value of a row and an action that has it, flagged where several do.

    Of several each is equally likely. Which it is decides no branch: the processor would guess
    wrong, and wait for the row to come from memory to know.
    """
    best, first = highest(table, row), np.uint64(0)
    tied = ties_in_word(table, row, first, best)
    ties = ones(tied)
    for start in range(WORD, np.uint64(table.shape[1]), WORD):
        ties += ones(ties_in_word(table, row, start, best))
    if ties == np.uint64(0):  # only where learning has diverged, to values that are no numbers
        return best, np.uint64(0)
    left = integers(bits * MULTIPLIER, ties)
    while left >= ones(tied):  # further on, in a row of more than 64
        left, first = left - ones(tied), first + WORD
        tied = ties_in_word(table, row, first, best)
    flag = TIED if ties > np.uint64(1) else np.uint64(0)
    return best, (first + nth_one(tied, left)) | flag


@inlined
def softmax(table, row, best, inverse_temperature, counter):
    """Return an action drawn with probability proportional to exp(beta value); `best` is the max.

    Also the stream's counter one draw further than was used. By rejection: a uniform proposal is
    accepted with probability exp(beta (value - best)), which spares the exponentials of the whole
    row. A row that rejects A times is drawn in full.
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


def choose(exploration, values, step, counter):
    """Return the action taken on these acting values, (1, A), and 64 random bits for its outcome.

    Also the stream's counter for the next draw. One draw serves the exploration, the action or
    tie, and (scrambled once more) the outcome.
    """


def act(exploration, q, best, greedy, row, step, counter):
    """Do what :func:`choose` does on a row whose best value and greedy action are at hand."""


def expected_value(exploration, q, state, values, step):
    """Return sum_a pi(a) q(state, a) for the policy followed on these acting values, (1, A)."""


choices, acts, expectations = Overloaded(choose), Overloaded(act), Overloaded(expected_value)


@choices.body(EpsilonGreedy)
def _choose_greedy(exploration, values, step, counter):
    bits = splitmix64(counter)
    if bernoulli(bits, at(exploration.epsilon, step)):
        return integers(bits, values.shape[1]), splitmix64(bits), counter + STRIDE
    return best_of(values, 0, bits)[1] & ACTION, splitmix64(bits), counter + STRIDE


@acts.body(EpsilonGreedy)
def _act_greedy(exploration, q, best, greedy, row, step, counter):
    bits = splitmix64(counter)
    if bernoulli(bits, at(exploration.epsilon, step)):
        return integers(bits, q.shape[1]), bits, counter + STRIDE
    return np.uint64(greedy[row]) & ACTION, bits, counter + STRIDE


@expectations.body(EpsilonGreedy)
def _expect_greedy(exploration, q, state, values, step):
    epsilon, best = at(exploration.epsilon, step), highest(values, 0)
    total, ties, mean = 0.0, 0.0, 0.0
    for action in range(values.shape[1]):
        if values[0, action] == best:
            total += q[0, state, action]
            ties += 1.0
        mean += q[0, state, action] / values.shape[1]
    return (1.0 - epsilon) * total / ties + epsilon * mean


@choices.body(Softmax)
def _choose_softly(exploration, values, step, counter):
    beta = at(exploration.inverse_temperature, step)
    action, counter = softmax(values, 0, highest(values, 0), beta, counter)
    return action, splitmix64(splitmix64(counter)), counter + STRIDE


@acts.body(Softmax)
def _act_softly(exploration, q, best, greedy, row, step, counter):
    beta = at(exploration.inverse_temperature, step)
    action, counter = softmax(q, row, best[row], beta, counter)
    return action, splitmix64(counter), counter + STRIDE


@expectations.body(Softmax)
def _expect_softly(exploration, q, state, values, step):
    beta, best = at(exploration.inverse_temperature, step), highest(values, 0)
    total, weight = 0.0, 0.0
    for action in range(values.shape[1]):
        w = np.exp(beta * (values[0, action] - best))
        total += w * q[0, state, action]
        weight += w
    return total / weight
