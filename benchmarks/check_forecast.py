"""Forecasts of each aggregate beside what learning then did: pursuit on 4x4 to 7x7 cells.

Training returns in the first and the last tenth of epsilon-greedy learning, mean over seeds, after
a forecast from the same sources. Takes about a minute and a half on two cores.

    python benchmarks/check_forecast.py [--seeds 6]
"""

import argparse

import numpy as np

import curricle as cr

LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
ROLLOUTS = cr.GreedyEvaluation(method="rollouts", episodes=20, discounted=False)
AGGREGATES = (cr.minimum, cr.mean, cr.total, cr.maximum)
# Cells a side, discount, time limit, source and target steps.
CASES = (
    (4, 0.95, 100, 400_000, 200_000),
    (4, 0.99, 200, 100_000, 200_000),
    (5, 0.95, 100, 400_000, 400_000),
    (5, 0.95, 100, 100_000, 400_000),
    (5, 0.99, 100, 400_000, 400_000),
    (6, 0.95, 200, 400_000, 600_000),
    (7, 0.95, 200, 400_000, 1_000_000),
)


def plan(aggregate, size, discount, limit, source_steps, target_steps):
    two, one = (cr.Pursuit(size, n, discount=discount, time_limit=limit) for n in (2, 1))
    return cr.Curriculum(
        tasks={"chase": one, "hunt": two},
        transfers=[
            cr.Transfer("chase", "hunt", cr.project(two, one, predator=name))
            for name in two.predator_names
        ],
        aggregate=aggregate,
        learner=LEARNER,
        shaping=cr.QInitialisation(),
        budget={"chase": cr.StoppingRule(source_steps), "hunt": target_steps},
        evaluation=ROLLOUTS,
    )


def tenths(result):
    """Return the mean training return in the first and in the last tenth."""
    curve = np.nanmean(result.training_return[:, 1:], axis=0)
    n = len(curve) // 10
    return curve[:n].mean(), curve[-n:].mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=6)
    seeds = parser.parse_args().seeds
    for case in CASES:
        foreseen = cr.forecast(plan(cr.mean, *case), seeds=seeds, trial=False)
        print(
            "{0}x{0}, discount {1}, cut at {2}, {3:,} source and {4:,} target steps".format(*case)
        )
        for aggregate in AGGREGATES:
            name = aggregate.__name__
            result = plan(aggregate, *case).train(seeds, trained=foreseen.trained)["hunt"]
            first, last = tenths(result)
            print(f"  {name:8} came {first:6.1f} -> {last:6.1f}   {foreseen[name].verdict}")


if __name__ == "__main__":
    main()
