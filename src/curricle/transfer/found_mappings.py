"""Mappings between two tasks that searches find, scored and ranked."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from curricle.checks import brief, whole_number
from curricle.display import block, brief_repr, printed, shortened, table
from curricle.errors import MappingError, SettingError, TaskError
from curricle.progress import SILENT, Bars, Progress, check_progress, shown
from curricle.tasks.task import Task, same_task
from curricle.text_tables import counted
from curricle.transfer.common_part import by_common_part
from curricle.transfer.component_mapping import ComponentMapping
from curricle.transfer.component_search import by_alignment, by_name
from curricle.transfer.component_warping import by_component_warping
from curricle.transfer.homomorphisms import by_homomorphism
from curricle.transfer.mapping import StateActionMapping, check_unmapped_value
from curricle.transfer.mapping_scores import MappingScores, score_mapping
from curricle.transfer.nearest_pairs import by_lax_bisimulation
from curricle.transfer.proposal import NOT_PROVEN, Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair
from curricle.transfer.unmapped_values import fitted_unmapped_value

Search = Callable[[TaskPair], Iterable[Proposal]]
"""A search for mappings; it raises MappingError where it does not apply."""

SEARCHES: tuple[Search, ...] = (
    by_name,
    by_alignment,
    by_homomorphism,
    by_component_warping,
    by_common_part,
    by_lax_bisimulation,
)
LEAST_REGAINED = 0.25
"""Share of the way to the optimum that a mapping used unseen must regain where it is known."""
MOST_UNEXPLAINED = 0.75
"""Share that such a mapping may leave unexplained."""
MOST_MISSED = 0.05
"""Share of the way to the optimum that a mapping as good as exact may miss where it is known."""
LEFT_BY_EXACT = 0.01
"""Share that such a mapping may leave unexplained: flat values of many pairs are explained well."""
SAME = 1e-7
"""Two mappings are one if phi differs by less, in units of the largest."""


@dataclass(frozen=True, eq=False)
class FoundMapping:
    """A mapping that was found.

    Attributes
    ----------
    mapping : StateActionMapping
    how : str
        How it was found.
    scores : MappingScores
    bound : float
        Proven: the Q* of no mapped pair is further than this from the Q* of the source pair that it
        reads, in return units; NaN where nothing is proven.
    unmapped_value : float, optional
        What fits where it maps nothing (:func:`fitted_unmapped_value`); the mapping has it if the
        curriculum finds the mapping.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld("S.T")
    >>> found = find_mappings(maze, maze)[0]
    >>> found.how, found.scores.regained
    ('components by name', 1.0)
    """

    mapping: StateActionMapping
    how: str
    scores: MappingScores
    bound: float = NOT_PROVEN
    unmapped_value: float | None = None

    __repr__ = brief_repr
    _repr_html_ = printed

    def __str__(self) -> str:
        proven = "" if np.isnan(self.bound) else f", Q* proven within {self.bound:.3g}"
        fits = "" if self.unmapped_value is None else f", {self.unmapped_value:.3g} fits elsewhere"
        return f"{self.how}: {self.scores}{proven}{fits}"


@dataclass(frozen=True, eq=False, repr=False)
class FoundMappings:
    """The mappings that were found, best first, and what the other searches said.

    Attributes
    ----------
    candidates : tuple of FoundMapping
    refused : dict of str to str
        Name of each search that found nothing -> why.
    steps : int
        Steps taken in tasks without tables; a curriculum charges them to whoever reads a mapping.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld("S.T")
    >>> len(find_mappings(maze, maze)) > 0
    True
    """

    candidates: tuple[FoundMapping, ...]
    refused: dict[str, str]
    steps: int = 0

    def __getitem__(self, which: Any) -> Any:
        return self.candidates[which]

    def __iter__(self) -> Iterator[FoundMapping]:
        return iter(self.candidates)

    def __len__(self) -> int:
        return len(self.candidates)

    def __str__(self) -> str:
        lines = [f"{i + 1}. {one}" for i, one in enumerate(self.candidates)]
        return "\n".join([*lines, *(f"{name}: {why}" for name, why in self.refused.items())])

    def __repr__(self) -> str:
        best = self.candidates[0].how if self.candidates else "none"
        return shortened(f"FoundMappings({counted(len(self), 'mapping')}, the best: {best})")

    def _repr_html_(self) -> str:
        head = ["mapping", "coverage", "regained", "dynamics error", "Bellman inconsistency"]
        rows = [
            (
                one.how,
                f"{one.scores.coverage:.0%}",
                f"{one.scores.regained:.0%}",
                one.scores.dynamics_error,
                one.scores.bellman_inconsistency,
            )
            for one in self.candidates
        ]
        refused = [f"{name}: {why}" for name, why in self.refused.items()]
        return block("Mappings found, best first", table(head, rows, wide=head[:1]), *refused)


def find_mappings(
    target: Task,
    source: Task,
    *,
    searches: Sequence[Search] = SEARCHES,
    keep: int = 8,
    seed: int = 0,
    unmapped_value: float | None = None,
    samples: int | None = None,
    progress: Progress = None,
) -> FoundMappings:
    """Return mappings between two tasks, best first.

    Candidates of all searches are scored by one measure (:func:`score_mapping`), from the tables of
    both tasks and their exact values; no step is taken in either, unless `samples` asks for it.
    Those that clear the bar of :func:`auto_mapping` come first, and of these the ones that are as
    good as exact where they know anything and have a value that fits elsewhere, as a learner has to
    unlearn wrong values, but not missing ones. Then they are ordered by their worth, which is what
    the greedy policy of the source's values regains of the optimum, times the share of the target
    that the values explain; by the dynamics error; and by the Bellman inconsistency. Of candidates
    through which the source's values are read alike, the first search's is kept.

    Parameters
    ----------
    target, source : Task
    searches : sequence of callable
        Each takes a :class:`TaskPair` and yields a :class:`Proposal` for each mapping.
    keep : int
        Most candidates to return.
    seed : int
        Of samples of pairs.
    unmapped_value : float, optional
        Of the mappings.
    samples : int, optional
        Steps of the random policy to take in each task that has no tables, to estimate them: for
        live tasks. Scores are then of the estimated tables, over the states in which every action
        was tried; nothing is proven. Mappings carry the steps, which a curriculum charges.
    progress : bool or callable, optional
        True shows a bar of the searches, a function is called with the name of each that has ended.

    Raises
    ------
    SettingError
        When `keep` is less than 1, `seed` is negative, no search is given or one is no function, or
        a search yields anything but a :class:`Proposal` for these tasks, or `progress` is none of
        these.
    TaskError
        When a task has no tables and `samples` is not given.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> for one in find_mappings(hunt, chase, searches=[by_assignment])[:2]:
    ...     print(one.how)
    components by assignment: predator is predator_1, prey by name
    components by assignment: predator is predator_2, prey by name
    """
    whole_number("keep", keep, 1, SettingError)
    whole_number("seed", seed, 0, SettingError)
    check_unmapped_value(unmapped_value)
    check_searches(searches)
    check_progress(progress)
    tasks = TaskPair(target, source, samples, seed)
    if not tasks.judged.any():
        raise TaskError(f"no state was met in which every action was tried, in {tasks.steps} steps")
    refused: dict[str, str] = {}
    with shown(progress) as bars:
        proposed = proposals(tasks, searches, unmapped_value, refused, bars)
        found = [
            FoundMapping(
                one.mapping,
                one.how,
                score_mapping(one.mapping, seed=seed, tasks=tasks),
                one.bound,
                fitted_unmapped_value(one.mapping, tasks=tasks),
            )
            for one in different(proposed, tasks)
        ]
    return FoundMappings(tuple(sorted(found, key=rank)[:keep]), refused, tasks.steps)


def proposals(
    tasks: TaskPair,
    searches: Sequence[Search],
    unmapped_value: float | None,
    refused: dict[str, str],
    bars: Bars = SILENT,
) -> Iterator[Proposal]:
    """Yield what the searches propose; the reasons of those that do not apply go to `refused`."""
    grow = bars.bar("searches", len(searches))
    for search in searches:
        name = getattr(search, "__name__", repr(search))
        try:
            for one in search(tasks):
                _check_proposal(name, one, tasks)
                mapping = one.mapping
                if unmapped_value is not None:
                    mapping = replace_unmapped_value(mapping, unmapped_value)
                if tasks.steps:
                    yield Proposal(charged(mapping, one.how, tasks.steps), one.how)
                else:
                    yield one._replace(mapping=mapping)
        except MappingError as error:
            refused[name] = str(error)
        grow()
        bars.tell(name)


def check_searches(searches: Any) -> None:
    """Raise SettingError unless these are functions, at least one.

    Examples
    --------
    >>> check_searches("by_name")
    Traceback (most recent call last):
    curricle.errors.SettingError: searches must be a list of functions: got 'by_name'
    """
    if not isinstance(searches, Sequence) or not all(map(callable, searches)):
        raise SettingError(f"searches must be a list of functions: got {brief(searches)}")
    if not searches:
        raise SettingError("find_mappings needs at least one search: got none")


def _check_proposal(search: str, given: Any, tasks: TaskPair) -> None:
    """Raise SettingError unless a search yielded a proposal for these tasks."""
    if not isinstance(given, Proposal):
        raise SettingError(f"a search must yield a Proposal: {search} yielded {brief(given)}")
    for role in ("target", "source"):
        task = getattr(given.mapping, role)
        if not same_task(task, getattr(tasks, role)):
            raise SettingError(
                f"a search must propose mappings of the tasks that it is given: {search} proposed "
                f"the {role} {brief(task)}"
            )


def charged(mapping: StateActionMapping, how: str, steps: int) -> SearchedMapping:
    """Return a mapping with the steps that its search took."""
    if isinstance(mapping, SearchedMapping):
        return replace(mapping, steps=steps)
    parts = mapping.target, mapping.source, mapping.index, mapping.unmapped_value
    return SearchedMapping(*parts, how=how, steps=steps)


def replace_unmapped_value(mapping: StateActionMapping, value: float) -> StateActionMapping:
    """Return the same mapping with another value of unmapped pairs."""
    if isinstance(mapping, ComponentMapping):
        parts = mapping.target, mapping.source, mapping.renaming
        return ComponentMapping(*parts, value, mapping.unequal)
    return replace(mapping, unmapped_value=value)


def different(given: Iterable[Proposal], tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the proposals that read the source's values in different ways, the first of each."""
    q = tasks.source_solution.action_values
    slack = SAME * max(1.0, float(abs(q).max()))
    read: list[Any] = []
    for one in given:
        phi = one.mapping.read(q)
        if not any(np.allclose(phi, other, rtol=0, atol=slack, equal_nan=True) for other in read):
            read.append(phi)
            yield one


