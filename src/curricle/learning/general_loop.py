"""The general learning loop: all update rules and all shapings, one function for each equation.

:func:`curricle.learn` validates the arguments. Q-learning on unshaped rewards has a faster loop of
its own in ``q_learning.py``, guarded learning one in ``guard.py``. This loop is compiled once for
all rules and shapings: with bodies chosen by type it would be compiled anew for each combination,
and compiling takes far longer than the few comparisons that a step of the loop makes.
"""

from typing import NamedTuple

import numpy as np

from curricle.arrays import FloatArray, FloatTable, IntArray
from curricle.learning.exploration import choose, expected_value
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import Schedule, at, rate_of
from curricle.learning.stopping import stops
from curricle.learning.tables import tie_bits
from curricle.planning.greedy import ACTION, acting_rows, best_of, greedy_actions, highest
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.draws import STRIDE, first_above, splitmix64
from curricle.tasks.generative_models import first_state, has_failed, transition, truncated
from curricle.tasks.overloads import inlined

# What is added to the reward, or to the values acted on.
PLAIN, STATE, LOOK_BACK, BONUS, ADVICE = range(5)
# Update rules.
Q_LEARNING, SARSA, EXPECTED_SARSA, DOUBLE_Q_LEARNING = range(4)


class ShapingKernel(NamedTuple):
    """What a :class:`Shaping` adds while learning, as compiled loops read it."""

    kind: int
    weight: Schedule
    steps: IntArray  # (M,) the step from which each state potential holds
    state_values: FloatArray  # (M, S) Phi(s)
    pair_values: FloatArray  # (S, A) phi(s, a)


class Acting(NamedTuple):
    """The values a policy acts on: Q, the mean of two tables, or either plus w phi under advice."""

    q: FloatTable  # (1 or 2, S, A)
    advice: FloatArray  # (S, A) phi, or (0, A)
    weight: float
    values: FloatArray  # (1, A) work space


@acting_rows.body(Acting)
def _write_acting_row(view, state, out):
    for action in range(out.shape[1]):
        value = np.float64(view.q[0, state, action])
        if view.q.shape[0] == 2:
            value = 0.5 * (value + view.q[1, state, action])
        if view.advice.shape[0] > 0:
            value += view.weight * view.advice[state, action]
        out[0, action] = value


acting_values = inlined(_write_acting_row)


@greedy_actions.body(Acting)
def _acting_greedy(view, state, bits):
    acting_values(view, state, view.values)
    return best_of(view.values, 0, bits)[1]


@inlined
def state_potential(shaping, state, step):
    """Return w(t) Phi(s, t), of the potential that holds at `step`."""
    current = first_above(shaping.steps, step) - np.uint64(1)
    return at(shaping.weight, step) * shaping.state_values[current, state]


# -- update rules: the target of Q(s, a) where the episode goes on from s' -----------------------


@inlined
def q_learning_target(reward, discount, q, next_state):
    """Return r + gamma max_b Q(s', b) (paper E1; Watkins 1989)."""
    real = q.dtype.type  # the precision of the table, as in the fast loop
    return real(reward) + real(discount) * highest(q[0], next_state)


@inlined
def sarsa_target(reward, discount, q, next_state, next_action):
    """Return r + gamma Q(s', a'), a' the action that will be taken (Rummery, Niranjan 1994)."""
    return reward + discount * np.float64(q[0, next_state, next_action])


@inlined
def expected_sarsa_target(reward, discount, q, next_state, exploration, values, step):
    """Return r + gamma sum_b pi(b|s') Q(s', b) (van Seijen et al. 2009).

    The policy pi acts on `values`, (1, A), those of s'.
    """
    return reward + discount * expected_value(exploration, q, next_state, values, step)


@inlined
def double_q_learning_target(reward, discount, q, next_state, table, bits):
    """Return r + gamma Q_other(s', argmax_b Q_table(s', b)) (van Hasselt 2010)."""
    best = best_of(q[table], next_state, bits)[1] & ACTION
    return reward + discount * np.float64(q[1 - table, next_state, best])


@inlined
def td_target(rule, reward, discount, q, next_state, next_action, values, table, bits, step):
    """Return the target of the learner's update rule."""
    if rule.update == SARSA:
        return sarsa_target(reward, discount, q, next_state, next_action)
    if rule.update == EXPECTED_SARSA:
        return expected_sarsa_target(
            reward, discount, q, next_state, rule.exploration, values, step
        )
    if rule.update == DOUBLE_Q_LEARNING:
        return double_q_learning_target(reward, discount, q, next_state, table, bits)
    return q_learning_target(reward, discount, q, next_state)


