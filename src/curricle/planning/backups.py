"""Compiled sweeps of exact planning over the tables of a FiniteMDP.

Every loop ends with a sweep in which each value was backed up from a vector within `change` of
the values returned, which is all that the error bound in ``solution.py`` needs. The callers
validate and pass index tables as uint32: an unsigned index needs no test for being negative.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

SWEEPS = 5
"""Sweeps of the greedy policy after each greedy backup; 3 to 6 are about as good."""
PATIENCE = 100
"""Backups without progress near the limits of double precision before giving up, plus a horizon."""
CONVERGED = -1


class Precision(NamedTuple):
    """How far to iterate."""

    enough: float  # the residual, rounding included, at which to end
    unit: float  # the relative rounding error of one backup
    largest_reward: float
    horizon: float  # what a residual is multiplied by to bound the error


@njit(cache=True, nogil=True)
def back_up_rows(mean, probability, next_state, discount, values, rows):
    """Write r + gamma sum_s' P(s') V(s') of each outcome row into `rows`."""
    for row in range(len(probability)):
        total = 0.0
        for outcome in range(probability.shape[1]):
            total += probability[row, outcome] * values[next_state[row, outcome]]
        rows[row] = mean[row] + discount * total


@njit(cache=True, nogil=True)
def improve(outcome_row, terminal, rows, values, chosen):
    """Make each value the best of its state's rows, `chosen` such a row; return the change.

    A choice that is still among the best is kept. Four running maxima hide the latency of one.
    """
    n_states, n_actions = outcome_row.shape
    fours = n_actions // 4
    change = 0.0
    for state in range(n_states):
        if terminal[state]:
            continue
        best = rows[chosen[state]]
        second, third, fourth = best, best, best
        for four in range(fours):
            value = rows[outcome_row[state, 4 * four]]
            best = value if value > best else best
            value = rows[outcome_row[state, 4 * four + 1]]
            second = value if value > second else second
            value = rows[outcome_row[state, 4 * four + 2]]
            third = value if value > third else third
            value = rows[outcome_row[state, 4 * four + 3]]
            fourth = value if value > fourth else fourth
        for action in range(4 * fours, n_actions):
            value = rows[outcome_row[state, action]]
            best = value if value > best else best
        best = max(max(best, second), max(third, fourth))
        if rows[chosen[state]] < best:
            for action in range(n_actions):
                if rows[outcome_row[state, action]] == best:
                    chosen[state] = outcome_row[state, action]
                    break
        change = max(change, abs(best - values[state]))
        values[state] = best
    return change


@njit(cache=True, nogil=True)
def policy_backup(mean, probability, next_state, terminal, discount, chosen, values, sweep):
    """Back up the values of a policy of one row a state, in place; return the largest change.

    Odd sweeps go from the last state to the first.
    """
    n_states = len(values)
    change = 0.0
    for index in range(n_states):
        state = n_states - 1 - index if sweep % 2 else index
        if terminal[state]:
            continue
        row = chosen[state]
        total = 0.0
        for outcome in range(probability.shape[1]):
            total += probability[row, outcome] * values[next_state[row, outcome]]
        new = mean[row] + discount * total
        change = max(change, abs(new - values[state]))
        values[state] = new
    return change


@njit(cache=True, nogil=True)
def largest_of(values):
    """Return max |V|."""
    largest = 0.0
    for value in values:
        largest = max(largest, abs(value))
    return largest


@njit(cache=True, nogil=True)
def converged(change, least, waited, values, reach, discount, precision):
    """Return for how many backups there has been no progress, or CONVERGED to end.

    Iteration ends if the residual (gamma times the change, plus the rounding of a backup: `unit`
    times the size of the numbers) is at most `enough`; if the change is well below that rounding;
    or if, near it, the smallest change so far, `least`, has not been undercut for long. `reach` is
    a sum of changes that no value exceeds, which spares the search for the largest value.
    """
    enough, unit, largest_reward, horizon = precision
    if not change < np.inf:
        return CONVERGED
    if discount * change > enough and change > 64 * horizon * unit * (largest_reward + reach):
        return 0
    rounding = unit * (largest_reward + largest_of(values))
    if discount * change + rounding <= enough or 2 * change <= rounding:
        return CONVERGED
    if change < least:
        return 0
    return waited + 1 if waited < PATIENCE + horizon else CONVERGED


@njit(cache=True, nogil=True)
def optimal_values(
    outcome_row,
    probability,
    next_state,
    mean,
    terminal,
    discount,
    values,
    precision,
):
    """Turn `values`, bounds of the lengths of episodes, into the optimum; return the last change.

    Modified policy iteration: a greedy backup of all states, then a few sweeps of the greedy
    policy, which back up one row a state. It starts from the lengths times the smallest best mean
    reward of a state, and ends after a greedy backup (:func:`converged`).
    """
    rows = np.empty(len(probability))
    chosen = outcome_row[:, 0].copy()
    best_reward = np.zeros(len(values))
    improve(outcome_row, terminal, mean, best_reward, chosen)
    worst = 0.0
    for value in best_reward:
        worst = min(worst, value)
    for state in range(len(values)):
        values[state] = 0.0 if terminal[state] else worst * values[state]
    least, waited, reach = np.inf, np.int64(0), largest_of(values)
    while True:
        back_up_rows(mean, probability, next_state, discount, values, rows)
        change = improve(outcome_row, terminal, rows, values, chosen)
        reach += change
        waited = converged(change, least, waited, values, reach, discount, precision)
        if waited == CONVERGED:
            return change
        least = min(least, change)
        for sweep in range(SWEEPS):
            moved = policy_backup(
                mean,
                probability,
                next_state,
                terminal,
                discount,
                chosen,
                values,
                sweep,
            )
            if moved <= 0.5 * precision.enough:
                break


# -- a given policy ------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def policy_entries(policy, terminal, row_of):
    """Return a policy in compressed form: state s has entries first[s] to first[s + 1].

    An entry is an outcome row and its weight; a terminal state has one entry, of weight 0. `row_of`
    has the row of each pair, for all states or, repeating, for a part of them.
    """
    n_states, n_actions = policy.shape
    first = np.zeros(n_states + 1, dtype=np.int64)
    for state in range(n_states):
        taken = 1 if terminal[state] else np.count_nonzero(policy[state] > 0)
        first[state + 1] = first[state] + taken
    row = np.zeros(first[-1], dtype=np.uint32)
    weight = np.zeros(first[-1])
    for state in range(n_states):
        entry = first[state]
        for action in range(0 if terminal[state] else n_actions):
            if policy[state, action] > 0:
                row[entry] = row_of[state % len(row_of), action]
                weight[entry] = policy[state, action]
                entry += 1
    return first, row, weight


@njit(cache=True, nogil=True)
def mixed_policy_backup(first, row, weight, terminal, rows, values, start):
    """Make values the policy's mean of their rows, from state `start` on; return the change."""
    change = 0.0
    for index in range(len(values)):
        state = start + index
        if terminal[state]:
            continue
        new = 0.0
        for entry in range(first[state], first[state + 1]):
            new += weight[entry] * rows[row[entry]]
        change = max(change, abs(new - values[index]))
        values[index] = new
    return change


@njit(cache=True, nogil=True)
def copy(values, target):
    """Copy: the assignment of slices takes seconds to compile."""
    for state in range(len(values)):
        target[state] = values[state]


@njit(cache=True, nogil=True)
def difference(before, values):
    """Write values - before into `before`."""
    for state in range(len(values)):
        before[state] = values[state] - before[state]


@njit(cache=True, nogil=True)
def extrapolate(values, step, last):
    """Extrapolate along the last step (Anderson 1965, depth 1); return whether it was done.

    After two equal linear sweeps, V + last and then V + last + step, the sweep from the mixture
    V + (1 - t) last changes it by (1 - t) step + t last, and leads to the values returned. t
    minimises that change in the mean square. It is used only if the change is then less than half
    of `step` in the maximum norm, so that no sweep is lost.
    """
    along, across, longest = 0.0, 0.0, 0.0
    for state in range(len(values)):
        bend = step[state] - last[state]
        along += step[state] * bend
        across += bend * bend
        longest = max(longest, abs(step[state]))
    if across == 0.0:
        return False
    t = along / across
    for state in range(len(values)):
        if abs((1 - t) * step[state] + t * last[state]) > 0.5 * longest:
            return False
    for state in range(len(values)):
        values[state] -= t * step[state]
    return True


@njit(cache=True, nogil=True)
def policy_values(
    first,
    row,
    weight,
    probability,
    next_state,
    mean,
    terminal,
    discount,
    values,
    precision,
):
    """Bring `values` to those of a policy, in place; ends and returns as `optimal_values` does."""
    rows = np.empty(len(probability))
    step, last = np.zeros(len(values)), np.zeros(len(values))
    upwards = np.int64(0)  # every sweep in the same direction
    single = True  # one row a state: backed up in place, which takes fewer sweeps
    for state in range(len(values)):
        one = first[state + 1] - first[state] == 1
        single &= one and (terminal[state] or weight[first[state]] == 1.0)
    least, waited, reach, pairs = np.inf, np.int64(0), 0.0, 0
    while True:
        last, step = step, last
        copy(values, step)
        if single:
            change = policy_backup(
                mean, probability, next_state, terminal, discount, row, values, upwards
            )
        else:
            back_up_rows(mean, probability, next_state, discount, values, rows)
            change = mixed_policy_backup(first, row, weight, terminal, rows, values, 0)
        difference(step, values)
        reach += change
        waited = converged(change, least, waited, values, reach, discount, precision)
        if waited == CONVERGED:
            return change
        least = min(least, change)
        pairs += 1
        if pairs >= 4 and waited == 0 and extrapolate(values, step, last):
            pairs, reach = 0, reach + largest_of(values)
