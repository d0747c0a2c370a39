"""Forecast: will a curriculum pay, and where does learning start? Before training in the target.

Whether it pays is answered by a trial (:mod:`curricle.comparison.trial`). About each potential it
says where learning starts: the return of the greedy policy on phi, and whether phi is so high that
epsilon-greedy learning falls from there.
"""

import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from typing import Any, cast

import numpy as np

from curricle.checks import instance, one_of
from curricle.comparison.comparing import threshold_of_optimum
from curricle.comparison.learnt_sources import (
    DistilledSource,
    SourceLearning,
    distilled_sources,
    source_learning,
)
from curricle.comparison.plan import Memory
from curricle.comparison.trial import (
    Candidate,
    Trial,
    affordable,
    candidates_of,
    hindrance,
    run_trial,
)
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import Learnt, SourceValues
from curricle.deep.learning import policy_return
from curricle.display import block, table
from curricle.errors import CurricleError, CurriculumError
from curricle.learning.potential import PairPotential
from curricle.learning.seeds import over_seeds, seed_tuple, threads_for
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import Target
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.statistics.intervals import Interval, mean_interval
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.spaces import state_name
from curricle.text import brief_repr, counted, folded, or_dash, shortened, text_table
from curricle.transfer.aggregate import Aggregate
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.mapping import Coverage, coverage_table
from curricle.transfer.observation_mapping import ObservationCoverage
from curricle.transfer.rollouts import (
    ObservationTarget,
    PotentialQuality,
    potential_quality,
    target_of,
)
from curricle.transfer.transfer import Calibrate, transfer_names

# -- The record of a forecast, and what it says in words ----------------------------------------
#
# The words about a potential are about the start and about what it knows. What learning then gains
# is another question: from a low start it can gain more than from scratch.


@dataclass(frozen=True)
class ForecastRow:
    """One potential as it would enter the target: a single source's, or an aggregate."""

    name: str  # the transfer, as "source -> target [n]", or the aggregate's name
    aggregate: bool  # whether it is an aggregate of all transfers
    used: bool  # whether the curriculum would use it
    seeds: tuple[PotentialQuality, ...] = field(repr=False)  # K of them
    # K of its scale, from rollouts of its greedy policy.
    calibrations: tuple[Calibration, ...] = field(repr=False)
    gain: Interval | None = None  # in mean return, strong, of a trial in the model; None without
    verdict: str = ""  # what the start is, whether it lasts, and what to do, in words
    # That it may be worse than knowing nothing and in what, in words; empty if in nothing.
    anti_knowledge: str = ""

    __repr__ = brief_repr

    def _repr_html_(self) -> str:
        gain = None if self.gain is None else f"gain in the trial: {self.gain}"
        return block(self.name, self.verdict, self.anti_knowledge, gain)

    def mean(self, measure: str) -> float:
        """Return the mean over seeds of a field of ``PotentialQuality``."""
        return float(np.mean([getattr(quality, measure) for quality in self.seeds]))

    @property
    def scale(self) -> float:
        """The mean scale that calibration finds; NaN if it finds none for most seeds."""
        scales = [calibration.scale for calibration in self.calibrations if not calibration.refusal]
        most = scales and 2 * len(scales) > len(self.calibrations)
        return float(np.mean(scales)) if most else float("nan")

    @property
    def score(self) -> float:
        """What orders candidates: the gain of the trial, else the start; NaN if unknown."""
        return self.mean("start") if self.gain is None else float(self.gain.estimate)


