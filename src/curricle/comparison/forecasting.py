"""A forecast, before training in the target, says whether a curriculum pays and where it starts.

A trial (:mod:`curricle.comparison.trial`) answers whether it pays. For each potential the forecast
states where learning starts: the return of the policy greedy on phi, and whether phi is so high
that returns then fall. For each source it states whether the source learnt its own task.
"""

import math
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, cast

import numpy as np

from curricle.arrays import FloatArray, Frozen, frozen
from curricle.checks import instance, one_of
from curricle.comparison.comparison import Reference
from curricle.comparison.opponents import OPPONENTS, Learners, Opponent
from curricle.comparison.plan import Memory
from curricle.comparison.trial import (
    SEEDS,
    Candidate,
    Trial,
    affordable,
    candidates_of,
    hindrance,
    run_trial,
)
from curricle.curriculum.curriculum import Curriculum, Node
from curricle.curriculum.result import Learnt, SourceValues
from curricle.deep.learning import policy_return
from curricle.deep.miniature import Miniatures
from curricle.display import block, printed, table
from curricle.errors import CurricleError, CurriculumError, in_words
from curricle.learning.potential import PairPotential
from curricle.learning.seeds import over_seeds, seed_tuple, threads_for
from curricle.planning.greedy import Values, VisitedValues
from curricle.planning.policy_evaluation import (
    NOT_LEARNT,
    STANDARD_ERRORS,
    GreedyEvaluation,
    Target,
)
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.statistics.curves import ROUNDING
from curricle.statistics.intervals import Interval, mean_interval
from curricle.tasks.live import is_live
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import is_observation_task, made_by
from curricle.tasks.spaces import state_name
from curricle.text import brief_repr, counted, folded, or_dash, shortened, text_table
from curricle.transfer.aggregate import Aggregate
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.mapping import Coverage, ObservationCoverage, coverage_table
from curricle.transfer.rollouts import (
    ObservationTarget,
    PotentialQuality,
    potential_quality,
    target_of,
)
from curricle.transfer.transfer import FOUND, Calibrate, transfer_names

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
    random, random_noise = target.estimated(VisitedValues.none(learnt.values.shape[2]))
    returns, noise = _returns(target, learnt.values)
    reference, reference_noise, by, steps = float("nan"), 0.0, UNKNOWN, 0
    if target.solution is not None:
        best = Values(target.solution.optimal.astype(np.float64))
        reference, reference_noise = target.estimated(best)
        by = OPTIMUM
    elif fresh and not is_live(node.task):
        steps, by = 2 * int(learnt.steps_used.max()), FRESH
        # The fresh learner has no sources, and random streams of its own.
        off = GreedyEvaluation(method="off")
        name = f"{node.name}/fresh"
        alone = replace(node, name=name, budget=steps, eval_freq=steps, evaluation=off)
        trained = alone.train(learnt.seeds, workers=workers, progress=bars)
        of_fresh, reference_noise = _returns(target, trained.values)
        reference = float(of_fresh.mean())
    total = float(np.sqrt(noise**2 + random_noise**2 + reference_noise**2))
    return SourceLearning(
        node.name, learnt.seeds, frozen(returns), random, reference, by, total, fresh_steps=steps
    )


def _returns(target: Target, values: Any) -> tuple[FloatArray, float]:
    """Return the greedy return of each of K tables, and the standard error of their mean."""
    estimates = [target.estimated(Values(table)) for table in values]
    returns, noise = np.array(estimates).T
    return returns, float(np.sqrt((noise**2).sum()) / len(estimates))


@dataclass(frozen=True, eq=False)
class DistilledSource(Frozen):
    """How far networks of K seeds go from the random policy's return to the optimum."""

    name: str
    members: tuple[str, ...]  # M tasks: the miniatures, then the relatives used only for tests
    levels: tuple[str, ...]  # (M,) kind and number of the levels on which a member is tested
    shares: FloatArray  # (K, M): share of the way, by seed and member

    @property
    def expected(self) -> float:
        """The share to expect in the target: that in the last member, which is nearest to it."""
        # benchmarks/networks/forecast.py measures how well this share ranks sources.
        return float(self.shares[:, -1].mean())

    def __str__(self) -> str:
        examined = zip(self.shares.mean(axis=0), self.levels, self.members, strict=True)
        none = "nothing, as random play is optimal,"
        texts = [
            f"{none if np.isnan(x) else f'{round(x, 2) + 0.0:.0%}'} on {levels} of {member}"
            for x, levels, member in examined
        ]
        return (
            f"{self.name}'s network regains, of the way from random to optimal, {', '.join(texts)}"
        )


