"""A guard against harmful potentials: which of two learners acts, and for how many steps.

One learner has the potential, the other learns without it, and both learn from every step
(``train_guarded``). What a harmful potential costs is the steps in which its learner acts and
from which nothing is to be learnt. The guard bounds these: it compares what the learners earn,
turn by turn, and keeps an account of the steps of the learner with the potential for each of two
cases, while it is ahead and while it is not.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatArray, FloatTable
from curricle.checks import number, whole_number
from curricle.errors import SettingError
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
    move,
    shaping_reward,
    state_potential,
    td_target,
    warm_up_checkpoints,
    write_checkpoint,
)
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import at, rate_of
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.draws import STRIDE, splitmix64
from curricle.tasks.generative_models import first_state, has_failed, transition, truncated
from curricle.tasks.overloads import inlined

SCRATCH, SHAPED = 0, 1
"""The learner without the potential and the one with it: the first axis of guarded tables."""
FIRST_TURNS = 2
"""Turns of each learner before they are compared: the fewest that have a variance."""
UNDECIDED = 0.5
"""The share before they are compared. Above it the learner with the potential is ahead."""
TURN, WHOLE = 3.0, 10.0
"""An episode is a turn where it has WHOLE / (1 - discount) steps at most. Elsewhere turns are cut
after TURN / (1 - discount) steps, by when a return has 95 % of its weight."""


@dataclass(frozen=True)
class Guard:
    """Bounds what a harmful potential costs, and keeps the optimum.

    Two learners learn from the same steps: one with the potential, the other without it. They act
    in turns. A turn is an episode; where episodes may last longer than 10 / (1 - discount) steps,
    or without limit, it ends after 3 / (1 - discount) steps. The learner with the higher mean
    discounted return of its last turns is ahead, the one without the potential in doubt: its
    greedy policy is evaluated, and its values are returned.

    While the learner with the potential is ahead it acts in the share of the steps that is the
    probability that it earns more (Student's t with two degrees of freedom, so that few turns say
    little), `share_ahead` at most. Otherwise it acts in the share `share_behind`.

    In T steps, of which it was behind in T0, the learner with the potential acts in no more than

        share_behind T0 + 3 L

    steps of turns that began while it was behind, where L is the length of its longest turn: two
    turns before there is anything to compare, and one on account. This holds for each seed, any
    potential and any task. The other learner acts in at least (1 - share_behind) T0
    + (1 - share_ahead) (T - T0) - 4 L steps, and learns from all T. Both act again and again, and
    what either learns is what it would learn without a guard, so that Q-learning converges to Q*
    under the usual conditions for any potential.

    Parameters
    ----------
    share_behind : float
        Share of the steps for the learner with the potential while it is not ahead, in (0, 0.5].
    share_ahead : float
        Largest share of the steps for it while it is ahead, in (0.5, 1).
    memory : int
        Turns of each learner over which discounted returns are averaged, exponentially; episodes of
        each network.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Guard(share_behind=0.02)
    Guard(share_behind=0.02, share_ahead=0.8, memory=20)
    """

    share_behind: float = 0.05
    share_ahead: float = 0.8
    memory: int = 20

    def __post_init__(self) -> None:
        if number("share_behind of a guard", self.share_behind, SettingError, 0.0, 0.5) == 0.0:
            raise SettingError(
                "share_behind of a guard must be above 0, or the learner with the potential would "
                "never act again: got 0"
            )
        ahead = number("share_ahead of a guard", self.share_ahead, SettingError, 0.5, 1.0)
        if ahead in (0.5, 1.0):
            raise SettingError(
                "share_ahead of a guard must be above 0.5, and below 1 or the learner without the "
                f"potential would never act again: got {ahead:g}"
            )
        whole_number("memory of a guard", self.memory, FIRST_TURNS, SettingError)

    @property
    def kernel(self) -> "GuardKernel":
        """The guard as the compiled loop reads it."""
        return GuardKernel(float(self.share_behind), float(self.share_ahead), 1.0 / self.memory)


class GuardKernel(NamedTuple):
    """A guard, for the compiled loop."""

    share_behind: float
    share_ahead: float
    forgetting: float


class Tally(NamedTuple):
    """What both learners earned in their last turns, averaged exponentially; weights add up to 1.

    Credit is the steps that the learner with the potential may still act in before the other one
    does, while it is behind (0) and while it is ahead (1).
    """

    turns: FloatArray  # (2,)
    mean: FloatArray  # (2,)
    variance: FloatArray  # (2,)
    squares: FloatArray  # (2,) the sum of the squared weights: 1 / the effective sample size
    credit: FloatArray  # (2,)


def empty_tally() -> Tally:
    """Return the tally before the first turn."""
    return Tally(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))


def longest_turn(discount: float, time_limit: int) -> int:
    """Return the steps after which a turn ends, if no episode has ended before."""
    if discount == 1 or time_limit * (1 - discount) <= WHOLE:
        return time_limit
    return round(TURN / (1 - discount))


@inlined
def add_return(tally, learner, earned, forgetting):
    """Add one more return to a learner's average."""
    part = max(forgetting, 1.0 / (tally.turns[learner] + 1.0))
    deviation = earned - tally.mean[learner]
    tally.turns[learner] += 1.0
    tally.mean[learner] += part * deviation
    variance = tally.variance[learner] + part * deviation * deviation
    tally.variance[learner] = (1.0 - part) * variance
    tally.squares[learner] = (1.0 - part) * (1.0 - part) * tally.squares[learner] + part * part