@dataclass(frozen=True, eq=False)
class Forecast:
    """Whether the transfers into a target will pay, and where learning starts. Prints as a table.

    Attributes
    ----------
    target : str
    coverage : dict of str to Coverage or ObservationCoverage
        Of each transfer's mapping; of observations that the first seed's greedy policy meets.
    rows : tuple of ForecastRow
        Aggregates, then each transfer alone; both with the highest score first.
    optimum, random_return : float
        Expected return of an optimal policy (NaN if the target is too large to solve), and of the
        random policy, with which learning from scratch starts.
    solved : bool
        Whether potentials are compared with the exact Q*.
    exact : bool
        Whether returns are exact too.
    trained : dict of str to SourceValues
        The sources, as :meth:`Curriculum.train` takes them; with `perfect` their optimal values.
    perfect : bool
        Whether the sources were solved instead of trained.
    sources : dict of str to SourceLearning or DistilledSource
        How much of its own task each source learnt, where that is known.
    trial : Trial or None
        The comparison with learning from scratch, in the model or on a smaller relative.
    no_trial : str
        Why there is none, in words.
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
        """The row of the potential that the curriculum would use."""
        return next(row for row in self.rows if row.used)

    @property
    def best(self) -> ForecastRow:
        """The row with the highest score, transfers alone included."""
        return max(self.rows, key=lambda row: np.nan_to_num(row.score, nan=-np.inf))

    @property
    def computed_from(self) -> str:
        """What the sources' values are, in words."""
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
        """Whether the curriculum will pay, in a few words."""
        if self.trial is None:
            return "whether it pays is open"
        return self.trial.verdict(self.used.name)

    @property
    def basis(self) -> str:
        """The numbers that the answer rests on and what they assume, or why there are none."""
        if self.trial is None:
            return f"no trial: {self.no_trial}"
        return f"{self.trial.numbers(self.used.name)}; {self.trial.assumes}"

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = 80) -> str:
        """Return sentences and a table, in lines of so many characters at most."""
        above = [*self._head, *(f"{name}: {cover}" for name, cover in self.coverage.items())]
        words = [f"{row.name}: {row.verdict}" for row in self.rows if row.aggregate]
        return "\n".join(
            [
                *(folded(line, width) for line in above),
                *text_table(["", *columns(self)], _cells_of(self), width),
                *(folded(line, width) for line in words),
            ]
        )

    def __repr__(self) -> str:
        names = ", ".join(row.name for row in self.rows)
        return shortened(f"Forecast({self.target!r}: {self.answer}; potentials: {names})")

    def _repr_html_(self) -> str:
        """Return the answer, what that rests on, the table and coverage."""
        words = [row.verdict if row.aggregate else "" for row in self.rows]
        rows = [(*row, text) for row, text in zip(_cells_of(self), words, strict=True)]
        last = "start, in words"
        return block(
            *self._head,
            table(["potential", *columns(self), last], rows, wide=[last]),
            "* the one that the curriculum uses",
            self.coverage and coverage_table(self.coverage),
        )

    @property
    def _head(self) -> list[str]:
        """The sentences above the table: the answer, what it rests on, and the start."""
        lines = [f"Forecast for {self.target!r}: {self.answer}", self.basis]
        if self.trial is not None and not self.trial.relative and not self.best.used:
            lines.append(f"the highest gain in the trial: {self.best.name}")
        lines += map(str, self.sources.values())
        # The transfers that may be anti-knowledge; a single one is its aggregate's row.
        alone = [row for row in self.rows if not row.aggregate] or self.rows[:1]
        lines += [f"{row.name} {row.anti_knowledge}" for row in alone if row.anti_knowledge]
        how = "exact" if self.exact else "returns by rollouts"
        if not self.solved and _values_are_read(self):
            how += "; Q* estimated by the values of phi's own policy"
        optimum = "" if np.isnan(self.optimum) else f"optimum {self.optimum:.4g}, "
        start = f"The start with phi, {self.computed_from}: {optimum}random policy "
        return [*lines, f"{start}{self.random_return:.4g} ({how})"]


def _listed(names: Iterable[str]) -> str:
    """Return names as a list in words."""
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
"""What each column shows of a row."""


def columns(forecast: Forecast) -> list[str]:
    """Return those it has: gains where there was a trial, and values where potentials have them."""
    left_out = set[str]()
    if all(row.gain is None for row in forecast.rows):
        left_out = {"gain"}
    if not _values_are_read(forecast):
        left_out |= COLUMNS.keys() - {"gain", "start"}
    return [name for name in COLUMNS if name not in left_out]


def _cells_of(forecast: Forecast) -> list[tuple[str, ...]]:
    """Return the name of each potential, with a star if it is used, and its columns."""
    shown = [COLUMNS[name] for name in columns(forecast)]
    return [(row.name + " *" * row.used, *(cell(row) for cell in shown)) for row in forecast.rows]


def _values_are_read(forecast: Forecast) -> bool:
    """Return whether potentials are compared with values; not where networks enter."""
    return not all(np.isnan(row.mean("optimistic")) for row in forecast.rows)


AnyTarget = Target | ObservationTarget

# Thresholds of the verdicts; benchmarks/check_forecast.py compares them with training.
GAIN, GOOD = 0.1, 0.5  # shares of the way from random to the optimum: weak, good
OPTIMISTIC = 0.5  # share of optimistic pairs above which learning keeps lowering values
SLIPS, COLLAPSES = 0.2, 0.25  # mean excess / mean abs(V*) above which returns then fall
ESTIMATED = 0.45  # the same if the excess is over the value of phi's own policy, less than V*
UNDERESTIMATE = 20.0  # typical rewards by which phi may be too low where the optimal policy goes
RAISED = 1.15  # scale above which a calibration is worth its steps


