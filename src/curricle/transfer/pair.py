"""Two tasks with the exact values that searches for mappings read; the proposals of searches."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.errors import SettingError
from curricle.planning.solution import EPSILON, Solution, evaluate, greedy_policy, solve
from curricle.tasks.graph import reachable_states
from curricle.tasks.mdp import FiniteMDP, Task, closed, duplicated, live_pairs, tables
from curricle.text import brief_repr
from curricle.transfer.mapping import UNMAPPED, PairMapping, StateActionMapping

NOT_PROVEN = float("nan")
ENDLESS = 1_000  # the horizon of a task with discount 1 and no time limit, in steps


@dataclass(frozen=True, eq=False)
class TaskPair:
    """A target and a source with tables; values that several searches need are computed once.

    A discount of 1 is taken as 1 - 1/L, L the time limit (1,000 steps without one), so that values
    are bounded and distances between states contract.

    Raises
    ------
    TaskError
        When a task has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> TaskPair(GridWorld("S..T"), GridWorld("S.T")).source_solution.values[:2]
    array([196.01, 199.  ])
    """

    target: Task
    source: Task
    target_mdp: FiniteMDP = field(init=False, repr=False)
    source_mdp: FiniteMDP = field(init=False, repr=False)

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        for role, task in (("target", self.target), ("source", self.source)):
            mdp = tables(task)
            if mdp.discount == 1:
                mdp = replace(mdp, discount=1 - 1 / max(2, mdp.time_limit or ENDLESS))
            object.__setattr__(self, f"{role}_mdp", mdp)

    @property
    def models(self) -> tuple[FiniteMDP, FiniteMDP]:
        """The tables of the target and of the source."""
        return self.target_mdp, self.source_mdp

    @cached_property
    def target_solution(self) -> Solution:
        """Exact values of the target."""
        return solve(self.target_mdp)

    @cached_property
    def source_solution(self) -> Solution:
        """Exact values of the source."""
        return solve(self.source_mdp)

    @cached_property
    def values_without(self) -> FloatArray:
        """Values of the target's random or myopic policy, (S,): those with the larger mean."""
        mdp = self.target_mdp
        rewards = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row]
        policies = mdp.random_policy, greedy_policy(closed(rewards, mdp.available))
        values = [evaluate(mdp, policy).values for policy in policies]
        return max(values, key=lambda by_policy: float(by_policy[self.judged].mean()))

    @cached_property
    def judged(self) -> BoolArray:
        """The target's reachable nonterminal states, (S,) bool."""
        return reachable_states(self.target_mdp) & ~self.target_mdp.terminal

    @cached_property
    def pairs(self) -> BoolArray:
        """The pairs of these states and their available actions, (S, A) bool."""
        return self.judged[:, None] & live_pairs(self.target_mdp)

    @cached_property
    def own_solutions(self) -> tuple[Solution, Solution] | None:
        """The solutions of both tasks at their own discounts; None if a task has no finite Q*."""
        judged = (self.target, self.target_solution), (self.source, self.source_solution)
        try:
            of_target, of_source = (
                s if tables(task).discount < 1 else solve(task) for task, s in judged
            )
        except SettingError:
            return None
        return of_target, of_source

    def bound(self, index: IntArray) -> float:
        """Return a bound on abs(Q* - Q* of the pair read) over mapped pairs; or `NOT_PROVEN`."""
        mapped = (index != UNMAPPED) & ~self.target_mdp.terminal[:, None]
        if self.own_solutions is None or not mapped.any():
            return NOT_PROVEN
        most = apart(index, *self.own_solutions)[mapped].max()
        error = sum(solution.error_bound for solution in self.own_solutions)
        return float((most + error) * (1 + 4 * EPSILON))

    def proposal(self, index: IntArray, how: str) -> "Proposal":
        """Return the proposal of a mapping by an index, (S, A); `how` states how it was found."""
        # Searches read tables, in which an unavailable pair is a copy of another pair.
        rows = self.source_mdp.outcome_row
        pairs = np.arange(rows.size).reshape(rows.shape)
        copied = duplicated(pairs, self.source_mdp.available).ravel()
        index = np.where(index < 0, index, copied[np.maximum(index, 0)])
        mapping = StateActionMapping(self.target, self.source, index, how=how, knows_target=True)
        return Proposal(mapping, how)


def apart(index: IntArray, of_target: Solution, of_source: Solution) -> FloatArray:
    """Return abs(Q*(s, a) - Q* of the pair that it reads), (S, A); NaN where it reads no pair."""
    read = np.where(index >= 0, of_source.finite_action_values.ravel()[np.maximum(index, 0)], 0.0)
    read = np.where(index == UNMAPPED, np.nan, read)
    return np.asarray(abs(of_target.finite_action_values - read))


# -- what a search proposes ------------------------------------------------------------------------


class Proposal(NamedTuple):
    """A mapping that a search proposes.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> Proposal(identity(GridWorld("S.T")), "by hand").how
    'by hand'
    """

    mapping: PairMapping
    how: str  # how it was found
