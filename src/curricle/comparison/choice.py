"""Choosing a curriculum: trials of candidates and opponents in the target's model.

Every candidate source is played at several source budgets, scales and ways in, on a few seeds. In
each round the better half is kept, without curricula that are shown to be worse than the leader,
and played on more seeds, until a few finalists are left. The finalists meet all opponents on fresh
seeds, which no finalist was chosen on and no experiment has by default.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice, product
from math import log
from typing import Any, NamedTuple, cast

import numpy as np

from curricle.arrays import FloatArray
from curricle.candidates.candidates import KINDS, MAKERS, SourceCandidate, source_candidates
from curricle.candidates.kinds import DesignTarget, Draft, design_target, family_members
from curricle.checks import whole_number
from curricle.comparison.comparison import Comparison, comparison_plan, trained_comparison
from curricle.comparison.measures import Arm, Reference
from curricle.comparison.opponents import OPPONENTS
from curricle.comparison.plan import Memory, Plan
from curricle.comparison.sentences import (
    columns_of,
    interval_of,
    nothing_learnt,
    short,
    without_source,
)
from curricle.comparison.task_differences import differences
from curricle.comparison.trial import WINDOW, hindrance
from curricle.curriculum.curriculum import DEFAULT_STEPS, Curriculum
from curricle.errors import CurricleError, CurriculumError, SettingError, TaskError, in_words
from curricle.learning.shaping import QInitialisation
from curricle.learning.stopping import StoppingRule
from curricle.learning.storage import Storage
from curricle.progress import Bars, Progress, shown
from curricle.statistics.intervals import Interval, mean_interval
from curricle.tasks.family import FamilyMember
from curricle.tasks.mdp import Task, has_tables
from curricle.text import UNBOUNDED, brief_repr, folded, printed, text_table
from curricle.transfer.aggregate import minimum
from curricle.transfer.transfer import Transfer, numbered

SHARES = (0.02, 0.05, 0.15)  # source steps, as shares of the target's steps
WAYS = ((1.0, False), (2.0, False), (1.0, True))
"""Ways in: the scale of the source's values, and whether the default portfolio has them.

A smaller share of the portfolio's optimist was offered too, and gained in none of ten targets."""
MOST = 10  # candidates made by default
ROUNDS = (4, 4, 8, 16)  # seeds that each round adds; every round keeps the better half
FINALISTS, FINAL_SEEDS = 3, 20  # curricula that meet all opponents, and the number of fresh seeds
FIRST_SEED, SEEDS_APART = 2_000_000, 1_000  # of trials; from one choice to the next
TARGET = "target"  # name of the target where the user passes no curriculum
OF_TARGET = ("learner", "budget", "eval_freq", "evaluation", "storage")
SHOWN = 8  # rows of a printed table
HEADS = ("", "source steps", "seeds", "mean return", "gain over the best opponent", "answer")

# -- The curricula that are played, and the result -------------------------------------------------


class Option(NamedTuple):
    """A candidate with a source budget and a way in."""

    name: str
    candidate: SourceCandidate
    steps: int
    scale: float
    portfolio: bool

    def curriculum(self, target: str, task: Task, settings: Mapping[str, Any]) -> Curriculum:
        """Return the curriculum of a target; `settings` are the target's."""
        name, budget = self.candidate.name, settings.get("budget", DEFAULT_STEPS)
        of_both = {key: settings[key] for key in settings if key not in ("budget", "eval_freq")}
        if isinstance(storage := of_both.get("storage"), Storage):  # the source's values are read
            dense = replace(storage, kind="auto", save_values=True)
            of_both["storage"] = {target: storage, name: dense}
        if not self.portfolio:  # which is the default, where the target's learner may have one
            of_both["shaping"] = QInitialisation()
        return Curriculum(
            {name: self.candidate.task, target: task},
            [Transfer(name, target, mapping, self.scale) for mapping in self.candidate.mappings],
            aggregate=minimum,
            budget={name: StoppingRule(self.steps), target: budget},
            eval_freq={target: settings.get("eval_freq")},
            **of_both,
        )