def distilled_sources(
    tasks: Mapping[str, object], sources: Mapping[str, SourceValues]
) -> dict[str, DistilledSource]:
    """Return the test results of each source that was distilled from miniatures, by name."""
    distilled = {}
    for name, learnt in sources.items():
        task = tasks.get(name)
        if isinstance(task, Miniatures) and learnt.values is not None:
            examinations = [task.examined(values) for values in learnt.values]
            shares = np.array([[exam.regained for exam in examined] for examined in examinations])
            members = tuple(made_by(exam.member.make) for exam in examinations[0])
            levels = tuple(counted(exam.levels, exam.kind) for exam in examinations[0])
            distilled[name] = DistilledSource(name, members, levels, shares)
    return distilled


# -- The record of a forecast, and its sentences ------------------------------------------------
#
# Sentences about a potential describe the start, and signs that the potential misleads. Learning
# may still gain more from a low start than from scratch.


@dataclass(frozen=True)
class ForecastRow:
    """A potential that could enter the target: that of a single transfer, or an aggregate."""

    name: str  # the transfer, as "source -> target [n]", or the aggregate's name
    aggregate: bool  # whether it is an aggregate of all transfers
    used: bool  # whether the curriculum would use it
    seeds: tuple[PotentialQuality, ...] = field(repr=False)  # of each of K seeds
    # The scale of each of K seeds, fitted to rollouts of the greedy policy.
    calibrations: tuple[Calibration, ...] = field(repr=False)
    gain: Interval | None = None  # strong gain in mean return in the trial; None without a trial
    verdict: str = ""  # a sentence on the start and on whether returns then fall, with advice
    anti_knowledge: str = ""  # a sentence on signs that phi misleads; empty without signs

    __repr__ = brief_repr

    def mean(self, measure: str) -> float:
        """Return the mean over seeds of the field `measure` of ``PotentialQuality``."""
        return float(np.mean([getattr(quality, measure) for quality in self.seeds]))

    @property
    def scale(self) -> float:
        """The mean of the fitted scales; NaN if most seeds cannot be calibrated."""
        scales = [calibration.scale for calibration in self.calibrations if not calibration.refusal]
        most = scales and 2 * len(scales) > len(self.calibrations)
        return float(np.mean(scales)) if most else float("nan")

    @property
    def score(self) -> float:
        """The number that orders rows: the gain in the trial, else the start; NaN if unknown."""
        return self.mean("start") if self.gain is None else float(self.gain.estimate)


