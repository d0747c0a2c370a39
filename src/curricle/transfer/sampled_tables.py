"""Tables of a task estimated from steps of the random policy, for tasks that have none."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import whole_number
from curricle.errors import SettingError, TaskError
from curricle.planning.simulator import UniformPolicy, simulate
from curricle.tasks.draws import stream_start
from curricle.tasks.live import open_model
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.task import Task, generative_model

LARGEST = 2_000_000
"""State-action pairs of a task that is sampled."""
LONGEST = 1_000
"""Steps of an episode where the task has no time limit."""


@dataclass(frozen=True, eq=False)
class SampledTables:
    """What random steps show of a task.

    Attributes
    ----------
    mdp : FiniteMDP
        Outcomes by their frequencies. A pair that was not tried stays where it is, at the lowest
        reward that was seen.
    tried : (S,) bool
        States in which every action was taken at least once.
    steps : int
        Steps taken.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> sampled_tables(GridWorld("S.T"), 200).tried
    array([ True,  True, False])
    """

    mdp: FiniteMDP
    tried: BoolArray
    steps: int


def sampled_tables(task: Task, steps: int, *, seed: int = 0) -> SampledTables:
    """Return tables estimated from so many steps of the uniformly random policy.

    Parameters
    ----------
    task : Task
        With or without tables; a live one is played in an environment of its own.
    steps : int
        Steps to take; the last episode is cut off.
    seed : int

    Raises
    ------
    SettingError
        When `steps` is less than 1.
    TaskError
        When the task has more than 2 million pairs.
    """
    steps = whole_number("steps to sample", steps, 1, SettingError)
    generative = generative_model(task)
    shape = generative.states.size, generative.actions.size
    if shape[0] * shape[1] > LARGEST:
        raise TaskError(
            f"tables are estimated for up to {LARGEST:,} pairs: the task has "
            f"{shape[0] * shape[1]:,}"
        )
    taken = _transitions(generative, steps, seed)
    return _estimated(generative, *taken)


def _transitions(
    task: Any, steps: int, seed: int
) -> tuple[IntArray, IntArray, FloatArray, IntArray, BoolArray, IntArray]:
    """Return states, actions, rewards, next states, which ended, and the starts of episodes."""
    first = stream_start(seed, "sampled_tables")
    policy, stream = UniformPolicy(np.uint64(task.actions.size)), np.array([first], np.uint64)
    parts, starts, left = [], [], steps
    with open_model(task, first) as model:
        while left > 0:
            limit = min(left, task.time_limit or LONGEST)
            record, ends = simulate(model, policy, stream, episodes=1, limit=limit)
            n = len(record.states)
            if n == 0:  # the environment failed; leaving the context says why
                break
            after = np.append(record.states[1:], ends.last_states[0])
            ended = np.zeros(n, bool)
            ended[-1] = ends.terminated[0]
            parts.append((record.states, record.actions, record.rewards, after, ended))
            starts.append(int(record.states[0]))
            left -= n
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    states, actions, rewards, after, ended = columns
    return states, actions, rewards, after, ended, np.array(starts)


def _estimated(
    task: Any,
    states: IntArray,
    actions: IntArray,
    rewards: FloatArray,
    after: IntArray,
    ended: BoolArray,
    starts: IntArray,
) -> SampledTables:
    """Return the tables that transitions make."""
    n_states, n_actions = task.states.size, task.actions.size
    entered, ends = (
        np.bincount(after, weights=weight, minlength=n_states)
        for weight in (np.ones(len(after)), ended)
    )
    terminal = (ends > entered / 2) & (np.bincount(states, minlength=n_states) == 0)
    pairs = states * n_actions + actions
    keys, place, counts = np.unique(
        np.stack([pairs, after], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    mean = np.bincount(place.ravel(), weights=rewards) / counts
    first = np.concatenate([[0], np.flatnonzero(np.diff(keys[:, 0])) + 1])
    order = np.arange(len(keys)) - np.repeat(first, np.diff(np.append(first, len(keys))))
    width = int(order.max()) + 1
    of_pair = n_states * n_actions
    chance, reward = np.zeros((of_pair, width)), np.full((of_pair, width), float(rewards.min()))
    reached = np.repeat(np.arange(of_pair) // n_actions, width).reshape(of_pair, width)
    chance[keys[:, 0], order] = counts
    reward[keys[:, 0], order], reached[keys[:, 0], order] = mean, keys[:, 1]
    tried = chance.sum(axis=1) > 0
    chance[~tried, 0] = 1.0
    start = np.bincount(starts, minlength=n_states) / len(starts)
    mdp = FiniteMDP(
        states=task.states,
        actions=task.actions,
        outcome_row=np.arange(of_pair).reshape(n_states, n_actions),
        probability=chance / chance.sum(axis=1, keepdims=True),
        next_state=reached,
        reward=reward,
        terminal=terminal,
        start=start,
        discount=min(task.discount, 1 - 1 / max(2, task.time_limit or LONGEST)),
        time_limit=task.time_limit,
    )
    return SampledTables(mdp, tried.reshape(n_states, n_actions).all(axis=1), len(states))
