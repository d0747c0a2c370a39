"""Recipes: curricula in relative terms, which fit any task like those they were found on.

"A crop of half the size" and "the member with one predator" name a source of any target, where
"rows 0 to 3" names one of a single maze.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

from benchmarks.referee.problem import TARGET, Problem
from curricle.curriculum.curriculum import Curriculum
from curricle.design import SourceCandidate, mappings_between
from curricle.design.candidates import MAKERS
from curricle.design.kinds import Draft, design_target
from curricle.errors import CurricleError, CurriculumError
from curricle.learning.learners import QLearning
from curricle.learning.portfolio import Portfolio
from curricle.learning.schedules import linear
from curricle.learning.shaping import LookAheadAdvice, QInitialisation, Shaping, StateShaping
from curricle.learning.stopping import SETTLED, StoppingRule
from curricle.tasks.family import FamilyMember, Parameter
from curricle.tasks.mdp import same_task
from curricle.transfer import family_mappings
from curricle.transfer.aggregate import maximum, mean, minimum, total
from curricle.transfer.transfer import Calibrate, Transfer

AGGREGATES = {"mean": mean, "minimum": minimum, "maximum": maximum, "total": total}
SHAPINGS: dict[str, Callable[[], Shaping]] = {
    "initialise": QInitialisation,
    "guarded": partial(QInitialisation, portfolio=Portfolio()),
    "look-ahead": LookAheadAdvice,
    "state": StateShaping,
}
"""Ways in which the sources' values enter the learning of the target."""
TERM = re.compile(r"(?P<share>\d*\.?\d+)?\s*n\s*(?P<more>[+-]\s*\d+)?")
"""A parameter of a source by that of its target, n: such as ``0.5 n`` or ``n - 1``."""


# -- sources in relative terms -------------------------------------------------------------------


@dataclass(frozen=True)
class Relation:
    """A source by its relation to the target."""

    kind: str
    share: float | None = None  # of the target: of the side of a crop, of the way to the goal
    which: str = ""  # what is removed, or which components are merged: "no pit"
    changes: tuple[tuple[str, Any], ...] = ()  # of a member: its parameters, or terms of them

    def __str__(self) -> str:
        if self.kind == "member":
            return "member with " + ", ".join(f"{name} {value}" for name, value in self.changes)
        share = "" if self.share is None else f" {self.share:.3g}"
        return f"{self.kind}{share}{f': {self.which}' if self.which else ''}"

    def source_of(self, target: Any) -> SourceCandidate:
        """Return the source of a target that stands in this relation to it.

        Of sources that are made in steps, such as crops, it is the one whose share is the nearest;
        of equally near ones the larger.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> maze = GridWorld(["S....", ".....", ".....", "....T"])
        >>> Relation("crop", 0.5).source_of(maze).name
        'rows 1..3, columns 2..4'
        """
        if self.kind == "member":
            return self._member(target)
        drafts = [
            draft
            for draft in MAKERS[self.kind](design_target(target))
            if which_of(draft) == self.which
        ]
        if self.share is not None:
            drafts = [draft for draft in drafts if draft.share is not None]
            drafts.sort(key=self._distance)  # stable
        if not drafts:
            raise CurriculumError(f"the target has no source that is a {self}")
        draft = drafts[0]
        return SourceCandidate(draft.name, *draft.build(), draft.kind, draft.words, draft.share)

    def _distance(self, draft: Draft) -> tuple[float, float]:
        share = draft.share or 0.0
        return round(abs(share - (self.share or 0.0)), 9), -share

    def _member(self, target: Any) -> SourceCandidate:
        if not isinstance(target, FamilyMember):
            raise CurriculumError(f"a source that is a {self} needs a member of a family")
        terms = {
            name: _value(target.family.parameter(name), term, target) for name, term in self.changes
        }
        member = target.replace(**terms)
        mappings = family_mappings(target, member)
        return SourceCandidate(str(member), member.task, mappings, "member", member=member)


def which_of(draft: Draft) -> str | None:
    """Return what tells a draft from others of its kind in any target; None for one hazard."""
    if draft.kind not in ("removed", "coarser"):
        return ""
    return None if " at (" in draft.name else draft.name


