"""A shaped task beside the task itself: both solved, and their optimal actions compared.

Everything here rests on the tables of a :class:`FiniteMDP` and on the error bounds of
:func:`solve`. An action is *better* or *worse* only where no error within the bounds could make it
the same.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.errors import PotentialError, SettingError
from curricle.planning.solution import EPSILON, Solution, solve
from curricle.tasks.labels import action_name, state_name
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.reachability import reachable_states
from curricle.tasks.spaces import frozen
from curricle.tasks.task import Task

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Bonus = Callable[[IntArray, IntArray, IntArray], Any]
"""F(s, a, s'), what shaping adds to the reward of each of E transitions, (E,) float."""
BLOCK = 1_000_000
"""Transitions that a bonus is asked about at once."""
ATTEMPTS = 15


@dataclass(frozen=True, eq=False)
class Reached:
    """What can be met on the way from the start, under any policy.

    Attributes
    ----------
    mdp : FiniteMDP
    states : (N,) int64
        States that can be reached, ends left out.
    ends : (M,) int64
        Terminal states that can be reached.
    """

    mdp: FiniteMDP
    states: IntArray
    ends: IntArray

    @property
    def width(self) -> int:
        """A O, the outcomes that a state's actions have."""
        return self.mdp.actions.size * int(self.mdp.probability.shape[1])

    @cached_property
    def rows(self) -> npt.NDArray[np.integer[Any]]:
        """The outcome row of each pair, (N A,)."""
        return self.mdp.outcome_row[self.states].ravel()

    def transitions(self) -> Iterator[tuple[slice, BoolArray, IntArray, IntArray, IntArray]]:
        """Yield pairs block by block: which, (n, O) outcomes possible, and s, a, s' of these."""
        n_actions = self.mdp.actions.size
        pairs = max(1, BLOCK // int(self.mdp.probability.shape[1]))
        for first in range(0, len(self.rows), pairs):
            block = slice(first, min(first + pairs, len(self.rows)))
            possible = self.mdp.probability[self.rows[block]] > 0
            pair = first + np.nonzero(possible)[0]
            reached = self.mdp.next_state[self.rows[block]][possible].astype(np.int64)
            yield block, possible, self.states[pair // n_actions], pair % n_actions, reached

    def paid(self, bonus: Bonus) -> FloatArray:
        """Return F of every outcome of every pair, (N A, O) float64; 0 where it cannot happen."""
        f = np.zeros((len(self.rows), self.mdp.probability.shape[1]))
        for block, possible, *transition in self.transitions():
            f[block][possible] = bonus_values(self.mdp, bonus, *transition)
        return f


def reached(mdp: FiniteMDP) -> Reached:
    """Return what can be met on the way from the start: breadth first over the tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> reached(GridWorld(["S#.", ".#T"]).mdp).states  # the east lies behind a wall
    array([0, 2])
    """
    rows = mdp.outcome_row, mdp.probability, mdp.next_state
    met = reachable_states(mdp.start, mdp.terminal, *rows)
    states, ends = np.flatnonzero(met & ~mdp.terminal), np.flatnonzero(met & mdp.terminal)
    return Reached(mdp, frozen(states), frozen(ends))


def bonus_values(task: Any, bonus: Bonus, s: IntArray, a: IntArray, after: IntArray) -> FloatArray:
    """Return F(s, a, s') of some transitions, (E,), or raise PotentialError naming a bad one."""
    given = bonus(s, a, after)
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


def shaped_task(reached: Reached, f: FloatArray) -> FiniteMDP:
    """Return the task with r + F for rewards, F (N A, O); every pair has a row of its own."""
    mdp, rows = reached.mdp, reached.rows
    own = np.zeros(mdp.outcome_row.shape, np.int32)  # others are not met: any row does
    own[reached.states] = np.arange(len(rows), dtype=np.int32).reshape(-1, mdp.actions.size)
    return _task(mdp, own, mdp.probability[rows], mdp.next_state[rows], mdp.reward[rows] + f)


def _task(mdp: FiniteMDP, row: Any, probability: Any, next_state: Any, reward: Any) -> FiniteMDP:
    return FiniteMDP(
        states=mdp.states,
        actions=mdp.actions,
        outcome_row=frozen(row),
        probability=frozen(probability),
        next_state=frozen(next_state),
        reward=frozen(reward),
        terminal=mdp.terminal,
        start=mdp.start,
        discount=mdp.discount,
        time_limit=mdp.time_limit,
    )


def solved(task: Task, tolerance: float) -> Solution:
    """Return the solution, to `tolerance` or else as close as double precision gets.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> solved(GridWorld("S.T"), 1e-16).error_bound < 1e-8
    True
    """
    for _ in range(ATTEMPTS):
        try:
            return solve(task, tolerance=tolerance)
        except SettingError:  # the tolerance is below what rounding alone comes to
            tolerance *= 10
    return solve(task, tolerance=tolerance)


def closeness(mdp: FiniteMDP) -> float:
    """Return the tolerance to ask of :func:`solved`: 1e-8 of the largest reward that is paid."""
    paid = abs(mdp.reward[np.isfinite(mdp.reward)])
    return 1e-8 * (float(paid.max(initial=0.0)) or 1.0)


# -- what a policy acts on -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ActedOn:
    """What a policy acts on in the shaped task, and what theory says it is.

    Attributes
    ----------
    values : (N, A) float64
        Of the states that can be reached.
    bound : float
        No value is further from the true one.
    residual : float
        Largest distance from what a potential would make of the task's own values.
    """

    values: FloatArray
    bound: float
    residual: float


def with_reward(own: Solution, reached: Reached, f: FloatArray, shift: FloatArray) -> ActedOn:
    """Return the optimal values of the task with r + F, which theory takes for Q* - shift.

    `f` is (N A, O), `shift` (N,).
    """
    solution = solved(shaped_task(reached, f), closeness(reached.mdp))
    q = solution.action_values[reached.states]
    expected = own.action_values[reached.states] - shift[:, None]
    return ActedOn(q, solution.error_bound, _largest(q - expected))


def with_look_ahead(own: Solution, reached: Reached, phi: FloatArray) -> ActedOn:
    """Return Q + phi under look-ahead advice, or started at phi, which theory takes for Q*.

    The operator Q <- E[r + gamma phi(s', a*) - phi(s, a) + gamma Q(s', a*)], a* = argmax Q + phi,
    is a contraction of Q + phi with the one fixed point to which it leads from Q = 0 as from
    anywhere: that of a task whose ends pay gamma max_a phi(end, a). That task is solved, and the
    operator then carried out once as it is written, so that the bound holds for what it gives.
    """
    mdp = reached.mdp
    solution = own
    if phi[reached.ends].any():
        ending = np.where(mdp.terminal, mdp.discount * phi.max(axis=1), 0.0)
        f = reached.paid(lambda s, a, after: ending[after])
        solution = solved(shaped_task(reached, f), closeness(mdp))
    q = look_ahead_sweep(mdp, phi, solution.action_values - phi)
    acted = (q + phi)[reached.states]
    rounding = (mdp.probability.shape[1] + 8) * EPSILON * (_largest(phi) + _largest(acted))
    residual = _largest(acted - own.action_values[reached.states])
    return ActedOn(acted, solution.error_bound + rounding, residual)


def look_ahead_sweep(mdp: FiniteMDP, phi: FloatArray, q: FloatArray) -> FloatArray:
    """Return one sweep of Q-learning's expected update under look-ahead advice, (S, A).

    E[r + gamma phi(s', a*) - phi(s, a) + gamma Q(s', a*)] with a* = argmax_b Q(s', b) + phi(s', b);
    Q of an end is 0, phi of an end is what it is given as (Wiewiora, Cottrell, Elkan 2003).
    """
    q = np.where(mdp.terminal[:, None], 0.0, q)
    best = (q + phi).argmax(axis=1)
    everywhere = np.arange(len(q))
    worth = mdp.discount * (phi[everywhere, best] + q[everywhere, best])
    rows = (mdp.probability * (mdp.reward + worth[mdp.next_state])).sum(axis=1)
    return np.where(mdp.terminal[:, None], 0.0, rows[mdp.outcome_row] - phi)


def with_look_back(own: Solution, reached: Reached, phi: FloatArray) -> ActedOn:
    """Return Q under look-back advice where phi of the pair before is the same on every way in.

    F = phi(s_t, a_t) - phi(s_{t-1}, a_{t-1}) / gamma, with phi = 0 before the start and at ends,
    is then a reward of s, a and s', and theory takes Q for Q* - phi(before) / gamma.
    """
    mdp = reached.mdp
    before = ways_in(reached, phi)[0]

    def given(s: IntArray, a: IntArray, after: IntArray) -> FloatArray:
        return np.where(mdp.terminal[after], 0.0, phi[s, a]) - before[s] / mdp.discount

    shift = before[reached.states] / mdp.discount
    return with_reward(own, reached, reached.paid(given), shift)


def ways_in(reached: Reached, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest phi(s, a) of the pairs that lead into each state, (S,) each.

    0 counts among them where an episode may start.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> ways_in(reached(GridWorld("S.T").mdp), np.arange(12.0).reshape(3, 4))
    (array([0., 1., 5.]), array([7., 6., 5.]))
    """
    mdp = reached.mdp
    least = np.where(mdp.start > 0, 0.0, np.inf)
    most = np.where(mdp.start > 0, 0.0, -np.inf)
    for _, _, s, a, after in reached.transitions():
        np.minimum.at(least, after, phi[s, a])
        np.maximum.at(most, after, phi[s, a])
    return least, most


def entered(reached: Reached, state: int, phi: FloatArray, value: float) -> tuple[int, int] | None:
    """Return a pair that leads into a state with phi(s, a) = `value`; None if it is the start."""
    for _, _, s, a, after in reached.transitions():
        ways = np.flatnonzero((after == state) & (phi[s, a] == value))
        if ways.size:
            return int(s[ways[0]]), int(a[ways[0]])
    return None


def with_advice(own: Solution, reached: Reached, advice: FloatArray) -> ActedOn:
    """Return Q* + advice, (S, A), for policies that learn Q on plain rewards."""
    added = advice[reached.states]
    acted = own.action_values[reached.states] + added
    rounding = EPSILON * (_largest(acted) + _largest(added))
    return ActedOn(acted, own.error_bound + rounding, _largest(added))


def _largest(array: FloatArray) -> float:
    return float(abs(array).max(initial=0.0))


# -- comparing -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Comparison:
    """Where the optimal actions of a task and of its shaped twin differ, N states.

    Attributes
    ----------
    tolerance : float
        Actions this close to the best count as optimal.
    chosen : (N, A) bool
        Actions possibly optimal in the shaped task.
    worse : (N, A) bool
        Chosen ones that are worse than the best of the task.
    given_up : (N, A) bool
        Actions possibly optimal in the task that are worse than the best of the shaped task.
    short, shaped_short : (N, A) float64
        By how much each action falls short of the best, in the task and in the shaped task.
    """

    tolerance: float
    chosen: BoolArray
    worse: BoolArray
    given_up: BoolArray
    short: FloatArray
    shaped_short: FloatArray

    @property
    def loss(self) -> float:
        """The most that one action possibly optimal in the shaped task loses."""
        return float(self.short[self.chosen].max(initial=0.0))

    @property
    def agrees(self) -> bool:
        """Whether no action is an exception."""
        return not (self.worse.any() or self.given_up.any())


def compare(
    q: FloatArray, bound: float, acted: ActedOn, tolerance: float | None = None
) -> Comparison:
    """Return where the optimal actions differ, provably; tolerance by default 1e-6 of Q*'s size.

    A difference of two values is known to twice their bound. A tolerance of four bounds keeps
    rounding from making an exception: an action that falls short by more than the tolerance in
    one problem and as much in truth in the other is not possibly optimal there.
    """
    least = 4 * max(bound, acted.bound)
    if tolerance is not None and tolerance < least:
        raise SettingError(
            f"tolerance must be at least {least:.1e}, four times the error of what is compared: "
            f"got {tolerance:g}"
        )
    if tolerance is None:
        tolerance = max(1e-6 * _largest(q), least)
    short = q.max(axis=1, keepdims=True) - q
    shaped_short = acted.values.max(axis=1, keepdims=True) - acted.values
    chosen, optimal = shaped_short <= 2 * acted.bound, short <= 2 * bound
    worse = chosen & (short > tolerance + 2 * bound)
    given_up = optimal & (shaped_short > tolerance + 2 * acted.bound)
    return Comparison(tolerance, chosen, worse, given_up, short, shaped_short)


def total_loss(own: Solution, reached: Reached, chosen: BoolArray) -> float:
    """Return what a policy that keeps to the `chosen` actions, (N, A), loses in all at worst.

    max_s V*(s) - V_worst(s) over the states that can be reached, V_worst the lowest value such a
    policy has.
    """
    mdp = reached.mdp
    row = mdp.outcome_row.copy()
    rows = row[reached.states]
    first = np.take_along_axis(rows, chosen.argmax(axis=1)[:, None], axis=1)
    row[reached.states] = np.where(chosen, rows, first)
    against = _task(mdp, row, mdp.probability, mdp.next_state, -mdp.reward)
    worst = -solved(against, closeness(mdp)).values
    return float((own.values - worst)[reached.states].max(initial=0.0))
