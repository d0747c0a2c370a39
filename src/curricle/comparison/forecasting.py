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
from typing import Any

import numpy as np

from curricle.checks import instance
from curricle.comparison.candidates import Candidate, candidates_of
from curricle.comparison.comparing import LearntAlone, threshold_of_optimum
from curricle.comparison.forecasts import (
    AnyTarget,
    Forecast,
    ForecastRow,
    anti_knowledge,
    network_words,
    start_words,
)
from curricle.comparison.learnt_sources import distilled_sources, source_learning
from curricle.comparison.trial import Trial, affordable, hindrance, rehearse, run_trial
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import Learnt, SourceValues
from curricle.deep.policy import policy_return
from curricle.errors import CurricleError, CurriculumError
from curricle.learning.potential import PairPotential
from curricle.learning.seeds import over_seeds, seed_tuple, threads_for
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import Target
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.aggregate import Aggregate
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.mapping import Coverage
from curricle.transfer.observation_mapping import ObservationCoverage
from curricle.transfer.rollouts import (
    ObservationTarget,
    PotentialQuality,
    potential_quality,
    target_of,
)
from curricle.transfer.transfer import Calibrate, Transfer, transfer_names


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
) -> Forecast:
    """Return a forecast: whether the transfers into a target pay, and where learning starts.

    Whether they pay is answered by a trial: the comparison with learning from scratch, sources
    charged, played in the tasks' models. Its random streams have names of their own, so that it
    shares no draw with any seed of :func:`compare` or :meth:`Curriculum.train`. It never counts as
    the experiment. A target without a model is not learnt: potentials are rolled out in it.

    Parameters
    ----------
    curriculum : Curriculum
        ``curricle.forecast`` also takes a study of one arm or the path of its file: its arm, its
        first seeds and its threshold, where others are not given.
    target : str, optional
        By default the task that all others lead to.
    seeds : int or sequence of int
        Of the sources whose potentials are looked at.
    aggregates : sequence of callable
        In addition to the library's four and the curriculum's own.
    trained : dict of str to SourceValues or LearningResult, optional
        Sources trained before, for the same seeds. A trial trains its own.
    perfect : bool
        Whether to train no source and take the optimal values of each instead: the start if
        the sources were learnt perfectly, of one seed, and no trial.
    episodes : int, optional
        Rollouts of each potential if the target is live or too large to evaluate exactly: by
        default 1000, or 50 for an observation task.
    trial : bool or Curriculum, optional
        True for a trial of 20 seeds, whatever it takes; False for none; by default one where the
        tasks have models and it takes 5 s or less on one processor by an estimate, with as many
        seeds from 8 to 20 as fit. A curriculum is a smaller relative, in which the trial is made
        where the tasks have no models: its verdict is carried over, and says so.
    threshold : float, optional
        Return that counts as learnt in the trial, as in :func:`compare`.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task that is learnt and for the potentials; a function is called
        with the name of each potential when it has been looked at, and with "trial" after one.

    Raises
    ------
    CurriculumError
        If the target is unknown, not unique or has no transfer into it; with `perfect` also if a
        source cannot be solved; with ``trial=True`` if a task has no model, or the target's budget
        is not in steps.

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
    return forecast_once(
        JudgedPotentials(),
        curriculum,
        target,
        seeds=seeds,
        aggregates=aggregates,
        trained=trained,
        perfect=perfect,
        episodes=episodes,
        trial=trial,
        threshold=threshold,
        workers=workers,
        progress=progress,
    )


Judgement = tuple[tuple[PotentialQuality, ...], tuple[Calibration, ...]]
"""How good the potential of each of K seeds is, and the scales that calibrations find."""


@dataclass(frozen=True)
class JudgedPotentials:
    """Targets, judgements of their potentials and what trials learn alone, computed once."""

    alone: LearntAlone = field(default_factory=LearntAlone)
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


def forecast_once(
    judged: JudgedPotentials,
    curriculum: Curriculum,
    target: str | None = None,
    *,
    seeds: int | Sequence[int] = 3,
    aggregates: Sequence[Aggregate] = (),
    trained: Mapping[str, Learnt] | None = None,
    perfect: bool = False,
    only_used: bool = False,
    episodes: int | None = None,
    trial: bool | Curriculum | None = None,
    threshold: float | None = None,
    workers: int | None = None,
    progress: Progress = None,
) -> Forecast:
    """Return a forecast as :func:`forecast`, with what others for the same target have computed.

    With `only_used` it has a row for the potential that the curriculum would use, and no other.
    """
    name, edges = _transfers_into(curriculum, target)
    for function in aggregates:
        if not callable(function):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): got {function!r}"
            )
    any_target = judged.target(
        curriculum.tasks[name], curriculum.setting("evaluation", name), episodes
    )
    numbers = seed_tuple(seeds)[:1] if perfect else seed_tuple(seeds)
    each = candidates_of(curriculum, name, aggregates)
    _check_trial(each, trial, perfect)
    reads_values = curriculum.setting("shaping", name).reads_values
    found, no_trial, learnt = None, "no source is trained", dict[str, Any]()
    with shown(progress) as bars:
        sources = _sources(curriculum, name, numbers, trained, perfect, workers, bars)
        all_rows = reads_values and not only_used  # without values, potentials do not differ
        shown_rows = [one for one in each if one.used or all_rows]
        made = ((one, tuple(one.potentials(sources, numbers))) for one in shown_rows)
        judge = partial(_judgement if reads_values else _judgement_of_networks, workers=workers)
        rows = _rows(made, len(shown_rows), any_target, judged, judge, bars)
        if not perfect:
            how = {"alone": judged.alone, "workers": workers, "progress": bars.within()}
            found, no_trial = _trial(each, trial, threshold, any_target, how)
            if found is not None:
                bars.tell("trial")
            learnt |= source_learning(curriculum, sources, workers=workers, progress=bars.within())
            learnt |= distilled_sources(curriculum.tasks, sources)
    rows = _judged(rows, found, any_target, reads_values=reads_values)
    return Forecast(
        target=name,
        coverage=_coverage(edges, any_target, curriculum.potentials(name, sources)[0]),
        rows=tuple(rows),
        optimum=any_target.optimum,
        random_return=any_target.random_return,
        solved=any_target.solution is not None,
        exact=any_target.evaluation.method == "exact",
        trained=sources,
        perfect=perfect,
        sources=learnt,
        trial=found,
        no_trial=no_trial,
    )


def _judged(
    rows: Sequence[ForecastRow], found: Trial | None, any_target: AnyTarget, *, reads_values: bool
) -> list[ForecastRow]:
    """Return rows with the gain of a trial and with words, aggregates and the best first."""
    judged = [
        replace(
            row,
            gain=None if found is None or found.relative else found.gain(row.name),
            verdict=start_words(row, any_target) if reads_values else network_words(row),
            anti_knowledge=anti_knowledge(row, any_target.random_return),
        )
        for row in rows
    ]
    return sorted(
        judged, key=lambda row: (not row.aggregate, -np.nan_to_num(row.score, nan=-np.inf))
    )


def _sources(
    curriculum: Curriculum,
    name: str,
    seeds: tuple[int, ...],
    trained: Mapping[str, Learnt] | None,
    perfect: bool,
    workers: int | None,
    bars: Bars,
) -> dict[str, SourceValues]:
    """Return what the sources of a target learnt, or their solutions."""
    if perfect and trained:
        raise CurriculumError(
            "a forecast for sources learnt perfectly takes no trained ones: got "
            + ", ".join(trained)
        )
    if perfect:
        return _solved(curriculum, [edge.source for edge in curriculum.in_edges(name)], seeds)
    before = curriculum.ancestors(name)
    how: Any = {"trained": trained, "workers": workers, "progress": bars.within()}
    return curriculum.train(seeds, only=before, **how).sources


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
    (used,) = (one for one in candidates if one.used)
    if isinstance(trial, Curriculum):
        return rehearse(trial, used, **how), ""
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


def _coverage(
    edges: Sequence[Transfer], any_target: AnyTarget, potential: AnyPotential
) -> dict[str, Coverage | ObservationCoverage]:
    """Return the coverage of each transfer's mapping, where its pairs are few enough to count."""
    labels = dict(zip(transfer_names(edges), edges, strict=True))
    if isinstance(any_target, ObservationTarget):
        sample = any_target.observations(potential)
        return {label: edge.mapping.coverage(sample) for label, edge in labels.items()}
    counted = {label: edge for label, edge in labels.items() if edge.mapping.countable}
    return {label: edge.mapping.coverage() for label, edge in counted.items()}


