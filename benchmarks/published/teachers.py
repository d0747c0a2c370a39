"""Published teachers, played by the protocol of the other claims: tasks, and the audit of teachers.

    python -m benchmarks.published play published-results starts levels      # first
    python -m benchmarks.published.teachers published-results                # goes on after a kill

A study file cannot name a teacher. So the file of a claim has the tasks, learner and opponents, and
its audit has scratch, opponents and their trials. A teacher gets the same total of steps in all its
tasks, and its best of the same trials on the same seeds, those of scratch and those of the
optimistic learner, each of them an arm. Uniform draws from the same tasks are its placebo.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import curricle as cr
from benchmarks.published.__main__ import CLAIMS, TRIALS, markdown, share, way_to_optimum
from benchmarks.published.teaching import (
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Teacher,
    Uniform,
    teach,
)
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import Arm
from curricle.statistics.curves import SCRATCH, Curve
from curricle.study import StudyResults, read_study
from curricle.study.auditing import CONFIGURED, FAIR, as_fair
from curricle.study.tuning import FINALISTS
from curricle.tasks import GoalDistance, goal_distance, with_start

# -- Rutherford et al. 2024: mazes of MiniGrid -----------------------------------------------------

SIDE, WALLS, MAZES, STARTS = 13, 60, 5, 20
DRAW = 2  # the first by which about 16 % of the levels have no way to the goal, as on average
AHEAD = ((0, 1), (1, 0), (0, -1), (-1, 0))  # east, south, west, north


@cache
def drawn_levels() -> tuple[cr.FiniteMDP, tuple[int, ...]]:
    """Return five of their mazes as a task, and the states in which the levels start.

    A maze has 60 walls, drawn with repetition, and a goal in a free cell; a start is a free cell
    and a heading. Goals cannot always be reached, as in theirs.
    """
    rng, outcomes, names, ends, starts = np.random.default_rng(DRAW), [], [], [], []
    number = np.arange(SIDE**2 * 4).reshape(SIDE, SIDE, 4)
    for maze in range(MAZES):
        wall = {*rng.integers(SIDE**2, size=WALLS).tolist()}
        goal, *cells = rng.permutation([cell for cell in range(SIDE**2) if cell not in wall])
        free = rng.choice(cells, STARTS)
        starts += (maze * number.size + free * 4 + rng.integers(4, size=STARTS)).tolist()
        for row, column, heading in np.ndindex(number.shape):
            names.append((maze, row, column, heading))
            ends.append(row * SIDE + column == goal)
            ahead = row + AHEAD[heading][0], column + AHEAD[heading][1]
            inside = min(ahead) >= 0 and max(ahead) < SIDE
            if not inside or ahead[0] * SIDE + ahead[1] in wall:
                ahead = row, column
            entered = ahead[0] * SIDE + ahead[1] == goal and not ends[-1]
            moves = (row, column, (heading - 1) % 4), (row, column, (heading + 1) % 4)
            pays = (0.0, 0.0, float(entered))
            outcomes.append(
                [
                    [(1.0, maze * number.size + int(number[to]), paid)]
                    for to, paid in zip((*moves, (*ahead, heading)), pays, strict=True)
                ]
            )
    sizes = zip(("maze", "row", "column", "heading"), (MAZES, *number.shape), strict=True)
    task = cr.FiniteMDP.from_outcomes(
        outcomes, terminal=ends, start=starts[0], discount=0.99, time_limit=250,
        states=cr.Space([cr.Component(*pair) for pair in sizes], names),
        actions=cr.Space([cr.Component("move", 3, labels=("left", "right", "forward"))]),
    )  # fmt: skip
    return task, tuple(starts)


def levels(*, nearest: int = MAZES * STARTS) -> Any:
    """Return their levels as one task, or the nearest to their goals of those with a way."""
    task, starts = drawn_levels()
    far = goal_distance(task)[[*starts]]
    order = np.argsort(np.where(far < 0, far.max() + 1, far), kind="stable")[:nearest]
    chances = np.bincount(np.array(starts)[order], minlength=len(task.terminal)) / len(order)
    return with_start(task, chances)


# -- teachers and their tasks ----------------------------------------------------------------------

RING = 4  # cells; their random walks of 50 or 100 steps go about as far from the good starts


def rings(target: Any) -> dict[str, Any]:
    """Return a task's starts in rings around the goal, from the inside."""
    farthest = int(goal_distance(target)[target.mdp.start > 0].max())
    return {
        f"from {low}": with_start(target, GoalDistance(low, min(low + RING - 1, farthest)))
        for low in range(1, farthest + 1, RING)
    }


def each_level(target: Any) -> dict[str, Any]:
    """Return a task for each level."""
    return {f"level {s}": with_start(target, [s]) for s in np.flatnonzero(target.mdp.start)}


class Claim(NamedTuple):
    """The teachers of a claim, the published first, and the function that makes their tasks."""

    tasks: Callable[[Any], dict[str, Any]]
    teachers: Mapping[str, Teacher]
    taught: float = 1.0  # share of the steps in which they teach; the others make the tasks


