"""How a source relates to a target, in terms that hold for other targets too.

"A crop of half the size" and "the member with one predator" name a source of any target, where
"rows 0 to 3" names one of a single maze.
"""

import math
import re
from dataclasses import dataclass
from typing import Any

from curricle.checks import brief, number, one_of, text
from curricle.design.family_members import member_draft
from curricle.design.makers import KINDS, MAKERS
from curricle.design.proposals import Draft, SourceCandidate, design_target
from curricle.errors import CurricleError, CurriculumError
from curricle.frozen_arrays import Frozen
from curricle.tasks.families.family import FamilyMember, Parameter

TERM = re.compile(r"(?P<share>\d*\.?\d+)?\s*n\s*(?P<more>[+-]\s*\d+)?")
"""A parameter of a source by that of its target, n: such as ``0.5 n`` or ``n - 1``."""


@dataclass(frozen=True)
class Relation(Frozen):
    """A source by its relation to the target.

    Parameters
    ----------
    kind : str
        Of :data:`KINDS`, what the source is made by.
    share : float, optional
        Of the target, above 0 and below 1: of the side of a crop, of the way that starts lie from
        the goal, of the way to a bottleneck.
    which : str
        What is removed, or which components are merged, as candidates name it: ``"no pit"``.
    changes : dict
        Of a member: its parameters. A number, word or flag is the value itself; ``"0.5 n"`` and
        ``"n - 1"`` are by the target's value n, rounded half up for whole numbers. The others are
        the target's.

    Raises
    ------
    CurriculumError
        When the kind is unknown, or the terms do not fit it.

    Examples
    --------
    >>> from curricle.tasks import pursuit_family
    >>> half = Relation("member", changes={"size": "0.5 n", "predators": 1})
    >>> print(half)
    member with size 0.5 n, predators 1
    >>> half.source_of(pursuit_family(size=5, predators=2)).name
    'pursuit(size=3, predators=1)'
    """

    kind: str
    share: float | None = None
    which: str = ""
    changes: Any = ()

    def __post_init__(self) -> None:
        one_of("the kind of a relation", self.kind, KINDS, CurriculumError)
        if self.which != "":
            text("which of a relation", self.which, CurriculumError)
        if self.share is not None:
            number("the share of a relation", self.share, CurriculumError)
            if not 0 < self.share < 1:
                raise CurriculumError(
                    f"the share of a relation must lie between 0 and 1: got {self.share:g}"
                )
        try:
            changes = dict(self.changes)
        except (TypeError, ValueError):
            raise CurriculumError(
                f"the changes of a relation must be a dict of parameters: got {self.changes!r}"
            ) from None
        for name, value in changes.items():
            _check_single(name, value)
        if (self.kind == "member") != bool(changes):
            raise CurriculumError(
                "changes of parameters make a member, and a member needs them: got the kind "
                f"{self.kind!r} with {changes}"
            )
        object.__setattr__(self, "changes", tuple(changes.items()))

    def __str__(self) -> str:
        if self.kind == "member":
            return "member with " + ", ".join(f"{name} {value}" for name, value in self.changes)
        share = "" if self.share is None else f" {self.share:.3g}"
        return f"{self.kind}{share}{f': {self.which}' if self.which else ''}"

    def source_of(self, target: Any) -> SourceCandidate:
        """Return the source of a target that stands in this relation to it.

        Of sources that are made in steps, such as crops, it is the one whose share is the nearest;
        of equally near ones the larger.

        Parameters
        ----------
        target : Task or FamilyMember
            With tables, unless the kind is ``"member"``.

        Raises
        ------
        CurriculumError
            When the target has no such source.

        Examples
        --------
        >>> from curricle import GridWorld
        >>> maze = GridWorld(["S....", ".....", ".....", "....T"])
        >>> Relation("crop", 0.5).source_of(maze).name
        'rows 1..3, columns 2..4'
        """
        if self.kind == "member":
            draft = self._member(target)
        else:
            made = MAKERS[self.kind](design_target(target))
            drafts = [one for one in made if one.which == self.which]
            if self.share is not None:
                drafts = [one for one in drafts if one.share is not None]
                drafts.sort(key=self._distance)  # stable
            if not drafts:
                raise CurriculumError(f"{_named(target)} has no source that is a {self}")
            draft = drafts[0]
        try:
            task, mappings = draft.build()
        except CurricleError as error:
            raise CurriculumError(
                f"{_named(target)} has no source that is a {self}: {error}"
            ) from error
        words = draft.kind, draft.words
        return SourceCandidate(draft.name, task, mappings, *words, self, draft.member)

    def _distance(self, draft: Draft) -> tuple[float, float]:
        share = draft.share or 0.0
        return round(abs(share - (self.share or 0.0)), 9), -share

    def _member(self, target: Any) -> Draft:
        if not isinstance(target, FamilyMember):
            raise CurriculumError(
                f"a source that is a {self} needs a target that is a member of a family: got "
                f"{_named(target)}"
            )
        changes = {
            name: _value(target.family.parameter(name), given, target)
            for name, given in self.changes
        }
        return member_draft(target, target.replace(**changes))


def _check_single(name: Any, value: Any) -> None:
    """Raise CurriculumError where a value cannot be one of a parameter: those are hashed."""
    try:
        hash(value)
    except TypeError:
        raise CurriculumError(
            f"{name} in the changes of a relation must be one value, such as a number or a word: "
            f"got {brief(value)}"
        ) from None


def _value(parameter: Parameter, given: Any, target: FamilyMember) -> Any:
    """Return the value of a source's parameter."""
    found = TERM.fullmatch(given.strip()) if isinstance(given, str) else None
    if found is None or (parameter.values is not None and given in parameter.values):
        return given
    n = target[parameter.name]
    if n is None:
        return None
    share = 1.0 if found["share"] is None else float(found["share"])
    value = share * number(f"{parameter.name} of {target}", n, CurriculumError)
    value += 0 if found["more"] is None else int(found["more"].replace(" ", ""))
    if parameter.kind is int or isinstance(n, int):
        value = math.floor(value + 0.5)
    low = -math.inf if parameter.low is None else parameter.low
    high = math.inf if parameter.high is None else parameter.high
    return min(max(value, low), high)


def _named(target: Any) -> str:
    return (
        str(target) if isinstance(target, FamilyMember) else f"the target, {type(target).__name__},"
    )


def relation_of(draft: Draft) -> Relation | None:
    """Return how a draft relates to its target; None where no other target has the like."""
    if draft.which is None or (draft.kind == "member" and not draft.changes):
        return None
    share = draft.share if draft.share is not None and draft.share < 1 else None
    return Relation(draft.kind, share, draft.which, draft.changes)
