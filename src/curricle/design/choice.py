"""Choosing a curriculum: candidates and opponents are played in the target's model beforehand.

Every candidate source is played at some source budgets and scales. All learn on a few seeds; the
better half, without those that are shown to be worse than the leader, learns on more, until few are
left. These finalists then meet all opponents on seeds that none of them was chosen on, so that the
verdict on them is that of any comparison. A trial's seeds are none that an experiment has unless it
asks for them. Curricula of candidates enter by ``QInitialisation()``, unguarded: the trial shows
what a guard would be for.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from math import log
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import number, whole_number
from curricle.comparison.comparison import (
    Arm,
    Comparison,
    checkpoints,
    comparison_of,
    comparison_plan,
    short,
    threshold_before,
    trained_arms,
)
from curricle.comparison.opponents import OPPONENTS, Opponent
from curricle.comparison.plan import Memory, Plan, most_source_steps
from curricle.comparison.trial import WINDOW, hindrance, node_seconds
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import DEFAULT_STEPS
from curricle.design.candidates import KINDS, MAKERS, SourceCandidate, source_candidates
from curricle.design.kinds import DesignTarget, Draft, design_target, family_members
from curricle.display import block, table
from curricle.errors import CurricleError, CurriculumError, SettingError, TaskError, in_words
from curricle.learning.shaping import QInitialisation
from curricle.learning.stopping import StoppingRule
from curricle.progress import Bars, Progress, shown
from curricle.statistics.curves import SCRATCH, mean_return
from curricle.statistics.intervals import Interval, mean_interval
from curricle.tasks.family import FamilyMember
from curricle.tasks.mdp import has_tables
from curricle.text import UNBOUNDED, brief_repr, counted, folded, text_table
from curricle.transfer.aggregate import minimum
from curricle.transfer.transfer import Transfer, numbered

SHARES = (0.02, 0.05, 0.15)  # source steps, as shares of the target's
SCALES = (1.0, 2.0)  # of the source's values
MOST = 10  # candidates that are played
ROUNDS = (4, 4, 8, 16)  # seeds that each round adds, for the better half of the one before
FINALISTS, FINAL_SEEDS = 3, 20  # curricula that meet all opponents, and on how many fresh seeds
FIRST_SEED, SEEDS_APART = 2_000_000, 1_000  # of a trial, and between those of two choices
SECONDS = 150.0  # estimated seconds on one processor up to which candidates are played
WITHOUT_SOURCE: tuple[Opponent, ...] = ("bounds", "optimistic")  # rounds need no potential for them
TARGET = "target"  # its name, without curricula of the user's
OF_TARGET = ("learner", "budget", "eval_freq", "evaluation", "storage")

# -- The curricula that are played -----------------------------------------------------------------


class Option(NamedTuple):
    """A candidate with a source budget and a scale."""

    name: str
    candidate: SourceCandidate
    steps: int
    scale: float


def options_of(candidates: Sequence[SourceCandidate], budget: int) -> Iterator[Option]:
    """Yield every candidate at each source budget and scale, for a target's budget in steps."""
    for candidate in candidates:
        for share in SHARES:
            for scale in SCALES:
                times = "" if scale == 1 else f", x {scale:g}"
                name = f"{candidate.name}, {share:.0%}{times}"
                yield Option(name, candidate, max(1, int(share * budget)), scale)


def curriculum_of(
    option: Option, target: str, task: Any, settings: Mapping[str, Any]
) -> Curriculum:
    """Return the curriculum of an option; `settings` are those of the target."""
    candidate, budget = option.candidate, settings.get("budget", DEFAULT_STEPS)
    of_both = {key: settings[key] for key in settings if key not in ("budget", "eval_freq")}
    return Curriculum(
        {candidate.name: candidate.task, target: task},
        [Transfer(candidate.name, target, f, option.scale) for f in candidate.mappings],
        aggregate=minimum,
        shaping=QInitialisation(),
        budget={candidate.name: StoppingRule(option.steps), target: budget},
        eval_freq={target: settings.get("eval_freq")},
        **of_both,
    )


