"""DoorKey 8x8 by a recipe that was designed on tables of DoorKey 5x5 and 6x6, and by hand.

The miniatures are rooms of side 5 and 6 that a table of cells learns. Their sources are tables of
errands, of the same room ("n") or of a smaller one ("n - 1", "0.75 n"). As the network has a
learning rate for a residual that is 0.06 times that for rewards alone, so has the table of cells.
A training takes 80,000 steps at most, its source included; its cost are the steps until a return of
16 in three evaluations in a row, or all. Recipes of a race have the same seeds: all have the first
four, and the better half, at least two, goes on to ten. Of those whose mean cost is within one
standard error of the lowest, the best is the one whose seeds differ the least (after Breiman et al.
1984, who take the simplest of these). A recipe whose source takes as many steps as the best mean
cost so far is not trained. What the 8x8 room returns is read nowhere.

1. Steps a state of the source: the best for "n", in each room. A trend over the states of the
   tables of cells says how many they are in other rooms, and another what the recipe costs.
2. The relation: "n - 1" and "0.75 n" name the same room here, 5x5 for 6x6. What reading it costs
   more in 6x6 than in 5x5, with the steps that are best there, is the price of reading a smaller
   room. The predicted cost of a relation in 8x8 is what the trend says of its source's room, and
   this price unless it is "n". The lowest is chosen, with the steps that the trend says.
3. Scale and shaping: the best over 6x6 from 6x6 and 6x6 from 5x5, of what the network can do too;
   of equal ones the first.

    pip install "minigrid>=3,<4"
    python -m benchmarks.door_recipe [--design-only] [--seeds 10] [--workers 1] [--out DIR]
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import curricle as cr
from benchmarks import deep_door
from benchmarks.deep_door import BUDGET, DQN, EVAL_FREQ, EVALUATION, GENTLE, LARGE, THRESHOLD
from benchmarks.door_rooms import ERRANDS, cells, door_room
from benchmarks.evidence import Benchmark, curve_of, folder, trained
from curricle.design import TARGET, Problem, Recipe, Relation, SearchBudget, Stage, Trend

ROOMS = 5, 6
STEPS = 5, 10, 15, 20, 30, 40, 60, 80  # a state of a table of errands, which has 900
SMALLER = "n - 1", "0.75 n"
FIRST, ALL = 4, 10  # seeds
RATE = 0.2  # of the table of cells
EVERY = 2_000  # steps
ROLLOUTS = cr.GreedyEvaluation("rollouts", episodes=10, discounted=False)
HOW = {
    "scale 1": {},
    "scale 0.5": {"scale": 0.5},
    "scale 1.5": {"scale": 1.5},
    "calibrated": {"scale": "calibrated"},
    "state": {"shaping": "state"},
}
"""Look-ahead advice is left out: for a network it is the same as to initialise, a residual."""


def from_errands(term, steps, **how):
    """Return the recipe of a table of errands of a room whose side is such a term."""
    relation = Relation("member", changes={"size": term, "seen": "errands"})
    return Recipe([Stage(relation, steps)], **how)


def network_settings(recipe):
    return GENTLE if recipe.shaping == "initialise" else DQN


def miniature(size, recipe):
    """Return the room of side `size` as a problem for a table that is as slow as the network."""
    rate = RATE * network_settings(recipe)["learning_rate"] / DQN["learning_rate"]
    return Problem(
        door_room(size=size, seen="cells"), steps=BUDGET, threshold=THRESHOLD, miniature=True,
        learner=cr.QLearning(learning_rate=rate, epsilon=0.2), evaluation=ROLLOUTS,
        eval_freq=EVERY,
    )  # fmt: skip


def curriculum(recipe, member, *, learner, **settings):
    """Return a recipe's curriculum, its sources learnt as that by hand, over their own steps."""
    learners = {TARGET: learner}
    for stage, source in recipe.sources(member):
        rate = cr.learning.linear(0.5, 0.05, steps=source_steps(stage))
        learners[source.name] = cr.QLearning(learning_rate=rate, epsilon=0.2)
    return recipe.curriculum(member, learner=learners, **settings)


def sum_of_steps(recipe):
    return sum(map(source_steps, recipe.stages))


def source_steps(stage):
    return stage.budget(ERRANDS.size, ERRANDS.size).max_steps


class Race(NamedTuple):
    """What came out of a race."""

    best: Any
    cost: float  # its mean


