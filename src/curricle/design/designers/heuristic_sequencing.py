"""Heuristic Task Sequencing for Cumulative Return (Foglino et al. 2019)."""

from collections.abc import Iterator, Sequence
from itertools import permutations

from curricle.checks import whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.chain_costs import SEEDS, Chain, ChainCosts
from curricle.design.designers.source_settings import DEFAULT_SOURCES, SourceSettings, check_design
from curricle.design.problem import Problem
from curricle.design.search_budget import BudgetSpent, SearchBudget
from curricle.errors import CurriculumError


def hts_cr(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    longest: int | None = None,
    seeds: int = SEEDS,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return the best chain of Heuristic Task Sequencing for Cumulative Return (HTS-CR).

    First all ordered pairs of sources are evaluated and ranked. A source is a good head, or tail,
    if the ranks of the pairs that begin, or end, with it have a low sum. Then the best heads and
    tails are admitted in turns, one more at a time; with each, all chains of three sources and more
    are evaluated that begin with an admitted head, end with an admitted tail, and have others of
    them between. It goes on while the budget lasts, and returns the best chain so far.

    The order is that of the authors' program (github.com/francescofoglino/Curriculum-Learning). Two
    things differ. The paper maximises the return that the agent gets while it learns; here a chain
    is better if its target is learnt in fewer steps, sources included, as in every design. And
    sources hand on their values as `sources` says, for tables; the paper's are linear in features.
    As in the paper single sources are not evaluated, nor is the target alone: with fewer than two
    candidates, or a budget for no pair, that is what is returned.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
    seed : int
    longest : int, optional
        Sources in a chain at most; all candidates by default.
    seeds : int
        Of each training; the same in all of them.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When a number is out of range.

    References
    ----------
    Foglino, Coletto Christakou, Luna Gutierrez, Leonetti 2019: Curriculum learning for cumulative
    return maximization (IJCAI).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> found = source_candidates(problem.task, kinds=["crop", "removed"])
    >>> sorted(hts_cr(problem, found, SearchBudget(20_000)).order)
    ['no pit at (0, 3)', 'rows 1..2, columns 2..3', 'target']
    """
    check_design(problem, candidates, budget, seed, sources)
    n = len(candidates) if longest is None else longest
    n = whole_number(
        "the longest chain of a search", n, 1 if longest is None else 2, CurriculumError
    )
    costs = ChainCosts(problem, candidates, budget, seed=seed, seeds=seeds, sources=sources)
    names = [one.name for one in candidates]
    try:
        pairs = sorted(permutations(names, 2), key=costs.of)  # evaluated in this order; stable
        heads, tails = (_ranked(names, [pair[end] for pair in pairs]) for end in (0, 1))
        for chain in _extended(names, heads, tails, n):
            costs.of(chain)
    except BudgetSpent:
        pass
    return costs.curriculum(costs.best)


def _ranked(names: Sequence[str], ends: Sequence[str]) -> list[str]:
    """Return names by the sum of their ranks among the ends of pairs, the best pair first."""
    scores = dict.fromkeys(names, 0)
    for rank, name in enumerate(ends, 1):
        scores[name] += rank
    return sorted(names, key=lambda name: scores[name])


def _extended(
    names: Sequence[str], heads: Sequence[str], tails: Sequence[str], longest: int
) -> Iterator[Chain]:
    """Yield chains of three sources and more, head and tail admitted in turns; some repeatedly."""
    for turn in range(1, 2 * len(names) - 1):
        first, last = heads[: 1 + (turn + 1) // 2], tails[: 1 + turn // 2]
        for length in range(3, longest + 1):
            for head in first:
                for tail in last:
                    if head != tail:
                        admitted = {*first, *last} - {head, tail}
                        between = [name for name in names if name in admitted]
                        for body in permutations(between, length - 2):
                            yield (head, *body, tail)
