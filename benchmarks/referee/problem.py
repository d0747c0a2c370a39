"""A target that a curriculum is designed for, and the budget of the search for it."""

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

import curricle as cr
from curricle.arrays import BoolArray, IntArray
from curricle.comparison.controls import PLACEBO, train_control
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult
from curricle.planning.policy_evaluation import Target
from curricle.tasks.family import FamilyMember

TARGET = "target"
"""What the target is called in a curriculum of a design."""
EXACT = cr.GreedyEvaluation(method="exact")
PATIENCE = 3
"""Evaluations in a row that must reach the return that counts as learnt."""
READING = {field.name for field in fields(cr.StoppingRule)} - {
    *("max_steps", "min_steps", "patience", "when")
}
"""Conditions of a stopping rule that read evaluations."""
TIMED_SEEDS, CAP = 2, 1.5
"""Seeds of scratch by which trainings are shortened, and their length over that of scratch: what
costs more is no better for it."""


class Training(NamedTuple):
    """What one curriculum cost, for K seeds."""

    steps: IntArray  # (K,) until the target was learnt, sources included
    learnt: BoolArray  # (K,)
    source_steps: IntArray  # (K,) of the steps


@dataclass(frozen=True, eq=False)
class Problem:
    """A target with tables, how it is learnt in each training, and when it counts as learnt.

    Examples
    --------
    >>> problem = Problem(cr.GridWorld("S..T"), steps=2000, eval_freq=20)
    >>> problem.train(problem.scratch, seeds=range(2))[0].learnt
    array([ True,  True])
    """

    target: Any  # a task or a member of a family
    steps: int  # of a training at most, its sources included
    eval_freq: int
    learner: cr.QLearning = field(default_factory=cr.QLearning)
    fraction: float = 0.9  # of the way from the random policy's return to the optimum
    evaluation: cr.GreedyEvaluation = EXACT
    name: str = TARGET
    threshold: float | None = None  # the return itself, in place of the fraction
    sources: dict[Any, Any] = field(default_factory=dict)
    """Candidates by relation that were made before: hundreds of recipes share them."""

    @property
    def task(self) -> Any:
        """The target as a task."""
        return self.target.task if isinstance(self.target, FamilyMember) else self.target

    @cached_property
    def level(self) -> float:
        """The return that counts as learnt."""
        if self.threshold is not None:
            return self.threshold
        return Target.of(self.task, self.evaluation).level(self.fraction)

    @property
    def scratch(self) -> Curriculum:
        """The curriculum without sources."""
        return self.curriculum({}, [], {})

    def curriculum(
        self, tasks: dict[str, Any], transfers: Any, budgets: dict[str, Any], **settings: Any
    ) -> Curriculum:
        """Return the curriculum with these sources before the target, with their budgets."""
        return Curriculum(
            {**tasks, TARGET: self.task},
            list(transfers),
            budget={**budgets, TARGET: self.steps},
            evaluation=self.evaluation,
            eval_freq={TARGET: self.eval_freq},
            **{"learner": self.learner, **settings},
        )

    def train(
        self, curriculum: Curriculum, seeds: Sequence[int] | range, *, placebo: bool = False
    ) -> tuple[Training, int]:
        """Return what a curriculum cost, and the environment steps of its training.

        It ends where the target is learnt. A curriculum whose sources may take all steps of a
        training is not trained: each seed counts with all steps. A placebo is the same curriculum
        with the values that the target reads shuffled over its pairs.
        """
        numbers = [int(seed) for seed in seeds]
        names = curriculum.ancestors(TARGET)
        if sum(curriculum.node(name).most_steps for name in names) >= self.steps:
            full = np.full(len(numbers), self.steps)
            return Training(full, np.zeros(len(numbers), bool), full), 0
        rule = cr.StoppingRule(self.steps, threshold=self.level, patience=PATIENCE)
        plan = _without_unread_rollouts(curriculum).replace(TARGET, budget=rule)
        with warnings.catch_warnings():
            # That a calibration is refused is what this curriculum does, not something to mend.
            warnings.simplefilter("ignore", UserWarning)
            result = plan.train(numbers, charge=True, workers=1)
        before = result.source_steps(TARGET) if names else np.zeros(len(numbers), int)
        taken = sum(int(task.steps_used.sum()) for task in result.sources.values())
        last = result[TARGET]
        if placebo:
            last, _ = train_control(PLACEBO, plan, numbers, result.sources, workers=1)
            taken += int(last.steps_used.sum())
        return Training(before + last.steps_used, self._learnt(last), before), taken

    def _learnt(self, result: LearningResult) -> BoolArray:
        """Return whether each seed's last evaluations reached the level, (K,)."""
        learnt = []
        for greedy, used in zip(result.greedy_return, result.steps_used, strict=True):
            last = greedy[: int(used) // self.eval_freq + 1][-PATIENCE:]
            learnt.append(len(last) == PATIENCE and bool((last >= self.level).all()))
        return np.array(learnt)


def _without_unread_rollouts(curriculum: Curriculum) -> Curriculum:
    """Return a curriculum whose sources are not evaluated where nothing depends on the rollouts."""
    for name in curriculum.ancestors(TARGET):
        node = curriculum.node(name)
        read = any(getattr(node.budget, condition, None) is not None for condition in READING)
        if node.most_evaluation_steps and not read:
            curriculum = curriculum.replace(name, evaluation=cr.GreedyEvaluation("off"))
    return curriculum


class BudgetSpent(CurriculumError):
    """What is left of a design's budget does not pay for a training."""


class SearchBudget:
    """The steps that a design may spend on trainings, and those that it has spent.

    A training is made only if the most that it can cost is left. Evaluations cost nothing: rollouts
    stand for exact evaluations, which take no steps.

    Examples
    --------
    >>> problem = Problem(cr.GridWorld("S..T"), steps=2000, eval_freq=20)
    >>> budget = SearchBudget(5000)
    >>> training = budget.train(problem, problem.scratch, seeds=range(2))
    >>> bool(training.learnt.all()), bool(budget.left == 5000 - training.steps.sum())
    (True, True)
    """

    def __init__(self, steps: float) -> None:
        self.steps = self._limit = steps
        self.spent = 0

    @property
    def left(self) -> float:
        """The steps that may still be spent."""
        return self._limit - self.spent

    @contextmanager
    def share(self, share: float, *, aside: float) -> Iterator[None]:
        """Keep what is trained in this context to a share of what is left, less what is aside."""
        before = self._limit
        self._limit = self.spent + share * max(0.0, self.left - aside)
        try:
            yield
        finally:
            self._limit = before

    def train(
        self,
        problem: Problem,
        curriculum: Curriculum,
        seeds: Sequence[int] | range,
        *,
        placebo: bool = False,
    ) -> Training:
        """Return what a curriculum costs in a problem, and book it; raise BudgetSpent before."""
        # The sources of a placebo are trained again.
        most = problem.steps * len(seeds) * (2 if placebo else 1)
        if most > self.left:
            raise BudgetSpent(
                f"a training of {problem.name} for {len(seeds)} seeds may cost {most:,.0f} steps: "
                f"{self.left:,.0f} of the budget are left"
            )
        training, taken = problem.train(curriculum, seeds, placebo=placebo)
        self.spent += taken
        return training


def timed(problems: Sequence[Problem], budget: SearchBudget, first_seed: int) -> list[Problem]:
    """Return problems whose trainings end at one and a half times what scratch takes."""
    shortened = []
    for problem in problems:
        seeds = range(first_seed, first_seed + TIMED_SEEDS)
        scratch = budget.train(problem, problem.scratch, seeds).steps
        steps = min(problem.steps, math.ceil(CAP * scratch.mean()))
        shortened.append(replace(problem, steps=steps, threshold=problem.level))
    return shortened