def _value(parameter: Parameter, term: Any, target: FamilyMember) -> Any:
    """Return the value of a source's parameter."""
    parts = TERM.fullmatch(term.strip()) if isinstance(term, str) else None
    if parts is None or (parameter.values is not None and term in parameter.values):
        return term
    n = target[parameter.name]
    if n is None:
        return None
    value = (1.0 if parts["share"] is None else float(parts["share"])) * n
    value += 0 if parts["more"] is None else int(parts["more"].replace(" ", ""))
    if parameter.kind is int or isinstance(n, int):
        value = math.floor(value + 0.5)
    low = -math.inf if parameter.low is None else parameter.low
    high = math.inf if parameter.high is None else parameter.high
    return min(max(value, low), high)


def transfers_of(
    task: Any, sources: Sequence[SourceCandidate], edges: Iterable[tuple[str, str]], **into: Any
) -> Iterator[Transfer]:
    """Yield the transfers between sources, and, with these settings, from them into the target."""
    by_name = {source.name: source for source in sources}
    for before, after in edges:
        if after == TARGET:
            for mapping in by_name[before].mappings:
                yield Transfer(before, TARGET, mapping, **into)
        else:
            for mapping in mappings_between(task, by_name[after], by_name[before]):
                yield Transfer(before, after, mapping)


# -- recipes -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trend:
    """A number by the states S of a target: level (S / around)^slope.

    Examples
    --------
    >>> Trend(50.0, slope=0.5, around=100.0).at(400), str(Trend(40.0))
    (100.0, '40')
    """

    level: float
    slope: float = 0.0
    around: float = 1.0

    def at(self, states: float) -> float:
        """Return the number for a target of so many states."""
        return (
            float(self.level * (states / self.around) ** self.slope) if self.slope else self.level
        )

    def __str__(self) -> str:
        if self.slope == 0:
            return f"{self.level:.3g}"
        return f"{self.level:.3g} x (S / {self.around:,.0f})^{self.slope:.2g}"


@dataclass(frozen=True)
class Stage:
    """One source of a recipe, and its steps for each of its states."""

    relation: Relation
    steps: Trend
    settled: bool = False  # whether it ends before where its return has settled

    def budget(self, source: Any, target: Any) -> StoppingRule:
        """Return the budget of a source of a target."""
        steps = max(1, round(source.states.size * self.steps.at(target.states.size)))
        return StoppingRule(steps, settled=SETTLED if self.settled else None)

    def __str__(self) -> str:
        until = ", until settled" if self.settled else ""
        return f"{self.relation}: {self.steps} steps a state{until}"


