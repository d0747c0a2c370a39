"""The compiled learning loops, and the evaluation of the greedy policy.

The functions trust their input; :func:`curricle.learn`, which calls them, validates.

Reading order: what the loops are given, the general loop :func:`train`, its faster twin
:func:`train_q_learning`, greedy evaluation.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.learning.sampling import (
    SOFTMAX,
    acting_values,
    best_of,
    choose,
    draw_outcome,
    draw_start,
    expected_value,
    first_above,
    greedy,
    softmax,
    tied,
    uniform,
)
from curricle.learning.schedules import HARMONIC, Schedule, at

FloatArray = npt.NDArray[np.float64]

# What is added to the reward, or to the values acted on.
PLAIN, STATE, LOOK_BACK, BONUS, ADVICE = range(5)
# Update rules.
Q_LEARNING, SARSA, EXPECTED_SARSA, DOUBLE_Q_LEARNING = range(4)

NO_LIMIT = np.int64(2**62)
JUDGE = np.uint64(0x5851F42D4C957F2D)
"""Sets the stream of evaluations apart from that of learning, which they must not disturb."""


class Model(NamedTuple):
    """The tables of a :class:`FiniteMDP`, as the loops read them."""

    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A) int32
    probability: FloatArray  # (Y, O)
    cumulative: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O) int32
    reward: FloatArray  # (Y, O)
    terminal: npt.NDArray[np.bool_]  # (S,)
    start_states: npt.NDArray[np.int64]  # (n,)
    start_cumulative: FloatArray  # (n,)
    discount: float
    time_limit: np.int64  # steps; NO_LIMIT for none


class Shaping(NamedTuple):
    """What a potential adds while learning; `initialise` and `look_ahead` need none of it."""

    way: int
    weight: Schedule
    frame_steps: npt.NDArray[np.int64]  # (M,) the step from which each frame holds
    state_values: FloatArray  # (M, S) Phi(s) of each frame
    pair_values: FloatArray  # (S, A) phi(s, a)


class Evaluation(NamedTuple):
    """How the greedy policy is judged at a checkpoint."""

    exact: bool
    episodes: int  # rollouts, if not exact
    discounted: bool
    horizon: int  # steps of an episode
    negligible: float  # probability still in play below which an exact evaluation stops


class Record(NamedTuple):
    """What a run writes down, one entry a checkpoint."""

    training_return: FloatArray  # (T,) mean return of the episodes ended since the last one
    greedy_return: FloatArray  # (T,)
    steps: npt.NDArray[np.int64]  # (T,)
    episodes: npt.NDArray[np.int64]  # (T,)


# -- learning ------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def state_potential(shaping, state, step):
    """Return w(t) Phi(s, t), the frame of the potential in force at `step`."""
    frame = first_above(shaping.frame_steps, step) - 1
    return at(shaping.weight, step) * shaping.state_values[frame, state]


@njit(cache=True, nogil=True)
def bootstrap(q, table, state, next_action, values, rule, step, stream):
    """Return what the rule takes `state` to be worth; `values` are its acting values.

    Q-learning (paper E1): max_a Q(s, a). SARSA: Q(s, a) of the action that will be taken.
    Expected SARSA: the policy's mean. Double Q-learning: the other table's value of this
    table's best action.
    """
    if rule.update == SARSA:
        return q[0, state, next_action]
    if rule.update == EXPECTED_SARSA:
        return expected_value(q, state, values, rule, step)
    if rule.update == DOUBLE_Q_LEARNING:
        return q[1 - table, state, greedy(q[table], state, stream)]
    return best_of(q[0], state)[0]


@njit(cache=True, nogil=True)
def shaping_reward(shaping, phi, discount, state, action, next_state, terminated, step, carried):
    """Return what shaping adds to the reward of a step, and what it carries to the next step.

    Carried is Phi(s', t') for a state potential, phi(s, a) for look-back advice. The potential of
    a terminal state is 0.
    """
    if shaping.way == STATE:  # F = gamma Phi(s', t') - Phi(s, t)
        here, there = carried, 0.0
        if not terminated:
            there = state_potential(shaping, next_state, step)
        return discount * there - here, there
    if shaping.way == LOOK_BACK:  # F = phi(s, a) - phi(s before, a before) / gamma
        here, before = phi[state, action], carried
        if terminated:  # the end's own term, gamma (0 - phi(s, a) / gamma), is due now
            return -before / discount, 0.0
        return here - before / discount, here
    if shaping.way == BONUS:
        return phi[state, action], 0.0
    return 0.0, 0.0


@njit(cache=True, nogil=True)
def write(record, checkpoint, step, episodes, ended, ended_return, value):
    """Fill one checkpoint of a record."""
    record.training_return[checkpoint] = ended_return / ended if ended > 0 else np.nan
    record.greedy_return[checkpoint] = value
    record.steps[checkpoint] = step
    record.episodes[checkpoint] = episodes


@njit(cache=True, nogil=True)
def train(model, rule, shaping, evaluation, q, visits, stream, budget, every, record):
    """Learn in place on `q` (1 or 2, S, A), fill `record`, return the steps and episodes done.

    `visits` (S, A) counts updates for a harmonic learning rate, `stream` (1,) is the run's random
    stream, `budget` are the steps and episodes at which to stop, `every` the steps between
    checkpoints (checkpoint 0 is before the first step).
    """
    # Arrays leave their tuples here: inside the loop each access would count a reference.
    outcome_row, cumulative, successor = model.outcome_row, model.cumulative, model.next_state
    pay, terminal, discount = model.reward, model.terminal, model.discount
    weight, phi = shaping.weight, shaping.pair_values
    advice = phi[: phi.shape[0] if shaping.way == ADVICE else 0]
    values, next_values = np.empty((1, q.shape[2])), np.empty((1, q.shape[2]))
    judge = stream ^ JUDGE
    value = greedy_return(model, q, advice, at(weight, 0), evaluation, judge)
    write(record, 0, 0, 0, 0, 0.0, value)

    counted, noisy = rule.learning_rate.shape == HARMONIC, cumulative.shape[1] > 1
    step, episodes, checkpoint, ended, ended_return = 0, 0, 1, 0, 0.0
    fresh, state, action, length, episode_return, carried = True, 0, 0, 0, 0.0, 0.0
    while step < budget[0] and episodes < budget[1]:
        if fresh:
            state = draw_start(model.start_states, model.start_cumulative, stream)
            length, episode_return, carried = 0, 0.0, 0.0
            if shaping.way == STATE:
                carried = state_potential(shaping, state, step)
        if fresh or rule.update != SARSA:
            acting_values(q, state, advice, at(weight, step), values)
            action = choose(values, rule, step, stream)
        row = outcome_row[state, action]
        outcome = draw_outcome(cumulative, row, stream) if noisy else 0
        next_state, target = successor[row, outcome], pay[row, outcome]
        terminated = terminal[next_state]
        step, length, episode_return = step + 1, length + 1, episode_return + target

        extra, carried = shaping_reward(
            shaping, phi, discount, state, action, next_state, terminated, step, carried
        )
        target += extra
        # Cutting off at the time limit is not termination: it bootstraps like any other step.
        next_action, table = 0, 0
        if rule.update == DOUBLE_Q_LEARNING:
            table = int(uniform(stream) * 2)
        if not terminated:
            acting_values(q, next_state, advice, at(weight, step), next_values)
            if rule.update == SARSA:
                next_action = choose(next_values, rule, step, stream)
            target += discount * bootstrap(
                q, table, next_state, next_action, next_values, rule, step, stream
            )
        count = step - 1
        if counted:
            count = visits[state, action]
            visits[state, action] += 1
        rate = at(rule.learning_rate, count)
        q[table, state, action] += rate * (target - q[table, state, action])

        fresh = terminated or length >= model.time_limit
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
        state, action = next_state, next_action
        if step == checkpoint * every:
            value = greedy_return(model, q, advice, at(weight, step), evaluation, judge)
            write(record, checkpoint, step, episodes, ended, ended_return, value)
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
    return step, episodes


@njit(cache=True, nogil=True)
def train_q_learning(model, rule, shaping, evaluation, q, visits, stream, budget, every, record):
    """Do what :func:`train` does, draw for draw, for Q-learning without reward shaping.

    Each row's maximum is kept at hand and looked for again only when it was lowered, so that a
    step scans no row; that is what makes this loop several times faster than the general one.
    `shaping` is plain.
    """
    outcome_row, cumulative, successor = model.outcome_row, model.cumulative, model.next_state
    pay, terminal, discount = model.reward, model.terminal, model.discount
    table, no_advice = q[0], shaping.pair_values[:0]
    n_states, n_actions = table.shape
    row_best = np.empty(n_states)
    row_action, row_ties = np.empty(n_states, np.int32), np.empty(n_states, np.int32)
    for state in range(n_states):
        row_best[state], row_action[state], row_ties[state] = best_of(table, state)
    judge = stream ^ JUDGE
    value = greedy_return(model, q, no_advice, 0.0, evaluation, judge)
    write(record, 0, 0, 0, 0, 0.0, value)

    counted, noisy = rule.learning_rate.shape == HARMONIC, cumulative.shape[1] > 1
    step, episodes, checkpoint, ended, ended_return = 0, 0, 1, 0, 0.0
    fresh, state, length, episode_return = True, 0, 0, 0.0
    while step < budget[0] and episodes < budget[1]:
        if fresh:
            state = draw_start(model.start_states, model.start_cumulative, stream)
            length, episode_return = 0, 0.0
        parameter = at(rule.exploring, step)
        if rule.exploration == SOFTMAX:
            action = softmax(table, state, row_best[state], parameter, stream)
        elif uniform(stream) < parameter:
            action = int(uniform(stream) * n_actions)
        elif row_ties[state] == 1:
            action = row_action[state]
        else:
            action = tied(table, state, row_best[state], row_ties[state], stream)
        row = outcome_row[state, action]
        outcome = draw_outcome(cumulative, row, stream) if noisy else 0
        next_state, target = successor[row, outcome], pay[row, outcome]
        step, length, episode_return = step + 1, length + 1, episode_return + target

        terminated = terminal[next_state]
        if not terminated:
            target += discount * row_best[next_state]
        count = step - 1
        if counted:
            count = visits[state, action]
            visits[state, action] += 1
        rate = at(rule.learning_rate, count)
        old = table[state, action]
        new = old + rate * (target - old)
        table[state, action] = new
        if new > row_best[state]:
            row_best[state], row_action[state], row_ties[state] = new, action, 1
        elif old == row_best[state] or new == row_best[state]:
            row_best[state], row_action[state], row_ties[state] = best_of(table, state)

        fresh = terminated or length >= model.time_limit
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
        state = next_state
        if step == checkpoint * every:
            value = greedy_return(model, q, no_advice, 0.0, evaluation, judge)
            write(record, checkpoint, step, episodes, ended, ended_return, value)
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
    return step, episodes


# -- evaluating the greedy policy ----------------------------------------------------------------


@njit(cache=True, nogil=True)
def greedy_return(model, q, advice, advice_weight, evaluation, stream):
    """Return the greedy policy's expected return from the start distribution to the time limit.

    Ties are broken uniformly. Exact by following the distribution over states, or the mean of
    rollouts.
    """
    if evaluation.exact:
        return followed_return(model, q, advice, advice_weight, evaluation)
    outcome_row, cumulative, next_state = model.outcome_row, model.cumulative, model.next_state
    reward, terminal, discount = model.reward, model.terminal, model.discount
    start_states, start_cumulative = model.start_states, model.start_cumulative
    values = np.empty((1, q.shape[2]))
    noisy, total = cumulative.shape[1] > 1, 0.0
    for _ in range(evaluation.episodes):
        state, weight = draw_start(start_states, start_cumulative, stream), 1.0
        for _ in range(evaluation.horizon):
            acting_values(q, state, advice, advice_weight, values)
            row = outcome_row[state, greedy(values, 0, stream)]
            outcome = draw_outcome(cumulative, row, stream) if noisy else 0
            total += weight * reward[row, outcome]
            state = next_state[row, outcome]
            if terminal[state]:
                break
            if evaluation.discounted:
                weight *= discount
    return total / evaluation.episodes


@njit(cache=True, nogil=True)
def followed_return(model, q, advice, advice_weight, evaluation):
    """Return the expected return by pushing the state distribution forward step by step."""
    outcome_row, probability = model.outcome_row, model.probability
    next_state, reward, terminal = model.next_state, model.reward, model.terminal
    n_states, n_actions = outcome_row.shape
    n_outcomes = probability.shape[1]
    values = np.empty((1, n_actions))
    only = np.full(n_states, -2)  # the greedy action, -1 where several tie, -2 not yet asked
    mass, next_mass = np.zeros(n_states), np.zeros(n_states)
    alive, next_alive = np.empty(n_states, np.int64), np.empty(n_states, np.int64)
    before = 0.0
    n_alive = model.start_states.shape[0]
    for i in range(n_alive):
        alive[i] = model.start_states[i]
        mass[alive[i]] = model.start_cumulative[i] - before
        before = model.start_cumulative[i]

    total, weight = 0.0, 1.0
    for _ in range(evaluation.horizon):
        n_next, in_play = 0, 0.0
        for i in range(n_alive):
            state = alive[i]
            if only[state] == -2:
                acting_values(q, state, advice, advice_weight, values)
                best, action, ties = best_of(values, 0)
                only[state] = action if ties == 1 else -1
            ties, first, last = 1, only[state], only[state] + 1
            if only[state] == -1:
                acting_values(q, state, advice, advice_weight, values)
                best, _, ties = best_of(values, 0)
                first, last = 0, n_actions
            share = mass[state] / ties
            mass[state] = 0.0
            for action in range(first, last):
                if ties > 1 and values[0, action] != best:
                    continue
                row = outcome_row[state, action]
                for outcome in range(n_outcomes):
                    part = share * probability[row, outcome]
                    if part > 0.0:
                        total += weight * part * reward[row, outcome]
                        reached = next_state[row, outcome]
                        if not terminal[reached]:
                            if next_mass[reached] == 0.0:
                                next_alive[n_next] = reached
                                n_next += 1
                            next_mass[reached] += part
                            in_play += part
        alive, next_alive = next_alive, alive
        mass, next_mass = next_mass, mass
        n_alive = n_next
        if evaluation.discounted:
            weight *= model.discount
        if in_play * weight < evaluation.negligible:
            break
    return total