def start_words(row: ForecastRow, target: AnyTarget) -> str:
    """Return what the start with a potential is, whether it lasts, and what to do, in words."""
    if np.isnan(row.mean("start")):
        return "is the same for all actions, so it has no greedy policy: use StateShaping"
    start = row.mean("start")
    excess = row.mean("excess") / max(row.mean("mean_absolute_value"), 1e-12)
    words = [f"starts at {start:.3g}"]
    # If the optimum is unknown, any better start is a good one.
    gain = start - target.random_return
    whole = np.nan_to_num(target.optimum - target.random_return)
    good = gain > GOOD * whole
    if not good:
        weak = gain > GAIN * whole
        words.append("a weak start" if weak else "near or below the random policy")
    words.append(f"{row.mean('optimistic'):.0%} optimistic")
    slips, collapses = (SLIPS, COLLAPSES) if row.seeds[0].exact else (ESTIMATED, ESTIMATED)
    advice = []
    # A weak start has little to lose, and its policy is little evidence of phi's scale.
    if good and row.mean("optimistic") > OPTIMISTIC and excess >= slips:
        fall = "expect a fall" if excess >= collapses else "returns may fall"
        advice.append(f"{fall} from there under epsilon-greedy")
    elif good:
        advice.append("expect no fall from there")
    else:
        advice.append("what learning gains from there is open")
    if good and excess > 0 and row.scale > RAISED:
        advice.append(f"calibrate with c = {row.scale:.1f}")
    worst = max(row.seeds, key=lambda seed: np.nan_to_num(seed.largest_underestimate))
    if worst.largest_underestimate > UNDERESTIMATE * target.typical_reward:
        task: Any = target.task
        where = state_name(task.states, worst.most_underestimated_state)
        advice.append(
            f"underestimates {where}, which the optimal policy visits, by"
            f" {worst.largest_underestimate:.3g}: a guard bounds what that costs"
        )
    return ", ".join(words) + (": " + "; ".join(advice) if advice else "")


def network_words(row: ForecastRow) -> str:
    """Return what enters where values are not read, and what its policy returns, in words."""
    start = row.mean("start")
    policy = "" if np.isnan(start) else f", which returns {start:.3g} in the target as it is"
    return f"its network or policy enters{policy}; its values are not read"


