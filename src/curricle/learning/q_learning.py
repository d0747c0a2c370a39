"""The fast loop: Q-learning without shaping, or with a potential at its start; and R-max.

The maximum of each row and a greedy action are stored with it, and computed anew only when that
value was lowered: most steps scan no row. A portfolio's learners have rows side by side.
"""

from typing import NamedTuple

import numpy as np

from curricle.learning.general_loop import is_spent
from curricle.learning.learners import Visits, explore, optimistic_rate, sober_rate
from curricle.learning.model_based import note_outcome, plan_from
from curricle.learning.portfolio import (
    INFORMED,
    OPTIMIST,
    SOBER,
    SOURCE,
    VISITS,
    Floor,
    add_turn,
    next_member,
    source_is_ahead,
)
from curricle.learning.record import Checkpoint, noted_end
from curricle.learning.schedules import rate_of
from curricle.learning.storage import Change, find_row_maxima, is_full, row_of, update
from curricle.planning.greedy import ACTION, greedy_action, highest
from curricle.planning.policy_evaluation import SLICE, greedy_return
from curricle.tasks.kernel import (
    STRIDE,
    called,
    inlined,
    of_width,
    overloaded,
    prefetch,
    splitmix64,
)
from curricle.tasks.models import first_state, has_failed, transition, truncated

NO_ROW = np.uint64(2**64 - 1)


class Beside(NamedTuple):
    """The table of Q of an optimistic learner, which learns beside the one that is acted on.

    The optimistic values start at the highest value: their greedy actions lead to pairs not tried
    yet. Q starts at the lowest; it is evaluated, kept in snapshots and transferred. Q-learning is
    off-policy, so that Q may learn from actions that the optimistic values choose.
    """

    highest: float  # cuts the values that the optimistic values bootstrap from
    spread: float  # of the values that are possible
    visits: Visits


@overloaded(otherwise=lambda beside, q, number: q.dtype.type(number))
def as_learnt(beside, q, number):
    """Return a number in the precision in which targets are computed."""


@as_learnt.body(Beside)
def _double(beside, q, number):
    return np.float64(number)


class MembersChange(NamedTuple):
    """The targets of a portfolio's members for a pair."""

    action: np.uint64
    bits: np.uint64  # break a tie
    next_state: np.uint64
    reward: float
    informed: float
    optimistic: float
    sober: float
    explores: bool  # whether an optimist acted


@inlined
def update_value(q, best, row, change):
    """Update the pair's value and the row's maximum, as no learner acts on its greedy action."""
    old = q[row, change.action]
    new = q.dtype.type(old + change.rate * (change.target - old))
    if new > best[row]:
        best[row] = new
    elif new < old and old == best[row]:
        best[row] = highest(q, row, (change.action, new))
    q[row, change.action] = new


@inlined
def update_all(table, members, row, change, changes):
    """Update the row of a pair by a change; in a portfolio each member's by theirs."""
    q, best, greedy = of_width(table.q, table.width), table.row_max, table.row_argmax
    if members is None:
        update(q, best, greedy, row, change)
    else:
        action, bits = changes.action, changes.bits
        outcome = changes.next_state, changes.reward
        chosen = optimistic_rate(members.visits, row + VISITS, action, *outcome)
        rate, cautious = q.dtype.type(chosen), q.dtype.type(sober_rate(members.visits, chosen))
        update(q, best, greedy, row + INFORMED, Change(action, rate, changes.informed, bits))
        update(q, best, greedy, row + OPTIMIST, Change(action, rate, changes.optimistic, bits))
        if changes.explores:
            update_value(q, best, row + SOBER, Change(action, cautious, changes.sober, bits))


@overloaded(otherwise=lambda floor, reward, terminated: 0.0)
def lost_after(floor, reward, terminated):
    """Return what the sober learner's values have lost by the lowest rewards so far."""


