"""How many steps a state sources need as tasks grow: cost curves of several sizes, aligned.

Box and Wilson 1951, "on the experimental attainment of optimum conditions": the lowest point of a
polynomial in the logarithm of the steps, fitted to trials. Here tasks of all sizes share its shape,
and it moves with the logarithm of the size.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.design.arms import with_steps
from curricle.design.problem import Problem
from curricle.design.recipe import Recipe
from curricle.design.search_budget import SearchBudget
from curricle.design.trends import Trend

FACTORS = (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0, 8.0)
"""Of the recipe's steps a state, which are tried."""
MOST_SEEDS = 16
DEGREE = 4
SLOPES = np.arange(-0.5, 1.51, 0.05)
"""Logarithms of steps a state by those of states that are tried."""
POINTS = 401
"""At which the lowest point of the polynomial is looked for."""
FEWEST_RUNS = 4
ROUNDING = 1e-12
RESAMPLES = 200
AGREE = 0.9
"""Share of the resamples whose slopes must have one sign; else the number is a constant."""


def with_step_trend(
    problems: Sequence[Problem],
    recipe: Recipe,
    budget: SearchBudget,
    *,
    first_seed: int,
) -> Recipe:
    """Return a recipe whose steps a state are those that cost the least, by size.

    Each problem is trained with several times the recipe's steps. Where the lowest cost moves with
    the size of the target in nine of ten resamples (of problems, and of their seeds), each
    stage gets a trend, with the resamples for its interval; else a constant.

    Returns
    -------
    Recipe
        The same one where the budget does not pay for four runs of each.
    """
    each = (len(FACTORS) + 1) * sum(budget.most(one, 1) for one in problems)
    seeds = int(min(MOST_SEEDS, budget.left / each)) if each else MOST_SEEDS
    if not recipe.stages or seeds * len(problems) < FEWEST_RUNS:
        return recipe
    numbers = range(first_seed, first_seed + seeds)
    costs = np.empty((len(problems), len(FACTORS), seeds))
    for p, problem in enumerate(problems):
        scratch = budget.train(problem, problem.scratch, numbers).steps.mean()
        for f, factor in enumerate(FACTORS):
            plan = problem.curriculum(with_steps(recipe, factor))
            costs[p, f] = budget.train(problem, plan, numbers).steps / scratch
    sizes = np.log([one.task.states.size for one in problems])
    random = np.random.default_rng([first_seed, len(problems)])
    level, slope = lowest(sizes, costs.mean(axis=2))
    resampled = np.array([lowest(*_resampled(sizes, costs, random)) for _ in range(RESAMPLES)])
    agree = (np.sign(resampled[:, 1]) == np.sign(slope)).mean()
    if agree < AGREE:
        slope, resampled[:, 1] = 0.0, 0.0
        level = lowest(np.zeros_like(sizes), costs.mean(axis=2))[0]
    around = math.exp(float(sizes.mean()))
    stages = []
    for stage in recipe.stages:
        base = stage.steps.at(around)
        draws = np.stack([base * np.exp(resampled[:, 0]), stage.steps.slope + resampled[:, 1]], 1)
        trend = Trend(base * math.exp(level), stage.steps.slope + slope, around, draws)
        stages.append(replace(stage, steps=trend))
    return replace(recipe, stages=stages)


def lowest(sizes: FloatArray, costs: FloatArray) -> tuple[float, float]:
    """Return where the cost is the lowest: the log factor at the mean size, and its slope.

    log cost of problem p at log factor x is a_p + g(x - slope z_p), where z_p is its size less the
    mean and g a polynomial of degree 4. The slope is that of :data:`SLOPES` by which the curves
    agree the most. Costs above that of scratch, 1, are left out: what does not pay has no say in
    where it pays the most.

    Parameters
    ----------
    sizes : (P,) float64
        Logarithms of states.
    costs : (P, F) float64
        Mean steps of each problem and factor, over those of scratch.

    Returns
    -------
    (float, float)
        Where fewer than six costs are below 1, the factor of the lowest mean and slope 0.

    Examples
    --------
    >>> x, sizes = np.log(FACTORS), np.array([1.0, 3.0])
    >>> costs = 0.4 * np.exp(0.2 * (x - 0.5 * (sizes[:, None] - 2.0)) ** 2)
    >>> tuple(round(one, 2) + 0.0 for one in lowest(sizes, costs))
    (0.0, 0.5)
    """
    x, z = np.log(FACTORS), sizes - sizes.mean()
    p, f = np.nonzero(costs < 1)
    if len(p) < DEGREE + 2:
        return float(x[costs.mean(axis=0).argmin()]), 0.0
    own = _less_means(np.log(costs[p, f])[:, None], p)
    best, found = np.inf, (0.0, 0.0)
    for slope in SLOPES if np.ptp(z) > 0 else [0.0]:
        u = x[f] - slope * z[p]
        powers = u[:, None] ** np.arange(1, DEGREE + 1)
        design = _less_means(powers, p)
        weights = np.linalg.lstsq(design, own, rcond=None)[0]
        error = float(((own - design @ weights) ** 2).sum())
        if error < best - ROUNDING:
            at = np.linspace(max(u.min(), x[0]), min(u.max(), x[-1]), POINTS)
            curve = (at[:, None] ** np.arange(1, DEGREE + 1)) @ weights[:, 0]
            best, found = error, (float(at[curve.argmin()]), float(slope))
    return found


def _less_means(values: FloatArray, problem: IntArray) -> FloatArray:
    """Return rows less the mean row of their problem, so that each problem has its own constant."""
    counts = np.maximum(np.bincount(problem), 1)
    total = np.zeros((len(counts), values.shape[1]))
    np.add.at(total, problem, values)
    return np.asarray(values - (total / counts[:, None])[problem])


def _resampled(
    sizes: FloatArray, costs: FloatArray, draws: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    problems = draws.integers(len(sizes), size=len(sizes))
    seeds = draws.integers(costs.shape[2], size=costs.shape[2])
    return sizes[problems], costs[problems][:, :, seeds].mean(axis=2)
