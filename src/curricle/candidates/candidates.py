"""Candidates for the sources of a target: drafts of all kinds, without useless and equal ones."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen
from curricle.candidates.kinds import (
    DesignTarget,
    Draft,
    aims,
    coarser_tables,
    crops,
    design_target,
    family_members,
    likeliest_outcomes,
    removals,
    start_rings,
)
from curricle.checks import fit_name, one_of, text, whole_number
from curricle.errors import CurricleError, CurriculumError
from curricle.planning.solution import evaluate, solve
from curricle.tasks.family import FamilyMember
from curricle.tasks.graph import reachable_states
from curricle.tasks.mdp import FiniteMDP, generative_model, same_task, tables
from curricle.tasks.start_states import goal_distance
from curricle.text import brief_repr, counted, printed
from curricle.transfer.bisimulation import model_for_refinement, refined
from curricle.transfer.mapping import TaskMapping

MAKERS: dict[str, Callable[[DesignTarget], Iterator[Draft]]] = {
    "member": family_members,
    "crop": crops,
    "removed": removals,
    "deterministic": likeliest_outcomes,
    "starts": start_rings,
    "coarser": coarser_tables,
}
KINDS = tuple(MAKERS)  # in the order of their turns
LARGEST = 20_000_000  # state-action pairs up to which a task is judged
ROUNDING = 1e-9  # largest difference of equal returns, in units of the larger return
FINGERPRINT = 1e-6  # difference that equal tasks never have, in units of the larger value
PROPOSED = "proposed"
AS_TARGET = "same as the target"

Propose = Callable[[Any], Iterable["SourceCandidate"]]


@dataclass(frozen=True, eq=False)
class SourceCandidate(Frozen):
    """A task that may be a source of the target, with mappings from the target.

    CurriculumError when the name is not valid, or `mappings` do not lead to the task.

    Parameters
    ----------
    name : str
        Name in a curriculum; every candidate of a target has a different name.
    task : Task
        A task with tables.
    mappings : StateActionMapping, ObservationMapping or sequence of them
        From the target to the task. There are several where the target reads the task in several
        ways: each of two predators can read the single predator of a smaller hunt.
    kind, words : str
        A kind of :func:`source_candidates`, or "proposed"; and a description for people.
    share : float, optional
        Size relative to the target: of a crop its share of the side, of starts near the goal their
        share of the largest distance.
    member : FamilyMember, optional
        The task's address, if it is a member of the target's family.
    optimum, random_return : float
        Expected discounted returns of an optimal policy and of the uniformly random policy from
        the task's start; NaN before it is judged.

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
        mappings = self.mappings if isinstance(self.mappings, Sequence) else (self.mappings,)
        if not mappings or not all(isinstance(mapping, TaskMapping) for mapping in mappings):
            raise CurriculumError(
                f"a candidate needs mappings from the target: {self.name!r} has {self.mappings!r}"
            )
        if any(mapping.source is not self.task for mapping in mappings):
            raise CurriculumError(
                f"the mappings of a candidate must lead to its task: one of {self.name!r} does not"
            )
        object.__setattr__(self, "mappings", tuple(mappings))

    @property
    def mapping(self) -> Any:
        """The first mapping."""
        return self.mappings[0]

    def __repr__(self) -> str:
        states = counted(self.task.states.size, "state")
        return f"SourceCandidate({self.name!r}, {self.kind}, {states})"


class DroppedCandidate(NamedTuple):
    """A draft that was dropped, and the reason."""

    name: str
    kind: str
    reason: str
    detail: str = ""  # text of the error, or name of the equal candidate


