"""Playing one pair: a comparison of all its arms, and the rows that are kept of it."""

import time
import warnings
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

import curricle as cr
from benchmarks.pairs import Pair, pairs
from benchmarks.pairs.arms import CONTROLS, DEFAULTS, RAW, curricula, raw, scratch_learners
from curricle.comparison.comparison import Comparison
from curricle.planning.target import Target
from curricle.statistics import asymptotic_performance, mean_return
from curricle.statistics.curves import SCRATCH

EXACT = cr.GreedyEvaluation(method="exact")
NAN = float("nan")


def pair_named(name: str) -> Pair:
    """Return a pair by its name."""
    (found,) = (pair for pair in pairs(family=name.partition("/")[0]) if pair.name == name)
    return found


def play(name: str, arms: Sequence[str], seeds: int) -> list[dict[str, Any]]:
    """Return a row for each arm and seed of a pair; they depend on the arguments and the code.

    The raw arm is compared by itself, since its controls would be run for every other arm too; its
    verdict is against the learner from scratch of its own kind, that of the other arms against the
    best from scratch. The defaults, whose sources take other steps, have a total of their own; the
    other comparisons have one total. All have one target and one threshold.
    """
    pair, begun = pair_named(name), time.process_time()
    others = curricula(pair, [arm for arm in arms if arm != RAW])
    defaults = {arm: others.pop(arm) for arm in DEFAULTS if arm in others}
    rows: list[dict[str, Any]] = []
    alone: Any = {"opponents": (), "workers": 1}  # those that matter are arms
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        facts = facts_of(pair, seeds)
        if RAW in arms:
            found = cr.compare({RAW: raw(pair)}, seeds=seeds, controls=CONTROLS, **alone)
            rows += rows_of(pair, found)
        if others:
            found = cr.compare(others, seeds=seeds, scratch=scratch_learners(pair), **alone)
            rows += rows_of(pair, found, scratch=not rows)
        if defaults:
            found = cr.compare(defaults, seeds=seeds, **alone)
            rows += rows_of(pair, found, scratch=not rows)
    seconds = time.process_time() - begun
    return [{**row, **facts, "pair_seconds": seconds} for row in rows]


def rows_of(pair: Pair, found: Comparison, *, scratch: bool = True) -> Iterator[dict[str, Any]]:
    """Yield a row for each arm, the learner from scratch first if wanted, and each seed."""
    if found.failed:
        raise next(iter(found.failed.values()))
    base = mean_return(found.scratch.curve)
    for arm, played in found.arms.items():
        if arm == SCRATCH and not scratch:
            continue
        charged, weak = played.charged(found.scratch), found._weak(arm)
        times, contrast = found.times(arm), found.contrasts.get(arm)
        gain = played.strong_gain(found.scratch)
        weak_base = found._weak(SCRATCH)
        weak_gain = mean_return(weak) - mean_return(weak_base)
        weak_final_gain = asymptotic_performance(weak) - asymptotic_performance(weak_base)
        for k in range(found.seeds):
            yield {
                "pair": pair.name,
                "arm": arm,
                "seed": k,
                "gain": float(gain[k]),
                "mean_return": float(mean_return(charged)[k]),
                "scratch_mean_return": float(base[k]),
                "weak_mean_return": float(mean_return(weak)[k]),
                "weak_gain": float(weak_gain[k]),
                "weak_final_gain": float(weak_final_gain[k]),
                "start_return": float(played.curve.values[k, 0]),
                "final_return": float(charged.values[k, -1]),
                "steps_to_threshold": float(times.steps[k]),
                "reached": bool(times.reached[k]),
                "source_steps": int(played.curve.source_steps[k]),
                "source_share": float(np.nanmean(played.source_share[k]))
                if np.isfinite(played.source_share[k]).any()
                else NAN,
                "verdict": "" if contrast is None else contrast.verdict,
                "reason": "" if contrast is None else contrast.reason,
                "threshold": float(found.threshold),
                "total": int(found.total),
            }


@cache
def levels(task: Any) -> tuple[float, float]:
    """Return the random policy's return in a task and the optimum, as checkpoints measure it."""
    target = Target.of(task, EXACT)
    return float(target.random_return), float(target.optimum)


def facts_of(pair: Pair, seeds: int) -> dict[str, Any]:
    """Return what is the same in all rows of a pair."""
    source_random, source_optimum = levels(pair.source)
    random_return, optimum = levels(pair.target)
    learnt = pair.curriculum().train(seeds, only="source", workers=1)["source"]
    return {
        "family": pair.family,
        "split": pair.split,
        "kind": pair.kind,
        "sensible": pair.sensible,
        "target": pair.target_name,
        "random_return": random_return,
        "optimum": optimum,
        "source_return": float(learnt.greedy_return[:, -1].mean()),
        "source_random_return": source_random,
        "source_optimum": source_optimum,
        "source_budget": pair.source_budget,
        "target_budget": pair.target_budget,
    }
