"""How many steps a state sources need as tasks grow: cost curves of several sizes, aligned.

Box and Wilson 1951, "on the experimental attainment of optimum conditions": the lowest point of a
polynomial in the logarithm of the steps, fitted to trials. Here tasks of all sizes share its shape,
and it moves with the logarithm of the size.

Miniatures differ little in size and much in all else, so the slope of that is uncertain, and a
large task is far away: an error of 0.5 triples the steps for 8 times the states. So the slope is
shrunk towards what is known before any trial. Values travel one step back a visit, hence the visits
that a state needs grow as the way from the start to the goal does.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.design.arms import with_steps
from curricle.design.problem import Problem
from curricle.design.proposals import aims
from curricle.design.recipe import Recipe
from curricle.design.search_budget import SearchBudget
from curricle.design.trends import Trend
from curricle.progress import SILENT, Bars
from curricle.tasks.start_states import goal_distance
from curricle.tasks.task import has_tables, tables

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
"""Share of the resamples whose slopes must have one sign, where nothing is known of the ways to the
goal; else the number is a constant."""
DOUBT = 0.5
"""Standard deviation, over families, of the power of the way with which steps a state grow; its
mean is 1. Measured: 1.5 for random mazes from 36 to 400 states, 0.8 for pursuits."""


def with_step_trend(
    problems: Sequence[Problem],
    recipe: Recipe,
    budget: SearchBudget,
    *,
    first_seed: int,
    bars: Bars = SILENT,
) -> Recipe:
    """Return a recipe whose steps a state are those that cost the least, by size.

    Each problem is trained with several times the recipe's steps. Where the lowest cost moves with
    the size of the target, each stage gets a trend, with resamples (of problems, and of their
    seeds) for its interval. Its slope is the mean of the fitted one and of :func:`way_slope`,
    weighted by their precisions. Where the ways are not known, it is the fitted one if nine of ten
    resamples agree on its sign, and else 0.

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
    grow = bars.bar("steps a state", len(problems) * (1 + len(FACTORS)))
    for p, problem in enumerate(problems):
        scratch = budget.train(problem, problem.scratch, numbers).steps.mean()
        grow()
        for f, factor in enumerate(FACTORS):
            plan = problem.curriculum(with_steps(recipe, factor))
            costs[p, f] = budget.train(problem, plan, numbers).steps / scratch
            grow()
    sizes = np.log([one.task.states.size for one in problems])
    random = np.random.default_rng([first_seed, len(problems)])
    known = float(np.mean([one.steps.slope for one in recipe.stages]))
    level, slope, resampled = fitted(sizes, costs, way_slope(problems), random, known=known)
    around = math.exp(float(sizes.mean()))
    stages = []
    for stage in recipe.stages:
        base = stage.steps.at(around)
        draws = np.stack([base * np.exp(resampled[:, 0]), stage.steps.slope + resampled[:, 1]], 1)
        trend = Trend(base * math.exp(level), stage.steps.slope + slope, around, draws)
        stages.append(replace(stage, steps=trend))
    return replace(recipe, stages=stages)


def way_slope(problems: Sequence[Problem]) -> float | None:
    """Return the slope of the logarithm of the way to the goal over that of the states.

    The way is the fewest steps to the goal (:func:`aims`) from the start that is the farthest away.

    Returns
    -------
    float or None
        None where a task has no tables, no way has a step, or ways do not grow with the states.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> mazes = [Problem(maze_family(size=n, walls=0.0, seed=1), steps=1) for n in (5, 9)]
    >>> round(way_slope(mazes), 2)  # 8 steps for 25 states, 16 for 81
    0.59
    """
    if not all(has_tables(one.task) for one in problems):
        return None
    models = [tables(one.task) for one in problems]
    ways = np.array([goal_distance(one, aims(one))[one.start_states].max() for one in models])
    sizes = np.log([one.task.states.size for one in problems])
    z = sizes - sizes.mean()
    if ways.min() < 1 or np.ptp(z) == 0:
        return None
    slope = float(z @ np.log(ways) / (z @ z))
    return slope if slope > 0 else None


def fitted(
    sizes: FloatArray,
    costs: FloatArray,
    way: float | None,
    random: np.random.Generator,
    *,
    known: float = 0.0,
) -> tuple[float, float, FloatArray]:
    """Return the log factor at the mean size, its slope, and resamples of both.

    Parameters
    ----------
    sizes : (P,) float64
        Logarithms of states.
    costs : (P, F, K) float64
        Of each problem, factor and seed, over the mean of scratch.
    way : float or None
        The slope of the ways to the goal (:func:`way_slope`).
    random : Generator
    known : float
        How much of the slope the recipe has before, to which a factor is added.

    Returns
    -------
    (float, float, (n, 2) float64)

    Examples
    --------
    >>> sizes, x = np.array([3.5, 3.5, 4.5, 4.5]), np.log(FACTORS)
    >>> lows = np.array([0.9, -0.9, 0.6, -0.6])  # problems of one size differ, those of two do not
    >>> costs = 0.4 * np.exp(0.1 * (x - lows[:, None]) ** 2)[:, :, None]
    >>> level, slope, _ = fitted(sizes, costs, 0.5, np.random.default_rng(0))
    >>> 0.3 < slope < 0.5, fitted(sizes, costs, None, np.random.default_rng(0))[1]
    (True, 0.0)
    """
    samples = [(sizes, costs.mean(axis=2))]
    samples += [_resampled(sizes, costs, random) for _ in range(RESAMPLES)]
    slopes = np.array([lowest(*one)[1] for one in samples])
    if way is not None:
        before = DOUBT * way
        weight = before**2 / (before**2 + float(slopes[1:].var()))
        # A draw of each is a draw of the weighted mean: its variance is the posterior's.
        means = way - known + before * np.array([0.0, *random.standard_normal(RESAMPLES)])
        slopes = weight * slopes + (1 - weight) * means
    elif (np.sign(slopes[1:]) == np.sign(slopes[0])).mean() < AGREE:
        slopes[:] = 0.0
    levels = [
        lowest(*one, slopes=np.array([slope]))[0]
        for one, slope in zip(samples, slopes, strict=True)
    ]
    found = np.stack([levels, slopes], axis=1)
    return float(levels[0]), float(slopes[0]), found[1:]


def lowest(
    sizes: FloatArray, costs: FloatArray, slopes: FloatArray = SLOPES
) -> tuple[float, float]:
    """Return where the cost is the lowest: the log factor at the mean size, and its slope.

    log cost of problem p at log factor x is a_p + g(x - slope z_p), where z_p is its size less the
    mean and g a polynomial of degree 4. The slope is that of `slopes` by which the curves
    agree the most. Costs above that of scratch, 1, are left out: what does not pay has no say in
    where it pays the most.

    Parameters
    ----------
    sizes : (P,) float64
        Logarithms of states.
    costs : (P, F) float64
        Mean steps of each problem and factor, over those of scratch.
    slopes : (n,) float64

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
    for slope in slopes if np.ptp(z) > 0 else [0.0]:
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
