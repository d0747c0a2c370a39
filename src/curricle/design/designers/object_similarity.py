"""Curricula of tasks with fewer objects (Silva and Costa 2018)."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from curricle.checks import number, whole_number
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import SourceCandidates
from curricle.design.designers.source_graphs import applicable_states, source_graph
from curricle.design.designers.source_settings import DEFAULT_SOURCES, SourceSettings, check_design
from curricle.design.designers.task_objects import Object, Objects, objects_by
from curricle.design.problem import Problem
from curricle.design.proposals import SourceCandidate
from curricle.design.search_budget import SearchBudget
from curricle.errors import CurriculumError

REPETITIONS, THRESHOLD = 10, 2.0
"""Of the authors' program, where source tasks are generated."""

TaskObjects = dict[str | None, frozenset[Object]]
"""Of each candidate by its name, and of the target under None."""


def object_oriented(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    repetitions: int = REPETITIONS,
    threshold: float = THRESHOLD,
    objects: Objects | None = None,
    sources: SourceSettings = DEFAULT_SOURCES,
) -> Curriculum:
    """Return the object-oriented curriculum of Silva and Costa. Trains nothing.

    Source tasks are drawn at random: a number of objects of each class, up to that of the target,
    and a size. Of those drawn a graph is made as :func:`svetlik` makes it, grouped by the number of
    objects of each class, with another transfer potential:
    ``sim(s, t) / (sim_max |S_s| (n_s + 1) / (|S_t| (n_t + 1)))``, n the number of objects. sim is
    the sum over classes of the share of objects that both have, and the share of the states of t
    that s has; sim_max is the largest similarity of s to a task that was taken before, for the same
    task. Small sources with few, but the same objects come first, and such as are no repetition.

    This follows the authors' program (github.com/f-leno/Curriculum_HFO). What differs: the program
    places the objects that it draws in a new task; here the candidate with the nearest number of
    objects, then of states, is taken, classes of which all have as many left out. Every object
    counts, where the program leaves out agent and treasure. States in common are those that the
    mapping of the source maps; and values pass through it, their mean as the start of Q, where the
    paper averages over all mappings between objects of the same class.

    Parameters
    ----------
    problem : Problem
    candidates : SourceCandidates
    budget : SearchBudget
    seed : int
        Of the draws.
    repetitions : int
        Of the draws; each draws a task for every least number of objects of the rarest class.
    threshold : float
        Of the transfer potential.
    objects : callable, optional
        A function of a task that returns its objects; by default :func:`objects_of`.
    sources : SourceSettings

    Raises
    ------
    CurriculumError
        When there is no repetition, or the threshold is below 0.

    References
    ----------
    Silva, Costa 2018: Object-oriented curriculum generation for reinforcement learning (AAMAS).

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> problem = Problem(GridWorld(["S..P", "....", "...T"]), steps=2000)
    >>> found = source_candidates(problem.task, kinds=["crop", "removed"])
    >>> object_oriented(problem, found, SearchBudget(0), seed=1).order
    ('rows 1..2, columns 2..3', 'no pit at (0, 3)', 'target')
    """
    check_design(problem, candidates, budget, seed, sources)
    repetitions = whole_number("repetitions of the draws", repetitions, 1, CurriculumError)
    number("the threshold of transfer potentials", threshold, CurriculumError, 0)
    tasks: dict[str | None, Any] = {one.name: one.task for one in candidates}
    tasks[None] = problem.task
    has: TaskObjects = {
        name: objects_by(objects, task, problem.task) for name, task in tasks.items()
    }
    drawn = _drawn(candidates.candidates, has, repetitions, np.random.default_rng(seed))

    def potential(
        source: SourceCandidate, task: SourceCandidate | None, others: Sequence[SourceCandidate]
    ) -> float:
        name = None if task is None else task.name
        closest = max((_similarity(problem, has, source, one) for one in others), default=0.0)
        small = source.task.states.size * (len(has[source.name]) + 1)
        large = tasks[name].states.size * (len(has[name]) + 1)
        return _similarity(problem, has, source, task) * float(large / ((closest or 1.0) * small))

    def counts(one: SourceCandidate) -> frozenset[tuple[str, int]]:
        found = Counter(kind for kind, _ in has[one.name])
        return frozenset((kind, i) for kind, n in found.items() for i in range(n))

    kept, edges = source_graph(drawn, potential, counts, threshold)
    return sources.curriculum(problem, kept, edges)


def _similarity(
    problem: Problem, has: TaskObjects, source: SourceCandidate, task: SourceCandidate | None
) -> float:
    """Return the share of common objects, summed over classes, and the share of common states."""
    own, other = has[source.name], has[None if task is None else task.name]
    counts, others, both = (
        Counter(kind for kind, _ in those) for those in (own, other, own & other)
    )
    states = int((problem.task if task is None else task.task).states.size)
    # In an order that no hash decides, as sums depend on it.
    found = sum(both[kind] / max(counts[kind], others[kind]) for kind in sorted(counts))
    return found + applicable_states(problem.task, source, task) / states


def _drawn(
    candidates: Sequence[SourceCandidate],
    has: TaskObjects,
    repetitions: int,
    rng: np.random.Generator,
) -> list[SourceCandidate]:
    """Return the candidates nearest to random numbers of objects and of states, each once."""
    counts = {name: Counter(kind for kind, _ in those) for name, those in has.items()}
    target = counts[None]
    classes = [kind for kind in sorted(target) if len({each[kind] for each in counts.values()}) > 1]
    rarest = min(classes, key=lambda kind: target[kind], default=None)
    sizes = sorted({one.task.states.size for one in candidates})
    found: dict[str, SourceCandidate] = {}
    for _ in range(repetitions):
        for least in range(1 + (0 if rarest is None else target[rarest])):
            wanted = {
                kind: int(rng.integers(least if kind == rarest else 0, target[kind] + 1))
                for kind in classes
            }
            size = int(rng.choice(sizes))

            def distance(
                one: SourceCandidate, wanted: dict[str, int] = wanted, size: int = size
            ) -> tuple[int, int]:
                apart = sum(abs(counts[one.name][kind] - n) for kind, n in wanted.items())
                return apart, abs(one.task.states.size - size)

            nearest = min(candidates, key=distance)
            found[nearest.name] = nearest
    return list(found.values())
