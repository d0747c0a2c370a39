"""Chains that are chosen by the size of their sources alone."""

import math

from curricle.checks import instance, number, one_of
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.chain_costs import Chain, chain_curriculum
from curricle.design.designers.source_settings import DEFAULT_SOURCES, SourceSettings, check_design
from curricle.design.problem import Problem
from curricle.design.proposals import SourceCandidate
from curricle.design.recipe import Recipe
from curricle.design.search_budget import SearchBudget
from curricle.errors import CurricleError, CurriculumError


def relative_size(problem: Problem, candidate: SourceCandidate) -> float:
    """Return the size of a candidate over that of the target.

    The share in its relation to the target, such as that of a crop's side or of the way to the
    goal; of a candidate without one, its states over those of the target.
    """
    share = getattr(candidate.relation, "share", None)
    if share is not None:
        return float(share)
    return float(candidate.task.states.size / problem.task.states.size)


def fixed_recipe(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    recipe: Recipe | None = None,
    size: float = 0.5,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return the same recipe for every problem: one source of half the size. Trains nothing.

    Of equally near candidates the first one is taken.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
    seed : int
    recipe : Recipe, optional
        Instead of a source of that size. It has its own budgets and ways of transfer.
    size : float
        Of the source over that of the target: of the side of a crop, of the way to the goal; of
        candidates that have no such share, of the states.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When the size is not between 0 and 1, or the recipe does not fit the target.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> fixed_recipe(problem, source_candidates(problem.task), SearchBudget(0)).order
    ('rows 1..2, columns 2..3', 'target')
    """
    check_design(problem, candidates, budget, seed, sources)
    number("the size of a source", size, CurriculumError)
    if not 0 < size < 1:
        raise CurriculumError(f"the size of a source must lie between 0 and 1: got {size:g}")
    if recipe is not None:
        instance("the recipe of a design", recipe, Recipe, CurriculumError)
        return problem.curriculum(recipe)
    nearest = min(candidates, key=lambda one: abs(relative_size(problem, one) - size))
    return chain_curriculum(problem, candidates, (nearest.name,), sources)


def growing_chain(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    factor: float = 2.0,
    kind: str | None = None,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return a chain in which each source is twice the size of the one before. Trains nothing.

    Sizes are those of :func:`fixed_recipe`. From the target down, a half, a quarter and so on each
    get the candidate of the nearest ratio, if that is nearer to this size than to the next one, and
    if the source after it can read it.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
    seed : int
    factor : float
        From each source to the next; above 1.
    kind : str, optional
        Of the candidates; by default that of which there are the most different sizes.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When the factor is not above 1, or there is no candidate of this kind.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S......", *["......."] * 5, "......T"]), steps=2000)
    >>> found = source_candidates(problem.task, kinds=["crop"])
    >>> growing_chain(problem, found, SearchBudget(0)).order
    ('rows 5..6, columns 5..6', 'rows 3..6, columns 3..6', 'target')
    """
    check_design(problem, candidates, budget, seed, sources)
    if number("the factor of a growing chain", factor, CurriculumError) <= 1:
        raise CurriculumError(f"the factor of a growing chain must be above 1: got {factor:g}")
    kinds = list(dict.fromkeys(one.kind for one in candidates))
    if kind is not None:
        one_of("the kind of a growing chain", kind, kinds, CurriculumError)
    sizes = {
        each: {one.name: relative_size(problem, one) for one in candidates if one.kind == each}
        for each in ([kind] if kind is not None else kinds)
    }
    chosen = max(sizes.values(), key=lambda those: len(set(those.values())))
    return _grown(problem, candidates, chosen, factor, sources)


def _grown(
    problem: Problem,
    candidates: SourceCandidates,
    sizes: dict[str, float],
    factor: float,
    sources: SourceSettings,
) -> Curriculum:
    """Return the chain of sources that stand nearest to 1 / factor, 1 / factor^2, ..."""
    chain: Chain = ()
    found, stage = problem.scratch, 1
    # Half a stage below the smallest source nothing is near any more.
    while stage <= 0.5 - math.log(min(sizes.values()), factor):
        distance = {name: abs(math.log(size, factor) + stage) for name, size in sizes.items()}
        for name in sorted(distance, key=lambda one: distance[one]):
            if distance[name] > 0.5:
                break
            longer = (name, *chain)
            try:
                found = chain_curriculum(problem, candidates, longer, sources)
            except CurricleError:
                continue
            chain = longer
            break
        stage += 1
    return found
