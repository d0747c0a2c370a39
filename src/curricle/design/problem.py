"""A target of a design: how it is learnt, what counts as learnt, and what a curriculum costs."""

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from curricle.array_types import BoolArray, IntArray
from curricle.checks import brief, fit_name, instance, number, one_of, whole_number
from curricle.comparison.comparing import FRACTION
from curricle.comparison.controls import changed_potentials, learn_changed, value_controls
from curricle.comparison.levels import VisitedPairs
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import DEFAULT_STEPS
from curricle.curriculum.result import CurriculumResult
from curricle.design.assembly import TARGET
from curricle.design.ledger import Ledger
from curricle.design.proposals import SourceCandidate
from curricle.design.recipe import Recipe
from curricle.design.relations import Relation
from curricle.design.spending import ledger_of
from curricle.errors import CurriculumError
from curricle.frozen_arrays import Frozen
from curricle.learning.learners import Learner, QLearning
from curricle.learning.result import LearningResult
from curricle.learning.stopping import StoppingRule
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import Target
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.task import has_tables

CHECKPOINTS = 100
"""Evaluations in the steps of a training, unless told otherwise."""
CONDITIONS = "threshold", "fraction", "plateau", "drop", "settled"
"""Of a stopping rule, those that read evaluations."""
MEASURES = ("time", "area")
PATIENCE = 3
"""Evaluations in a row that must reach the return that counts as learnt."""


class Training(NamedTuple):
    """What one curriculum cost, for K seeds."""

    steps: IntArray  # (K,) as the problem measures it, sources included
    learnt: BoolArray  # (K,) whether it was
    source_steps: IntArray  # (K,) of them