@lost_after.body(Floor)
def _lost_after(floor, reward, terminated):
    if reward < floor.least[np.uint64(terminated)]:
        floor.least[np.uint64(terminated)] = reward
        going, ending = floor.least
        floor.lost[0] = (floor.horizon - 1.0) * going + min(going, ending)
    return floor.lost[0]


@inlined
def acting_on(members, table, member, row, state, bits):
    """Return a greedy action of a portfolio's member in a state, whose first row is `row`."""
    # The optimists' greedy actions are kept. The others act seldom, and draw among ties here.
    if member == SOURCE:
        return greedy_action(members.source, state, bits) & ACTION
    if member == SOBER:
        return greedy_action(members.sober, state, bits) & ACTION
    return np.uint64(table.row_argmax[row + member]) & ACTION


def train_q_learning(model, rule, tables, course):
    """Learn in place on a table, fill the record, return the steps and episodes done.

    `tables` are the table that is acted on, that which is evaluated, and a :class:`Beside`, the
    :class:`Members` of a portfolio and a :class:`LearntModel`, or None. A full table ends the run
    before the step that needs another row.
    """
    return learn_fast(model, rule, tables, tables[2], tables[3], tables[4], course)


@inlined  # so that no reference to an array is counted, which takes time to run and to compile
def learn_fast(model, rule, tables, beside, members, learnt_model, course):
    """Learn as :func:`train_q_learning` says."""
    # Numba leaves out what is done with an argument that is None.
    #
    # Rows of a far table arrive late from memory. There the update of a step is made during the
    # next one, before anything it changes is read, so that results are the same.
    table, learnt, record = tables[0], tables[1], course.record
    if beside is not None or learnt_model is not None:
        find_row_maxima(learnt)
    q, best, greedy = of_width(table.q, table.width), table.row_max, table.row_argmax
    far = len(table.far) > 0 and learnt_model is None
    limit, eval_freq = course.limit, course.eval_freq
    discount, nothing = as_learnt(beside, q, course.discount), as_learnt(beside, q, 0.0)
    if members is not None:
        find_row_maxima(members.source)
    find_row_maxima(table)
    step = episodes = ended = checkpoint = np.int64(0)  # a literal would be a type of its own
    ended_return, episode_return, counter = 0.0, 0.0, course.stream + STRIDE
    state, last, counter = first_state(model, splitmix64(counter)), step + limit, counter + STRIDE
    row = row_of(table, state, False)
    none = np.uint64(0)
    change, changes = Change(none, nothing, nothing, none), None
    if members is not None:
        changes = MembersChange(none, none, none, 0.0, nothing, nothing, nothing, True)
    pending = NO_ROW
    share = agreement = np.nan
    acting, start, begun, earned, factor = SOURCE, state, step, 0.0, 1.0
    while True:
        if step == checkpoint * eval_freq:
            if members is not None:
                leads = source_is_ahead(members.tally)
                share, learnt = np.float64(leads), members.source if leads else members.sober
            value = greedy_return(course.evaluation, model, learnt)
            if beside is not None:
                first = row_of(table, start, False)
                apart = np.float64(best[first]) - np.float64(learnt.row_max[first])
                agreement = 1.0 - apart / beside.spread
            curves = ended, ended_return, value, share, agreement
            reached = Checkpoint(checkpoint, step, episodes, *curves)
            noted = record, course.stopping, reached, learnt.q, learnt.q
            if called(course.noting, noted) > 0.0:
                return step, episodes
            checkpoint += 1
            ended, ended_return = 0, 0.0
        if is_spent(course, step, episodes) or is_full(table, row) or has_failed(model):
            return step, episodes
        # Numba compiles `min` by a function of its own, once more for each combination of types.
        stop, slice_ends = checkpoint * eval_freq, step - step % SLICE + SLICE
        stop = stop if stop < course.steps else course.steps
        stop = stop if stop < slice_ends else slice_ends
        while step < stop:
            if members is None:
                drawn = explore(rule.exploration, q, row, best[row], step, counter)
                action, bits, counter, exploits = drawn
                if exploits:
                    action = np.uint64(greedy[row]) & ACTION
            else:
                bits, counter = splitmix64(counter), counter + STRIDE
                action = acting_on(members, table, acting, row, state, bits)
                if far:  # of these rows the next update reads this pair alone, as a rule
                    for kept in (SOBER, VISITS):
                        prefetch(members.pairs, (row + kept) * np.uint64(q.shape[1]) + action)
            next_state, reward, terminated = transition(model, state, action, splitmix64(bits))
            next_row = row_of(table, next_state, terminated)
            if far:
                prefetch(q, next_row)  # that of the informed optimist, in a portfolio
                if members is not None:
                    prefetch(q, next_row + OPTIMIST)
                    prefetch(best, next_row)
                    prefetch(greedy, next_row)
            if pending != NO_ROW:
                update_all(table, members, pending, change, changes)
                pending = NO_ROW
            if is_full(table, next_row):
                row = next_row
                break
            if learnt_model is not None:
                note_outcome(learnt_model, state, action, reward, next_state, terminated)
                if learnt_model.pairs[state, action].visits >= learnt_model.min_visits:
                    for plan in learnt_model.plans:
                        plan_from(learnt_model, plan, course.discount, state, action, bits)
            elif members is None:
                target = as_learnt(beside, q, reward)
                if beside is not None and beside.visits.horizon > 0.0:
                    rate = optimistic_rate(beside.visits, row, action, next_state, reward)
                    cautious = sober_rate(beside.visits, rate)
                else:
                    rate = as_learnt(beside, q, rate_of(rule.learning_rate, row, action, step))
                    cautious = rate
                if not terminated:
                    after = as_learnt(beside, q, best[next_row])
                    if beside is not None and not after < beside.highest:
                        after = beside.highest  # rewards at discount 1 could raise optimism too far
                    target += discount * after
                change = Change(action, rate, target, bits)
            if beside is not None:
                target = reward
                if not terminated:
                    target += discount * np.float64(learnt.row_max[next_row])
                of_q = of_width(learnt.q, learnt.width)
                sober_change = Change(action, cautious, target, bits)
                update(of_q, learnt.row_max, learnt.row_argmax, row, sober_change)
            if members is not None:
                floor = q.dtype.type(lost_after(members.floor, reward, terminated))
                informed = optimistic = q.dtype.type(reward)
                sober = informed - floor
                if not terminated:
                    most = q.dtype.type(members.highest)
                    after, other = best[next_row + INFORMED], best[next_row + OPTIMIST]
                    informed += discount * (after if after < most else most)
                    optimistic += discount * (other if other < most else most)
                    sober += discount * (best[next_row + SOBER] + floor)
                targets = informed, optimistic, sober
                changes = MembersChange(action, bits, next_state, reward, *targets, acting < SOBER)
            ends = noted_end(record, next_state, terminated) or step + 1 == last or truncated(model)
            if far and not ends and next_row != row and step + 1 < stop:
                pending = row
            elif learnt_model is None:
                update_all(table, members, row, change, changes)
            step, episode_return = step + 1, episode_return + reward
            state, row = next_state, next_row
            if members is not None:  # the members are compared by what the task maximises
                earned, factor = earned + factor * reward, factor * course.discount
                if ends or step - begun >= course.turn:
                    add_turn(members.tally, acting, step - begun, earned)
                    acting = next_member(members.shares, members.tally)
                    begun, earned, factor = step, 0.0, 1.0
            # Cutting off at the time limit is not termination: the target was bootstrapped.
            if ends:
                ended, ended_return, episode_return = ended + 1, ended_return + episode_return, 0.0
                episodes, last = episodes + 1, step + limit
                if episodes == course.episodes:
                    break
                state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
                row, start = row_of(table, state, False), state
                if is_full(table, row) or has_failed(model):
                    break
