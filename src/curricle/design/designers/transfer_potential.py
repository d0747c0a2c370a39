"""Curriculum graphs by transfer potential (Svetlik et al. 2017)."""

from collections.abc import Sequence
from typing import Any

from curricle.checks import number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.source_graphs import applicable_states, source_graph
from curricle.design.designers.source_settings import SourceSettings, check_design
from curricle.design.designers.task_objects import Objects, objects_by
from curricle.design.problem import Problem
from curricle.design.proposals import SourceCandidate
from curricle.design.search_budget import SearchBudget
from curricle.errors import CurriculumError

THRESHOLD = 0.8
"""Of Silva and Costa's program for mazes. It counts states otherwise, and domains differ in it."""
SUMMED_ADVICE = SourceSettings(aggregate="total", shaping="look-ahead")
"""Potential-based advice by the sum of the sources' values, as Svetlik et al. use it."""


def transfer_potential_of(
    target: Any, source: SourceCandidate, task: SourceCandidate | None = None
) -> float:
    """Return the transfer potential of a source for a task: ``applicable / (1 + |S_t| - |S_s|)``.

    Applicable are the states of the task in which the values of the source can be read; it is 0
    where the source has more states than the task.

    Parameters
    ----------
    target : Task
        Of the design.
    source : SourceCandidate
    task : SourceCandidate, optional
        By default the target itself.

    Examples
    --------
    Of the twelve states of a maze, a crop of 2 x 2 applies in three: its fourth is the goal.

    >>> from curricle import GridWorld
    >>> from curricle.design.relations import Relation
    >>> maze = GridWorld(["S...", "....", "...T"])
    >>> transfer_potential_of(maze, Relation("crop", 0.5).source_of(maze)) == 3 / (1 + 12 - 4)
    True
    """
    states = int((target if task is None else task.task).states.size)
    if source.task.states.size > states:
        return 0.0
    return applicable_states(target, source, task) / (1 + states - int(source.task.states.size))


def svetlik(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    threshold: float = THRESHOLD,
    objects: Objects | None = None,
    sources: SourceSettings = SUMMED_ADVICE,
) -> Curriculum:
    """Return the curriculum graph of Svetlik et al. Trains nothing.

    Candidates with a transfer potential for the target above a threshold
    (:func:`transfer_potential_of`) are grouped by the classes of objects that they have. Within a
    group each is led to by the one of the highest potential among those with a lower potential for
    the target; between groups, by the best one of each group with a proper subset of its classes,
    always above the threshold. What leads to no source leads to the target. Sources enter as in the
    paper: by potential-based advice, the sum over them of the mean of their values.

    What differs: a source's values apply where its mappings say so, instead of where its objects
    lie in the same places around the agent. Where sources read each other, their values start Q:
    learning is the same as under advice, and values stay in the source's own rewards.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
    seed : int
        Nothing is random: all seeds give the same.
    threshold : float
        Of the transfer potential. The paper sets it by domain.
    objects : callable, optional
        A function of a task that returns its objects; only their classes count. By default
        :func:`objects_of`.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When the threshold is below 0.

    References
    ----------
    Svetlik, Leonetti, Sinapov, Shah, Walker, Stone 2017: Automatic curriculum graph generation for
    reinforcement learning agents (AAAI).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> found = source_candidates(problem.task, kinds=["crop", "removed", "starts"], most=4)
    >>> for edge in svetlik(problem, found, SearchBudget(0)).transfers:
    ...     print(edge.source, "->", edge.target)
    rows 0..2, columns 1..3 -> starts 1..2 from the goal
    no pit at (0, 3) -> starts 1..2 from the goal
    starts 1..2 from the goal -> target
    """
    check_design(problem, candidates, budget, seed, sources)
    number("the threshold of transfer potentials", threshold, CurriculumError, 0)

    def potential(
        source: SourceCandidate, task: SourceCandidate | None, _: Sequence[SourceCandidate]
    ) -> float:
        return transfer_potential_of(problem.task, source, task)

    def classes(one: SourceCandidate) -> frozenset[str]:
        return frozenset(kind for kind, _ in objects_by(objects, one.task, problem.task))

    kept, edges = source_graph(candidates.candidates, potential, classes, threshold)
    return sources.curriculum(problem, kept, edges)
