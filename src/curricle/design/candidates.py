"""Candidates for the sources of one target: proposed by kind, judged, and none of them twice."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from curricle.array_types import BoolArray, FloatArray
from curricle.checks import one_of, whole_number
from curricle.design.bottlenecks import bottlenecks
from curricle.design.parts import crops, family_members, start_rings
from curricle.design.proposals import (
    PROPOSED,
    DesignTarget,
    Draft,
    Made,
    SourceCandidate,
    aims,
    design_target,
)
from curricle.design.simpler_models import coarser_tables, likeliest_outcomes, removals
from curricle.display import block, brief_repr, table
from curricle.errors import CurricleError, CurriculumError
from curricle.planning.solution import evaluate, solve
from curricle.tasks.mdp import FiniteMDP, reachable_states
from curricle.tasks.start_states import goal_distance
from curricle.tasks.task import generative_model, same_task, tables
from curricle.transfer.bisimulation import model_for_refinement, refined

MAKERS: dict[str, Callable[[DesignTarget], Iterator[Draft]]] = {
    "member": family_members,
    "crop": crops,
    "removed": removals,
    "deterministic": likeliest_outcomes,
    "starts": start_rings,
    "bottleneck": bottlenecks,
    "coarser": coarser_tables,
}
KINDS = tuple(MAKERS)
"""What candidates are made by, in the order of their turns."""
MOST = 20
"""Candidates, unless told otherwise."""
LARGEST = 20_000_000
"""State-action pairs up to which a task is judged, as they are refined together."""
ROUNDING = 1e-9
"""Difference of returns, in units of the larger, that counts as none."""
FINGERPRINT = 1e-6
"""The same of fingerprints: far more than equal tasks can differ by."""
# Why a task is no candidate; the same words for all that are dropped for one reason.
NOT_MADE = "cannot be made"
TOO_LARGE = "too large to be judged"
NO_SOLUTION = "no exact solution"
NEVER_REACHED = "goal never reached from the start"
AVOIDED = "goal avoided by every optimal policy"
NOTHING_TO_LEARN = "nothing to learn: the random policy is optimal"
AS_TARGET, AS_ANOTHER = "same as the target", "same as another candidate"

Propose = Callable[[Any], Iterable[SourceCandidate]]


class DroppedCandidate(NamedTuple):
    """What was proposed and is no candidate."""

    name: str
    kind: str
    reason: str
    """The same words for all that were dropped for one reason."""
    detail: str = ""
    """The sentence of the error, or the name of the candidate that is the same task."""


@dataclass(frozen=True, eq=False)
class SourceCandidates:
    """Candidates for the sources of a target, in order. Prints as a table.

    Attributes
    ----------
    target : Task
    candidates : tuple of SourceCandidate
        They take turns by kind, so that the first few are of all kinds.
    dropped : tuple of DroppedCandidate
        What was proposed before the last of them, and why it is none.
    cut : bool
        Whether `most` ended the list while there was more to look at.
    """

    target: Any
    candidates: tuple[SourceCandidate, ...]
    dropped: tuple[DroppedCandidate, ...]
    cut: bool

    __repr__ = brief_repr

    def __len__(self) -> int:
        return len(self.candidates)

    def __iter__(self) -> Iterator[SourceCandidate]:
        return iter(self.candidates)

    def __getitem__(self, name: str) -> SourceCandidate:
        by_name = {one.name: one for one in self.candidates}
        one_of("a candidate", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def _reasons(self) -> str:
        """How many were dropped for each reason, the most frequent first, in words."""
        counts = Counter(one.reason for one in self.dropped).most_common()
        return "; ".join(f"{n} {reason}" for reason, n in counts)

    def _repr_html_(self) -> str:
        rows = [
            (one.name, one.kind, one.task.states.size, one.optimum, one.random_return)
            for one in self.candidates
        ]
        head = ["source", "kind", "states", "optimum", "random policy"]
        return block("Candidates for sources", table(head, rows), *self._left_out())

    def _left_out(self) -> list[str]:
        """Return what was dropped or not looked at, in words."""
        lines = list[str]()
        if self.dropped:
            looked_at = len(self.candidates) + len(self.dropped)
            lines.append(f"dropped {len(self.dropped)} of {looked_at}: {self._reasons}")
        if self.cut:
            lines.append(f"cut at {len(self)}: there is more to look at")
        return lines

    def __str__(self) -> str:
        width = max(len(one.name) for one in self.candidates)
        lines = [f"{'':{width}}  {'kind':<13}{'states':>9}{'optimum':>10}{'random':>10}"]
        lines += [
            f"{one.name:{width}}  {one.kind:<13}{one.task.states.size:>9,}{one.optimum:>10.4g}"
            f"{one.random_return:>10.4g}"
            for one in self.candidates
        ]
        return "\n".join([*lines, *self._left_out()])


@dataclass(frozen=True, eq=False)
class Judged:
    """What is known of a task: its returns, and its fingerprint."""

    mdp: FiniteMDP
    refusal: str  # why it can be no candidate; empty if it can
    optimum: float = float("nan")
    random_return: float = float("nan")
    fingerprint: FloatArray | None = None


def source_candidates(
    target: Any,
    *,
    kinds: Sequence[str] = KINDS,
    most: int = MOST,
    propose: Propose | None = None,
) -> SourceCandidates:
    """Return candidates for the sources of a target, each with its mapping from it.

    Tasks that are the target or another candidate up to an exact homomorphism are dropped, and
    those that cannot be learnt: where the goal is never reached from the start, every optimal
    policy avoids it, or the random policy is optimal. The order is the same in every run.

    Parameters
    ----------
    target : Task or FamilyMember
        With tables of at most 20 million pairs; a larger one is designed for on smaller members.
    kinds : sequence of str
        By default all of these, which take turns in this order:

        - ``"member"``: easier members of the target's family;
        - ``"crop"``: the part around the goal, of a task with `crop`;
        - ``"removed"``: without hazards, a predator, or penalties;
        - ``"deterministic"``: without chance;
        - ``"starts"``: starts near the goal;
        - ``"bottleneck"``: a doorway as the goal;
        - ``"coarser"``: neighbouring values of ordered components merged.
    most : int
        Candidates at most.
    propose : callable, optional
        A function of the target task that returns further :class:`SourceCandidate` of a user's own;
        they come first.

    Raises
    ------
    CurriculumError
        When a kind is unknown, `propose` returns something else, or no candidate is left.
    TaskError
        When the target has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> found = source_candidates(GridWorld(["S..P", ".#..", "...T"]), most=3)
    >>> [one.name for one in found]
    ['rows 1..2, columns 2..3', 'no pit at (0, 3)', 'starts 1..2 from the goal']
    """
    most = whole_number("the number of candidates", most, 1, CurriculumError)
    wanted = _checked_kinds(kinds, propose)
    found = design_target(target)
    if found.mdp.outcome_row.size > LARGEST:
        raise CurriculumError(
            f"candidates are made for targets of up to {LARGEST:,} state-action pairs: this one "
            f"has {found.mdp.outcome_row.size:,}"
        )
    drafts = [list(_own(found.task, propose))] if propose is not None else []
    drafts += [list(MAKERS[kind](found)) for kind in KINDS if kind in wanted]
    if not any(drafts):
        raise CurriculumError(_nothing_proposed(found, wanted))
    in_turns = (one for turn in zip_longest(*drafts) for one in turn if one is not None)
    return _judged_drafts(found, in_turns, most)


def _judged_drafts(target: DesignTarget, drafts: Iterable[Draft], most: int) -> SourceCandidates:
    """Return the drafts that are built, can be learnt and are new, in order; and the others."""
    known = {AS_TARGET: judged(target.mdp)}
    kept, dropped = list[SourceCandidate](), list[DroppedCandidate]()
    cut = False
    for draft in drafts:
        if len(kept) == most:
            cut = True
            break
        name = draft.name if draft.name not in known else f"{draft.name} ({draft.kind})"
        try:
            task, mappings = draft.build()
            of_draft = draft.kind, draft.words, draft.share, draft.member
            candidate = SourceCandidate(name, task, mappings, *of_draft)
            found = judged(tables(task), _goal_of(target, candidate))
        except CurricleError as error:
            dropped.append(DroppedCandidate(name, draft.kind, NOT_MADE, str(error)))
            continue
        reason, detail = _refusal(found, known)
        if reason:
            dropped.append(DroppedCandidate(name, draft.kind, reason, detail))
            continue
        known[name] = found
        kept.append(replace(candidate, optimum=found.optimum, random_return=found.random_return))
    candidates = SourceCandidates(target.task, tuple(kept), tuple(dropped), cut)
    if not kept:
        raise CurriculumError(
            f"a target needs a candidate that can be learnt: {candidates._reasons}"
        )
    return candidates


def _goal_of(target: DesignTarget, candidate: SourceCandidate) -> BoolArray | None:
    """Return the goal of a candidate, if only the target can tell; else its own rewards do.

    Where nothing ends either task, and chance was removed, the largest rewards may be elsewhere.
    """
    mdp = tables(candidate.task)
    if mdp.terminal.any() or target.mdp.terminal.any():
        return None
    read = np.concatenate([one.index[target.goal].ravel() for one in candidate.mappings])
    found = np.zeros(len(mdp.terminal), bool)
    found[read[read >= 0] // mdp.outcome_row.shape[1]] = True
    return found if found.any() else None


def _refusal(found: Judged, known: dict[str, Judged]) -> tuple[str, str]:
    """Return why a task is no candidate, and the candidate that it repeats; empty if it is one."""
    if found.refusal:
        return found.refusal, ""
    for name, one in known.items():
        if same_up_to_homomorphism(found, one):
            return (AS_TARGET, "") if name == AS_TARGET else (AS_ANOTHER, name)
    return "", ""


def _checked_kinds(kinds: Sequence[str], propose: Propose | None) -> tuple[str, ...]:
    if isinstance(kinds, str) or not isinstance(kinds, Sequence):
        raise CurriculumError(f"kinds of candidates must be a list: got {kinds!r}")
    for kind in kinds:
        one_of("a kind of candidates", kind, KINDS, CurriculumError)
    if not kinds and propose is None:
        raise CurriculumError("candidates need at least one kind, or propose: got neither")
    if propose is not None and not callable(propose):
        raise CurriculumError(f"propose must be a function of the target: got {propose!r}")
    return tuple(kinds)


def _nothing_proposed(target: DesignTarget, kinds: tuple[str, ...]) -> str:
    if target.member is not None and kinds == ("member",):
        return (
            "a family needs a member that is easier than the target: "
            f"{target.member} is the only one, or the easiest"
        )
    return f"the target has no candidates of the kinds {', '.join(kinds)}: give others, or propose"


def _own(target: Any, propose: Propose) -> Iterator[Draft]:
    """Yield what a user's function proposes, checked."""
    given = propose(target)
    if isinstance(given, SourceCandidate | str) or not isinstance(given, Iterable):
        raise CurriculumError(f"propose must return SourceCandidates, in a list: got {given!r}")
    names = set[str]()
    for one in given:
        if not isinstance(one, SourceCandidate):
            raise CurriculumError(f"propose must return SourceCandidates: got {one!r}")
        if one.name in names:
            raise CurriculumError(f"candidates need different names: {one.name!r} is given twice")
        if not all(same_task(mapping.target, target) for mapping in one.mappings):
            raise CurriculumError(
                "the mappings of a candidate must be from the target: one of "
                f"{one.name!r} is from another task"
            )
        names.add(one.name)
        generative_model(one.task)
        yield Draft(PROPOSED, one.name, one.words, _as_it_is(one))


