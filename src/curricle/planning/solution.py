"""Exact planning: optimal values and the values of a policy, each with a proven error bound."""

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import number, numbers
from curricle.errors import SettingError
from curricle.planning.models import (
    CONVERGED,
    ExtrapolatedBackup,
    Iteration,
    PlanningModel,
    Policy,
    Precision,
    TabularPlanningModel,
    iterate,
    model_of,
)
from curricle.progress import Bars, Progress, shown
from curricle.tasks.graph import steps_to
from curricle.tasks.mdp import PROBABILITY_TOLERANCE, FiniteMDP, Task, closed, normalised, tables
from curricle.tasks.spaces import state_name
from curricle.text import brief_repr

EPSILON = float(np.finfo(np.float64).eps)
RELATIVE_TOLERANCE = 1e-10
"""Largest error by default, of the largest value; rounding allows it up to a discount of 0.9999."""
AT_ONCE = 10_000_000
"""Pairs (s, a) backed up between two looks at the progress: a tenth of a second to a second."""
DIRECT_AFTER = 300_000  # sweeps after which a small system is solved directly
MOST_WORK = 1e13
"""Pairs backed up that are expected in a large system, up to which it is swept: some hours."""
TINIEST = float(np.finfo(np.float64).smallest_subnormal)


@dataclass(frozen=True, eq=False)
class PolicyValues(Frozen):
    """The exact values of a policy.

    Attributes
    ----------
    values : (S,) float64
        V(s), discounted return; 0 in terminal states.
    start_value : float
        V averaged over the start distribution.
    error_bound : float
        Proven: no V(s), and no Q(s, a) of an available action, is further than this from the true
        one, rounding included. The numbers in the task's tables count as exact.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> evaluate(GridWorld("S.T"), [1, 1, 0]).error_bound < 1e-8
    True
    """

    values: FloatArray
    start_value: float
    error_bound: float
    _model: PlanningModel = field(repr=False)

    __repr__ = brief_repr

    @cached_property
    def action_values(self) -> FloatArray:
        """Q(s, a) = sum_s' P(s' | s, a) (r + gamma V(s')), (S, A) float64; 0 in terminal states.

        It is -inf where an action is not available.
        """
        return frozen(closed(self.finite_action_values, self._model.available))

    @cached_property
    def finite_action_values(self) -> FloatArray:
        """`action_values`, but an unavailable pair has those of the state's first available action.

        Its outcomes are the same in the tables, so that what is proven of them holds for it too.
        """
        return frozen(self._model.action_values(self.values))


@dataclass(frozen=True, eq=False)
class Solution(PolicyValues):
    """Optimal values, and which actions attain them.

    `values` are V*, `action_values` Q*, both within `error_bound` of the truth.

    Attributes
    ----------
    steps : int or None
        At discount 1, where the time limit alone bounds the values: the limit. `values` are then
        the highest expected returns in so many steps, `action_values` in one more.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> solve(GridWorld(["S.", ".T"])).optimal[0]  # east and south are as good
    array([False,  True,  True, False])
    """

    steps: int | None = field(default=None, repr=False)

    __repr__ = brief_repr

    @cached_property
    def optimal(self) -> BoolArray:
        """Actions that the error bound cannot tell from optimal, (S, A) bool.

        Their Q(s, a) is within twice the bound of the best, so that ties are kept.
        """
        best = self.action_values.max(axis=1, keepdims=True)
        return frozen(np.asarray(self.action_values >= best - 2 * self.error_bound))

    @property
    def policy(self) -> FloatArray:
        """The policy that takes each optimal action equally often, (S, A) float64."""
        return np.asarray(self.optimal / self.optimal.sum(axis=1, keepdims=True))