@inlined
def superiority(tally):
    """Return the probability that the learner with the potential earns more; 0 if it has not yet.

    The distribution function of Student's t with two degrees of freedom is
    1/2 + t / (2 sqrt(2 + t^2)). An average of effective sample size n has n - 1 degrees of freedom.
    """
    gain = tally.mean[SHAPED] - tally.mean[SCRATCH]
    if gain <= 0.0:
        return 0.0
    error = tally.variance[SCRATCH] / (1.0 / tally.squares[SCRATCH] - 1.0)
    error += tally.variance[SHAPED] / (1.0 / tally.squares[SHAPED] - 1.0)
    return 0.5 + 0.5 * gain / np.sqrt(2.0 * error + gain * gain)


@inlined
def shaped_share(guard, tally):
    """Return the share of the steps for the learner with the potential."""
    share = superiority(tally)
    return min(share, guard.share_ahead) if share > UNDECIDED else guard.share_behind


@inlined
def next_turn(guard, tally, turn, share):
    """Return the share from here on and the learner that acts next, after a turn.

    `turn` are the learner that acted, its steps and its discounted return; `share` is the one that
    held when the turn began.
    """
    acting, length, earned = turn
    compared = min(tally.turns[SCRATCH], tally.turns[SHAPED]) >= FIRST_TURNS
    if compared:
        case = 1 if share > UNDECIDED else 0
        tally.credit[case] += share * length
        if acting == SHAPED:
            tally.credit[case] -= length
    add_return(tally, acting, earned, guard.forgetting)
    if min(tally.turns[SCRATCH], tally.turns[SHAPED]) < FIRST_TURNS:
        return UNDECIDED, SHAPED if tally.turns[SHAPED] <= tally.turns[SCRATCH] else SCRATCH
    share = shaped_share(guard, tally)
    case = 1 if share > UNDECIDED else 0
    return share, SHAPED if tally.credit[case] > 0.0 else SCRATCH


# -- the loop of two learners ----------------------------------------------------------------------
#
# It handles every update rule and every shaping with the equations of `general_loop.py`. That loop
# and the fast one know nothing of guards, and are neither slower nor longer to compile for them.


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
    tie = splitmix64(counter)
    chosen, bits, counter, _ = choose(rule.exploration, both.values, tie, step, counter)
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
        move(q, table, state, action, rate, target)
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
        if is_spent(budget, record, step, episodes) or has_failed(model):
            return step, episodes, ahead
        if fresh:
            state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
            length, episode_return = 0, 0.0
            begin_episode(both, state, step)
        if fresh or rule.update != SARSA:
            counter = decide(both, acting, rule, state, step, counter)
        action = both.action[acting]
        next_state, reward, terminated = transition(
            model, state, action, splitmix64(both.bits[acting])
        )
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
