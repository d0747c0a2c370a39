"""The simulator: episodes of a policy in any kind of task, compiled.

All rollouts draw from their random stream in the same order: one draw for the start, then one for
each step, for the action and (mixed once more) for its outcome.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.planning.greedy import ACTION, greedy_action
from curricle.tasks.kernel import Overloaded, compiled, draw, inlined, integers, splitmix64, uniform
from curricle.tasks.models import Functions, first_state, has_failed, transition, truncated

# -- policies ------------------------------------------------------------------------------------


def policy_action(policy, state, bits):
    """Return the action that a policy takes in a state, drawn with 64 random bits."""


policy_actions = Overloaded(policy_action)


class UniformPolicy(NamedTuple):
    """Takes every action with the same probability."""

    n_actions: np.uint64


class TablePolicy(NamedTuple):
    """Takes actions with given probabilities."""

    cumulative: FloatArray  # (S, A), the last possible action has 1


class GreedyPolicy(NamedTuple):
    """Takes a greedy action, ties broken uniformly."""

    values: Any  # a view of what it is greedy on; numba reserves the name "view"


@policy_actions.body(UniformPolicy)
def _uniform_action(policy, state, bits):
    return integers(bits, policy.n_actions)


@policy_actions.body(TablePolicy)
def _table_action(policy, state, bits):
    action, chance = np.uint64(0), uniform(bits)
    for i in range(np.uint64(policy.cumulative.shape[1] - 1)):
        action += np.uint64(chance >= policy.cumulative[state, i])
    return action


@policy_actions.body(GreedyPolicy)
def _greedy_policy_action(policy, state, bits):
    return greedy_action(policy.values, state, bits) & ACTION


# -- the simulator -------------------------------------------------------------------------------


def record_step(record, n, state, action, reward):
    """Record the n-th step of all episodes: state, action and reward."""


step_records = Overloaded(record_step)


class StepRecord(NamedTuple):
    """Every step, one after the other."""

    states: IntArray  # (n,)
    actions: IntArray  # (n,)
    rewards: FloatArray  # (n,)


class ReturnRecord(NamedTuple):
    """The sum of returns, nothing else."""

    discount: float
    total: FloatArray  # (2,) the sum; the weight of the next reward


@step_records.body(StepRecord)
def _record_all(record, n, state, action, reward):
    record.states[n] = np.int64(state)
    record.actions[n] = np.int64(action)
    record.rewards[n] = reward


@step_records.body(ReturnRecord)
def _record_return(record, n, state, action, reward):
    record.total[0] += record.total[1] * reward
    record.total[1] *= record.discount


@inlined
def simulate_episode(model, policy, state, stream, limit, record, n):
    """Simulate an episode; return the steps of all so far, the last state, whether it terminated.

    It starts in `state`, has at most `limit` steps, and is recorded from the n-th step on.
    """
    last, terminated, stopped = n + limit, False, False
    while n < last and not stopped:
        bits = draw(stream)
        action = policy_action(policy, state, bits)
        next_state, reward, terminated = transition(model, state, action, splitmix64(bits))
        record_step(record, n, state, action, reward)
        state, n = next_state, n + 1
        stopped = terminated or truncated(model)
    return n, state, terminated


class EpisodeEnds(NamedTuple):
    """How each of E episodes ended."""

    lengths: IntArray  # (E,) steps
    last_states: IntArray  # (E,)
    terminated: BoolArray  # (E,)
    truncated: BoolArray  # (E,) by the task itself, not by the limit


def _simulate(model, policy, starts, stream, limit, record, ends):
    n = np.int64(0)
    for episode in range(ends.lengths.shape[0]):
        if has_failed(model):
            break
        if starts.shape[0] > 0:
            state = np.uint64(starts[episode])
        else:
            state = np.uint64(first_state(model, draw(stream)))
        first = n
        n, state, terminated = simulate_episode(model, policy, state, stream, limit, record, n)
        ends.lengths[episode] = n - first
        ends.last_states[episode] = np.int64(state)
        ends.terminated[episode] = terminated
        ends.truncated[episode] = not terminated and truncated(model)


def simulate(
    model: Any,
    policy: UniformPolicy | TablePolicy | GreedyPolicy,
    stream: npt.NDArray[np.uint64],
    *,
    episodes: int,
    limit: int,
    starts: npt.NDArray[np.integer[Any]] | None = None,
) -> tuple[StepRecord, EpisodeEnds]:
    """Return the steps of some episodes, one after the other, and how each ended.

    The model must be open (:func:`open_model`); `stream`, (1,), advances. Each episode has at most
    `limit` steps, and starts in a state of `starts`, (E,), or where the task draws it.
    """
    size = episodes * limit  # memory that no step reaches is never allocated
    record = StepRecord(np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size))
    ends = EpisodeEnds(*np.zeros((2, episodes), np.int64), *np.zeros((2, episodes), np.bool_))
    first = np.zeros(0, np.int64) if starts is None else np.array(starts, np.int64)
    loop = compiled(_simulate, isinstance(model, Functions))
    loop(model, policy, first, stream, limit, record, ends)
    n = int(ends.lengths.sum())
    taken = record.states[:n].copy(), record.actions[:n].copy(), record.rewards[:n].copy()
    return StepRecord(*taken), ends