TEACHERS = {
    "starts": Claim(
        rings,
        {
            "reverse curriculum": ReverseCurriculum(r_min=0.1, r_max=0.9),
            "reverse curriculum, no start mastered": ReverseCurriculum(r_max=1.0),
            "uniform over rings": Uniform(),
        },
        taught=0.95,  # random walks from good starts take 10,000 of their 200,000 steps
    ),
    "levels": Claim(
        each_level,
        {
            # a 25th of the levels, and half of the episodes in them, are theirs
            "learnability": Learnability(rho=0.5, top=4, window=10),
            "prioritised level replay": PrioritizedLevelReplay(),
        },
    ),
}


# -- their audit -----------------------------------------------------------------------------------


LEARNERS = {"": SCRATCH, ", OptimisticQLearning": f"{SCRATCH}, OptimisticQLearning"}
"""What is added to a teacher's name -> the arm from scratch whose trials are its learners."""


def arms_of(name: str) -> list[str]:
    """Return the arms of a claim: every teacher with both learners."""
    return [f"{teacher}{learner}" for teacher in TEACHERS[name].teachers for learner in LEARNERS]


def learners(fair: Any, of: str) -> dict[str, cr.learning.Learner]:
    """Return the learners of the trials of an arm from scratch, its own first."""
    trials = [trial for trial, variant in fair.tune.variants.items() if variant.arm == of]
    target = fair.curricula[next(iter(fair.curricula))].target
    plans = {trial: fair.tune.scratches[trial].tasks[target] for trial in trials}
    return {trial: plan.setting("learner", fair.folder) for trial, plan in plans.items()}


def curves(folder: Path, name: str, arm: str, seeds: tuple[int, ...] | None = None) -> None:
    """Train a teacher as configured and with its best trial, and keep its curves in a folder."""
    study, (make, teachers, share_taught) = read_study(CLAIMS[name]), TEACHERS[name]
    teacher = arm.removesuffix(", OptimisticQLearning")
    side, fair = StudyResults(folder / name / CONFIGURED), as_fair(study, TRIALS)
    first = next(iter(study.curricula.values()))
    target, evaluation = first.tasks[first.target], first.setting("evaluation", first.target)
    tasks, charged = make(target), (side.record.total, side.record.eval_freq)
    total, eval_freq = (round(share_taught * steps) for steps in charged)

    def trained(learner: Any, chosen: Any) -> Any:
        return teach(
            tasks, target, teachers[teacher], learner, total,
            seeds=chosen, eval_freq=eval_freq, evaluation=evaluation,
        ).greedy_return  # fmt: skip

    tried = learners(fair, LEARNERS[arm.removeprefix(teacher)])
    of_trial = {n: trained(of, fair.tune.seeds).mean() for n, of in tried.items()}
    own, finalists = next(iter(tried)), sorted(tried, key=lambda n: -of_trial[n])[:FINALISTS]
    finalists = dict.fromkeys([own, *finalists])
    seeds_of_all = (*fair.tune.seeds, *fair.tune.final_seeds)
    best = max(finalists, key=lambda n: float(np.nanmean(trained(tried[n], seeds_of_all))))
    chosen = side.seeds if seeds is None else seeds
    np.savez(
        folder / name / f"{arm}.npz",
        best=[f"{key} {value}" for key, value in fair.tune.variants[best].values.items()],
        **{CONFIGURED: trained(tried[own], chosen), FAIR: trained(tried[best], chosen)},
    )


def compared(folder: Path, name: str, results: StudyResults) -> Comparison:
    """Return the comparison of a side of an audit, with the teachers among its arms."""
    arms = {arm: of for arm, of in results.comparison.arms.items() if not of.control}
    at = results.comparison.scratch.curve.steps
    for teacher in arms_of(name):
        with np.load(folder / name / f"{teacher}.npz") as kept:
            arms[teacher] = Arm(Curve(at, kept[results.store.path.name]))
    return replace(results.comparison, arms=arms)


def rows(folder: Path, name: str) -> Iterator[tuple[str, ...]]:
    """Yield the rows of each teacher: gain over scratch as configured; over the best, fair."""
    for side in (CONFIGURED, FAIR):
        results = StudyResults(folder / name / side)
        made, way = compared(folder, name, results), way_to_optimum(name, results)
        for arm in arms_of(name):
            over, contrast = made.against(SCRATCH)[arm].gain, made.contrasts[arm]
            with np.load(folder / name / f"{arm}.npz") as kept:
                best = ", ".join(kept["best"]) * (side == FAIR)
            gains = share(over, way), share(contrast.strong_gain, way)
            times, mean = made.times(arm), made.mean_return(arm).estimate
            steps = f"{np.median(times.steps):,.0f}, {(~times.reached).sum()} never"
            rival = made.best_opponent(arm)
            yield side, arm, *gains, rival, contrast.answer, steps, f"{mean:.3f}", best


def main() -> None:
    """Train the teachers that have no curves yet, and print a table for each claim."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", default=[*TEACHERS])
    given = parser.parse_args()
    heads = ("", "teacher", "over scratch", "over the best", "the best", "verdict", "steps")
    heads = (*heads, "mean return", "best of the trials")
    for name in given.names:
        for teacher in arms_of(name):
            if not (given.folder / name / f"{teacher}.npz").exists():
                curves(given.folder, name, teacher)
        print(f"\n{name}\n\n{markdown(heads, rows(given.folder, name))}", flush=True)


if __name__ == "__main__":
    main()
