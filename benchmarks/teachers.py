"""Which task next: steps to the threshold by each teacher, against learning the target alone.

Every step in every task is counted. The learning rate is the one with which learning the target
alone is fastest on other seeds, the same for all arms: teachers get no tuning. "optimistic" is
learning the target alone from the largest value that there can be. The threshold is 90 % of the
way from the random policy's return to the optimum, reached by the mean of five checkpoints; seeds
that do not reach it count with the budget. "saved" is the mean over seeds of the steps that a
teacher saves, as a share of the mean without one, with its 95 % interval.

    python -m benchmarks.teachers [--seeds 20] [--only maze]
"""

import argparse

import numpy as np

import curricle as cr
from benchmarks.pairs.pair import levels
from curricle.learning import value_bounds
from curricle.paper.mazes import maze
from curricle.statistics import paired_difference, time_to_threshold
from curricle.statistics.curves import Curve
from curricle.tasks import DeepSea, FourRooms, GoalDistance, KeyLockPit, goal_distance, with_start

TEACHERS = [
    cr.teaching.Uniform(),
    cr.teaching.Learnability(),
    cr.teaching.PrioritizedLevelReplay(),
    cr.teaching.ReverseCurriculum(),
]
RATES, TUNING_SEEDS = (0.1, 0.2, 0.5, 0.9), range(1000, 1010)
WINDOW, CHECKPOINTS, WAY = 5, 500, 0.9


def rings(target, width):
    """Return the target's starts in rings around the goal, from the inside, and the target."""
    farthest = goal_distance(target)[target.mdp.start_states].max()
    firsts = range(1, farthest, width)
    near = {f"{d}..": with_start(target, GoalDistance(d, d + width - 1)) for d in firsts}
    return {**near, "target": target}


def task_sets():
    """Return the tasks, the target last, and the budget in steps, by name."""
    slips = {f"slip {slip:.2f}": FourRooms(slip=slip) for slip in (0.0, 1 / 6)}
    return {
        "maze": (rings(maze(-5.0), 3), 30_000),
        "four rooms": (rings(FourRooms(), 4), 300_000),
        "key, lock, pit": (rings(KeyLockPit.room(8), 3), 60_000),
        "deep sea": (rings(DeepSea(12, time_limit=12), 1), 150_000),
        "slips": ({**slips, "target": FourRooms()}, 300_000),
    }


def main():
    """Print a table for each set of tasks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only")
    given = parser.parse_args()
    for name, (tasks, budget) in task_sets().items():
        if given.only in (None, name):
            print_table(name, tasks, budget, given.seeds)


def print_table(name, tasks, budget, seeds):
    """Print the steps to the threshold of each arm."""
    target, freq = tasks["target"], budget // CHECKPOINTS
    random, optimum = levels(target)
    level = random + WAY * (optimum - random)

    def times(result):
        return time_to_threshold(Curve.of(result), level, window=WINDOW)

    def scratch(learner, chosen):
        return times(cr.learn(target, learner, budget, seeds=chosen, eval_freq=freq, workers=1))

    rate = min(
        RATES, key=lambda a: scratch(cr.QLearning(learning_rate=a), TUNING_SEEDS).steps.mean()
    )
    learner = cr.QLearning(learning_rate=rate)
    optimist = cr.QLearning(learning_rate=rate, initial_value=value_bounds(target)[1])
    alone = scratch(learner, range(seeds))
    print(f"\n{name}: {len(tasks)} tasks, learning rate {rate}, {seeds} seeds, {budget:,} steps")
    print(f"{'arm':<24}{'median':>9}{'mean':>9}{'reached':>9}{'saved':>24}")
    print_row("target alone", alone, alone)
    print_row("target alone, optimistic", scratch(optimist, range(seeds)), alone)
    for teacher in TEACHERS:
        found = cr.teaching.teach(
            tasks, teacher, learner, budget, target="target", seeds=seeds, eval_freq=freq, workers=1
        )
        print_row(type(teacher).__name__, times(found.learning), alone)


def print_row(arm, found, alone):
    """Print one arm."""
    saved = paired_difference(alone.steps, found.steps)
    mean = alone.steps.mean()
    share = f"{saved.estimate / mean:.0%} [{saved.low / mean:.0%}, {saved.high / mean:.0%}]"
    share = "" if found is alone else share
    print(
        f"{arm:<24}{np.median(found.steps):>9,.0f}{found.steps.mean():>9,.0f}"
        f"{f'{found.reached.sum()}/{len(found.reached)}':>9}{share:>24}",
        flush=True,
    )


if __name__ == "__main__":
    main()