@dataclass(frozen=True, eq=False)
class SourceCandidates:
    """Candidates for the sources of a target, in order. Prints as a table.

    Attributes
    ----------
    target : Task
    candidates : tuple of SourceCandidate
        The candidates; their kinds take turns.
    dropped : tuple of DroppedCandidate
        The drafts that were dropped before `most` candidates were complete.
    cut : bool
        Whether `most` ended the list before all drafts were judged.
    """

    target: Any
    candidates: tuple[SourceCandidate, ...]
    dropped: tuple[DroppedCandidate, ...]
    cut: bool

    __repr__ = brief_repr
    _repr_html_ = printed

    def __len__(self) -> int:
        return len(self.candidates)

    def __iter__(self) -> Iterator[SourceCandidate]:
        return iter(self.candidates)

    def __getitem__(self, name: str) -> SourceCandidate:
        by_name = {candidate.name: candidate for candidate in self.candidates}
        one_of("a candidate", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def reasons(self) -> str:
        """The reasons for dropping drafts with their counts, the most frequent first."""
        counts = Counter(dropped.reason for dropped in self.dropped).most_common()
        return "; ".join(f"{n} {reason}" for reason, n in counts)

    def __str__(self) -> str:
        width = max(len(candidate.name) for candidate in self.candidates)
        lines = [f"{'':{width}}  {'kind':<13}{'states':>9}{'optimum':>10}{'random':>10}"]
        for source in self.candidates:
            states = source.task.states.size
            numbers = f"{states:>9,}{source.optimum:>10.4g}{source.random_return:>10.4g}"
            lines.append(f"{source.name:{width}}  {source.kind:<13}{numbers}")
        dropped = len(self.dropped)
        lines += [f"dropped {dropped} of {dropped + len(self)}: {self.reasons}"] * bool(dropped)
        lines += [f"cut at {len(self)}: there is more to look at"] * self.cut
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Judged:
    """A task with its returns, and numbers that differ between most tasks."""

    mdp: FiniteMDP
    refusal: str  # why the task is no candidate; empty if it is
    optimum: float = float("nan")
    random_return: float = float("nan")
    fingerprint: FloatArray | None = None


def source_candidates(
    target: object, *, kinds: Sequence[str] = KINDS, most: int = 20, propose: Propose | None = None
) -> SourceCandidates:
    """Return candidates for the sources of a target, with their mappings from the target.

    A task is dropped if it equals the target or another candidate up to an exact homomorphism, or
    if it cannot be learnt: no path leads from the start to the goal, every optimal policy avoids
    the goal, or the random policy is optimal. The order is the same in every run.

    Parameters
    ----------
    target : Task or FamilyMember
        A task or member with tables of at most 20 million pairs.
    kinds : sequence of str
        Kinds of candidates, by default all, which take turns in this order:

        - ``"member"``: easier members of the target's family;
        - ``"crop"``: the part around the goal, of a task with `crop` and `layout`;
        - ``"removed"``: the target without hazards, a predator, or penalties;
        - ``"deterministic"``: the target without chance;
        - ``"starts"``: the target with starts near the goal;
        - ``"coarser"``: the target with neighbouring values of ordered components merged.
    most : int
        Most candidates to return.
    propose : callable, optional
        Takes the target task and returns further candidates, :class:`SourceCandidate`, to judge
        first.

    Raises
    ------
    CurriculumError
        When a kind is unknown, `propose` returns something else, or no candidate is left.
    TaskError
        When the target has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> candidates = source_candidates(GridWorld(["S..P", ".#..", "...T"]), most=3)
    >>> [candidate.name for candidate in candidates]
    ['rows 1..2, columns 2..3', 'no pit at (0, 3)', 'starts 1..2 from the goal']
    """
    most = whole_number("the number of candidates", most, 1, CurriculumError)
    wanted = _checked_kinds(kinds, propose)
    target = design_target(target)
    if target.mdp.outcome_row.size > LARGEST:
        raise CurriculumError(
            f"candidates are made for targets of up to {LARGEST:,} state-action pairs: this one "
            f"has {target.mdp.outcome_row.size:,}"
        )
    drafts = [list(_proposed(target.task, propose))] if propose is not None else []
    drafts += [list(MAKERS[kind](target)) for kind in KINDS if kind in wanted]
    if not any(drafts):
        if target.member is not None and wanted == ("member",):
            raise CurriculumError(
                "a family needs a member that is easier than the target: "
                f"{target.member} is the only one, or the easiest"
            )
        raise CurriculumError(
            f"the target has no candidates of the kinds {', '.join(wanted)}: give others, or "
            "propose"
        )
    judgements = {AS_TARGET: judged(target.mdp)}
    kept, dropped, cut = list[SourceCandidate](), list[DroppedCandidate](), False
    for draft in (draft for turn in zip_longest(*drafts) for draft in turn if draft is not None):
        if len(kept) == most:
            cut = True
            break
        name = draft.name if draft.name not in judgements else f"{draft.name} ({draft.kind})"
        try:
            task, mappings = draft.build()
            of_draft = draft.kind, draft.words, draft.share, draft.member
            candidate = SourceCandidate(name, task, mappings, *of_draft)
            judgement = judged(tables(task), _goal_of(target, candidate))
        except CurricleError as error:
            dropped.append(DroppedCandidate(name, draft.kind, "cannot be made", str(error)))
            continue
        same = (key for key in judgements if same_up_to_homomorphism(judgement, judgements[key]))
        reason, detail = judgement.refusal, ""
        if not reason and (key := next(same, None)) is not None:
            another = "same as another candidate", key
            reason, detail = (key, "") if key == AS_TARGET else another
        if reason:
            dropped.append(DroppedCandidate(name, draft.kind, reason, detail))
            continue
        judgements[name] = judgement
        returns: Any = {"optimum": judgement.optimum, "random_return": judgement.random_return}
        kept.append(replace(candidate, **returns))
    candidates = SourceCandidates(target.task, tuple(kept), tuple(dropped), cut)
    if not kept:
        raise CurriculumError(
            f"a target needs a candidate that can be learnt: {candidates.reasons}"
        )
    return candidates


def candidate_named(target: object, kind: str, name: str) -> SourceCandidate:
    """Return the candidate of a target with this kind and name, without judging any candidate."""
    for draft in MAKERS[kind](design_target(target)):
        if name in (draft.name, f"{draft.name} ({kind})"):
            task, mappings = draft.build()
            return SourceCandidate(name, task, mappings, kind, draft.words)
    raise CurriculumError(f"a target must have the candidate that is named: it has no {name!r}")


def _goal_of(target: DesignTarget, candidate: SourceCandidate) -> BoolArray | None:
    """Return the source states that the target's goal reads; None if either task has an end."""
    # Without chance, the largest rewards of a task without an end may be in other states.
    mdp = tables(candidate.task)
    if mdp.terminal.any() or target.mdp.terminal.any():
        return None
    read = np.concatenate([m.index[target.goal].ravel() for m in candidate.mappings])
    goal = np.zeros(len(mdp.terminal), bool)
    goal[read[read >= 0] // mdp.outcome_row.shape[1]] = True
    return goal if goal.any() else None


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


def _proposed(target: Any, propose: Propose) -> Iterator[Draft]:
    """Yield the candidates that a user's function proposes, checked."""
    proposed = propose(target)
    if isinstance(proposed, SourceCandidate | str) or not isinstance(proposed, Iterable):
        raise CurriculumError(f"propose must return SourceCandidates, in a list: got {proposed!r}")
    names = set[str]()
    for candidate in proposed:
        if not isinstance(candidate, SourceCandidate):
            raise CurriculumError(f"propose must return SourceCandidates: got {candidate!r}")
        name = candidate.name
        if name in names:
            raise CurriculumError(f"candidates need different names: {name!r} is there twice")
        if not all(same_task(mapping.target, target) for mapping in candidate.mappings):
            raise CurriculumError(
                "the mappings of a candidate must be from the target: one of "
                f"{name!r} is from another task"
            )
        names.add(name)
        generative_model(candidate.task)
        build = partial(tuple, (candidate.task, candidate.mappings))
        yield Draft(PROPOSED, name, candidate.words, build)


# -- whether a task can be learnt, and whether two tasks are the same ----------------------------


def judged(mdp: FiniteMDP, goal: BoolArray | None = None) -> Judged:
    """Return a task with its returns or its refusal; `goal`, (S,), is by default :func:`aims`."""
    if mdp.outcome_row.size > LARGEST:
        return Judged(mdp, "too large to be judged")
    try:
        best = solve(mdp)
        chance = evaluate(mdp, mdp.random_policy)
    except CurricleError:
        return Judged(mdp, "no exact solution")
    goal = aims(mdp) if goal is None else goal
    # A task whose ends cannot be entered has no goal, whatever its largest rewards are.
    endless = mdp.terminal.any() and not mdp.terminal[goal].any()
    far = goal_distance(mdp, goal)[mdp.start_states]
    far = far[far >= 0]
    late = mdp.time_limit is not None and far.size and int(far.min()) > mdp.time_limit
    if endless or not far.size or late:
        return Judged(mdp, "goal never reached from the start")
    if not (reachable_states(mdp, best.optimal) & goal).any():
        return Judged(mdp, "goal avoided by every optimal policy")
    optimum, random_return = float(best.start_value), float(chance.start_value)
    error = best.error_bound + chance.error_bound
    error += ROUNDING * max(abs(optimum), abs(random_return))
    values = best.values[reachable_states(mdp)]
    pointless = optimum - random_return <= error
    refusal = "nothing to learn: the random policy is optimal" if pointless else ""
    fingerprint = np.array([optimum, values.min(), values.max()])
    return Judged(mdp, refusal, optimum, random_return, fingerprint)


def same_up_to_homomorphism(task: Judged, other: Judged) -> bool:
    """Return whether exact homomorphisms map both tasks onto one task."""
    first, second = task.mdp, other.mdp
    if (first.discount, first.time_limit) != (second.discount, second.time_limit):
        return False
    if task.fingerprint is None or other.fingerprint is None:
        return False
    if not np.allclose(task.fingerprint, other.fingerprint, rtol=FINGERPRINT, atol=FINGERPRINT):
        return False
    if first.outcome_row.size + second.outcome_row.size > LARGEST:
        return first is second
    partitions = refined([model_for_refinement(first), model_for_refinement(second)])
    blocks = int(max(partition.states.max() for partition in partitions)) + 1
    start, other_start = (
        np.bincount(partition.states, mdp.start, blocks)
        for partition, mdp in zip(partitions, (first, second), strict=True)
    )
    return bool(np.allclose(start, other_start, rtol=0, atol=ROUNDING))