def solve(task: Task, *, tolerance: float | None = None, progress: Progress = None) -> Solution:
    """Return the optimal values V* and Q*, with a guaranteed error bound.

    Modified policy iteration on the tables, or value iteration without tables where the task has a
    :class:`FactoredModel`. Both start from a V <= TV, so that values only rise (Puterman 1994,
    theorem 6.5.5), with TV(s) = max_a sum_s' P(s' | s, a) (r + gamma V(s')). The last sweep backs
    up each V(s) from values within ``d`` of the result, so that ``|TV - V| <= gamma d``, and
    ``gamma d / (1 - gamma)`` plus rounding (theorem 6.3.1) bounds the error. At discount 1
    the longest expected episode replaces 1 / (1 - gamma). Where some policy never ends and costs
    without bound, the task is a stochastic shortest path problem (Bertsekas, Tsitsiklis 1991). Such
    a task, and a task that 300,000 sweeps do not solve, is solved by linear systems if it has at
    most 5,000 states. The time limit is ignored: it limits learning, and is not part of the task.
    Only where nothing else bounds the values, at discount 1, they are those of episodes of so many
    steps, by backward induction (:attr:`Solution.steps`).

    Parameters
    ----------
    task : Task
    tolerance : float, optional
        Largest error allowed, in return units; by default 1e-10 of the largest value, or as close
        as double precision gets.
    progress : bool or callable, optional
        True counts the sweeps; a function is called from time to time with the largest change of a
        value in the last sweep.

    Raises
    ------
    SettingError
        When at discount 1, without a time limit, some policy never ends and does not cost without
        bound, when the sweeps would take many hours, when rounding alone exceeds `tolerance`, or
        when the values have no finite bound in double precision.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> solution = solve(GridWorld("S.T", discount=0.5))
    >>> solution.values, solution.optimal[0]
    (array([ 98.5, 199. ,   0. ]), array([False,  True, False, False]))
    """
    try:
        return solve_without_limit(task, tolerance=tolerance, progress=progress)
    except SettingError:
        model = model_of(task)
        if model.discount < 1 or not isinstance(model, TabularPlanningModel):
            raise
        if (steps := model.mdp.time_limit) is None or tolerance is not None:
            raise
    values = values_in(model, steps)
    size = model.largest_reward + float(abs(values).max())
    error = steps * _unit(model, None) * size
    return Solution(frozen(values), model.start_value(values), error, model, steps)


def solve_without_limit(
    task: Task, *, tolerance: float | None = None, progress: Progress = None
) -> Solution:
    """Return what :func:`solve` does; SettingError where the time limit alone bounds the values."""
    with shown(progress) as bars:
        model = model_of(task)
        values, error = _iterate(model, None, tolerance, bars)
    return Solution(frozen(values), model.start_value(values), error, model)


def evaluate(
    task: Task, policy: Any, *, tolerance: float | None = None, progress: Progress = None
) -> PolicyValues:
    """Return the exact values of a policy, with a guaranteed error bound.

    V(s) = sum_a pi(a | s) sum_s' P(s' | s, a) (r + gamma V(s')), by sweeps of the tables with
    occasional extrapolation (Anderson 1965).

    Parameters
    ----------
    task : Task
    policy : (S,) int array, (S, A) float array or model
        An action for each state, or the probability of each action. Or a model with a method
        ``predict`` from observations to actions, as in Stable-Baselines3, in a task that knows the
        observation of each state (:class:`TabulatedTask`).
    tolerance, progress : optional
        As in :func:`solve`.

    Raises
    ------
    SettingError
        When the policy is malformed, takes an action that is not available, is a model and the task
        does not know its observations, may never end at discount 1, or as in :func:`solve`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld("S.T", discount=0.5)
    >>> evaluate(maze, [3, 1, 0]).values  # west, east, -
    array([ -2., 199.,   0.])
    """
    model = TabularPlanningModel.of(tables(task))
    if callable(getattr(policy, "predict", None)):
        policy_of = getattr(task, "policy", None)
        if not callable(policy_of):
            raise SettingError(
                "a model is evaluated in a task that knows the observation of each state, as "
                f"tasks of tabulate do: got {task!r}"
            )
        policy = policy_of(policy)
    followed = checked_policy(policy, model.terminal, model.n_actions, model.available)
    with shown(progress) as bars:
        values, error = _iterate(model, followed, tolerance, bars)
    return PolicyValues(frozen(values), model.start_value(values), error, model)


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
        raise SettingError(f"action_values must not be NaN: got {np.isnan(q).sum()} of them")
    best = q >= q.max(axis=-1, keepdims=True) - tolerance
    return np.asarray(best / best.sum(axis=-1, keepdims=True))


def checked_policy(
    policy: npt.ArrayLike, terminal: BoolArray, n_actions: int, available: BoolArray | None = None
) -> Policy:
    """Return a policy as (S,) actions or (S, A) probabilities; SettingError names the bad state."""
    checked = _of_shape(policy, terminal, n_actions)
    if available is not None:
        taken = np.arange(n_actions) == checked[:, None] if checked.ndim == 1 else checked > 0
        bad = np.argwhere(taken & ~available)
        if len(bad):
            state, action = bad[0]
            raise SettingError(
                "a policy may take available actions only: in state "
                f"{state} it takes action {action}, available are "
                f"{np.flatnonzero(available[state]).tolist()}"
            )
    return checked