@dataclass(frozen=True, eq=False)
class Forecast:
    """Whether the transfers into a target will pay, and where learning starts. Prints as a table.

    Attributes
    ----------
    target : str
    coverage : dict of str to Coverage or ObservationCoverage
        Coverage of each transfer's mapping, over all pairs or over the observations that the first
        seed's greedy policy meets.
    rows : tuple of ForecastRow
        The aggregates, then the single transfers, each group with the highest score first.
    optimum, random_return : float
        Expected returns of an optimal policy (NaN if the target is too large to solve) and of the
        random policy, with which learning from scratch starts.
    solved, exact : bool
        Whether potentials are compared with the exact Q*, and whether returns are exact.
    trained : dict of str to SourceValues
        The sources' values, as :meth:`Curriculum.train` takes them; optimal values with `perfect`.
    perfect : bool
        Whether the sources were solved instead of trained.
    sources : dict of str to SourceLearning or DistilledSource
        How much of its own task each source learnt, if that is known.
    trial : Trial or None
        The comparison with learning from scratch, played in the tasks' models.
    no_trial : str
        Why there is no trial, as text.
    knows_target : bool
        Whether a search found a mapping in the target's model, for which no step is charged.
    """

    target: str
    coverage: Mapping[str, Coverage | ObservationCoverage]
    rows: tuple[ForecastRow, ...]
    optimum: float
    random_return: float
    solved: bool
    exact: bool
    trained: Mapping[str, SourceValues] = field(repr=False)
    perfect: bool = False
    sources: Mapping[str, SourceLearning | DistilledSource] = field(default_factory=dict)
    trial: Trial | None = None
    no_trial: str = ""
    knows_target: bool = False

    def __getitem__(self, name: str) -> ForecastRow:
        by_name = {row.name: row for row in self.rows}
        one_of("a row of a forecast", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def ranking(self) -> tuple[str, ...]:
        """The aggregates' names, the highest score first."""
        return tuple(row.name for row in self.rows if row.aggregate)

    @property
    def used(self) -> ForecastRow:
        """The row of the potential that the curriculum uses."""
        return next(row for row in self.rows if row.used)

    @property
    def best(self) -> ForecastRow:
        """The row with the highest score, of those in the trial if there is one."""
        rows = [row for row in self.rows if row.gain is not None] or self.rows
        return max(rows, key=lambda row: np.nan_to_num(row.score, nan=-np.inf))

    @property
    def computed_from(self) -> str:
        """A clause on the seeds and steps of the sources, and on mappings found by a search."""
        return f"{self._learnt_from}{self._found}"

    @property
    def _found(self) -> str:
        return f", {FOUND}" * self.knows_target

    @property
    def _learnt_from(self) -> str:
        if self.perfect:
            return f"if {_listed(self.trained)} were learnt perfectly"
        seeds = len(self.rows[0].seeds)
        sources = list[str]()
        for name, source in self.trained.items():
            average = " on average" * bool(np.ptp(source.steps_used))
            sources.append(f"{name} ({source.steps_used.mean():,.0f} steps{average})")
        return f"from {counted(seeds, 'seed')} of {_listed(sources)}"

    @property
    def answer(self) -> str:
        """Whether the curriculum will pay, in a few words; and whether its mapping was found."""
        pays = "whether it pays is open"
        if self.trial is not None:
            pays = self.trial.verdict(self.used.name)
        return f"{pays}{self._found}"

    @property
    def basis(self) -> str:
        """The numbers behind the answer and their assumptions, or why there was no trial."""
        if self.trial is None:
            return f"no trial: {self.no_trial}"
        return f"{self.trial.numbers(self.used.name)}; {self.trial.assumes}"

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = 80) -> str:
        """Return sentences and a table, in lines of at most `width` characters."""
        above = [*self._head, *(f"{name}: {cover}" for name, cover in self.coverage.items())]
        below = [f"{row.name}: {row.verdict}" for row in self.rows if row.aggregate]
        columns, cells = _table_of(self)
        return "\n".join(
            [
                *(folded(line, width) for line in above),
                *text_table(["", *columns], cells, width),
                *(folded(line, width) for line in below),
            ]
        )

    def __repr__(self) -> str:
        names = ", ".join(row.name for row in self.rows)
        return shortened(f"Forecast({self.target!r}: {self.answer}; potentials: {names})")

    def _repr_html_(self) -> str:
        """Return the answer with its basis, the table and coverage."""
        columns, cells = _table_of(self)
        verdicts = [row.verdict * row.aggregate for row in self.rows]
        rows = [(*row, verdict) for row, verdict in zip(cells, verdicts, strict=True)]
        last = "start, in words"
        return block(
            *self._head,
            table(["potential", *columns, last], rows, wide=[last]),
            "* the one that the curriculum uses",
            self.coverage and coverage_table(self.coverage),
        )

    @property
    def _head(self) -> list[str]:
        """The sentences above the table: the answer with its basis, and the start."""
        lines = [f"Forecast for {self.target!r}: {self.answer}", self.basis]
        if self.trial is not None:
            lines += [
                f"{name} failed: {in_words(error)}"
                for name, error in self.trial.comparison.failed.items()
                if name != self.used.name  # whose error is the basis
            ]
            lines += [f"the highest gain in the trial: {self.best.name}"] * (not self.best.used)
        lines += map(str, self.sources.values())
        # Transfers that may be anti-knowledge; a single transfer has the row of its aggregate.
        alone = [row for row in self.rows if not row.aggregate] or self.rows[:1]
        lines += [f"{row.name} {row.anti_knowledge}" for row in alone if row.anti_knowledge]
        how = "exact" if self.exact else "returns by rollouts"
        if not self.solved and _values_are_read(self):
            how += "; Q* estimated by the values of phi's own policy"
        optimum = "" if np.isnan(self.optimum) else f"optimum {self.optimum:.4g}, "
        start = f"The start with phi, {self._learnt_from}: {optimum}random policy "
        return [*lines, f"{start}{self.random_return:.4g} ({how})"]


