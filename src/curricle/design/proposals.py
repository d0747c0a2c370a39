"""A candidate for a source, how it reads another one, and the draft that it is made from."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from curricle.array_types import BoolArray, IntArray
from curricle.checks import fit_name, text
from curricle.errors import CurriculumError, TaskError
from curricle.frozen_arrays import Frozen
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.start_states import goal_states
from curricle.tasks.task import generative_model, has_tables, tables
from curricle.text_tables import counted
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
"""Share of the target's pairs for which a mapping through it must be one and the same."""


@dataclass(frozen=True, eq=False)
class SourceCandidate(Frozen):
    """A task that may be a source of the target, and how the target reads it.

    Parameters
    ----------
    name : str
        What a curriculum can call it; different for each candidate of a target.
    task : Task
        With tables.
    mappings : StateActionMapping, ObservationMapping or sequence of them
        From the target to the task; several where the target reads it in several ways, as each of
        two predators reads the only one of a smaller hunt.
    kind : str
        What it was made by, as in :func:`source_candidates`; "proposed" for a user's own.
    words : str
        What it is, for a person.
    share : float, optional
        Of the target, where candidates of its kind differ by size or distance: of the side of a
        crop, of the way that starts or a bottleneck lie from the goal.
    member : FamilyMember, optional
        Its address, if it is a member of the target's family.
    optimum, random_return : float
        Expected discounted return from its start, of an optimal policy and of the uniformly random
        one; NaN before it was judged.

    Raises
    ------
    CurriculumError
        When the name is unfit, or a mapping is none or leads elsewhere.

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
        if not mappings or not all(isinstance(one, MAPPINGS) for one in mappings):
            raise CurriculumError(
                f"a candidate needs mappings from the target: {self.name!r} has {self.mappings!r}"
            )
        if any(one.source is not self.task for one in mappings):
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
    """Return how a source reads an earlier one: f(s', a') for the later source's pairs.

    Members of one family map onto each other as it declares. Other sources read each other through
    the target: a pair of the later one reads the pair of the earlier one that most of those target
    pairs read which read itself. Of several mappings those are taken by which the target's pairs
    agree, or the one by which they agree the most.

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
    own, other = after.member, before.member
    if own is not None and other is not None and own.family.factory is other.family.factory:
        return member_mappings(own, other, after.task, before.task)
    if not all(has_tables(task) for task in (target, after.task, before.task)):
        raise CurriculumError(
            "sources that build on each other must be members of one family, or have tables as "
            f"the target has: {after.name!r} and {before.name!r} do not"
        )
    reader = after.mappings[0].index
    found = [_through(reader, one.index, after.task, before.task) for one in before.mappings]
    best = max(agreement for agreement, _ in found)
    return tuple(
        StateActionMapping(after.task, before.task, index)
        for agreement, index in found
        if agreement >= min(best, AGREES)
    )


def _through(reader: IntArray, read: IntArray, after: Any, before: Any) -> tuple[float, IntArray]:
    """Return the most frequent pair that is read, (S', A'), and in how many it is that one."""
    shape = after.states.size, generative_model(after).actions.size
    known = (reader >= 0) & (read != UNMAPPED)
    index = np.full(shape[0] * shape[1], UNMAPPED, np.int64)
    if not known.any():
        return 0.0, index.reshape(shape)
    size = before.states.size * generative_model(before).actions.size - ENDED
    both = reader[known].astype(np.int64) * size + (read[known] - ENDED)
    pairs, counts = np.unique(both, return_counts=True)
    own, other = np.divmod(pairs, size)
    order = np.lexsort((other, -counts, own))  # of equal counts the first pair
    first = order[np.unique(own[order], return_index=True)[1]]
    index[own[first]] = other[first] + ENDED
    index = index.reshape(shape)
    index[terminal_states(after)] = ENDED
    return float(counts[first].sum() / counts.sum()), index


# -- drafts --------------------------------------------------------------------------------------


class DesignTarget(NamedTuple):
    """The target of a design, and what the kinds of candidates read of it."""

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
    build: Callable[[], Made]
    """Returns the task and its mappings; raises a CurricleError where there is no such task."""
    share: float | None = None
    """Of the target, where candidates of a kind differ by size or distance."""
    member: FamilyMember | None = None
    """Its address, if it is a member of the target's family."""


def design_target(target: Any) -> DesignTarget:
    """Return what kinds read of a target, a task or a member of a family; TaskError if neither."""
    member = target if isinstance(target, FamilyMember) else None
    task = target if member is None else member.task
    mdp = tables(task)
    return DesignTarget(task, member, mdp, aims(mdp))


def aims(mdp: FiniteMDP) -> BoolArray:
    """Return the states that an agent wants to get to, (S,) bool.

    The ends that are entered with the largest reward; where nothing ends the task, the states in
    which some action has the largest expected reward of all.
    """
    try:
        return goal_states(mdp)
    except TaskError:
        mean = (mdp.probability * mdp.reward).sum(axis=1)[mdp.outcome_row].max(axis=1)
        live = ~mdp.terminal
        return np.asarray(live & (mean >= mean[live].max(initial=-np.inf)))


def by_number(target: Any, source: Any) -> StateActionMapping:
    """Return the mapping of each state and action to that of the same number."""
    states, actions = np.arange(target.states.size), np.arange(target.actions.size)
    return pair_mapping(target, source, states[:, None], actions)


def spread(items: Iterable[Item]) -> list[Item]:
    """Return items so that those first in the list are spread over all: the middle one first."""
    listed = list(items)
    found, parts = list[Item](), [(0, len(listed))]
    for low, high in parts:  # grows while it is read
        if low < high:
            middle = (low + high - 1) // 2
            found.append(listed[middle])
            parts += [(low, middle), (middle + 1, high)]
    return found
