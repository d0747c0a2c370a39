"""The fast loop: Q-learning on unshaped rewards, as for Q-initialisation and look-ahead advice.

The maximum of each row and a greedy action are stored with it, and computed anew only when that
value was lowered: most steps scan no row.
"""

import numpy as np

from curricle.learning.general_loop import is_spent, note_all
from curricle.learning.learners import act
from curricle.learning.record import noted_end
from curricle.learning.schedules import rate_of
from curricle.learning.storage import OptimisticTables, find_row_maxima, is_full, row_of
from curricle.planning.greedy import TIED, best_of
from curricle.planning.policy_evaluation import SLICE, greedy_return
from curricle.tasks.kernel import STRIDE, Overloaded, inlined, of_width, prefetch, splitmix64
from curricle.tasks.models import first_state, has_failed, transition, truncated

NO_ROW = np.uint64(2**64 - 1)


@inlined
def update(q, best, greedy, row, change):
    """Move q(row, action) towards the target, and update the row's maximum and greedy action.

    `change` are the action, the learning rate, the target and 64 bits that break a tie.
    """
    action, rate, target, bits = change
    old = q[row, action]
    new = q.dtype.type(old + rate * (target - old))
    if new != old:
        q[row, action] = new
        if new > best[row]:
            best[row], greedy[row] = new, action
        elif old == best[row] or new == best[row]:
            best[row], greedy[row] = best_of(q, row, bits)
    elif np.uint64(greedy[row]) == action | TIED:
        greedy[row] = best_of(q, row, bits)[1]  # each visit draws afresh among several


# -- what an optimistic learner does otherwise -----------------------------------------------------
#
# Two tables learn from the same steps. The optimistic one, U, starts at the highest value and is
# acted on: its greedy actions lead into what was not tried yet. The other, Q, starts at the lowest;
# it is evaluated, kept in snapshots and transferred. Q-learning is off-policy, so Q is none the
# worse for who acts.


def acted_on(table):
    """Return the table that is acted on."""


def evaluated(table):
    """Return the table that is evaluated."""


def as_learnt(table, number):
    """Return a number in the precision in which targets are computed."""


def cut_off(table, value):
    """Return the value to bootstrap from: rewards at discount 1 could raise optimism too far."""


def learn_beside(table, reward, bootstraps, next_row, row, change):
    """Update the table that is evaluated where it is not the one that is acted on."""


acted_tables = Overloaded(acted_on, otherwise=lambda table: table)
evaluated_tables = Overloaded(evaluated, otherwise=lambda table: table)
precisions = Overloaded(as_learnt, otherwise=lambda table, number: table.q.dtype.type(number))
cuts = Overloaded(cut_off, otherwise=lambda table, value: value)
besides = Overloaded(
    learn_beside, otherwise=lambda table, reward, bootstraps, next_row, row, change: None
)


@acted_tables.body(OptimisticTables)
def _optimistic_values(table):
    return table.hoped


@evaluated_tables.body(OptimisticTables)
def _values_beside(table):
    return table.learnt


@precisions.body(OptimisticTables)
def _double(table, number):
    return np.float64(number)


@cuts.body(OptimisticTables)
def _cut_at_highest(table, value):
    return np.float64(value) if value < table.highest else table.highest


@besides.body(OptimisticTables)
def _learn_values_beside(table, reward, bootstraps, next_row, row, change):
    learnt, (action, rate, target, bits) = table.learnt, change
    q, target = of_width(learnt.q, learnt.width), reward
    if bootstraps > 0.0:
        target += bootstraps * np.float64(learnt.row_max[next_row])
    update(q, learnt.row_max, learnt.row_argmax, row, (action, rate, target, bits))


# -- the loop ------------------------------------------------------------------------------------


def train_q_learning(model, rule, table, course):
    """Learn in place on `table`, fill the record, return the steps and episodes done.

    A full table ends the run before the step that needs another row.
    """
    return learn_fast(model, rule, table, course)


@inlined  # so that no reference to an array is counted, which takes time to run and to compile
def learn_fast(model, rule, table, course):
    """Do what :func:`train_q_learning` says."""
    # Rows of a far table arrive late from memory. There the update of a step is made during the
    # next one, before anything it changes is read, so that results are the same.
    acting, record = acted_on(table), course.record
    q, best, greedy = of_width(acting.q, acting.width), acting.row_max, acting.row_argmax
    limit, eval_freq, far = course.limit, course.eval_freq, len(acting.far) > 0
    discount, nothing = as_learnt(table, course.discount), as_learnt(table, 0.0)
    find_row_maxima(table)
    step, episodes, ended, ended_return = course.used
    early, checkpoint = step > 0, np.int64(0)  # a literal would be a type of its own
    episode_return, counter = 0.0, course.stream + STRIDE
    state, last, counter = first_state(model, splitmix64(counter)), step + limit, counter + STRIDE
    row = row_of(table, state, False)
    pending, pending_change = NO_ROW, (np.uint64(0), nothing, nothing, np.uint64(0))
    while True:
        if early or step == checkpoint * eval_freq:
            learnt = evaluated(table)
            value = greedy_return(course.evaluation, model, learnt)
            so_far = step, episodes, ended, ended_return, value, np.nan
            checkpoint, ends = note_all(course, early, checkpoint, so_far, learnt.q, learnt.q)
            if ends:
                return step, episodes
            if early:
                early = False
                continue
            ended, ended_return = 0, 0.0
        if is_spent(course, step, episodes) or is_full(table, row) or has_failed(model):
            return step, episodes
        # Numba compiles `min` by a function of its own, once more for each combination of types.
        stop, slice_ends = checkpoint * eval_freq, step - step % SLICE + SLICE
        stop = stop if stop < course.steps else course.steps
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
            target, rate = as_learnt(table, reward), rate_of(rule.learning_rate, row, action, step)
            if not terminated:
                target += discount * cut_off(table, best[next_row])
            change = action, as_learnt(table, rate), target, bits
            learn_beside(table, reward, 0.0 if terminated else discount, next_row, row, change)
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
                if episodes == course.episodes:
                    break
                state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
                row = row_of(table, state, False)
                if is_full(table, row) or has_failed(model):
                    break
        if pending != NO_ROW:
            update(q, best, greedy, pending, pending_change)
            pending = NO_ROW