def _as_it_is(one: SourceCandidate) -> Callable[[], Made]:
    return lambda: (one.task, one.mappings)


# -- whether a task can be learnt, and whether two are the same ----------------------------------


def judged(mdp: FiniteMDP, goal: BoolArray | None = None) -> Judged:
    """Return what is known of a task, and why it can be no candidate if it cannot.

    `goal`, (S,), is where it wants to get; by default what its rewards say (:func:`aims`).
    """
    n_states, n_actions = mdp.outcome_row.shape
    if mdp.outcome_row.size > LARGEST:
        return Judged(mdp, TOO_LARGE)
    try:
        best = solve(mdp)
        chance = evaluate(mdp, np.full((n_states, n_actions), 1 / n_actions))
    except CurricleError:
        return Judged(mdp, NO_SOLUTION)
    if refusal := _missed(mdp, aims(mdp) if goal is None else goal, best.optimal):
        return Judged(mdp, refusal)
    optimum, random_return = float(best.start_value), float(chance.start_value)
    error = best.error_bound + chance.error_bound
    error += ROUNDING * max(1.0, abs(optimum), abs(random_return))
    values = best.values[reachable_states(mdp)]
    return Judged(
        mdp,
        NOTHING_TO_LEARN if optimum - random_return <= error else "",
        optimum,
        random_return,
        np.array([optimum, values.min(), values.max()]),
    )


