"""Whether recipes that are designed on miniatures pay at full size, on tasks they never saw.

- ``mazes``: designed on random 6x6 and 8x8 mazes, applied to other mazes of 10x10 and 20x20;
- ``pursuit``: designed on hunts of at most 4,096 states, applied to 7x7 with two predators and to
  10x10 with three (10^8 states), beside the curriculum of examples/three_predators.py;
- ``paper``: the paper's maze, by the standing recipe and by a search that ten trainings pay for.

python -m benchmarks.recipes_travel mazes [--budget 10_000_000] [--seeds 8] [--first 40]
python -m benchmarks.recipes_travel pursuit [--budget 50_000_000] [--memory "4.5 GiB"]
python -m benchmarks.recipes_travel paper
"""

import argparse
import time

import numpy as np

import curricle as cr
from curricle.design import (
    Problem,
    Recipe,
    SearchBudget,
    design_curriculum,
    design_recipe,
    first_arms,
    judge,
)
from curricle.paper.settings import maze
from curricle.tasks import goal_distance, maze_family, pursuit_family

LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
STEPS = {6: 20_000, 8: 60_000, 10: 100_000, 20: 600_000}
"""Of a training of a maze at most, by its size."""
WITHIN = 0.975
"""Of the way from random to optimal: within 60 of the optimum."""
FREE = float("inf")
HUNTS = {(2, 2): 8_000, (3, 2): 40_000, (4, 2): 120_000, (2, 3): 30_000}
"""Of a training of a hunt, by its size and predators."""


# -- mazes ---------------------------------------------------------------------------------------


def mazes(size, count, first):
    """Return mazes whose way to the treasure is long and worth going."""
    found = []
    for seed in range(first, first + 100_000):
        member = maze_family(
            size=size, walls=0.0, pits=0.22, fires=0.05, seed=seed, step=-5.0, time_limit=20 * size
        )
        task = member.task
        far = goal_distance(task)[task.mdp.start_states].max()
        if far >= 2 * size and cr.solve(task).start_value > -300:
            found.append(member)
        if len(found) == count:
            return found
    raise RuntimeError("there are too few such mazes")