def _of_shape(policy: npt.ArrayLike, terminal: BoolArray, n_actions: int) -> Policy:
    """Return a policy whose shape, actions and probabilities are right, or raise SettingError."""
    if not isinstance(policy, np.ndarray) or policy.dtype.kind not in "iuf":
        numbers("a policy", policy, SettingError)
    choices, n_states = np.array(policy), len(terminal)  # a copy: loops trust what is checked here
    if choices.shape == (n_states,):
        if not np.issubdtype(choices.dtype, np.integer):
            raise SettingError(
                f"a policy of one action a state must be integers: got {choices.dtype}"
            )
        bad = np.flatnonzero((choices < 0) | (choices >= n_actions))
        if bad.size:
            raise SettingError(
                f"a policy's actions must lie in 0..{n_actions - 1}: state {bad[0]} has "
                f"{choices[bad[0]]}"
            )
        return choices
    if choices.shape != (n_states, n_actions):
        raise SettingError(
            f"a policy must have shape ({n_states},) or ({n_states}, {n_actions}): got "
            f"{choices.shape}"
        )
    table = normalised(choices.astype(np.float64, copy=False))
    good = (table >= 0).all(axis=1) & (abs(table.sum(axis=1) - 1) <= PROBABILITY_TOLERANCE)
    bad = np.flatnonzero(~good & ~terminal)
    if bad.size:
        raise SettingError(
            f"a policy's probabilities must sum to 1: state {bad[0]} has {table[bad[0]].tolist()}"
        )
    return table


def _iterate(
    model: PlanningModel, policy: Policy | None, tolerance: float | None, bars: Bars
) -> tuple[FloatArray, float]:
    """Return the values of a policy, the best if None, and their error bound."""
    # If each V(s) was backed up from values within d of V, then |TV - V| <= gamma d, so V is within
    # horizon gamma d of the fixed point, and likewise with rounding added to gamma d. One more
    # backup of such values, which gives Q, stays within that: gamma horizon + 1 <= horizon.
    if tolerance is not None and not number("tolerance", tolerance, SettingError) > 0:
        raise SettingError(f"tolerance must be positive: got {tolerance}")
    unit = _unit(model, policy)
    if policy is None and model.discount == 1 and _tabular(model).endless(None).size:
        values, error = shortest_paths(_tabular(model), unit)
        reached = 2 * error
    else:
        lengths = _lengths(model, policy, bars)
        horizon, error = float(np.max(lengths)) + (model.discount == 1), np.inf
        if horizon * model.largest_reward < np.inf:
            enough = 0.0 if tolerance is None else 0.999 * tolerance / horizon
            relative = 0.999 * RELATIVE_TOLERANCE / horizon if tolerance is None else 0.0
            reward, discount = model.largest_reward, model.discount
            precision = Precision(enough, relative, unit, reward, horizon, discount)
            values, change = _fixed_point(model, policy, lengths, precision, bars)
            rounding = unit * (reward + float(abs(values).max()))
            if reward > 0:  # products below the normal numbers have an error of their own
                rounding += unit / EPSILON * TINIEST
            # The last factor is for the rounding of this line itself.
            error = (discount * change + rounding) * horizon * (1 + 8 * EPSILON)
            reached = 2 * rounding * horizon
        if not error < np.inf:
            raise SettingError(
                f"values need a finite error bound: rewards of up to {model.largest_reward:.3g} in "
                f"episodes of {horizon:.3g} expected steps leave none in double precision"
            )
    if tolerance is not None and error > tolerance:
        raise SettingError(
            f"tolerance must be at least {max(reached, 1.1 * error):.1e} for this "
            f"task in double precision: got {tolerance:g}"
        )
    return values, error


def _unit(model: PlanningModel, policy: Policy | None) -> float:
    """Return the relative rounding error of a backup, which adds up that many products."""
    products = model.n_outcomes + 3 + (0 if policy is None else model.n_actions)
    return products * EPSILON


def _tabular(model: PlanningModel) -> TabularPlanningModel:
    assert isinstance(model, TabularPlanningModel), "a policy, or discount 1, needs the tables"
    return model


