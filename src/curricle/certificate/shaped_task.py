"""A shaping in its task: the values on which a policy acts, and the potential behind a reward.

If F(s, a, s') = gamma Phi(s') - Phi(s) and Phi is 0 at the ends, then the discounted sum of F is
-Phi(s) along *every* path from s. One path from each state thus gives the only possible Phi, and
all other transitions tell whether that Phi fits (Ng, Harada, Russell 1999).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.checks import number, one_of
from curricle.errors import PotentialError, SettingError, in_words
from curricle.learning.potential import LARGEST_POTENTIAL, PairPotential, StatePotential
from curricle.learning.shaping import Shaping
from curricle.planning.solution import EPSILON, Solution, solve_without_limit
from curricle.tasks.graph import reachable_states
from curricle.tasks.mdp import FiniteMDP, Task, generative_model, live_pairs, tables
from curricle.tasks.spaces import action_name, state_name

RewardFunction = Callable[..., Any]
"""Returns F(s, a, s') of E transitions, (E,) float, which shaping adds to their rewards."""
Ends = Literal["zero", "given"]
"""Whether an array is read at the ends as 0, as by :func:`learn`, or with its values there."""
AnyInts = npt.NDArray[np.integer[Any]]
CHUNK = 1_000_000  # transitions passed to a shaping reward at a time
# Factor of an error bound that covers the rounding of r + F: the bound allows for at least four
# roundings of the largest reward at every step.
ROUNDED = 1.25


@dataclass(frozen=True)
class ShapingReward(Shaping):
    """A user's shaping reward F(s, a, s') for :func:`certify`; no learner takes it.

    Parameters
    ----------
    function : callable
        Takes three (E,) int64 arrays (states, actions, next states) of transitions that can happen
        and returns (E,) floats.

    Examples
    --------
    >>> ShapingReward(lambda state, action, after: 5.0 * (after == state)).any_reward
    True
    """

    function: RewardFunction

    for_tables: ClassVar[bool] = False
    theorem: ClassVar[str] = "Ng, Harada, Russell 1999"
    any_reward: ClassVar[bool] = True
    potential: ClassVar[None] = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise SettingError(
                f"ShapingReward takes a function F(s, a, s'): got {type(self.function).__name__}"
            )

    def reward(self, shaped: object) -> RewardFunction:
        """Return the function itself."""
        return self.function


# -- the task without shaping ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Reachable:
    """The part of a task that can be reached from the start, under any policy."""

    mdp: FiniteMDP
    reached: BoolArray  # (S,), ends included
    states: IntArray  # (N,), ends left out
    ends: IntArray  # terminal states
    rows: AnyInts  # (N A,), the outcome row of each pair
    possible: BoolArray  # (N A, O), True for E possible outcomes: state, action, next state
    source: AnyInts  # (E,)
    action: AnyInts  # (E,)
    target: AnyInts  # (E,)

    @classmethod
    def of(cls, mdp: FiniteMDP) -> "Reachable":
        """Return the reachable part of a task."""
        reached = reachable_states(mdp)
        states = np.flatnonzero(reached & ~mdp.terminal)
        rows = mdp.outcome_row[states].ravel()
        possible = (mdp.probability[rows] > 0) & live_pairs(mdp)[states].reshape(-1, 1)
        place, action = np.divmod(np.nonzero(possible)[0].astype(np.int32), mdp.actions.size)
        ends, source = np.flatnonzero(reached & mdp.terminal), states.astype(np.int32)[place]
        target = mdp.next_state[rows][possible]
        return cls(mdp, reached, states, ends, rows, possible, source, action, target)

    def reward(self, function: RewardFunction) -> FloatArray:
        """Return F of every possible transition, (E,)."""
        rewards = []
        for first in range(0, len(self.source), CHUNK):
            part = slice(first, first + CHUNK)
            parts = (x[part].astype(np.int64) for x in (self.source, self.action, self.target))
            rewards.append(shaping_rewards(self.mdp, function, *parts))
        return np.concatenate(rewards)

    def with_reward(self, f: FloatArray) -> FiniteMDP:
        """Return the task with rewards r + F, F (E,); every reachable pair has its own row."""
        mdp, rows = self.mdp, self.rows
        row = np.zeros(mdp.outcome_row.shape, np.int32)  # rows of unreachable states are arbitrary
        row[self.states] = np.arange(len(rows), dtype=np.int32).reshape(-1, mdp.actions.size)
        reward = mdp.reward[rows]
        reward[self.possible] += f
        return replace(
            mdp,
            outcome_row=frozen(row),
            probability=frozen(mdp.probability[rows]),
            next_state=frozen(mdp.next_state[rows]),
            reward=frozen(reward),
        )


def shaping_rewards(
    task: Task, function: RewardFunction, s: IntArray, a: IntArray, after: IntArray
) -> FloatArray:
    """Return F(s, a, s') of E transitions, (E,), or raise PotentialError if a number is missing."""
    try:
        rewards = function(s, a, after)
    except Exception as error:
        raise PotentialError(
            "a shaping reward must take arrays of states, actions and next states: it raised "
            f"{in_words(error)}"
        ) from error
    try:
        values = np.broadcast_to(np.asarray(rewards, np.float64), (len(s),))
    except (TypeError, ValueError):
        shape = np.shape(rewards) if isinstance(rewards, np.ndarray) else repr(rewards)
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


# -- the values on which a policy acts -------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ActionValues:
    """Values of actions in the N reachable states, and the actions that may be optimal."""

    # A difference of two values has an error of at most twice their bound. Actions that fall short
    # of the best by no more may be optimal; if there is a single such action, it is optimal.

    values: FloatArray  # (N, A)
    bound: float  # their largest possible error

    @property
    def error(self) -> float:
        """The largest error of a difference of two values."""
        return 2 * self.bound

    @cached_property
    def short(self) -> FloatArray:
        """How far each action falls short of the best action, (N, A)."""
        return np.asarray(self.values.max(axis=1, keepdims=True) - self.values)

    @cached_property
    def optimal(self) -> BoolArray:
        """The actions that may be optimal, (N, A)."""
        return self.short <= self.error

    def lost(self, actions: BoolArray, tolerance: float) -> FloatArray:
        """Return the proven loss of the best of `actions`, (N,); 0 within the tolerance."""
        least = np.where(actions, self.short, np.inf).min(axis=1) - self.error
        return np.where(least > tolerance, least, 0.0)


@dataclass(frozen=True, eq=False)
class ShapedValues(ActionValues):
    """The values on which a policy acts under shaping."""

    residual: float  # their largest distance from the values that theory derives from the task's
    largest: float  # the largest number from which they are computed


@dataclass(frozen=True, eq=False)
class ShapedTask:
    """A shaping with its task; the shaping's class reads it to tell why the shaping is safe."""

    task: Task
    shaping: Shaping
    potential: Any  # a potential of the library, or an array (S,) or (S, A) with values at the ends
    discount: float  # gamma of F: the task's discount, or another tool's
    ignored: FloatArray  # values of an array at the ends, which learn() ignores, (S,)

    compared: bool = False  # whether all states are compared

    @cached_property
    def reachable(self) -> Reachable:
        """The reachable states; only if states are compared."""
        return Reachable.of(tables(self.task))

    @cached_property
    def unshaped(self) -> Solution:
        """The solution of the task without shaping; only if states are compared."""
        return solve_without_limit(self.task)

    @cached_property
    def ends(self) -> IntArray:
        """The reachable terminal states; all known ones if states are not compared."""
        terminal = generative_model(self.task).terminal
        return (
            self.reachable.ends
            if self.compared
            else np.flatnonzero([] if terminal is None else terminal)
        )

    @property
    def task_discount(self) -> float:
        """The discount of the task."""
        return generative_model(self.task).discount

    @property
    def is_array(self) -> bool:
        """Whether the potential is an array, which need not be 0 at the ends."""
        return isinstance(self.potential, np.ndarray)

    @cached_property
    def phi(self) -> FloatArray:
        """The last potential times the last weight, (S,) or (S, A)."""
        values = self.potential if self.is_array else self.potential.values
        if isinstance(self.potential, StatePotential):
            values = values[-1]
        return np.asarray(self.shaping.last_weight * values)

    @property
    def phi_at_ends(self) -> FloatArray:
        """Phi(s), or max_a phi(s, a), that F reads at the ends; 0 unless it is an array."""
        if not self.is_array:
            return np.zeros(len(self.ends))
        phi = self.phi if self.phi.ndim == 1 else self.phi.max(axis=1)
        return np.asarray(phi[self.ends])

    @property
    def zero_at_ends(self) -> bool:
        """Whether the potential is 0 at all known ends."""
        return not self.phi_at_ends.any()

    # The values on which a policy acts, with proven bounds; the classes of shapings call these.

    def rewarded(self, reward: RewardFunction, off: FloatArray) -> ShapedValues:
        """Return Q* for rewards r + F(s, a, s'); by theory Q* - off, off (S,)."""
        return self.with_rewards(self.reachable.reward(reward), off[self.reachable.states])

    def with_rewards(self, f: FloatArray, off: FloatArray) -> ShapedValues:
        """Return Q* for rewards r + F, F (E,); by theory Q* - off, off (N,)."""
        solution = solve_without_limit(self.reachable.with_reward(f))
        q = solution.finite_action_values[self.reachable.states]
        expected = self.unshaped.finite_action_values[self.reachable.states] - off[:, None]
        bound = ROUNDED * solution.error_bound
        return ShapedValues(q, bound, _largest(q - expected), _largest(q, f))

    def looking_ahead(self, phi: FloatArray) -> ShapedValues:
        """Return Q + phi under look-ahead advice, or with the initial Q at phi; by theory Q*."""
        # The sweep contracts Q + phi to Q* of a task whose ends pay gamma max_a phi(end, a). One
        # sweep follows the solution, so that the bound holds for the result of the sweep.
        reachable, mdp, solution = self.reachable, self.reachable.mdp, self.unshaped
        if phi[reachable.ends].any():
            ending = np.where(mdp.terminal, mdp.discount * phi.max(axis=1), 0.0)
            solution = solve_without_limit(
                reachable.with_reward(reachable.reward(lambda s, a, after: ending[after]))
            )
        acted = (look_ahead_sweep(mdp, phi, solution.finite_action_values - phi) + phi)[
            reachable.states
        ]
        rounding = (mdp.probability.shape[1] + 8) * EPSILON * (_largest(phi) + _largest(acted))
        residual = _largest(acted - self.unshaped.finite_action_values[reachable.states])
        bound = solution.error_bound + rounding
        return ShapedValues(acted, bound, residual, _largest(phi, acted))


def look_ahead_sweep(mdp: FiniteMDP, phi: FloatArray, q: FloatArray) -> FloatArray:
    """Return E[r + gamma phi(s', a*) - phi(s, a) + gamma Q(s', a*)], (S, A), a* = argmax Q + phi.

    Q of an end is 0; phi of an end is read from the array (Wiewiora, Cottrell, Elkan 2003).
    """
    q = np.where(mdp.terminal[:, None], 0.0, q)
    best = (q + phi).argmax(axis=1)
    everywhere = np.arange(len(q))
    bootstrap = mdp.discount * (phi[everywhere, best] + q[everywhere, best])
    rows = (mdp.probability * (mdp.reward + bootstrap[mdp.next_state])).sum(axis=1)
    return np.where(mdp.terminal[:, None], 0.0, rows[mdp.outcome_row] - phi)


def _largest(*arrays: FloatArray) -> float:
    return max(float(abs(array).max(initial=0.0)) for array in arrays)


def check_shaping(
    task: Task, shaping: object, shaping_discount: float | None = None, ends: Ends = "zero"
) -> ShapedTask:
    """Return a shaping with its task; PotentialError or SettingError if they do not fit."""
    if not isinstance(shaping, Shaping):
        raise SettingError(
            "certify takes a shaping, such as StateShaping(potential), or a "
            f"ShapingReward(function): got {type(shaping).__name__}"
        )
    by_function = isinstance(shaping, ShapingReward)
    if not (by_function or (shaping.for_tables and shaping.potential is not None)):
        raise SettingError(
            f"a shaping to be certified must be for tables and have a potential: got {shaping!r}"
        )
    one_of("ends", ends, ("zero", "given"), SettingError)
    generative = generative_model(task)
    discount = generative.discount
    if shaping_discount is not None:
        if not shaping.takes_discount:
            raise SettingError(
                "shaping_discount is the discount of F = gamma Phi(s') - Phi(s) and goes with "
                f"StateShaping: got {shaping.name}"
            )
        discount = number("shaping_discount", shaping_discount, SettingError, low=0, high=1)
    potential: Any = None if by_function else shaping.for_task(task).potential
    ignored = np.zeros(0)
    if not (by_function or isinstance(shaping.potential, StatePotential | PairPotential)):
        array = np.array(shaping.potential, dtype=np.float64)
        at_states = array if array.ndim == 1 else array.max(axis=1)
        terminal = generative.terminal
        if ends == "given":
            # Elsewhere as learn() reads it: a pair that is not available, -inf in values, copies
            # another.
            at_ends = at_states if isinstance(potential, StatePotential) else array
            if terminal is not None:
                is_end = terminal.reshape(-1, *[1] * (at_ends.ndim - 1))
                at_ends = np.where(is_end, at_ends, potential.values.reshape(at_ends.shape))
            potential = frozen(at_ends)
        elif terminal is not None:
            ignored = np.where(terminal, at_states, 0.0)
    return ShapedTask(task, shaping, potential, discount, ignored)


# -- the potential behind a reward, or a sentence on why there is none -----------------------------

RELATIVE_RESIDUAL = 1e-5  # residual, relative to the largest F, up to which a potential fits


@dataclass(frozen=True, eq=False)
class Fit(Frozen):
    """F as gamma Phi(s') - Phi(s)."""

    potential: FloatArray  # Phi, (S,); 0 in states that cannot be reached
    residual: FloatArray  # F - gamma Phi(s') + Phi(s), (E,)

    @property
    def worst(self) -> float:
        """The largest absolute residual; infinite if one is NaN."""
        sizes = abs(self.residual)
        return float(np.where(np.isnan(sizes), np.inf, sizes).max(initial=0.0))


def fit(reachable: Reachable, f: FloatArray, discount: float, *, ends_are_zero: bool = True) -> Fit:
    """Return the only Phi from which F, (E,), can come; Phi of ends is 0 or free."""
    # One transition a state gives its Phi from the Phi of a neighbour. Where that leaves a number
    # free, `group` is the number on which a state depends, `slope` the change of Phi with it.
    source, target, terminal = reachable.source, reachable.target, reachable.mdp.terminal
    has_phi, phi, slope = (
        ~reachable.reached,
        np.zeros(len(reachable.reached)),
        np.zeros(len(reachable.reached)),
    )
    group, groups = np.zeros(len(reachable.reached), np.int64), 0

    def follow(forward: bool, transitions: IntArray) -> None:
        """Compute Phi of the states on one side of transitions from Phi on the other side."""
        unknown, neighbour = (target, source) if forward else (source, target)
        states, first = np.unique(unknown[transitions], return_index=True)
        by = transitions[first]  # the first transition of a state
        if not forward:
            phi[states] = discount * phi[neighbour[by]] - f[by]
            slope[states] = discount * slope[neighbour[by]]
        elif discount > 0:
            phi[states] = (f[by] + phi[neighbour[by]]) / discount
            slope[states] = slope[neighbour[by]] / discount
        has_phi[states], group[states] = True, groups

    def follow_backward() -> None:
        waiting = np.flatnonzero(~has_phi[source])
        while (ready := waiting[has_phi[target[waiting]]]).size:
            follow(False, ready)
            waiting = waiting[~has_phi[source[waiting]]]

    # Forward steps at a small discount may overflow. Then no potential fits.
    with np.errstate(over="ignore", invalid="ignore"):
        if ends_are_zero:
            has_phi[reachable.ends] = True
            follow_backward()
        if discount < 1:
            cycle = _endless(reachable, ~has_phi & ~terminal)
            states, first = np.unique(source[cycle], return_index=True)
            by = cycle[first]
            after, weight, total = np.searchsorted(states, target[by]), discount, -f[by]
            while weight > 1e-20:  # the sums over the first 1, 2, 4, ... steps
                total = total + weight * total[after]
                after, weight = after[after], weight**2
            phi[states], has_phi[states] = total, True
            follow_backward()
        # Rounding errors grow in forward steps, so these come last.
        while not has_phi.all():
            forward_edges = np.flatnonzero(has_phi[source] & ~has_phi[target])
            if forward_edges.size:
                follow(True, forward_edges)
            else:  # states that no transition joins with has_phi states have a free number
                open_ends = np.flatnonzero(~has_phi & terminal)
                free = (open_ends if open_ends.size else np.flatnonzero(~has_phi))[:1]
                groups += 1
                slope[free], has_phi[free], group[free] = 1.0, True, groups
            follow_backward()
        residual = f - discount * phi[target] + phi[source]
        if groups:  # least squares decides the free numbers
            change = slope[source] - discount * slope[target]
            steep = np.bincount(group[source], change * change, groups + 1)
            pull = np.bincount(group[source], change * residual, groups + 1)
            best = np.divide(-pull, steep, out=np.zeros_like(pull), where=steep > 1e-18)
            phi = phi + best[group] * slope
            residual = residual + best[group[source]] * change
        return Fit(frozen(phi), residual)


def _endless(reachable: Reachable, staying: BoolArray) -> IntArray:
    """Return the transitions of paths that can stay for ever in the states `staying`, (S,) bool."""
    edges = np.flatnonzero(staying[reachable.source] & staying[reachable.target])
    while True:
        going_on = np.zeros_like(staying)
        going_on[reachable.source[edges]] = True
        if (going_on == staying).all():
            return edges
        staying = going_on
        edges = edges[staying[reachable.source[edges]] & staying[reachable.target[edges]]]


# -- sentences -------------------------------------------------------------------------------------

NAMED = 3  # ends to name; further ends are counted


@dataclass(frozen=True, eq=False)
class Origin:
    """The potential behind a shaping reward."""

    plain: Fit  # the fit with the task's discount and Phi = 0 at the ends
    fitting: Fit | None  # a fit within the tolerance, maybe with Phi not 0 at the ends
    sentences: tuple[str, ...]


def origin(task: Task, reachable: Reachable, f: FloatArray) -> Origin:
    """Return the potential behind F, (E,), with sentences; these say why if there is none."""
    discount, enough = reachable.mdp.discount, RELATIVE_RESIDUAL * float(abs(f).max(initial=0.0))
    plain = fit(reachable, f, discount)
    if plain.worst <= enough:
        form = f"F = {discount:g} Phi(s') - Phi(s) with Phi = 0 at the ends"
        return Origin(plain, plain, (f"{form}, to {plain.worst:.1g}",))
    move = reachable.source.astype(np.int64) * len(reachable.reached) + reachable.target
    apart, *pair = widest(move, f)
    if apart > enough:
        state, next_state = int(reachable.source[pair[0]]), int(reachable.target[pair[0]])
        sentence = different_by_action(task, state, next_state, f[pair], reachable.action[pair])
        return Origin(plain, None, (sentence,))
    open_ended = fit(reachable, f, discount, ends_are_zero=False)
    if open_ended.worst > enough:
        worst = int(abs(plain.residual).argmax())
        state, next_state = int(reachable.source[worst]), int(reachable.target[worst])
        by_next = f[worst] - discount * plain.potential[next_state]
        sentence = (
            f"not potential-based: from {state_name(task.states, state)} on, the discounted sum of "
            f"F is {by_next + 0.0:.4g} by way of {state_name(task.states, next_state)} and "
            f"{0.0 - plain.potential[state]:.4g} on another path; with a potential it is -Phi on "
            "every path"
        )
        return Origin(plain, None, (sentence,))
    ends = reachable.ends[abs(open_ended.potential[reachable.ends]) > enough]
    return Origin(plain, open_ended, (nonzero_ends(task, ends, open_ended.potential[ends]),))


def nonzero_ends(task: Task, ends: IntArray, phi: FloatArray, rule: str = ", must be 0") -> str:
    """Return the sentence about ends whose potential is not 0."""
    parts = [
        f"terminal {state_name(task.states, int(end))} has Phi = {value:.4g}{rule}"
        for end, value in zip(ends[:NAMED], phi[:NAMED], strict=True)
    ]
    if len(ends) > NAMED:
        parts.append(f"Phi is not 0 at {len(ends) - NAMED:,} more ends")
    return "; ".join(parts)


def different_by_action(
    task: Task, state: int, next_state: int, f: FloatArray, actions: AnyInts
) -> str:
    """Return the sentence about a transition with different F, (2,), by two actions, (2,)."""
    names = (action_name(task.actions, int(action)) for action in actions)
    by = " and ".join(f"{paid:.4g} by {name}" for paid, name in zip(f, names, strict=True))
    return (
        f"not potential-based: from {state_name(task.states, state)} to "
        f"{state_name(task.states, next_state)}, F is {by}; with a potential the action does not "
        "matter"
    )


def widest(keys: AnyInts, values: FloatArray) -> tuple[float, int, int]:
    """Return the largest difference of two values with equal keys, (n,), and their indices."""
    order = np.lexsort((values, keys))
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    apart = values[order[last]] - values[order[first]]
    group = int(apart.argmax())
    return float(apart[group]), int(order[last[group]]), int(order[first[group]])
