"""The recipes that race: what sources a target may have, and how their numbers may differ."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from curricle.design.makers import MAKERS
from curricle.design.problem import Problem
from curricle.design.proposals import design_target
from curricle.design.recipe import AGGREGATES, SHAPINGS, Recipe, Stage
from curricle.design.relations import Relation, relation_of
from curricle.design.standing import learns_slowly
from curricle.design.trends import Trend
from curricle.errors import CurricleError
from curricle.tasks.families.family import FamilyMember, Parameter
from curricle.tasks.task import has_tables

SHARES = (0.5, 0.7, 0.3)
"""Of a target, for one source."""
CHAINS = ((0.35, 0.7), (0.25, 0.5), (0.3, 0.5, 0.8), (0.2, 0.4, 0.6, 0.8))
"""The same for sources that build on each other."""
NUMBERS = (
    (30.0, 1.0, True),
    (100.0, 2.0, False),
    (100.0, 1.5, True),
    (30.0, 1.0, False),
    (300.0, 2.0, True),
    (100.0, 1.0, False),
    (10.0, 1.0, False),
    (30.0, 3.0, False),
)
"""Steps a state, scales, and whether sources are annealed, with which sources race first.

The first one stays where races cannot tell it from others, which is common on miniatures. Where a
learner has a low learning rate (:func:`learns_slowly`), values of annealed sources are better the
larger the tasks are. Other learners are as good teachers in fewer steps: then the same numbers race
in the order of :data:`OF_FAST_LEARNERS`.
"""
OF_FAST_LEARNERS = (*NUMBERS[3::-1], *NUMBERS[4:])
FEW = 4
"""Below it a parameter of a target is a count, of which sources have one less, or one."""
BY_SHARE = ("crop", "starts")
"""Kinds of which a source is any part of the target."""
FACTORS = (1 / 3, 3.0)
"""By which steps and scales differ from those of the leader."""


def first_arms(problems: Sequence[Problem]) -> dict[str, Recipe]:
    """Return recipes by name for a first race, so that the first few differ the most.

    Every source and chain of sources with several steps a state, scales and learners, and with the
    minimum beside the mean where a target reads several potentials.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> arms = first_arms([Problem(GridWorld(["S...", "....", "...T"]), steps=5000)])
    >>> next(iter(arms))
    'crop 0.5: 30 steps a state; annealed sources; scale 1; initialise'
    """
    single = relations(problems)
    alone = [one for one in single if len(one.changes) < 2]
    plans: list[tuple[Relation, ...]] = [*((one,) for one in alone), *_chains(problems, alone)]
    plans += [(one,) for one in single if len(one.changes) > 1]
    found = dict[str, Recipe]()
    several = {plan for plan in plans if _several(problems[0], plan)}
    numbers = NUMBERS if learns_slowly(problems[0].learner) else OF_FAST_LEARNERS
    for steps, scale, annealed in numbers:
        for aggregate in ("minimum", "mean") if several else ("mean",):
            for plan in plans:
                if aggregate == "mean" or plan in several:
                    stages = [Stage(one, steps) for one in plan]
                    recipe = Recipe(stages, True, aggregate, scale, annealed=annealed)
                    found[name_of(recipe)] = recipe
    return found


def name_of(recipe: Recipe) -> str:
    """Return a recipe in one line."""
    return str(recipe).replace("\n", "; ")


def relations(problems: Sequence[Problem]) -> list[Relation]:
    """Return what sources some problems may have; those of kinds but members as the first has."""
    target, found = problems[0].target, list[Relation]()
    if has_tables(problems[0].task):
        made = design_target(target)
        for kind, maker in MAKERS.items():
            drafts = [] if kind in ("member", "bottleneck") else list(maker(made))
            if kind in BY_SHARE and drafts:
                found += [Relation(kind, share) for share in SHARES]
            elif drafts:
                known = (relation_of(draft) for draft in drafts)
                found += [one for one in known if one is not None]
    members = [one.target for one in problems if isinstance(one.target, FamilyMember)]
    if len(members) == len(problems):
        found += [Relation("member", changes=one) for one in _changes(members)]
    return found


def _changes(members: Sequence[FamilyMember]) -> Iterator[dict[str, Any]]:
    """Yield changes of parameters that make members easier: of each alone, and of two.

    Terms suit the hardest value that any of them has.
    """
    single = []
    for one in members[0].family.parameters:
        values = [member[one.name] for member in members]
        hardest = max(values, key=lambda value: one.difficulty(value) or 0.0)
        single += [{one.name: term} for term in _terms(one, hardest)]
    yield from single
    for first, other in product(single, single):
        names = (*first, *other)
        if names == tuple(sorted(set(names))):
            yield {**first, **other}


def _terms(parameter: Parameter, value: Any) -> list[Any]:
    """Return terms for easier values of a parameter that is ordered."""
    easier = parameter.easier_than(value)
    if parameter.difficulty(value) is None or value is None:
        return []
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and parameter.harder == "larger" and parameter.values is None:
        if isinstance(value, float):
            return ["0.5 n", 0.0] if value > 0 else []
        if value >= FEW:
            return [f"{share} n" for share in SHARES]
        return [easier[0], *(["n - 1"] if value - 1 in easier else [])] if easier else []
    return list(easier[-1:])


def _chains(
    problems: Sequence[Problem], known: Sequence[Relation]
) -> Iterator[tuple[Relation, ...]]:
    """Yield chains of growing parts, and of members of growing size."""
    for kind in BY_SHARE:
        if any(one.kind == kind for one in known):
            yield from (tuple(Relation(kind, share) for share in chain) for chain in CHAINS)
    grows = [
        name
        for one in known
        if len(one.changes) == 1
        for name, term in one.changes
        if term == f"{SHARES[0]} n" and all(isinstance(one.target[name], int) for one in problems)
    ]
    for name in grows:
        for chain in CHAINS:
            yield tuple(Relation("member", changes={name: f"{share} n"}) for share in chain)


def _several(problem: Problem, plan: Sequence[Relation]) -> bool:
    """Return whether the target reads several potentials of the last source."""
    try:
        return len(plan[-1].source_of(problem.target).mappings) > 1
    except CurricleError:
        return False


def variations(recipe: Recipe, *, several: bool) -> dict[str, Recipe]:
    """Return the recipes that differ from one in one setting, by name.

    Parameters
    ----------
    recipe : Recipe
    several : bool
        Whether the target reads several potentials, so that the aggregate matters.
    """
    found = [replace(recipe, annealed=not recipe.annealed)]
    found += [with_steps(recipe, factor) for factor in FACTORS]
    if isinstance(recipe.scale, Trend):
        levels = [recipe.scale.level * factor for factor in (0.5, 1.5, 2.0, *FACTORS)]
        found += [replace(recipe, scale=Trend.constant(level)) for level in levels]
    found.append(replace(recipe, scale="calibrated" if recipe.scale != "calibrated" else 1.0))
    found += [replace(recipe, shaping=one) for one in SHAPINGS if one != recipe.shaping]
    found.append(replace(recipe, stages=[replace(one, settled=True) for one in recipe.stages]))
    if several:
        found += [replace(recipe, aggregate=one) for one in AGGREGATES if one != recipe.aggregate]
    if len(recipe.stages) > 1:
        found.append(replace(recipe, chain=not recipe.chain))
        found += [replace(recipe, stages=recipe.stages[1:])]
    return {name_of(one): one for one in found}


def with_steps(recipe: Recipe, factor: float) -> Recipe:
    """Return a recipe with its steps a state multiplied by a factor."""
    stages = [
        replace(one, steps=replace(one.steps, level=one.steps.level * factor))
        for one in recipe.stages
    ]
    return replace(recipe, stages=stages)
