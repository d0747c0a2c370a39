"""Recipes: curricula in relative terms, which fit any task like those they were found on."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import Any

from curricle.checks import brief, instance, one_of
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import SETTINGS
from curricle.design.assembly import TARGET, transfers_of
from curricle.design.proposals import SourceCandidate
from curricle.design.relations import Relation
from curricle.design.trends import Trend
from curricle.errors import CurriculumError
from curricle.frozen_arrays import Frozen
from curricle.learning.guard import Guard
from curricle.learning.learners import QLearning
from curricle.learning.schedules import linear
from curricle.learning.shaping import LookAheadAdvice, QInitialisation, Shaping, StateShaping
from curricle.learning.stopping import SETTLED, StoppingRule
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model, same_task
from curricle.transfer.aggregation import Aggregate, maximum, mean, minimum, total
from curricle.transfer.edges import Calibrate, Transfer

AGGREGATES: Mapping[str, Aggregate] = MappingProxyType(
    {"mean": mean, "minimum": minimum, "maximum": maximum, "total": total}
)
SHAPINGS: Mapping[str, Callable[[], Shaping]] = MappingProxyType(
    {
        "initialise": QInitialisation,
        "guarded": partial(QInitialisation, guard=Guard()),
        "look-ahead": LookAheadAdvice,
        "state": StateShaping,
    }
)
"""Ways in which the sources' values enter the learning of the target."""


@dataclass(frozen=True)
class Stage(Frozen):
    """One source of a recipe, and how long it is trained.

    Parameters
    ----------
    relation : Relation
    steps : Trend or float
        Steps per state of the source. A trend is over the states of the target.
    settled : bool
        Whether it ends before where its return has settled; else it takes all of them.

    Examples
    --------
    >>> print(Stage(Relation("crop", 0.5), steps=40))
    crop 0.5: 40 steps a state
    """

    relation: Relation
    steps: Any
    settled: bool = False

    def __post_init__(self) -> None:
        instance("the relation of a stage", self.relation, Relation, CurriculumError)
        instance("settled of a stage", self.settled, bool, CurriculumError)
        if not isinstance(self.steps, Trend):
            object.__setattr__(self, "steps", Trend.constant(self.steps))

    def budget(self, states: int, target: Any) -> StoppingRule:
        """Return the budget of a source of so many states, for this target."""
        steps = max(1, round(states * at_target(self.steps, target)))
        return StoppingRule(steps, settled=SETTLED if self.settled else None)

    def __str__(self) -> str:
        until = ", until settled" if self.settled else ""
        return f"{self.relation}: {self.steps} steps a state{until}"


