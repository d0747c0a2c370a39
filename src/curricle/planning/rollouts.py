"""Rollouts: episodes of any policy in any kind of task, compiled; a single one, and random ones.

All rollouts draw from their random stream in the same order: one draw for the start, then one
for each step, for the action and (mixed once more) for its outcome.
"""

import math
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.planning.greedy import ACTION, Values, greedy_action
from curricle.planning.solution import checked_policy
from curricle.tasks.kernel import (
    compiled,
    draw,
    inlined,
    integers,
    overloaded,
    splitmix64,
    stream_start,
    uniform,
)
from curricle.tasks.live import is_live, open_model
from curricle.tasks.mdp import GenerativeModel, Task, available_actions, generative_model
from curricle.tasks.models import (
    cumulated,
    first_state,
    has_failed,
    has_users_code,
    permitted,
    transition,
    truncated,
)
from curricle.text import brief_repr

# -- policies ------------------------------------------------------------------------------------


@overloaded()
def policy_action(policy, state, bits):
    """Return the action that a policy takes in a state, drawn with 64 random bits."""


class UniformPolicy(NamedTuple):
    """Takes every available action with the same probability."""

    n_actions: np.uint64


class TablePolicy(NamedTuple):
    """Takes actions with given probabilities."""

    cumulative: FloatArray  # (S, A), the last possible action has 1


class GreedyPolicy(NamedTuple):
    """Takes a greedy action, ties broken uniformly."""

    values: Any  # a view of what it is greedy on; numba reserves the name "view"


@policy_action.body(UniformPolicy)
def _uniform_action(policy, state, bits):
    return integers(bits, policy.n_actions)


@policy_action.body(TablePolicy)
def _table_action(policy, state, bits):
    action, chance = np.uint64(0), uniform(bits)
    for i in range(np.uint64(policy.cumulative.shape[1] - 1)):
        action += np.uint64(chance >= policy.cumulative[state, i])
    return action


@policy_action.body(GreedyPolicy)
def _greedy_policy_action(policy, state, bits):
    return greedy_action(policy.values, state, bits) & ACTION


# -- the simulator -------------------------------------------------------------------------------


@overloaded()
def record_step(record, n, state, action, reward):
    """Record the n-th step of all episodes: state, action and reward."""


class StepRecord(NamedTuple):
    """Every step, one after the other."""

    states: IntArray  # (n,)
    actions: IntArray  # (n,)
    rewards: FloatArray  # (n,)


class ReturnRecord(NamedTuple):
    """The sum of returns, nothing else."""

    discount: float
    total: FloatArray  # (2,) the sum; the weight of the next reward


@record_step.body(StepRecord)
def _record_all(record, n, state, action, reward):
    record.states[n] = np.int64(state)
    record.actions[n] = np.int64(action)
    record.rewards[n] = reward


@record_step.body(ReturnRecord)
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
        action = permitted(model, state, policy_action(policy, state, bits), bits)
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
    model: object,
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
    loop = compiled(_simulate, has_users_code(model))
    loop(model, policy, first, stream, limit, record, ends)
    n = int(ends.lengths.sum())
    taken = record.states[:n].copy(), record.actions[:n].copy(), record.rewards[:n].copy()
    return StepRecord(*taken), ends


ROLLOUTS, LENGTH = 100, 200  # random rollouts that measure a task's speed; one in a live task
MOST_PAIRS = 100_000_000  # table entries for rollouts: memory is reserved, little of it used


def random_step_seconds(task: object) -> float:
    """Return the seconds that a random step of a task with states takes."""
    generative = generative_model(task)
    shape = generative.states.size, generative.actions.size
    stream = np.zeros(1, np.uint64)
    # With equal values every action is greedy. This also compiles the loop for a report's episodes.
    policy = (
        GreedyPolicy(Values(frozen(np.zeros(shape))))
        if math.prod(shape) <= MOST_PAIRS
        else UniformPolicy(np.uint64(shape[1]))
    )
    with open_model(generative, 0) as model:
        simulate(model, policy, stream, episodes=1, limit=1)  # compiles
        started, episodes = time.perf_counter(), 1 if is_live(task) else ROLLOUTS
        steps, _ = simulate(model, policy, stream, episodes=episodes, limit=LENGTH)
        return (time.perf_counter() - started) / max(1, len(steps.states))


# -- a single episode, and random ones -------------------------------------------------------------


CHUNK = 65_536  # steps of one long episode that are simulated at a time


