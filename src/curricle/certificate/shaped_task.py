"""The shaped task, and the values that a policy acts on in it, with proven error bounds.

All of it uses the tables of a :class:`FiniteMDP` and the error bounds of :func:`solve`.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray, frozen
from curricle.certificate.checked_shaping import CheckedShaping, RewardFunction
from curricle.errors import PotentialError
from curricle.learning.potential import LARGEST_POTENTIAL
from curricle.planning.solution import EPSILON, Solution, solve
from curricle.tasks.mdp import FiniteMDP, reachable_states
from curricle.tasks.spaces import action_name, state_name

AnyInts = npt.NDArray[np.integer[Any]]
CHUNK = 1_000_000
"""Transitions passed to a shaping reward at a time."""
ROUNDED = 1.25
"""Factor of an error bound that covers the rounding of r + F.

The bound allows for at least four roundings of the largest reward at every step.
"""


@dataclass(frozen=True, eq=False)
class Reachable:
    """The part of a task that can be reached from the start, under any policy."""

    mdp: FiniteMDP
    met: BoolArray  # (S,), ends included
    states: IntArray  # (N,), ends left out
    ends: IntArray  # terminal states
    rows: AnyInts  # (N A,), the outcome row of each pair
    possible: BoolArray  # (N A, O), E outcomes that can happen: state, action and next state are
    source: AnyInts  # (E,)
    action: AnyInts  # (E,)
    target: AnyInts  # (E,)

    @classmethod
    def of(cls, mdp: FiniteMDP) -> "Reachable":
        """Return the reachable part of a task."""
        met = reachable_states(mdp)
        states = np.flatnonzero(met & ~mdp.terminal)
        rows = mdp.outcome_row[states].ravel()
        possible = mdp.probability[rows] > 0
        place, action = np.divmod(np.nonzero(possible)[0].astype(np.int32), mdp.actions.size)
        return cls(
            mdp,
            met,
            states,
            np.flatnonzero(met & mdp.terminal),
            rows,
            possible,
            states.astype(np.int32)[place],
            action,
            mdp.next_state[rows][possible],
        )

    def reward(self, function: RewardFunction) -> FloatArray:
        """Return F of each transition, (E,)."""
        rewards = []
        for first in range(0, len(self.source), CHUNK):
            part = slice(first, first + CHUNK)
            s, a, after = self.source[part], self.action[part], self.target[part]
            pairs = s.astype(np.int64), a.astype(np.int64)
            rewards.append(shaping_rewards(self.mdp, function, *pairs, after.astype(np.int64)))
        return np.concatenate(rewards)


def shaping_rewards(
    task: Any,
    function: RewardFunction,
    s: IntArray,
    a: IntArray,
    after: IntArray,
) -> FloatArray:
    """Return F(s, a, s') of E transitions, (E,), or raise PotentialError where there is none."""
    try:
        given = function(s, a, after)
    except Exception as error:
        raise PotentialError(
            f"a shaping reward must take arrays of states, actions and next states: it raised "
            f"{type(error).__name__}: {error}"
        ) from error
    try:
        values = np.broadcast_to(np.asarray(given, np.float64), (len(s),))
    except (TypeError, ValueError):
        shape = np.shape(given) if isinstance(given, np.ndarray) else repr(given)
        raise PotentialError(
            f"a shaping reward must return a number for each of {len(s):,} transitions: got {shape}"
        ) from None
    bad = np.flatnonzero(~(abs(values) <= LARGEST_POTENTIAL))
    if bad.size:
        i = bad[0]
        rule = f"at most {LARGEST_POTENTIAL:.0e} in size" if np.isfinite(values[i]) else "finite"
        raise PotentialError(
            f"a shaping reward must be {rule}: it is {values[i]:g} from "
            f"{state_name(task.states, int(s[i]))} by {action_name(task.actions, int(a[i]))} to "
            f"{state_name(task.states, int(after[i]))}"
        )
    return values


def shaped_task(met: Reachable, f: FloatArray) -> FiniteMDP:
    """Return the task with rewards r + F, F (E,); every reachable pair has its own row."""
    mdp, rows = met.mdp, met.rows
    own = np.zeros(mdp.outcome_row.shape, np.int32)  # unreachable states may have any row
    own[met.states] = np.arange(len(rows), dtype=np.int32).reshape(-1, mdp.actions.size)
    reward = mdp.reward[rows]
    reward[met.possible] += f
    return replace(
        mdp,
        outcome_row=frozen(own),
        probability=frozen(mdp.probability[rows]),
        next_state=frozen(mdp.next_state[rows]),
        reward=frozen(reward),
    )


# -- the values that a policy acts on ------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ShapedValues:
    """The values that a policy acts on under shaping, of the N reachable states."""

    values: FloatArray  # (N, A)
    bound: float  # their largest possible error
    residual: float  # their largest distance from what theory derives from the task's own values
    largest: float  # the largest number that they are computed from


def shaped_values(shaping: CheckedShaping, own: Solution, met: Reachable) -> ShapedValues:
    """Return the values that a policy acts on under a potential."""
    phi, discount = shaping.last_values(), shaping.discount
    match shaping.shaping.claim:
        case "telescoping":
            f = met.reward(lambda s, a, after: discount * phi[after] - phi[s])
            return with_reward(own, met, f, phi[met.states])
        case "added_values":
            return with_advice(own, met, phi)
        case "one_way_in":
            return with_look_back(own, met, phi)
        case _:
            return with_look_ahead(own, met, phi)


def with_reward(own: Solution, met: Reachable, f: FloatArray, shift: FloatArray) -> ShapedValues:
    """Return the optimal values for rewards r + F, F (E,); by theory Q* - shift, shift (N,)."""
    solution = solve(shaped_task(met, f))
    q = solution.action_values[met.states]
    expected = own.action_values[met.states] - shift[:, None]
    largest = max(_largest(q), _largest(f))
    return ShapedValues(q, ROUNDED * solution.error_bound, _largest(q - expected), largest)


def with_look_ahead(own: Solution, met: Reachable, phi: FloatArray) -> ShapedValues:
    """Return Q + phi under look-ahead advice, or after starting at phi; by theory Q*.

    The operator Q <- E[r + gamma phi(s', a*) - phi(s, a) + gamma Q(s', a*)], a* = argmax Q + phi,
    is a contraction of Q + phi. Its one fixed point is Q* of a task whose ends pay
    gamma max_a phi(end, a). That task is solved, and the operator then applied once as written, so
    that the bound holds for its own result.
    """
    mdp = met.mdp
    solution = own
    if phi[met.ends].any():
        ending = np.where(mdp.terminal, mdp.discount * phi.max(axis=1), 0.0)
        f = met.reward(lambda s, a, after: ending[after])
        solution = solve(shaped_task(met, f))
    q = look_ahead_sweep(mdp, phi, solution.action_values - phi)
    acted = (q + phi)[met.states]
    rounding = (mdp.probability.shape[1] + 8) * EPSILON * (_largest(phi) + _largest(acted))
    residual = _largest(acted - own.action_values[met.states])
    largest = max(_largest(phi), _largest(acted))
    return ShapedValues(acted, solution.error_bound + rounding, residual, largest)


def look_ahead_sweep(mdp: FiniteMDP, phi: FloatArray, q: FloatArray) -> FloatArray:
    """Return one sweep of Q-learning's expected update under look-ahead advice, (S, A).

    E[r + gamma phi(s', a*) - phi(s, a) + gamma Q(s', a*)] with a* = argmax_b Q(s', b) + phi(s', b);
    Q of an end is 0, phi of an end is as given (Wiewiora, Cottrell, Elkan 2003).
    """
    q = np.where(mdp.terminal[:, None], 0.0, q)
    best = (q + phi).argmax(axis=1)
    everywhere = np.arange(len(q))
    bootstrap = mdp.discount * (phi[everywhere, best] + q[everywhere, best])
    rows = (mdp.probability * (mdp.reward + bootstrap[mdp.next_state])).sum(axis=1)
    return np.where(mdp.terminal[:, None], 0.0, rows[mdp.outcome_row] - phi)


def with_look_back(own: Solution, met: Reachable, phi: FloatArray) -> ShapedValues:
    """Return Q under look-back advice, by theory Q* - phi(before) / gamma.

    All transitions into a state must have one phi. Then F = phi(s_t, a_t) - phi(s_{t-1}, a_{t-1})
    / gamma, with phi = 0 before the start and at ends, is a function of s, a and s'.
    """
    mdp = met.mdp
    before = np.zeros(mdp.states.size)
    before[met.target] = phi[met.source, met.action]
    before[mdp.start > 0] = 0.0
    shift = before / mdp.discount

    def reward(s: IntArray, a: IntArray, after: IntArray) -> FloatArray:
        return np.where(mdp.terminal[after], 0.0, phi[s, a]) - shift[s]

    return with_reward(own, met, met.reward(reward), shift[met.states])


def with_advice(own: Solution, met: Reachable, advice: FloatArray) -> ShapedValues:
    """Return Q* + advice, (S, A), for policies that learn Q from plain rewards."""
    added = advice[met.states]
    acted = own.action_values[met.states] + added
    rounding = EPSILON * (_largest(acted) + _largest(added))
    largest = max(_largest(acted), _largest(added))
    return ShapedValues(acted, own.error_bound + rounding, _largest(added), largest)


def _largest(array: FloatArray) -> float:
    return float(abs(array).max(initial=0.0))
