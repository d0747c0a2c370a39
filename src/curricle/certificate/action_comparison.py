"""The optimal actions of a task and of its shaped version, compared in every state."""

from dataclasses import dataclass, replace

import numpy as np

from curricle.array_types import BoolArray, FloatArray
from curricle.certificate.shaped_task import (
    Reachable,
    ShapedValues,
)
from curricle.certificate.verdict import Counterexample
from curricle.frozen_arrays import frozen
from curricle.planning.solution import Solution, solve
from curricle.tasks.spaces import action_name, state_name, values_of


@dataclass(frozen=True, eq=False)
class ActionComparison:
    """The optimal actions of a task and of its shaped version, N states.

    A difference of two values is known to twice their bound. An action whose value falls short of
    the best by no more may be optimal; where it is the only such action, it is.
    """

    optimal: BoolArray  # (N, A), may be optimal in the task
    chosen: BoolArray  # (N, A), may be optimal in the shaped task
    short: FloatArray  # (N, A), difference from the best in the task
    shaped_short: FloatArray  # (N, A), difference from the best in the shaped task
    error: float  # of a difference in the task
    shaped_error: float  # of a difference in the shaped task
    tolerance: float  # a loss that is allowed for

    @property
    def loss(self) -> float:
        """The largest possible loss of one action that may be optimal in the shaped task."""
        certain = self.optimal & (self.optimal.sum(axis=1, keepdims=True) == 1)
        lost = np.where(certain, 0.0, self.short + self.error)
        return float(lost[self.chosen].max(initial=0.0))

    @property
    def lost(self) -> FloatArray:
        """What an action optimal in the shaped task is proven to lose, (N,); 0 if allowed for."""
        least = np.where(self.chosen, self.short, np.inf).min(axis=1) - self.error
        return np.where(least > self.tolerance, least, 0.0)

    @property
    def given_up(self) -> FloatArray:
        """How far the task's optimal actions are proven to fall short when shaped, (N,)."""
        least = np.where(self.optimal, self.shaped_short, np.inf).min(axis=1) - self.shaped_error
        return np.where(least > self.tolerance, least, 0.0)

    @property
    def undecided(self) -> BoolArray:
        """States in which the optimal actions are proven neither equal nor different, (N,)."""
        same = (self.optimal == self.chosen).all(axis=1) & (self.optimal.sum(axis=1) == 1)
        if self.tolerance > 0:
            fine = self.short + self.error <= self.tolerance
            shaped_fine = self.shaped_short + self.shaped_error <= self.tolerance
            same |= ((fine | ~self.chosen) & (shaped_fine | ~self.optimal)).all(axis=1)
        return np.asarray(~same & (self.lost == 0) & (self.given_up == 0))


def compare_actions(
    q: FloatArray, bound: float, shaped: ShapedValues, tolerance: float
) -> ActionComparison:
    """Return the comparison of Q*, (N, A), known to `bound`, with the values under shaping."""
    short = q.max(axis=1, keepdims=True) - q
    shaped_short = shaped.values.max(axis=1, keepdims=True) - shaped.values
    error, shaped_error = 2 * bound, 2 * shaped.bound
    return ActionComparison(
        short <= error,
        shaped_short <= shaped_error,
        short,
        shaped_short,
        error,
        shaped_error,
        tolerance,
    )


def total_loss(own: Solution, met: Reachable, chosen: BoolArray) -> float:
    """Return the largest possible loss of a policy of `chosen` actions, (N, A).

    max_s V*(s) - V_worst(s), where V_worst is the lowest value that such a policy has, and the
    errors of both.
    """
    mdp = met.mdp
    row = mdp.outcome_row.copy()
    rows = row[met.states]
    first = np.take_along_axis(rows, chosen.argmax(axis=1)[:, None], axis=1)
    row[met.states] = np.where(chosen, rows, first)
    against = replace(mdp, outcome_row=frozen(row), reward=frozen(-mdp.reward))
    worst = solve(against)
    lost = (own.values + worst.values)[met.states].max(initial=0.0)
    return float(lost) + own.error_bound + worst.error_bound


def counterexample(
    met: Reachable, own: Solution, shaped: ShapedValues, found: ActionComparison
) -> Counterexample:
    """Return the state in which most is lost, or else one whose optimal action is given up."""
    mdp, q = met.mdp, own.action_values[met.states]
    if found.lost.any():
        row = int(found.lost.argmax())
        best = int(q[row].argmax())
        other = int(np.where(found.chosen[row], found.short[row], np.inf).argmin())
        lost = float(found.short[row, other])
    else:
        row = int(found.given_up.argmax())
        other, lost = int(shaped.values[row].argmax()), 0.0
        best = int(np.where(found.optimal[row], found.shaped_short[row], np.inf).argmin())
    state = int(met.states[row])
    return Counterexample(
        state=state,
        components=values_of(mdp.states, state),
        place=state_name(mdp.states, state),
        action=best,
        shaped_action=other,
        actions=(action_name(mdp.actions, best), action_name(mdp.actions, other)),
        lost=lost,
        values=(float(q[row, best]), float(q[row, other])),
        shaped_values=(float(shaped.values[row, best]), float(shaped.values[row, other])),
    )


def too_close(met: Reachable, own: Solution, shaped: ShapedValues, found: ActionComparison) -> str:
    """Return the sentence about the states whose actions are proven neither equal nor different."""
    rows = np.flatnonzero(found.undecided)
    row = rows[0]
    q, acted = own.action_values[met.states[row]], shaped.values[row]
    close = np.flatnonzero(found.optimal[row] | found.chosen[row])
    two = close[np.argsort(-q[close], kind="stable")[:2]]
    values = " and ".join(
        f"{action_name(met.mdp.actions, int(a))} is worth {q[a]:.6g}, under shaping {acted[a]:.6g}"
        for a in two
    )
    return (
        f"in {len(rows):,} of {len(met.states):,} reachable states the values are too close to "
        f"tell, first in {state_name(met.mdp.states, int(met.states[row]))}: {values}"
    )
