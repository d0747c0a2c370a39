"""The potential behind a shaping reward, or why there is none, in sentences.

If F(s, a, s') = gamma Phi(s') - Phi(s) and Phi is 0 at the ends, then the discounted sum of F is
-Phi(s) along *every* path from s. One path from each state thus gives the only possible Phi, and
all other transitions tell whether it fits (Ng, Harada, Russell 1999).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.certificate.shaped_task import Reachable
from curricle.tasks.spaces import action_name, state_name

RELATIVE_RESIDUAL = 1e-5  # residual, relative to the largest F, up to which a potential fits


@dataclass(frozen=True, eq=False)
class Fit(Frozen):
    """F as ``discount`` Phi(s') - Phi(s)."""

    discount: float
    potential: FloatArray  # Phi, (S,); 0 in states that cannot be reached
    residual: FloatArray  # F - discount Phi(s') + Phi(s), (E,)

    @property
    def worst(self) -> float:
        """The largest absolute residual; infinite if one is NaN."""
        sizes = abs(self.residual)
        return float(np.where(np.isnan(sizes), np.inf, sizes).max(initial=0.0))


def negligible(f: FloatArray) -> float:
    """Return the residual up to which a potential fits F, (E,)."""
    return RELATIVE_RESIDUAL * float(abs(f).max(initial=0.0))


def fit(met: Reachable, f: FloatArray, discount: float, *, ends_are_zero: bool = True) -> Fit:
    """Return the only Phi that F, (E,), can come from, and the residual; Phi of ends 0, or free."""
    steps = _order(met, ends_are_zero, discount < 1)
    source, target = met.source, met.target
    # Forward at a small discount numbers may overflow. Then nothing fits.
    with np.errstate(over="ignore", invalid="ignore"):
        phi = _potential(met, f, discount, steps, 0.0)
        left = f - discount * phi[target] + phi[source]
        if any(step.kind == FREE for step in steps):
            # Phi and the residual are linear in the free numbers, one for each group of states.
            slope = _potential(met, np.zeros_like(f), discount, steps, 1.0)
            change = slope[source] - discount * slope[target]
            group = np.zeros(len(phi), np.int64)
            for n, step in zip(np.cumsum([s.kind == FREE for s in steps]), steps, strict=True):
                group[step.states] = n
            steep = np.bincount(group[source], change * change, len(steps) + 1)
            pull = np.bincount(group[source], change * left, len(steps) + 1)
            best = np.divide(-pull, steep, out=np.zeros_like(pull), where=steep > 1e-18)
            phi = phi + best[group] * slope
            left = left + best[group[source]] * change
        return Fit(discount, frozen(phi), left)


# -- from F to Phi ---------------------------------------------------------------------------------

# Phi is 0; follows from that of s', or from that of s; is the discounted sum along transitions that
# follow each other for ever; or is an unknown number, on which later states may depend.
ZERO, BACKWARD, FORWARD, CYCLE, FREE = range(5)
NO_TRANSITIONS = np.zeros(0, np.int64)


class Step(NamedTuple):
    """Some states whose Phi follows at once, by one transition for each but ZERO and FREE."""

    kind: int
    states: npt.NDArray[np.integer[Any]]
    transitions: IntArray


def _order(met: Reachable, ends_are_zero: bool, discounted: bool) -> list[Step]:
    """Return steps that give Phi of all reachable states."""
    terminal, known, steps = met.mdp.terminal, ~met.met, list[Step]()

    def add(kind: int, states: Any, transitions: IntArray = NO_TRANSITIONS) -> None:
        if kind in (BACKWARD, FORWARD, CYCLE):  # the first transition of each state
            states, first = np.unique(states, return_index=True)
            transitions = transitions[first]
        steps.append(Step(kind, states, transitions))
        known[states] = True

    def add_backward() -> None:
        left = np.flatnonzero(~known[met.source])
        while (ready := left[known[met.target[left]]]).size:
            add(BACKWARD, met.source[ready], ready)
            left = left[~known[met.source[left]]]

    if ends_are_zero:
        add(ZERO, met.ends)
        add_backward()
    if discounted:
        cycle = _endless(met, ~known & ~terminal)
        if cycle.size:
            add(CYCLE, met.source[cycle], cycle)
        add_backward()
    # Errors grow forward, so that this comes last. Groups that nothing joins have a free number.
    while not known.all():
        ahead = np.flatnonzero(known[met.source] & ~known[met.target])
        if ahead.size:
            add(FORWARD, met.target[ahead], ahead)
        else:
            open_ends = np.flatnonzero(~known & terminal)
            add(FREE, (open_ends if open_ends.size else np.flatnonzero(~known))[:1])
        add_backward()
    return steps


def _endless(met: Reachable, staying: BoolArray) -> IntArray:
    """Return the transitions of paths that can stay for ever among some states, (S,) bool."""
    left = np.flatnonzero(staying[met.source] & staying[met.target])
    while True:
        going_on = np.zeros_like(staying)
        going_on[met.source[left]] = True
        if (going_on == staying).all():
            return left
        staying = going_on
        left = left[staying[met.source[left]] & staying[met.target[left]]]


def _potential(
    met: Reachable, f: FloatArray, discount: float, steps: list[Step], free: float
) -> FloatArray:
    """Return Phi, (S,), by these steps, with one value for all free numbers."""
    phi = np.zeros(len(met.met))
    for kind, states, which in steps:
        if kind == FREE:
            phi[states] = free
        elif kind == BACKWARD:
            phi[states] = discount * phi[met.target[which]] - f[which]
        elif kind == FORWARD and discount > 0:
            phi[states] = (f[which] + phi[met.source[which]]) / discount
        elif kind == CYCLE:
            place = np.zeros(len(phi), np.int64)
            place[states] = np.arange(len(states))
            after, weight, total = place[met.target[which]], discount, -f[which]
            while weight > 1e-20:  # the sums over the first 1, 2, 4, ... steps
                total = total + weight * total[after]
                after, weight = after[after], weight**2
            phi[states] = total
    return phi


# -- sentences -------------------------------------------------------------------------------------

AnyInts = npt.NDArray[np.integer[Any]]
NAMED = 3  # ends that are named; the others are counted


@dataclass(frozen=True, eq=False)
class Origin:
    """The potential behind a shaping reward."""

    plain: Fit  # with the task's discount and Phi = 0 at the ends
    fitting: Fit | None  # without residual, maybe with ends that are not 0
    sentences: tuple[str, ...]


def origin(task: Any, met: Reachable, f: FloatArray) -> Origin:
    """Return the potential behind F, (E,), or a sentence on why there is none."""
    discount, enough = met.mdp.discount, negligible(f)
    plain = fit(met, f, discount)
    if plain.worst <= enough:
        form = f"F = {discount:g} Phi(s') - Phi(s)"
        sentence = f"{form} with Phi = 0 at the ends, to {plain.worst:.1g}"
        return Origin(plain, plain, (sentence,))
    move = met.source.astype(np.int64) * len(met.met) + met.target
    apart, *pair = widest(move[:, None], f)
    if apart > enough:
        here, there = int(met.source[pair[0]]), int(met.target[pair[0]])
        by_action = different_by_action(task, here, there, f[pair], met.action[pair])
        return Origin(plain, None, (by_action,))
    open_ended = fit(met, f, discount, ends_are_zero=False)
    if open_ended.worst > enough:
        worst = int(abs(plain.residual).argmax())
        here, there = int(met.source[worst]), int(met.target[worst])
        by_there = f[worst] - discount * plain.potential[there]
        sentence = (
            f"not potential-based: from {state_name(task.states, here)} on, the discounted sum of "
            f"F is {by_there + 0.0:.4g} by way of {state_name(task.states, there)} and "
            f"{0.0 - plain.potential[here]:.4g} on another path; with a potential it is -Phi on "
            "every path"
        )
        return Origin(plain, None, (sentence,))
    ends = met.ends[abs(open_ended.potential[met.ends]) > enough]
    return Origin(plain, open_ended, (nonzero_ends(task, ends, open_ended.potential[ends]),))


def nonzero_ends(task: Any, ends: IntArray, phi: FloatArray, rule: str = ", must be 0") -> str:
    """Return the sentence about ends whose potential is not 0."""
    parts = [
        f"terminal {state_name(task.states, int(end))} has Phi = {value:.4g}{rule}"
        for end, value in zip(ends[:NAMED], phi[:NAMED], strict=True)
    ]
    if len(ends) > NAMED:
        parts.append(f"Phi is not 0 at {len(ends) - NAMED:,} more ends")
    return "; ".join(parts)


def different_by_action(task: Any, here: int, there: int, f: FloatArray, actions: AnyInts) -> str:
    """Return the sentence about a move with two F, (2,), by two actions, (2,)."""
    names = (action_name(task.actions, int(action)) for action in actions)
    by = " and ".join(f"{paid:.4g} by {name}" for paid, name in zip(f, names, strict=True))
    return (
        f"not potential-based: from {state_name(task.states, here)} to "
        f"{state_name(task.states, there)}, F is {by}; with a potential the action does not matter"
    )


def several_entries(
    task: Any, pairs: tuple[AnyInts, AnyInts, AnyInts], phi: FloatArray, starts: IntArray
) -> tuple[float, str | None]:
    """Return how far phi, (n,), of ways into one state differs, and a sentence if it does."""
    source, action, target = pairs
    entered = np.append(target, starts)
    phi = np.append(phi, np.zeros(len(starts)))
    apart, *ways = widest(entered[:, None], phi)
    if apart == 0:
        return apart, None
    entries = [
        f"with phi = {phi[i]:.4g} from {state_name(task.states, int(source[i]))} by "
        f"{action_name(task.actions, int(action[i]))}"
        if i < len(source)
        else "with phi = 0 where an episode starts"
        for i in ways
    ]
    return apart, (
        "look-back advice keeps the optimum for certain only where all ways into a state have one "
        f"phi: {state_name(task.states, int(entered[ways[0]]))} is entered {' and '.join(entries)}"
    )


def widest(keys: AnyInts, values: FloatArray) -> tuple[float, int, int]:
    """Return the largest difference of two values with equal keys, (n, k), and which two."""
    order = np.lexsort((values, *keys.T))
    same = (keys[order][1:] == keys[order][:-1]).all(axis=1)
    first = np.flatnonzero(~np.concatenate([[False], same]))
    last = np.append(first[1:], len(order)) - 1
    apart = values[order[last]] - values[order[first]]
    group = int(apart.argmax())
    return float(apart[group]), int(order[last[group]]), int(order[first[group]])
