"""A guard against harmful potentials: a second learner without one, which learns from every step.

Values that are too high correct themselves, since greedy actions try those pairs. Values that are
too low do not: those pairs are avoided, and only a learner without the potential tries them.

The loop is not the general one: it updates two tables with each step, evaluates the one that is
ahead, and chooses which one acts after each episode. In the general loop, all other learning would
need a second table and three more branches, and would take longer to compile.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from curricle.array_types import FloatArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError
from curricle.learning.exploration import choose
from curricle.learning.general_loop import (
    Acting,
    acting_values,
    warm_up_checkpoints,
    write_checkpoint,
)
from curricle.learning.record import is_spent, noted_end
from curricle.learning.schedules import rate_of
from curricle.planning.greedy import highest
from curricle.planning.policy_evaluation import greedy_return
from curricle.tasks.draws import STRIDE, splitmix64
from curricle.tasks.generative_models import first_state, has_failed, transition, truncated
from curricle.tasks.overloads import inlined

MIN_EPISODES = 5
"""Episodes of each learner before they are compared."""
FADING = 0.999
"""Factor, per episode, of the steps counted for each learner."""


@dataclass(frozen=True)
class Guard:
    """Reduces the influence of a potential where it does harm, and keeps the optimum.

    Two Q-learners learn from the same steps: one starts at phi, the other without it. In each
    episode one of them acts. The one with the higher mean discounted return of its last episodes is
    evaluated, and its values are returned; where it is ahead by `standard_errors`, its share of the
    steps grows from episode to episode. Each is Q-learning on plain rewards from its own initial
    values, so both converge to Q* under the usual conditions, for any phi and any shares.

    Parameters
    ----------
    share : float
        First share of the steps for the learner with phi, in [min_share, 1 - min_share].
    min_share : float
        Share that each learner keeps, in (0, 0.5].
    pace : float
        Part of the way to its largest share that the better one gains an episode, in [0, 1].
    standard_errors : float
        Standard errors by which the mean of the better one has to be higher. Where few episodes
        are averaged it takes more, so that two equal learners pass as seldom as they would with
        known variances: at 3 in 0.27 % of comparisons.
    memory : int
        Episodes over which discounted returns are averaged, exponentially.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Guard(min_share=0.2)
    Guard(share=0.5, min_share=0.2, pace=0.003, standard_errors=3.0, memory=20)
    """

    share: float = 0.5
    min_share: float = 0.1
    pace: float = 0.003
    standard_errors: float = 3.0
    memory: int = 20

    def __post_init__(self) -> None:
        min_share = number("min_share of a guard", self.min_share, SettingError, 0.0, 0.5)
        if min_share == 0.0:
            raise SettingError(
                "min_share of a guard must be above 0, or one learner would never act: got 0"
            )
        number("share of a guard", self.share, SettingError, min_share, 1 - min_share)
        number("pace of a guard", self.pace, SettingError, 0.0, 1.0)
        number("standard_errors of a guard", self.standard_errors, SettingError, 0.0)
        whole_number("memory of a guard", self.memory, MIN_EPISODES, SettingError)

    @property
    def kernel(self) -> "GuardKernel":
        """The guard as the compiled loop reads it."""
        return GuardKernel(
            float(self.share),
            float(self.min_share),
            float(self.pace),
            float(self.standard_errors),
            1.0 / self.memory,
        )


class GuardKernel(NamedTuple):
    """A guard, for the compiled loop."""

    share: float
    min_share: float
    pace: float
    standard_errors: float
    forgetting: float


class Returns(NamedTuple):
    """The last discounted returns of both learners, averaged exponentially; weights add up to 1."""

    episodes: FloatArray  # (2,)
    mean: FloatArray  # (2,)
    variance: FloatArray  # (2,)
    squares: FloatArray  # (2,) the sum of the squared weights: 1 / the effective sample size


@inlined
def add_return(returns, learner, returned, forgetting):
    """Add one more return to a learner's average."""
    part = max(forgetting, 1.0 / (returns.episodes[learner] + 1.0))
    deviation = returned - returns.mean[learner]
    returns.episodes[learner] += 1.0
    returns.mean[learner] += part * deviation
    variance = returns.variance[learner] + part * deviation * deviation
    returns.variance[learner] = (1.0 - part) * variance
    returns.squares[learner] = (1.0 - part) * (1.0 - part) * returns.squares[learner] + part * part


