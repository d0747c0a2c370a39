"""Forecast: what a curriculum's potentials are like in the target, before it is trained there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from curricle.checks import instance, one_of
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.potentials import calibrated
from curricle.errors import CurriculumError
from curricle.learning.budget import seed_tuple
from curricle.learning.result import LearningResult
from curricle.learning.threads import over_seeds, threads_for
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.tasks.labels import state_name
from curricle.transfer.aggregation import Aggregate, maximum, mean, minimum, total
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.coverage import Coverage, ObservationCoverage
from curricle.transfer.edges import Calibrate, Transfer, numbered, transfer_names
from curricle.transfer.observation_target import ObservationTarget, target_of
from curricle.transfer.quality import PotentialQuality, potential_quality

AGGREGATES = (minimum, mean, maximum, total)
Place = Any
"""The target as potentials are judged in it: a Target or an ObservationTarget."""

# Where the words of a verdict change; benchmarks/check_forecast.py sets them against what came.
GAIN, GOOD = 0.1, 0.5
"""Shares of the way from untaught to optimal from which a start is a gain, and a good one."""
MOST = 0.5
"""Share of optimistic pairs from which learning is one disappointment after the other."""
SLIPS, COLLAPSES = 0.2, 0.25
"""Mean excess, in units of mean abs(V*), from which returns then fall, under epsilon-greedy."""
ESTIMATED = 0.45
"""The same where the excess is over what phi's own policy earns, which is less than V*."""
GLOOM = 20.0
"""Typical rewards that phi may promise too little on the way before it is said to mislead."""
RAISED = 1.15
"""Scale from which a calibration is worth its steps."""


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
        Whether it is what the curriculum would use.
    seeds : tuple of K PotentialQuality
    calibrations : tuple of K Calibration
        What following it said about its size.
    verdict : str
        In plain words.
    """

    name: str
    aggregate: bool
    used: bool
    seeds: tuple[PotentialQuality, ...] = field(repr=False)
    calibrations: tuple[Calibration, ...] = field(repr=False)
    verdict: str

    def mean(self, measure: str) -> float:
        """Return the mean over seeds of a measure of :class:`PotentialQuality`, such as ``"start"``."""
        return float(np.mean([getattr(one, measure) for one in self.seeds]))

    @property
    def scale(self) -> float:
        """The mean scale that a calibration finds; NaN where it finds none for most seeds."""
        found = [one.scale for one in self.calibrations if not one.refusal]
        most = found and 2 * len(found) > len(self.calibrations)
        return float(np.mean(found)) if most else float("nan")


@dataclass(frozen=True, eq=False)
class Forecast:
    """What is to be expected of a target's transfers. Prints as a table with a verdict each.

    Attributes
    ----------
    target : str
    coverage : dict of str to Coverage or ObservationCoverage
        Of each transfer's mapping; into a task seen through observations over those that the
        curriculum's potential of the first seed leads to.
    foreseen : tuple of ForecastRow
        Aggregates, the best start first, then each transfer alone.
    optimum, random_return : float
        Expected return of an optimal policy (NaN where the target is too large to solve), and of
        acting at random, as before learning without transfer.
    solved : bool
        Whether potentials are compared with the exact Q*.
    exact : bool
        Whether returns are exact too.
    trained : dict of str to LearningResult
        The sources, for :meth:`Curriculum.train` to go on with.
    """

    target: str
    coverage: Mapping[str, Coverage | ObservationCoverage]
    rows: tuple[ForecastRow, ...]
    optimum: float
    random_return: float
    solved: bool
    exact: bool
    trained: Mapping[str, LearningResult] = field(repr=False)

    def __getitem__(self, name: str) -> ForecastRow:
        by_name = {one.name: one for one in self.rows}
        one_of("a potential that was foreseen", name, by_name, CurriculumError)
        return by_name[name]

    @property
    def ranking(self) -> tuple[str, ...]:
        """The aggregates' names, the best start first."""
        return tuple(one.name for one in self.rows if one.aggregate)

    def __str__(self) -> str:
        seeds = len(self.rows[0].seeds)
        how = "exact" if self.exact else "returns by rollouts"
        how += "" if self.solved else "; Q* taken to be what phi's own policy earns"
        lines = [
            f"Forecast for {self.target!r} from {seeds} seed{'s' * (seeds > 1)} of its sources: "
            f"optimum {self.optimum:.4g}, untaught {self.random_return:.4g} ({how})"
        ]
        lines += [f"{name}: {cover}" for name, cover in self.coverage.items()]
        width = max(len(one.name) for one in self.rows) + 2
        lines.append(
            f"{'':{width}}{'start':>8}{'phi > Q*':>10}{'excess':>8}{'rank':>7}{'scale':>7}"
        )
        for one in self.rows:
            lines.append(
                f"{one.name + ' *' * one.used:{width}}{one.mean('start'):>8.3g}"
                f"{one.mean('optimistic'):>10.0%}{one.mean('excess'):>8.2g}"
                f"{one.mean('rank'):>7.2f}{one.scale:>7.2g}"
            )
        lines += [f"{one.name}: {one.verdict}" for one in self.rows if one.aggregate]
        return "\n".join(lines)


