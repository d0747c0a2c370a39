"""A target and a source as the searches for mappings read them: tables and exact values."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import brief, whole_number
from curricle.display import brief_repr
from curricle.errors import SettingError, TaskError
from curricle.planning.solution import Solution, evaluate, greedy_policy, solve
from curricle.tasks.mdp import FiniteMDP, reachable_states
from curricle.tasks.task import Task, has_tables, tables
from curricle.transfer.partition_refinement import Model, model_for_refinement, refined
from curricle.transfer.sampled_tables import SampledTables, sampled_tables

ENDLESS = 1_000
"""Steps that stand for the horizon of a task with discount 1 and no time limit."""


@dataclass(frozen=True, eq=False)
class TaskPair:
    """A target and a source with tables; what searches need of them is computed once.

    A discount of 1 is taken as 1 - 1/L, L the time limit (1,000 steps without one), so that values
    are bounded and distances between states contract.

    Parameters
    ----------
    target, source : Task
    samples : int, optional
        Steps of the random policy from which tables are estimated, of each task that has none.
    seed : int
        Of these steps.

    Raises
    ------
    SettingError
        When `samples` is less than 1.
    TaskError
        When one of them has no tables and is not to be sampled.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> TaskPair(GridWorld("S..T"), GridWorld("S.T")).source_solution.values[:2]
    array([196.01, 199.  ])
    """

    target: Task
    source: Task
    samples: int | None = None
    seed: int = 0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        if self.samples is not None:
            whole_number("samples", self.samples, 1, SettingError)
        for role, task in (("target", self.target), ("source", self.source)):
            if self.samples is None and not has_tables(task) and hasattr(task, "model"):
                raise TaskError(
                    f"the {role} has no tables, which find_mappings(..., samples=20_000) estimates "
                    f"from steps: {brief(task)}"
                )
        _ = self.target_mdp, self.source_mdp

    @cached_property
    def sampled(self) -> tuple[SampledTables | None, SampledTables | None]:
        """What was estimated of the target and of the source; None of those with tables."""
        of_target, of_source = (self._sampled(task) for task in (self.target, self.source))
        return of_target, of_source

    def _sampled(self, task: Task) -> SampledTables | None:
        if self.samples is None or has_tables(task):
            return None
        return sampled_tables(task, self.samples, seed=self.seed)

    @cached_property
    def target_mdp(self) -> FiniteMDP:
        """The target's tables."""
        found = self.sampled[0]
        return discounted(tables(self.target) if found is None else found.mdp)

    @cached_property
    def source_mdp(self) -> FiniteMDP:
        """The source's tables."""
        found = self.sampled[1]
        return discounted(tables(self.source) if found is None else found.mdp)

    @property
    def steps(self) -> int:
        """Steps that were taken in both tasks to estimate their tables."""
        return sum(found.steps for found in self.sampled if found is not None)

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
        """Values of the target's policies that need no source, (S,) float64.

        The random policy or the myopic one, which is greedy on the next reward: whichever has the
        larger mean.
        """
        mdp = self.target_mdp
        rewards = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row]
        policies = np.full(rewards.shape, 1 / rewards.shape[1]), greedy_policy(rewards)
        values = [evaluate(mdp, policy).values for policy in policies]
        return max(values, key=lambda one: float(one[self.judged].mean()))

    @cached_property
    def judged(self) -> BoolArray:
        """The target's states that an episode can be in and that do not end it, (S,) bool.

        Of a target that was sampled, those in which every action was tried.
        """
        live = reachable_states(self.target_mdp) & ~self.target_mdp.terminal
        return live if self.sampled[0] is None else live & self.sampled[0].tried

    @cached_property
    def models(self) -> tuple[Model, Model]:
        """Both tasks for refinement, with the target's discount.

        V* of the source also solves V = max_a r' + gamma_t P V, with r' = r + (gamma_s - gamma_t)
        P V: a task with the target's discount. Where discounts agree nothing changes.
        """
        own, other = self.target_mdp, self.source_mdp
        rewards = (other.probability * other.reward).sum(axis=1)
        if own.discount != other.discount:
            after = (other.probability * self.source_solution.values[other.next_state]).sum(axis=1)
            rewards = rewards + (other.discount - own.discount) * after
        return model_for_refinement(own), model_for_refinement(other, rewards)

    @cached_property
    def source_blocks(self) -> IntArray:
        """The block of each source state, (S',) int64; states of a block behave alike."""
        return refined([model_for_refinement(self.source_mdp)])[0].states


def discounted(mdp: FiniteMDP) -> FiniteMDP:
    """Return tables with a discount below 1: their own, or 1 - 1/L at a discount of 1.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> discounted(GridWorld("S.T", discount=1, time_limit=50).mdp).discount
    0.98
    """
    if mdp.discount < 1:
        return mdp
    return replace(mdp, discount=1 - 1 / max(2, mdp.time_limit or ENDLESS))
