"""What is known of a target task beforehand: its optimum, its floor, and its possible returns."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from curricle.errors import SettingError
from curricle.planning.greedy import Values, VisitedValues
from curricle.planning.models import TabularPlanningModel
from curricle.planning.policy_evaluation import (
    LARGEST_EXACT,
    NEGLIGIBLE,
    GreedyEvaluation,
    greedy_policy_return,
)
from curricle.planning.solution import Solution, solve, values_in
from curricle.statistics.curves import ROUNDING, fraction_of_optimum
from curricle.tasks.mdp import NO_LIMIT, Task, closed, generative_model, has_tables, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr

LARGEST_SOLVED = 5_000_000  # pairs (S x A) up to which a target is solved
LARGEST_EVALUATED = 300_000_000
"""Outcomes in all steps (S x A x O x horizon) up to which greedy policies are evaluated exactly."""
ROLLOUTS = 1000  # rollouts of an evaluation that is not exact
BATCHES = 10  # parts into which the rollouts of an evaluation are divided, for their standard error
STANDARD_ERRORS = 2.0  # within which two returns are called the same
NOT_LEARNT = 0.5  # share of the way from random to the optimum below which a task was not learnt
MOST_SWEEPS, MOST_BACKUPS = 10_000, 10_000_000
"""Steps, and outcomes times steps, to which all episodes are searched for extreme returns: 0.1 s"""


class Estimated(NamedTuple):
    """An estimate of a policy's return, its standard error, and the steps that it took."""

    value: float
    noise: float
    steps: int


