"""Compiled choices among a row of values: the best, a greedy one, the one a learner takes.

Numba's disk cache does not notice that a function called from another file has changed: after an
edit here, in `schedules.py`, or in the compiled parts of `tasks/`, run ``make clean``.
"""

from typing import NamedTuple

import numpy as np

from curricle.learning.machine import larger
from curricle.learning.schedules import Schedule, at
from curricle.tasks.draws import HALF, STRIDE, below, happens, piece, scramble, unit

# Exploration.
EPSILON_GREEDY, SOFTMAX = range(2)

TIED = np.uint64(1 << 15)
"""Flag of an action that was drawn among several of the same value."""
ACTION = np.uint64((1 << 15) - 1)
"""The bits of the action itself."""
SPENT = np.uint64((1 << 16) - 1)
"""In place of an action: several are best, and the one that was drawn has been taken."""
MULTIPLIER = np.uint64(0xD1342543DE82EF95)
"""Of a linear congruential generator whose upper bits are good enough to propose actions with."""


class Rule(NamedTuple):
    """A learner."""

    update: int
    learning_rate: Schedule
    exploration: int
    exploring: Schedule  # epsilon, or the softmax's inverse temperature


@piece
def highest(table, row):
    """Return the highest value of a row."""
    best = table[row, 0]
    for action in range(np.uint64(1), np.uint64(table.shape[1])):
        best = larger(best, table[row, action])
    return best


@piece
def best_of(table, row, bits):
    """Return the highest value of a row and an action that has it, flagged where several do.

    Of several each is equally likely: actions are proposed by 64 random bits until one has the
    value, A / ties proposals on average; counting up to a place drawn takes twice as long.
    """
    best, n_actions = highest(table, row), np.uint64(table.shape[1])
    # In 32 bits, as many entries go through a vector instruction as in single precision.
    ties, total = np.uint32(0), np.uint32(0)
    for action in range(n_actions):
        tied = np.uint32(table[row, action] == best)
        ties = np.uint32(ties + tied)
        total = np.uint32(total + np.uint32(tied * np.uint32(action)))
    if ties == np.uint32(1):
        return best, np.uint64(total)
    proposed = n_actions
    while proposed == n_actions or table[row, proposed] != best:
        bits = bits * MULTIPLIER + STRIDE
        proposed = below(bits >> HALF, n_actions)
    return best, proposed | TIED


@piece
def one_of_several(table, greedy, row, bits):
    """Return the action drawn among a row's best, each time another draw.

    The draw made when the row was last looked through serves once. If taking the action then
    changes its value, the row is looked through again; if not, the next draw is made here.
    """
    chosen = np.uint64(greedy[row])
    if chosen == SPENT:
        chosen = best_of(table, row, bits)[1]
    greedy[row] = SPENT
    return chosen & ACTION


@piece
def softmax(table, row, best, inverse_temperature, counter):
    """Return an action drawn with probability proportional to exp(beta value); `best` is the max.

    Also the stream's counter one draw further than was used. By rejection: a uniform proposal is
    accepted with probability exp(beta (value - best)), which spares the exponentials of the whole
    row. A row that rejects A times is drawn in full.
    """
    n_actions = np.uint64(table.shape[1])
    for _ in range(n_actions):
        bits = scramble(counter)
        counter += STRIDE
        action = below(bits, n_actions)
        if accepted(inverse_temperature * (table[row, action] - best), bits):
            return action, counter
    total = 0.0
    for action in range(n_actions):
        total += np.exp(inverse_temperature * (table[row, action] - best))
    left = unit(scramble(counter)) * total
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


@piece
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


@piece
def choose(values, rule, step, counter):
    """Return the action that `rule` takes on these acting values, (1, A), and bits for its outcome.

    Also the stream's counter for the next draw. One draw serves the exploration, the action or
    tie, and (scrambled once more) the outcome.
    """
    parameter, bits = at(rule.exploring, step), scramble(counter)
    if rule.exploration == SOFTMAX:
        action, counter = softmax(values, 0, highest(values, 0), parameter, counter)
        return action, scramble(scramble(counter)), counter + STRIDE
    if happens(bits, parameter):
        action = below(bits, values.shape[1])
    else:
        action = best_of(values, 0, bits)[1] & ACTION
    return action, scramble(bits), counter + STRIDE


@piece
def expected_value(q, state, values, rule, step):
    """Return sum_a pi(a) q(state, a) for the policy that `rule` follows on these acting values."""
    parameter = at(rule.exploring, step)
    best = highest(values, 0)
    total, weight, mean = 0.0, 0.0, 0.0
    for action in range(values.shape[1]):
        if rule.exploration == SOFTMAX:
            w = np.exp(parameter * (values[0, action] - best))
        else:
            w = 1.0 if values[0, action] == best else 0.0
        total += w * q[0, state, action]
        weight += w
        mean += q[0, state, action] / values.shape[1]
    if rule.exploration == SOFTMAX:
        return total / weight
    return (1.0 - parameter) * total / weight + parameter * mean
