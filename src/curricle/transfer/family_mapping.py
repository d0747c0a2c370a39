"""Mappings between members of a task family, made from what the family declares."""

from collections.abc import Iterator
from typing import Any

from curricle.checks import brief, instance
from curricle.errors import CurricleError, MappingError
from curricle.tasks.families.family import ComponentsByName, FamilyMember
from curricle.tasks.task import Task
from curricle.transfer.component_mapping import ComponentMapping
from curricle.transfer.mapping import StateActionMapping, from_function
from curricle.transfer.observation_mapping import ObservationMapping


def family_mappings(
    target: FamilyMember, source: FamilyMember, *, unmapped_value: float | None = None
) -> tuple[Any, ...]:
    """Return how a member of a family maps onto another, as the family declares it.

    Several mappings stand for several transfers: each predator of a pursuit can read the only one
    of its source. What the family declares is checked against both tasks as any mapping is.

    Parameters
    ----------
    target, source : FamilyMember
        Of one family; their tasks are built.
    unmapped_value : float, optional
        As in :class:`StateActionMapping`. It is not given to mappings that a family's function made
        itself.

    Returns
    -------
    tuple of StateActionMapping or ObservationMapping
        At least one, from ``target.task`` to ``source.task``.

    Raises
    ------
    MappingError
        When the members are of two families, or what the family declares does not fit them.

    Examples
    --------
    >>> from curricle.tasks import pursuit_family
    >>> hunt, chase = pursuit_family(size=4, predators=2), pursuit_family(size=4, predators=1)
    >>> for mapping in family_mappings(hunt, chase):
    ...     print(mapping)
    ComponentMapping(prey=prey, predator=predator_1)
    ComponentMapping(prey=prey, predator=predator_2)
    """
    instance("target", target, FamilyMember, MappingError)
    instance("source", source, FamilyMember, MappingError)
    return member_mappings(target, source, target.task, source.task, unmapped_value)


def member_mappings(
    target: FamilyMember,
    source: FamilyMember,
    target_task: Task,
    source_task: Task,
    unmapped_value: float | None = None,
) -> tuple[Any, ...]:
    """Return the mappings of :func:`family_mappings` for tasks that were made of the members.

    They have the members' states and actions, and perhaps another start.
    """
    if target.family.factory is not source.family.factory:
        raise MappingError(
            f"members of one family map onto each other: got {target}, of {target.family.name}, "
            f"and {source}, of {source.family.name}"
        )
    declared = target.family.mapping
    if not isinstance(declared, ComponentsByName):
        try:
            declared = declared(target, source)
        except MappingError:
            raise
        except CurricleError as error:
            raise MappingError(str(error)) from error
    found = tuple(declared) if isinstance(declared, list | tuple | Iterator) else (declared,)
    if not found:
        raise MappingError(
            f"a family must declare at least one mapping: {target} <- {source} has none"
        )
    return tuple(_made(one, target_task, source_task, unmapped_value, target) for one in found)


def _made(
    declared: Any,
    target: Task,
    source: Task,
    unmapped_value: float | None,
    member: FamilyMember,
) -> Any:
    """Return one declared mapping as the library checks it."""
    if isinstance(declared, ComponentsByName):
        renaming = dict(declared.renaming)
        return ComponentMapping(target, source, renaming, unmapped_value, declared.unequal)
    if isinstance(declared, StateActionMapping | ObservationMapping):
        return declared
    if callable(declared):
        return from_function(target, source, declared, unmapped_value=unmapped_value)
    raise MappingError(
        f"the mapping of {member.family.name} must return a ComponentsByName, a function of "
        f"states and actions, a mapping, or a list of them: got {brief(declared)}"
    )
