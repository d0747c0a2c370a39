"""What chains of sources cost: each trained once, all over the same seeds."""

from itertools import pairwise

import numpy as np

from curricle.checks import whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.assembly import TARGET
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.source_settings import DEFAULT_SOURCES, SourceSettings
from curricle.design.problem import Problem
from curricle.design.search_budget import SearchBudget
from curricle.errors import CurricleError, CurriculumError

Chain = tuple[str, ...]
"""Names of sources, the first one first; each builds on the one before, the target on the last."""
SEEDS = 3
"""Of each training of a search, unless told otherwise."""


def chain_curriculum(
    problem: Problem, candidates: SourceCandidates, chain: Chain, sources: SourceSettings
) -> Curriculum:
    """Return the curriculum of a chain; CurricleError where a source cannot read the one before.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S...", "....", "...T"]), steps=2000)
    >>> found = source_candidates(problem.task, kinds=["crop"])
    >>> chain = tuple(one.name for one in found)
    >>> chain_curriculum(problem, found, chain, SourceSettings()).order
    ('rows 1..2, columns 2..3', 'rows 0..2, columns 1..3', 'target')
    """
    edges = list(pairwise([*chain, TARGET]))
    return sources.curriculum(problem, [candidates[name] for name in chain], edges)


class ChainCosts:
    """Mean costs of chains in a problem, measured over the same seeds.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
        Which pays for the trainings.
    seed : int
        From which those of the trainings are drawn.
    seeds : int
        K, of each training.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When there is no seed.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S...", "....", "...T"]), steps=2000)
    >>> found = source_candidates(problem.task, kinds=["crop"])
    >>> costs = ChainCosts(problem, found, SearchBudget(10**5), seed=1)
    >>> costs.of(()) == costs.lowest, costs.best
    (True, ())
    """

    def __init__(
        self,
        problem: Problem,
        candidates: SourceCandidates,
        budget: SearchBudget,
        *,
        seed: int = 0,
        seeds: int = SEEDS,
        sources: SourceSettings = DEFAULT_SOURCES,
    ) -> None:
        self.problem, self.candidates, self.budget = problem, candidates, budget
        self.sources = sources
        n = whole_number("seeds of a training of a search", seeds, 1, CurriculumError)
        first = int(np.random.default_rng(seed).integers(2**31))
        self.seeds = range(first, first + n)
        self._known = dict[Chain, float]()
        self.best: Chain = ()  # that with the lowest cost so far; none before the first training
        self.lowest = float("inf")

    def of(self, chain: Chain) -> float:
        """Return the mean cost of a chain in steps, its sources included.

        One whose sources cannot read each other counts with all steps of a training, and is not
        trained.

        Raises
        ------
        BudgetSpent
            When what is left does not pay for its training.
        """
        if chain not in self._known:
            try:
                curriculum = self.curriculum(chain)
            except CurricleError:
                self._known[chain] = float(self.problem.steps)
                return self._known[chain]
            found = self.budget.train(self.problem, curriculum, self.seeds)
            self._known[chain] = float(found.steps.mean())
            if self._known[chain] < self.lowest:
                self.best, self.lowest = chain, self._known[chain]
        return self._known[chain]

    def curriculum(self, chain: Chain) -> Curriculum:
        """Return the curriculum of a chain."""
        return chain_curriculum(self.problem, self.candidates, chain, self.sources)
