"""Following a policy through a task, one episode at a time: for drawings, checks and examples."""

# Numba infers the types of what is compiled here.
# mypy: allow-untyped-defs, allow-untyped-calls

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.run import compiled, stream_start
from curricle.planning.solution import checked_policy, policy_table
from curricle.tasks.draws import draw, first_above, splitmix64, uniform
from curricle.tasks.generative_models import (
    Functions,
    cumulated,
    cut_short,
    first_state,
    transition,
)
from curricle.tasks.live import opened
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, generative_model, has_tables, tables

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Trajectory:
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
    rewards: npt.NDArray[np.float64]
    terminated: bool
    truncated: bool

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
        With or without tables; a live one is played in an environment of its own.
    policy : (S,) int array or (S, A) float array
        As in :func:`evaluate`.
    seed : int
    start : int, optional
        First state; drawn from the start distribution by default. For tasks with tables.
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
    limit = whole_number(
        "the limit of a rollout in steps",
        generative_model(task).time_limit if steps is None else steps,
        1,
        SettingError,
    )
    seed = whole_number("seed", seed, 0, SettingError)
    if not has_tables(task):
        if start is not None:
            raise SettingError(
                f"a rollout of a task without tables starts as its episodes do: start was {start!r}"
            )
        return _played(task, policy, seed, limit)
    mdp = tables(task)
    table = policy_table(mdp, policy)
    rng = np.random.default_rng(seed)
    state = rng.choice(mdp.states.size, p=mdp.start) if start is None else start
    state = whole_number("the state a rollout starts in", state, 0, SettingError)
    if state >= mdp.states.size or mdp.terminal[state]:
        raise SettingError(f"a rollout must start in a state that is not terminal: got {state}")
    states, actions, rewards = [state], list[int](), list[float]()
    while len(actions) < limit and not mdp.terminal[states[-1]]:
        action = int(rng.choice(mdp.actions.size, p=table[states[-1]]))
        row = mdp.outcome_row[states[-1], action]
        outcome = int(np.searchsorted(mdp.cumulative[row], rng.random(), side="right"))
        actions.append(action)
        rewards.append(float(mdp.reward[row, outcome]))
        states.append(int(mdp.next_state[row, outcome]))
    terminated = bool(mdp.terminal[states[-1]])
    return Trajectory(
        frozen(np.array(states)),
        frozen(np.array(actions, dtype=np.int64)),
        frozen(np.array(rewards)),
        terminated,
        not terminated,
    )


def _played(task: Task, policy: npt.ArrayLike, seed: int, limit: int) -> Trajectory:
    """Return one episode of a policy in a task that only its model knows."""
    generative = generative_model(task)
    n_states, n_actions = generative.states.size, generative.actions.size
    checked = checked_policy(policy, np.zeros(n_states, dtype=bool), n_actions)
    chances = np.eye(n_actions)[checked] if checked.ndim == 1 else checked.astype(np.float64)
    states, actions = np.empty(limit + 1, np.int64), np.empty(limit, np.int64)
    rewards, stream = np.empty(limit), stream_start(seed, "rollout")
    with opened(generative.model, stream) as model:
        n, terminated = compiled(_play, isinstance(model, Functions))(
            model, cumulated(chances), np.array([stream], np.uint64), states, actions, rewards
        )
    return Trajectory(
        frozen(states[: n + 1].copy()),
        frozen(actions[:n].copy()),
        frozen(rewards[:n].copy()),
        bool(terminated),
        not terminated,
    )


def _play(model, cumulative, stream, states, actions, rewards):
    """Fill in an episode; return its steps and whether it reached an end."""
    state, over, cut, n = first_state(model, draw(stream)), False, False, 0
    states[0] = np.int64(state)
    while not over and not cut and n < actions.shape[0]:
        bits = draw(stream)
        action = first_above(cumulative[state], uniform(bits))
        state, rewards[n], over = transition(model, state, action, splitmix64(bits))
        cut = cut_short(model)
        actions[n] = np.int64(action)
        n += 1
        states[n] = np.int64(state)
    return n, over