# -- The result ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Choice:
    """The curriculum to learn a target with, if any. Prints as a sentence and a table.

    Attributes
    ----------
    name : str
        The chosen curriculum, by its source, the source's share of the target's steps, and the
        scale where it is not 1; empty if none pays.
    curriculum : Curriculum or None
        The chosen curriculum; None if none pays.
    alone : str
        The best opponent, which needs no source.
    comparison : Comparison
        The finalists against all opponents, on seeds that no finalist was chosen on.
    rows : tuple of dict
        One for each curriculum that was played, the best first: name, source_steps, seeds,
        mean_return, gain, gain_low, gain_high (over the best opponent, in mean return, sources
        charged), and answer: the verdict of a finalist, or when it was left out.
    remarks : tuple of str
        Sentences on candidates that failed or were not played, and on where it was played.
    """

    name: str
    curriculum: Curriculum | None
    alone: str
    comparison: Comparison = field(repr=False)
    rows: tuple[Mapping[str, Any], ...] = field(repr=False)
    remarks: tuple[str, ...] = ()

    __repr__ = brief_repr

    @property
    def sentence(self) -> str:
        """The choice, in a sentence."""
        best = self.name or self.rows[0]["name"]
        verdict = self.comparison.verdicts[best]
        seeds = f"{self.comparison.seeds} fresh seeds"
        gain = f"{short(verdict.gain)} in mean return on {seeds}"
        if self.name:
            return (
                f"{best}: gains {gain} more than {self.alone} alone (p = {verdict.adjusted_p:.2g})"
            )
        well = "better" if verdict.direction < 0 else "as well"
        return f"no curriculum: {self.alone} alone does {well} (the best, {best}, gains {gain})"

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the sentence and the table in lines of at most `width` characters."""
        rows = [_cells(row) for row in self.rows[:SHOWN]]
        lines = [folded(self.sentence, width), *text_table(HEADS, rows, width, prose=True)]
        return "\n".join([*lines, *(folded(remark, width) for remark in self._remarks)])

    def _repr_html_(self) -> str:
        rows = [_cells(row) for row in self.rows]
        return block(self.sentence, table(HEADS, rows, wide=HEADS[-1:]), *self._remarks)

    @property
    def _remarks(self) -> list[str]:
        others = len(self.rows) - SHOWN
        return [*([f"and {others} more"] if others > 0 else []), *self.remarks]


SHOWN = 8  # rows of a printed table
HEADS = ("", "source steps", "seeds", "mean return", "gain over the best opponent", "answer")


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    numbers = (row["gain"], row["gain_low"], row["gain_high"])
    gain = short(Interval(*numbers, 0.95, row["seeds"]))
    steps, seeds = f"{row['source_steps']:,.0f}", f"{row['seeds']}"
    return row["name"], steps, seeds, f"{row['mean_return']:.4g}", gain, row["answer"]


def alone_words(comparison: Comparison) -> str:
    """Return the opponent with the highest mean return, in words."""
    best = max(comparison.scratches, key=lambda name: float(comparison.returns[name].mean()))
    values = comparison[best].initial_values
    if values is not None:
        return f"initial_value={values.mean():.4g}"
    return "learning from scratch" if best == SCRATCH else best.removeprefix(f"{SCRATCH}, ")


# -- Halving ---------------------------------------------------------------------------------------

Play = Callable[[Sequence[str], tuple[int, ...], Sequence[Opponent]], tuple[Plan, dict[str, Arm]]]
"""Names of curricula, seeds and opponents -> their plan, and its arms that were trained."""


def chosen(
    names: Sequence[str], play: Play, seed: int = 0
) -> tuple[str, Comparison, tuple[dict[str, Any], ...]]:
    """Return the curriculum that pays most, or "", the finalists' comparison, and all rows."""
    first, left = FIRST_SEED + whole_number("seed", seed, 0, SettingError) * SEEDS_APART, [*names]
    returns, rows = dict[str, FloatArray](), dict[str, dict[str, Any]]()
    for n, seeds in enumerate(ROUNDS, 1):
        _, arms = play(left, tuple(range(first, first + seeds)), WITHOUT_SOURCE)
        first += seeds
        for name, arm in arms.items():
            batch = mean_return(arm.charged(arms[SCRATCH]))
            returns[name] = np.append(returns.get(name, []), batch)
        rivals = [returns[name] for name, arm in arms.items() if arm.scratch or name == SCRATCH]
        rival = max(rivals, key=lambda values: float(values.mean()))
        ranked = sorted((name for name in left if name in arms), key=lambda x: -returns[x].mean())
        for name in ranked:
            gain, steps = mean_interval(returns[name] - rival), arms[name].curve.source_steps
            rows[name] = _row(name, steps, returns[name], gain, f"left out after round {n}")
        better = ranked[: max(FINALISTS, -(-len(ranked) // 2))]
        left = [x for x in better if _may_exceed(returns[x], returns[ranked[0]])]
        hopeless = not any(_may_exceed(returns[x], rival) for x in left)
        if hopeless or len(left) <= FINALISTS:
            break
    finalists = left[:FINALISTS]
    plan, arms = play(finalists, tuple(range(first, first + FINAL_SEEDS)), OPPONENTS)
    level, window = threshold_before(plan, None), min(WINDOW, checkpoints(plan))
    comparison = comparison_of(plan, arms, level, window, {})
    for name in comparison.verdicts:
        steps, gain = comparison[name].curve.source_steps, comparison.contrasts[name].strong_gain
        answer = f"{comparison.contrasts[name].verdict}, against {comparison.best_opponent(name)}"
        rows[name] = _row(name, steps, comparison.returns[name], gain, answer)
    last = sorted(comparison.verdicts, key=lambda name: -rows[name]["mean_return"])
    order = [*last, *(x for x in sorted(rows, key=lambda x: -rows[x]["gain"]) if x not in last)]
    pays = [name for name in last if comparison.verdicts[name].direction > 0]
    best = pays[0] if pays else ""
    return best, comparison, tuple(rows[name] for name in sorted(order, key=lambda x: x != best))


def _may_exceed(returns: FloatArray, others: FloatArray) -> bool:
    """Return whether a mean return may be as high as another; it may if no interval tells."""
    return not mean_interval(returns - others).high < 0


def _row(name: str, steps: Any, returns: FloatArray, gain: Interval, answer: str) -> dict[str, Any]:
    return {
        "name": name,
        "source_steps": float(steps.mean()),
        "seeds": len(returns),
        "mean_return": float(returns.mean()),
        "gain": float(gain.estimate),
        "gain_low": float(gain.low),
        "gain_high": float(gain.high),
        "answer": answer,
    }


def affordable(curricula: Mapping[str, Curriculum], seconds: float) -> int:
    """Return how many of some curricula can be played in so many seconds, as estimated."""
    first = next(iter(curricula.values()))
    node = first.node(first.target)
    total = node.most_steps + max(map(most_source_steps, curricula.values()))
    # The second half of the rounds costs about as much as the first, with half the arms in each.
    opponents = 4 * (sum(ROUNDS) + FINAL_SEEDS) + FINALISTS * 4 * FINAL_SEEDS
    seeds = seconds / node_seconds(node, total) - opponents
    return int(seeds / sum(n / 2**k for k, n in enumerate(ROUNDS)))


# -- Choosing --------------------------------------------------------------------------------------


def choose(
    target: Any,
    candidates: Sequence[Any] | Mapping[str, Curriculum] = (),
    *,
    kinds: Sequence[str] = KINDS,
    most: int = MOST,
    on: Any = None,
    seed: int = 0,
    seconds: float = SECONDS,
    workers: int | None = None,
    progress: Progress = None,
    **settings: Any,
) -> Choice:
    """Return which curriculum to learn a target with, if any, by trials in its model.

    Each source is tried with 2, 5 and 15 % of the target's steps and its values times 1 and 2;
    several mappings are joined by :func:`minimum`, and potentials enter by ``QInitialisation()``
    without a guard. The better half of each round gets more seeds; the last three meet all
    opponents (as in :func:`compare`) on 20 fresh seeds. Nothing of an experiment is used up: the
    seeds of trials begin at 2,000,000. Equal seeds give equal choices. ``curricle.choose`` also
    takes a study or its path, whose arms are then candidates too.

    Parameters
    ----------
    target : Task or FamilyMember
        With tables, as :func:`source_candidates` needs them.
    candidates : sequence of SourceCandidate and Curriculum, or dict of str to Curriculum
        Further candidates; curricula are played as they are.
    kinds : sequence of str
        The kinds of candidates that are made; none if empty.
    most : int
        Most candidates that are made, `candidates` that are sources included.
    on : Task or FamilyMember, optional
        A smaller relative in which to choose instead. The kind of source, the relation of its size
        to the target's, its steps a state and its scale are then carried over; target steps a state
        are equal.
    seed : int
    seconds : float
        Estimated seconds on one processor up to which candidates are played, in their order.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each round; a function is called with the name of each trained arm.
    **settings
        The target's ``budget`` (100,000 steps), ``learner``, ``eval_freq``, ``evaluation`` and
        ``storage``, as a :class:`Curriculum` takes them; those of curricula in `candidates` if
        there are any.

    Returns
    -------
    Choice
        With a curriculum only if it gains more than the best of all opponents (p < .05, corrected
        for three finalists).

    Raises
    ------
    TaskError, CurriculumError, SettingError
        When the target has no model or no candidates, or takes too long: name a smaller relative
        with `on`.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> choice = choose(Pursuit(size=3, predators=2), kinds=["removed"], budget=20_000)
    >>> choice.name, choice.curriculum.order
    ('one predator fewer, 15%, x 2', ('one predator fewer', 'target'))
    """
    how: dict[str, Any] = {"kinds": kinds, "most": most, "seed": seed, "seconds": seconds}
    how |= {"workers": workers, "progress": progress}
    if on is not None:
        return _carried_over(target, on, candidates, settings, how)
    return _tried(target, candidates, settings, **how)[0]


def _tried(
    target: Any,
    candidates: Sequence[Any] | Mapping[str, Curriculum],
    settings: Mapping[str, Any],
    *,
    kinds: Sequence[str],
    most: int,
    seed: int,
    seconds: float,
    workers: int | None,
    progress: Progress,
) -> tuple[Choice, dict[str, Option]]:
    """Return the choice of a target with a model, and the options that were made for it."""
    curricula, options = trial_curricula(target, candidates, kinds, most, settings)
    curricula, remarks = played(curricula, seconds)
    memory, failed, rounds = Memory(), dict[str, Exception](), 0
    total = comparison_plan(curricula, memory).steps[1]

    def play(
        names: Sequence[str], seeds: tuple[int, ...], opponents: Sequence[Opponent]
    ) -> tuple[Plan, dict[str, Arm]]:
        nonlocal rounds
        rounds += 1
        some = {name: curricula[name] for name in names}
        plan = comparison_plan(some, memory, (), opponents, least_total=total)
        grow = bars.bar(round_words(rounds, some, seeds), len(plan.arms))

        def tell(name: str) -> None:
            grow()
            bars.tell(name)

        return plan, trained_arms(plan, seeds, failed, memory, workers, Bars(call=tell))

    with shown(progress) as bars:
        name, comparison, rows = chosen([*curricula], play, seed)
    failures = (f"{arm} failed: {in_words(error)}" for arm, error in failed.items())
    curriculum, alone = curricula.get(name), alone_words(comparison)
    choice = Choice(name, curriculum, alone, comparison, rows, (*remarks, *failures))
    return choice, options


def round_words(number: int, names: Collection[str], seeds: Sequence[int]) -> str:
    """Return what is played in a round, as text."""
    return f"round {number}: {counted(len(seeds), 'seed')} of {len(names)} and their opponents"


def trial_curricula(
    target: Any,
    candidates: Sequence[Any] | Mapping[str, Curriculum],
    kinds: Sequence[str],
    most: int,
    settings: Mapping[str, Any],
) -> tuple[dict[str, Curriculum], dict[str, Option]]:
    """Return the curricula to play by name, and the options that some of them are."""
    if isinstance(candidates, str) or not isinstance(candidates, Sequence | Mapping):
        raise CurriculumError(f"candidates must be a list, or a dict by name: got {candidates!r}")
    named = isinstance(candidates, Mapping)
    stated = [*candidates.values()] if isinstance(candidates, Mapping) else [*candidates]
    for candidate in stated:
        if not isinstance(candidate, Curriculum | SourceCandidate):
            raise CurriculumError(
                f"candidates must be curricula or SourceCandidates: got {candidate!r}"
            )
    own = [candidate for candidate in stated if isinstance(candidate, Curriculum)]
    sources = [candidate for candidate in stated if isinstance(candidate, SourceCandidate)]
    of_sources = numbered([", ".join(plan.ancestors(plan.target)) for plan in own])
    curricula = dict(zip(candidates if named else of_sources, own, strict=True))
    name, options = TARGET, dict[str, Option]()
    if own:
        name = own[0].target
        settings = {key: own[0].setting(key, name) for key in OF_TARGET} | {**settings}
    if kinds or sources:
        task = target.task if isinstance(target, FamilyMember) else target
        if not has_tables(task):
            raise TaskError(f"{task!r} has no model to choose in: name a smaller relative with on=")
        budget = whole_number("budget", settings.get("budget", DEFAULT_STEPS), 1, SettingError)
        propose = (lambda _: sources) if sources else None
        found = source_candidates(target, kinds=kinds, most=most, propose=propose)
        for option in options_of(found.candidates, budget):
            options[option.name] = option
            curricula[option.name] = curriculum_of(option, name, found.target, settings)
    if not curricula:
        raise CurriculumError("there must be candidates to choose from: give kinds or candidates")
    return curricula, options


def played(
    curricula: Mapping[str, Curriculum], seconds: float
) -> tuple[dict[str, Curriculum], list[str]]:
    """Return the curricula that can be played in so many seconds, and a sentence on the others."""
    for curriculum in curricula.values():
        if why := hindrance(curriculum):
            raise TaskError(
                f"curricula are tried in models, and {why}: use on=, a smaller relative"
            )
    number("seconds", seconds, SettingError, 0)
    most = affordable(curricula, seconds)
    if most >= len(curricula):
        return dict(curricula), []
    if most < 1:
        raise SettingError(
            f"trials must take at most {seconds:g} s, and those of this target take longer by "
            "estimate: choose on a smaller relative with on=, or raise seconds"
        )
    remark = f"{most} of {len(curricula)} curricula were played: all would take over {seconds:g} s"
    return dict(islice(curricula.items(), most)), [remark]


# -- Carried over from a smaller relative ----------------------------------------------------------

FEWEST_STEPS = 1_000  # of the relative as a target
MOST_DRAFTS = 50  # of the target that are looked at


def _carried_over(
    target: Any, on: Any, candidates: Any, settings: dict[str, Any], how: dict[str, Any]
) -> Choice:
    """Return the choice on a smaller relative, in its place for a target."""
    task, relative = (x.task if isinstance(x, FamilyMember) else x for x in (target, on))
    budget = whole_number("budget", settings.get("budget", DEFAULT_STEPS), 1, SettingError)
    relation = relative.states.size / task.states.size
    steps = max(FEWEST_STEPS, round(budget * relation))
    there = {**settings, "budget": steps}
    there.pop("eval_freq", None)
    choice, options = _tried(on, candidates, there, **how)
    remark = (
        f"played in a relative with {relative.states.size:,} states instead of "
        f"{task.states.size:,}, in {steps:,} steps instead of {budget:,}; assumes that what pays "
        "there pays in the target"
    )
    option = options.get(choice.name)
    if option is None:  # none pays, or a curriculum of the user's, which only he can carry over
        return replace(choice, curriculum=None, remarks=(*choice.remarks, remark))
    states = option.candidate.task.states.size
    share, a_state = states / relative.states.size, option.steps / states
    words = (
        f"carried over: a source of kind {option.candidate.kind!r}, with {share:.3g} of the "
        f"target's states, {a_state:.3g} steps a state of its own, scale {option.scale:g}"
    )
    source, curriculum = _counterpart(target, option, on), None
    if source is None:
        words += "; none can be made of the target itself: build it by hand"
    else:
        spent = max(1, round(a_state * source.task.states.size))
        words += f": {source.name}, {source.task.states.size:,} states, {spent:,} steps"
        carried = option._replace(candidate=source, steps=spent)
        curriculum = curriculum_of(carried, TARGET, task, {**settings, "budget": budget})
    return replace(choice, curriculum=curriculum, remarks=(*choice.remarks, remark, words))


def _counterpart(target: Any, option: Option, on: Any) -> SourceCandidate | None:
    """Return the target's source that is as an option's is to a smaller relative; None if none."""
    like, member = option.candidate, isinstance(target, FamilyMember)
    if like.kind not in MAKERS or not (member if like.kind == "member" else has_tables(target)):
        return None
    drafts = (
        family_members(DesignTarget(None, target, None, None))
        if like.kind == "member"
        else MAKERS[like.kind](design_target(target))
    )
    whole, relative = (x.task if isinstance(x, FamilyMember) else x for x in (target, on))
    wanted = like.task.states.size / relative.states.size

    def distance(draft: Draft) -> tuple[bool, float]:
        if draft.member is not None and like.member is not None:
            changed = _changed(draft.member, target) != _changed(like.member, on)
            return changed, abs(log(draft.member.task.states.size / whole.states.size / wanted))
        if draft.share is not None and like.share is not None:
            return False, abs(draft.share - like.share)
        return draft.words != like.words, 0.0

    for draft in sorted(islice(drafts, MOST_DRAFTS), key=distance):
        with suppress(CurricleError):
            task, mappings = draft.build()
            return SourceCandidate(draft.name, task, mappings, draft.kind, draft.words)
    return None


def _changed(member: FamilyMember, of: FamilyMember) -> set[str]:
    """Return the parameters in which two members differ."""
    return {name for name, value in member.parameters.items() if of.parameters[name] != value}
