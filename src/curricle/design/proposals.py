"""A candidate for a source, how it reads another candidate, and the draft that it is made from."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from curricle.arrays import BoolArray, Frozen, IntArray
from curricle.checks import fit_name, text
from curricle.errors import CurriculumError, TaskError
from curricle.tasks.family import FamilyMember
from curricle.tasks.mdp import FiniteMDP, generative_model, has_tables, tables
from curricle.tasks.start_states import goal_states
from curricle.text import counted
from curricle.transfer.by_components import member_mappings
from curricle.transfer.mapping import (
    ENDED,
    UNMAPPED,
    StateActionMapping,
    pair_mapping,
    terminal_states,
)
from curricle.transfer.observation_mapping import ObservationMapping

Item = TypeVar("Item")
PROPOSED = "proposed"
MAPPINGS = (StateActionMapping, ObservationMapping)
AGREES = 0.99
"""Share of the target's pairs that must read the same pair through the target."""


@dataclass(frozen=True, eq=False)
class SourceCandidate(Frozen):
    """A task that may be a source of the target, and how the target reads it.

    Parameters
    ----------
    name : str
        For a curriculum; every candidate of a target has a different one.
    task : Task
        With tables.
    mappings : StateActionMapping, ObservationMapping or sequence of them
        From the target to the task; several where the target reads it in several ways, as each of
        two predators reads the single predator of a smaller hunt.
    kind : str
        One of the kinds of :func:`source_candidates`; "proposed" for a user's candidate.
    words : str
        A description for a person.
    share : float, optional
        Size or distance as a share of the target's: the side of a crop, the way from starts or a
        bottleneck to the goal.
    member : FamilyMember, optional
        Its address, if it is a member of the target's family.
    optimum, random_return : float
        Expected discounted return from its start, of an optimal policy and of the uniformly random
        policy; NaN before it is judged.

    Raises
    ------
    CurriculumError
        When the name is unfit, or `mappings` holds something else or leads to another task.

    Examples
    --------
    >>> from curricle import GridWorld, same_position
    >>> maze = GridWorld("S...T")
    >>> near = maze.crop(rows=(0, 1), columns=(2, 5))
    >>> SourceCandidate("near", near, same_position(maze, near))
    SourceCandidate('near', proposed, 3 states)
    """

    name: str
    task: Any
    mappings: Any
    kind: str = PROPOSED
    words: str = ""
    share: float | None = None
    member: FamilyMember | None = None
    optimum: float = float("nan")
    random_return: float = float("nan")

    def __post_init__(self) -> None:
        fit_name("a candidate", self.name, CurriculumError)
        text(f"the kind of {self.name!r}", self.kind, CurriculumError)
        several = isinstance(self.mappings, Sequence)
        mappings = tuple(self.mappings) if several else (self.mappings,)
        if not mappings or not all(isinstance(mapping, MAPPINGS) for mapping in mappings):
            raise CurriculumError(
                f"a candidate needs mappings from the target: {self.name!r} has {self.mappings!r}"
            )
        if any(mapping.source is not self.task for mapping in mappings):
            raise CurriculumError(
                f"the mappings of a candidate must lead to its task: one of {self.name!r} does not"
            )
        object.__setattr__(self, "mappings", mappings)

    @property
    def mapping(self) -> Any:
        """The first of its mappings."""
        return self.mappings[0]

    def __repr__(self) -> str:
        states = counted(self.task.states.size, "state")
        return f"SourceCandidate({self.name!r}, {self.kind}, {states})"


