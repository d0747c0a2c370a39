"""Who plays: designers that search on the target, and such as search on other maps.

A designer of curricula is ``designer(problem, candidates, budget, seed=...) -> Curriculum``; it
searches on the target itself. A designer of recipes is ``designer(problems, budget, seed=...) ->
Recipe``; it searches on the maps of development, and its recipe is applied to the target.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from benchmarks.referee.designers import DESIGNERS
from benchmarks.referee.problem import Problem, SearchBudget
from benchmarks.referee.racing import design_recipe
from benchmarks.referee.recipes import Recipe, half_the_size, standing_recipe
from curricle.curriculum.curriculum import Curriculum
from curricle.design import SourceCandidates

SCRATCH, FIXED, RACING = "none", ("fixed_recipe", "growing_chain", "half_size"), "race"
"""Learning alone; recipes that are the same for every target, without a search; racing."""


class Player(NamedTuple):
    """A designer."""

    name: str
    design: Callable[..., Any]
    on_target: bool = True
    """Whether it searches on the target; else on other maps, for a recipe."""


def half_size(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return one source of half the size, 50 steps a state: the recipe that racing begins with."""
    return (half_the_size([problem]) or Recipe()).curriculum(problem)


def standing(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the standing recipe for such a target; where there is none, no curriculum.

    Earlier races found it, on other mazes, and on hunts of which one is judged here: it is no
    recipe that a verdict on racing can rest on.
    """
    return (standing_recipe(problem) or Recipe()).curriculum(problem)


def race(problems: Sequence[Problem], budget: SearchBudget, *, seed: int = 0) -> Recipe:
    """Return the recipe that races on the maps of development find; none if none pays there."""
    return design_recipe(problems, budget, seed=seed)


def race_on_target(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the curriculum that the same races find on the target itself."""
    return design_recipe([problem], budget, seed=seed).curriculum(problem)


PLAYERS = {
    **{name: Player(name, design) for name, design in DESIGNERS.items()},
    "half_size": Player("half_size", half_size),
    "standing": Player("standing", standing),
    "race_on_target": Player("race_on_target", race_on_target),
    RACING: Player(RACING, race, on_target=False),
}
"""Name -> player."""