def anti_knowledge(row: ForecastRow, random_return: float) -> str:
    """Return in what a potential is worse than knowing nothing, in words; empty if in nothing."""
    # Its greedy policy returns less than the random one by more than the seeds differ (Student's
    # interval of 95 %; for a single seed, or where all agree, at all), or its order of the pairs is
    # against that of Q* in every seed. The words are weak because some such potentials pay all the
    # same: docs/trust.md says how many.
    signs = []
    starts, ranks = (np.array([getattr(k, of) for k in row.seeds]) for of in ("start", "rank"))
    high, mean = float(mean_interval(starts).high), float(starts.mean())
    if (mean if np.isnan(high) else high) < random_return:
        signs.append(
            f"its policy starts at {mean:.3g}, below the random policy's {random_return:.3g}"
        )
    if (ranks < 0).all():
        other = "Q*" if row.seeds[0].exact else "the returns of its own policy"
        words = f"its order of the pairs is against that of {other}"
        signs.append(f"{words} (rank {ranks.mean():.2f})")
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
    trial: bool | Curriculum | None = None,
    threshold: float | None = None,
    workers: int | None = None,
    progress: Progress = None,
    only_used: bool = False,
    judged: "JudgedPotentials | None" = None,
) -> Forecast:
    """Return a forecast: whether the transfers into a target pay, and where learning starts.

    Whether they pay is answered by a trial: the comparison with learning from scratch, played in
    the tasks' models. It shares no random draw with :func:`compare` or :meth:`Curriculum.train`. In
    a target without a model potentials are rolled out alone.

    Parameters
    ----------
    curriculum : Curriculum
        ``curricle.forecast`` also takes a study of one arm or its path.
    target : str, optional
        By default the task that all others lead to.
    seeds : int or sequence of int
        Of the sources whose potentials are looked at.
    aggregates : sequence of callable
        In addition to the library's four and the curriculum's own.
    trained : dict of str to SourceValues or LearningResult, optional
        Sources trained before, for the same seeds. A trial trains its own.
    perfect : bool
        Whether to take the optimal values of each source instead of training it; without a trial.
    episodes : int, optional
        Rollouts of each potential if the target is live or too large to evaluate exactly: by
        default 1000, or 50 for an observation task.
    trial : bool or Curriculum, optional
        True for a trial of 20 seeds, whatever it takes; False for none; by default one of 8 to 20
        seeds, where the tasks have models and it takes 5 s or less on one processor, about. A
        curriculum is a smaller relative, the verdict on which is carried over, and says so.
    threshold : float, optional
        Return that counts as learnt in the trial, as in :func:`compare`.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task that is learnt and for the potentials; a function is called
        with the name of each potential when it has been looked at, and with "trial" after one.
    only_used : bool
        Whether it has a row for the potential that the curriculum would use, and no other.
    judged : JudgedPotentials, optional
        What other forecasts for the same target have computed.

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
    >>> found = forecast(plan, trial=False)
    >>> found.ranking
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
    _check_trial(candidates, trial, perfect)
    reads_values = curriculum.setting("shaping", name).reads_values
    made_trial, no_trial, learnt = None, "no source is trained", dict[str, Any]()
    rows = list[ForecastRow]()
    with shown(progress) as bars:
        sources = _sources(curriculum, name, numbers, trained, perfect, workers, bars)
        all_rows = reads_values and not only_used  # without values, potentials do not differ
        looked_at = [candidate for candidate in candidates if candidate.used or all_rows]
        grow = bars.bar("potentials", len(looked_at))
        for candidate in looked_at:
            phi = tuple(candidate.potentials(sources, numbers))
            judge = partial(_judgement, phi, any_target, workers, reads_values=reads_values)
            of_seeds = judged.judgement(any_target, phi, judge)
            rows.append(ForecastRow(candidate.name, candidate.aggregate, candidate.used, *of_seeds))
            grow()
            bars.tell(candidate.name)
        if not perfect:
            how = {"memory": judged.memory, "workers": workers, "progress": bars.within()}
            made_trial, no_trial = _trial(candidates, trial, threshold, any_target, how)
            if made_trial is not None:
                bars.tell("trial")
            learnt |= source_learning(curriculum, sources, workers=workers, progress=bars.within())
            learnt |= distilled_sources(curriculum.tasks, sources)
    gains = made_trial if made_trial is not None and not made_trial.relative else None
    rows = [
        replace(
            row,
            gain=None if gains is None else gains.gain(row.name),
            verdict=start_words(row, any_target) if reads_values else network_words(row),
            anti_knowledge=anti_knowledge(row, any_target.random_return),
        )
        for row in rows
    ]
    labels = dict(zip(transfer_names(edges), edges, strict=True))
    coverage: dict[str, Any]  # where the pairs of a mapping are few enough to count
    if isinstance(any_target, ObservationTarget):
        sample = any_target.observations(curriculum.potentials(name, sources)[0])
        coverage = {label: edge.mapping.coverage(sample) for label, edge in labels.items()}
    else:
        countable = {label: edge for label, edge in labels.items() if edge.mapping.countable}
        coverage = {label: edge.mapping.coverage() for label, edge in countable.items()}
    return Forecast(
        target=name,
        coverage=coverage,
        rows=tuple(
            sorted(
                rows, key=lambda row: (not row.aggregate, -np.nan_to_num(row.score, nan=-np.inf))
            )
        ),
        optimum=any_target.optimum,
        random_return=any_target.random_return,
        solved=any_target.solution is not None,
        exact=any_target.evaluation.method == "exact",
        trained=sources,
        perfect=perfect,
        sources=learnt,
        trial=made_trial,
        no_trial=no_trial,
    )


Judgement = tuple[tuple[PotentialQuality, ...], tuple[Calibration, ...]]  # of K seeds


@dataclass(frozen=True)
class JudgedPotentials:
    """Targets, judgements of their potentials and what trials learn alone, computed once."""

    memory: Memory = field(default_factory=Memory)
    _targets: list[tuple[Any, Any, Target | ObservationTarget]] = field(default_factory=list)
    _found: dict[Any, Judgement] = field(default_factory=dict)

    def target(
        self, task: Any, evaluation: GreedyEvaluation, episodes: int | None = None
    ) -> Target | ObservationTarget:
        """Return a task as a target, solved once."""
        how = evaluation, episodes
        for known, settings, target in self._targets:
            if known is task and settings == how:
                return target
        target = target_of(task, evaluation, episodes=episodes)
        self._targets.append((task, how, target))
        return target

    def judgement(
        self,
        target: Target | ObservationTarget,
        potentials: tuple[AnyPotential, ...],
        judge: Callable[[], Judgement],
    ) -> Judgement:
        """Return the judgement of K potentials; `judge` makes it where it is the first of them."""
        if not all(isinstance(one, PairPotential) for one in potentials):
            return judge()
        key = id(target), *map(_digest, potentials)
        if key not in self._found:
            self._found[key] = judge()
        return self._found[key]


def _digest(potential: PairPotential) -> bytes:
    """Return a digest of the numbers that a potential is made of."""
    numbers: Iterable[Any] = potential.kernel or (potential.values,)
    return blake2b(pickle.dumps((type(potential).__name__, *numbers))).digest()


def _sources(
    curriculum: Curriculum,
    name: str,
    seeds: tuple[int, ...],
    trained: Mapping[str, Learnt] | None,
    perfect: bool,
    workers: int | None,
    bars: Bars,
) -> dict[str, SourceValues]:
    """Return what the sources of a target learnt, or their solutions, as if learnt."""
    if perfect and trained:
        raise CurriculumError(
            "a forecast for sources learnt perfectly takes no trained ones: got "
            + ", ".join(trained)
        )
    if not perfect:
        before = curriculum.ancestors(name)
        how: Any = {"trained": trained, "workers": workers, "progress": bars.within()}
        return curriculum.train(seeds, only=before, **how).sources
    solved = {}
    for source in [edge.source for edge in curriculum.in_edges(name)]:
        node = curriculum.node(source)
        known = not node.deep and not is_observation_task(node.task)
        solution = Target.of(node.task, node.evaluation).solution if known else None
        if solution is None:
            raise CurriculumError(
                "a forecast for sources learnt perfectly needs tasks that can be solved: "
                f"{source!r} cannot"
            )
        none = np.zeros(len(seeds), np.int64)
        solved[source] = SourceValues(node.task, seeds, solution.action_values[None], none)
    return solved


def _check_trial(
    candidates: Sequence[Candidate], trial: bool | Curriculum | None, perfect: bool
) -> None:
    """Raise CurriculumError where a trial is asked for that cannot be made, before any training."""
    if perfect and trial:
        raise CurriculumError(
            "a trial trains the sources: with perfect=True, trial must be False or left out"
        )
    if trial is True and (why := hindrance(candidates[0].curriculum)):
        raise CurriculumError(f"a trial needs models and a budget in steps: {why}")
    if not isinstance(trial, bool | Curriculum | None):
        raise CurriculumError(f"trial must be True, False, None or a Curriculum: got {trial!r}")
    if isinstance(trial, Curriculum) and (why := hindrance(trial)):
        raise CurriculumError(f"a smaller relative needs models and a budget in steps: {why}")


def _trial(
    candidates: Sequence[Candidate],
    trial: bool | Curriculum | None,
    threshold: float | None,
    any_target: AnyTarget,
    how: Mapping[str, Any],
) -> tuple[Trial | None, str]:
    """Return the trial of the candidates, or of the used one, or None and why there is none."""
    if trial is False:
        return None, "none was asked for"
    (used,) = (candidate for candidate in candidates if candidate.used)
    if isinstance(trial, Curriculum):
        return run_trial([used], trial, **how), ""
    threshold = threshold_of_optimum(any_target) if threshold is None else threshold
    if trial is True:
        return run_trial(candidates, threshold=threshold, **how), ""
    why = hindrance(used.curriculum)
    if why:
        return None, f"{why}; trial=smaller_curriculum rehearses on a smaller relative"
    tried, seeds = affordable(candidates)
    if not seeds:
        return None, "it would take long; trial=True makes it"
    try:
        return run_trial(tried, seeds=seeds, threshold=threshold, **how), ""
    except CurricleError as error:  # the potentials can be looked at all the same
        return None, f"it failed: {error}"


def _judgement(
    potentials: Sequence[AnyPotential],
    any_target: AnyTarget,
    workers: int | None,
    *,
    reads_values: bool,
) -> Judgement:
    """Return how good potentials are and their scale; of networks what policies return."""
    if not reads_values:
        nan, target = float("nan"), cast(Any, any_target)
        starts = [policy_return(phi, target, seed=k) for k, phi in enumerate(potentials)]
        return tuple(PotentialQuality(start, nan, nan, nan, nan) for start in starts), ()
    of_actions: Sequence[Any]
    if isinstance(any_target, ObservationTarget):
        threads, fit = 0, Calibrate(any_target.episodes)
        of_actions = potentials if potentials[0].of_actions else ()
    else:
        fit, of_actions = Calibrate(), potentials
        threads = threads_for(any_target.task, workers, len(potentials))
    seeds = over_seeds(
        lambda k: potential_quality(potentials[k], any_target, seed=k), len(potentials), threads
    )
    calibrations = tuple(fit_calibration(phi, fit, seed=k) for k, phi in enumerate(of_actions))
    return tuple(seeds), calibrations
