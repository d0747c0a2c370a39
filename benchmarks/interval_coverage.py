"""How often each kind of printed interval covers the truth: tests/golden/interval_coverage.md.

Nominal coverage is 95 %. Each entry is the share of simulated studies, in percent, whose interval
covers the known truth, among those that have an interval (a sample without spread has none). One
entry of 20,000 studies has a standard error of 0.15. Takes about a minute.

    python benchmarks/interval_coverage.py [--studies 20000]
"""

import argparse
from collections.abc import Callable, Mapping
from functools import cache, partial

import numpy as np
from scipy.stats import binom

import curricle as cr
from curricle import statistics
from curricle.comparison.verdicts import steps_saved_share
from curricle.statistics.hypothesis_tests import performance_profile
from curricle.statistics.intervals import interquartile_interval

SEEDS = (3, 5, 10, 20, 50)
POPULATION = 2_000_000
"""Values from which a truth without a formula is computed."""

Draw = Callable[..., np.ndarray]  # (rng, shape) -> values
FAMILIES: Mapping[str, Draw] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "Gumbel": lambda rng, shape: rng.gumbel(size=shape),
    "lognormal, sigma 0.5": lambda rng, shape: rng.lognormal(sigma=0.5, size=shape),
    "lognormal, sigma 1": lambda rng, shape: rng.lognormal(sigma=1.0, size=shape),
    "two-point, 1 in 2": lambda rng, shape: (rng.random(shape) < 0.5).astype(float),
    "two-point, 1 in 10": lambda rng, shape: (rng.random(shape) < 0.1).astype(float),
}
"""Skewness 0, 1.1, 1.7, 6.2, 0 and 2.7."""


def learning(share):
    """Return draws of runs of which a share learns: returns near 1, the others' near 0."""
    return lambda rng, shape: (rng.random(shape) < share) + rng.normal(scale=0.02, size=shape)


def covered(interval, truth):
    """Return the share of intervals that cover the truth, among those with bounds."""
    low, high = np.atleast_1d(interval.low), np.atleast_1d(interval.high)
    given = ~np.isnan(low)
    return float(np.mean((low <= truth) & (truth <= high), where=given))


def mean(draw, seeds, studies, rng):
    """Return the coverage of a mean: each point of a learning curve."""
    truth = draw(np.random.default_rng(0), POPULATION).mean()
    return covered(statistics.mean_interval(draw(rng, (seeds, studies))), truth)


def difference(draw, seeds, studies, rng):
    """Return the coverage of a mean difference from an arm of half the spread: gains."""
    population = draw(np.random.default_rng(0), POPULATION)
    apart = draw(rng, (seeds, studies)) / 2 - draw(rng, (seeds, studies))
    return covered(statistics.mean_interval(apart), -population.mean() / 2)


