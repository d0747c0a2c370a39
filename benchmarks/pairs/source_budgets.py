"""Compare ways to say how long a source learns: until it has settled, fixed shares, by hand.

    python -m benchmarks.pairs.source_budgets --seeds 10

Only sensible pairs are played, with the default portfolio. All arms of a pair have one total; the
source's steps are charged. Gains over scratch are shares of the way from the random policy's
return to the optimum. A family counts once, with the mean of its pairs, since pairs of one family
are much alike; intervals at 95 % are Student's over families. The rule's constants were fitted on
the development families; the verification families judge them.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np

import curricle as cr
from benchmarks.pairs import Pair, pairs
from benchmarks.pairs.playing import levels, pair_named
from benchmarks.pairs.results import LEAST_BASE, student
from benchmarks.pairs.tables import MOST_LOSS
from curricle.statistics import mean_return

RULE = "not stated"
SHARES = {"a 30th of the target's": 30, "a tenth": 10, "a third": 3}


def arms(pair: Pair) -> dict[str, cr.Curriculum]:
    """Return the arms; they differ in the source's budget alone."""
    own, most = pair.source_budget, pair.target_budget
    caps = {"by hand, a cap": own, RULE: None}
    exact = {"by hand, exactly": own, **{k: most // n for k, n in SHARES.items()}}
    exactly = {name: cr.StoppingRule(steps) for name, steps in exact.items()}
    return {
        name: pair.curriculum(
            shaping=None,
            budget={"source": budget, "target": most},
            eval_freq={"target": pair.eval_freq},
        )
        for name, budget in {**caps, **exactly}.items()
    }


def played(name: str, seeds: int) -> dict[str, Any]:
    """Return what is kept of a pair: each arm's gain, its loss and its source's steps."""
    pair = pair_named(name)
    found = cr.compare(arms(pair), seeds=seeds, opponents=(), workers=1)
    random, optimum = levels(pair.target)
    base = (mean_return(found.scratch.curve).mean() - random) / (optimum - random)
    row: dict[str, Any] = {"pair": name, "family": pair.family, "split": pair.split}
    for arm in arms(pair):
        gain = found[arm].strong_gain(found.scratch).mean() / (optimum - random)
        steps = found[arm].curve.source_steps.mean() / pair.target_budget
        row[arm] = {"gain": gain, "loss": -gain / max(base, LEAST_BASE), "steps": steps}
    return row


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table: a line for each arm."""
    names = [name for name in rows[0] if name not in ("pair", "family", "split")]
    families = {
        row["family"]: [one for one in rows if one["family"] == row["family"]] for row in rows
    }
    by_family = {
        arm: np.array([np.mean([row[arm]["gain"] for row in own]) for own in families.values()])
        for arm in names
    }
    lines = [
        f"{'':<30}{'gain':>8}{'rule gains more by':>24}{'worse than the rule':>21}{'loses':>7}"
        f"{'steps':>7}"
    ]
    for arm in names:
        over = student(by_family[RULE] - by_family[arm])
        more = f"{over.estimate:+.3f} ({over.low:+.3f}, {over.high:+.3f})" if arm != RULE else ""
        worse = sum(row[arm]["gain"] < row[RULE]["gain"] for row in rows)
        loses = sum(row[arm]["loss"] > MOST_LOSS for row in rows)
        steps = np.mean([row[arm]["steps"] for row in rows])
        of = f"{worse} of {len(rows)}" if arm != RULE else ""
        lines.append(
            f"{arm:<30}{by_family[arm].mean():>+8.3f}{more:>24}{of:>21}{loses:>7}{steps:>7.0%}"
        )
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Play the pairs and print a table for each split."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.pairs.source_budgets", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--split", choices=["development", "verification"])
    parser.add_argument("--pair", action="append", help="one pair by name; may be repeated")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    given = parser.parse_args(arguments)
    names = given.pair or [pair.name for pair in pairs(given.split) if pair.sensible]
    rows = []
    with ProcessPoolExecutor(min(given.workers, len(names))) as pool:
        for row in pool.map(partial(played, seeds=given.seeds), names):
            rows.append(row)
            print(f"{len(rows)} of {len(names)}: {row['pair']}", file=sys.stderr, flush=True)
    for split in dict.fromkeys(row["split"] for row in rows):
        own = [row for row in rows if row["split"] == split]
        print(f"{split}: {len(own)} pairs, {len({row['family'] for row in own})} families")
        print("\n".join(table(own)), end="\n\n")
    print(
        "gain: mean over families, of the way to the optimum. loses: pairs whose loss against\n"
        f"scratch is more than {MOST_LOSS:.0%} of what scratch covers. steps: of the source, as a\n"
        "share of the target's budget."
    )


if __name__ == "__main__":
    main()
