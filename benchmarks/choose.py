"""What `cr.choose` chooses, against the best in hindsight of all that it could have chosen.

For each target: its choice, the time, and on fresh seeds the mean return while learning, sources
charged, on the way from the random policy (0) to the optimum (1), of learning from scratch, of the
choice (the opponent that it names, where it chooses no curriculum), and of the best of all
curricula and opponents; then of the curriculum that it lists first, and of the best curriculum.

    python -m benchmarks.choose [--seeds 10] [--only hunt]
"""

import argparse
from dataclasses import replace
from time import perf_counter

import numpy as np

import curricle as cr
from benchmarks.pairs import pairs
from curricle.comparison.choice import KINDS, MOST, trial_curricula
from curricle.paper.mazes import MAP
from curricle.planning.target import Target
from curricle.tasks import (
    four_rooms_family,
    frozen_lake_family,
    key_lock_pit_family,
    pursuit_family,
    taxi_family,
)

VERIFICATION = ("river-swim", "chain", "deep-sea", "taxi", "frozen-lake", "four-rooms")
ALONE = "scratch, alone"


def targets():
    """Yield a name, a target, its budget and a learning rate: built in, then of the pairs."""
    paper = cr.GridWorld(MAP, rewards=cr.Rewards(step=-5.0), time_limit=200)
    locked = key_lock_pit_family(size=8)
    yield "paper's maze (.1)", paper, 100_000, 0.1
    yield "paper's maze (.5)", paper, 100_000, 0.5
    yield "hunt 4x4", pursuit_family(size=4, predators=2), 50_000, 0.1
    yield "key-lock-pit (.1)", locked, 100_000, 0.1
    yield "key-lock-pit (.5)", locked, 100_000, 0.5
    yield "four rooms 13", four_rooms_family(), 100_000, 0.1
    yield "FrozenLake 8x8", frozen_lake_family(size=8), 100_000, 0.1
    yield "Taxi", taxi_family(), 100_000, 0.1
    seen = set()
    for pair in pairs("verification"):
        if pair.family not in seen and pair.family in VERIFICATION:
            seen.add(pair.family)
            yield f"{pair.family}, {pair.target_name}", pair.target, pair.target_budget, 0.1


def judged(target, budget, rate, seeds):
    """Return the choice, its seconds, shares of scratch, choice and best, and of curricula."""
    learner = cr.QLearning(learning_rate=rate)
    settings = {"budget": budget, "learner": learner}
    begin = perf_counter()
    choice = cr.choose(target, workers=1, **settings)
    seconds = perf_counter() - begin
    curricula, _ = trial_curricula(target, (), KINDS, MOST, settings)
    further = {}
    if not choice.name and choice.alone.startswith("initial_value="):
        value = float(choice.alone.partition("=")[2])
        further = {"alone": replace(learner, initial_value=value)}
    fresh = cr.compare(
        curricula, seeds=seeds, opponents=["bounds", "optimistic"], scratch=further, workers=1
    )
    task = next(iter(curricula.values())).tasks["target"]
    of_task = Target.of(task, cr.GreedyEvaluation())
    best, random = of_task.optimum, of_task.random_return
    share = {name: (r.mean() - random) / (best - random) for name, r in fresh.returns.items()}
    named = {"learning from scratch": "scratch"}.get(choice.alone, f"scratch, {choice.alone}")
    mine = choice.name or (ALONE if further else named)
    top = max(share, key=share.get)
    shares = share["scratch"], share[mine], share[top]
    first = choice.rows[0]["name"]
    return choice, seconds, shares, top, (share[first], max(share[name] for name in curricula))


def main():
    """Print a line for each target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    kept = []
    heads = "seconds", "scratch", "choice", "best", "kept", "first", "best"
    print(f"{'':32}" + "".join(f"{head:>9}" for head in heads) + "  choice; best")
    for name, target, budget, rate in targets():
        if asked.only not in name:
            continue
        choice, seconds, shares, top, listed = judged(target, budget, rate, asked.seeds)
        kept.append(shares[1] / shares[2])
        chosen = choice.name or f"none, {choice.alone}"
        numbers = f"{seconds:9.0f}" + "".join(f"{share:9.3f}" for share in shares)
        numbers += f"{kept[-1]:9.0%}" + "".join(f"{share:9.3f}" for share in listed)
        print(f"{name:32}{numbers}  {chosen}; {top}", flush=True)
    print(f"at least 80 % of the best in {np.mean(np.array(kept) >= 0.8):.0%} of {len(kept)}")


if __name__ == "__main__":
    main()