def forecast(
    curriculum: Curriculum,
    target: str | None = None,
    *,
    seeds: int | Sequence[int] = 3,
    aggregates: Sequence[Aggregate] = (),
    trained: Mapping[str, LearningResult] | None = None,
    episodes: int | None = None,
    workers: int | None = None,
) -> Forecast:
    """Return what to expect of the transfers into a target; only the sources are trained.

    Parameters
    ----------
    curriculum : Curriculum
    target : str, optional
        By default the task that all others lead to.
    seeds : int or sequence of int
        Of the sources.
    aggregates : sequence of callable
        To look at besides the library's four and the curriculum's own.
    trained : dict of str to LearningResult, optional
        Sources trained before, for the same seeds.
    episodes : int, optional
        Rollouts of each potential where the target is too large, or live, to be exact: 1000 by
        default, 50 of a task seen through observations.
    workers : int, optional
        Threads over seeds.

    Returns
    -------
    Forecast

    Raises
    ------
    CurriculumError
        When the target is unknown, not unique or has no transfer into it.

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
    instance("what is foreseen", curriculum, Curriculum, CurriculumError)
    for function in aggregates:
        if not callable(function):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): got {function!r}"
            )
    name = curriculum.target if target is None else target
    edges = curriculum.in_edges(name)
    if not edges:
        raise CurriculumError(f"a forecast needs a task with transfers into it: {name!r} has none")
    own = curriculum.setting("aggregate", name)
    evaluation: GreedyEvaluation = curriculum.setting("evaluation", name)
    place = target_of(curriculum.tasks[name], evaluation, episodes=episodes)
    sources = curriculum.train(
        seeds, only=curriculum.ancestors(name), trained=trained, workers=workers
    ).nodes
    numbers = seed_tuple(seeds)
    labels = dict(zip(transfer_names(edges), edges, strict=True))
    bounds = place.optimum, place.random_return
    # Of a single potential the minimum, the mean and the maximum are one.
    several = AGGREGATES if len(edges) > 1 else ()
    functions, found = list[Aggregate](), list[ForecastRow]()
    for function in (*several, own, *aggregates):
        if not any(function is known for known in functions):
            functions.append(function)
    settings = curriculum.calibration(name)
    names = numbered([getattr(function, "__name__", str(function)) for function in functions])
    for called, function in zip(names, functions, strict=True):
        potentials = curriculum.potentials(name, sources, function=function)
        used = function is own and settings is None
        found.append(_foresee(called, True, used, potentials, place, bounds, workers))
        if function is own and settings is not None:
            fitted = [one.potential for one in calibrated(name, potentials, settings, numbers)]
            found.append(
                _foresee(f"{called}, calibrated", True, True, fitted, place, bounds, workers)
            )
    found.sort(key=lambda one: -np.nan_to_num(one.mean("start")))
    for label, edge in labels.items() if len(edges) > 1 else ():
        potentials = curriculum.potentials(name, sources, transfers=[edge])
        found.append(_foresee(label, False, False, potentials, place, bounds, workers))
    return Forecast(
        target=name,
        coverage=_coverage(labels, place, curriculum.potentials(name, sources)[0]),
        rows=tuple(found),
        optimum=bounds[0],
        random_return=bounds[1],
        solved=place.solution is not None,
        exact=place.evaluation.method == "exact",
        trained=sources,
    )


def _coverage(
    edges: Mapping[str, Transfer], place: Place, potential: AnyPotential
) -> dict[str, Coverage | ObservationCoverage]:
    """Return the coverage of each transfer's mapping."""
    if isinstance(place, ObservationTarget):
        sample = place.observations(potential)
        return {label: edge.mapping.coverage(sample) for label, edge in edges.items()}
    return {label: edge.mapping.coverage() for label, edge in edges.items()}


