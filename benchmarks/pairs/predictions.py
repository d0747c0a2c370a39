"""What a trial says of each pair, before its target is learnt; and what came of it.

    python -m benchmarks.pairs.predictions --split development --out predictions.parquet
    python -m benchmarks.pairs.predictions --realised pairs.parquet --out predictions.parquet

The first command takes seconds a pair: three seeds of the source, whose potentials are looked at,
and a trial of 20 seeds on random streams of its own. The second joins the predictions with the
gains that the runner of the pairs measured, sources charged, and prints

- rank: the rank correlation with the realised gain within targets, pooled. Both are ranked among
  the pairs of a target, the ranks scaled to [-1, 1], and correlated over all pairs;
- sign: of the pairs whose gain differs from 0 (95 % intervals over seeds) the share of which the
  trial names the right sign;
- choice: the share of targets in which the first choice is at most a tenth of the best gain below
  it. The first choice has the highest gain in the trial, or is to learn from scratch where none is
  above 0.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.stats import rankdata

from benchmarks.pairs import family_names, pairs
from curricle.comparison.forecasting import ForecastRow, anti_knowledge
from curricle.comparison.trial import candidates_of, run_trial
from curricle.planning.target import Target
from curricle.statistics import mean_interval
from curricle.transfer.rollouts import potential_quality

SOURCE_SEEDS = (0, 1, 2)
CLOSE = 0.1
"""Share of the best in hindsight that a first choice may lose."""


def predictions_of(pair):
    """Return the row of a pair: what its sources' potentials and a trial say."""
    started = time.perf_counter()
    plan = pair.curriculum()
    (candidate,) = (one for one in candidates_of(plan, "target") if one.used)
    sources = plan.train(SOURCE_SEEDS, only="source", workers=1).sources
    target = Target.of(pair.target, plan.setting("evaluation", "target"))
    potentials = candidate.potentials(sources, SOURCE_SEEDS)
    quality = tuple(potential_quality(phi, target, seed=k) for k, phi in enumerate(potentials))
    row = {
        "pair": pair.name,
        "family": pair.family,
        "split": pair.split,
        "kind": pair.kind,
        "target": pair.target_name,
        "anti_knowledge": anti_knowledge(
            ForecastRow("", True, True, quality, ()), target.random_return
        ),
    }
    row["seconds"] = time.perf_counter() - started
    trial = run_trial([candidate], workers=1)
    arm, scratch = trial.comparison[candidate.name], trial.comparison.scratch
    row["trial"] = float(np.mean(arm.strong_gain(scratch)))
    gain = trial.gain(candidate.name)
    row["trial_low"], row["trial_high"] = float(gain.low), float(gain.high)
    row["trial_seconds"] = time.perf_counter() - started - row["seconds"]
    return row


def pooled_rank(score, gain, target):
    """Return the correlation of the ranks within targets, over all pairs."""
    mine, yours = [], []
    for name in np.unique(target):
        rows = target == name
        if rows.sum() > 1:
            mine.append(_scaled_ranks(score[rows]))
            yours.append(_scaled_ranks(gain[rows]))
    return float(np.corrcoef(np.concatenate(mine), np.concatenate(yours))[0, 1])


def _scaled_ranks(values):
    """Return ranks from -1 to 1, ties at their mean; what is unknown is in the middle."""
    known = np.isfinite(values)
    ranks = np.zeros(len(values))
    if known.sum() > 1:
        ranks[known] = 2 * (rankdata(values[known]) - 1) / (known.sum() - 1) - 1
    return ranks


def right_signs(score, gain, low, high):
    """Return the share of right signs, and the pairs whose gain differs from 0."""
    differs = (low > 0) | (high < 0)
    right = (score[differs] > 0) == (gain[differs] > 0)
    return float(right[np.isfinite(score[differs])].sum() / differs.sum()), int(differs.sum())


def regrets(score, gain, target):
    """Return for each target how far the first choice is below the best, as a share of the best.

    Where nothing pays it is 0 for learning from scratch, and infinite for any source that costs.
    """
    found = []
    for name in np.unique(target):
        scores, gains = np.nan_to_num(score[target == name], nan=-np.inf), gain[target == name]
        chosen = gains[scores.argmax()] if scores.max() > 0 else 0.0
        best = max(gains.max(), 0.0)
        short = best - chosen
        found.append(0.0 if short <= 0 else short / best if best > 0 else np.inf)
    return np.array(found)


def judge(predictions, realised):
    """Print the bars of the trial; `realised` are gain, low and high of each pair."""
    rows = [row for row in predictions if row["pair"] in realised]
    gain, low, high = np.array([realised[row["pair"]] for row in rows]).T
    target = np.array([f"{row['family']}: {row['target']}" for row in rows])
    score = np.array([row["trial"] for row in rows], dtype=float)
    rank, (sign, n) = pooled_rank(score, gain, target), right_signs(score, gain, low, high)
    choice = float((regrets(score, gain, target) <= CLOSE).mean())
    print(f"{len(rows)} pairs, {len(np.unique(target))} targets")
    print(f"rank {rank:.2f}, sign {sign:.0%}, choice {choice:.0%}")
    print(
        f"the gains of {n} pairs differ from 0; {(gain[(low > 0) | (high < 0)] > 0).mean():.0%} "
        "of these are above it"
    )
    judge_words(rows, gain, low, high)


def judge_words(rows, gain, low, high):
    """Print how often words came true."""
    for words, sign, said in (
        ("likely pays", 1, lambda row: row["trial_low"] > 0),
        ("likely costs more than it brings", -1, lambda row: row["trial_high"] < 0),
        ("may be anti-knowledge", -1, lambda row: bool(row["anti_knowledge"])),
        ("(not named as anti-knowledge)", -1, lambda row: not row["anti_knowledge"]),
    ):
        named = np.array([said(row) for row in rows])
        true, shown = (sign * gain > 0)[named], (low > 0 if sign > 0 else high < 0)[named]
        against = (high < 0 if sign > 0 else low > 0)[named]
        print(
            f'"{words}", said of {named.sum()}: gain of that sign in {true.mean():.0%}, shown by '
            f"20 seeds in {shown.mean():.0%}, the contrary shown in {against.mean():.0%}"
        )


def realised_gains(path, arm="raw"):
    """Return gain, low and high of each pair, from the Parquet file of the pairs' runner."""
    gains = {}
    for row in pq.read_table(path, filters=[("arm", "=", arm)]).to_pylist():
        gains.setdefault(row["pair"], []).append(row["gain"])
    found = {}
    for name, each in gains.items():
        interval = mean_interval(each)
        found[name] = interval.estimate, interval.low, interval.high
    return found


def predict(chosen, out):
    """Write the predictions of some pairs; those that are there already are kept."""
    rows = pq.read_table(out).to_pylist() if out.exists() else []
    known = {row["pair"] for row in rows}
    for pair in chosen:
        if pair.name in known:
            continue
        rows.append(predictions_of(pair))
        pq.write_table(pa.Table.from_pylist(rows), out)
        print(f"{pair.name}: {rows[-1]['trial_seconds']:.1f} s", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--split", choices=["development", "verification"])
    parser.add_argument("--family", choices=family_names())
    parser.add_argument("--realised", type=Path, help="what the runner of the pairs wrote")
    parser.add_argument("--out", type=Path, default=Path("predictions.parquet"))
    given = parser.parse_args()
    if given.realised is None:
        predict(pairs(given.split, given.family), given.out)
    else:
        judge(pq.read_table(given.out).to_pylist(), realised_gains(given.realised))
