"""What a shaping reward is made of: whether a potential is behind it, and which.

If F(s, a, s') = gamma Phi(s') - Phi(s) and Phi is 0 at the ends, then the discounted sum of F is
-Phi(s) on *every* way on from s: Phi is the value of any policy, indeed of any luck, for rewards
-F. One way on from each state so gives the only Phi there can be, and all transitions say whether
it is one (Ng, Harada, Russell 1999).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.certificate.shaped import Reached
from curricle.tasks.spaces import frozen

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

RECOGNISED = 1e-5
"""Residual, relative to the largest F, up to which a reward counts as made of a potential."""
SEARCHED = 20_000
"""Transitions that the search for a second discount looks at; all of them decide in the end."""
VALLEYS = 4
"""Low points of the grid that are looked into."""


@dataclass(frozen=True, eq=False)
class Moves:
    """E transitions with what a shaping reward pays for each.

    Attributes
    ----------
    source, action, target : (E,) int array
    f : (E,) float64
    terminal : (S,) bool
    met : (S,) bool
        States, ends included, that take part.
    discount : float
        The task's.
    """

    source: npt.NDArray[np.integer[Any]]
    action: npt.NDArray[np.integer[Any]]
    target: npt.NDArray[np.integer[Any]]
    f: FloatArray
    terminal: BoolArray
    met: BoolArray
    discount: float

    @property
    def enough(self) -> float:
        """The residual up to which F counts as made of a potential."""
        return RECOGNISED * float(abs(self.f).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Fit:
    """F taken for ``discount`` Phi(s') - Phi(s).

    Attributes
    ----------
    discount : float
    potential : (S,) float64
        Phi; 0 where nothing leads.
    residual : (E,) float64
        F - ``discount`` Phi(s') + Phi(s).
    """

    discount: float
    potential: FloatArray
    residual: FloatArray

    @property
    def worst(self) -> float:
        """The largest residual in size."""
        sizes = abs(self.residual)
        return float(np.where(np.isnan(sizes), np.inf, sizes).max(initial=0.0))


def moves_of(reached: Reached, f: FloatArray) -> Moves:
    """Return the transitions that can happen, with F (N A, O) of each."""
    mdp, parts = reached.mdp, []
    for block, possible, *transition in reached.transitions():
        parts.append((*(one.astype(np.int32) for one in transition), f[block][possible]))
    source, action, target, paid = (np.concatenate(one) for one in zip(*parts, strict=True))
    met = np.zeros(mdp.states.size, np.bool_)
    met[reached.states], met[reached.ends] = True, True
    return Moves(source, action, target, paid, mdp.terminal, met, mdp.discount)


def fit(moves: Moves, discount: float, *, ends_are_zero: bool = True) -> Fit:
    """Return the Phi that F must have if it is ``discount`` Phi(s') - Phi(s), and what is left.

    Parameters
    ----------
    moves : Moves
    discount : float
        In (0, 1], or the task's own.
    ends_are_zero : bool
        Whether Phi of ends is 0, or is read off the transitions into them.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.certificate.shaped import reached
    >>> met, phi = reached(GridWorld("S.T", discount=0.5).mdp), np.array([1.0, 3.0, 0.0])
    >>> moves = moves_of(met, met.paid(lambda s, a, after: 0.5 * phi[after] - phi[s]))
    >>> found = fit(moves, 0.5)
    >>> found.potential, found.worst
    (array([1., 3., 0.]), 0.0)
    """
    return _fitted(moves, discount, _order(moves, ends_are_zero, discount < 1))


def explanation(moves: Moves, plain: Fit) -> tuple[Fit, bool] | None:
    """Return how else F is made of a potential, if it is, and whether the ends are then 0.

    By a discount other than the task's, by ends that are not 0, or by both; the simplest first.
    """
    for ends_are_zero in (True, False):
        if not ends_are_zero:
            found = fit(moves, plain.discount, ends_are_zero=False)
            if found.worst <= moves.enough:
                return found, False
        found = second_discount(moves, ends_are_zero=ends_are_zero)
        if found.worst <= moves.enough:
            return found, ends_are_zero
    return None


def second_discount(moves: Moves, *, ends_are_zero: bool = True) -> Fit:
    """Return the fit with the discount in [0.02, 1] that leaves least.

    The residual of each transition is the distance from the right discount times a polynomial:
    a grid and golden sections around its lowest points find it.
    """
    among = np.arange(len(moves.f))
    if len(among) > SEARCHED:
        among = np.random.default_rng(0).choice(among, SEARCHED, replace=False)
    steps = _order(moves, ends_are_zero, True)

    def left(discount: float) -> float:
        return _fitted(moves, discount, steps, among).worst

    grid = np.sort(np.append(np.linspace(0.02, 0.98, 49), 1 - np.logspace(-9, -2, 15)))
    levels = np.array([left(g) for g in grid])
    best, least = grid[levels.argmin()], levels.min()
    around = np.pad(levels, 1, constant_values=np.inf)
    valleys = np.flatnonzero((levels <= around[:-2]) & (levels <= around[2:]))
    for i in valleys[np.argsort(levels[valleys])][:VALLEYS]:
        found = _golden(left, grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)])
        if left(found) < least:
            best, least = found, left(found)
    undiscounted = fit(moves, 1.0, ends_are_zero=ends_are_zero)
    if undiscounted.worst <= max(moves.enough, least):
        return undiscounted
    return _fitted(moves, float(best), steps)


def _golden(function: Callable[[float], float], low: float, high: float) -> float:
    """Return where a function that falls and then rises is least, to 1e-12."""
    share = (np.sqrt(5) - 1) / 2
    a, b = high - share * (high - low), low + share * (high - low)
    at_a, at_b = function(a), function(b)
    while high - low > 1e-12:
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - share * (high - low)
            at_a = function(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + share * (high - low)
            at_b = function(b)
    return float((low + high) / 2)


# -- from F to Phi -------------------------------------------------------------------------------

ZERO, BACK, FORTH, CYCLE, FREE = range(5)


class Step(NamedTuple):
    """Some states whose Phi follows at once.

    ZERO: the states numbered `which` get 0. FREE: it gets a number that is to be found, as do all
    that follow from it. The others go by one transition for each state: BACK, from s' to s; FORTH,
    from s to s'; CYCLE, the discounted sum along transitions that lead from one to the next for
    ever.
    """

    way: int
    which: IntArray


def _order(moves: Moves, ends_are_zero: bool, discounted: bool) -> list[Step]:
    """Return the order in which Phi of all states that are met follows from F.

    Against the arrows errors shrink, along them they grow: that is the last resort. States that no
    arrow joins to these follow from one of them, whose Phi the other transitions among them tell.
    """
    known, steps = ~moves.met, list[Step]()
    if ends_are_zero:
        _know(known, steps, Step(ZERO, np.flatnonzero(moves.terminal & moves.met)), moves)
        _backward(moves, known, steps)
    if discounted:
        _for_ever(moves, known, steps)
        _backward(moves, known, steps)
    while True:
        ahead = np.flatnonzero(known[moves.source] & ~known[moves.target])
        if ahead.size:
            _, first = np.unique(moves.target[ahead], return_index=True)
            _know(known, steps, Step(FORTH, ahead[first]), moves)
        elif known.all():
            return steps
        else:
            open_ends = np.flatnonzero(~known & moves.terminal)
            any_state = open_ends if open_ends.size else np.flatnonzero(~known)
            _know(known, steps, Step(FREE, any_state[:1]), moves)
        _backward(moves, known, steps)


def _know(known: BoolArray, steps: list[Step], step: Step, moves: Moves) -> None:
    steps.append(step)
    known[_of(step, moves)] = True


def _of(step: Step, moves: Moves) -> npt.NDArray[np.integer[Any]]:
    """Return the states that a step is about."""
    if step.way in (ZERO, FREE):
        return step.which
    return (moves.target if step.way == FORTH else moves.source)[step.which]


def _backward(moves: Moves, known: BoolArray, steps: list[Step]) -> None:
    """Go against the transitions from known states as far as these lead."""
    left = np.flatnonzero(~known[moves.source])
    while (ready := left[known[moves.target[left]]]).size:
        _, first = np.unique(moves.source[ready], return_index=True)
        _know(known, steps, Step(BACK, ready[first]), moves)
        left = left[~known[moves.source[left]]]


def _for_ever(moves: Moves, known: BoolArray, steps: list[Step]) -> None:
    """Know the states from which one can go on for ever among the unknown that are no ends."""
    staying = ~known & ~moves.terminal
    left = np.flatnonzero(staying[moves.source] & staying[moves.target])
    while True:
        going_on = np.zeros_like(staying)
        going_on[moves.source[left]] = True
        if (going_on == staying).all():
            break
        staying = going_on
        left = left[staying[moves.source[left]] & staying[moves.target[left]]]
    if left.size:
        _, first = np.unique(moves.source[left], return_index=True)
        _know(known, steps, Step(CYCLE, left[first]), moves)


def _potential(
    moves: Moves, discount: float, steps: list[Step], f: FloatArray, free: float
) -> FloatArray:
    """Return Phi for a discount, (S,), found in this order, with this value in free places."""
    phi = np.zeros(len(moves.terminal))
    for step in steps:
        states, which = _of(step, moves), step.which
        if step.way == FREE:
            phi[states] = free
        elif step.way == BACK:
            phi[states] = discount * phi[moves.target[which]] - f[which]
        elif step.way == FORTH and discount > 0:
            phi[states] = (f[which] + phi[moves.source[which]]) / discount
        elif step.way == CYCLE:
            place = np.zeros(len(phi), np.int64)
            place[states] = np.arange(len(states))
            after, weight, total = place[moves.target[which]], discount, -f[which]
            while weight > 1e-20:  # the first 1, 2, 4, ... steps
                total = total + weight * total[after]
                after, weight = after[after], weight**2
            phi[states] = total
    return phi


def _fitted(moves: Moves, discount: float, steps: list[Step], which: Any = slice(None)) -> Fit:
    """Return Phi for a discount and the residual of some transitions."""
    source, target = moves.source[which], moves.target[which]
    # Far along the arrows at a small discount numbers may overflow: that is no fit then.
    with np.errstate(over="ignore", invalid="ignore"):
        phi = _potential(moves, discount, steps, moves.f, 0.0)
        left = moves.f[which] - discount * phi[target] + phi[source]
        if any(step.way == FREE for step in steps):
            # Phi is linear in the free numbers, and so is what is left: one each where arrows join.
            slope = _potential(moves, discount, steps, np.zeros_like(moves.f), 1.0)
            change = slope[source] - discount * slope[target]
            part = _parts(moves, steps)
            n = int(part.max()) + 1
            steep = np.bincount(part[source], change * change, n)
            pull = np.bincount(part[source], change * left, n)
            best = np.divide(-pull, steep, out=np.zeros(n), where=steep > 1e-18)
            phi = phi + best[part] * slope
            left = left + best[part[source]] * change
        return Fit(discount, frozen(phi), left)


def _parts(moves: Moves, steps: list[Step]) -> IntArray:
    """Return which free number each state follows from, (S,); 0 for none."""
    part, latest = np.zeros(len(moves.terminal), np.int64), 0
    for step in steps:
        latest += step.way == FREE
        part[_of(step, moves)] = latest
    return part