def _rows(
    potentials: Iterable[tuple[Candidate, tuple[AnyPotential, ...]]],
    number: int,
    any_target: AnyTarget,
    judged: JudgedPotentials,
    judge: Callable[..., Judgement],
    bars: Bars,
) -> list[ForecastRow]:
    """Return the rows of candidates without what a trial and words add."""
    rows = list[ForecastRow]()
    grow = bars.bar("potentials", number)
    for one, each in potentials:
        row = judged.judgement(any_target, each, partial(judge, each, any_target))
        rows.append(ForecastRow(one.name, one.aggregate, one.used, *row))
        grow()
        bars.tell(one.name)
    return rows


def _judgement(
    potentials: Sequence[AnyPotential], any_target: AnyTarget, workers: int | None
) -> Judgement:
    """Return how good potentials are, and their scale."""
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


def _judgement_of_networks(
    potentials: Sequence[Any], target: Any, workers: int | None
) -> Judgement:
    """Return the same of networks whose values are not read: the returns of their policies."""
    nan = float("nan")
    starts = [policy_return(one, target, seed=k) for k, one in enumerate(potentials)]
    return tuple(PotentialQuality(start, nan, nan, nan, nan) for start in starts), ()


def _transfers_into(curriculum: Curriculum, target: str | None) -> tuple[str, tuple[Transfer, ...]]:
    """Return the name of a target, the curriculum's by default, and the transfers into it.

    CurriculumError if there are none.
    """
    instance("the curriculum of a forecast", curriculum, Curriculum, CurriculumError)
    name = curriculum.target if target is None else target
    edges = curriculum.in_edges(name)
    if not edges:
        raise CurriculumError(f"a forecast needs a task with transfers into it: {name!r} has none")
    return name, edges
