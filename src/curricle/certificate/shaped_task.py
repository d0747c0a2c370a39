"""The shaped task beside the task itself: both solved, and their optimal actions compared.

All of it uses the tables of a :class:`FiniteMDP` and the error bounds of :func:`solve`. An action
counts as better or worse than another only where no error within the bounds could make them equal.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.certificate.checked_shaping import RewardFunction
from curricle.errors import PotentialError, SettingError
from curricle.planning.solution import EPSILON, Solution, solve
from curricle.tasks.labels import action_name, state_name
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.reachability import reachable_states
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task

AnyInts = npt.NDArray[np.integer[Any]]
CHUNK = 1_000_000
"""Transitions passed to a shaping reward at a time."""
ATTEMPTS = 15
"""Tolerances that are tried, each ten times the one before."""


@dataclass(frozen=True, eq=False)
class Reachable:
    """The part of a task that can be reached from the start, under any policy.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> Reachable.of(GridWorld(["S#.", ".#T"]).mdp).states  # a wall cuts off the east
    array([0, 2])
    """

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
        starts = range(0, len(self.source), CHUNK)
        return np.concatenate(
            [
                shaping_rewards(
                    self.mdp,
                    function,
                    *(
                        part[first : first + CHUNK].astype(np.int64)
                        for part in (self.source, self.action, self.target)
                    ),
                )
                for first in starts
            ]
        )


def shaping_rewards(
    task: Any, function: RewardFunction, s: IntArray, a: IntArray, after: IntArray
) -> FloatArray:
    """Return F(s, a, s') of E transitions, (E,), or raise PotentialError naming a bad one."""
    given = function(s, a, after)
    try:
        values = np.broadcast_to(np.asarray(given, np.float64), (len(s),))
    except (TypeError, ValueError):
        shape = np.shape(given) if isinstance(given, np.ndarray) else repr(given)
        raise PotentialError(
            f"a shaping reward must return a number for each of {len(s):,} transitions: got {shape}"
        ) from None
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        i = bad[0]
        raise PotentialError(
            f"a shaping reward must be finite: it is {values[i]} from "
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


def solve_closely(task: Task, tolerance: float) -> Solution:
    """Return the solution to `tolerance`, or else as close as double precision gets."""
    for _ in range(ATTEMPTS):
        try:
            return solve(task, tolerance=tolerance)
        except SettingError:  # rounding alone exceeds the tolerance
            tolerance *= 10
    return solve(task, tolerance=tolerance)


def default_tolerance(mdp: FiniteMDP) -> float:
    """Return the tolerance for :func:`solve_closely`: 1e-8 of the largest reward."""
    return 1e-8 * (_largest(mdp.reward[np.isfinite(mdp.reward)]) or 1.0)


# -- the values that a policy acts on ------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ShapedValues:
    """The values that a policy acts on under shaping, of the N reachable states."""

    values: FloatArray  # (N, A)
    bound: float  # their largest possible error
    residual: float  # their largest distance from what theory derives from the task's own values


def with_reward(own: Solution, met: Reachable, f: FloatArray, shift: FloatArray) -> ShapedValues:
    """Return the optimal values for rewards r + F, F (E,); by theory Q* - shift, shift (N,)."""
    solution = solve_closely(shaped_task(met, f), default_tolerance(met.mdp))
    q = solution.action_values[met.states]
    expected = own.action_values[met.states] - shift[:, None]
    return ShapedValues(q, solution.error_bound, _largest(q - expected))


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
        solution = solve_closely(shaped_task(met, f), default_tolerance(mdp))
    q = look_ahead_sweep(mdp, phi, solution.action_values - phi)
    acted = (q + phi)[met.states]
    rounding = (mdp.probability.shape[1] + 8) * EPSILON * (_largest(phi) + _largest(acted))
    residual = _largest(acted - own.action_values[met.states])
    return ShapedValues(acted, solution.error_bound + rounding, residual)


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
    return ShapedValues(acted, own.error_bound + rounding, _largest(added))


def _largest(array: FloatArray) -> float:
    return float(abs(array).max(initial=0.0))


# -- the comparison ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ActionComparison:
    """Where the optimal actions of a task and of its shaped version differ, N states."""

    tolerance: float  # actions this close to the best count as optimal
    chosen: BoolArray  # (N, A), may be optimal in the shaped task
    worse: BoolArray  # (N, A), chosen, and worse than the best of the task
    given_up: BoolArray  # (N, A), may be optimal in the task, and worse than the best when shaped
    short: FloatArray  # (N, A), difference from the best in the task
    shaped_short: FloatArray  # (N, A), difference from the best in the shaped task

    @property
    def loss(self) -> float:
        """The most that one action that may be optimal in the shaped task loses."""
        return float(self.short[self.chosen].max(initial=0.0))

    @property
    def agrees(self) -> bool:
        """Whether the optimal actions are the same."""
        return not (self.worse.any() or self.given_up.any())


def compare_actions(
    q: FloatArray, bound: float, shaped: ShapedValues, tolerance: float | None = None
) -> ActionComparison:
    """Return where the optimal actions provably differ; tolerance by default 1e-6 of Q*'s size.

    A difference of two values is known to twice their bound. A tolerance of four bounds keeps
    rounding from making an exception: an action that falls short by more than the tolerance in
    one problem, and by as much in truth in the other, cannot be optimal there.
    """
    least = 4 * max(bound, shaped.bound)
    if tolerance is not None and tolerance < least:
        raise SettingError(
            f"tolerance must be at least {least:.1e}, four times the error of the values compared: "
            f"got {tolerance:g}"
        )
    if tolerance is None:
        tolerance = max(1e-6 * _largest(q), least)
    short = q.max(axis=1, keepdims=True) - q
    shaped_short = shaped.values.max(axis=1, keepdims=True) - shaped.values
    chosen, optimal = shaped_short <= 2 * shaped.bound, short <= 2 * bound
    worse = chosen & (short > tolerance + 2 * bound)
    given_up = optimal & (shaped_short > tolerance + 2 * shaped.bound)
    return ActionComparison(tolerance, chosen, worse, given_up, short, shaped_short)


def total_loss(own: Solution, met: Reachable, chosen: BoolArray) -> float:
    """Return the most that a policy of `chosen` actions, (N, A), loses from a reachable state.

    max_s V*(s) - V_worst(s), where V_worst is the lowest value that such a policy has.
    """
    mdp = met.mdp
    row = mdp.outcome_row.copy()
    rows = row[met.states]
    first = np.take_along_axis(rows, chosen.argmax(axis=1)[:, None], axis=1)
    row[met.states] = np.where(chosen, rows, first)
    against = replace(mdp, outcome_row=frozen(row), reward=frozen(-mdp.reward))
    worst = -solve_closely(against, default_tolerance(mdp)).values
    return float((own.values - worst)[met.states].max(initial=0.0))
