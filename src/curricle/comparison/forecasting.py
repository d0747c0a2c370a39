"""A forecast, before training in the target, says whether a curriculum pays.

A trial (:mod:`curricle.comparison.trial`) answers that. For each source the forecast states whether
it learnt its own task. Live environments and networks allow no trial: of their targets it states
the return of the potential's own greedy policy, beside that of the random policy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, Frozen, frozen
from curricle.checks import instance, one_of
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import Reference
from curricle.comparison.opponents import OPPONENTS, Learners, Opponent
from curricle.comparison.plan import Memory
from curricle.comparison.sentences import headroom_sentence, instead, likely, steps_and_gain
from curricle.comparison.trial import (
    SEEDS,
    ForecastRow,
    affordable,
    hindrance,
    rows_of,
    run_trial,
)
from curricle.curriculum.curriculum import Curriculum, Node, TrainingOptions
from curricle.curriculum.result import Learnt, SourceValues
from curricle.deep.learning import policy_return
from curricle.deep.miniature import Examined
from curricle.errors import CurricleError, CurriculumError, in_words
from curricle.learning.seeds import seed_tuple
from curricle.planning.greedy import Values
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import NOT_LEARNT, STANDARD_ERRORS, Target
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.tasks.live import is_live
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import is_observation_task, made_by
from curricle.text import brief_repr, counted, folded, printed, shortened, text_table
from curricle.transfer.aggregate import Aggregate
from curricle.transfer.mapping import Coverage
from curricle.transfer.rollouts import ObservationTarget, potential_return, target_of
from curricle.transfer.transfer import FOUND, transfer_names

# -- Did a source learn its own task? --------------------------------------------------------------
#
# The greedy return of a source is compared with the optimum of its task, or with the return of a
# fresh learner of twice as many steps. Values of a source that did not learn its task can be worse
# than none. The comparison charges no step: the optimum follows from a model, and the fresh
# learner is simulated. Networks distilled from miniatures are examined on held-out levels.

LEARNT = 0.9  # a source learnt its task from this share of the way from random to the reference
OPTIMUM, FRESH, UNKNOWN = "its optimum", "a fresh learner", ""  # kinds of reference


@dataclass(frozen=True, eq=False)
class SourceLearning(Frozen):
    """How much of its own task a source learnt. Prints as a sentence."""

    name: str
    seeds: tuple[int, ...]  # the K seeds
    returns: FloatArray  # (K,): of each seed's greedy policy, in the source's task
    random_return: float  # return of the uniformly random policy in the source's task
    reference: float  # an optimal policy's return, or a fresh learner's mean return; NaN if unknown
    measured_by: str  # what the reference is: "its optimum", "a fresh learner", or nothing
    # Standard error that rollouts cause in the differences of the mean of `returns`, the random
    # return and the reference; 0 where all three are exact.
    noise: float = 0.0
    # Steps a seed of the fresh learner; 0 without it. The curriculum is not charged for them.
    fresh_steps: int = field(default=0, kw_only=True)

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def shares(self) -> FloatArray:
        """Shares of the way from random to the reference, (K,); NaN if it is not above random."""
        way = self.reference - self.random_return
        if not way > STANDARD_ERRORS * self.noise:
            return np.full(len(self.seeds), np.nan)
        return np.asarray((self.returns - self.random_return) / way)

    @property
    def share(self) -> float:
        """The mean of the shares; NaN if the reference is not above random."""
        return float(self.shares.mean())

    @property
    def learnt(self) -> bool | None:
        """Whether the source learnt at least nine tenths of the way; None if that is unknown."""
        return None if np.isnan(self.share) else self.share >= LEARNT

    def __str__(self) -> str:
        got, random = f"{self.returns.mean():.4g}", f"{self.random_return:.4g}"
        failed, by = f"{self.name} did NOT learn its own task: {got}", self.measured_by
        if by == UNKNOWN:
            # A source no better than random did not learn, whatever the optimum is.
            if self.returns.mean() - self.random_return <= STANDARD_ERRORS * self.noise:
                return f"{failed}, no better than random ({random}); its values may mislead"
            return f"{self.name} returns {got} where random is {random}; its optimum is not known"
        by += f" of {self.fresh_steps:,} steps" if self.fresh_steps else ""
        if np.isnan(self.share):
            return (
                f"{self.name} cannot be judged: {by} returns {self.reference:.4g}, no more than "
                f"random ({random})"
            )
        if self.share < NOT_LEARNT:
            return (
                f"{failed} where random is {random} and {by} {self.reference:.4g}; its values may "
                "mislead"
            )
        # The sentence says 100 % only where at most a thousandth is missing.
        per_cent = round(100 * self.share)
        per_cent = per_cent if self.share >= 0.999 else min(99, per_cent)
        only = "" if self.learnt else "only "
        sentence = f"{self.name} learnt {only}{per_cent:d} % of the way to {by}"
        if failing := int((self.shares < NOT_LEARNT).sum()):
            seeds = counted(len(self.seeds), "seed")
            sentence += f", but {failing} of {seeds} did NOT learn it"
        return sentence


def source_learning(
    curriculum: Curriculum,
    sources: Mapping[str, SourceValues],
    *,
    fresh: bool = True,
    workers: int | None = None,
    progress: Progress = None,
) -> dict[str, SourceLearning]:
    """Return how much of its own task each source learnt.

    Parameters
    ----------
    curriculum : Curriculum
    sources : dict of str to SourceValues
        Such as ``CurriculumResult.sources``. Sources are left out whose values are not in dense
        tables, or which no transfer reads.
    fresh : bool
        Whether a fresh learner of twice the steps is the reference of a source that cannot be
        solved; never for a live task.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each fresh learner; a function is called with each source's name.
    """
    learnings, read = {}, {edge.source for edge in curriculum.transfers}
    with shown(progress) as bars:
        for name, learnt in sources.items():
            dense = name in read and isinstance(learnt.values, np.ndarray)
            if not dense or is_observation_task(curriculum.tasks[name]):
                continue
            node = curriculum.node(name)
            generative = generative_model(node.task)
            if generative.time_limit is None:
                if generative.discount == 1:
                    continue  # an episode has no bound
                node = replace(node, evaluation=replace(node.evaluation, discounted=True))
            learnings[name] = _learning(node, learnt, fresh, workers, bars.within())
            bars.tell(name)
    return learnings


def _learning(
    node: Node, learnt: SourceValues, fresh: bool, workers: int | None, bars: Bars
) -> SourceLearning:
    target = Target.of(node.task, node.evaluation)
    random, random_noise, _ = target.random
    returns, noise = _returns(target, learnt.values)
    reference, reference_noise, by, steps = float("nan"), 0.0, UNKNOWN, 0
    if target.solution is not None:
        best = Values(target.solution.optimal.astype(np.float64))
        reference, reference_noise, _ = target.estimated(best)
        by = OPTIMUM
    elif fresh and not is_live(node.task):
        steps, by = 2 * int(learnt.steps_used.max()), FRESH
        # The fresh learner has no sources, and random streams of its own.
        off = GreedyEvaluation(method="off")
        name = f"{node.name}/fresh"
        alone = replace(node, name=name, budget=steps, eval_freq=steps, evaluation=off)
        options = TrainingOptions(workers=workers, progress=bars)
        trained = alone.train(learnt.seeds, (), options)
        of_fresh, reference_noise = _returns(target, trained.values)
        reference = float(of_fresh.mean())
    total = float(np.sqrt(noise**2 + random_noise**2 + reference_noise**2))
    return SourceLearning(
        node.name, learnt.seeds, frozen(returns), random, reference, by, total, fresh_steps=steps
    )


def _returns(target: Target, values: FloatArray) -> tuple[FloatArray, float]:
    """Return the greedy return of each of K tables, and the standard error of their mean."""
    estimates = [target.estimated(Values(table)) for table in values]
    returns, noise = (np.array([getattr(k, of) for k in estimates]) for of in ("value", "noise"))
    return returns, float(np.sqrt((noise**2).sum()) / len(estimates))


@dataclass(frozen=True, eq=False)
class DistilledSource(Frozen):
    """How far networks of K seeds go from the random policy's return to the optimum."""

    name: str
    examined: tuple[tuple[Examined, ...], ...]  # by seed and by M members, tests last

    @property
    def shares(self) -> FloatArray:
        """Share of the way, by seed and member, (K, M)."""
        return np.array([[exam.regained for exam in of_seed] for of_seed in self.examined])

    def __str__(self) -> str:
        none, texts = "nothing, as random play is optimal,", list[str]()
        for x, exam in zip(self.shares.mean(axis=0), self.examined[0], strict=True):
            share = none if np.isnan(x) else f"{round(x, 2) + 0.0:.0%}"
            levels = counted(exam.levels, exam.kind)
            texts.append(f"{share} on {levels} of {made_by(exam.member.make)}")
        way = "of the way from random to optimal"
        return f"{self.name}'s network regains, {way}, {', '.join(texts)}"


