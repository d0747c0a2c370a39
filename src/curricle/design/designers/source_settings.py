"""How the sources of a design are trained, and how their values enter learning."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from curricle.checks import instance, number, one_of, whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.assembly import TARGET, transfers_of
from curricle.design.candidates import SourceCandidates
from curricle.design.problem import Problem
from curricle.design.proposals import SourceCandidate
from curricle.design.recipe import AGGREGATES, SHAPINGS
from curricle.design.search_budget import SearchBudget
from curricle.errors import CurriculumError
from curricle.frozen_arrays import Frozen
from curricle.learning.shaping import QInitialisation
from curricle.learning.stopping import SETTLED, StoppingRule
from curricle.tasks.task import same_task
from curricle.transfer.edges import Transfer

Edge = tuple[str, str]
"""Names of a source and of what reads it: another source, or the target."""


@dataclass(frozen=True)
class SourceSettings(Frozen):
    """What a designer's sources have in common.

    Parameters
    ----------
    steps_per_state : float
        Steps of a source at most, over the number of its states.
    share : float
        Of the steps of a training of the problem, which all sources of a curriculum together take
        at most, each an equal part of it.
    settled : bool
        Whether a source ends before where its return has settled; else it takes all of them.
    aggregate : {"mean", "minimum", "maximum", "total"}
        Of what a task reads, where that is several potentials. A total is over sources: one that is
        read by m mappings enters by 1/m of each, which is their mean where all of them apply.
    shaping : {"initialise", "guarded", "look-ahead", "state"}
        How they enter the target, as in :class:`Recipe`; sources start Q at them.

    Raises
    ------
    CurriculumError
        When a number is out of range, or a word unknown.

    Examples
    --------
    >>> print(SourceSettings().budget(states=100, sources=2, steps=20_000))
    5,000 steps, until the return has settled
    >>> print(SourceSettings(settled=False).budget(states=10, sources=2, steps=20_000))
    600 steps
    """

    steps_per_state: float = 60.0
    share: float = 0.5
    settled: bool = True
    aggregate: str = "mean"
    shaping: str = "initialise"

    def __post_init__(self) -> None:
        steps = number("steps per state of a source", self.steps_per_state, CurriculumError)
        if steps <= 0:
            raise CurriculumError(f"steps per state of a source must be above 0: got {steps:g}")
        share = number("the share of a training's steps for sources", self.share, CurriculumError)
        if not 0 < share < 1:
            raise CurriculumError(
                f"the share of a training's steps for sources must lie between 0 and 1: got {share}"
            )
        instance("settled of sources", self.settled, bool, CurriculumError)
        one_of("the aggregate of sources", self.aggregate, AGGREGATES, CurriculumError)
        one_of("the shaping by sources", self.shaping, SHAPINGS, CurriculumError)

    def budget(self, states: int, sources: int, steps: int) -> StoppingRule:
        """Return the budget of one of so many sources, of so many states.

        Parameters
        ----------
        states, sources : int
        steps : int
            Of a training of the problem.
        """
        most = min(self.steps_per_state * states, self.share * steps / sources)
        return StoppingRule(max(1, int(most)), settled=SETTLED if self.settled else None)

    def curriculum(
        self, problem: Problem, sources: Sequence[SourceCandidate], edges: Iterable[Edge]
    ) -> Curriculum:
        """Return the curriculum of a problem with these sources and edges.

        Raises
        ------
        CurricleError
            When a source cannot read another one that leads to it.
        """
        if not sources:
            return problem.scratch
        transfers = list(self._transfers(problem.task, sources, list(edges)))
        reading = {one.target for one in transfers} - {TARGET}
        given = problem.settings
        budgets = {
            one.name: self.budget(one.task.states.size, len(sources), problem.steps)
            for one in sources
        }
        return Curriculum(
            {**{one.name: one.task for one in sources}, TARGET: problem.task},
            transfers,
            aggregate=AGGREGATES[self.aggregate],
            shaping={
                TARGET: SHAPINGS[self.shaping](),
                **{one.name: QInitialisation() for one in sources if one.name in reading},
            },
            budget={TARGET: given["budget"], **budgets},
            learner=given["learner"],
            evaluation=given["evaluation"],
            eval_freq={TARGET: given["eval_freq"]},
        )

    def _transfers(
        self, task: Any, sources: Sequence[SourceCandidate], edges: list[Edge]
    ) -> Iterator[Transfer]:
        for edge in edges:
            found = list(transfers_of(task, sources, [edge]))
            scale = 1 / len(found) if self.aggregate == "total" else 1.0
            yield from (replace(one, scale=scale) for one in found)


DEFAULT_SOURCES = SourceSettings()
"""Of a designer that is told nothing else."""


def check_design(
    problem: Any, candidates: Any, budget: Any, seed: Any, sources: Any = None
) -> None:
    """Raise CurriculumError unless these are what every designer takes."""
    instance("the problem of a design", problem, Problem, CurriculumError)
    instance("the candidates of a design", candidates, SourceCandidates, CurriculumError)
    instance("the budget of a design", budget, SearchBudget, CurriculumError)
    whole_number("the seed of a design", seed, 0, CurriculumError)
    if sources is not None:
        instance("sources of a design", sources, SourceSettings, CurriculumError)
    if not same_task(candidates.target, problem.task):
        raise CurriculumError(
            f"candidates must be for the target of the problem: those for {problem.name} are for "
            "another task"
        )