@inlined
def least_gain(returns, standard_errors):
    """Return by how much the means of two learners have to differ, squared (Welch 1947).

    An average of effective sample size n has n - 1 degrees of freedom. The quantile of Student's t
    that is as rare as so many standard errors of a normal is Wallace's (1959), within 3 %.
    """
    of_one, of_other = 1.0 / returns.squares[0] - 1.0, 1.0 / returns.squares[1] - 1.0
    error, other = returns.variance[0] / of_one, returns.variance[1] / of_other
    both = error + other
    if both == 0.0:
        return 0.0
    part = error / both
    freedom = 1.0 / (part * part / of_one + (1.0 - part) * (1.0 - part) / of_other)
    normal = standard_errors * (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0)
    return both * freedom * np.expm1(normal * normal / freedom)


@inlined
def compare_learners(guard, returns, ahead, share):
    """Return which learner is ahead and the share of phi's, after an episode."""
    if min(returns.episodes[0], returns.episodes[1]) < MIN_EPISODES:
        return ahead, share
    gain = returns.mean[1] - returns.mean[0]
    ahead = 1 if gain >= 0.0 else 0
    if gain * gain > least_gain(returns, guard.standard_errors):
        goal = 1.0 - guard.min_share if ahead == 1 else guard.min_share
        share += guard.pace * (goal - share)
    return ahead, share


def train_guarded(
    model, horizon, rule, guard, q, evaluation, stream, used, budget, eval_freq, record
):
    """Learn in place on `q` (2, S, A), the second one started at phi; fill `record`.

    Return steps and episodes done and which table is ahead. The other arguments are those of
    ``general_loop.train``.
    """
    discount, limit = horizon
    values, row = np.empty((1, q.shape[2])), np.empty((1, q.shape[2]))
    none = np.empty((0, q.shape[2]))
    returns, acted = Returns(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)), np.zeros(2)
    ahead, share, acting = 1, guard.share, 1
    step, episodes, ended, ended_return = used
    view = Acting(q[1:], none, 0.0, row)
    value = greedy_return(evaluation, model, view) if step > 0 else np.nan
    checkpoint = warm_up_checkpoints(record, step, eval_freq, value, q[1], q[1])
    record.guard_share[:checkpoint] = share
    counter = stream[0] + STRIDE
    fresh, state, length, episode_return = True, np.uint64(0), 0, 0.0
    discounted_return, weight = 0.0, 1.0
    while True:
        if step == checkpoint * eval_freq:
            value = greedy_return(evaluation, model, Acting(q[ahead : ahead + 1], none, 0.0, row))
            record.guard_share[checkpoint] = share
            so_far = step, episodes, ended, ended_return, value
            if write_checkpoint(record, checkpoint, so_far, q[ahead], q[ahead], budget.stopping):
                return step, episodes, ahead
            checkpoint, ended, ended_return = checkpoint + 1, 0, 0.0
        if is_spent(budget, step, episodes) or has_failed(model):
            return step, episodes, ahead
        if fresh:
            state, counter = first_state(model, splitmix64(counter)), counter + STRIDE
            length, episode_return, discounted_return, weight = 0, 0.0, 0.0, 1.0
        acting_values(Acting(q[acting : acting + 1], none, 0.0, row), state, values)
        action, bits, counter = choose(rule.exploration, values, step, counter)
        next_state, reward, terminated = transition(model, state, action, bits)
        rate = rate_of(rule.learning_rate, state, action, step)
        for learner in range(2):
            target = reward
            if not terminated:
                target += discount * np.float64(highest(q[learner], next_state))
            old = np.float64(q[learner, state, action])
            q[learner, state, action] = old + rate * (target - old)
        step, length, episode_return = step + 1, length + 1, episode_return + reward
        # The learners are compared by what the task maximises.
        discounted_return, weight = discounted_return + weight * reward, weight * discount
        ended_here = noted_end(record, next_state, terminated)
        state, fresh = next_state, ended_here or length >= limit or truncated(model)
        if fresh:
            episodes, ended, ended_return = episodes + 1, ended + 1, ended_return + episode_return
            add_return(returns, acting, discounted_return, guard.forgetting)
            ahead, share = compare_learners(guard, returns, ahead, share)
            acted[acting] += length
            acting = 1 if acted[1] <= share * (acted[0] + acted[1]) else 0
            acted *= FADING
