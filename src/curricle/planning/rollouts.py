"""Rollouts: one episode of a given policy, and many of the uniformly random one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import whole_number
from curricle.display import block, table
from curricle.errors import SettingError
from curricle.planning.greedy import Values
from curricle.planning.simulator import (
    GreedyPolicy,
    StepRecord,
    TablePolicy,
    UniformPolicy,
    simulate,
)
from curricle.planning.solution import checked_policy
from curricle.tasks.kernel import stream_start
from curricle.tasks.live import is_live, open_model
from curricle.tasks.mdp import GenerativeModel, Task, generative_model
from curricle.tasks.models import cumulated
from curricle.text import brief_repr, counted

CHUNK = 65_536
"""Steps of one long episode that are simulated at a time."""


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

    def _repr_html_(self) -> str:
        end = "terminated" if self.terminated else "truncated" if self.truncated else "cut off"
        title = f"{counted(len(self.rewards), 'step')}, return {self.rewards.sum():.4g}, {end}"
        rows = zip(range(len(self.rewards)), self.states, self.actions, self.rewards, strict=False)
        return block(title, table(["step", "state", "action", "reward"], rows))

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
        A live one is played in an environment of its own.
    policy : (S,) int array or (S, A) float array
        As in :func:`evaluate`.
    seed : int
    start : int, optional
        First state; by default, and always in a live task, drawn as episodes start.
    steps : int, optional
        Where to cut off; the task's time limit by default.

    Raises
    ------
    SettingError
        When the policy is malformed, the start is terminal or no state or cannot be chosen, or
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
    checked = checked_policy(policy, known, n_actions)
    if checked.ndim == 2:
        probabilities = TablePolicy(cumulated(checked.astype(np.float64, copy=False)))
        return _trajectory(generative, probabilities, seed, steps, start)
    # It is greedy on values of 1, as most policies are: they share a compiled loop.
    values = np.zeros((n_states, n_actions))
    values[np.arange(n_states), checked] = 1.0
    return _trajectory(generative, GreedyPolicy(Values(frozen(values))), seed, steps, start)


def greedy_rollout(task: Task, view: Any, *, seed: int = 0, steps: int | None = None) -> Trajectory:
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
    left = generative.time_limit if steps is None else steps
    left = whole_number("the limit of a rollout in steps", left, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    starts = None if start is None else _starts(generative, [start])
    first = stream_start(seed, "rollout")
    stream, parts = np.array([first], np.uint64), list[StepRecord]()
    with open_model(generative, first) as model:
        while True:
            limit = min(left, CHUNK)
            part, ends = simulate(model, policy, stream, episodes=1, limit=limit, starts=starts)
            parts.append(part)
            left, starts = left - limit, ends.last_states
            if ends.terminated[0] or ends.truncated[0] or not left:
                break
    states, actions, rewards = (np.concatenate(part) for part in zip(*parts, strict=True))
    states, terminated = np.append(states, ends.last_states), bool(ends.terminated[0])
    return Trajectory(frozen(states), frozen(actions), frozen(rewards), terminated, not terminated)


def _starts(task: GenerativeModel, starts: Sequence[int] | IntArray) -> IntArray:
    """Return the states that episodes start in, (E,), or raise SettingError if they cannot."""
    if is_live(task):
        raise SettingError(f"a live task starts where its episodes do: start was {starts[0]!r}")
    name, terminal = "the state a rollout starts in", task.terminal
    states = np.array([whole_number(name, state, 0, SettingError) for state in starts])
    bad = states >= task.states.size
    if terminal is not None:
        bad[~bad] = terminal[states[~bad]]
    if bad.any():
        raise SettingError(
            f"a rollout must start in a state that is not terminal: got {states[bad][0]}"
        )
    return states


@dataclass(frozen=True, eq=False)
class RandomRollouts(Frozen):
    """E episodes of the uniformly random policy, of up to L steps."""

    states: IntArray  # (E, L + 1) from where each starts; after its end the last one, repeated
    actions: IntArray  # (E, L) 0 after the end
    length: IntArray  # (E,) steps taken
    terminated: BoolArray  # (E,) the others were cut off

    @property
    def taken(self) -> BoolArray:
        """Which steps were taken, (E, L)."""
        return np.asarray(np.arange(self.actions.shape[1]) < self.length[:, None])

    @property
    def ending(self) -> BoolArray:
        """Which steps terminated an episode, (E, L)."""
        last = np.arange(self.actions.shape[1]) == self.length[:, None] - 1
        return np.asarray(last & self.terminated[:, None])


def random_rollouts(
    task: Task,
    *,
    episodes: int,
    length: int,
    seed: int = 0,
    starts: IntArray | None = None,
) -> RandomRollouts:
    """Return episodes in which every action is equally likely at every step.

    They start as the task draws them, or in `starts`, (E,), as many states as `episodes`.
    """
    n = whole_number("episodes of random rollouts", episodes, 1, SettingError)
    length = whole_number("the length of a random rollout in steps", length, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    generative = generative_model(task)
    first = stream_start(seed, "random_rollouts")
    policy, stream = UniformPolicy(np.uint64(generative.actions.size)), np.array([first], np.uint64)
    states = None if starts is None else _starts(generative, starts)
    if states is not None and len(states) != n:
        raise SettingError(f"starts must be as many as episodes, {n}: got {len(states)}")
    with open_model(generative, first) as model:
        steps, ends = simulate(model, policy, stream, episodes=n, limit=length, starts=states)
    taken = np.arange(length) < ends.lengths[:, None]
    states = np.repeat(ends.last_states[:, None], length + 1, axis=1)
    states[:, :-1][taken] = steps.states
    actions = np.zeros((n, length), np.int64)
    actions[taken] = steps.actions
    return RandomRollouts(
        frozen(states), frozen(actions), frozen(ends.lengths), frozen(ends.terminated)
    )