def interquartile(draw, seeds, studies, rng):
    """Return the coverage of an interquartile mean."""
    population = np.sort(draw(np.random.default_rng(0), POPULATION))
    truth = population[POPULATION // 4 : -(POPULATION // 4)].mean()
    return covered(interquartile_interval(draw(rng, (seeds, studies))), truth)


def saved(sigma, never, seeds, studies, rng):
    """Return the coverage of steps saved, a share `never` of scratch not reaching the threshold.

    Times are lognormal; the arm takes a third of the steps of scratch.
    """

    def within(rng, shape):
        scratch, arm = (rng.lognormal(sigma=sigma, size=shape) for _ in range(2))
        return np.minimum(scratch, horizon) - np.minimum(arm / 3, horizon)

    whole = np.random.default_rng(0)
    horizon = np.quantile(whole.lognormal(sigma=sigma, size=POPULATION), 1 - never)
    truth = within(whole, POPULATION).mean()
    return covered(statistics.mean_interval(within(rng, (seeds, studies))), truth)


def share_saved(sigma, factors, seeds, studies, rng):
    """Return the coverage of the share of steps saved, over opponents of these factors.

    Times are lognormal; an opponent takes its factor times as many steps as the arm.
    """
    studies, every = min(studies, 4000), np.ones(seeds, bool)
    times = rng.lognormal(sigma=sigma, size=(studies, 1 + len(factors), seeds))
    times[:, 1:] *= np.array(factors)[:, None]
    found = [
        steps_saved_share(arm, opponents)
        for arm, *opponents in (
            [statistics.Times(steps, every) for steps in study] for study in times
        )
    ]
    truth = 1 - 1 / min(factors)
    return float(np.mean([one.low <= truth <= one.high for one in found]))


def mean_time(never, seeds, studies, rng):
    """Return the coverage of a mean time, a share of seeds not reaching the threshold."""
    studies = min(studies, 2000)
    steps = rng.lognormal(size=(studies, seeds))
    end = np.random.default_rng(0).lognormal(size=POPULATION)
    end = np.quantile(end, 1 - never)
    reached = steps <= end
    found = [
        statistics.Times(np.minimum(one, end), here).restricted_mean()
        for one, here in zip(steps, reached, strict=True)
    ]
    truth = np.exp(0.5)
    return float(np.mean([one.low <= truth <= one.high for one in found]))


def improvement(shift, spread, seeds, studies, rng):
    """Return the coverage of the probability of improvement of normal arms."""
    studies = min(studies, 4000)
    rest = np.random.default_rng(0).normal(size=(2, POPULATION))
    truth = np.mean(spread * rest[0] + shift > rest[1])
    pairs = rng.normal(size=(studies, 2, seeds))
    found = [statistics.probability_of_improvement(spread * a + shift, b) for a, b in pairs]
    return float(np.mean([one.low <= truth <= one.high for one in found]))


def profile(shares, seeds, studies, rng):
    """Return the exact coverage of a share of runs, mean over true shares."""
    runs = np.tri(seeds + 1, seeds, -1)  # row k: k of K runs above 0
    found = [performance_profile(row, [0.5]) for row in runs]
    low, high = (np.array([getattr(one, end)[0] for one in found]) for end in ("low", "high"))
    chance = binom.pmf(np.arange(seeds + 1)[:, None], seeds, shares)
    return float((chance * ((low[:, None] <= shares) & (shares <= high[:, None]))).sum(0).mean())


@cache
def learnt(task):
    """Return the gains, steps saved, mean returns, and one point of the curve of many seeds."""
    if task == "maze":
        target = cr.GridWorld(["....T", ".PPP.", "S...."])
        source = target.crop(rows=(0, 2), columns=(2, 5))
        mappings, many, budget = [cr.same_position(target, source)], 2000, (500, 5000)
    else:
        target, source = cr.Pursuit(4, 2), cr.Pursuit(4, 1)
        mappings = [cr.project(target, source, predator=name) for name in target.predator_names]
        many, budget = 300, (20_000, 100_000)
    plan = cr.Curriculum(
        tasks={"source": source, "target": target},
        transfers=[cr.Transfer("source", "target", one) for one in mappings],
        aggregate=cr.minimum,
        budget={"source": cr.StoppingRule(budget[0]), "target": budget[1]},
        shaping=cr.QInitialisation(),
    )
    found = cr.compare(plan, seeds=many, opponents=())
    scratch = found.scratch
    values = scratch.curve.filled()
    return {
        "gain": found.returns["transfer"] - found.returns["scratch"],
        "steps saved": found.times("scratch").steps - found.times("transfer").steps,
        "mean return": statistics.mean_return(scratch.curve),
        "point": values[:, values.std(axis=0).argmax()],
    }


def as_learnt(task, measure, seeds, studies, rng):
    """Return the coverage for samples of the seeds of a comparison, as if these were all."""
    values = learnt(task)[measure]
    sample = rng.choice(values, size=(seeds, studies))
    if measure == "mean return":
        cut, ordered = len(values) // 4, np.sort(values)
        return covered(interquartile_interval(sample), ordered[cut:-cut].mean())
    return covered(statistics.mean_interval(sample), values.mean())


SHARES = np.linspace(0.005, 0.995, 199)
KINDS: dict[str, Callable[[int, int, np.random.Generator], float]] = {
    **{f"mean: {name}": partial(mean, draw) for name, draw in FAMILIES.items()},
    **{f"paired difference: {name}": partial(difference, draw) for name, draw in FAMILIES.items()},
    **{f"interquartile mean: {name}": partial(interquartile, d) for name, d in FAMILIES.items()},
    **{
        f"steps saved: sigma {sigma:g}, {never:.0%} of scratch never": partial(saved, sigma, never)
        for sigma, never in ((0.5, 0.0), (0.5, 0.5), (0.5, 0.9), (1.0, 0.0), (1.0, 0.5), (1.0, 0.9))
    },
    "mean time: all reach the threshold": partial(mean_time, 0.0),
    "mean time: 30% never": partial(mean_time, 0.3),
    "P(improvement): 0.50": partial(improvement, 0.0, 1.0),
    "P(improvement): 0.76": partial(improvement, 1.0, 1.0),
    "P(improvement): 0.98": partial(improvement, 3.0, 1.0),
    "P(improvement): 0.84, a fifth of the spread": partial(improvement, 1.0, 0.2),
    "share of runs: mean over all shares": partial(profile, SHARES),
    "share of runs: 0.05": partial(profile, np.array([0.05])),
    "share of runs: 0.5": partial(profile, np.array([0.5])),
    "maze as learnt: gain": partial(as_learnt, "maze", "gain"),
    "maze as learnt: steps saved": partial(as_learnt, "maze", "steps saved"),
    "maze as learnt: interquartile mean return": partial(as_learnt, "maze", "mean return"),
    "maze as learnt: curve where seeds differ most": partial(as_learnt, "maze", "point"),
    "pursuit as learnt: gain": partial(as_learnt, "pursuit", "gain"),
    "pursuit as learnt: interquartile mean return": partial(as_learnt, "pursuit", "mean return"),
    "pursuit as learnt: curve where seeds differ most": partial(as_learnt, "pursuit", "point"),
    "mean: 95 in 100 learn": partial(mean, learning(0.95)),
    "mean: 80 in 100 learn": partial(mean, learning(0.8)),
    "interquartile mean: 95 in 100 learn": partial(interquartile, learning(0.95)),
    "interquartile mean: 80 in 100 learn": partial(interquartile, learning(0.8)),
    "share of steps saved: one opponent, sigma 0.5": partial(share_saved, 0.5, [3]),
    "share of steps saved: one opponent, sigma 1": partial(share_saved, 1.0, [3]),
    "share of steps saved: seven opponents, sigma 0.5": partial(
        share_saved, 0.5, [3, 3, 4, 5, 6, 8, 9]
    ),
}
"""Kind of interval and of data -> coverage of (seeds, studies, rng)."""


def coverage(kind, seeds, studies):
    """Return the coverage of a kind of interval, from 0 to 1, with fixed random numbers."""
    rng = np.random.default_rng([list(KINDS).index(kind), seeds, studies])
    return KINDS[kind](seeds, studies, rng)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--studies", type=int, default=20_000)
    studies = parser.parse_args().studies
    print("| nominal 95 % | " + " | ".join(f"{k} seeds" for k in SEEDS) + " |")
    print("|---" * (len(SEEDS) + 1) + "|")
    for kind in KINDS:
        found = [f"{100 * coverage(kind, k, studies):.1f}" for k in SEEDS]
        print(f"| {kind} | " + " | ".join(found) + " |", flush=True)


if __name__ == "__main__":
    main()
