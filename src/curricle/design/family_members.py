"""Candidates that are easier members of the target's family."""

from collections.abc import Iterator
from functools import partial
from itertools import islice

from curricle.design.proposals import DesignTarget, Draft, Made, spread
from curricle.tasks.families.family import FamilyMember
from curricle.transfer.family_mapping import family_mappings

MOST_LISTED = 10_000
"""Easier members that are listed at most; addresses alone, of which few are built."""


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
        words = f"an easier member of the family: {_changes(target.member, one)}"
        yield Draft("member", str(one), words, partial(_built, target.member, one))


def _built(target: FamilyMember, source: FamilyMember) -> Made:
    return source.task, family_mappings(target, source)


def _changes(target: FamilyMember, source: FamilyMember) -> str:
    given = target.parameters
    changed = {name: one for name, one in source.parameters.items() if one != given[name]}
    return ", ".join(f"{name} {one} instead of {given[name]}" for name, one in changed.items())