def _fixed_point(
    model: PlanningModel,
    policy: Policy | None,
    lengths: FloatArray | float,
    precision: Precision,
    bars: Bars,
) -> tuple[FloatArray, float]:
    """Return the values of a policy, the best if None, and the change of the last sweep."""
    if policy is None:
        backup, lowest = model.greedy_backup()
        values = np.where(model.terminal, 0.0, lowest * lengths)
    else:
        values = np.zeros(len(model.terminal))
        steps = np.zeros((2, len(values)))
        backup = ExtrapolatedBackup(_tabular(model).policy_backup(policy), steps, np.array([-1]))
    pairs = max(1, values.size * model.n_actions)
    most = min(DIRECT_AFTER, max(1, AT_ONCE // pairs))
    reach = float(abs(values).max(initial=0.0))
    iteration = Iteration(0, np.inf, np.inf, 0, reach)
    while iteration.waited != CONVERGED:
        iteration = Iteration(*iterate(backup, values, precision, iteration, most))
        bars.at("sweeps", iteration.sweeps)
        bars.tell(iteration.change)
        if iteration.waited == CONVERGED or iteration.sweeps < DIRECT_AFTER:
            continue
        if not isinstance(model, TabularPlanningModel) or values.size > LARGEST_DIRECT:
            # As many sweeps as a contraction may take.
            largest = precision.largest_reward + float(abs(values).max())
            enough = max(precision.enough, precision.relative * largest, precision.unit * largest)
            sweeps = precision.horizon * max(0.0, np.log(iteration.change / enough))
            if sweeps * pairs > MOST_WORK:
                raise SettingError(
                    f"up to {LARGEST_DIRECT:,} states are solved directly, and {values.size:,} by "
                    f"sweeps: after {iteration.sweeps:,} about {sweeps:.2g} more are expected of "
                    f"episodes of up to {precision.horizon:.3g} steps; a lower discount or a "
                    "larger tolerance needs fewer"
                )
            continue
        unit = precision.unit
        values = policy_values(model, policy) if policy is not None else best_policy(model, unit)[0]
        once = precision._replace(enough=np.inf)  # what is left is proven by one more sweep
        iteration = Iteration(*iterate(backup, values, once, iteration, 1))
    return values, iteration.change


def _lengths(model: PlanningModel, policy: Policy | None, bars: Bars) -> FloatArray | float:
    """Return a bound w of the expected (discounted) length of an episode from each state."""
    # It satisfies w >= 1 + gamma max_a P w, so that r w is a V <= TV for any r <= 0 that no state's
    # best mean reward is below. 1 / (1 - gamma), where probabilities sum to 1; or at discount 1
    # lengths computed up to a residual of about 1/2: if |1 + P w - w| <= d < 1, rounding included,
    # then w / (1 - d) has the property.
    if model.discount < 1:
        kept = model.discount * model.largest_sum(policy)
        return 1 / (1 - kept) if kept < 1 else np.inf
    model = _tabular(model)
    if policy is not None and (endless := model.endless(policy)).size:  # else `_iterate` has looked
        raise SettingError(
            "discount 1 needs every policy considered to end: from state "
            f"{endless[0]} an episode can go on for ever"
        )
    precision = Precision(0.5, 0.0, EPSILON, 1.0, float(len(model.terminal)), 1.0)
    lengths, change = _fixed_point(
        model.counting_steps(), policy, 0.0, precision, bars.within("lengths of episodes")
    )
    residual = change + _unit(model, policy) * (1 + float(lengths.max()))
    return np.asarray(lengths / (1 - residual)) if residual < 1 else np.inf


# -- systems solved directly -----------------------------------------------------------------------
#
# Sweeps take as many steps as an episode has; a direct solution does not. It proves nothing by
# itself: it is backed up, and what is left is bounded.
#
# At discount 1 some policy may never end. Where each such policy costs without bound, V* is finite
# and solves V = TV alone (Bertsekas, Tsitsiklis 1991). Two things prove it, and bound the error. If
# W >= TW + c, c > 0, then r <= W - PW - c: an endless episode gets at most -c a step. And if
# TV <= V + d, then U = V + t (W - V) with t = d / c <= 1 has TU <= U, hence U >= V*.


LARGEST_DIRECT = 5_000
"""States up to which systems are solved directly, in seconds even where they are dense."""
MOST_IMPROVEMENTS = 1_000
COSTS = 2.0 ** -np.arange(1, 41, 3)
"""Lower bounds that are tried for the cost of an endless way, in units of the largest reward."""


def transitions(mdp: FiniteMDP, chances: FloatArray) -> Any:
    """Return the chances of next states, ends left out, sparse (S, S), for chances of actions."""
    from scipy.sparse import csr_array  # takes time, and few need it

    n_states = mdp.states.size
    state, action = np.nonzero(np.where(mdp.terminal[:, None], 0.0, chances))
    row = mdp.outcome_row[state, action]
    weight = chances[state, action][:, None] * mdp.probability[row]
    after = mdp.next_state[row]
    weight[mdp.terminal[after]] = 0.0
    source = np.repeat(state, after.shape[1])
    return csr_array((weight.ravel(), (source, after.ravel())), shape=(n_states, n_states))


def solved(step: Any, discount: float, right: FloatArray) -> FloatArray:
    """Return x of x = `right` + discount `step` x, (S,); not finite where there is none."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import spsolve

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a singular system
        return np.asarray(spsolve((eye_array(len(right)) - discount * step).tocsc(), right))


def policy_values(model: TabularPlanningModel, policy: Any) -> FloatArray:
    """Return V of a policy, (S,) actions or (S, A) chances, by one linear system."""
    chances = np.eye(model.n_actions)[policy] if policy.ndim == 1 else policy
    live, paid = ~model.terminal, np.zeros(len(policy))
    paid[live] = (chances[live] * model.mean_reward[model.mdp.outcome_row[live]]).sum(axis=1)
    return solved(transitions(model.mdp, chances), model.discount, paid)


def backed_up(model: TabularPlanningModel, values: FloatArray) -> FloatArray:
    """Return r + gamma P V of all pairs, (S, A), as sweeps compute it; 0 in terminal states."""
    mdp = model.mdp
    rows = model.mean_reward + model.discount * (mdp.probability * values[mdp.next_state]).sum(1)
    return np.where(model.terminal[:, None], 0.0, rows[mdp.outcome_row])


def values_in(model: TabularPlanningModel, steps: int) -> FloatArray:
    """Return the highest expected returns in so many steps, (S,), by backward induction."""
    mdp, values = model.mdp, np.zeros(model.mdp.states.size)
    for _ in range(steps):
        q, before = backed_up(model, values), values
        values = (q if mdp.available is None else np.where(mdp.available, q, -np.inf)).max(axis=1)
        if np.array_equal(values, before):
            break
    return values


def best_policy(model: TabularPlanningModel, unit: float) -> tuple[FloatArray, IntArray]:
    """Return V of the policy that policy iteration ends with, (S,), and its actions (Howard 1960).

    It starts from a policy that ends. A better one that never ends, at discount 1, need not pay for
    going on: it is returned with values that are not finite.
    """
    mdp, places = model.mdp, np.arange(len(model.terminal))
    nearest = np.where(mdp.probability > 0, steps_to(mdp, mdp.terminal)[mdp.next_state], np.inf)
    policy = nearest.min(axis=1)[mdp.outcome_row].argmin(axis=1)
    for _ in range(MOST_IMPROVEMENTS):
        values = policy_values(model, policy)
        q = backed_up(model, values)
        better, now = q.argmax(axis=1), q[places, policy]
        rounding = 8 * unit * (model.largest_reward + abs(values).max(initial=0.0))
        gains = q[places, better] > now + rounding
        if not gains.any():  # also where values are not finite
            break
        policy = np.where(gains, better, policy)
        if model.discount == 1 and model.endless(policy).size:
            return np.full(len(policy), np.nan), policy
    return values, policy


def shortest_paths(model: TabularPlanningModel, unit: float) -> tuple[FloatArray, float]:
    """Return V* at discount 1, (S,), and its error bound, where not every policy ends.

    SettingError where V* is not finite, or the cost of an endless way cannot be told from 0.
    """
    away = steps_to(model.mdp, model.mdp.terminal)
    endless, why = np.flatnonzero(np.isinf(away)), "no way leads to an end"
    if not endless.size and len(away) > LARGEST_DIRECT:
        endless, why = model.endless(None), f"{len(away):,} states are too many to tell"
    if not endless.size:
        (values, policy), why = best_policy(model, unit), "the way costs nothing"
        endless = model.endless(policy)
        for cost in () if endless.size else COSTS * model.largest_reward:
            above, last = best_policy(replace(model, mean_reward=model.mean_reward + cost), unit)
            error = _error(model, policy, unit, values, above)
            if error < np.inf:
                return values, error
            endless = model.endless(last)
    state = int((endless if endless.size else model.endless(None))[0])
    raise SettingError(
        "discount 1 needs every policy considered to end, or to cost without bound: from "
        f"{state_name(model.mdp.states, state)} an episode can go on for ever, and {why}; a "
        "discount below 1 bounds the values"
    )


def _error(
    model: TabularPlanningModel,
    policy: IntArray,
    unit: float,
    values: FloatArray,
    above: FloatArray,
) -> float:
    """Return how far V of a policy that ends is from V*, given W `above`; infinite if not known."""
    # V* is at least what the policy is worth.
    live, places = ~model.terminal, np.arange(len(policy))
    counted = model.counting_steps()
    lengths = policy_values(counted, policy)
    if not np.isfinite([values, above, lengths]).all():
        return np.inf
    rounding, rounding_above, rounding_lengths = (
        unit * (of.largest_reward + float(abs(array).max()))
        for of, array in ((model, values), (model, above), (counted, lengths))
    )
    q = backed_up(model, values)
    short = float(abs(q[places, policy] - values)[live].max()) + rounding
    rest = abs(backed_up(counted, lengths)[places, policy] - lengths)[live].max() + rounding_lengths
    cost = float((above - backed_up(model, above).max(axis=1))[live].min()) - rounding_above
    over = max(0.0, float((q.max(axis=1) - values)[live].max())) + rounding
    if not (rest < 1 and 0 < over <= cost):
        return np.inf
    lower = short * float(lengths.max()) / (1 - rest)
    upper = over / cost * max(0.0, float((above - values).max()))
    return float((max(lower, upper) + rounding) * model.largest_sum(None) * (1 + 64 * unit))


# -- how often a policy is where -------------------------------------------------------------------


NEGLIGIBLE = 1e-13  # share of the visits so far below which those of later steps are left out
STEPS_AT_MOST = 30_000
"""Steps of visits that are added up without a time limit; later ones come from a linear system."""


def visit_distribution(task: Task, policy: npt.ArrayLike | None = None) -> FloatArray:
    """Return the share of visits that a policy pays to each state, (S,) float64, summing to 1.

    mu(s) = eta(s) / sum_s' eta(s') with the expected discounted visits of an episode,
    eta(s) = sum_t gamma^t Pr(s_t = s), t below the time limit: the on-policy distribution, with
    discounting as a form of termination (Sutton & Barto 2018, section 9.2). It is 0 in terminal
    states. Visits of late steps are left out once they are less than 1e-13 of all; without a time
    limit those after 30,000 steps come from one linear system.

    Parameters
    ----------
    task : Task
        With tables.
    policy : (S,) int array or (S, A) float array, optional
        As in :func:`evaluate`; uniformly random by default.

    Raises
    ------
    SettingError
        When the policy is malformed, or at discount 1, without a time limit, never ends.
    TaskError
        When the task has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> visit_distribution(GridWorld("S..T", discount=1.0), [1, 1, 1, 0])
    array([0.33333333, 0.33333333, 0.33333333, 0.        ])
    """
    mdp = tables(task)
    if policy is None:
        policy = mdp.random_policy
    checked = checked_policy(policy, mdp.terminal, mdp.actions.size, mdp.available)
    table = np.asarray(np.eye(mdp.actions.size)[checked] if checked.ndim == 1 else checked, float)
    step, now, visits = transitions(mdp, table), mdp.start, np.zeros(mdp.states.size)
    for _ in range(STEPS_AT_MOST if mdp.time_limit is None else mdp.time_limit):
        visits += now
        now = mdp.discount * (now @ step)
        if now.sum() <= NEGLIGIBLE * visits.sum():
            break
    else:
        if mdp.time_limit is None:
            endless = mdp.discount == 1 and TabularPlanningModel.of(mdp).endless(table).size
            small = visits.size <= LARGEST_DIRECT and not endless
            visits += solved(step.T, mdp.discount, now) if small else np.nan
        if not np.isfinite(visits).all():
            raise SettingError(
                f"visits need a time limit, or episodes that end, in up to {LARGEST_DIRECT:,} "
                f"states: after {STEPS_AT_MOST:,} steps {now.sum():.3g} of them go on, in "
                f"{visits.size:,} states"
            )
    return frozen(np.asarray(visits / visits.sum()))