def options_of(candidates: Sequence[SourceCandidate], budget: int) -> Iterator[Option]:
    """Yield all candidates at each source budget and way in; `budget` is the target's, in steps."""
    for candidate, share, (scale, portfolio) in product(candidates, SHARES, WAYS):
        name = f"{candidate.name}, {share:.0%}" + f", x {scale:g}" * (scale != 1)
        name += ", portfolio" * portfolio
        yield Option(name, candidate, max(1, int(share * budget)), scale, portfolio)


@dataclass(frozen=True, eq=False)
class Choice:
    """The curriculum to learn a target with, if any. Prints as a sentence and a table.

    Attributes
    ----------
    name : str
        The chosen curriculum: its source, the source's share of the target's steps, the scale if it
        is not 1, and whether it has a portfolio; empty if no curriculum pays.
    curriculum : Curriculum or None
        The chosen curriculum as it was played; None if no curriculum pays, or it cannot be carried
        over to the target.
    alone : str
        The best opponent of the first finalist in words, which needs no source.
    comparison : Comparison
        The finalists against all opponents, on seeds that no finalist was chosen on.
    rows : tuple of dict
        A row for each curriculum, finalists first: name, source_steps, seeds, mean_return; gain,
        gain_low, gain_high over the best opponent; answer, which is a verdict or the last round.
    remarks : tuple of str
        Sentences below the table: on failed curricula, and on the relative that was played.
    """

    name: str
    curriculum: Curriculum | None
    alone: str
    comparison: Comparison = field(repr=False)
    rows: tuple[Mapping[str, Any], ...] = field(repr=False)
    remarks: tuple[str, ...] = ()

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def sentence(self) -> str:
        """The choice as a sentence."""
        best = self.name or self.rows[0]["name"]
        verdict = self.comparison.verdicts[best]
        if self.comparison.nobody:
            return f"no curriculum: {nothing_learnt(self.comparison)}"
        gain = f"{short(verdict.gain)} in mean return on {self.comparison.seeds} fresh seeds"
        if self.name:
            p = f"p = {verdict.adjusted_p:.2g}"
            return f"{best}: gains {gain} more than {self.alone} alone ({p})"
        why = f"none is shown to gain more than {self.alone} alone"
        if verdict.direction < 0:
            why = f"{self.alone} alone does better"
        return f"no curriculum: {why} (the best, {best}, gains {gain})"

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the sentence and the table in lines of at most `width` characters."""
        cells = list[tuple[str, ...]]()
        for row in self.rows[:SHOWN]:
            numbers = f"{row['source_steps']:,.0f}", f"{row['seeds']}", f"{row['mean_return']:.4g}"
            cells.append((row["name"], *numbers, short(interval_of("gain", row)), row["answer"]))
        lines = [folded(self.sentence, width), *text_table(HEADS, cells, width, prose=True)]
        return "\n".join([*lines, *(folded(remark, width) for remark in self.remarks)])


# -- Halving ---------------------------------------------------------------------------------------

Play = Callable[[Plan, tuple[int, ...], str], Comparison]  # plan, seeds and title -> result


def chosen(plan: Plan, play: Play, seed: int = 0) -> Choice:
    """Return the choice among a plan's curricula, without the curriculum itself."""
    first = FIRST_SEED + whole_number("seed", seed, 0, SettingError) * SEEDS_APART
    curricula = [name for name, arm in plan.arms.items() if not (arm.scratch or arm.of)]
    if why := next(filter(None, (hindrance(plan.curricula[name]) for name in curricula)), ""):
        raise TaskError(
            f"trials need a model, and {why}: name a smaller relative with on=, or compare the "
            "curricula by cr.forecast"
        )
    remaining = curricula
    returns, rows, failed = dict[str, FloatArray](), dict[str, dict[str, Any]](), dict[str, Any]()

    def played(further: int, title: str, *, constants: bool) -> Comparison:
        nonlocal first
        seeds, first = tuple(range(first, first + further)), first + further
        out = [name for name in curricula if name not in remaining]
        out += [name for name, arm in plan.arms.items() if arm.of and not constants]
        out += failed  # in all rounds, as seeds of some rounds cannot be compared with all
        title += f", {further} seeds of {len(remaining)} curricula"
        comparison = play(plan.without(out), seeds, title)
        failed.update(comparison.failed)
        return comparison

    def add_row(name: str, arm: Arm, returns: FloatArray, gain: Interval, answer: str) -> None:
        rows[name] = {
            "name": name,
            "source_steps": float(arm.curve.source_steps.mean()),
            "seeds": len(returns),
            "mean_return": float(returns.mean()),
            **columns_of("gain", gain),
            "answer": answer,
        }

    for n, further in enumerate(ROUNDS, 1):
        comparison = played(further, f"round {n}", constants=False)
        for name, batch in comparison.returns.items():
            returns[name] = np.append(returns.get(name, []), batch)
        rival = max((returns[x] for x in comparison.scratches), key=lambda values: values.mean())
        ranked = sorted(comparison.controls, key=lambda name: -returns[name].mean())
        for name in ranked:
            gain = mean_interval(returns[name] - rival)
            add_row(name, comparison[name], returns[name], gain, f"left out after round {n}")
        better = ranked[: max(FINALISTS, -(-len(ranked) // 2))]
        remaining = [x for x in better if _may_exceed(returns[x], returns[ranked[0]])]
        hopeful = any(_may_exceed(returns[x], rival) for x in remaining)
        if len(remaining) <= FINALISTS or not hopeful:
            break
    remaining = remaining[:FINALISTS]
    final = played(FINAL_SEEDS, "last round", constants=True)
    pays = {name: verdict.direction > 0 for name, verdict in final.verdicts.items()}
    finalists = sorted(pays, key=lambda name: (not pays[name], -final.returns[name].mean()))
    for name in finalists:
        contrast = final.contrasts[name]
        answer = f"{contrast.verdict}, against {final.best_opponent(name)}"
        add_row(name, final[name], final.returns[name], contrast.strong_gain, answer)
    others = sorted(rows.keys() - {*finalists}, key=lambda name: (-rows[name]["gain"], name))
    remarks = [f"and {len(rows) - SHOWN} more"] * (len(rows) > SHOWN)
    remarks += [f"{arm} failed: {in_words(error)}" for arm, error in failed.items()]
    listed = tuple(rows[name] for name in (*finalists, *others))
    best = finalists[0] * pays[finalists[0]]
    return Choice(best, None, without_source(final, finalists[0])[0], final, listed, tuple(remarks))


def _may_exceed(returns: FloatArray, others: FloatArray) -> bool:
    """Return whether a mean return may be as high as another; True without an interval."""
    return not mean_interval(returns - others).high < 0


# -- Choosing --------------------------------------------------------------------------------------


def choose(
    target: Task | FamilyMember,
    candidates: Sequence[Curriculum | SourceCandidate] | Mapping[str, Curriculum] = (),
    *,
    kinds: Sequence[str] = KINDS,
    most: int = MOST,
    on: Task | FamilyMember | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress = None,
    **settings: Any,
) -> Choice:
    """Return which curriculum, if any, to learn a target with, after trials in the target's model.

    Each source is tried with 2, 5 and 15 % of the target's steps. Its values, times 1 and 2, enter
    by ``QInitialisation()``, and times 1 in the default portfolio if the learner may have one;
    several mappings are joined by :func:`minimum`. The better half of each round gets more seeds;
    the last three meet all opponents of :func:`compare` on 20 fresh seeds. The seeds of trials
    begin at 2,000,000. ``curricle.choose`` also takes a study or its path.

    Parameters
    ----------
    target : Task or FamilyMember
        With tables, as :func:`source_candidates` needs them.
    candidates : sequence of SourceCandidate and Curriculum, or dict of str to Curriculum
        Further candidates. Curricula are played unchanged.
    kinds, most : sequence of str and int
        The kinds of candidates to make (none if empty), and the most candidates to make.
    on : Task or FamilyMember, optional
        A smaller relative of the target in which to choose, with as many steps a state. The chosen
        kind of source, its size relative to the target, its steps a state and its scale are then
        carried over to the target.
    seed, workers, progress : optional
        Equal seeds give equal choices. `workers` and `progress`, a bar a round, as in
        :func:`compare`.
    **settings
        The target's ``budget`` (100,000 steps), ``learner``, ``eval_freq``, ``evaluation`` and
        ``storage``; by default those of the first curriculum in `candidates`.

    Returns
    -------
    Choice
        It has a curriculum only if that gains more than the best opponent (p < .05, corrected for
        the number of finalists).

    Raises
    ------
    TaskError, CurriculumError, SettingError
        When the target has no model, or there are no candidates.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> choice = choose(GridWorld("S...T"), kinds=["crop"], budget=500, most=1)
    >>> choice.curriculum, choice.alone
    (None, 'OptimisticQLearning')
    """
    if isinstance(target, Curriculum):
        name = target.target
        raise SettingError(
            f"a choice takes the target, and curricula for it as candidates: got {target!r}; call "
            f"choose(plan.tasks[{name!r}], [plan])"
        )
    played_settings = settings
    if on is not None:
        budget = whole_number("budget", settings.get("budget", DEFAULT_STEPS), 1, SettingError)
        states, fewer = (_task(of).states.size for of in (target, on))
        steps = max(FEWEST_STEPS, round(budget * fewer / states))
        settings = {k: x for k, x in settings.items() if k != "eval_freq"} | {"budget": budget}
        played_settings = {**settings, "budget": steps}
    place = target if on is None else on
    curricula, options = trial_curricula(place, candidates, kinds, most, played_settings)
    memory = Memory()
    whole = comparison_plan(curricula, memory, opponents=OPPONENTS)
    reference = Reference.before(whole.target_node, None)

    def play(plan: Plan, seeds: tuple[int, ...], title: str) -> Comparison:
        grow, tell = cast(Any, (bars.bar(title, len(plan.arms)), bars.tell))
        one_bar = Bars(call=lambda name: (grow(), tell(name)))
        return trained_comparison(plan, seeds, reference, WINDOW, memory, workers, one_bar)

    with shown(progress) as bars:
        choice = chosen(whole, play, seed)
    curriculum, remarks = curricula.get(choice.name), [*choice.remarks]
    if on is not None:
        curriculum = None
        played = f"{fewer:,} states instead of {states:,}, {steps:,} steps instead of {budget:,}"
        remarks += [f"played in a relative: {played}; assumes that what pays there pays here"]
        if choice.name in options:  # a user's curriculum is not carried over
            option, sentence = _carried_over(target, options[choice.name], on)
            curriculum = option and option.curriculum(TARGET, _task(target), settings)
            remarks.append(sentence)
    return replace(choice, curriculum=curriculum, remarks=tuple(remarks))


def trial_curricula(
    target: Task | FamilyMember,
    candidates: Sequence[Curriculum | SourceCandidate] | Mapping[str, Curriculum],
    kinds: Sequence[str],
    most: int,
    settings: Mapping[str, Any],
) -> tuple[dict[str, Curriculum], dict[str, Option]]:
    """Return the curricula to play by name, and the options by name that candidates give."""
    stated = [*candidates.values()] if isinstance(candidates, Mapping) else [*candidates]
    if not all(isinstance(candidate, Curriculum | SourceCandidate) for candidate in stated):
        raise CurriculumError(f"candidates must be curricula or SourceCandidates: got {stated!r}")
    plans = [candidate for candidate in stated if isinstance(candidate, Curriculum)]
    sources = [candidate for candidate in stated if isinstance(candidate, SourceCandidate)]
    names = numbered([", ".join(plan.ancestors(plan.target)) or "potential" for plan in plans])
    labels = candidates if isinstance(candidates, Mapping) and not sources else names
    curricula = dict(zip(labels, plans, strict=True))
    for plan in plans:
        apart = [*differences(_task(target), plan.tasks[plan.target])]
        apart += [key for key, x in settings.items() if plan.setting(key, plan.target) != x]
        if apart:
            raise CurriculumError(
                "curricula must lead to the target, with the settings given: "
                f"{plan.target!r} of a candidate differs in {'; '.join(apart)}"
            )
    name, options = plans[0].target if plans else TARGET, dict[str, Option]()
    for key in OF_TARGET if plans else ():
        settings = {key: plans[0].setting(key, name), **settings}
    if kinds or sources:
        if not has_tables(_task(target)):
            raise TaskError(
                f"trials need a model, which {target!r} has not: name a smaller relative with on="
            )
        budget = whole_number("budget", settings.get("budget", DEFAULT_STEPS), 1, SettingError)
        propose = (lambda _: sources) if sources else None
        proposals = source_candidates(target, kinds=kinds, most=most, propose=propose)
        options = {option.name: option for option in options_of(proposals.candidates, budget)}
        if twice := {*curricula} & {*options}:
            raise CurriculumError(f"candidates need different names: {min(twice)!r} is there twice")
        for label, option in options.items():
            curriculum = option.curriculum(name, proposals.target, settings)
            if curriculum.setting("shaping", name).portfolio or not option.portfolio:
                curricula[label] = curriculum
    if not curricula:
        raise CurriculumError("there must be candidates to choose from: give kinds or candidates")
    return curricula, options


def _task(target: Task | FamilyMember) -> Task:
    return target.task if isinstance(target, FamilyMember) else target


# -- Carried over from a smaller relative ----------------------------------------------------------

FEWEST_STEPS = 1_000  # fewest steps of the relative as a target
MOST_DRAFTS = 50  # drafts of the target among which to look


def _carried_over(
    target: Task | FamilyMember, option: Option, on: Task | FamilyMember
) -> tuple[Option | None, str]:
    """Return the target's option that matches an option of a smaller relative, and a sentence."""
    like, states = option.candidate, option.candidate.task.states.size
    share, a_state = states / _task(on).states.size, option.steps / states
    sentence = (
        f"carried over: a source of kind {like.kind!r}, with {share:.3g} of the target's states, "
        f"{a_state:.3g} steps a state of its own, scale {option.scale:g}"
        f"{', in a portfolio' * option.portfolio}"
    )

    def distance(draft: Draft) -> tuple[bool, float]:
        if draft.member is not None and like.member is not None:
            assert isinstance(target, FamilyMember)  # of which this is a member
            assert isinstance(on, FamilyMember)
            size = draft.member.task.states.size / _task(target).states.size
            pairs = (draft.member.parameters, target), (like.member.parameters, on)
            easier, easier_on = ({k for k in x if x[k] != of.parameters[k]} for x, of in pairs)
            return easier != easier_on, abs(log(size / share))
        if like.share is None:
            return draft.words != like.words, 0.0
        return False, abs((like.share if draft.share is None else draft.share) - like.share)

    drafts, nothing = cast(Iterator[Draft], iter(())), cast(Any, None)
    if like.kind == "member" and isinstance(target, FamilyMember):  # a member without its tables
        drafts = family_members(DesignTarget(nothing, target, nothing, nothing))
    elif like.kind in MAKERS and has_tables(_task(target)):
        drafts = MAKERS[like.kind](design_target(target))
    for draft in sorted(islice(drafts, MOST_DRAFTS), key=distance):
        with suppress(CurricleError):
            task, mappings = draft.build()
            source = SourceCandidate(draft.name, task, mappings, draft.kind, draft.words)
            steps = max(1, round(a_state * task.states.size))
            sentence += f": {draft.name}, {task.states.size:,} states, {steps:,} steps"
            return option._replace(candidate=source, steps=steps), sentence
    return None, f"{sentence}; none can be made of the target itself: build it by hand"
