"""Forecast: the quality of a curriculum's potentials in the target, before training there.

It is about the start: the return of the greedy policy on phi before anything is learnt in the
target, and whether phi is so high that epsilon-greedy learning falls from there. It is not about
what learning then gains: from a low start it can gain more than from scratch.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from textwrap import fill
from typing import Any

import numpy as np

from curricle.checks import one_of
from curricle.comparison.learnt_sources import SourceLearning, source_learning
from curricle.comparison.targets import transfers_into
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.sources import Learnt, SourceValues, calibrated
from curricle.errors import CurriculumError
from curricle.learning.seeds import over_seeds, seed_tuple, threads_for
from curricle.planning.target import Target
from curricle.tasks.labels import state_name
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.aggregation import Aggregate, maximum, mean, minimum, total
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.descriptions import countable
from curricle.transfer.edges import Calibrate, Transfer, numbered, transfer_names
from curricle.transfer.mapping import Coverage
from curricle.transfer.observation_mapping import ObservationCoverage
from curricle.transfer.observation_rollouts import ObservationTarget, target_of
from curricle.transfer.quality import PotentialQuality, potential_quality

AGGREGATES = (minimum, mean, maximum, total)
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
    verdict : str
        What the start is, whether it lasts, and what to do, in words.
    """

    name: str
    aggregate: bool
    used: bool
    seeds: tuple[PotentialQuality, ...] = field(repr=False)
    calibrations: tuple[Calibration, ...] = field(repr=False)
    verdict: str

    def mean(self, measure: str) -> float:
        """Return the mean over seeds of a field of :class:`PotentialQuality`."""
        return float(np.mean([getattr(one, measure) for one in self.seeds]))

    @property
    def scale(self) -> float:
        """The mean scale that calibration finds; NaN if it finds none for most seeds."""
        found = [one.scale for one in self.calibrations if not one.refusal]
        most = found and 2 * len(found) > len(self.calibrations)
        return float(np.mean(found)) if most else float("nan")


@dataclass(frozen=True, eq=False)
class Forecast:
    """The start of learning with the transfers into a target. Prints as a table with verdicts.

    Attributes
    ----------
    target : str
    coverage : dict of str to Coverage or ObservationCoverage
        Of each transfer's mapping. In an observation task: over the observations that the greedy
        policy of the first seed's potential meets.
    rows : tuple of ForecastRow
        Aggregates, the best start first, then each transfer alone.
    optimum, random_return : float
        Expected return of an optimal policy (NaN if the target is too large to solve), and of the
        random policy, with which learning from scratch starts.
    solved, exact : bool
        Whether potentials are compared with the exact Q*, and whether returns are exact too.
    trained : dict of str to SourceValues
        The sources, to be passed to :meth:`Curriculum.train`; with `perfect` their optimal values.
    perfect : bool
        Whether the sources were solved instead of trained.
    sources : dict of str to SourceLearning
        How much of its own task each source learnt; of tables that were trained.
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
    sources: Mapping[str, SourceLearning] = field(default_factory=dict)

    def __getitem__(self, name: str) -> ForecastRow:
        by_name = {one.name: one for one in self.rows}
        one_of("a row of a forecast", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def ranking(self) -> tuple[str, ...]:
        """The aggregates' names, the best start first."""
        return tuple(one.name for one in self.rows if one.aggregate)

    @property
    def computed_from(self) -> str:
        """What the sources' values are, in words."""
        if self.perfect:
            return f"if {_listed(self.trained)} were learnt perfectly"
        seeds = len(self.rows[0].seeds)
        sources = [f"{name} ({_steps(one)})" for name, one in self.trained.items()]
        return f"from {seeds} seed{'s' * (seeds > 1)} of {_listed(sources)}"

    def __str__(self) -> str:
        how = "exact" if self.exact else "returns by rollouts"
        how += "" if self.solved else "; Q* estimated by the values of phi's own policy"
        lines = [
            f"Forecast of the start of learning {self.target!r}, not of what it gains, "
            f"{self.computed_from}: optimum {self.optimum:.4g}, random policy "
            f"{self.random_return:.4g} ({how})",
            *map(str, self.sources.values()),
            *(f"{name}: {cover}" for name, cover in self.coverage.items()),
        ]
        lines = [_wrapped(line) for line in lines]
        width = max(len(one.name) for one in self.rows) + 2
        lines.append(
            f"{'':{width}}{'start':>11}{'phi > Q*':>10}{'excess':>10}{'rank':>7}{'scale':>7}"
        )
        for one in self.rows:
            scale = "none" if np.isnan(one.scale) else f"{one.scale:.2g}"
            lines.append(
                f"{one.name + ' *' * one.used:{width}}{one.mean('start'):>11.3g}"
                f"{one.mean('optimistic'):>10.0%}{one.mean('excess'):>10.2g}"
                f"{one.mean('rank'):>7.2f}{scale:>7}"
            )
        lines += [_wrapped(f"{one.name}: {one.verdict}") for one in self.rows if one.aggregate]
        return "\n".join(lines)


