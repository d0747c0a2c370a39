"""A forecast as a record: rows of potentials, the answer of a trial, and both as text."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from curricle.checks import one_of
from curricle.comparison.distilled_sources import DistilledSource
from curricle.comparison.forecast_table import as_html, forecast_text, in_brief
from curricle.comparison.learnt_sources import SourceLearning
from curricle.comparison.trial import Trial
from curricle.curriculum.sources import SourceValues
from curricle.display import block, brief_repr
from curricle.errors import CurriculumError
from curricle.statistics.intervals import Interval
from curricle.text_tables import counted
from curricle.transfer.calibration import Calibration
from curricle.transfer.mapping import Coverage
from curricle.transfer.observation_mapping import ObservationCoverage
from curricle.transfer.quality import PotentialQuality


@dataclass(frozen=True)
class ForecastRow:
    """One potential as it would enter the target: a single source's, or an aggregate.

    Attributes
    ----------
    name : str
        The transfer, as ``source -> target [n]``, or the aggregate's name.
    aggregate : bool
        Whether it is an aggregate of all transfers.
    used : bool
        Whether the curriculum would use it.
    seeds : tuple of K PotentialQuality
    calibrations : tuple of K Calibration
        Of its scale, from rollouts of its greedy policy.
    gain : Interval or None
        The strong gain in mean return that a trial in the model gave; None without one.
    verdict : str
        What the start is, whether it lasts, and what to do, in words.
    anti_knowledge : str
        That it may be worse than knowing nothing and in what, in words; empty if in nothing.
    """

    name: str
    aggregate: bool
    used: bool
    seeds: tuple[PotentialQuality, ...] = field(repr=False)
    calibrations: tuple[Calibration, ...] = field(repr=False)
    gain: Interval | None = None
    verdict: str = ""
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
        """Return it in lines of so many characters at most."""
        return forecast_text(self, width)

    def __repr__(self) -> str:
        return in_brief(self)

    def _repr_html_(self) -> str:
        return as_html(self)


def _listed(names: Iterable[str]) -> str:
    """Return names as a list in words."""
    *some, last = names
    return f"{', '.join(some)} and {last}" if some else last


def _steps(source: SourceValues) -> str:
    """Return for how many steps the seeds of a source were trained."""
    steps = source.steps_used
    return f"{steps.mean():,.0f} steps" + " on average" * bool(np.ptp(steps))