def _listed(names: Iterable[str]) -> str:
    """Return names as a list in a sentence."""
    *some, last = names
    return f"{', '.join(some)} and {last}" if some else last


COLUMNS: dict[str, Callable[[ForecastRow], str]] = {
    "gain": lambda row: "" if row.gain is None else f"{row.gain.estimate:.3g}",
    "start": lambda row: or_dash(row.mean("start")),
    "phi > Q*": lambda row: or_dash(row.mean("optimistic"), ".0%"),
    "excess": lambda row: or_dash(row.mean("excess"), ".2g"),
    "rank": lambda row: or_dash(row.mean("rank"), ".2f"),
    "scale": lambda row: "none" if np.isnan(row.scale) else f"{row.scale:.2g}",
}
"""The columns of the table of rows."""


def _table_of(forecast: Forecast) -> tuple[list[str], list[tuple[str, ...]]]:
    """Return the columns of a forecast and its rows: name, with a star if it is used, and cells."""
    # Gains need a trial; columns about phi need potentials whose values are read.
    left_out = {"gain"} if all(row.gain is None for row in forecast.rows) else set()
    if not _values_are_read(forecast):
        left_out |= COLUMNS.keys() - {"gain", "start"}
    shown = {name: cell for name, cell in COLUMNS.items() if name not in left_out}
    cells = [
        (row.name + " *" * row.used, *(cell(row) for cell in shown.values()))
        for row in forecast.rows
    ]
    return list(shown), cells


def _values_are_read(forecast: Forecast) -> bool:
    """Return whether learning reads the potentials' values; False where networks enter."""
    return not all(np.isnan(row.mean("optimistic")) for row in forecast.rows)


AnyTarget = Target | ObservationTarget

# Thresholds of the sentences; benchmarks/check_forecast.py compares them with training.
GAIN, GOOD = 0.1, 0.5  # a start is weak, good above these shares of the way to the optimum
OPTIMISTIC = 0.5  # share of optimistic pairs above which learning keeps lowering values
SLIPS, COLLAPSES = 0.2, 0.25  # mean excess / mean abs(V*) from which returns may fall, will fall
ESTIMATED = 0.45  # both, if the excess is over the value of phi's own policy, which is at most V*
UNDERESTIMATE = 20.0  # typical rewards by which phi may be too low where the optimal policy goes
RAISED = 1.15  # scale above which a calibration is worth its steps


def start_words(row: ForecastRow, target: AnyTarget, reads_values: bool) -> str:
    """Return a sentence on a potential's start, on whether returns then fall, and on what to do."""
    start, optimistic = row.mean("start"), row.mean("optimistic")
    if not reads_values:
        policy = "" if np.isnan(start) else f", which returns {start:.3g} in the target as it is"
        return f"its network or policy enters{policy}; its values are not read"
    if np.isnan(start):
        return "is the same for all actions, so it has no greedy policy: use StateShaping"
    excess = row.mean("excess") / max(row.mean("mean_absolute_value"), 1e-12)
    # If the optimum is unknown, any start above the random policy is good.
    gain = start - target.random_return
    whole = np.nan_to_num(target.optimum - target.random_return)
    good = gain > GOOD * whole
    parts = [f"starts at {start:.3g}"]
    if not good:
        parts.append("a weak start" if gain > GAIN * whole else "near or below the random policy")
    parts.append(f"{optimistic:.0%} optimistic")
    slips, collapses = (SLIPS, COLLAPSES) if row.seeds[0].exact else (ESTIMATED, ESTIMATED)
    # From a weak start returns can hardly fall, and its policy is little evidence of phi's scale.
    if not good:
        advice = ["the gain from there is unknown"]
    elif optimistic > OPTIMISTIC and excess >= slips:
        fall = "expect a fall" if excess >= collapses else "returns may fall"
        advice = [f"{fall} from there under epsilon-greedy"]
    else:
        advice = ["expect no fall from there"]
    if good and excess > 0 and row.scale > RAISED:
        advice.append(f"calibrate with c = {row.scale:.1f}")
    worst = max(row.seeds, key=lambda seed: np.nan_to_num(seed.largest_underestimate))
    if worst.largest_underestimate > UNDERESTIMATE * target.typical_reward:
        task: Any = target.task
        where = state_name(task.states, worst.most_underestimated_state)
        advice.append(
            f"underestimates {where}, which the optimal policy visits, by "
            f"{worst.largest_underestimate:.3g}: a portfolio limits what that costs"
        )
    return f"{', '.join(parts)}: {'; '.join(advice)}"