def _wrapped(line: str) -> str:
    """Return a line as lines that fit a terminal of 80 columns."""
    return fill(line, 80, subsequent_indent="  ", break_on_hyphens=False)


def _listed(names: Iterable[str]) -> str:
    """Return names as a list in words."""
    *some, last = names
    return f"{', '.join(some)} and {last}" if some else last


def _steps(source: SourceValues) -> str:
    """Return for how many steps the seeds of a source were trained."""
    steps = source.steps_used
    return f"{steps.mean():,.0f} steps" + " on average" * bool(np.ptp(steps))


def forecast(
    curriculum: Curriculum,
    target: str | None = None,
    *,
    seeds: int | Sequence[int] = 3,
    aggregates: Sequence[Aggregate] = (),
    trained: Mapping[str, Learnt] | None = None,
    perfect: bool = False,
    episodes: int | None = None,
    workers: int | None = None,
) -> Forecast:
    """Return a forecast of the start of learning in a target. Only the sources are trained.

    Parameters
    ----------
    curriculum : Curriculum
    target : str, optional
        By default the task that all others lead to.
    seeds : int or sequence of int
        Of the sources.
    aggregates : sequence of callable
        In addition to the library's four and the curriculum's own.
    trained : dict of str to SourceValues or LearningResult, optional
        Sources trained before, for the same seeds.
    perfect : bool
        Whether to train no source and take the optimal values of each instead: the forecast if
        the sources were learnt perfectly, of one seed.
    episodes : int, optional
        Rollouts of each potential if the target is live or too large to evaluate exactly: by
        default 1000, or 50 for an observation task.
    workers : int, optional
        Threads over seeds.

    Raises
    ------
    CurriculumError
        If the target is unknown, not unique or has no transfer into it; with `perfect` also if a
        source cannot be solved.

    Examples
    --------
    >>> from curricle import Pursuit, Transfer, project
    >>> hunt, chase = Pursuit(3, 2, time_limit=50), Pursuit(3, 1, time_limit=50)
    >>> plan = Curriculum(
    ...     tasks={"chase": chase, "hunt": hunt},
    ...     transfers=[Transfer("chase", "hunt", project(hunt, chase, predator=name))
    ...                for name in hunt.predator_names],
    ...     aggregate=maximum, budget=50_000)
    >>> found = forecast(plan)
    >>> found.ranking
    ('minimum', 'mean', 'total', 'maximum')
    """
    name, edges = transfers_into(curriculum, target, "a forecast")
    for function in aggregates:
        if not callable(function):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): got {function!r}"
            )
    any_target = target_of(
        curriculum.tasks[name], curriculum.setting("evaluation", name), episodes=episodes
    )
    if perfect and trained:
        raise CurriculumError(
            f"a forecast for sources learnt perfectly takes no trained ones: got {_listed(trained)}"
        )
    if perfect:
        seeds = seed_tuple(seeds)[:1]
        sources = _solved(curriculum, [edge.source for edge in edges], seeds)
    else:
        before = curriculum.ancestors(name)
        sources = curriculum.train(seeds, only=before, trained=trained, workers=workers).sources
    make_row = partial(_row, any_target=any_target, workers=workers)
    found = _aggregate_rows(curriculum, name, sources, aggregates, seed_tuple(seeds), make_row)
    found.sort(key=lambda row: -np.nan_to_num(row.mean("start")))
    labels = dict(zip(transfer_names(edges), edges, strict=True))
    for label, edge in labels.items() if len(edges) > 1 else ():
        potentials = curriculum.potentials(name, sources, transfers=[edge])
        found.append(make_row(label, potentials, aggregate=False, used=False))
    optimum, random_return = any_target.optimum, any_target.random_return
    return Forecast(
        target=name,
        coverage=_coverage(labels, any_target, curriculum.potentials(name, sources)[0]),
        rows=tuple(
            replace(row, verdict=_verdict(row, any_target, optimum, random_return)) for row in found
        ),
        optimum=optimum,
        random_return=random_return,
        solved=any_target.solution is not None,
        exact=any_target.evaluation.method == "exact",
        trained=sources,
        perfect=perfect,
        sources={} if perfect else source_learning(curriculum, sources, workers=workers),
    )


