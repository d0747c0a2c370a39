"""How often each verdict is wrong where arms are equal: the table of docs/trust.md.

All arms of a simulated study are of one distribution, so that each verdict which finds a difference
is a false alarm. Each entry is the share of studies with any, in percent; nominal is at most 5 %.
One entry of 3,000 studies has a standard error of 0.4. Takes ten minutes.

    python benchmarks/false_alarms.py [--studies 3000]
"""

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np

from curricle.comparison.verdicts import verdicts_of

SEEDS = (5, 6, 7, 10, 20, 50)
FAMILIES: dict[str, Callable[..., np.ndarray]] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "lognormal": lambda rng, shape: rng.lognormal(size=shape),
    "two-point": lambda rng, shape: rng.integers(2, size=shape).astype(float),
}


def any_found(returns, rivals):
    """Return whether any of the questions is answered by a difference."""
    return any(verdict.direction != 0 for verdict in verdicts_of(returns, rivals).values())


def pays(arms, family, seeds, rng):
    """Return whether any of some curricula is said to pay, or to cost more than it brings."""
    values = FAMILIES[family](rng, (arms + 1, seeds))
    names = [f"arm {n}" for n in range(arms)]
    returns = dict(zip(["scratch", *names], values, strict=True))
    return any_found(returns, {name: ["scratch"] for name in names})


def placebo(share, family, seeds, rng):
    """Return whether random values are said to gain more, or less, than a placebo's.

    A curriculum has one draw of values in all seeds, its placebo one for each; `share` of the
    variance of a return is the draw's, the rest the run's.
    """
    spread = FAMILIES[family](np.random.default_rng(0), (100_000,)).std()
    values = np.sqrt(share) * FAMILIES[family](rng, (seeds + 1,)) / spread
    runs = np.sqrt(1 - share) * rng.normal(size=(2, seeds))
    returns = {"arm": values[0] + runs[0], "placebo": values[1:] + runs[1]}
    verdicts = verdicts_of(returns, {"arm": ["placebo"]}, placebos=["placebo"])
    return verdicts["arm"].direction != 0


def controls(number, family, seeds, rng):
    """Return whether a curriculum is said to gain more, or less, than some controls."""
    values = FAMILIES[family](rng, (number + 1, seeds))
    names = [f"control {n}" for n in range(number)]
    return any_found(dict(zip(["arm", *names], values, strict=True)), {"arm": names})


VERDICTS: dict[str, Callable[..., bool]] = {
    f"{name}: {family}": partial(verdict, *settings, family)
    for name, verdict, settings in (
        ("pays or costs more, one curriculum", pays, (1,)),
        ("pays or costs more, any of five", pays, (5,)),
        ("gains more or less than a control", controls, (1,)),
        ("gains more or less than five controls", controls, (5,)),
        ("gains more or less than its placebo, half by the draw", placebo, (0.5,)),
        ("gains more or less than its placebo, all by the draw", placebo, (1.0,)),
    )
    for family in FAMILIES
}
"""Verdict and data -> whether one study has a false alarm, of (seeds, rng)."""


def false_alarms(verdict, seeds, studies):
    """Return the rate of false alarms of a verdict, from 0 to 1, with fixed random numbers."""
    rng = np.random.default_rng([list(VERDICTS).index(verdict), seeds, studies])
    return float(np.mean([VERDICTS[verdict](seeds, rng) for _ in range(studies)]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--studies", type=int, default=3000)
    studies = parser.parse_args().studies
    print("| nominal at most 5 % | " + " | ".join(f"{k} seeds" for k in SEEDS) + " |")
    print("|---" * (len(SEEDS) + 1) + "|")
    for verdict in VERDICTS:
        found = [f"{100 * false_alarms(verdict, k, studies):.1f}" for k in SEEDS]
        print(f"| {verdict} | " + " | ".join(found) + " |", flush=True)


if __name__ == "__main__":
    main()