def mappings_between(
    target: Any, after: SourceCandidate, before: SourceCandidate
) -> tuple[Any, ...]:
    """Return how a source reads an earlier source: f(s', a') for the later source's pairs.

    Members of a family map onto each other as the family declares. Other sources read each other
    through the target: of all target pairs that read a pair of the later source, most read the same
    pair of the earlier source, and that is its value. Of several mappings those are returned for
    which nearly all target pairs agree, or the mapping for which most agree.

    Parameters
    ----------
    target : Task
        Whose pairs the mappings of both sources are from.
    after, before : SourceCandidate

    Raises
    ------
    CurriculumError
        When the sources are no members of one family, and have no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design import source_candidates
    >>> maze = GridWorld(["S....", ".....", ".....", ".....", "....T"])
    >>> crops = source_candidates(maze, kinds=["crop"])
    >>> large, small = crops["rows 1..4, columns 1..4"], crops["rows 3..4, columns 3..4"]
    >>> (mapping,) = mappings_between(maze, large, small)
    >>> print(mapping.coverage())
    20.0% of 60 target pairs mapped, 0.0% at the source's end, 80.0% unmapped; ...
    """
    later, earlier = after.member, before.member
    if later and earlier and later.family.factory is earlier.family.factory:
        return member_mappings(later, earlier, after.task, before.task)
    if not all(has_tables(task) for task in (target, after.task, before.task)):
        raise CurriculumError(
            "sources that build on each other must be members of one family, or have tables as "
            f"the target has: {after.name!r} and {before.name!r} do not"
        )
    reader = after.mappings[0].index
    read = [_through(reader, mapping.index, after.task, before.task) for mapping in before.mappings]
    best = max(agreement for agreement, _ in read)
    return tuple(
        StateActionMapping(after.task, before.task, index)
        for agreement, index in read
        if agreement >= min(best, AGREES)
    )


def _through(reader: IntArray, read: IntArray, after: Any, before: Any) -> tuple[float, IntArray]:
    """Return the pair that most target pairs read, (S', A'), and the share of pairs that do."""
    shape = after.states.size, generative_model(after).actions.size
    known = (reader >= 0) & (read != UNMAPPED)
    index = np.full(shape[0] * shape[1], UNMAPPED, np.int64)
    if not known.any():
        return 0.0, index.reshape(shape)
    size = before.states.size * generative_model(before).actions.size - ENDED
    both = reader[known].astype(np.int64) * size + (read[known] - ENDED)
    pairs, counts = np.unique(both, return_counts=True)
    later, earlier = np.divmod(pairs, size)
    order = np.lexsort((earlier, -counts, later))  # of equal counts the first pair
    first = order[np.unique(later[order], return_index=True)[1]]
    index[later[first]] = earlier[first] + ENDED
    index = index.reshape(shape)
    index[terminal_states(after)] = ENDED
    return float(counts[first].sum() / counts.sum()), index


# -- drafts --------------------------------------------------------------------------------------


class DesignTarget(NamedTuple):
    """A target, its tables and its goal, from which drafts are made."""

    task: Any
    member: FamilyMember | None  # its address, if it is a member of a family
    mdp: FiniteMDP
    goal: BoolArray  # (S,)


Made = tuple[Any, StateActionMapping | Sequence[StateActionMapping]]


class Draft(NamedTuple):
    """A candidate before its task is built."""

    kind: str
    name: str
    words: str
    build: Callable[[], Made]  # the task and its mappings; CurricleError if there is no such task
    share: float | None = None
    member: FamilyMember | None = None


def paired(target: Any, make: Callable[[], Any], reads: Any = None) -> Callable[[], Made]:
    """Return the `build` of a task that `make` returns; `reads(target, source)` is the mapping."""

    def build() -> Made:
        source = make()
        return source, (reads or by_number)(target, source)

    return build


def design_target(target: Any) -> DesignTarget:
    """Return a target, a task or a member of a family, with its tables; TaskError for others."""
    member = target if isinstance(target, FamilyMember) else None
    task = target if member is None else member.task
    mdp = tables(task)
    return DesignTarget(task, member, mdp, aims(mdp))


def aims(mdp: FiniteMDP) -> BoolArray:
    """Return the goal, (S,) bool: the best ends, or else the states of the largest reward."""
    try:
        return goal_states(mdp)
    except TaskError:
        mean = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row].max(axis=1)
        live = ~mdp.terminal
        return np.asarray(live & (mean >= mean[live].max(initial=-np.inf)))


def by_number(target: Any, source: Any) -> StateActionMapping:
    """Return the mapping by which a pair reads the pair of the same number."""
    states, actions = np.arange(target.states.size), np.arange(target.actions.size)
    return pair_mapping(target, source, states[:, None], actions)


def spread(items: Iterable[Item]) -> list[Item]:
    """Return items in an order of which the first few are spread over all: the middle first."""
    items = list(items)
    order, parts = list[Item](), [(0, len(items))]
    for low, high in parts:  # grows while it is read
        if low < high:
            middle = (low + high - 1) // 2
            order.append(items[middle])
            parts += [(low, middle), (middle + 1, high)]
    return order
