"""The guarded loop: two learners, one of them without a potential, learn from one stream of steps.

It handles every update rule and every shaping with the equations of ``general_loop.py``. That loop
and the fast one know nothing of guards, and are neither slower nor longer to compile for them.
"""

from typing import Any, NamedTuple

import numpy as np

from curricle.array_types import FloatArray, FloatTable
from curricle.learning.exploration import choose
from curricle.learning.general_loop import (
    ADVICE,
    DOUBLE_Q_LEARNING,
    SARSA,
    STATE,
    Acting,
    ShapingKernel,
    acting_values,
    counted_row,
    shaping_reward,
    state_potential,
    td_target,
    warm_up_checkpoints,
    write_checkpoint,
)
from curricle.learning.guard import SCRATCH, SHAPED, UNDECIDED, next_turn
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import at, rate_of
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.draws import STRIDE, splitmix64
from curricle.tasks.generative_models import first_state, has_failed, transition, truncated
from curricle.tasks.overloads import inlined


class TwoLearners(NamedTuple):
    """The learner without the potential, and the one with it; n tables each (SCRATCH, SHAPED)."""

    q: FloatTable  # (2, n, S, A)
    shapings: tuple[ShapingKernel, ShapingKernel]  # the first adds nothing
    carried: FloatArray  # (2,) what each shaping carries from step to step
    action: Any  # (2,) uint64, what each would do in the present state
    bits: Any  # (2,) uint64, for the outcome of that action
    values: FloatArray  # (1, A) work space

    @classmethod
    def starting(cls, q: FloatTable, nothing: ShapingKernel, shaping: ShapingKernel) -> Any:
        """Return the learners before their first step, on tables that have their first values."""
        none = np.zeros(2, np.uint64)
        work = np.zeros((1, q.shape[3]))
        return cls(q, (nothing, shaping), np.zeros(2), none, none.copy(), work)


@inlined
def write_values(both, learner, state, step):
    """Write the values that a learner acts on in a state into ``both.values``."""
    shaping = both.shapings[learner]
    phi = shaping.pair_values
    advice = phi[: phi.shape[0] if shaping.kind == ADVICE else 0]
    view = Acting(both.q[learner], advice, at(shaping.weight, step), both.values)
    acting_values(view, state, both.values)


@inlined
def decide(both, learner, rule, state, step, counter):
    """Draw what a learner does in a state, and return the stream's counter."""
    write_values(both, learner, state, step)
    chosen, bits, counter = choose(rule.exploration, both.values, step, counter)
    both.action[learner], both.bits[learner] = chosen, bits
    return counter


@inlined
def begin_episode(both, state, step):
    """Set what the shapings carry into the first step."""
    for learner in range(2):
        both.carried[learner] = 0.0
        if both.shapings[learner].kind == STATE:
            both.carried[learner] = state_potential(both.shapings[learner], state, step)


@inlined
def learn_from(both, rule, discount, taken, step, counter):
    """Update both learners by a step, the `step`-th, and return the stream's counter.

    `taken` are the state, action, reward, next state and whether it ended the episode. For SARSA
    each learner draws its own next action: what it would do, not what the other one does, is what
    its values are of.
    """
    state, action, reward, next_state, terminated = taken
    table, coin = 0, np.uint64(0)
    if rule.update == DOUBLE_Q_LEARNING:
        coin, counter = splitmix64(counter), counter + STRIDE
        table = np.int64(coin & np.uint64(1))
    row = counted_row(both.q[SCRATCH], table, state)
    rate = rate_of(rule.learning_rate, row, action, step - 1)
    for learner in range(2):
        q = both.q[learner]
        extra, carried = shaping_reward(
            both.shapings[learner],
            discount,
            state,
            action,
            next_state,
            terminated,
            step,
            both.carried[learner],
        )
        both.carried[learner] = carried
        target = reward + extra
        # Cutting off at the time limit is not termination: it bootstraps like any other step.
        if not terminated:
            write_values(both, learner, next_state, step)
            if rule.update == SARSA:
                counter = decide(both, learner, rule, next_state, step, counter)
            target = td_target(
                rule,
                target,
                discount,
                q,
                next_state,
                both.action[learner],
                both.values,
                table,
                coin,
                step,
            )
        old = np.float64(q[table, state, action])
        q[table, state, action] = old + rate * (target - old)
    return counter


def train_guarded(
    model, horizon, rule, guard, tally, both, evaluation, stream, used, budget, eval_freq, record
):
    """Learn in place on ``both.q``; fill `record`.

    Return steps and episodes done and the learner that is ahead. `horizon` are the discount, the
    time limit and the longest turn. The other arguments are those of ``general_loop.train``.
    """
    discount, limit, longest = horizon
    row, last = np.empty((1, both.q.shape[3])), both.q.shape[1] - 1
    phi, weights = both.shapings[SHAPED].pair_values, both.shapings[SHAPED].weight
    advices = phi[:0], phi[: phi.shape[0] if both.shapings[SHAPED].kind == ADVICE else 0]
    share, ahead, acting = UNDECIDED, SCRATCH, SHAPED
    step, episodes, ended, ended_return = used
    value = np.nan
    if step > 0:
        value = greedy_return(evaluation, model, Acting(both.q[ahead], advices[0], 0.0, row))
    checkpoint = warm_up_checkpoints(
        record, step, eval_freq, value, both.q[ahead, 0], both.q[ahead, last]
    )
    record.guard_share[:checkpoint] = share
    counter = stream[0] + STRIDE
    fresh, state, length, episode_return = True, np.uint64(0), 0, 0.0
    turn_length, earned, factor = 0, 0.0, 1.0
    while True:
        if step == checkpoint * eval_freq:
            q = both.q[ahead]
            view = Acting(q, advices[ahead], at(weights, step), row)
            record.guard_share[checkpoint] = share
            so_far = step, episodes, ended, ended_return, greedy_return(evaluation, model, view)
            if write_checkpoint(record, checkpoint, so_far, q[0], q[last], budget.stopping):
                return step, episodes, ahead
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
        if is_spent(budget, step, episodes) or has_failed(model):
            return step, episodes, ahead
        if fresh:
            state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
            length, episode_return = 0, 0.0
            begin_episode(both, state, step)
        if fresh or rule.update != SARSA:
            counter = decide(both, acting, rule, state, step, counter)
        action = both.action[acting]
        next_state, reward, terminated = transition(model, state, action, both.bits[acting])
        step, length, episode_return = step + 1, length + 1, episode_return + reward
        taken = state, action, reward, next_state, terminated
        counter = learn_from(both, rule, discount, taken, step, counter)
        # The learners are compared by what the task maximises.
        turn_length, earned, factor = turn_length + 1, earned + factor * reward, factor * discount
        ended_here = noted_end(record, next_state, terminated)
        state, fresh = next_state, ended_here or length >= limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
        if fresh or turn_length >= longest:
            share, acting = next_turn(guard, tally, (acting, turn_length, earned), share)
            ahead = SHAPED if share > UNDECIDED else SCRATCH
            turn_length, earned, factor = 0, 0.0, 1.0
