"""What is said about a shaping reward: that a potential is behind it, or what is wrong with it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.certificate.bonus import Fit, Moves, explanation, fit
from curricle.tasks.labels import action_name, state_name

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
NAMED = 3
"""Ends that are named; of more the number is told."""


@dataclass(frozen=True, eq=False)
class Origin:
    """What a shaping reward is made of.

    Attributes
    ----------
    plain : Fit
        F taken for gamma Phi(s') - Phi(s), the task's discount and Phi = 0 at the ends.
    found : Fit or None
        The fit that explains F, which may have another discount or ends that are not 0.
    sentences : tuple of str
    """

    plain: Fit
    found: Fit | None
    sentences: tuple[str, ...]


def origin(task: Any, moves: Moves) -> Origin:
    """Return what a shaping reward is made of, in numbers and in words.

    Parameters
    ----------
    task : Task
        Whose names states and actions go by.
    moves : Moves

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.certificate.bonus import moves_of
    >>> from curricle.certificate.shaped import reached
    >>> maze = GridWorld("S.T")
    >>> met = reached(maze.mdp)
    >>> print(*origin(maze, moves_of(met, met.paid(lambda s, a, after: 1.0))).sentences)
    terminal state 2 (row 0, column 2) has Phi = -100, must be 0
    """
    plain = fit(moves, moves.discount)
    if plain.worst <= moves.enough:
        form = f"F = {moves.discount:g} Phi(s') - Phi(s)"
        return Origin(plain, plain, (f"{form} with Phi = 0 at the ends, to {plain.worst:.1g}",))
    by_action = seeing_actions(task, moves)
    other = None if by_action else explanation(moves, plain)
    if other is None:
        return Origin(plain, None, (by_action or two_ways_on(task, moves, plain),))
    found, ends_are_zero = other
    said = []
    if found.discount != moves.discount:
        said.append(second_discount_named(found.discount, moves.discount))
    if not ends_are_zero:
        ends = np.flatnonzero(moves.terminal & moves.met)
        ends = ends[abs(found.potential[ends]) > moves.enough]
        said.append(open_ends_named(task, ends, found.potential[ends]))
    return Origin(plain, found, tuple(said))


def second_discount_named(discount: float, own: float) -> str:
    """Return the sentence about a discount that is not the task's.

    Examples
    --------
    >>> second_discount_named(0.9, 0.99)
    "shaped with a second discount: F = 0.9 Phi(s') - Phi(s), the task's discount is 0.99"
    """
    form = f"F = {discount:.6g} Phi(s') - Phi(s)"
    return f"shaped with a second discount: {form}, the task's discount is {own:.6g}"


def open_ends_named(task: Any, ends: IntArray, phi: FloatArray) -> str:
    """Return the sentence about ends whose potential is not 0.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> open_ends_named(GridWorld("S.T"), np.array([2]), np.array([3.2]))
    'terminal state 2 (row 0, column 2) has Phi = 3.2, must be 0'
    """
    parts = [
        f"terminal {state_name(task.states, int(end))} has Phi = {value:.4g}, must be 0"
        for end, value in zip(ends[:NAMED], phi[:NAMED], strict=True)
    ]
    more = f"; so have {len(ends) - NAMED:,} more" if len(ends) > NAMED else ""
    return "; ".join(parts) + more


def seeing_actions(task: Any, moves: Moves) -> str | None:
    """Return the sentence about a move that F pays by its action, None if there is none."""
    key = moves.source.astype(np.int64) * len(moves.terminal) + moves.target
    order = np.argsort(key)
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    paid = moves.f[order]
    apart = np.maximum.reduceat(paid, first) - np.minimum.reduceat(paid, first)
    group = int(apart.argmax())
    if apart[group] <= moves.enough:
        return None
    same = order[first[group] : first[group + 1] if group + 1 < len(first) else len(order)]
    pair = same[moves.f[same].argmax()], same[moves.f[same].argmin()]
    here, there = (
        state_name(task.states, int(one[pair[0]])) for one in (moves.source, moves.target)
    )
    return different_by_action(
        task, here, there, [(float(moves.f[i]), int(moves.action[i])) for i in pair]
    )


def two_ways_on(task: Any, moves: Moves, plain: Fit) -> str:
    """Return the sentence about a state from which F adds up to different sums."""
    worst = int(abs(plain.residual).argmax())
    here, there = int(moves.source[worst]), int(moves.target[worst])
    one = moves.f[worst] - plain.discount * plain.potential[there]
    return (
        f"not potential-based: on from {state_name(task.states, here)} the discounted sum of F is "
        f"{one + 0.0:.4g} by way of {state_name(task.states, there)} and "
        f"{0.0 - plain.potential[here]:.4g} another way; a potential pays -Phi on every way"
    )


def different_by_action(task: Any, here: str, there: str, by: list[tuple[float, int]]) -> str:
    """Return the sentence about two actions, (F, a), that are paid differently for one move."""
    paid = " and ".join(f"{f:.4g} by {action_name(task.actions, a)}" for f, a in by)
    return (
        f"not potential-based: from {here} to {there}, F is {paid}; a potential is blind to actions"
    )


def two_ways_in(task: Any, state: int, ways: list[tuple[float, int, int] | None]) -> str:
    """Return the sentence about a state entered by ways, (phi, s, a), of different phi.

    None is the start of an episode, before which phi counts as 0.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> print(two_ways_in(GridWorld("S.T"), 0, [(2.0, 1, 3), None]))
    look-back advice is sure to keep the optimum only where every state is entered in one way:
    state 0 (row 0, column 0) is entered with phi = 2 from state 1 (row 0, column 1) by west and
    with phi = 0 where an episode starts
    """
    told = [
        "with phi = 0 where an episode starts"
        if way is None
        else f"with phi = {way[0]:.4g} from {state_name(task.states, way[1])} by "
        f"{action_name(task.actions, way[2])}"
        for way in ways
    ]
    return (
        "look-back advice is sure to keep the optimum only where every state is entered in one "
        f"way: {state_name(task.states, state)} is entered {told[0]} and {told[1]}"
    )