@inlined
def counted_row(q, table, state):
    """Return the row in which the updates of a state are counted; each table counts its own."""
    return np.uint64(table) * np.uint64(q.shape[1]) + state


@inlined
def move(q, table, state, action, rate, target):
    """Move Q(s, a) of a table towards a target, in the table's precision, and return it."""
    real, old = q.dtype.type, q[table, state, action]
    new = old + real(rate) * (real(target) - old)
    q[table, state, action] = new
    return np.float64(new)


@inlined
def advised(advice, weight, state, action):
    """Return what advice adds to the value that a policy acts on."""
    return weight * advice[state, action] if advice.shape[0] > 0 else 0.0


@inlined
def begin(model, shaping, step, counter):
    """Return the first state of an episode, the stream's counter, and the potential carried."""
    state, carried = first_state(model, splitmix64(counter)), 0.0
    if shaping.kind == STATE:
        carried = state_potential(shaping, state, step)
    return state, counter + STRIDE, carried


@inlined
def toss(rule, counter):
    """Return the table that is updated, the bits that chose it, and the stream's counter."""
    if rule.update != DOUBLE_Q_LEARNING:
        return 0, np.uint64(0), counter
    coin = splitmix64(counter)
    return np.int64(coin & np.uint64(1)), coin, counter + STRIDE


# -- ties: Q-learning has a fast loop too and draws them as there, a visit ahead; others at once ---


@inlined
def draw_ties(ties, key):
    """Draw the bits that break each state's ties before learning, (S,)."""
    for state in range(np.uint64(ties.shape[0])):
        ties[state] = tie_bits(key, state)


@inlined
def act(rule, values, ties, state, step, counter):
    """Return what :func:`choose` does in a state on these acting values."""
    tie = ties[state] if rule.update == Q_LEARNING else splitmix64(counter)
    return choose(rule.exploration, values, tie, step, counter)


@inlined
def draws_again(values, tie, new, action):
    """Return whether the fast loop would draw again among a state's ties after an update.

    That is where the action's value, which was in `values` and is `new`, changed and is or was the
    highest, or where it did not change and the action is the one that had been drawn by `tie`.
    """
    old = values[0, action]
    if new == old:
        return best_of(values, 0, tie)[1] & ACTION == action
    return max(old, new) >= highest(values, 0)


# -- shaping rewards: what is added to a reward, and what is carried to the next step ------------


@inlined
def state_shaping_reward(shaping, discount, next_state, terminated, step, here):
    """Return F = gamma Phi(s', t') - Phi(s, t), and Phi(s', t') (Ng, Harada, Russell 1999).

    Phi of a terminal state is 0 (Grzes 2017).
    """
    there = 0.0
    if not terminated:
        there = state_potential(shaping, next_state, step)
    return discount * there - here, there


@inlined
def look_back_reward(shaping, discount, state, action, terminated, before):
    """Return F = phi(s, a) - phi(s before, a before) / gamma, and phi(s, a).

    Wiewiora, Cottrell, Elkan 2003. The last step of an episode also gets the term of its end,
    gamma (0 - phi(s, a) / gamma), so that phi(s, a) cancels.
    """
    here = shaping.pair_values[state, action]
    if terminated:
        return -before / discount, 0.0
    return here - before / discount, here


@inlined
def shaping_reward(shaping, discount, state, action, next_state, terminated, step, carried):
    """Return what shaping adds to the reward of a step, and what it carries to the next step."""
    if shaping.kind == STATE:
        return state_shaping_reward(shaping, discount, next_state, terminated, step, carried)
    if shaping.kind == LOOK_BACK:
        return look_back_reward(shaping, discount, state, action, terminated, carried)
    if shaping.kind == BONUS:
        return shaping.pair_values[state, action], 0.0
    return 0.0, 0.0


# -- the loop ------------------------------------------------------------------------------------


@inlined
def keep_snapshot(record, checkpoint, q, other):
    """Keep the mean of two tables (S, A) if this is a checkpoint to keep."""
    for i in range(record.snapshot_at.shape[0]):
        if record.snapshot_at[i] == checkpoint:
            for state in range(q.shape[0]):
                for action in range(q.shape[1]):
                    mean = 0.5 * (q[state, action] + other[state, action])
                    record.snapshots[i, state, action] = mean