def anti_knowledge(row: ForecastRow, random_return: float) -> str:
    """Return a sentence on signs that a potential misleads; '' without signs."""
    # Sign 1: Student's 95 % interval of the greedy policy's return lies below the random policy's
    # return (for a single seed, or seeds that agree, the return itself does). Sign 2: phi and Q*
    # correlate negatively in every seed. The sentence says "may", because some such potentials
    # pay nevertheless: docs/trust.md says how many.
    signs = []
    starts, ranks = (np.array([getattr(k, of) for k in row.seeds]) for of in ("start", "rank"))
    high, mean = float(mean_interval(starts).high), float(starts.mean())
    end = mean if np.isnan(high) else high
    if end < random_return and not math.isclose(end, random_return, rel_tol=ROUNDING):
        below = f"below the random policy's {random_return:.3g}"
        signs.append(f"its policy starts at {mean:.3g}, {below}")
    if (ranks < 0).all():
        other = "Q*" if row.seeds[0].exact else "the returns of its own policy"
        against = f"its order of the pairs is against that of {other}"
        signs.append(f"{against} (rank {ranks.mean():.2f})")
    return f"may be anti-knowledge: {'; '.join(signs)}" if signs else ""


# -- Making a forecast ---------------------------------------------------------------------------


def forecast(
    curriculum: Curriculum,
    target: str | None = None,
    *,
    seeds: int | Sequence[int] = 3,
    aggregates: Sequence[Aggregate] = (),
    trained: Mapping[str, Learnt] | None = None,
    perfect: bool = False,
    episodes: int | None = None,
    trial: bool | None = None,
    opponents: Sequence[Opponent] = OPPONENTS,
    scratch: Learners = (),
    threshold: float | None = None,
    workers: int | None = None,
    progress: Progress = None,
    judged: "JudgedPotentials | None" = None,
) -> Forecast:
    """Return the forecast of whether the transfers into a target pay and where learning starts.

    A trial tells whether they pay: it plays the comparison with learning from scratch in the tasks'
    models, with other random draws than :func:`compare` and :meth:`Curriculum.train`. Without a
    model there is no trial, and only the greedy policies of the potentials are rolled out.

    Parameters
    ----------
    curriculum : Curriculum
        ``curricle.forecast`` also takes a study of one arm or its path.
    target : str, optional
        By default the task to which all other tasks lead.
    seeds : int or sequence of int
        Seeds of the sources from which potentials are made.
    aggregates : sequence of callable
        Aggregates to compare besides the library's four and the curriculum's.
    trained : dict of str to SourceValues or LearningResult, optional
        Sources that were trained before, for the same seeds. A trial trains its sources anew.
    perfect : bool
        Whether to take the optimal values of each source instead of training it; without a trial.
    episodes : int, optional
        Rollouts of each potential if the target is live or too large to evaluate exactly: by
        default 1000, or 50 for an observation task.
    trial : bool, optional
        True for a trial of 20 seeds, False for none. By default there is a trial of 8 to 20 seeds
        if the tasks have models and it takes at most about 10 s on one processor.
    opponents, scratch, threshold : optional
        The learners without sources against which the trial asks whether the curriculum pays, and
        the return that counts as learnt, as in :func:`compare`.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each learnt task and for the potentials; a function is called with the
        name of each potential, and with "trial" after the trial.
    judged : JudgedPotentials, optional
        Computations to share with other forecasts for the same target.

    Raises
    ------
    CurriculumError
        If the target is not unique or has no transfer into it, a source cannot be solved as
        `perfect` needs, or ``trial=True`` lacks a model or a budget in steps.

    Examples
    --------
    >>> from curricle import Pursuit, Transfer, maximum, project
    >>> hunt, chase = Pursuit(3, 2, time_limit=50), Pursuit(3, 1, time_limit=50)
    >>> plan = Curriculum(
    ...     tasks={"chase": chase, "hunt": hunt},
    ...     transfers=[Transfer("chase", "hunt", project(hunt, chase, predator=name))
    ...                for name in hunt.predator_names],
    ...     aggregate=maximum, budget=50_000)
    >>> forecast(plan, trial=False).ranking
    ('minimum', 'mean', 'total', 'maximum')
    """
    check_progress(progress)
    instance("the curriculum of a forecast", curriculum, Curriculum, CurriculumError)
    name = curriculum.target if target is None else target
    if not (edges := curriculum.in_edges(name)):
        raise CurriculumError(f"a forecast needs a task with transfers into it: {name!r} has none")
    for function in aggregates:
        if not callable(function):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): got {function!r}"
            )
    judged = JudgedPotentials() if judged is None else judged
    evaluation = curriculum.setting("evaluation", name)
    any_target = judged.target(curriculum.tasks[name], evaluation, episodes)
    numbers = seed_tuple(seeds)[:1] if perfect else seed_tuple(seeds)
    candidates = candidates_of(curriculum, name, aggregates)
    tried, trial_seeds, no_trial = _planned_trial(candidates, trial, perfect)
    reads_values = curriculum.setting("shaping", name).reads_values
    made_trial: Trial | None = None
    learnt, rows = dict[str, Any](), list[ForecastRow]()
    with shown(progress) as bars:
        if perfect:
            sources = _solved_sources(curriculum, name, numbers, trained or {})
        else:
            learning: Any = {"trained": trained, "workers": workers, "progress": bars.within()}
            before = curriculum.ancestors(name)
            sources = curriculum.train(numbers, only=before, **learning).sources
        # Potentials whose values are not read do not differ.
        looked_at = [candidate for candidate in candidates if candidate.used or reads_values]
        grow = bars.bar("potentials", len(looked_at))
        for candidate in looked_at:
            phi = tuple(candidate.curriculum.entering(name, sources, numbers)[0])
            of_seeds = judged.judgement(any_target, phi, workers, reads_values=reads_values)
            row = ForecastRow(candidate.name, candidate.aggregate, candidate.used, *of_seeds)
            start = start_words(row, any_target, reads_values)
            against = anti_knowledge(row, any_target.random_return)
            rows.append(replace(row, verdict=start, anti_knowledge=against))
            grow()
            bars.tell(candidate.name)
        if tried:
            how: Any = {"memory": judged.memory, "workers": workers, "progress": bars.within()}
            how |= {"opponents": opponents, "scratch": scratch}
            how["reference"] = Reference.of(any_target, threshold)
            try:
                made_trial = run_trial(tried, seeds=trial_seeds, **how)
                bars.tell("trial")
            except CurricleError as error:  # the potentials can be judged without the trial
                if trial is not None:
                    raise
                no_trial = f"it failed: {error}"
        if not perfect:
            learnt |= source_learning(curriculum, sources, workers=workers, progress=bars.within())
            learnt |= distilled_sources(curriculum.tasks, sources)
    if made_trial is not None:
        rows = [replace(row, gain=made_trial.gain(row.name)) for row in rows]
    scores = {row.name: np.nan_to_num(row.score, nan=-np.inf) for row in rows}
    rows.sort(key=lambda row: (not row.aggregate, row.gain is None, -scores[row.name]))
    labels = dict(zip(transfer_names(edges), edges, strict=True))
    coverage: dict[str, Any]  # of mappings whose pairs are few enough to count
    if isinstance(any_target, ObservationTarget):
        sample = any_target.observations(curriculum.potentials(name, sources)[0])
        coverage = {label: edge.mapping.coverage(sample) for label, edge in labels.items()}
    else:
        countable = {label: edge for label, edge in labels.items() if edge.mapping.countable}
        coverage = {label: edge.mapping.coverage() for label, edge in countable.items()}
    return Forecast(
        name,
        coverage,
        tuple(rows),
        any_target.optimum,
        any_target.random_return,
        solved=any_target.solution is not None,
        exact=any_target.evaluation.method == "exact",
        trained=sources,
        perfect=perfect,
        sources=learnt,
        trial=made_trial,
        no_trial=no_trial,
        knows_target=curriculum.knows_target(name),
    )


