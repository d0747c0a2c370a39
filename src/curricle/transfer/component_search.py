"""Mappings by components: by their names, and by every assignment of one's to the other's."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from curricle.errors import MappingError
from curricle.tasks.families.family import Unequal
from curricle.transfer.component_mapping import ComponentMapping, describe_renaming, source_points
from curricle.transfer.mapping import pair_mapping
from curricle.transfer.mapping_search import Assignment, assignments
from curricle.transfer.proposal import Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair

WORDS: dict[Unequal, str] = {
    "unmapped": "components by name",
    "scale": "components by name, unequal ranges scaled",
    "clip": "components by name, unequal ranges clipped",
}
MOST_UNEQUAL = 3
"""Components of unequal ranges that are aligned in all ways."""
KEPT = 12
"""Assignments that are scored in full: those whose dynamics predict the target best."""


def by_name(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mappings that :func:`project` makes without renaming.

    Where ranges of a component differ, values that the source lacks are left unmapped, scaled or
    clipped; these are three candidates.

    Raises
    ------
    MappingError
        When the target lacks a component of the source's.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> tasks = TaskPair(Pursuit(size=3, predators=2), Pursuit(size=3, predators=1))
    >>> list(by_name(tasks))
    Traceback (most recent call last):
    curricle.errors.MappingError: source component 'predator' must be read from a target ...
    """
    ways: tuple[Unequal, ...] = ("unmapped", "scale", "clip")
    for unequal in ways:
        mapping = ComponentMapping(tasks.target, tasks.source, {}, unequal=unequal)
        yield Proposal(mapping, WORDS[unequal])


def by_alignment(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield mappings by name with ranges of unequal size put side by side at either end.

    A wide grid and a narrow one may correspond at the goal's side. Values outside the narrower
    range are left unmapped, or read its last value.

    Raises
    ------
    MappingError
        When the target lacks a component of the source's, or all ranges are equal or have labels.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S....T"), GridWorld("S.T"))
    >>> [one.how for one in by_alignment(tasks)]
    ['components by name, last column aligned', 'components by name, last column aligned, clipped']
    """
    own, other = tasks.target.states, tasks.source.states
    values = own.decode()
    actions = source_points(tasks.target.actions, tasks.source.actions, {})
    unequal = []
    for theirs in other.components:
        mine = own.component(theirs.name) if theirs.name in own.names else None
        if mine is None:
            raise MappingError(f"ranges are aligned by name: the target has no {theirs.name!r}")
        if (mine.size, mine.low) != (theirs.size, theirs.low) and mine.labels is None:
            unequal.append(theirs.name)
    if not unequal or len(unequal) > MOST_UNEQUAL:
        raise MappingError(
            f"ranges are aligned where 1 to {MOST_UNEQUAL} components differ: got {len(unequal)}"
        )
    for ends in product(("first", "last"), repeat=len(unequal)):
        if set(ends) == {"first"} and all(own.component(n).low == other.component(n).low
                                          for n in unequal):  # fmt: skip
            continue  # as by name
        for clipped in (False, True):
            read = {}
            for theirs in other.components:
                offset = 0
                if theirs.name in unequal:
                    mine, end = own.component(theirs.name), ends[unequal.index(theirs.name)]
                    offset = theirs.low - mine.low if end == "first" else theirs.high - mine.high
                value = values[theirs.name] + offset
                read[theirs.name] = np.clip(value, theirs.low, theirs.high) if clipped else value
            state = other.encode(**read)
            words = " and ".join(f"{end} {name}" for name, end in zip(unequal, ends, strict=True))
            how = f"components by name, {words} aligned{', clipped' if clipped else ''}"
            index = pair_mapping(tasks.target, tasks.source, state[:, None], actions).index
            yield Proposal(SearchedMapping(tasks.target, tasks.source, index, how=how), how)


def by_assignment(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the assignments of components under which the source predicts the target best.

    As :func:`find_projections`, after Taylor, Kuhlmann, Stone 2008.

    Raises
    ------
    MappingError
        When there are more than 10,000 assignments, or one task has unnumbered components.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> tasks = TaskPair(Pursuit(size=3, predators=2), Pursuit(size=3, predators=1))
    >>> print(next(by_assignment(tasks)).how)
    components by assignment: predator is predator_1, prey by name
    """
    if not (tasks.target_mdp.states.names and tasks.source_mdp.states.names):
        raise MappingError("an assignment needs components: a task has none")
    best: list[Assignment] = []
    for found in assignments(tasks.target_mdp, tasks.source_mdp):
        if not np.isnan(found.error):
            best = sorted([*best, found], key=lambda one: one.error)[:KEPT]
    for one in best:
        # One name may stand for a component of states and for one of actions, read differently.
        shared = set(one.states) & set(one.actions)
        if any(one.states[name] != one.actions[name] for name in shared):
            states, actions = (
                ", ".join(f"{k} is {v}" for k, v in part.items())
                for part in (one.states, one.actions)
            )
            words = f"{states}; actions: {actions}"
            mapping = one.mapping(tasks.target, tasks.source)
        else:
            renaming = {**one.states, **one.actions}
            words = describe_renaming(list(renaming), renaming)
            mapping = ComponentMapping(tasks.target, tasks.source, renaming)
        yield Proposal(mapping, f"components by assignment: {words}")
