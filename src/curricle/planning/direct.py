"""Small systems solved directly: a policy's values, the best by policy iteration, shortest paths.

Sweeps take as many steps as an episode has; a direct solution does not. It proves nothing by
itself: the caller backs its values up and bounds what is left.

At discount 1 some policy may never end. Where each such policy costs without bound, V* is finite
and solves V = TV alone (Bertsekas, Tsitsiklis 1991). Two things prove it, and bound the error. If
W >= TW + c, c > 0, then r <= W - PW - c: what goes on for ever gets at most -c a step. And if
TV <= V + d, then U = V + t (W - V) with t = d / c <= 1 has TU <= U, hence U >= V*.
"""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.errors import SettingError
from curricle.planning.models import TabularPlanningModel
from curricle.tasks.mdp import FiniteMDP, steps_to
from curricle.tasks.spaces import state_name

LARGEST_DIRECT = 5_000
"""States up to which systems are solved directly, in seconds even where they are dense."""
MOST_IMPROVEMENTS = 1_000
COSTS = 2.0 ** -np.arange(1, 41, 3)
"""What endless ways are tried to cost at least, in units of the largest reward."""


def transitions(mdp: FiniteMDP, chances: FloatArray) -> Any:
    """Return the chance of each next state that goes on, a sparse (S, S) array, for (S, A) ones."""
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


def best_policy(model: TabularPlanningModel, unit: float) -> tuple[FloatArray, IntArray]:
    """Return V of the policy that policy iteration ends with, (S,), and its actions (Howard 1960).

    It starts from a policy that ends. At discount 1 one that improves it never ends only if it need
    not pay for going on: it is returned with values that are not finite.
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

    `unit` is the relative rounding error of a backup. SettingError where there is no finite V*, or
    where an endless way costs less than can be told from nothing.
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
    """Return how far `values`, of a policy that ends, are from V*; infinite if not known.

    `above` is W at the head of this file. V* is at least what the policy is worth.
    """
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
    left = abs(backed_up(counted, lengths)[places, policy] - lengths)[live].max() + rounding_lengths
    cost = float((above - backed_up(model, above).max(axis=1))[live].min()) - rounding_above
    over = max(0.0, float((q.max(axis=1) - values)[live].max())) + rounding
    if not (left < 1 and 0 < over <= cost):
        return np.inf
    lower = short * float(lengths.max()) / (1 - left)
    upper = over / cost * max(0.0, float((above - values).max()))
    return float((max(lower, upper) + rounding) * model.largest_sum(None) * (1 + 64 * unit))