# -- The record of a forecast, and its sentences ------------------------------------------------


@dataclass(frozen=True)
class Start:
    """What a potential's own greedy policy returns in a target that has no model."""

    potential: float  # mean over seeds and episodes
    random: float  # of the uniformly random policy


@dataclass(frozen=True, eq=False)
class Forecast:
    """Whether the potential of a target will pay. Prints as sentences and a table of gains.

    Attributes
    ----------
    target : str
    coverage : dict of str to Coverage
        Coverage of each transfer's mapping, over all pairs or over the observations that the first
        seed's greedy policy meets.
    rows : tuple of ForecastRow
        The aggregates, then the single transfers, each group with the highest gain first; or the
        potential that is written by hand.
    trained : dict of str to SourceValues
        The sources' values, as :meth:`Curriculum.train` takes them.
    sources : dict of str to SourceLearning or DistilledSource
        How much of its own task each source learnt, if that is known.
    start : Start or None
        The return of the potential's own policy, of live targets and those seen through
        observations; None elsewhere, and of a potential without such a policy.
    trial : Comparison or None
        The comparison with learning from scratch, played in the tasks' models: an arm for each row,
        under its name, and the opponents.
    no_trial : str
        Why there is no trial, as text.
    knows_target : bool
        Whether a search found a mapping in the target's model, for which no step is charged.
    """

    target: str
    coverage: Mapping[str, Coverage]
    rows: tuple[ForecastRow, ...]
    trained: Mapping[str, SourceValues] = field(repr=False)
    sources: Mapping[str, SourceLearning | DistilledSource] = field(default_factory=dict)
    start: Start | None = None
    trial: Comparison | None = None
    no_trial: str = ""
    knows_target: bool = False

    def __getitem__(self, name: str) -> ForecastRow:
        by_name = {row.name: row for row in self.rows}
        one_of("a row of a forecast", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def used(self) -> ForecastRow:
        """The row of the potential that the curriculum uses."""
        return next(row for row in self.rows if row.used)

    @property
    def best(self) -> ForecastRow:
        """The row with the highest gain; that in use without a trial."""
        return max(self._tried, key=_estimate, default=self.used)

    @property
    def headroom(self) -> float:
        """:meth:`Comparison.headroom` in the trial; NaN if it is unknown."""
        if self.trial is None or self.used.gain is None:
            return float("nan")
        return self.trial.headroom(self.used.name)

    @property
    def answer(self) -> str:
        """Whether the curriculum will pay, in a few words; and whether its mapping was found."""
        gain = self.used.gain
        if self.trial is None:
            pays = "whether it pays is open"
        elif gain is None:
            pays = "it failed in the trial"
        else:
            nobody = self.trial.nobody
            pays = f"{nobody} in the trial" if nobody else likely(gain)
        return f"{pays}, {FOUND}" if self.knows_target else pays

    @property
    def basis(self) -> str:
        """The numbers behind the answer and their assumptions, or why there was no trial."""
        if self.trial is None:
            return f"no trial: {self.no_trial}"
        name, failed = self.used.name, self.trial.failed
        result = in_words(failed[name]) if name in failed else steps_and_gain(self.trial, name)
        retrained = ", its sources trained anew" * bool(self.used.curriculum.transfers)
        return (
            f"{result}; a trial in the model: {counted(self.trial.seeds, 'seed')}, random streams "
            "apart from those of an experiment; assumes the tasks, budgets and settings of the "
            f"curriculum{retrained}"
        )

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = 80) -> str:
        """Return sentences and a table, in lines of at most `width` characters."""
        covers = (f"{name}: {cover}" for name, cover in self.coverage.items())
        lines = [folded(line, width) for line in (*self._sentences, *covers)]
        cells = [
            (row.name + " *" * row.used, f"{row.gain.estimate:.3g}")
            for row in self._tried
            if row.gain is not None
        ]
        if len(cells) > 1:  # a single gain stands in the basis
            lines += text_table(["", "gain"], cells, width)
        return "\n".join(lines)

    def __repr__(self) -> str:
        names = ", ".join(row.name for row in self.rows)
        return shortened(f"Forecast({self.target!r}: {self.answer}; potentials: {names})")

    _repr_html_ = printed

    @property
    def _tried(self) -> list[ForecastRow]:
        """The rows with a gain; none where nobody learnt in the trial."""
        nobody = self.trial is not None and self.trial.nobody
        return [] if nobody else [row for row in self.rows if row.gain is not None]

    @property
    def _sentences(self) -> list[str]:
        """The sentences above the table: headroom, answer, its basis, the sources, the start."""
        lines = [self.answer, self.basis]
        if self.trial is not None and (gain := self.used.gain) is not None:
            arms, name = self.trial, self.used.name
            lines[0] += f": {instead(arms, name)}" * bool(gain.high < 0)
            lines[:0] = filter(None, [headroom_sentence(arms, name)])
        lines[0] = f"Forecast for {self.target!r}: {lines[0]}"
        if self.trial is not None:
            lines += [
                f"{name} failed: {in_words(error)}"
                for name, error in self.trial.failed.items()
                if name != self.used.name  # whose error is the basis
            ]
            lines += [f"the highest gain in the trial: {self.best.name}"] * (not self.best.used)
        alone = f", which alone says little of {self.target!r}"  # 90 % there were .04 in a target
        lines += [f"{of}{alone * isinstance(of, DistilledSource)}" for of in self.sources.values()]
        if self.start is not None:
            lines.append(
                f"the potential's own policy returns {self.start.potential:.4g} in "
                f"{self.target!r}, {self._learnt_from}and the random policy "
                f"{self.start.random:.4g}"
            )
        return lines

    @property
    def _learnt_from(self) -> str:
        """A clause on the seeds and steps of the sources."""
        if not self.trained:
            return ""
        sources, seeds = list[str](), 0
        for name, source in self.trained.items():
            seeds, average = len(source.seeds), " on average" * bool(np.ptp(source.steps_used))
            sources.append(f"{name} ({source.steps_used.mean():,.0f} steps{average})")
        return f"from {counted(seeds, 'seed')} of {', '.join(sources)}, "


