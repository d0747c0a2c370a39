"""Whether a candidate can be learnt at all, and whether two are the same task."""

from dataclasses import dataclass
from time import process_time_ns

import numpy as np

from curricle.array_types import BoolArray, FloatArray
from curricle.design.proposals import aims
from curricle.errors import CurricleError
from curricle.planning.solution import evaluate, solve
from curricle.tasks.mdp import FiniteMDP, reachable_states
from curricle.tasks.start_states import goal_distance
from curricle.transfer.partition_refinement import model_for_refinement, refined

LARGEST = 20_000_000
"""State-action pairs up to which a task is judged, as they are refined together."""
TOO_LARGE = "too large to be judged"
NO_SOLUTION = "no exact solution"
NEVER_REACHED = "goal never reached from the start"
AVOIDED = "goal avoided by every optimal policy"
NOTHING_TO_LEARN = "nothing to learn: the random policy is optimal"
ROUNDING = 1e-9
"""Difference of returns, in units of the larger, that counts as none."""
FINGERPRINT = 1e-6
"""The same of fingerprints: far more than equal tasks can differ by."""


@dataclass(frozen=True, eq=False)
class Judged:
    """What is known of a task: its returns, and its fingerprint."""

    mdp: FiniteMDP
    refusal: str  # why it can be no candidate; empty if it can
    optimum: float = float("nan")
    random_return: float = float("nan")
    fingerprint: FloatArray | None = None
    evaluation: int = 0  # nanoseconds of evaluating the random policy


def judged(mdp: FiniteMDP, goal: BoolArray | None = None) -> Judged:
    """Return what is known of a task, and why it can be no candidate if it cannot.

    `goal`, (S,), is where it wants to get; by default what its rewards say (:func:`aims`).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> judged(GridWorld("S.T").mdp).refusal, judged(GridWorld("S#T").mdp).refusal
    ('', 'goal never reached from the start')
    """
    n_states, n_actions = mdp.outcome_row.shape
    if mdp.outcome_row.size > LARGEST:
        return Judged(mdp, TOO_LARGE)
    try:
        best = solve(mdp)
    except CurricleError:
        return Judged(mdp, NO_SOLUTION)
    if refusal := _missed(mdp, aims(mdp) if goal is None else goal, best.optimal):
        return Judged(mdp, refusal)
    begin = process_time_ns()
    chance = evaluate(mdp, np.full((n_states, n_actions), 1 / n_actions))
    spent = process_time_ns() - begin
    optimum, random_return = float(best.start_value), float(chance.start_value)
    error = best.error_bound + chance.error_bound
    error += ROUNDING * max(1.0, abs(optimum), abs(random_return))
    values = best.values[reachable_states(mdp)]
    return Judged(
        mdp,
        NOTHING_TO_LEARN if optimum - random_return <= error else "",
        optimum,
        random_return,
        np.array([optimum, values.min(), values.max()]),
        spent,
    )


def _missed(mdp: FiniteMDP, goal: BoolArray, optimal: BoolArray) -> str:
    """Return why an episode misses the goal; empty if an optimal policy can reach it in time."""
    if mdp.terminal.any() and not mdp.terminal[goal].any():
        # It has ends, and none can be entered: its largest rewards are no goal.
        return NEVER_REACHED
    far = goal_distance(mdp, goal)[mdp.start_states]
    far = far[far >= 0]
    if not far.size or (mdp.time_limit is not None and int(far.min()) > mdp.time_limit):
        return NEVER_REACHED
    return "" if (reachable_states(mdp, optimal) & goal).any() else AVOIDED


def same_up_to_homomorphism(one: Judged, other: Judged) -> bool:
    """Return whether two tasks are one, up to an exact homomorphism of both onto the same task.

    Their states and actions may be numbered in any way, and one may have several states for one of
    the other. Discount, time limit, and the chance to start in each block are equal. Tasks whose
    fingerprints differ, the optimal values that homomorphisms keep, are not refined.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze, turned = judged(GridWorld("S.T").mdp), judged(GridWorld("T.S").mdp)
    >>> same_up_to_homomorphism(maze, turned)
    True
    >>> same_up_to_homomorphism(maze, judged(GridWorld(".ST").mdp))
    False
    """
    first, second = one.mdp, other.mdp
    if (first.discount, first.time_limit) != (second.discount, second.time_limit):
        return False
    if one.fingerprint is None or other.fingerprint is None:
        return False
    if not np.allclose(one.fingerprint, other.fingerprint, rtol=FINGERPRINT, atol=FINGERPRINT):
        return False
    if first.outcome_row.size + second.outcome_row.size > LARGEST:
        return first is second
    mine, others = refined([model_for_refinement(first), model_for_refinement(second)])
    blocks = int(max(mine.states.max(), others.states.max())) + 1
    start, other_start = (
        np.bincount(found.states, mdp.start, blocks)
        for found, mdp in ((mine, first), (others, second))
    )
    return bool(np.allclose(start, other_start, rtol=0, atol=ROUNDING))
