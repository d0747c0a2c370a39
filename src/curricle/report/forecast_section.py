"""The forecast of each curriculum next to what was measured, and whether its shaping is safe."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from curricle.certificate.certification import certify
from curricle.certificate.verdict import Certificate
from curricle.comparison.forecasting import Forecast, forecast
from curricle.curriculum.curriculum import Curriculum, CurriculumResult
from curricle.curriculum.sources import calibrated
from curricle.learning.potential_rollouts import PairPotential
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model

EFFORT = 800_000
"""Target pairs times forecasts times seeds at most: about ten seconds."""
MOST_SEEDS = 3
"""Seeds of a forecast."""
LARGEST_CERTIFIED = 20_000_000
"""Target pairs up to which a potential is certified."""


@dataclass(frozen=True, eq=False)
class ForecastSection:
    """The forecast and certificates of curricula with the same graph."""

    arms: tuple[str, ...]
    forecast: Forecast | None  # None where it was left out
    used: Mapping[str, tuple[str, ...]]  # name of a forecast row -> the arms with that potential
    measured: Mapping[str, float]  # arm -> greedy return at the first target step, mean over seeds
    # Of the potentials of the arms' first seeds, each with the arms that it holds for.
    certificates: tuple[tuple[tuple[str, ...], Certificate], ...]
    left_out: tuple[str, ...]  # what, why, and how to get it, in a sentence each


def forecast_sections(
    results: Mapping[str, CurriculumResult], groups: Sequence[Sequence[str]]
) -> tuple[ForecastSection, ...]:
    """Return the forecast section of each group of arms.

    Parameters
    ----------
    results : dict of str to CurriculumResult
    groups : sequence of sequence of str
        Arms with the same graph; they share a forecast.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))], budget=1000)
    >>> section, = forecast_sections({"corner first": plan.train()}, [["corner first"]])
    >>> section.used, [(arms, bool(one)) for arms, one in section.certificates]
    ({'mean': ('corner first',)}, [(('corner first',), True)])
    """
    return tuple(_section(tuple(arms), results, len(groups)) for arms in groups)


def _section(
    arms: tuple[str, ...], results: Mapping[str, CurriculumResult], n_groups: int
) -> ForecastSection:
    target = results[arms[0]].curriculum.target
    if is_observation_task(results[arms[0]].curriculum.tasks[target]):
        seeds, certified, left_out = _observed_extent(arms, results, target)
    else:
        seeds, certified, left_out = _extent(arms, results, target, n_groups)
    found = _forecast(arms, results, target, seeds) if seeds else None
    certificates: dict[str, tuple[tuple[str, ...], Certificate]] = {}
    for arm in arms if certified else ():
        certificate = _certified(results[arm], target)
        alike, _ = certificates.get(str(certificate), ((), certificate))
        certificates[str(certificate)] = (*alike, arm), certificate
    return ForecastSection(
        arms=arms,
        forecast=found,
        used=_used(found, arms, results, target),
        measured={arm: float(results[arm][target].greedy_return[:, 0].mean()) for arm in arms},
        certificates=tuple(certificates.values()),
        left_out=tuple(left_out),
    )


def _extent(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str, n_groups: int
) -> tuple[int, bool, list[str]]:
    """Return the seeds of the forecast, whether to certify, and what is left out and why."""
    first = results[arms[0]]
    space = generative_model(first.curriculum.tasks[target])
    pairs = space.states.size * space.actions.size
    kept = all(
        isinstance(results[arm][t.source].values, np.ndarray)
        for arm in arms
        for t in results[arm].curriculum.in_edges(target)
    )
    seeds = kept * min(MOST_SEEDS, EFFORT // (pairs * n_groups), len(first[target].seeds))
    certified = kept and pairs <= LARGEST_CERTIFIED
    why = f"{target} has {pairs:,} state-action pairs"
    if not kept:
        why = "the sources' values were not kept in dense tables"
    elif n_groups > 1:
        why += f" and there are {n_groups} graphs"
    left_out = []
    if not seeds:
        left_out.append(
            f"The forecast is left out, because {why}: curricle.forecast(curriculum) gives it."
        )
    if not certified:
        left_out.append(
            f"Certificates are left out, because {why}: curricle.certify(task, shaping) gives them."
        )
    return seeds, certified, left_out


def _observed_extent(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str
) -> tuple[int, bool, list[str]]:
    """Return the same of a target seen through observations: one seed, and no certificates."""
    left_out = [
        f"Certificates are left out, because {target} is seen through observations: they need "
        "numbered states."
    ]
    first = results[arms[0]]
    readable = all(first[t.source].values is not None for t in first.curriculum.in_edges(target))
    if not readable:
        left_out.append(
            "The forecast is left out, because the sources' values were not kept, or their "
            "networks cannot be read here: pip install curricle[deep]."
        )
    return int(readable), False, left_out


def _forecast(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str, seeds: int
) -> Forecast:
    first = results[arms[0]]
    curriculum = first.curriculum
    sources = curriculum.ancestors(target)
    trained = {name: first.sources[name].first(seeds) for name in sources}
    others = [results[arm].curriculum.setting("aggregate", target) for arm in arms[1:]]
    return forecast(
        curriculum, seeds=first[target].seeds[:seeds], aggregates=others, trained=trained
    )


def _used(
    found: Forecast | None,
    arms: Sequence[str],
    results: Mapping[str, CurriculumResult],
    target: str,
) -> dict[str, tuple[str, ...]]:
    """Return which arms used the potential of each row."""
    used: dict[str, tuple[str, ...]] = {}
    names = [] if found is None else [one.name for one in found.rows]
    for arm in arms:
        curriculum = results[arm].curriculum
        called = getattr(curriculum.setting("aggregate", target), "__name__", "")
        called += ", calibrated" * (curriculum.calibration(target) is not None)
        if called in names:
            used[called] = (*used.get(called, ()), arm)
    return used


def _certified(result: CurriculumResult, target: str) -> Certificate:
    shaping = result.curriculum.setting("shaping", target)
    task = result.curriculum.tasks[target]
    return certify(task, shaping.with_potential(_entering(result, target)))


def _entering(result: CurriculumResult, target: str) -> PairPotential:
    """Return the potential with which the first seed of a target began."""
    curriculum: Curriculum = result.curriculum
    phi: PairPotential
    if kept := result.potentials.get(target):
        phi = kept[0]
        return phi
    sources = {name: one.first(1) for name, one in result.sources.items()}
    phi, *_ = found = curriculum.potentials(target, sources)
    if (settings := curriculum.calibration(target)) is not None:
        phi = calibrated(target, found, settings, result[target].seeds[:1])[0].potential
    return phi