@dataclass(frozen=True, eq=False)
class Trajectory(Frozen):
    """One episode of n steps.

    Attributes
    ----------
    states : (n + 1,) int64
        From the start to the state reached last.
    actions : (n,) int64
    rewards : (n,) float64
    terminated : bool
        Whether it ended in a terminal state.
    truncated : bool
        Whether it was cut off instead (time limit, `steps`, or by a live task itself).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> rollout(GridWorld("S.T"), [1, 1, 0]).discounted_return(0.5)
    98.5
    """

    states: IntArray
    actions: IntArray
    rewards: FloatArray
    terminated: bool
    truncated: bool

    __repr__ = brief_repr

    def __len__(self) -> int:
        return len(self.actions)

    def discounted_return(self, discount: float) -> float:
        """Return sum_t gamma^t r_t."""
        return float(self.rewards @ discount ** np.arange(len(self.rewards)))


def rollout(
    task: Task,
    policy: npt.ArrayLike,
    *,
    seed: int = 0,
    start: int | None = None,
    steps: int | None = None,
) -> Trajectory:
    """Return one episode of a policy.

    Parameters
    ----------
    task : Task
        A live task is played in a new environment.
    policy : (S,) int array or (S, A) float array
        As in :func:`evaluate`.
    seed : int
    start : int, optional
        First state; by default, and always in a live task, drawn as episodes start.
    steps : int, optional
        Steps after which the episode is cut off; by default the task's time limit.

    Raises
    ------
    SettingError
        When the policy is malformed, the start is no state, is terminal or cannot be chosen, or
        there is no limit.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> episode = rollout(GridWorld("S.T"), [1, 1, 0])
    >>> episode.states, episode.rewards, episode.terminated
    (array([0, 1, 2]), array([ -1., 199.]), True)
    """
    generative = generative_model(task)
    n_states, n_actions = generative.states.size, generative.actions.size
    terminal = generative.terminal
    known = np.zeros(n_states, dtype=bool) if terminal is None else terminal
    checked = checked_policy(policy, known, n_actions, available_actions(task))
    if checked.ndim == 2:
        probabilities = TablePolicy(cumulated(checked.astype(np.float64, copy=False)))
        return _trajectory(generative, probabilities, seed, steps, start)
    # The policy is made greedy on values of 1, to share a compiled loop with greedy policies.
    values = np.zeros((n_states, n_actions))
    values[np.arange(n_states), checked] = 1.0
    return _trajectory(generative, GreedyPolicy(Values(frozen(values))), seed, steps, start)


def greedy_rollout(
    task: Task, view: object, *, seed: int = 0, steps: int | None = None
) -> Trajectory:
    """Return one episode of the policy that is greedy on a view of values, ties drawn uniformly."""
    return _trajectory(generative_model(task), GreedyPolicy(view), seed, steps)


def _trajectory(
    generative: GenerativeModel,
    policy: TablePolicy | GreedyPolicy,
    seed: int,
    steps: int | None,
    start: int | None = None,
) -> Trajectory:
    """Return one episode of a policy as the simulator reads it."""
    remaining = generative.time_limit if steps is None else steps
    remaining = whole_number("the limit of a rollout in steps", remaining, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    starts = None if start is None else _start(generative, start)
    first = stream_start(seed, "rollout")
    stream, parts = np.array([first], np.uint64), list[StepRecord]()
    with open_model(generative, first) as model:
        while True:
            limit = min(remaining, CHUNK)
            part, ends = simulate(model, policy, stream, episodes=1, limit=limit, starts=starts)
            parts.append(part)
            remaining, starts = remaining - limit, ends.last_states
            if ends.terminated[0] or ends.truncated[0] or not remaining:
                break
    states, actions, rewards = (np.concatenate(part) for part in zip(*parts, strict=True))
    states, terminated = np.append(states, ends.last_states), bool(ends.terminated[0])
    return Trajectory(frozen(states), frozen(actions), frozen(rewards), terminated, not terminated)


def _start(task: GenerativeModel, start: int) -> IntArray:
    """Return the state that an episode starts in, (1,), or raise SettingError if it cannot."""
    if is_live(task):
        raise SettingError(f"a live task's environment chooses the start: got start {start!r}")
    state = whole_number("the state a rollout starts in", start, 0, SettingError)
    terminal = task.terminal
    if state >= task.states.size or (terminal is not None and terminal[state]):
        raise SettingError(f"a rollout must start in a state that is not terminal: got {state}")
    return np.array([state])


def random_rollouts(
    task: Task, *, episodes: int, length: int, seed: int = 0
) -> tuple[StepRecord, EpisodeEnds]:
    """Return episodes in which every available action is equally likely, as :func:`simulate`."""
    n = whole_number("episodes of random rollouts", episodes, 1, SettingError)
    length = whole_number("the length of a random rollout in steps", length, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    generative = generative_model(task)
    first = stream_start(seed, "random_rollouts")
    policy, stream = UniformPolicy(np.uint64(generative.actions.size)), np.array([first], np.uint64)
    with open_model(generative, first) as model:
        return simulate(model, policy, stream, episodes=n, limit=length)
