"""Exact planning: optimal values, the value of a given policy, each with a proven error bound."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from curricle.checks import number, numbers
from curricle.errors import SettingError
from curricle.tasks.endless import endless_states
from curricle.tasks.mdp import FiniteMDP, Task, tables
from curricle.tasks.outcomes import PROBABILITY_TOLERANCE
from curricle.tasks.spaces import frozen

FloatArray = npt.NDArray[np.float64]
EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class PolicyValues:
    """The exact values of a policy.

    Attributes
    ----------
    values : (S,) float64
        V(s), discounted return; 0 in terminal states.
    action_values : (S, A) float64
        Q(s, a) = sum_s' P(s' | s, a) (r + gamma V(s')); 0 in terminal states.
    start_value : float
        V averaged over the start distribution.
    error_bound : float
        No value is further than this from the true one (rounding included).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> evaluate(GridWorld("S.T"), [1, 1, 0]).error_bound < 1e-8
    True
    """

    values: FloatArray
    action_values: FloatArray
    start_value: float
    error_bound: float


@dataclass(frozen=True, eq=False)
class Solution(PolicyValues):
    """Optimal values, and which actions attain them.

    Attributes
    ----------
    optimal : (S, A) bool
        Actions whose Q(s, a) is within twice the error bound of the best: those that the bound
        cannot tell from optimal. Ties are so kept, not broken by index.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> solve(GridWorld(["S.", ".T"])).optimal[0]  # east and south are as good
    array([False,  True,  True, False])
    """

    optimal: npt.NDArray[np.bool_]

    @property
    def policy(self) -> FloatArray:
        """The policy that takes each optimal action equally often, (S, A) float64."""
        return np.asarray(self.optimal / self.optimal.sum(axis=1, keepdims=True))


def solve(task: Task, *, tolerance: float = 1e-8) -> Solution:
    """Return the optimal values V* and Q* by value iteration, with a guaranteed error bound.

    V_{k+1}(s) = max_a sum_s' P(s' | s, a) (r + gamma V_k(s')), until
    ``gamma / (1 - gamma) max |V_{k+1} - V_k|`` (Puterman 1994, theorem 6.3.1) plus rounding is at
    most `tolerance`. At discount 1 the longest expected episode takes the place of
    1 / (1 - gamma). The time limit plays no part: it is a limit of learning, not of the task.

    Parameters
    ----------
    task : Task
    tolerance : float
        Largest error allowed, in return units.

    Raises
    ------
    SettingError
        When the discount is 1 and some policy never ends, or when rounding alone exceeds the
        tolerance.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> solution = solve(GridWorld("S.T", discount=0.5))
    >>> solution.values, solution.optimal[0]
    (array([ 98.5, 199. ,   0. ]), array([False,  True, False, False]))
    """
    mdp = tables(task)
    everything = np.ones((mdp.states.size, mdp.actions.size))
    values, error = _iterate(mdp, everything, tolerance, greedy=True)
    action_values = back_up(mdp, values)
    best = action_values.max(axis=1, keepdims=True)
    return Solution(
        values=frozen(values),
        action_values=frozen(action_values),
        start_value=float(mdp.start @ values),
        error_bound=error,
        optimal=frozen(action_values >= best - 2 * error),
    )


def evaluate(task: Task, policy: npt.ArrayLike, *, tolerance: float = 1e-8) -> PolicyValues:
    """Return the exact values of a policy, with a guaranteed error bound.

    V(s) = sum_a pi(a | s) sum_s' P(s' | s, a) (r + gamma V(s')).

    Parameters
    ----------
    task : Task
    policy : (S,) int array or (S, A) float array
        An action for each state, or the probability of each action.
    tolerance : float
        Largest error allowed, in return units.

    Raises
    ------
    SettingError
        When the policy is malformed, or when at discount 1 it may never end.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld("S.T", discount=0.5)
    >>> evaluate(maze, [3, 1, 0]).values  # west, east, -
    array([ -2., 199.,   0.])
    """
    mdp = tables(task)
    probabilities = policy_table(mdp, policy)
    values, error = _iterate(mdp, probabilities, tolerance, greedy=False)
    return PolicyValues(
        values=frozen(values),
        action_values=frozen(back_up(mdp, values)),
        start_value=float(mdp.start @ values),
        error_bound=error,
    )


def greedy_policy(action_values: npt.ArrayLike, *, tolerance: float = 0.0) -> FloatArray:
    """Return the policy that is greedy on Q, ties broken uniformly, (S, A) float64.

    Parameters
    ----------
    action_values : (S, A) float array
    tolerance : float
        Actions this close to the best count as tied.

    Examples
    --------
    >>> greedy_policy([[1.0, 3.0, 3.0]])
    array([[0. , 0.5, 0.5]])
    """
    q = numbers("action_values", action_values, SettingError)
    number("tolerance", tolerance, SettingError, low=0)
    if np.isnan(q).any():
        raise SettingError(f"action_values must not be NaN: got {np.isnan(q).sum()} that are")
    best = q >= q.max(axis=-1, keepdims=True) - tolerance
    return np.asarray(best / best.sum(axis=-1, keepdims=True))


def back_up(mdp: FiniteMDP, values: FloatArray) -> FloatArray:
    """Return Q(s, a) = sum_s' P(s' | s, a) (r + gamma V(s')), (S, A); 0 in terminal states."""
    rows = (mdp.probability * (mdp.reward + mdp.discount * values[mdp.next_state])).sum(axis=1)
    return np.where(mdp.terminal[:, None], 0.0, rows[mdp.outcome_row])


def policy_table(mdp: FiniteMDP, policy: npt.ArrayLike) -> FloatArray:
    """Return a policy as (S, A) probabilities, or raise SettingError naming the bad state."""
    numbers("a policy", policy, SettingError)
    given = np.asarray(policy)
    n_states, n_actions = mdp.states.size, mdp.actions.size
    if given.shape == (n_states,):
        if not np.issubdtype(given.dtype, np.integer):
            raise SettingError(
                f"a policy of one action a state must be integers: got {given.dtype}"
            )
        bad = np.flatnonzero((given < 0) | (given >= n_actions))
        if bad.size:
            raise SettingError(
                f"a policy's actions must lie in 0..{n_actions - 1}: state {bad[0]} has "
                f"{given[bad[0]]}"
            )
        return np.asarray(np.eye(n_actions)[given])
    if given.shape != (n_states, n_actions):
        raise SettingError(
            f"a policy must have shape ({n_states},) or ({n_states}, {n_actions}): got "
            f"{given.shape}"
        )
    table = given.astype(np.float64)
    good = (table >= 0).all(axis=1) & (abs(table.sum(axis=1) - 1) <= PROBABILITY_TOLERANCE)
    bad = np.flatnonzero(~good & ~mdp.terminal)
    if bad.size:
        raise SettingError(
            f"a policy's probabilities must sum to 1: state {bad[0]} has {table[bad[0]].tolist()}"
        )
    return table


def _iterate(
    mdp: FiniteMDP, policy: FloatArray, tolerance: float, *, greedy: bool
) -> tuple[FloatArray, float]:
    """Return the fixed point's values and error bound; `greedy` over the actions with weight."""
    if not number("tolerance", tolerance, SettingError) > 0:
        raise SettingError(f"tolerance must be positive: got {tolerance}")
    horizon = _horizon(mdp, policy, greedy)
    terms = mdp.probability.shape[1] + 2 + (0 if greedy else mdp.actions.size)
    unit = terms * EPSILON  # relative rounding error of one backup
    values = np.zeros(mdp.states.size)
    change = sweeps(
        mdp.outcome_row,
        mdp.probability,
        mdp.next_state,
        mdp.reward,
        mdp.terminal,
        mdp.discount,
        policy,
        greedy,
        values,
        tolerance / (2 * horizon),
        unit,
    )
    rounding = unit * (float(abs(mdp.reward).max()) + float(abs(values).max()))
    error = (change + rounding) * horizon
    if error > tolerance:
        raise SettingError(
            f"tolerance must be at least {6 * rounding * horizon:.1e} for this task in double "
            f"precision: got {tolerance:g}"
        )
    return values, error


def _horizon(mdp: FiniteMDP, policy: FloatArray, greedy: bool) -> float:
    """Return the factor by which a Bellman residual bounds the error of the values.

    1 / (1 - gamma), or at discount 1 the longest expected episode: if w >= 0 satisfies
    w >= (1 - d) (1 + max_a P w), then w / (1 - d) bounds every policy's expected length.
    """
    if mdp.discount < 1:
        return 1 / (1 - mdp.discount)
    endless = endless_states(
        mdp.terminal, mdp.outcome_row, mdp.probability, mdp.next_state, policy > 0
    )
    if endless.size:
        raise SettingError(
            "discount 1 needs every policy considered to end: from state "
            f"{endless[0]} an episode can go on for ever"
        )
    length = np.zeros(mdp.states.size)
    growth = sweeps(
        mdp.outcome_row,
        mdp.probability,
        mdp.next_state,
        np.ones_like(mdp.reward),
        mdp.terminal,
        1.0,
        policy,
        greedy,
        length,
        0.5,
        EPSILON,
    )
    return float(length.max() / (1 - growth)) + 1


@njit(cache=True, nogil=True)
def sweeps(
    outcome_row,
    probability,
    next_state,
    reward,
    terminal,
    discount,
    policy,
    greedy,
    values,
    enough,
    unit,
):
    """Back up `values` in place, whole sweeps, until no value changes by more than `enough`.

    Or until the changes are mere rounding, `unit` times the size of the numbers. Returns the
    largest change of the last sweep. The outcome rows are backed up first; the pairs then only
    look theirs up.
    """
    n_states, n_actions = outcome_row.shape
    n_rows, n_outcomes = probability.shape
    rows = np.empty(n_rows)
    largest_reward = np.abs(reward).max()
    while True:
        for row in range(n_rows):
            total = 0.0
            for outcome in range(n_outcomes):
                total += probability[row, outcome] * (
                    reward[row, outcome] + discount * values[next_state[row, outcome]]
                )
            rows[row] = total
        change, largest = 0.0, largest_reward
        for state in range(n_states):
            if terminal[state]:
                continue
            new = -np.inf if greedy else 0.0
            for action in range(n_actions):
                if greedy:
                    new = max(new, rows[outcome_row[state, action]])
                else:
                    new += policy[state, action] * rows[outcome_row[state, action]]
            change = max(change, abs(new - values[state]))
            values[state] = new
            largest = max(largest, largest_reward + abs(new))
        if change <= enough or change <= 2 * unit * largest:
            return change
