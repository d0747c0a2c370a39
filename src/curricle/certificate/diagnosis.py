"""Sentences about a shaping reward: the potential behind it, or why there is none."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray, IntArray
from curricle.certificate.potential_fit import Fit, fit, negligible, rounding
from curricle.certificate.shaped_task import Reachable
from curricle.tasks.labels import action_name, state_name

AnyInts = npt.NDArray[np.integer[Any]]
NAMED = 3
"""Ends that are named; the others are counted."""
EQUAL = 1e-12
"""Relative difference up to which two phi are equal."""


@dataclass(frozen=True, eq=False)
class Origin:
    """The potential behind a shaping reward."""

    plain: Fit  # with the task's discount and Phi = 0 at the ends
    found: Fit | None  # without residual, maybe with ends that are not 0
    sentences: tuple[str, ...]
    by_rounding: bool = False  # whether rounding alone keeps F from being gamma Phi(s') - Phi(s)


def origin(task: Any, met: Reachable, f: FloatArray) -> Origin:
    """Return the potential behind F, (E,), or a sentence on why there is none.

    `task` gives states and actions their names.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld("S.T")
    >>> met = Reachable.of(maze.mdp)
    >>> print(*origin(maze, met, met.reward(lambda s, a, after: 1.0)).sentences)
    terminal state 2 (row 0, column 2) has Phi = -100, must be 0
    """
    discount, enough = met.mdp.discount, negligible(f)
    plain = fit(met, f, discount)
    if plain.worst <= enough:
        form = f"F = {discount:g} Phi(s') - Phi(s)"
        sentence = f"{form} with Phi = 0 at the ends, to {plain.worst:.1g}"
        return Origin(plain, plain, (sentence,), plain.worst <= rounding(met, f, plain))
    by_action = _depends_on_action(task, met, f)
    found = None if by_action else fit(met, f, discount, ends_are_zero=False)
    if found is None or found.worst > enough:
        return Origin(plain, None, (by_action or _unequal_paths(task, met, f, plain),))
    ends = met.ends[abs(found.potential[met.ends]) > enough]
    return Origin(plain, found, (nonzero_ends(task, ends, found.potential[ends]),))


def other_discount(discount: float, own: float) -> str:
    """Return the sentence about a discount that is not the task's."""
    form = f"F = {discount:.6g} Phi(s') - Phi(s)"
    return f"shaped with a second discount: {form}, the task's discount is {own:.6g}"


def ends_read_as_zero(task: Any, ends: IntArray, phi: FloatArray) -> str:
    """Return the sentence about ends whose given potential is not 0 and that learning ignores."""
    named = _ends(task, ends, phi, "has Phi = {:.4g}")
    return f"{named}, which learn() reads as 0; ends='given' judges a tool that does not"


def nonzero_ends(task: Any, ends: IntArray, phi: FloatArray) -> str:
    """Return the sentence about ends whose potential is not 0."""
    return _ends(task, ends, phi, "has Phi = {:.4g}, must be 0")


def _ends(task: Any, ends: IntArray, phi: FloatArray, form: str) -> str:
    parts = [
        f"terminal {state_name(task.states, int(end))} {form.format(value)}"
        for end, value in zip(ends[:NAMED], phi[:NAMED], strict=True)
    ]
    if len(ends) > NAMED:
        parts.append(f"Phi is not 0 at {len(ends) - NAMED:,} more ends")
    return "; ".join(parts)


def _depends_on_action(task: Any, met: Reachable, f: FloatArray) -> str | None:
    """Return the sentence about a move for which F depends on the action; None without one."""
    move = met.source.astype(np.int64) * len(met.met) + met.target
    apart, *pair = widest(move[:, None], f)
    if apart <= negligible(f):
        return None
    here, there = int(met.source[pair[0]]), int(met.target[pair[0]])
    return different_by_action(task, here, there, f[pair], met.action[pair])


def different_by_action(task: Any, here: int, there: int, f: FloatArray, actions: AnyInts) -> str:
    """Return the sentence about a move with two F, (2,), by two actions, (2,)."""
    names = (action_name(task.actions, int(action)) for action in actions)
    by = " and ".join(f"{paid:.4g} by {name}" for paid, name in zip(f, names, strict=True))
    return (
        f"not potential-based: from {state_name(task.states, here)} to "
        f"{state_name(task.states, there)}, F is {by}; with a potential the action does not matter"
    )


def _unequal_paths(task: Any, met: Reachable, f: FloatArray, plain: Fit) -> str:
    """Return the sentence about a state from which F has different sums on two paths."""
    worst = int(abs(plain.residual).argmax())
    here, there = int(met.source[worst]), int(met.target[worst])
    one = f[worst] - plain.discount * plain.potential[there]
    return (
        f"not potential-based: from {state_name(task.states, here)} on, the discounted sum of F is "
        f"{one + 0.0:.4g} by way of {state_name(task.states, there)} and "
        f"{0.0 - plain.potential[here]:.4g} on another path; with a potential it is -Phi on every "
        "path"
    )


def several_entries(
    task: Any, pairs: tuple[AnyInts, AnyInts, AnyInts], phi: FloatArray, starts: IntArray
) -> tuple[float, str | None]:
    """Return how far phi of the ways into a state differs at most, and a sentence if it does.

    Ways are transitions s, a, s', (n,) each, with phi(s, a), (n,), and the start of an episode in
    one of `starts`, with 0.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> west = np.array([1]), np.array([3]), np.array([0])
    >>> print(several_entries(GridWorld("S.T"), west, np.array([2.0]), np.array([0]))[1])
    look-back advice keeps the optimum for certain only where all ways into a state have one phi:
    state 0 (row 0, column 0) is entered with phi = 2 from state 1 (row 0, column 1) by west and
    with phi = 0 where an episode starts
    """
    source, action, target = pairs
    entered = np.append(target, starts)
    phi = np.append(phi, np.zeros(len(starts)))
    apart, *ways = widest(entered[:, None], phi)
    if apart <= EQUAL * abs(phi).max():
        return apart, None
    told = [
        f"with phi = {phi[i]:.4g} from {state_name(task.states, int(source[i]))} by "
        f"{action_name(task.actions, int(action[i]))}"
        if i < len(source)
        else "with phi = 0 where an episode starts"
        for i in ways
    ]
    return apart, (
        "look-back advice keeps the optimum for certain only where all ways into a state have one "
        f"phi: {state_name(task.states, int(entered[ways[0]]))} is entered {' and '.join(told)}"
    )


def widest(keys: AnyInts, values: FloatArray) -> tuple[float, int, int]:
    """Return the largest difference of two values with equal keys, (n, k), and which two.

    Examples
    --------
    >>> widest(np.array([[1], [2], [1]]), np.array([5.0, 0.0, 3.0]))
    (2.0, 0, 2)
    """
    order = np.lexsort((values, *keys.T))
    same = (keys[order][1:] == keys[order][:-1]).all(axis=1)
    first = np.flatnonzero(~np.concatenate([[False], same]))
    last = np.append(first[1:], len(order)) - 1
    apart = values[order[last]] - values[order[first]]
    group = int(apart.argmax())
    return float(apart[group]), int(order[last[group]]), int(order[first[group]])