def _estimate(row: ForecastRow) -> float:
    """Return the gain of a row; -inf where it has none."""
    return -np.inf if row.gain is None else float(np.nan_to_num(row.gain.estimate, nan=-np.inf))


# -- Making a forecast ---------------------------------------------------------------------------


def forecast(
    curriculum: Curriculum,
    target: str | None = None,
    *,
    seeds: int | Sequence[int] = 3,
    aggregates: Sequence[Aggregate] = (),
    trained: Mapping[str, Learnt] | None = None,
    episodes: int | None = None,
    trial: bool | None = None,
    opponents: Sequence[Opponent] = OPPONENTS,
    scratch: Learners = (),
    threshold: float | None = None,
    workers: int | None = None,
    progress: Progress = None,
    memory: Memory | None = None,
) -> Forecast:
    """Return the forecast of whether the transfers into a target, or its potential by hand, pay.

    A trial tells: it plays the comparison with learning from scratch in the tasks' models, with
    other random draws than :func:`compare` and :meth:`Curriculum.train`. A live target, or one that
    is seen through observations, has no model: there the greedy policy of the potential is rolled
    out, and whether it pays stays open.

    Parameters
    ----------
    curriculum : Curriculum
        ``curricle.forecast`` also takes a study of one arm or its path.
    target : str, optional
        By default the task to which all other tasks lead.
    seeds : int or sequence of int
        Seeds of the sources that are examined.
    aggregates : sequence of callable
        Aggregates to compare besides the library's four and the curriculum's.
    trained : dict of str to SourceValues or LearningResult, optional
        Sources that were trained before, for the same seeds. A trial trains its sources anew.
    episodes : int, optional
        Rollouts of the potential and of the random policy in a target without a model: by default
        1000, or 50 for an observation task.
    trial : bool, optional
        True for a trial of 20 seeds, False for none. By default there is a trial of 8 to 20 seeds
        if the tasks have models and it takes at most about 10 s on one processor.
    opponents, scratch, threshold : optional
        The learners without sources against which the trial asks whether the curriculum pays, and
        the return that counts as learnt, as in :func:`compare`.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each learnt task; a function is called with the name of each source
        that was examined, and with "trial" after the trial.
    memory : Memory, optional
        Results to share with other forecasts: trials with equal tasks then train them once.

    Raises
    ------
    CurriculumError
        If the target is not unique or has no potential, or ``trial=True`` lacks a model or a
        budget in steps.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 5000})
    >>> predicted = forecast(plan, trial=False)
    >>> predicted.answer, str(predicted.sources["corner"])
    ('whether it pays is open', 'corner learnt 100 % of the way to its optimum')
    """
    check_progress(progress)
    instance("the curriculum of a forecast", curriculum, Curriculum, CurriculumError)
    name = curriculum.target if target is None else target
    edges = curriculum.in_edges(name)
    if not curriculum.has_potential(name):
        raise CurriculumError(
            f"a forecast needs a task with a potential: {name!r} has neither transfers nor one by "
            "hand"
        )
    for function in aggregates:
        if not callable(function):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): got {function!r}"
            )
    numbers = seed_tuple(seeds)
    ways = rows_of(curriculum, name, aggregates)
    tried, trial_seeds, no_trial = _planned_trial(ways, trial)
    task = curriculum.tasks[name]
    any_target = target_of(task, curriculum.setting("evaluation", name), episodes=episodes)
    reads_values = curriculum.setting("shaping", name).reads_values
    learnt, start, played = dict[str, Any](), None, None
    with shown(progress) as bars:
        before, inner = curriculum.ancestors(name), bars.within()
        sources = curriculum.train(
            numbers, only=before, trained=trained, workers=workers, progress=inner
        ).sources
        if is_observation_task(task) or is_live(task):
            start = _start(curriculum, name, sources, any_target, reads_values=reads_values)
        if tried:
            reference = Reference.before(curriculum.node(name), threshold, any_target)
            try:
                played = run_trial(
                    tried, opponents=opponents, scratch=scratch, seeds=trial_seeds,
                    reference=reference, memory=memory, workers=workers, progress=inner,
                )  # fmt: skip
                bars.tell("trial")
            except CurricleError as error:  # the sources can be examined without the trial
                if trial is not None:
                    raise
                no_trial = f"it failed: {error}"
        learnt |= source_learning(curriculum, sources, workers=workers, progress=inner)
        learnt |= {
            source: DistilledSource(source, tuple(map(node.task.examined, of.values)))
            for source, of in sources.items()
            if (node := curriculum.node(source)).distilled and of.values is not None
        }
        for source in learnt:
            bars.tell(source)
    # Networks enter in one way, whatever their aggregate.
    rows = [row for row in ways if row.used or reads_values]
    if played is not None:
        gains = {name: contrast.strong_gain for name, contrast in played.contrasts.items()}
        rows = [replace(row, gain=gains.get(row.name)) for row in rows]
    rows.sort(key=lambda row: (not row.aggregate, row.gain is None, -_estimate(row)))
    sample = list[Any]()  # of observations, where pairs are not numbered
    if isinstance(any_target, ObservationTarget):
        first: Any = curriculum.potentials(name, sources)[0]
        sample.append(any_target.observations(first))
    coverage = {
        label: edge.mapping.coverage(*sample)
        for label, edge in zip(transfer_names(edges), edges, strict=True)
        if sample or edge.mapping.countable  # pairs are few enough to count
    }
    return Forecast(
        name, coverage, tuple(rows), sources, learnt, start, played, no_trial,
        curriculum.knows_target(name),
    )  # fmt: skip


