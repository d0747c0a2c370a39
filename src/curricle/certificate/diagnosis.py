"""The potential behind a shaping reward, or why there is none, in sentences.

If F(s, a, s') = gamma Phi(s') - Phi(s) and Phi is 0 at the ends, then the discounted sum of F is
-Phi(s) along *every* path from s. One path from each state thus gives the only possible Phi, and
all other transitions tell whether it fits (Ng, Harada, Russell 1999).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.certificate.shaped_task import AnyInts, Reachable
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


def fit(met: Reachable, f: FloatArray, discount: float, *, ends_are_zero: bool = True) -> Fit:
    """Return the only Phi that F, (E,), can come from, and the residual; Phi of ends 0, or free."""
    # Phi of all reachable states follows in steps, by a transition for each. Where a number is
    # free, `slope` is the change of Phi with it; `group` says on which number a state depends.
    source, target, terminal = met.source, met.target, met.mdp.terminal
    known, phi, slope = ~met.met, np.zeros(len(met.met)), np.zeros(len(met.met))
    group, groups = np.zeros(len(met.met), np.int64), 0

    def follow(forward: bool, transitions: IntArray) -> None:
        """Give the states on one side of transitions the Phi that follows from the other side."""
        here, there = (target, source) if forward else (source, target)
        states, first = np.unique(here[transitions], return_index=True)
        by = transitions[first]  # the first transition of a state
        if not forward:
            phi[states] = discount * phi[there[by]] - f[by]
            slope[states] = discount * slope[there[by]]
        elif discount > 0:
            phi[states] = (f[by] + phi[there[by]]) / discount
            slope[states] = slope[there[by]] / discount
        known[states], group[states] = True, groups

    def follow_backward() -> None:
        left = np.flatnonzero(~known[source])
        while (ready := left[known[target[left]]]).size:
            follow(False, ready)
            left = left[~known[source[left]]]

    # Forward at a small discount numbers may overflow. Then nothing fits.
    with np.errstate(over="ignore", invalid="ignore"):
        if ends_are_zero:
            known[met.ends] = True
            follow_backward()
        if discount < 1:
            cycle = _endless(met, ~known & ~terminal)
            states, first = np.unique(source[cycle], return_index=True)
            by = cycle[first]
            after, weight, total = np.searchsorted(states, target[by]), discount, -f[by]
            while weight > 1e-20:  # the sums over the first 1, 2, 4, ... steps
                total = total + weight * total[after]
                after, weight = after[after], weight**2
            phi[states], known[states] = total, True
            follow_backward()
        # Errors grow forward, so that this comes last.
        while not known.all():
            ahead = np.flatnonzero(known[source] & ~known[target])
            if ahead.size:
                follow(True, ahead)
            else:  # what nothing joins with the rest has a free number
                open_ends = np.flatnonzero(~known & terminal)
                free = (open_ends if open_ends.size else np.flatnonzero(~known))[:1]
                groups += 1
                slope[free], known[free], group[free] = 1.0, True, groups
            follow_backward()
        left = f - discount * phi[target] + phi[source]
        if groups:  # the free numbers with which the sum of squares is least
            change = slope[source] - discount * slope[target]
            steep = np.bincount(group[source], change * change, groups + 1)
            pull = np.bincount(group[source], change * left, groups + 1)
            best = np.divide(-pull, steep, out=np.zeros_like(pull), where=steep > 1e-18)
            phi = phi + best[group] * slope
            left = left + best[group[source]] * change
        return Fit(discount, frozen(phi), left)


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


# -- sentences -------------------------------------------------------------------------------------

NAMED = 3  # ends that are named; the others are counted


@dataclass(frozen=True, eq=False)
class Origin:
    """The potential behind a shaping reward."""

    plain: Fit  # with the task's discount and Phi = 0 at the ends
    fitting: Fit | None  # without residual, maybe with ends that are not 0
    sentences: tuple[str, ...]


def origin(task: Any, met: Reachable, f: FloatArray) -> Origin:
    """Return the potential behind F, (E,), or a sentence on why there is none."""
    discount, enough = met.mdp.discount, RELATIVE_RESIDUAL * float(abs(f).max(initial=0.0))
    plain = fit(met, f, discount)
    if plain.worst <= enough:
        form = f"F = {discount:g} Phi(s') - Phi(s) with Phi = 0 at the ends"
        return Origin(plain, plain, (f"{form}, to {plain.worst:.1g}",))
    move = met.source.astype(np.int64) * len(met.met) + met.target
    apart, *pair = widest(move[:, None], f)
    if apart > enough:
        here, there = int(met.source[pair[0]]), int(met.target[pair[0]])
        sentence = different_by_action(task, here, there, f[pair], met.action[pair])
        return Origin(plain, None, (sentence,))
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
