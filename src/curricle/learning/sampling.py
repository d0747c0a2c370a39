"""Compiled random draws and action choice, the parts every learning loop is made of.

Numba's disk cache does not notice that a function called from another file has changed: after an
edit here or in `schedules.py`, run ``make clean``.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from curricle.learning.schedules import Schedule, at

# Exploration.
EPSILON_GREEDY, SOFTMAX = range(2)


class Rule(NamedTuple):
    """A learner."""

    update: int
    learning_rate: Schedule
    exploration: int
    exploring: Schedule  # epsilon, or the softmax's inverse temperature


# -- random draws --------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def uniform(stream):
    """Draw from [0, 1) and advance `stream`, a (1,) uint64 counter (SplitMix64, Vigna 2015)."""
    stream[0] += np.uint64(0x9E3779B97F4A7C15)
    z = stream[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, nogil=True)
def first_above(rising, value):
    """Return the first place of a rising array whose entry exceeds `value`, by bisection."""
    low, high = 0, rising.shape[0]
    while low < high:
        middle = (low + high) // 2
        if rising[middle] > value:
            high = middle
        else:
            low = middle + 1
    return low


@njit(cache=True, nogil=True)
def draw_start(start_states, start_cumulative, stream):
    """Draw the first state of an episode."""
    return start_states[first_above(start_cumulative, uniform(stream))]


@njit(cache=True, nogil=True)
def draw_outcome(cumulative, row, stream):
    """Draw which outcome of an outcome row happens."""
    outcome = 0
    u = uniform(stream)
    while u >= cumulative[row, outcome]:
        outcome += 1
    return outcome


# -- choosing an action --------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def acting_values(q, state, advice, advice_weight, out):
    """Write into `out` (1, A) the values the policy acts on in `state`.

    They are Q, the mean of both tables for double Q-learning, plus w phi under advice (`advice`
    is phi, (S, A), or empty).
    """
    for action in range(out.shape[1]):
        value = q[0, state, action]
        if q.shape[0] == 2:
            value = 0.5 * (value + q[1, state, action])
        out[0, action] = value
    if advice.shape[0] > 0:
        for action in range(out.shape[1]):
            out[0, action] += advice_weight * advice[state, action]


@njit(cache=True, nogil=True)
def tied(table, state, best, ties, stream):
    """Return one of the `ties` actions that have the value `best` in a row, each equally likely."""
    skip = int(uniform(stream) * ties)
    for action in range(table.shape[1]):
        if table[state, action] == best:
            if skip == 0:
                return action
            skip -= 1
    return -1  # not reached


@njit(cache=True, nogil=True)
def best_of(table, state):
    """Return the highest value of a row, the first action that has it, and how many do."""
    best, chosen, ties = table[state, 0], 0, 1
    for action in range(1, table.shape[1]):
        if table[state, action] > best:
            best, chosen, ties = table[state, action], action, 1
        elif table[state, action] == best:
            ties += 1
    return best, chosen, ties


@njit(cache=True, nogil=True)
def greedy(table, state, stream):
    """Return an action of highest value in a row, each equally likely."""
    best, chosen, ties = best_of(table, state)
    return chosen if ties == 1 else tied(table, state, best, ties, stream)


@njit(cache=True, nogil=True)
def softmax(table, state, best, inverse_temperature, stream):
    """Return an action drawn with probability proportional to exp(beta value); `best` is the max.

    By rejection: a uniform proposal is accepted with probability exp(beta (value - best)), which
    spares the exponentials of the whole row. A row that rejects A times is drawn in full.
    """
    n_actions = table.shape[1]
    for _ in range(n_actions):
        action = int(uniform(stream) * n_actions)
        if uniform(stream) < np.exp(inverse_temperature * (table[state, action] - best)):
            return action
    total = 0.0
    for action in range(n_actions):
        total += np.exp(inverse_temperature * (table[state, action] - best))
    left = uniform(stream) * total
    chosen = 0
    for action in range(n_actions):
        weight = np.exp(inverse_temperature * (table[state, action] - best))
        if weight > 0.0:
            chosen = action
            left -= weight
            if left < 0.0:
                break
    return chosen


@njit(cache=True, nogil=True)
def choose(values, rule, step, stream):
    """Return the action that `rule` takes on these acting values, (1, A)."""
    parameter = at(rule.exploring, step)
    if rule.exploration == SOFTMAX:
        return softmax(values, 0, best_of(values, 0)[0], parameter, stream)
    if uniform(stream) < parameter:
        return int(uniform(stream) * values.shape[1])
    return greedy(values, 0, stream)


@njit(cache=True, nogil=True)
def expected_value(q, state, values, rule, step):
    """Return sum_a pi(a) q(state, a) for the policy that `rule` follows on these acting values."""
    parameter = at(rule.exploring, step)
    best = best_of(values, 0)[0]
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
