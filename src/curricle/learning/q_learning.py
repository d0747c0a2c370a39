"""The fast loop: Q-learning on unshaped rewards, as for Q-initialisation and look-ahead advice.

The maximum of each row and a greedy action are stored with it, and computed anew only when that
value was lowered. Most steps scan no row: several times faster than the general loop.
"""

import numpy as np

from curricle.learning.exploration import act
from curricle.learning.general_loop import note_all
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import rate_of
from curricle.learning.storage import find_row_maxima, is_full, row_of
from curricle.planning.greedy import TIED, best_of
from curricle.planning.policy_evaluation import SLICE, greedy_return
from curricle.tasks.draws import STRIDE, splitmix64
from curricle.tasks.generative_models import first_state, has_failed, transition, truncated
from curricle.tasks.overloads import inlined
from curricle.tasks.simd import of_width, prefetch

NO_ROW = np.uint64(2**64 - 1)


@inlined
def set_value(q, best, greedy, row, action, new, bits):
    """Set q(row, action), and update the row's maximum and greedy action; `bits` break a tie."""
    old = q[row, action]
    if new != old:
        q[row, action] = new
        if new > best[row]:
            best[row], greedy[row] = new, action
        elif old == best[row] or new == best[row]:
            best[row], greedy[row] = best_of(q, row, bits)
    elif np.uint64(greedy[row]) == action | TIED:
        greedy[row] = best_of(q, row, bits)[1]  # each visit draws afresh among several


@inlined
def update(q, best, greedy, row, change):
    """Move q(row, action) towards the target, and update the row's maximum and greedy action.

    `change` are the action, the learning rate, the target and 64 bits that break a tie.
    """
    action, rate, target, bits = change
    old = q[row, action]
    set_value(q, best, greedy, row, action, old + rate * (target - old), bits)


def train_q_learning(model, rule, table, course):
    """Learn in place on `table`, fill the record, return the steps and episodes done.

    A full table ends the run before the step that needs another row.
    """
    return learn_fast(model, rule, table, course)


@inlined  # so that no reference to an array is counted, which takes time to run and to compile
def learn_fast(model, rule, table, course):
    """Do what :func:`train_q_learning` says.

    Rows of a far table arrive late from memory. There the update of a step is made during the next
    one, before anything it changes is read, so that results are the same.
    """
    q, best, greedy = of_width(table.q, table.width), table.row_max, table.row_argmax
    real, limit, eval_freq = q.dtype.type, course.limit, course.eval_freq
    discount, far, record, budget = (
        real(course.discount),
        len(table.far) > 0,
        course.record,
        course.bounds,
    )
    find_row_maxima(table)
    step, episodes, ended, ended_return = course.used
    early, checkpoint = step > 0, np.int64(0)  # a literal would be a type of its own
    episode_return, counter = 0.0, course.stream + STRIDE
    state, last, counter = first_state(model, splitmix64(counter)), step + limit, counter + STRIDE
    row = row_of(table, state, False)
    pending, pending_change = NO_ROW, (np.uint64(0), real(0.0), real(0.0), np.uint64(0))
    while True:
        if early or step == checkpoint * eval_freq:
            value = greedy_return(course.evaluation, model, table)
            so_far = step, episodes, ended, ended_return, value, np.nan
            checkpoint, ends = note_all(course, early, checkpoint, so_far, q, q)
            if ends:
                return step, episodes
            if early:
                early = False
                continue
            ended, ended_return = 0, 0.0
        if is_spent(budget, record, step, episodes) or is_full(table, row) or has_failed(model):
            return step, episodes
        # Numba compiles `min` by a function of its own, once more for each combination of types.
        stop, slice_ends = checkpoint * eval_freq, step - step % SLICE + SLICE
        stop = stop if stop < budget.steps else budget.steps
        stop = stop if stop < slice_ends else slice_ends
        while step < stop:
            action, bits, counter = act(rule.exploration, q, best, greedy, row, step, counter)
            next_state, reward, terminated = transition(model, state, action, splitmix64(bits))
            next_row = row_of(table, next_state, terminated)
            if is_full(table, next_row):
                row = next_row
                break
            if far:
                prefetch(q, next_row)
            if pending != NO_ROW:
                update(q, best, greedy, pending, pending_change)
                pending = NO_ROW
            target = real(reward)
            if not terminated:
                target += discount * best[next_row]
            change = action, real(rate_of(rule.learning_rate, row, action, step)), target, bits
            ends = noted_end(record, next_state, terminated) or step + 1 == last or truncated(model)
            if far and not ends and next_row != row:
                pending, pending_change = row, change
            else:
                update(q, best, greedy, row, change)

            step, episode_return = step + 1, episode_return + reward
            state, row = next_state, next_row
            # Cutting off at the time limit is not termination: the target was bootstrapped.
            if ends:
                ended, ended_return, episode_return = ended + 1, ended_return + episode_return, 0.0
                episodes, last = episodes + 1, step + limit
                if episodes == budget.episodes:
                    break
                state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
                row = row_of(table, state, False)
                if is_full(table, row) or has_failed(model):
                    break
        if pending != NO_ROW:
            update(q, best, greedy, pending, pending_change)
            pending = NO_ROW