def _missed(mdp: FiniteMDP, goal: BoolArray, optimal: BoolArray) -> str:
    """Return why an episode misses the goal; empty if an optimal policy can reach it in time."""
    if mdp.terminal.any() and not mdp.terminal[goal].any():
        # It has ends, and none can be entered: its largest rewards are no goal.
        return NEVER_REACHED
    far = goal_distance(mdp, goal)[mdp.start_states]
    far = far[far >= 0]
    if not far.size or (mdp.time_limit is not None and int(far.min()) > mdp.time_limit):
        return NEVER_REACHED
    return "" if (reachable_states(mdp, optimal) & goal).any() else AVOIDED


def same_up_to_homomorphism(one: Judged, other: Judged) -> bool:
    """Return whether two tasks are one, up to an exact homomorphism of both onto the same task.

    Their states and actions may be numbered in any way, and one may have several states for one of
    the other. Discount, time limit, and the chance to start in each block are equal. Tasks whose
    fingerprints differ, the optimal values that homomorphisms keep, are not refined.
    """
    first, second = one.mdp, other.mdp
    if (first.discount, first.time_limit) != (second.discount, second.time_limit):
        return False
    if one.fingerprint is None or other.fingerprint is None:
        return False
    if not np.allclose(one.fingerprint, other.fingerprint, rtol=FINGERPRINT, atol=FINGERPRINT):
        return False
    if first.outcome_row.size + second.outcome_row.size > LARGEST:
        return first is second
    mine, others = refined([model_for_refinement(first), model_for_refinement(second)])
    blocks = int(max(mine.states.max(), others.states.max())) + 1
    start, other_start = (
        np.bincount(found.states, mdp.start, blocks)
        for found, mdp in ((mine, first), (others, second))
    )
    return bool(np.allclose(start, other_start, rtol=0, atol=ROUNDING))