def _solved(
    curriculum: Curriculum, names: Sequence[str], seeds: tuple[int, ...]
) -> dict[str, SourceValues]:
    """Return sources as if a seed had learnt their optimal values; CurriculumError if unknown."""
    found = {}
    for name in names:
        node = curriculum.node(name)
        known = not node.deep and not is_observation_task(node.task)
        solution = Target.of(node.task, node.evaluation).solution if known else None
        if solution is None:
            raise CurriculumError(
                "a forecast for sources learnt perfectly needs tasks that can be solved: "
                f"{name!r} cannot"
            )
        none = np.zeros(len(seeds), np.int64)
        found[name] = SourceValues(node.task, seeds, solution.action_values[None], none)
    return found


def _aggregate_rows(
    curriculum: Curriculum,
    name: str,
    sources: Mapping[str, SourceValues],
    aggregates: Sequence[Aggregate],
    seeds: Sequence[int],
    make_row: Callable[..., ForecastRow],
) -> list[ForecastRow]:
    """Return a row for each aggregate of the transfers into a task, calibrated too if it is."""
    own = curriculum.setting("aggregate", name)
    settings = curriculum.calibration(name)
    # The minimum, the mean and the maximum of a single potential are the same.
    several = AGGREGATES if len(curriculum.in_edges(name)) > 1 else ()
    functions, found = list[Aggregate](), list[ForecastRow]()
    for function in (*several, own, *aggregates):
        if not any(function is known for known in functions):
            functions.append(function)
    node = curriculum.node(name)
    names = numbered([getattr(function, "__name__", str(function)) for function in functions])
    for label, function in zip(names, functions, strict=True):
        potentials = curriculum.potentials(name, sources, function=function)
        used = function is own and settings is None
        found.append(make_row(label, potentials, aggregate=True, used=used))
        if function is own and settings is not None:
            fitted = [one.potential for one in calibrated(node, potentials, settings, seeds)]
            found.append(make_row(f"{label}, calibrated", fitted, aggregate=True, used=True))
    return found


def _coverage(
    edges: Mapping[str, Transfer], any_target: AnyTarget, potential: AnyPotential
) -> dict[str, Coverage | ObservationCoverage]:
    """Return the coverage of each transfer's mapping, where its pairs are few enough to count."""
    if isinstance(any_target, ObservationTarget):
        sample = any_target.observations(potential)
        return {label: edge.mapping.coverage(sample) for label, edge in edges.items()}
    counted = {label: edge for label, edge in edges.items() if countable(edge.mapping)}
    return {label: edge.mapping.coverage() for label, edge in counted.items()}


def _row(
    name: str,
    potentials: Sequence[AnyPotential],
    *,
    aggregate: bool,
    used: bool,
    any_target: AnyTarget,
    workers: int | None,
) -> ForecastRow:
    """Return a row without its verdict."""
    if isinstance(any_target, ObservationTarget):
        threads, fit = 1, Calibrate(any_target.episodes)
        of_actions = potentials if potentials[0].of_actions else ()
    else:
        fit, of_actions = Calibrate(), potentials
        threads = threads_for(any_target.task, workers, len(potentials))
    seeds = over_seeds(
        lambda k: potential_quality(potentials[k], any_target, seed=k), len(potentials), threads
    )
    calibrations = tuple(fit_calibration(phi, fit, seed=k) for k, phi in enumerate(of_actions))
    return ForecastRow(name, aggregate, used, tuple(seeds), calibrations, "")


def _verdict(row: ForecastRow, target: AnyTarget, optimum: float, random_return: float) -> str:
    """Return what the start with a potential is, whether it lasts, and what to do, in words."""
    if np.isnan(row.mean("start")):
        return "is the same for all actions, so it has no greedy policy: use StateShaping"
    start = row.mean("start")
    excess = row.mean("excess") / max(row.mean("mean_absolute_value"), 1e-12)
    words = [f"starts at {start:.3g}"]
    # If the optimum is unknown, any better start is a good one.
    gain, whole = start - random_return, np.nan_to_num(optimum - random_return)
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
            f" {worst.largest_underestimate:.3g}: learn with a guard"
        )
    return ", ".join(words) + (": " + "; ".join(advice) if advice else "")
