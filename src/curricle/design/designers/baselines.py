"""What designers are compared with: no curriculum, and a random one."""

import numpy as np

from curricle.checks import whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.chain_costs import Chain, chain_curriculum
from curricle.design.designers.source_settings import DEFAULT_SOURCES, SourceSettings, check_design
from curricle.design.problem import Problem
from curricle.design.search_budget import SearchBudget
from curricle.errors import CurricleError, CurriculumError


def no_curriculum(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the curriculum without sources: the target is learnt alone. Trains nothing.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> no_curriculum(problem, source_candidates(problem.task), SearchBudget(0)).order
    ('target',)
    """
    check_design(problem, candidates, budget, seed)
    return problem.scratch


def random_chain(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    most: int = 3,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return a random chain of candidates. Trains nothing.

    Its length is drawn from 1 to `most`, its sources from all candidates without replacement. A
    candidate that cannot read the one before it is passed over, so that a chain can end up shorter.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
    seed : int
    most : int
        Sources at most.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When `most` is below 1.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> found = source_candidates(problem.task)
    >>> random_chain(problem, found, SearchBudget(0), seed=1, most=1).order
    ('starts 1..3 from the goal', 'target')
    """
    check_design(problem, candidates, budget, seed, sources)
    most = whole_number("sources of a random chain", most, 1, CurriculumError)
    rng = np.random.default_rng(seed)
    length = int(rng.integers(1, most + 1))
    names = [one.name for one in candidates]
    chain: Chain = ()
    found = problem.scratch
    for drawn in rng.permutation(len(names)):
        if len(chain) == length:
            break
        try:
            longer = (*chain, names[drawn])
            found = chain_curriculum(problem, candidates, longer, sources)
        except CurricleError:
            continue
        chain = longer
    return found
