"""Candidates that are easier members of the target's family."""

from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import Any

from curricle.design.proposals import DesignTarget, Draft, Made, spread
from curricle.tasks.families.family import FamilyMember
from curricle.transfer.family_mapping import family_mappings

MOST_LISTED = 10_000
"""Easier members that are listed at most; addresses alone, of which few are built."""
SMALL = 4
"""Below it a parameter of the target is a count, and that of a source is said as it is."""


def family_members(target: DesignTarget) -> Iterator[Draft]:
    """Yield the members that are nowhere harder than the target, spread over all of them.

    Examples
    --------
    >>> from curricle.design.proposals import design_target
    >>> from curricle.tasks import pursuit_family
    >>> target = design_target(pursuit_family(size=3, predators=2))
    >>> [draft.name for draft in family_members(target)]
    ['pursuit(size=2)', 'pursuit(size=2, predators=1)', 'pursuit(size=3, predators=1)']
    """
    if target.member is None:
        return
    for one in spread(islice(target.member.family.easier(target.member), MOST_LISTED)):
        yield member_draft(target.member, one)


def member_draft(target: FamilyMember, source: FamilyMember) -> Draft:
    """Return the draft of one member as a source of another.

    Examples
    --------
    >>> from curricle.tasks import pursuit_family
    >>> target = pursuit_family(size=8, predators=2)
    >>> member_draft(target, target.replace(size=4, predators=1)).changes
    {'size': '0.5 n', 'predators': 1}
    """
    given = target.parameters
    changed = {name: one for name, one in source.parameters.items() if one != given[name]}
    shown = ", ".join(f"{name} {one} instead of {given[name]}" for name, one in changed.items())
    return Draft(
        "member",
        str(source),
        f"an easier member of the family: {shown}",
        partial(_built, target, source),
        "",
        changes={name: _term(one, given[name]) for name, one in changed.items()},
        member=source,
    )


def _built(target: FamilyMember, source: FamilyMember) -> Made:
    return source.task, family_mappings(target, source)


def _term(value: Any, of_target: Any) -> Any:
    """Return a value by that of the target, if both are numbers and the target's is not small."""
    numbers = all(isinstance(one, int | float) for one in (value, of_target))
    if not numbers or isinstance(value, bool) or of_target < SMALL or value <= 0:
        return value
    return f"{value / of_target:.3g} n"