def maze_problem(member, *, miniature):
    steps = STEPS[member["size"]]
    settings = {"fraction": WITHIN, "eval_freq": steps // 400, "learner": LEARNER}
    return Problem(member, steps=steps, miniature=miniature, **settings)


def run_mazes(args):
    small = [maze_problem(one, miniature=True) for n in (6, 8) for one in mazes(n, 6, 100)]
    held_out = {
        n: [maze_problem(one, miniature=False) for one in mazes(n, 10, 5000)] for n in (10, 20)
    }
    for seed in range(args.first, args.first + args.seeds):
        begin = time.perf_counter()
        found = design_recipe(small, SearchBudget(args.budget, workers=2), standing={}, seed=seed)
        print(f"\n-- design {seed}, {time.perf_counter() - begin:.0f} s\n{found}")
        for size, problems in held_out.items():
            free = SearchBudget(FREE, workers=2)
            judged = judge(problems, found.best, free, others={"half": found.fixed}, seeds=6)
            paid, count = judged.problems_paid()
            print(
                f"{size}x{size}: {judged.cost():.2f} of scratch (half the size "
                f"{judged.cost('half'):.2f}, placebo {judged.cost('placebo'):.2f}), "
                f"saves {judged.saving()}, pays in {paid} of {count}"
            )
            scratch = judged.steps["scratch"].mean()
            print(f"  scratch takes {scratch:,.0f} steps; {found.break_even(scratch)}")


# -- pursuit -------------------------------------------------------------------------------------


def hunt(size, predators):
    return pursuit_family(size=size, predators=predators, discount=0.95)


def run_pursuit(args):
    rollouts = cr.GreedyEvaluation("rollouts", episodes=50)
    small = [
        Problem(
            hunt(*key), steps=steps, fraction=0.98, eval_freq=steps // 50, learner=LEARNER,
            measure="area", evaluation=rollouts, miniature=True,
        )
        for key, steps in HUNTS.items()
    ]  # fmt: skip
    begin = time.perf_counter()
    budget = SearchBudget(args.budget, workers=2, prices={"evaluation": 0})
    # The largest hunt has no tables: its sources are members, and grids of another size would be
    # mapped by a table of all its pairs, 10^10.
    arms = {
        name: one
        for name, one in first_arms(small).items()
        if all(
            stage.relation.kind == "member" and "size" not in dict(stage.relation.changes)
            for stage in one.stages
        )
    }
    found = design_recipe(small, budget, arms=arms)
    print(f"-- design, {time.perf_counter() - begin:.0f} s\n{found}")
    for size, predators, total in ((7, 2, 6_000_000), (10, 3, 18_000_000)):
        compare_hunts(hunt(size, predators), found, total, args)


def compare_hunts(member, found, total, args):
    dense = member["predators"] == 2
    storage = (
        cr.Storage(save_values=False)
        if dense
        else cr.Storage(kind="sparse", dtype="float32", memory_limit=args.memory, save_values=False)
    )
    calibrate = cr.transfer.Calibrate()
    settings = {
        "budget": total, "learner": LEARNER, "eval_freq": total // 20, "storage": storage,
        "evaluation": cr.GreedyEvaluation("rollouts", episodes=200, discounted=False),
    }  # fmt: skip
    print(f"\n{member}, {total:,} steps in all, {args.seeds} seeds")
    plans = {
        "designed": found.best.curriculum(member, **settings),
        "by hand x 1.5": by_hand(member, settings, scale=1.5),
        "by hand, calibrated": by_hand(member, settings, calibrate=calibrate),
        "scratch": Recipe().curriculum(member, **settings),
    }
    for name, plan in plans.items():
        begin = time.perf_counter()
        result = plan.train(args.seeds, charge=True, workers=2)
        last = result["target"].greedy_return[:, -3:].mean(axis=1)
        sources = result.source_steps("target") if len(plan.order) > 1 else np.zeros(1)
        print(
            f"{name:<20} return {cr.statistics.mean_interval(last)}, sources "
            f"{sources.mean():,.0f} steps, {time.perf_counter() - begin:.0f} s"
        )
    if dense:
        result = cr.learn(
            member.task, LEARNER, args.scratch, seeds=1, eval_freq=args.scratch // 20,
            evaluation=settings["evaluation"], storage=storage,
        )  # fmt: skip
        print(f"scratch, {args.scratch:,} steps: {result.greedy_return[0].round(1).tolist()}")


def by_hand(member, settings, **how):
    """Return the curriculum of examples/three_predators.py."""
    size, target = member["size"], member.task
    chase = cr.Pursuit(size, predators=1, discount=0.95)
    steps = {7: 2_000_000, 10: 10_000_000}[size]
    falling = cr.learning.linear(0.5, 0.01, steps=steps * 4 // 5)
    others = {name: {"target": value} for name, value in settings.items()}
    others["budget"]["chase"] = cr.StoppingRule(steps)
    others["learner"]["chase"] = cr.QLearning(learning_rate=falling, epsilon=0.5)
    return cr.Curriculum(
        {"chase": chase, "target": target},
        [
            cr.Transfer("chase", "target", cr.project(target, chase, predator=name), **how)
            for name in target.predator_names
        ],
        aggregate=cr.minimum,
        shaping={"target": cr.LookAheadAdvice()},
        **others,
    )


# -- the paper's maze ----------------------------------------------------------------------------


def run_paper(args):
    target = Problem(maze(-5.0), steps=100_000, fraction=WITHIN, eval_freq=100, learner=LEARNER)
    for trainings in (1, 10):
        found = design_curriculum(target, trainings=trainings)
        search = found.ledger.cost
        judged = judge([target], found.recipe, SearchBudget(FREE, workers=2), seeds=30)
        steps = {name: each.mean() for name, each in judged.steps.items()}
        total = search / trainings + steps["recipe"]
        print(f"\n{trainings} trainings: {found}")
        print(
            f"scratch {steps['scratch']:,.0f}, recipe {steps['recipe']:,.0f}, placebo "
            f"{steps['placebo']:,.0f} steps; search {search:,.0f}; a training with its share of "
            f"the search {total / steps['scratch']:.2f} of scratch; saves {judged.saving()}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("mazes", "pursuit", "paper"))
    parser.add_argument("--budget", type=int, help="of a design, in steps")
    parser.add_argument("--seeds", type=int, default=2, help="designs of mazes; seeds of a hunt")
    parser.add_argument("--first", type=int, default=0, help="seed of the first design of mazes")
    parser.add_argument("--memory", default="4.5 GiB", help="of the tables of two seeds")
    parser.add_argument("--scratch", type=int, default=400_000_000, help="steps on 7x7")
    given = parser.parse_args()
    given.budget = given.budget or {"mazes": 10_000_000, "pursuit": 50_000_000}.get(given.what)
    {"mazes": run_mazes, "pursuit": run_pursuit, "paper": run_paper}[given.what](given)
