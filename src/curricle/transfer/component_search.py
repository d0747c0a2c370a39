"""Mappings by components: by their names, and by every assignment of one's to the other's."""

from collections.abc import Iterator

import numpy as np

from curricle.errors import MappingError
from curricle.tasks.families.components_by_name import Unequal
from curricle.transfer.component_mapping import ComponentMapping, describe_renaming
from curricle.transfer.mapping_search import Assignment, assignments
from curricle.transfer.proposal import Proposal
from curricle.transfer.task_pair import TaskPair

WORDS: dict[Unequal, str] = {
    "unmapped": "components by name",
    "scale": "components by name, unequal ranges scaled",
    "clip": "components by name, unequal ranges clipped",
}
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
    for found in assignments(tasks.target, tasks.source):
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