@dataclass(frozen=True, eq=False)
class Problem(Frozen):
    """A target, how it is learnt in each training of a design, and when it counts as learnt.

    Parameters
    ----------
    target : Task or FamilyMember
        A task with tables, unless `threshold` is given.
    steps : int
        Of a training at most, its sources included.
    learner : Learner
        Of target and sources.
    fraction : float
        Of the way from the random policy's return to the optimum: learnt is what reaches it in
        three evaluations in a row.
    threshold : float, optional
        The return itself instead.
    evaluation : GreedyEvaluation, optional
        By default exact where tables allow it, as rollouts cost steps; of a live task and of one
        with observations a few rollouts.
    eval_freq : int, optional
        Steps between evaluations; a hundredth of `steps` by default.
    measure : {"time", "area"}
        Of a training's cost: the steps until the target is learnt, or these steps weighted by what
        is missing, 1 - (return - random) / (level - random), kept from 0 to 1; those of sources
        count in full. Take the area where scratch does not learn the target in `steps`.
    miniature : bool
        Whether it stands for something larger: its steps are booked as ``miniatures``.
    name : str, optional
        By default that of the member, or "target".

    Raises
    ------
    CurriculumError, SettingError
        When a number is out of range.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> problem = Problem(GridWorld("S..T"), steps=2000)
    >>> problem.train(problem.scratch, seeds=range(2))[0].learnt
    array([ True,  True])
    """

    target: Any
    steps: int = DEFAULT_STEPS
    learner: Learner = field(default_factory=QLearning)
    fraction: float = FRACTION
    threshold: float | None = None
    evaluation: GreedyEvaluation | None = None
    eval_freq: int | None = None
    measure: Literal["time", "area"] = "time"
    miniature: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        whole_number("steps of a training", self.steps, 1, CurriculumError)
        number("the fraction that counts as learnt", self.fraction, CurriculumError, 0, 1)
        one_of("the measure of a problem", self.measure, MEASURES, CurriculumError)
        instance("the learner of a problem", self.learner, Learner, CurriculumError)
        instance("miniature of a problem", self.miniature, bool, CurriculumError)
        if self.evaluation is not None:
            given = "the evaluation of a problem", self.evaluation
            instance(*given, GreedyEvaluation, CurriculumError)
        if self.eval_freq is not None:
            whole_number("eval_freq of a problem", self.eval_freq, 1, CurriculumError)
        if self.threshold is not None:
            number("the threshold of a problem", self.threshold, CurriculumError)
        name = self.name or (str(self.target) if isinstance(self.target, FamilyMember) else TARGET)
        fit_name("a problem", name, CurriculumError)
        object.__setattr__(self, "name", name)
        if self.threshold is None and not has_tables(self.task):
            raise CurriculumError(
                "a fraction of the way to the optimum needs a target with tables; give the "
                f"threshold of {name}: got {brief(self.task)}"
            )
        if self.evaluation is None:
            object.__setattr__(self, "evaluation", _default_evaluation(self.task))
        if self.eval_freq is None:
            object.__setattr__(self, "eval_freq", max(1, self.steps // CHECKPOINTS))

    @property
    def task(self) -> Any:
        """The target as a task."""
        return self.target.task if isinstance(self.target, FamilyMember) else self.target

    @cached_property
    def level(self) -> float:
        """The return that counts as learnt."""
        if self.threshold is not None:
            return float(self.threshold)
        return Target.of(self.task, self.evaluation).level(self.fraction)

    @cached_property
    def random_return(self) -> float:
        """The return of the uniformly random policy."""
        return Target.of(self.task, self.evaluation).random_return

    @property
    def settings(self) -> dict[str, Any]:
        """What the curricula of the problem share, as :meth:`Recipe.curriculum` takes it."""
        return {
            "budget": self.steps,
            "learner": self.learner,
            "evaluation": self.evaluation,
            "eval_freq": self.eval_freq,
        }

    @property
    def scratch(self) -> Curriculum:
        """The curriculum without sources."""
        return self.curriculum(Recipe())

    def curriculum(self, recipe: Recipe) -> Curriculum:
        """Return the curriculum of a recipe for the target, with the settings of the problem."""
        return recipe.curriculum(self.target, source_of=self._source_of, **self.settings)

    @cached_property
    def _sources(self) -> dict[Relation, SourceCandidate]:
        """Sources of the target that were made before: hundreds of recipes share them."""
        return {}

    def _source_of(self, relation: Relation) -> SourceCandidate:
        if relation not in self._sources:
            self._sources[relation] = relation.source_of(self.target)
        return self._sources[relation]

    def within(self, steps: int) -> "Problem":
        """Return the problem with trainings of so many steps at most, evaluated as often."""
        return replace(self, steps=min(self.steps, steps), threshold=self.level)

    def train(
        self,
        curriculum: Curriculum,
        seeds: Any,
        *,
        placebo: bool = False,
        workers: int | None = None,
    ) -> tuple[Training, Ledger]:
        """Return what a curriculum cost, and the ledger of its training.

        It ends where the target is learnt. Sources whose budget reads no evaluations are not
        evaluated where that would take rollouts. A curriculum whose sources may take all steps of a
        training is not trained: each seed counts with all steps, and nothing is booked.

        Parameters
        ----------
        curriculum : Curriculum
            Whose target is the problem's.
        seeds : sequence of K int
        placebo : bool
            Whether the values that the target reads are shuffled over its pairs: a control, for
            targets with tables.

        Raises
        ------
        CurriculumError
            When a placebo is asked of a target without tables.
        """
        if placebo and not has_tables(self.task):
            raise CurriculumError(
                "a placebo shuffles values over the pairs of a target with tables: got "
                f"{brief(self.task)}"
            )
        numbers = [int(seed) for seed in seeds]
        name = curriculum.target
        if self._sources_at_most(curriculum) >= self.steps:
            full = np.full(len(numbers), self.steps)
            return Training(full, np.zeros(len(numbers), bool), full), Ledger()
        rule = StoppingRule(self.steps, threshold=self.level, patience=PATIENCE)
        ends = _without_unread_rollouts(curriculum).replace(name, budget=rule)
        with warnings.catch_warnings():
            # That a calibration is refused is what this curriculum does, not something to mend.
            warnings.simplefilter("ignore", UserWarning)
            result = ends.train(numbers, charge=True, workers=workers)
        spent = result.source_steps(name) if len(ends.order) > 1 else np.zeros(len(numbers), int)
        last = result[name]
        ledger = ledger_of(result, miniature=self.miniature)
        if placebo:
            last = self._placebo(ends, result, workers)
            ledger += ledger_of(last, miniature=self.miniature)
        return Training(spent + self._cost(last), self._learnt(last), spent), ledger

    def evaluated_at_most(self, curriculum: Curriculum) -> int:
        """Return the most steps that a seed's evaluations can take in a training; 0 if exact.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> rollouts = GreedyEvaluation("rollouts", episodes=10)
        >>> maze = GridWorld("S..T", time_limit=20)
        >>> problem = Problem(maze, steps=2000, evaluation=rollouts, eval_freq=500)
        >>> problem.evaluated_at_most(problem.scratch)    # 5 times 10 episodes
        1000
        """
        plan = _without_unread_rollouts(curriculum).replace(curriculum.target, budget=self.steps)
        return sum(plan.node(name).most_evaluation_steps for name in plan.order)

    def _sources_at_most(self, curriculum: Curriculum) -> int:
        names = curriculum.ancestors(curriculum.target)
        return sum(curriculum.node(one).most_steps for one in names)

    def _placebo(
        self, curriculum: Curriculum, result: CurriculumResult, workers: int | None
    ) -> LearningResult:
        pairs = VisitedPairs.of(curriculum)
        ((_, change),) = value_controls(["placebo"], pairs)
        return learn_changed(result, changed_potentials(result, change), workers)

    def _cost(self, result: LearningResult) -> IntArray:
        """Return the steps in the target by the problem's measure, (K,)."""
        if self.measure == "time":
            return result.steps_used
        worst, freq = self.random_return, self.eval_freq or 1
        missing = (self.level - result.greedy_return) / (self.level - worst)
        share = np.clip(missing, 0.0, 1.0)
        left = np.clip(result.steps_used[:, None] - result.steps, 0, freq)
        return np.asarray(np.rint((share * left).sum(axis=1)), np.int64)

    def _learnt(self, result: LearningResult) -> BoolArray:
        """Return whether each seed's last evaluations reached the level, (K,)."""
        found = []
        for greedy, used in zip(result.greedy_return, result.steps_used, strict=True):
            end = int(used) // (self.eval_freq or 1)
            last = greedy[: end + 1][-PATIENCE:]
            found.append(len(last) == PATIENCE and bool((last >= self.level).all()))
        return np.array(found)


def _default_evaluation(task: Any) -> GreedyEvaluation:
    return Target.of(task).evaluation if has_tables(task) else GreedyEvaluation("rollouts")


def _without_unread_rollouts(curriculum: Curriculum) -> Curriculum:
    """Return a curriculum whose sources are not evaluated where nothing depends on the rollouts."""
    for name in curriculum.ancestors(curriculum.target):
        node = curriculum.node(name)
        read = any(getattr(node.budget, one, None) is not None for one in CONDITIONS)
        if node.most_evaluation_steps and not read:
            curriculum = curriculum.replace(name, evaluation=GreedyEvaluation("off"))
    return curriculum