@dataclass(frozen=True)
class Recipe(Frozen):
    """A curriculum in relative terms.

    Parameters
    ----------
    stages : sequence of Stage
        In order, the first one first. Without any the recipe is to learn the target alone.
    chain : bool
        Whether each source builds on the one before, and the target on the last; else the target
        reads all of them.
    aggregate : {"mean", "minimum", "maximum", "total"}
        Of what the target reads, where that is several potentials.
    scale : Trend, float or "calibrated"
        Of the values that the target reads, over the states of the target.
    shaping : {"initialise", "guarded", "look-ahead", "state"}
        How they enter: as the start of Q, the same with a :class:`Guard`, as
        :class:`LookAheadAdvice`, or as :class:`StateShaping`.
    annealed : bool
        Whether sources are learnt by Q-learning with a learning rate that falls from 0.5 to 0.01
        and half of the actions random: values of more states, and more accurate ones. Else they are
        learnt as the target is.

    Raises
    ------
    CurriculumError
        When a part is of the wrong kind.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> recipe = Recipe([Stage(Relation("crop", 0.35), 60), Stage(Relation("crop", 0.7), 60)])
    >>> print(recipe)
    crop 0.35: 60 steps a state
    crop 0.7: 60 steps a state
    each builds on the one before; scale 1; initialise
    >>> plan = recipe.curriculum(maze_family(size=8, seed=1), budget=50_000)
    >>> plan.order, plan.setting("budget", "rows 0..2, columns -2..0").max_steps
    (('rows 0..2, columns -2..0', 'rows 0..5, columns -5..0', 'target'), 480)
    """

    stages: Any = ()
    chain: bool = True
    aggregate: str = "mean"
    scale: Any = 1.0
    shaping: str = "initialise"
    annealed: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.stages, Iterable):
            raise CurriculumError(
                f"the stages of a recipe must be a list of Stages: got {brief(self.stages)}"
            )
        stages = tuple(self.stages)
        for one in stages:
            instance("each stage of a recipe", one, Stage, CurriculumError)
        object.__setattr__(self, "stages", stages)
        instance("chain of a recipe", self.chain, bool, CurriculumError)
        instance("annealed of a recipe", self.annealed, bool, CurriculumError)
        one_of("the aggregate of a recipe", self.aggregate, AGGREGATES, CurriculumError)
        one_of("the shaping of a recipe", self.shaping, SHAPINGS, CurriculumError)
        calibrated = isinstance(self.scale, str) and self.scale == "calibrated"
        if not calibrated and not isinstance(self.scale, Trend):
            object.__setattr__(self, "scale", Trend.constant(self.scale))

    def __str__(self) -> str:
        if not self.stages:
            return "no curriculum: the target is learnt alone"
        lines = [str(stage) for stage in self.stages]
        how = []
        if len(self.stages) > 1:
            how.append("each builds on the one before" if self.chain else "the target reads all")
        if self.aggregate != "mean":
            how.append(self.aggregate)
        how += ["annealed sources"] if self.annealed else []
        how += [self.scale if isinstance(self.scale, str) else f"scale {self.scale}", self.shaping]
        return "\n".join([*lines, "; ".join(how)])

    def sources(
        self, target: Any, source_of: Callable[[Relation], SourceCandidate] | None = None
    ) -> list[tuple[Stage, SourceCandidate]]:
        """Return the stages with their sources of a target, a task or a member of a family.

        `source_of` returns the source of a relation, where some were made before.

        A source that is the target, or the same as another one, is left out: small targets have
        fewer of them. Members of a family are the same by their parameters, as two live tasks of
        one environment are not equal.

        Raises
        ------
        CurriculumError
            When a stage has no source of this target.
        """
        member = target if isinstance(target, FamilyMember) else None
        known = [(target if member is None else member.task, member)]
        found = list[tuple[Stage, SourceCandidate]]()
        for stage in self.stages:
            one = stage.relation
            source = one.source_of(target) if source_of is None else source_of(one)
            own = source.task, source.member
            if not any(_same(own, other) for other in known):
                known.append(own)
                found.append((stage, source))
        return found

    def curriculum(
        self,
        target: Any,
        *,
        source_of: Callable[[Relation], SourceCandidate] | None = None,
        **settings: Any,
    ) -> Curriculum:
        """Return the curriculum of a target.

        Parameters
        ----------
        target : Task or FamilyMember
        source_of : callable, optional
            As in :meth:`sources`.
        **settings
            Of :class:`Curriculum`, for the target where it has its own: ``budget``, ``learner``,
            ``evaluation``, ``eval_freq``, ``storage``. A learner and an evaluation are those of
            the sources too, unless they are dicts.

        Raises
        ------
        CurriculumError
            When a stage has no source of this target.
        """
        task = target.task if isinstance(target, FamilyMember) else target
        stages = self.sources(target, source_of)
        for_target = {"budget", "eval_freq", "storage"}
        given: dict[str, Any] = {
            k: {TARGET: v} if k in for_target else v for k, v in settings.items()
        }
        if not stages:
            return Curriculum({TARGET: task}, **given)
        budgets = {one.name: stage.budget(one.task.states.size, task) for stage, one in stages}
        if self.annealed:
            given["learner"] = {
                TARGET: given.get("learner", SETTINGS["learner"]),
                **{name: annealed_learner(one.max_steps) for name, one in budgets.items()},
            }
        return Curriculum(
            {**{one.name: one.task for _, one in stages}, TARGET: task},
            list(self._transfers(task, [one for _, one in stages])),
            aggregate={TARGET: AGGREGATES[self.aggregate]},
            shaping={TARGET: SHAPINGS[self.shaping](), **self._shaping_of_sources(stages)},
            **{**given, "budget": {**budgets, **given.get("budget", {})}},
        )

    def _shaping_of_sources(self, stages: list[tuple[Stage, SourceCandidate]]) -> dict[str, Any]:
        """Return how sources read those before them: as the start of Q, without a guard."""
        return {one.name: QInitialisation() for _, one in stages[1:]} if self.chain else {}

    def _transfers(self, task: Any, sources: list[SourceCandidate]) -> Iterator[Transfer]:
        names = [one.name for one in sources]
        if self.chain:
            edges = list(pairwise([*names, TARGET]))
        else:
            edges = [(name, TARGET) for name in names]
        if self.scale == "calibrated":
            return transfers_of(task, sources, edges, calibrate=Calibrate())
        return transfers_of(task, sources, edges, scale=at_target(self.scale, task))


def annealed_learner(steps: int) -> QLearning:
    """Return the learner of a source of so many steps, where sources are annealed.

    Examples
    --------
    >>> annealed_learner(1000).epsilon
    0.5
    """
    return QLearning(learning_rate=linear(0.5, 0.01, steps=max(1, steps * 4 // 5)), epsilon=0.5)


def _same(one: tuple[Any, FamilyMember | None], other: tuple[Any, FamilyMember | None]) -> bool:
    """Return whether two tasks, each with its address if it has one, are the same."""
    if one[1] is not None and one[1] == other[1]:
        return True
    observed = is_observation_task(one[0]) or is_observation_task(other[0])
    return not observed and same_task(one[0], other[0])


def at_target(trend: Trend, target: Any) -> float:
    """Return the number that a trend gives for a target, by its states.

    CurriculumError if they are not numbered and the number is no constant.
    """
    if trend.slope == 0:
        return trend.level
    if is_observation_task(target):
        raise CurriculumError(
            f"a number of a recipe grows with the states of the target, {trend}: a target with "
            "observations has none; give a constant"
        )
    return trend.at(generative_model(target).states.size)
