"""Calibrated transfers beside raw ones on the benchmark's pairs: docs/trust.md, `calibrate`.

Gains are shares of the way from the random to the optimal return, of the mean over training, with
the sources' steps free. A pair is worse if calibration loses more than 5 % of the raw gain.

    python -m benchmarks.check_calibration verification [--seeds 20]
"""

import argparse
import warnings

import numpy as np

import curricle as cr
from benchmarks.pairs import pairs


def compared(pair, seeds):
    """Return the shares from scratch, raw and calibrated, (K,) each, and the calibrations."""
    plan, task = pair.curriculum(), pair.target
    sources = plan.train(seeds, only=["source"]).sources
    arms = plan, pair.curriculum(calibrate=True)
    raw, calibrated = (arm.train(seeds, trained=sources) for arm in arms)
    scratch = cr.learn(
        task, budget=pair.target_budget, seeds=seeds, stream="target", eval_freq=pair.eval_freq,
        evaluation=cr.GreedyEvaluation(method="exact"),
    )  # fmt: skip
    n_actions = task.actions.size
    uniform = np.full((task.states.size, n_actions), 1 / n_actions)
    low, high = cr.evaluate(task, uniform).start_value, cr.solve(task).start_value
    shares = [
        (one.greedy_return.mean(axis=1) - low) / (high - low)
        for one in (scratch, raw["target"], calibrated["target"])
    ]
    return *shares, calibrated.calibrations["target"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("split", choices=["development", "verification"])
    parser.add_argument("--seeds", type=int, default=20)
    given = parser.parse_args()
    warnings.simplefilter("ignore")  # of seeds that are refused
    found = pairs(given.split)
    worse = 0
    for pair in found:
        scratch, raw, calibrated, fits = compared(pair, given.seeds)
        change = calibrated - raw
        error = change.std(ddof=1) / np.sqrt(len(change))
        is_worse = change.mean() < -0.05 * abs(raw.mean() - scratch.mean())
        worse += is_worse
        scales = [one.scale for one in fits if not one.refusal]
        steps = np.mean([one.steps for one in fits]) / pair.target_budget
        print(
            f"{pair.name:44} scratch {scratch.mean():6.3f}  raw {raw.mean():6.3f}  calibrated "
            f"{calibrated.mean():6.3f}  change {change.mean():7.4f} (error {error:.4f})  "
            f"{len(scales)} scaled, steps {steps:.2%}{'  WORSE' * bool(is_worse)}"
        )
    print(f"{worse} of {len(found)} pairs worse by more than 5 % of the raw gain")


if __name__ == "__main__":
    main()