@dataclass(frozen=True, eq=False)
class Target:
    """A target task in which potentials are measured; solved once, if it can be.

    Attributes
    ----------
    task : Task
    evaluation : GreedyEvaluation
    solution : Solution or None
        None where the target is too large to solve, or at discount 1, without a time limit, has no
        optimum that could be bounded.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> Target.of(GridWorld("S.T", discount=0.5)).optimum
    98.5
    """

    task: Task
    evaluation: GreedyEvaluation
    solution: Solution | None

    __repr__ = brief_repr

    @classmethod
    def of(
        cls, task: Task, evaluation: GreedyEvaluation | None = None, *, episodes: int = ROLLOUTS
    ) -> "Target":
        """Return a target, evaluated exactly where it can be, else by `episodes` rollouts."""
        settings = GreedyEvaluation() if evaluation is None else evaluation
        generative = generative_model(task)
        pairs = generative.states.size * generative.actions.size
        solution = None
        method: Literal["exact", "rollouts"] = "rollouts"
        if has_tables(task) and pairs <= LARGEST_SOLVED:
            mdp = tables(task)
            try:
                solution = solve(task)
            except SettingError:
                if generative.discount < 1:
                    raise  # at discount 1 some policy never ends
            outcomes = pairs * mdp.probability.shape[1]
            few = outcomes <= LARGEST_EXACT  # without a limit or discount the horizon is endless
            if few or outcomes * settings.horizon(task) <= LARGEST_EVALUATED:
                method = "exact"
        return cls(task, replace(settings, method=method, episodes=episodes), solution)

    @cached_property
    def optimum(self) -> float:
        """The highest expected return of a policy; NaN where the target is not solved.

        Under a time limit the policy may count the steps. Where the evaluation has another discount
        than the task, or samples, it is the return of a policy that is optimal without a limit.
        """
        if self.solution is None:
            return float("nan")
        model = generative_model(self.task)
        if self.optimum_bounds and model.time_limit is not None:
            if self.solution.steps is not None:
                return self.solution.start_value
            mdp = tables(self.task)
            return float(mdp.start @ values_in(TabularPlanningModel.of(mdp), model.time_limit))
        best = Values(self.solution.action_values)
        return greedy_policy_return(self.task, best, self.evaluation).value

    @property
    def optimum_bounds(self) -> bool:
        """Whether no policy returns more than the optimum of a solved target."""
        comparable = self.evaluation.discount(self.task) == generative_model(self.task).discount
        return self.evaluation.method == "exact" and comparable

    @cached_property
    def random_return(self) -> float:
        """The expected return of the policy that takes every available action equally often."""
        return greedy_policy_return(self.task, self._no_values, self.evaluation).value

    @property
    def _no_values(self) -> VisitedValues:
        return VisitedValues.none(generative_model(self.task).actions.size)

    @property
    def _above_random(self) -> bool:
        """Whether the optimum exceeds the random policy's return by more than rounding."""
        # Undiscounted, the policy that is optimal with the discount need not beat a random one.
        best, worst = self.optimum, self.random_return
        return best > worst and not math.isclose(best, worst, rel_tol=ROUNDING)

    @cached_property
    def floor(self) -> float:
        """The return above which something was learnt: half of the way from random to the optimum.

        Where the optimum is unknown, the random policy's return and its noise; without a bound
        where the optimum is not above random play.
        """
        if self.solution is not None:
            return self.level(NOT_LEARNT) if self._above_random else -math.inf
        return self.random.value + STANDARD_ERRORS * self.random.noise

    @property
    def floor_steps(self) -> int:
        """The steps of the rollouts that :attr:`floor` rests on; 0 where it follows from tables."""
        return 0 if self.solution is not None else self.random.steps

    @cached_property
    def random(self) -> Estimated:
        """The return of the random policy, its standard error, and the steps of its rollouts."""
        return self.estimated(self._no_values)

    def estimated(self, view: object) -> Estimated:
        """Return the expected return of a greedy policy, and its standard error; 0 if exact."""
        if self.evaluation.method == "exact":
            return Estimated(greedy_policy_return(self.task, view, self.evaluation).value, 0.0, 0)
        part = replace(self.evaluation, episodes=-(-self.evaluation.rollouts(self.task) // BATCHES))
        returns = [
            greedy_policy_return(self.task, view, part, seed=k, stream="source_learning")
            for k in range(BATCHES)
        ]
        values, steps = zip(*returns, strict=True)
        noise = float(np.std(values, ddof=1) / np.sqrt(BATCHES))
        return Estimated(float(np.mean(values)), noise, sum(steps))

    def level(self, fraction: float) -> float:
        """Return worst + fraction (optimum - worst), worst being the random policy's return.

        Where these two are equal up to rounding, every policy reaches the level. SettingError when
        the target is not solved, or its optimum is below random play.
        """
        if self.solution is None:
            raise not_solved(fraction, self.task)
        model = generative_model(self.task)
        if model.time_limit is None and self.optimum == 0 != self.solution.start_value:
            raise SettingError(
                "a fraction of the optimum needs a time limit, time_limit=, where the discount "
                f"leaves less than {NEGLIGIBLE:g} of all rewards: it is {model.discount:g}"
            )
        best, worst = self.optimum, self.random_return
        if math.isclose(best, worst, rel_tol=ROUNDING):
            return min(best, worst) - ROUNDING * abs(best)
        if best < worst:
            raise SettingError(
                "a fraction of the optimum needs an optimal policy that returns more than random "
                f"play: by the evaluation of {self.task!r} they return {best:g} and {worst:g}; "
                "give a return instead"
            )
        return fraction_of_optimum(best, worst, fraction)


def not_solved(fraction: float, task: object) -> SettingError:
    """Return the error that a fraction of an unknown optimum was asked for."""
    return SettingError(
        f"a fraction of the optimum needs a task that can be solved: got {fraction:g} of {task!r}; "
        "give a return instead"
    )


def possible_returns(task: object, discount: float) -> tuple[float, float] | None:
    """Return the lowest and the highest return of an episode; None where they are not known.

    They are of a task with tables, if it is small enough: v(s) = max_a max_o r + gamma v(s') over
    the outcomes o that are possible, for each step to the time limit, and the same with min.
    """
    if is_observation_task(task) or not has_tables(task):
        return None
    generative, ends = generative_model(task), list[float]()
    if generative.states.size * generative.actions.size > LARGEST_SOLVED:
        return None
    mdp = tables(task)
    possible, going = mdp.probability > 0, ~mdp.terminal
    most = min(MOST_SWEEPS, 1 + MOST_BACKUPS // max(possible.size, mdp.outcome_row.size))
    limit = NO_LIMIT if mdp.time_limit is None else mdp.time_limit
    for sign in (-1, 1):
        values, n, rewards = np.zeros(len(going)), 0, np.where(possible, sign * mdp.reward, -np.inf)
        before = values + np.inf
        while n < limit and (values != before).any():
            if n == most:
                return None
            rows = (rewards + discount * values[mdp.next_state]).max(axis=1)[mdp.outcome_row]
            before, values = values, np.where(going, closed(rows, mdp.available).max(axis=1), 0.0)
            n += 1
        ends.append(sign * float(values[mdp.start > 0].max()) + 0.0)
    return ends[0], ends[1]
