"""Forward search: from no source on, one source more at a time, by measured costs."""

from collections.abc import Iterator, Sequence

from curricle.checks import whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.chain_costs import SEEDS, Chain, ChainCosts
from curricle.design.designers.source_settings import DEFAULT_SOURCES, SourceSettings, check_design
from curricle.design.problem import Problem
from curricle.design.search_budget import BudgetSpent, SearchBudget
from curricle.errors import CurriculumError


def greedy_forward(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    seeds: int = SEEDS,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return the chain to which no single source can be added at a lower measured cost.

    It begins with the target alone. Each step trains every chain that has one source more, at any
    place, and goes on with the cheapest; it stops where none is cheaper than before. It is
    :func:`beam` of width 1.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
        Where it ends, the cheapest chain so far is returned: without any training, that of none.
    seed : int
    seeds : int
        Of each training; the same in all of them.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When there is no seed.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> budget = SearchBudget(30_000)
    >>> found = greedy_forward(problem, source_candidates(problem.task), budget)
    >>> found.order[-1], budget.ledger.cost <= 30_000
    ('target', True)
    """
    return beam(problem, candidates, budget, seed=seed, width=1, seeds=seeds, sources=sources)


def beam(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    width: int = 3,
    seeds: int = SEEDS,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return the cheapest chain of a beam search by measured costs.

    As :func:`greedy_forward`, but each step goes on with the `width` cheapest chains of it, and
    stops where none of them is cheaper than the cheapest of the step before.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
        As in :func:`greedy_forward`.
    seed : int
    width : int
        Chains of each step that are grown.
    seeds : int
        Of each training; the same in all of them.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When the width or the number of seeds is below 1.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> beam(problem, source_candidates(problem.task), SearchBudget(0), width=2).order
    ('target',)
    """
    check_design(problem, candidates, budget, seed, sources)
    width = whole_number("the width of a beam", width, 1, CurriculumError)
    costs = ChainCosts(problem, candidates, budget, seed=seed, seeds=seeds, sources=sources)
    names = [one.name for one in candidates]
    kept: list[Chain] = [()]
    try:
        before = costs.of(())
        while grown := list(
            dict.fromkeys(longer for one in kept for longer in _longer(one, names))
        ):
            kept = sorted(grown, key=costs.of)[:width]  # stable: of equal costs the first
            if costs.of(kept[0]) >= before:
                break
            before = costs.of(kept[0])
    except BudgetSpent:
        pass
    return costs.curriculum(costs.best)


def _longer(chain: Chain, names: Sequence[str]) -> Iterator[Chain]:
    """Yield the chains with one source more, at any place, the first place first."""
    for name in names:
        if name not in chain:
            for place in range(len(chain) + 1):
                yield (*chain[:place], name, *chain[place:])