def _foresee(
    name: str,
    aggregate: bool,
    used: bool,
    potentials: Sequence[AnyPotential],
    place: Place,
    bounds: tuple[float, float],
    workers: int | None,
) -> ForecastRow:
    if isinstance(place, ObservationTarget):
        threads, fit = 1, Calibrate(place.episodes)
        told = potentials if potentials[0].of_actions else ()
    else:
        fit, told = Calibrate(), potentials
        threads = threads_for(place.task, workers, len(potentials))
    seeds = over_seeds(
        lambda k: potential_quality(potentials[k], place, seed=k), len(potentials), threads
    )
    calibrations = tuple(fit_calibration(phi, fit, seed=k) for k, phi in enumerate(told))
    bare = ForecastRow(name, aggregate, used, tuple(seeds), calibrations, "")
    return replace(bare, verdict=_verdict(bare, place, *bounds))


def _verdict(one: ForecastRow, place: Place, optimum: float, random_return: float) -> str:
    """Return in plain words what to expect, and what to do."""
    if np.isnan(one.mean("start")):
        return "tells no actions apart, so no policy of it can be followed: for the shaping StateShaping alone"
    start = one.mean("start")
    excess = one.mean("excess") / max(one.mean("mean_absolute_value"), 1e-12)
    words = [f"starts at {start:.3g}"]
    # Where the optimum is unknown any better start is a good one.
    gain, whole = start - random_return, np.nan_to_num(optimum - random_return)
    good = gain > GOOD * whole
    if not good:
        words.append("a weak start" if gain > GAIN * whole else "no better than untaught")
    words.append(f"{one.mean('optimistic'):.0%} optimistic")
    slips, collapses = (SLIPS, COLLAPSES) if one.seeds[0].exact else (ESTIMATED, ESTIMATED)
    advice = []
    # A weak start has little to lose, and its policy says little about phi's size.
    if good and one.mean("optimistic") > MOST and excess >= slips:
        sure = "expect a collapse" if excess >= collapses else "may slip back"
        advice.append(f"{sure} under epsilon-greedy")
    elif good:
        advice.append("expect steady learning")
    if good and excess > 0 and one.scale > RAISED:
        advice.append(f"calibrate with c = {one.scale:.1f}")
    worst = max(one.seeds, key=lambda seed: np.nan_to_num(seed.largest_underestimate))
    if worst.largest_underestimate > GLOOM * place.typical_reward:
        where = state_name(place.task.states, worst.most_underestimated_state)
        advice.append(
            f"speaks ill of {where}, on the way of the optimal policy, by {worst.largest_underestimate:.3g}: "
            "learn with a guard"
        )
    return ", ".join(words) + (": " + "; ".join(advice) if advice else "")