def _planned_trial(
    candidates: list[Candidate], trial: bool | None, perfect: bool
) -> tuple[list[Candidate], int, str]:
    """Return a trial's candidates, its seeds, and why there is no trial if there is none."""
    if perfect and trial:
        raise CurriculumError(
            "a trial trains the sources: with perfect=True, trial must be False or left out"
        )
    if not isinstance(trial, bool | None):
        raise CurriculumError(f"trial must be True, False or None: got {trial!r}")
    if perfect or trial is False:
        return [], 0, "no source is trained" if perfect else "none was asked for"
    (used,) = (candidate for candidate in candidates if candidate.used)
    why = hindrance(used.curriculum)
    if why and trial:
        raise CurriculumError(f"a trial needs models and a budget in steps: {why}")
    if why:
        return [], 0, f"{why}; cr.choose(..., on=) plays on a smaller relative"
    if trial:
        return candidates, SEEDS, ""
    tried, seeds = affordable(candidates)
    return (
        tried,
        seeds,
        "" if seeds else "it would take long; trial=True or curricle check --forecast makes it",
    )


def _solved_sources(
    curriculum: Curriculum, name: str, seeds: tuple[int, ...], trained: Mapping[str, Learnt]
) -> dict[str, SourceValues]:
    """Return the optimal values of a target's sources, as if they were learnt in 0 steps."""
    if trained:
        raise CurriculumError(
            "a forecast with perfect=True must have no trained sources: got " + ", ".join(trained)
        )
    solved = {}
    for edge in curriculum.in_edges(name):
        node = curriculum.node(edge.source)
        known = not node.deep and not is_observation_task(node.task)
        solution = Target.of(node.task, node.evaluation).solution if known else None
        if solution is None:
            raise CurriculumError(
                "a forecast with perfect=True needs sources that can be solved: "
                f"{node.name!r} cannot"
            )
        no_steps = np.zeros(len(seeds), np.int64)
        solved[node.name] = SourceValues(node.task, seeds, solution.action_values[None], no_steps)
    return solved


