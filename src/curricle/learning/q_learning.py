"""The fast loop: Q-learning without reward shaping, which is Q-initialisation and look-ahead too.

Each row's best value and a greedy action are kept at hand, and looked for again only when the
value was lowered, so that a step scans no row: several times faster than the general loop.
"""

from curricle.learning.judging import greedy_return
from curricle.learning.kernels import JUDGE, write
from curricle.learning.machine import prefetch
from curricle.learning.rows import is_full, place, prepare
from curricle.learning.sampling import act, best_of
from curricle.learning.schedules import at
from curricle.tasks.draws import STRIDE, piece, scramble
from curricle.tasks.dynamics import first_state, transition

FITS = 32_768
"""Bytes of a table that stays in the processor's nearest cache, so that fetching ahead is idle."""


@piece
def update(q, best, greedy, row, action, rate, target, bits):
    """Move q(row, action) towards the target, and what is kept of the row with it."""
    old = q[row, action]
    new = old + rate * (target - old)
    if new != old:
        q[row, action] = new
        if new > best[row]:
            best[row], greedy[row] = new, action
        elif old == best[row] or new == best[row]:
            best[row], greedy[row] = best_of(q, row, bits)


def train_q_learning(
    model, horizon, rule, table, visits, evaluation, stream, budget, every, record
):
    """Learn in place on `table`, fill `record`, return the steps and episodes done.

    `horizon` are the discount and the time limit, `visits` (S, A) counts updates for a harmonic
    learning rate, `stream` (1,) is the run's random stream, `budget` are the steps and episodes
    at which to stop, `every` the steps between checkpoints (checkpoint 0 is before the first
    step). A table without room for another state ends the run before the step that needs it.
    """
    # Arrays leave their tuples here: inside the loop each access would count a reference.
    q, best, greedy = table.q, table.best, table.greedy
    real, limit = q.dtype.type, horizon[1]
    discount = real(horizon[0])
    large = q.nbytes > FITS
    judge = stream ^ JUDGE
    prepare(table)
    step, episodes, checkpoint, ended, ended_return, episode_return = 0, 0, 0, 0, 0.0, 0.0
    counter = stream[0] + STRIDE
    state, last, counter = first_state(model, scramble(counter)), limit, counter + STRIDE
    row = place(table, state)
    while True:
        if step == checkpoint * every:
            value = greedy_return(evaluation, model, table, judge)
            write(record, checkpoint, step, episodes, ended, ended_return, value)
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
        if step >= budget[0] or episodes >= budget[1] or is_full(table, row):
            return step, episodes
        stop = min(checkpoint * every, budget[0])
        while step < stop:
            action, bits, counter = act(rule.exploration, q, best, greedy, row, step, counter)
            next_state, reward, over = transition(model, state, action, scramble(bits))
            target, next_row = real(reward), row
            if not over:
                next_row = place(table, next_state)
                if is_full(table, next_row):
                    row = next_row
                    break
                if large:
                    prefetch(q, next_row)
                target += discount * best[next_row]
            count = step
            if rule.counted:
                count = visits[row, action]
                visits[row, action] += 1
            rate = real(at(rule.learning_rate, count))
            update(q, best, greedy, row, action, rate, target, bits)

            step, episode_return = step + 1, episode_return + reward
            state, row = next_state, next_row
            # Cutting off at the time limit is not termination: the target was bootstrapped.
            if over or step == last:
                ended, ended_return, episode_return = ended + 1, ended_return + episode_return, 0.0
                episodes, last = episodes + 1, step + limit
                if episodes == budget[1]:
                    break
                state, counter = first_state(model, scramble(counter)), counter + STRIDE
                row = place(table, state)
                if is_full(table, row):
                    break