def _start(
    curriculum: Curriculum,
    name: str,
    sources: Mapping[str, SourceValues],
    target: Target | ObservationTarget,
    *,
    reads_values: bool,
) -> Start | None:
    """Return what the greedy policy of a curriculum's potential returns in a target."""
    rolled: Any = potential_return if reads_values else policy_return
    potentials = curriculum.potentials(name, sources)
    returns = [rolled(phi, target, seed=k) for k, phi in enumerate(potentials)]
    mean = float(np.mean(returns))
    return None if np.isnan(mean) else Start(mean, target.random_return)


def _planned_trial(
    rows: list[ForecastRow], trial: bool | None
) -> tuple[list[ForecastRow], int, str]:
    """Return a trial's rows, its seeds, and why there is no trial if there is none."""
    if not isinstance(trial, bool | None):
        raise CurriculumError(f"trial must be True, False or None: got {trial!r}")
    if trial is False:
        return [], 0, "none was asked for"
    (used,) = (row for row in rows if row.used)
    why = hindrance(used.curriculum)
    if why and trial:
        raise CurriculumError(f"a trial needs models and a budget in steps: {why}")
    if why:
        return [], 0, f"{why}; cr.choose(..., on=) plays on a smaller relative"
    if trial:
        return rows, SEEDS, ""
    tried, seeds = affordable(rows)
    long = "it would take long; trial=True or curricle check --forecast makes it"
    return tried, seeds, "" if seeds else long