def race(title, budget: SearchBudget, entries: Mapping[object, Sequence[tuple[int, Recipe]]]):
    """Return the race of entries, each one or more recipes with the miniature it is for."""
    print(f"\n{title}", flush=True)
    costs, least = {}, float("inf")
    for name, given in entries.items():
        taken = np.mean([sum_of_steps(recipe) for _, recipe in given])
        if taken >= least:
            print(f"  {name}: not trained, its source takes {taken:,.0f} steps", flush=True)
            continue
        costs[name] = costs_of(budget, given, range(FIRST))
        print(f"  {name}: {shown(costs[name])}", flush=True)
        least = min(least, costs[name].mean())
    half = max(2, -(-len(costs) // 2))
    better = sorted(costs, key=lambda name: costs[name].mean())[:half]
    for name in better:
        more = costs_of(budget, entries[name], range(FIRST, ALL))
        costs[name] = np.concatenate([costs[name], more])
        print(f"  {name}: {shown(costs[name])}", flush=True)
    lowest = min((costs[name] for name in better), key=np.mean)
    near = [name for name in better if costs[name].mean() <= lowest.mean() + error(lowest)]
    best = min(near, key=lambda name: error(costs[name]))
    print(f"  best: {best}", flush=True)
    return Race(best, float(costs[best].mean()))


def costs_of(budget, given, seeds):
    """Return the mean cost of the recipes over their miniatures, for each seed, (K,)."""
    found = []
    for size, recipe in given:
        problem = miniature(size, recipe)
        plan = curriculum(recipe, problem.target, **problem.settings)
        found.append(budget.train(problem, plan, seeds).steps)
    return np.mean(found, axis=0)


def error(costs):
    """Return the standard error of a mean cost."""
    return costs.std(ddof=1) / len(costs) ** 0.5


def shown(costs):
    return f"{costs.mean():,.0f} +- {error(costs):,.0f}, {len(costs)} seeds"


def designed(budget: SearchBudget) -> Recipe:
    """Return the recipe for the large room that is the best by the rule above."""
    small, large = ROOMS
    own = {size: steps_race(budget, size) for size in ROOMS}
    steps = trend({size: own[size].best for size in ROOMS})
    cost = trend({size: own[size].cost for size in ROOMS})
    read = {own[small].best: [(large, from_errands(SMALLER[0], own[small].best))]}
    price = race("6x6 from 5x5", budget, read).cost - own[small].cost
    print(f"\nsteps a state: {steps} cells; cost: {cost} cells")
    print(f"price of reading a smaller room: {price:,.0f} steps")
    term = relation(cost, price)
    room = side(term, LARGE)
    chosen = steps.at(cells(room).size)
    seen = [(large, "n", own[large].best), (large, SMALLER[0], own[small].best)]
    entries = {
        name: [(size, from_errands(known, k, **how)) for size, known, k in seen]
        for name, how in HOW.items()
    }
    best = race("scale and shaping, over 6x6 from 6x6 and from 5x5", budget, entries).best
    return from_errands(term, chosen, **HOW[best])


def steps_race(budget, size) -> Race:
    """Return the race of steps a state for a source of the same room."""
    entries = {k: [(size, from_errands("n", k))] for k in STEPS}
    return race(f"{size}x{size} from {size}x{size}: steps a state", budget, entries)


def trend(numbers: Mapping[int, float]) -> Trend:
    """Return the trend through a number of each of two rooms, over the states of their cells."""
    (few, low), (many, high) = ((cells(size).size, one) for size, one in numbers.items())
    return Trend(low, float(np.log(high / low) / np.log(many / few)), few)


def relation(cost: Trend, price: float) -> str:
    """Return the term of the source's room whose predicted cost in the large room is the lowest."""
    predicted = {}
    for term in ("n", *SMALLER):
        room = side(term, LARGE)
        predicted[term] = cost.at(cells(room).size) + (0 if term == "n" else price)
        print(f"  {term}: {room}x{room}, predicted cost in 8x8 {predicted[term]:,.0f}")
    return min(predicted, key=predicted.get)


def side(term, size):
    """Return the side of the source's room."""
    ((_, source),) = from_errands(term, 1).sources(door_room(size=size))
    return source.member["size"]


def by_recipe(recipe: Recipe) -> cr.Curriculum:
    """Return the curriculum of the large room, which a network learns."""
    learner, spent = deep_door.learner(network_settings(recipe)), sum_of_steps(recipe)
    return curriculum(
        recipe, door_room(size=LARGE), learner=learner, budget=BUDGET - spent,
        eval_freq=EVAL_FREQ, evaluation={TARGET: EVALUATION},
    )  # fmt: skip


def main():
    given = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    given.add_argument("--design-only", action="store_true")
    given.add_argument("--seeds", type=int, default=10)
    given.add_argument("--workers", type=int, default=1)
    given.add_argument("--out", type=Path, default=folder("door_recipe"))
    options = given.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    budget = SearchBudget(float("inf"), journal=options.out / "trainings.jsonl")
    recipe = designed(budget)
    print(f"\n{recipe}\n\n{budget.ledger}", flush=True)
    if not options.design_only:
        compare(recipe, budget.ledger, options)


def compare(recipe, ledger, options):
    """Train the recipe and the hand-made curriculum with the same seeds, and print both.

    The search has paid after so many trainings of the 8x8 room, by what the recipe saves of the
    median steps by hand.
    """
    by_hand = "residual on the table"
    arms = {by_hand: deep_door.BENCHMARK.arms[by_hand], "recipe": partial(by_recipe, recipe)}
    jobs = [(arm, seed) for seed in range(options.seeds) for arm in arms]
    with cr.study.WorkerProcesses(options.workers) as pool:
        running = {
            pool.submit(trained, arms[arm], arm, seed, options.out): (arm, seed)
            for arm, seed in jobs
        }
        for done in as_completed(running):
            print("done:", *running[done], f"{done.result()['greedy'][-1]:.1f}", flush=True)
    title = "MiniGrid DoorKey 8x8 (DQN), by hand and by the recipe"
    curves = {arm: curve_of(arm, options.seeds, options.out) for arm in arms}
    Benchmark(title, arms, THRESHOLD).tell(curves)
    times = (
        cr.statistics.time_to_threshold(one, THRESHOLD, strong=True) for one in curves.values()
    )
    hand, found = (one.median().estimate for one in times)
    if np.isfinite([hand, found]).all():
        print(f"\n{ledger.break_even(float(hand - found))}")


if __name__ == "__main__":
    sys.exit(main())
