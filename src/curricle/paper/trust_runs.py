"""The runs of the trust figure: forecast, calibration, controls, guard, attribution."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from curricle import (
    Curriculum,
    GreedyEvaluation,
    Guard,
    Pursuit,
    QInitialisation,
    StoppingRule,
    Transfer,
    calibrate,
    compare,
    forecast,
    maximum,
    mean,
    minimum,
    project,
)
from curricle.array_types import FloatArray
from curricle.comparison import Attribution, Comparison, Forecast, attribute
from curricle.errors import CalibrationError
from curricle.learning import LearningResult
from curricle.paper import maze_runs as runs
from curricle.paper.settings import LEARNER, Progress, maze
from curricle.transfer import Calibrate

AGGREGATES = {"min": minimum, "mean": mean, "max": maximum}
ROLLOUTS = GreedyEvaluation(method="rollouts", episodes=20, discounted=False)
SOURCE_STEPS = 400_000
HUNTS = {5: (100, 400_000), 7: (200, 1_000_000)}
"""Size -> time limit and target steps; discount 0.95."""
FITTED = Calibrate()
"""The scale is the one that fits the returns, neither shrunk nor bounded."""
SWEEP = (1.2, 1.6, 2.0, 2.5)
"""Scales set by hand."""
FORECAST_SEEDS, LARGE_SEEDS = 2, 10
"""Seeds of the forecast, and the most of 7x7."""
MAZE_STEPS = 150_000
"""Target steps in the maze."""
EXAMINED = 20_000
"""Steps after which the greedy choices in the maze are examined."""
SIZES = range(3, 11)


@dataclass(frozen=True)
class TrustRuns:
    """The results of all runs."""

    forecast: Forecast  # of 5x5 pursuit
    compared: Comparison  # 5x5: each aggregate uncalibrated, min and mean also calibrated
    controls: Comparison  # 5x5: mean, calibrated, with all controls
    # (size, arm) -> training; arms "min" and "mean", each also ", calibrated" or " x c".
    hunts: Mapping[tuple[int, str], LearningResult]
    # The maze from scratch, from the 3x3 corner, and from there with a guard.
    maze: Mapping[str, LearningResult]
    scratch: runs.Scratch  # with the paper's budget; sets the threshold
    attribution: Attribution  # of harm to the 3x3 corner
    refused: Mapping[int, float]  # size of a maze source -> share of seeds with no calibration


def run(seeds: int, workers: int | None, progress: Progress) -> TrustRuns:
    """Return the results of all runs."""
    plans = {name: hunt(5, name) for name in AGGREGATES}
    predicted = forecast(plans["mean"], seeds=FORECAST_SEEDS, trial=False, workers=workers)
    progress("pursuit 5x5, forecast")
    plans |= {f"{name}, calibrated": hunt(5, name, calibrate=FITTED) for name in ("min", "mean")}
    compared = compare(plans, seeds=seeds, workers=workers, progress=_prefixed(progress, "5x5"))
    controls = compare(
        {"mean, calibrated": plans["mean, calibrated"]},
        seeds=seeds,
        controls=("placebo", "scaled", "negated", "random_start", "pretraining"),
        workers=workers,
        progress=_prefixed(progress, "5x5, controls"),
    )
    hunts = dict[tuple[int, str], LearningResult]()
    for size in HUNTS:
        hunts |= _hunts(size, seeds if size == 5 else min(seeds, LARGE_SEEDS), workers)
        progress(f"pursuit {size}x{size}, uncalibrated and calibrated")
    scratch = runs.scratch(maze(-5), seeds, workers)
    mazes, attribution = _mazes(seeds, workers)
    progress("maze, guarded")
    refused = {size: _refused(size, seeds, workers) for size in SIZES}
    progress("maze, calibration")
    return TrustRuns(predicted, compared, controls, hunts, mazes, scratch, attribution, refused)


def hunt(size: int, aggregate: str, **transfer: Any) -> Curriculum:
    """Return two predators learning from one, both having to catch."""
    limit, steps = HUNTS[size]
    two, one = (Pursuit(size, n, discount=0.95, time_limit=limit) for n in (2, 1))
    return Curriculum(
        tasks={"chase": one, "hunt": two},
        transfers=[
            Transfer("chase", "hunt", project(two, one, predator=name), **transfer)
            for name in two.predator_names
        ],
        aggregate=AGGREGATES[aggregate],
        learner=LEARNER,
        shaping=QInitialisation(),
        budget={"chase": StoppingRule(SOURCE_STEPS), "hunt": steps},
        eval_freq={"chase": SOURCE_STEPS, "hunt": steps // 50},
        evaluation=ROLLOUTS,
    )


def _prefixed(progress: Progress, where: str) -> Progress:
    return lambda words: progress(f"{where}: {words}")


def _hunts(size: int, seeds: int, workers: int | None) -> dict[tuple[int, str], LearningResult]:
    """Return min and mean, uncalibrated and calibrated; on 5x5 also scaled by hand."""
    plans = dict[str, Curriculum]()
    for name in ("min", "mean"):
        plans[name] = hunt(size, name)
        plans[f"{name}, calibrated"] = hunt(size, name, calibrate=FITTED)
        for scale in SWEEP if size == 5 else ():
            plans[f"{name} x {scale:g}"] = hunt(size, name, scale=scale)
    sources = plans["mean"].train(seeds, only=["chase"], workers=workers).sources
    return {
        (size, name): plan.train(seeds, trained=sources, workers=workers)["hunt"]
        for name, plan in plans.items()
    }


def corner_plan(size: int) -> Curriculum:
    """Return the curriculum from the top-right `size` x `size` corner to the maze."""
    arena = maze(-5)
    return runs.plan(arena, runs.corner(arena, size), MAZE_STEPS, "corner")


def _mazes(seeds: int, workers: int | None) -> tuple[dict[str, LearningResult], Attribution]:
    plan = corner_plan(3)
    sources = plan.train(seeds, only=["corner"], workers=workers).sources
    arms = {
        "from the 3x3 corner": plan,
        "the same, guarded": replace(plan, shaping=QInitialisation(guard=Guard())),
    }
    results = {"scratch": runs.learnt_alone(maze(-5), MAZE_STEPS, seeds, workers)}
    for name, arm in arms.items():
        results[name] = arm.train(seeds, trained=sources, workers=workers)["target"]
    return results, attribute(plan, steps=EXAMINED, seeds=seeds, trained=sources, workers=workers)


def _refused(size: int, seeds: int, workers: int | None) -> float:
    """Return the share of seeds for which a scale is the wrong model."""
    plan = corner_plan(size)
    sources = plan.train(seeds, only=["corner"], workers=workers).sources
    potentials = plan.potentials("target", sources)
    return float(np.mean([_is_refused(phi, k) for k, phi in enumerate(potentials)]))


def _is_refused(phi: Any, seed: int) -> bool:
    try:
        calibrate(phi, seed=seed)
    except CalibrationError:
        return True
    return False


def tenths(result: LearningResult) -> FloatArray:
    """Return the mean training return in each tenth of a run, (K, 10)."""
    values = result.training_return[:, 1:]
    parts = np.array_split(np.arange(values.shape[1]), 10)
    return np.stack([np.nanmean(values[:, part], axis=1) for part in parts], axis=1)
