"""A target task, solved once if it can be: its optimum and the random policy's return."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from curricle.errors import SettingError
from curricle.planning.greedy import Values, VisitedValues
from curricle.planning.policy_evaluation import GreedyEvaluation, greedy_policy_return
from curricle.planning.solution import Solution, solve
from curricle.statistics.curves import fraction_of_optimum
from curricle.tasks.mdp import Task, generative_model, has_tables, tables
from curricle.text import brief_repr

LARGEST_SOLVED = 5_000_000  # pairs (S x A) up to which a target is solved
LARGEST_EVALUATED = 300_000_000
"""Outcomes in all steps (S x A x O x horizon) up to which greedy policies are evaluated exactly."""
ROLLOUTS = 1000  # rollouts of an evaluation that is not exact
BATCHES = 10  # parts into which the rollouts of an evaluation are divided, for their standard error
STANDARD_ERRORS = 2.0  # within which two returns are called the same
NOT_LEARNT = 0.5  # share of the way from random to the optimum below which a task was not learnt


@dataclass(frozen=True, eq=False)
class Target:
    """A target task in which potentials are measured; solved once, if it can be.

    Attributes
    ----------
    task : Task
    evaluation : GreedyEvaluation
    solution : Solution or None
        None where the target is too large to solve, or where at discount 1 only the time limit
        ends some policy's episodes.
    typical_reward : float
        Median size of the rewards other than 0.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> Target.of(GridWorld("S.T", discount=0.5)).optimum
    98.5
    """

    task: Task
    evaluation: GreedyEvaluation
    solution: Solution | None
    typical_reward: float

    __repr__ = brief_repr

    @classmethod
    def of(
        cls,
        task: Task,
        evaluation: GreedyEvaluation | None = None,
        *,
        episodes: int = ROLLOUTS,
    ) -> "Target":
        """Return a target, evaluated exactly where it can be, else by `episodes` rollouts."""
        settings = GreedyEvaluation() if evaluation is None else evaluation
        generative = generative_model(task)
        pairs = generative.states.size * generative.actions.size
        solution, typical = None, float("nan")
        method: Literal["exact", "rollouts"] = "rollouts"
        if has_tables(task) and pairs <= LARGEST_SOLVED:
            mdp = tables(task)
            try:
                solution = solve(task)
            except SettingError:
                if generative.discount < 1:
                    raise  # at discount 1 not every policy ends
            sizes = abs(mdp.reward[(mdp.reward != 0) & np.isfinite(mdp.reward)])
            typical = float(np.median(sizes)) if sizes.size else 1.0
            outcomes = pairs * mdp.probability.shape[1]
            if outcomes * settings.horizon(task) <= LARGEST_EVALUATED:
                method = "exact"
        return cls(task, replace(settings, method=method, episodes=episodes), solution, typical)

    @cached_property
    def optimum(self) -> float:
        """The expected return of an optimal policy; NaN where the target is not solved."""
        if self.solution is None:
            return float("nan")
        best = Values(self.solution.optimal.astype(np.float64))
        return greedy_policy_return(self.task, best, self.evaluation)

    @cached_property
    def random_return(self) -> float:
        """The expected return of the uniformly random policy."""
        return greedy_policy_return(self.task, self._no_values, self.evaluation)

    @property
    def _no_values(self) -> VisitedValues:
        return VisitedValues.none(generative_model(self.task).actions.size)

    @cached_property
    def floor(self) -> float:
        """The return above which something was learnt: half of the way from random to the optimum.

        Where the optimum is unknown, the random policy's return and its noise.
        """
        if self.solution is not None:
            return self.level(NOT_LEARNT)
        random, noise = self.estimated(self._no_values)
        return random + STANDARD_ERRORS * noise

    def estimated(self, view: Any) -> tuple[float, float]:
        """Return the expected return of a greedy policy, and its standard error; 0 if exact."""
        if self.evaluation.method == "exact":
            return greedy_policy_return(self.task, view, self.evaluation), 0.0
        part = replace(self.evaluation, episodes=-(-self.evaluation.rollouts(self.task) // BATCHES))
        returns = [
            greedy_policy_return(self.task, view, part, seed=k, stream="source_learning")
            for k in range(BATCHES)
        ]
        return float(np.mean(returns)), float(np.std(returns, ddof=1) / np.sqrt(BATCHES))

    def level(self, fraction: float) -> float:
        """Return worst + fraction (optimum - worst), worst being the random policy's return.

        SettingError when the target is not solved.
        """
        if self.solution is None:
            raise not_solved(fraction, self.task)
        return fraction_of_optimum(self.optimum, self.random_return, fraction)


def not_solved(fraction: float, task: Any) -> SettingError:
    """Return the error that a fraction of an unknown optimum was asked for."""
    return SettingError(
        f"a fraction of the optimum needs a task that can be solved: got {fraction:g} of {task!r}; "
        "give a return instead"
    )
