"""Following a policy through a task, one episode at a time: for drawings, checks and examples."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.learning.planning import policy_table
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task, tables

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
        Whether it was cut off instead (time limit, or `steps`).

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
    policy : (S,) int array or (S, A) float array
        As in :func:`evaluate`.
    seed : int
    start : int, optional
        First state; drawn from the start distribution by default.
    steps : int, optional
        Where to cut off; the task's time limit by default.

    Raises
    ------
    SettingError
        When the policy is malformed, the start is terminal or no state, or there is no limit.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> episode = rollout(GridWorld("S.T"), [1, 1, 0])
    >>> episode.states, episode.rewards, episode.terminated
    (array([0, 1, 2]), array([ -1., 199.]), True)
    """
    mdp = tables(task)
    table = policy_table(mdp, policy)
    limit = whole_number(
        "the limit of a rollout in steps",
        mdp.time_limit if steps is None else steps,
        1,
        SettingError,
    )
    rng = np.random.default_rng(whole_number("seed", seed, 0, SettingError))
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