@inlined
def write_checkpoint(record, checkpoint, so_far, q, other, stopping):
    """Fill one checkpoint of a record, and return whether the stopping rule ends the run there.

    `so_far` are the steps, the episodes, the number and returns of those ended since the last
    checkpoint, and the greedy return; the policy acts on the mean of `q` and `other`.
    """
    step, episodes, ended, ended_return, value = so_far
    record.training_return[checkpoint] = ended_return / ended if ended > 0 else np.nan
    record.greedy_return[checkpoint] = value
    record.episodes[checkpoint] = episodes
    keep_snapshot(record, checkpoint, q, other)
    return stops(stopping, record.greedy_return, checkpoint, step)


@inlined
def warm_up_checkpoints(record, step, eval_freq, value, q, other):
    """Return the first checkpoint from `step` on; those before get the return before learning.

    `value` is that return, a number: evaluating here too would compile the evaluation a second
    time. Snapshots there are the mean of the tables `q` and `other` before learning.
    """
    checkpoint = 0
    while checkpoint * eval_freq < step:
        record.greedy_return[checkpoint] = value
        keep_snapshot(record, checkpoint, q, other)
        checkpoint += 1
    return checkpoint


def train(model, horizon, rule, shaping, q, evaluation, stream, used, budget, eval_freq, record):
    """Learn in place on `q` (1 or 2, S, A), fill `record`, return the steps and episodes done.

    `horizon` are the discount and the time limit, `stream` (1,) is the run's random stream,
    `used` the warm-up, `budget` are the :class:`Bounds`, `eval_freq` the steps between
    checkpoints (checkpoint 0 is before the first step).
    """
    discount, limit = horizon
    phi, weight = shaping.pair_values, shaping.weight
    advice = phi[: phi.shape[0] if shaping.kind == ADVICE else 0]
    shape = 1, q.shape[2]
    values, next_values, row = np.empty(shape), np.empty(shape), np.empty(shape)
    step, episodes, ended, ended_return = used
    first = Acting(q, advice, at(weight, step), row)
    value = greedy_return(evaluation, model, first) if step > 0 else np.nan
    last = q[q.shape[0] - 1]
    checkpoint = warm_up_checkpoints(record, step, eval_freq, value, q[0], last)
    fresh, state, length, episode_return, carried = True, np.uint64(0), 0, 0.0, 0.0
    action, bits, counter, drawn = np.uint64(0), np.uint64(0), stream[0] + STRIDE, False
    ties = np.empty(q.shape[1] if rule.update == Q_LEARNING else 0, np.uint64)
    draw_ties(ties, splitmix64(stream[0]))
    looks_ahead = rule.update in (SARSA, EXPECTED_SARSA)
    while True:
        if step == checkpoint * eval_freq:
            acting = Acting(q, advice, at(weight, step), row)
            so_far = step, episodes, ended, ended_return, greedy_return(evaluation, model, acting)
            if write_checkpoint(record, checkpoint, so_far, q[0], last, budget.stopping):
                return step, episodes
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
        if is_spent(budget, record, step, episodes) or has_failed(model):
            return step, episodes
        if fresh:
            state, counter, carried = begin(model, shaping, step, counter)
            length, episode_return = 0, 0.0
        if fresh or rule.update != SARSA:
            acting_values(Acting(q, advice, at(weight, step), row), state, values)
            action, bits, counter, drawn = act(rule, values, ties, state, step, counter)
        next_state, target, terminated = transition(model, state, action, splitmix64(bits))
        step, length, episode_return = step + 1, length + 1, episode_return + target
        extra, carried = shaping_reward(
            shaping, discount, state, action, next_state, terminated, step, carried
        )
        target += extra
        # Cutting off at the time limit is not termination: it bootstraps like any other step.
        next_action = np.uint64(0)
        table, coin, counter = toss(rule, counter)
        if not terminated:
            if looks_ahead:
                acting_values(Acting(q, advice, at(weight, step), row), next_state, next_values)
            if rule.update == SARSA:
                next_action, bits, counter, _ = act(
                    rule, next_values, ties, next_state, step, counter
                )
            target = td_target(
                rule, target, discount, q, next_state, next_action, next_values, table, coin, step
            )
        rate = rate_of(rule.learning_rate, counted_row(q, table, state), action, step - 1)
        new = move(q, table, state, action, rate, target)
        if rule.update == Q_LEARNING:
            if not drawn:  # a drawn action was among the highest
                new += advised(advice, at(weight, step - 1), state, action)
                drawn = draws_again(values, ties[state], new, action)
            if drawn:
                ties[state] = bits
        fresh = noted_end(record, next_state, terminated) or length >= limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
        state, action = next_state, next_action
