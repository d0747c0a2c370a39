"""Compiled evaluation of the greedy policy: its expected return, exactly or by rollouts."""

from typing import NamedTuple

import numpy as np

from curricle.learning.rows import acting_row, greedy_of
from curricle.learning.sampling import ACTION, TIED
from curricle.tasks.dispatch import ByType
from curricle.tasks.draws import draw, scramble
from curricle.tasks.dynamics import Tables, first_state, transition


class Rollouts(NamedTuple):
    """The mean of some episodes."""

    episodes: int
    weight: float  # of a reward, relative to the one before: the discount, or 1
    horizon: int  # steps of an episode


class Exact(NamedTuple):
    """The expectation, by following the distribution over states."""

    tables: Tables
    weight: float
    horizon: int
    negligible: float  # probability still in play below which following stops


def greedy_return(evaluation, model, view, stream):
    """Return the greedy policy's expected return from the start to the horizon.

    `view` is what the policy is greedy on (:func:`greedy_of`); ties are broken uniformly.
    """


judgements = ByType(greedy_return, allocates=True)


@judgements.body(Rollouts)
def _rolled_return(evaluation, model, view, stream):
    total = 0.0
    for _ in range(evaluation.episodes):
        state, weight = first_state(model, draw(stream)), 1.0
        for _ in range(evaluation.horizon):
            bits = draw(stream)
            action = greedy_of(view, state, bits) & ACTION
            state, reward, over = transition(model, state, action, scramble(bits))
            total += weight * reward
            if over:
                break
            weight *= evaluation.weight
    return total / evaluation.episodes


@judgements.body(Exact)
def _followed_return(evaluation, model, view, stream):
    tables = evaluation.tables
    n_states, n_actions = tables.outcome_row.shape
    n_outcomes = tables.probability.shape[1]
    values = np.empty((1, n_actions))
    mass, next_mass = np.zeros(n_states), np.zeros(n_states)
    alive, next_alive = np.empty(n_states, np.int64), np.empty(n_states, np.int64)
    greedy = np.empty(n_states, np.int64)  # -1 where not yet asked for
    for state in range(n_states):
        greedy[state] = -1
    before = 0.0
    n_alive = tables.start_states.shape[0]
    for i in range(n_alive):
        alive[i] = tables.start_states[i]
        mass[alive[i]] = tables.start_cumulative[i] - before
        before = tables.start_cumulative[i]

    total, weight = 0.0, 1.0
    for _ in range(evaluation.horizon):
        n_next, in_play = 0, 0.0
        for i in range(n_alive):
            state = alive[i]
            if greedy[state] < 0:
                greedy[state] = greedy_of(view, np.uint64(state), np.uint64(0))
            first, last, ties = greedy[state], greedy[state] + 1, 1
            if first >= TIED:
                acting_row(view, np.uint64(state), values)
                best = values[0, np.uint64(first) & ACTION]
                first, last, ties = 0, n_actions, 0
                for action in range(n_actions):
                    ties += values[0, action] == best
            share = mass[state] / ties
            mass[state] = 0.0
            for action in range(first, last):
                if ties > 1 and values[0, action] != best:
                    continue
                row = tables.outcome_row[state, action]
                for outcome in range(n_outcomes):
                    part = share * tables.probability[row, outcome]
                    if part > 0.0:
                        total += weight * part * tables.reward[row, outcome]
                        reached = tables.next_state[row, outcome]
                        if not tables.terminal[reached]:
                            if next_mass[reached] == 0.0:
                                next_alive[n_next] = reached
                                n_next += 1
                            next_mass[reached] += part
                            in_play += part
        alive, next_alive = next_alive, alive
        mass, next_mass = next_mass, mass
        n_alive = n_next
        weight *= evaluation.weight
        if in_play * weight < evaluation.negligible:
            break
    return total
