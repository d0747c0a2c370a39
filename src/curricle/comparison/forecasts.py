"""A forecast as a record: rows of potentials, the answer of a trial, and both as text and in words.

The words about a potential are about the start and about what it knows. What learning then gains is
another question: from a low start it can gain more than from scratch.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curricle.checks import one_of
from curricle.comparison.learnt_sources import DistilledSource, SourceLearning
from curricle.comparison.trial import Trial
from curricle.curriculum.result import SourceValues
from curricle.display import block, table
from curricle.errors import CurriculumError
from curricle.planning.target import Target
from curricle.statistics.intervals import Interval, mean_interval
from curricle.tasks.spaces import state_name
from curricle.text import brief_repr, counted, folded, or_dash, shortened, text_table
from curricle.transfer.calibration import Calibration
from curricle.transfer.mapping import Coverage, coverage_table
from curricle.transfer.observation_mapping import ObservationCoverage
from curricle.transfer.rollouts import ObservationTarget, PotentialQuality


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
        return float(np.mean([getattr(one, measure) for one in self.seeds]))

    @property
    def scale(self) -> float:
        """The mean scale that calibration finds; NaN if it finds none for most seeds."""
        found = [one.scale for one in self.calibrations if not one.refusal]
        most = found and 2 * len(found) > len(self.calibrations)
        return float(np.mean(found)) if most else float("nan")

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
        Of each transfer's mapping. In an observation task: over the observations that the greedy
        policy of the first seed's potential meets.
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
        The sources, to be passed to :meth:`Curriculum.train`; with `perfect` their optimal values.
    perfect : bool
        Whether the sources were solved instead of trained.
    sources : dict of str to SourceLearning or DistilledSource
        How much of its own task each source learnt; of tables that were trained, and of networks
        distilled from miniatures.
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
        by_name = {one.name: one for one in self.rows}
        one_of("a row of a forecast", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def ranking(self) -> tuple[str, ...]:
        """The aggregates' names, the highest score first."""
        return tuple(one.name for one in self.rows if one.aggregate)

    @property
    def used(self) -> ForecastRow:
        """The row of the potential that the curriculum would use."""
        return next(one for one in self.rows if one.used)

    @property
    def best(self) -> ForecastRow:
        """The row with the highest score, transfers alone included."""
        return max(self.rows, key=lambda one: np.nan_to_num(one.score, nan=-np.inf))

    @property
    def computed_from(self) -> str:
        """What the sources' values are, in words."""
        if self.perfect:
            return f"if {_listed(self.trained)} were learnt perfectly"
        seeds = len(self.rows[0].seeds)
        sources = [f"{name} ({_steps(one)})" for name, one in self.trained.items()]
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
        words = [f"{one.name}: {one.verdict}" for one in self.rows if one.aggregate]
        return "\n".join(
            [
                *(folded(line, width) for line in above),
                *text_table(["", *columns(self)], _rows(self), width),
                *(folded(line, width) for line in words),
            ]
        )

    def __repr__(self) -> str:
        names = ", ".join(one.name for one in self.rows)
        return shortened(f"Forecast({self.target!r}: {self.answer}; potentials: {names})")

    def _repr_html_(self) -> str:
        """Return the answer, what that rests on, the table and coverage."""
        words = [one.verdict if one.aggregate else "" for one in self.rows]
        rows = [(*row, text) for row, text in zip(_rows(self), words, strict=True)]
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
        alone = [one for one in self.rows if not one.aggregate] or self.rows[:1]
        lines += [f"{one.name} {one.anti_knowledge}" for one in alone if one.anti_knowledge]
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


def _steps(source: SourceValues) -> str:
    """Return for how many steps the seeds of a source were trained."""
    steps = source.steps_used
    return f"{steps.mean():,.0f} steps" + " on average" * bool(np.ptp(steps))


COLUMNS: dict[str, Callable[[ForecastRow], str]] = {
    "gain": lambda one: "" if one.gain is None else f"{one.gain.estimate:.3g}",
    "start": lambda one: or_dash(one.mean("start")),
    "phi > Q*": lambda one: or_dash(one.mean("optimistic"), ".0%"),
    "excess": lambda one: or_dash(one.mean("excess"), ".2g"),
    "rank": lambda one: or_dash(one.mean("rank"), ".2f"),
    "scale": lambda one: "none" if np.isnan(one.scale) else f"{one.scale:.2g}",
}
"""What each column shows of a row."""


def columns(forecast: Forecast) -> list[str]:
    """Return those it has: gains where there was a trial, and values where potentials have them."""
    left_out = set[str]()
    if all(one.gain is None for one in forecast.rows):
        left_out = {"gain"}
    if not _values_are_read(forecast):
        left_out |= COLUMNS.keys() - {"gain", "start"}
    return [name for name in COLUMNS if name not in left_out]


def _rows(forecast: Forecast) -> list[tuple[str, ...]]:
    """Return the name of each potential, with a star if it is used, and its columns."""
    shown = [COLUMNS[name] for name in columns(forecast)]
    return [(one.name + " *" * one.used, *(cell(one) for cell in shown)) for one in forecast.rows]


def _values_are_read(forecast: Forecast) -> bool:
    """Return whether potentials are compared with values; not where networks enter."""
    return not all(np.isnan(one.mean("optimistic")) for one in forecast.rows)


AnyTarget = Target | ObservationTarget

# Thresholds of the verdicts; benchmarks/check_forecast.py compares them with training.
GAIN, GOOD = 0.1, 0.5
"""Shares of the way from the random policy's return to the optimum: weak start, good start."""
OPTIMISTIC = 0.5
"""Share of optimistic pairs above which learning keeps lowering values."""
SLIPS, COLLAPSES = 0.2, 0.25
"""Mean excess, in units of mean abs(V*), above which returns then fall under epsilon-greedy."""
ESTIMATED = 0.45
"""The same if the excess is over the value of phi's own policy, which is less than V*."""
UNDERESTIMATE = 20.0
"""Typical rewards by which phi may be too low in states that the optimal policy visits."""
RAISED = 1.15
"""Scale above which a calibration is worth its steps."""


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
    """Return in what a potential is worse than knowing nothing, in words; empty if in nothing.

    Its greedy policy returns less than the random one by more than the seeds differ (Student's
    interval of 95 %; for a single seed, or where all agree, at all), or its order of the pairs is
    against that of Q* in every seed. The words are weak because some such potentials pay all the
    same: ``docs/trust.md`` says how many.
    """
    found = []
    starts, ranks = (np.array([getattr(k, of) for k in row.seeds]) for of in ("start", "rank"))
    high, mean = float(mean_interval(starts).high), float(starts.mean())
    if (mean if np.isnan(high) else high) < random_return:
        found.append(
            f"its policy starts at {mean:.3g}, below the random policy's {random_return:.3g}"
        )
    if (ranks < 0).all():
        other = "Q*" if row.seeds[0].exact else "the returns of its own policy"
        words = f"its order of the pairs is against that of {other}"
        found.append(f"{words} (rank {ranks.mean():.2f})")
    return f"may be anti-knowledge: {'; '.join(found)}" if found else ""
