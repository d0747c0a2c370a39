"""How often verdicts are wrong where arms are equal, and right where not: tables of docs/trust.md.

All arms of a simulated study are of one distribution, so that each verdict which finds a difference
is a false alarm. Each entry is the share of studies with any, in percent; nominal is at most 5 %.
One entry of 3,000 studies has a standard error of 0.4. Takes ten minutes. With `--power` a
curriculum has a gain, and an entry is the share of studies that show it. With `--audits` each study
is played: the audit of rooms drawn at random, with potentials that only break ties, so that what
is gained over scratch is luck of the seeds or of tuning. It goes on after a kill.

    python -m benchmarks.false_alarms [--power] [--studies 3000]
    python -m benchmarks.false_alarms --audits null-audits --studies 200
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from curricle.comparison.verdicts import verdicts_of
from curricle.study import audit, read_study

SEEDS, POWER_SEEDS = (6, 7, 10, 20, 50), (10, 20, 50)
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
        ("gains more or less than five controls", controls, (5,)),
        ("gains more or less than its placebo, half by the draw", placebo, (0.5,)),
        ("gains more or less than its placebo, all by the draw", placebo, (1.0,)),
    )
    for family in FAMILIES
}
"""Verdict and data -> whether one study has a false alarm, of (seeds, rng)."""


def shown(gain, below, tuning, seeds, rng):
    """Return whether a curriculum is said to pay; if it gains nothing, or to cost more.

    It gains `gain` over the best of seven opponents; the k-th of them is `below` of k lower, in
    standard deviations of a run. If there are seeds for tuning, it is compared with the three that
    have the highest means there.
    """
    means = -np.array([below(k) for k in range(7)])
    tested = np.argsort(rng.normal(means, 1 / np.sqrt(tuning)))[-3:] if tuning else range(7)
    runs = means[:, np.newaxis] + rng.normal(size=(7, seeds))
    returns = {"arm": gain + rng.normal(size=seeds), **{f"{k}": runs[k] for k in tested}}
    verdict = verdicts_of(returns, {"arm": [f"{k}" for k in tested]})["arm"]
    return verdict.direction > 0 or (gain == 0 and verdict.direction < 0)


EQUAL, ONE, LADDER = (lambda k: 0.0), (lambda k: 0.5 * (k > 0)), (lambda k: 0.5 * k)
POWER: dict[str, Callable[..., bool]] = {
    "gain .5: all equal": partial(shown, 0.5, EQUAL, 0),
    "gain .5: six half a deviation below the best": partial(shown, 0.5, ONE, 0),
    "gain .5: each half a deviation below the one before": partial(shown, 0.5, LADDER, 0),
    "gain .5: all equal, three chosen": partial(shown, 0.5, EQUAL, 10),
    "no gain: six half a deviation below the best, three chosen": partial(shown, 0.0, ONE, 10),
}
"""Gain, opponents and which are tested -> whether one study shows a difference, of (seeds, rng)."""


NOTHING, AUDIT_TRIALS = Path(__file__).with_name("nothing.toml"), 4  # 20 an arm


def noise(task: Any) -> np.ndarray:
    """Return values far too small to tell good from bad, drawn for each task anew."""
    rng = np.random.default_rng(task.mdp.next_state.ravel().astype(np.uint32))
    return 1e-9 * rng.random((task.states.size, task.actions.size))


def null_audits(folder: Path, studies: int) -> Iterator[list[str]]:
    """Yield what each audit answers of potentials that know nothing, in rooms drawn at random."""
    for number in range(studies):
        rng = np.random.default_rng(number)
        rooms = {
            "size": rng.integers(7, 10),
            "slip": round(rng.uniform(0.0, 0.4), 2),
            "goal": rng.choice(["north", "east", "south", "west"]),
            "budget": rng.integers(1, 9) * 1_000,
        }
        changes = [f"tasks.rooms.{key}={value}" for key, value in rooms.items()]
        seeds = f"seeds={100 * number}-{100 * number + 19}"
        study = read_study(NOTHING, set=[seeds, *changes])
        fair = audit(study, folder / str(number), trials=AUDIT_TRIALS, workers=1).fair
        yield [fair.comparison.contrasts[arm].answer for arm in fair.comparison.verdicts]


def rate(cases, case, seeds, studies):
    """Return the share of studies in which a case is true, with fixed random numbers."""
    rng = np.random.default_rng([list(cases).index(case), seeds, studies])
    return float(np.mean([cases[case](seeds, rng) for _ in range(studies)]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--studies", type=int, default=3000)
    parser.add_argument("--power", action="store_true", help="of a gain, instead of none")
    parser.add_argument("--audits", type=Path, metavar="FOLDER", help="play them in a folder")
    asked = parser.parse_args()
    if asked.audits:
        for number, answers in enumerate(null_audits(asked.audits, asked.studies)):
            print(number, *answers, sep="\t", flush=True)
        return
    tables = (POWER, POWER_SEEDS, "shown, in percent"), (VERDICTS, SEEDS, "nominal at most 5 %")
    cases, seeds, head = tables[not asked.power]
    print(f"| {head} | " + " | ".join(f"{k} seeds" for k in seeds) + " |")
    print("|---" * (len(seeds) + 1) + "|")
    for case in cases:
        found = [f"{100 * rate(cases, case, k, asked.studies):.1f}" for k in seeds]
        print(f"| {case} | " + " | ".join(found) + " |", flush=True)


if __name__ == "__main__":
    main()