def clears_bar(scores: MappingScores) -> bool:
    """Return whether a mapping fits well enough to be used unseen.

    Where it knows anything its greedy policy must regain at least 25 %, and its values must explain
    at least a quarter of what a constant leaves unexplained. Either alone does not do: two tasks
    may look alike nearly everywhere and have goals in different places, and a policy that follows
    wrong values may gain by avoiding what costs most.
    """
    return scores.regained_where_known >= LEAST_REGAINED and scores.unexplained <= MOST_UNEXPLAINED


def as_good_as_exact(found: FoundMapping) -> bool:
    """Return whether a mapping is right where it knows anything, and fits elsewhere.

    Where steps cost, pairs that were tried fall below the value that fits, so that a learner goes
    on to others. Without such a value it walks at random until it meets a mapped state: then a
    rough mapping of many states is better than an exact one of few.
    """
    scores = found.scores
    right = scores.regained_where_known >= 1 - MOST_MISSED
    right = right and scores.unexplained <= LEFT_BY_EXACT
    return right and (found.unmapped_value is not None or scores.coverage == 1)


def rank(found: FoundMapping) -> tuple[bool, bool, float, float, float]:
    """Return what candidates are ordered by, the best first."""
    scores = found.scores
    worst = np.nan_to_num(
        [-scores.worth, scores.dynamics_error, scores.bellman_inconsistency], nan=np.inf
    )
    worth, dynamics, bellman = (float(round(one, 9)) for one in worst)
    return not clears_bar(scores), not as_good_as_exact(found), worth, dynamics, bellman