@dataclass(frozen=True)
class Recipe:
    """A curriculum in relative terms. Without stages the target is learnt alone.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> recipe = Recipe(tuple(Stage(Relation("crop", share), Trend(60)) for share in (0.35, 0.7)))
    >>> print(recipe)
    crop 0.35: 60 steps a state; crop 0.7: 60 steps a state; each builds on the one before; ...
    >>> maze = Problem(maze_family(size=8, seed=1), steps=50_000, eval_freq=500)
    >>> recipe.curriculum(maze).order
    ('rows 0..2, columns -2..0', 'rows 0..5, columns -5..0', 'target')
    """

    stages: tuple[Stage, ...] = ()
    chain: bool = True  # each source builds on the one before; else the target reads all of them
    aggregate: str = "mean"  # of AGGREGATES
    scale: float | str = 1.0  # of the values that the target reads, or "calibrated"
    shaping: str = "initialise"  # of SHAPINGS
    annealed: bool = False
    """Whether sources have a learning rate that falls from .5 to .01 and half of their actions
    random: values of more states, and more accurate ones."""

    def __str__(self) -> str:
        """Return the recipe in one line, which is its name in a race."""
        if not self.stages:
            return "no curriculum: the target is learnt alone"
        parts = [str(stage) for stage in self.stages]
        if len(self.stages) > 1:
            parts.append("each builds on the one before" if self.chain else "the target reads all")
        if self.aggregate != "mean":
            parts.append(self.aggregate)
        parts += ["annealed sources"] if self.annealed else []
        scale = self.scale if isinstance(self.scale, str) else f"scale {self.scale:.3g}"
        return "; ".join([*parts, scale, self.shaping])

    def sources(self, problem: Problem) -> list[tuple[Stage, SourceCandidate]]:
        """Return the stages with their sources; without those that are the target or another."""
        member = problem.target if isinstance(problem.target, FamilyMember) else None
        known = [(problem.task, member)]
        kept = list[tuple[Stage, SourceCandidate]]()
        for stage in self.stages:
            if stage.relation not in problem.sources:
                problem.sources[stage.relation] = stage.relation.source_of(problem.target)
            source = problem.sources[stage.relation]
            if not any(
                (source.member is not None and source.member == other)
                or same_task(source.task, task)
                for task, other in known
            ):
                known.append((source.task, source.member))
                kept.append((stage, source))
        return kept

    def curriculum(self, problem: Problem) -> Curriculum:
        """Return the curriculum of a problem; CurriculumError where it has no such source."""
        stages = self.sources(problem)
        if not stages:
            return problem.scratch
        budgets = {one.name: stage.budget(one.task, problem.task) for stage, one in stages}
        shapings: dict[str, Shaping] = {TARGET: SHAPINGS[self.shaping]()}
        if self.chain:  # sources read those before them as the start of Q, without a portfolio
            shapings |= {source.name: QInitialisation() for _, source in stages[1:]}
        learners = {name: annealed_learner(one.max_steps) for name, one in budgets.items()}
        return problem.curriculum(
            {source.name: source.task for _, source in stages},
            self._transfers(problem.task, [source for _, source in stages]),
            budgets,
            aggregate={TARGET: AGGREGATES[self.aggregate]},
            shaping=shapings,
            **({"learner": {TARGET: problem.learner, **learners}} if self.annealed else {}),
        )

    def _transfers(self, task: Any, sources: list[SourceCandidate]) -> Iterator[Transfer]:
        names = [source.name for source in sources]
        edges = list(pairwise([*names, TARGET])) if self.chain else [(n, TARGET) for n in names]
        if self.scale == "calibrated":
            return transfers_of(task, sources, edges, calibrate=Calibrate())
        return transfers_of(task, sources, edges, scale=self.scale)


def annealed_learner(steps: int) -> QLearning:
    """Return the learner of a source of so many steps, where sources are annealed."""
    return QLearning(learning_rate=linear(0.5, 0.01, steps=max(1, steps * 4 // 5)), epsilon=0.5)


# -- recipes that are the same for every target --------------------------------------------------


def half_the_size(problems: Sequence[Problem]) -> Recipe | None:
    """Return the recipe with one source of half the size, with 50 steps a state.

    A crop where all problems have one, else the members of half the size, else starts half the way
    from the goal; None where they have none of these.
    """
    member = Relation("member", changes=(("size", "0.5 n"),))
    for relation in (Relation("crop", 0.5), member, Relation("starts", 0.5)):
        try:
            for problem in problems:
                relation.source_of(problem.target)
        except CurricleError:
            continue
        return Recipe((Stage(relation, Trend(50.0)),))
    return None


CORNERS = Trend(23.5, slope=0.9, around=48.0)
STANDING = (
    # Found on random mazes of 6x6 and 8x8.
    Recipe(tuple(Stage(Relation("crop", share), CORNERS) for share in (0.35, 0.7)), annealed=True),
    # Found on hunts of up to 4,096 states.
    Recipe(
        (Stage(Relation("member", changes=(("predators", 1),)), Trend(74.7, 0.2, 470.0)),),
        aggregate="minimum",
        scale=1.5,
        annealed=True,
    ),
    # The first one for a family with a size.
    Recipe(
        tuple(
            Stage(Relation("member", changes=(("size", f"{share} n"),)), CORNERS)
            for share in (0.35, 0.7)
        ),
        annealed=True,
    ),
)
"""Recipes that earlier races found: the standing recipes of version 0.2.0."""


def standing_recipe(problem: Problem) -> Recipe | None:
    """Return the first standing recipe that has sources for a target."""
    for recipe in STANDING:
        try:
            if recipe.sources(problem):
                return recipe
        except CurricleError:
            continue
    return None
