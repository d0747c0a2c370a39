"""Learners without sources, on the targets of the benchmark of pairs: how well do they explore?

Prints for each target and learner the mean greedy return while learning, on the way from the random
policy (0) to the optimum (1). "single table" is the optimistic learner without its second table:
the values that it acts on are evaluated.

    python -m benchmarks.scratch_learners [--split verification] [--seeds 20]
"""

import argparse

import numpy as np

import curricle as cr
from benchmarks.pairs import pairs
from curricle.learning import OptimisticQLearning, value_bounds
from curricle.planning.target import Target

EXACT = cr.GreedyEvaluation(method="exact")


def learners(task):
    """Return the learners to compare, by name."""
    highest, optimist = value_bounds(task)[1], OptimisticQLearning()
    rate = optimist.for_task(task).learning_rate
    return {
        "epsilon-greedy": cr.QLearning(),
        "high start": cr.QLearning(initial_value=highest),
        "single table": cr.QLearning(learning_rate=rate, epsilon=0.0, initial_value=highest),
        "optimistic": optimist,
    }


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="verification")
    parser.add_argument("--seeds", type=int, default=20)
    given = parser.parse_args()
    targets = {(pair.family, pair.target_name): pair for pair in pairs(given.split)}
    shares = []
    for (family, name), pair in targets.items():
        task, chosen = pair.target, learners(pair.target)
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
