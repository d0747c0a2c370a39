"""Learners without sources, on the targets of the benchmark of pairs: how well do they explore?

Prints for each target and learner the mean greedy return while learning, on the way from the random
policy (0) to the optimum (1). The constants of the learners that explore by optimism are fitted on
the development families (``--fit``) and judged on the others.

    python -m benchmarks.scratch_learners [--split verification] [--fit] [--seeds 5]
"""

import argparse

import numpy as np

import curricle as cr
from benchmarks.pairs import pairs
from curricle.learning import OPIQ, UCBQLearning, value_bounds
from curricle.planning.target import Target

EXACT = cr.GreedyEvaluation(method="exact")

FITTED = {
    **{f"UCB {c:g}": UCBQLearning(c=c) for c in (0.0, 1e-5, 3e-5, 1e-4, 1e-3)},
    **{f"OPIQ {m:g}": OPIQ(exponent=m) for m in (1.0, 2.0, 3.0, 4.0)},
}


def learners(task):
    """Return the learners to compare, by name."""
    return {
        "epsilon-greedy": cr.QLearning(),
        "optimistic start": cr.QLearning(initial_value=value_bounds(task)[1]),
        "UCB": UCBQLearning(),
        "OPIQ": OPIQ(),
    }


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="verification")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--fit", action="store_true", help="other constants, development alone")
    given = parser.parse_args()
    split = "development" if given.fit else given.split
    targets = {(pair.family, pair.target_name): pair for pair in pairs(split)}
    shares = []
    for (family, name), pair in targets.items():
        task, chosen = pair.target, FITTED if given.fit else learners(pair.target)
        judge = Target.of(task, EXACT)
        best, random = judge.optimum, judge.random_return
        row = []
        for learner in chosen.values():
            result = cr.learn(
                task,
                learner,
                pair.target_budget,
                seeds=given.seeds,
                eval_freq=pair.target_budget // 20,
                evaluation=EXACT,
            )
            row.append(((result.greedy_return.mean(axis=0) - random) / (best - random)).mean())
        if not shares:
            print(f"{'':44}" + "".join(f"{name:>18}" for name in chosen))
        shares.append(row)
        print(f"{family + '/' + name:44}" + "".join(f"{x:18.2f}" for x in row), flush=True)
    means = np.maximum(shares, -1.0).mean(axis=0)
    print(f"{'mean, cut off at -1':44}" + "".join(f"{x:18.2f}" for x in means))


if __name__ == "__main__":
    main()
