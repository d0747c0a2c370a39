"""Exploration by optimism: bonuses of seldom visited pairs, and the loop of the learners with one.

Two tables learn from the same steps. The *optimistic* one, U, contains the bonus and is acted on.
The other, Q, is plain Q-learning: it is evaluated, kept in snapshots and handed on, and no bonus
enters it. Q-learning is off-policy, so Q is none the worse for who acts.

The loop is not the fast one: that would need a second table and one more type to be compiled for.
"""

from typing import NamedTuple

import numpy as np

from curricle.array_types import IntArray
from curricle.learning.exploration import act
from curricle.learning.general_loop import warm_up_checkpoints, write_checkpoint
from curricle.learning.q_learning import set_value
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import rate_of
from curricle.learning.stopping import plain_and_inlined
from curricle.learning.tables import find_row_maxima
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.draws import STRIDE, splitmix64
from curricle.tasks.generative_models import first_state, has_failed, transition, truncated
from curricle.tasks.overloads import Overloaded
from curricle.tasks.simd import of_width


class HoeffdingBonus(NamedTuple):
    """A reward for each step: b(n) = scale sqrt((pairs + ln((n + 1) (n + 2))) / n) at visit n."""

    start: float  # of U above Q before the first visit
    highest: float  # value that U is cut off at where it is bootstrapped from
    scale: float
    log_pairs: float  # ln(S A / failure probability)
    visits: IntArray  # (S, A)


class DecayingOptimism(NamedTuple):
    """A bonus of values: U = X + start / (n + 1)^exponent after n visits."""

    start: float
    highest: float
    exponent: float
    visits: IntArray  # (S, A)


@plain_and_inlined
def hoeffding(bonus, n):
    """Return the reward b(n) that a :class:`HoeffdingBonus` adds at visit n."""
    return bonus.scale * np.sqrt((bonus.log_pairs + np.log((n + 1.0) * (n + 2.0))) / n)


def updated(bonus, old, rate, target, n):
    """Return U(s, a) after visit n, the n-th, from its value before it and its target."""


updates = Overloaded(updated)


@updates.body(HoeffdingBonus)
def _updated_by_hoeffding(bonus, old, rate, target, n):
    return old + rate * (target + hoeffding(bonus, n) - old)


@updates.body(DecayingOptimism)
def _updated_by_decay(bonus, old, rate, target, n):
    plain = old - bonus.start / n**bonus.exponent
    return plain + rate * (target - plain) + bonus.start / (n + 1.0) ** bonus.exponent


def train_optimistically(
    model, horizon, rule, bonus, table, optimistic, evaluation, stream, used, budget, eval_freq,
    record,
):  # fmt: skip
    """Learn in place on `table` and `optimistic`, acting on the latter; fill `record`.

    Both are dense. Return the steps and episodes done. The other arguments are those of
    ``q_learning.train_q_learning``; the learning rate counts visits in the array of the bonus.
    """
    q, best, greedy = of_width(table.q, table.width), table.row_max, table.row_argmax
    u, most, chosen = (
        of_width(optimistic.q, optimistic.width),
        optimistic.row_max,
        optimistic.row_argmax,
    )
    real, visits, highest = q.dtype.type, bonus.visits, bonus.highest
    discount, limit = horizon
    find_row_maxima(table)
    find_row_maxima(optimistic)
    step, episodes, ended, ended_return = used
    value = greedy_return(evaluation, model, table) if step > 0 else np.nan
    checkpoint = warm_up_checkpoints(record, step, eval_freq, value, q, q)
    fresh, state, length, episode_return = True, np.uint64(0), 0, 0.0
    counter = stream[0] + STRIDE
    while True:
        if step == checkpoint * eval_freq:
            so_far = step, episodes, ended, ended_return, greedy_return(evaluation, model, table)
            if write_checkpoint(record, checkpoint, so_far, q, q, budget.stopping):
                return step, episodes
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
        if is_spent(budget, step, episodes) or has_failed(model):
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
        new = real(old + rate * (target - old))
        new_hope = real(updated(bonus, hope, rate, hoped, np.float64(visits[state, action])))
        set_value(q, best, greedy, state, action, new, bits)
        set_value(u, most, chosen, state, action, new_hope, bits)
        step, length, episode_return = step + 1, length + 1, episode_return + reward
        # Cutting off at the time limit is not termination: the targets were bootstrapped.
        ended_here = noted_end(record, next_state, terminated)
        state, fresh = next_state, ended_here or length >= limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
