"""Who plays: designers that search on the target, and such as search on other maps.

A designer of curricula is ``designer(problem, candidates, budget, seed=...) -> Curriculum``; it
searches on the target itself. A designer of recipes is ``designer(problems, budget, seed=...) ->
Recipe``; it searches on the maps of development, and its recipe is applied to the target.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from curricle.curriculum.curriculum import Curriculum
from curricle.design import (
    Problem,
    Recipe,
    Relation,
    SearchBudget,
    SourceCandidates,
    Stage,
    design_recipe,
)

SCRATCH, FIXED, RACING = "none", ("fixed_recipe", "growing_chain"), "race"
"""Learning alone; recipes that are the same for every target, without a search; racing."""


class Player(NamedTuple):
    """A designer."""

    name: str
    design: Callable[..., Any]
    on_target: bool = True
    """Whether it searches on the target; else on other maps, for a recipe."""


def none(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the target alone."""
    return problem.scratch


def fixed_recipe(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return a corner of half the size first, 30 steps a state."""
    recipe = Recipe([Stage(Relation("crop", 0.5), 30)])
    return recipe.curriculum(problem.target, **problem.settings)


def race(problems: Sequence[Problem], budget: SearchBudget, *, seed: int = 0) -> Recipe:
    """Return the recipe that races on the maps of development find; none if none pays there."""
    return design_recipe(problems, budget, seed=seed).recipe


def race_on_target(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the curriculum that the same races find on the target itself."""
    return problem.curriculum(design_recipe([problem], budget, seed=seed).recipe)


PLAYERS = {
    one.name: one
    for one in (
        Player(SCRATCH, none),
        Player(FIXED[0], fixed_recipe),
        Player("race_on_target", race_on_target),
        Player(RACING, race, on_target=False),
    )
}
"""Name -> player, those that all are judged against first."""