Judgement = tuple[tuple[PotentialQuality, ...], tuple[Calibration, ...]]  # of K seeds


@dataclass(frozen=True)
class JudgedPotentials:
    """Cache of targets, of judgements of their potentials, and of the trials' scratch arms."""

    memory: Memory = field(default_factory=Memory)
    _targets: dict[Any, AnyTarget] = field(default_factory=dict)
    _judgements: dict[Any, Judgement] = field(default_factory=dict)

    def target(self, task: Any, evaluation: GreedyEvaluation, episodes: int | None) -> AnyTarget:
        """Return a task as a target; equal calls return the same target, which is solved once."""
        # A target keeps its task alive, so that no other task gets the id; `episodes` is unchecked.
        key = id(task), evaluation, repr(episodes)
        if key not in self._targets:
            self._targets[key] = target_of(task, evaluation, episodes=episodes)
        return self._targets[key]

    def judgement(
        self,
        target: AnyTarget,
        potentials: tuple[AnyPotential, ...],
        workers: int | None,
        *,
        reads_values: bool,
    ) -> Judgement:
        """Return the qualities and calibrations of potentials; of networks only their returns."""
        n, key = len(potentials), None
        if all(isinstance(phi, PairPotential) for phi in potentials):
            key = id(target), *map(_digest, potentials)
            if key in self._judgements:
                return self._judgements[key]
        if not reads_values:
            nan, seen = float("nan"), cast(Any, target)
            starts = [policy_return(phi, seen, seed=k) for k, phi in enumerate(potentials)]
            return tuple(PotentialQuality(start, nan, nan, nan, nan) for start in starts), ()
        of_actions: Sequence[Any] = potentials
        if isinstance(target, ObservationTarget):
            threads, fit = 0, Calibrate(target.episodes)
            of_actions = potentials if potentials[0].of_actions else ()
        else:
            threads, fit = threads_for(target.task, workers, n), Calibrate()
        seeds = over_seeds(lambda k: potential_quality(potentials[k], target, seed=k), n, threads)
        calibrations = (fit_calibration(phi, fit, seed=k) for k, phi in enumerate(of_actions))
        judgement = tuple(seeds), tuple(calibrations)
        if key is not None:
            self._judgements[key] = judgement
        return judgement


def _digest(potential: Any) -> bytes:
    """Return a digest of the numbers that a potential is made of."""
    numbers: Iterable[Any] = potential.kernel or (potential.values,)
    return blake2b(pickle.dumps((type(potential).__name__, *numbers))).digest()
