"""Published teachers, played by the protocol of the other claims: tasks, and the audit of teachers.

    python -m benchmarks.published play published-results starts levels      # first
    python -m benchmarks.published.teachers published-results                # goes on after a kill

A study file cannot name a teacher. So the file of a claim has the tasks, learner and opponents, and
its audit has scratch, opponents, and the trials of the learning rate and of the level of Q. A
teacher gets the same total of steps in all its tasks, and its best of the same trials on the same
seeds. Uniform draws from the same tasks are its placebo.
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


TEACHERS = {
    "starts": Claim(
        rings,
        {
            "reverse curriculum": ReverseCurriculum(r_min=0.1, r_max=0.9),
            "reverse curriculum, no start mastered": ReverseCurriculum(r_max=1.0),
            "uniform over rings": Uniform(),
        },
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


def settings(study: Any) -> list[dict[str, float]]:
    """Return the settings of the trials of an audit: learning rate and level of Q."""
    variants = as_fair(study, TRIALS).tune.variants.values()
    values = [variant.values for variant in variants if variant.arm == SCRATCH]
    return [{key.rsplit(".", 1)[-1]: value for key, value in of.items()} for of in values]


def curves(folder: Path, name: str, of: str, seeds: tuple[int, ...] | None = None) -> None:
    """Train a teacher as configured and with its best trial, and keep its curves in a folder."""
    study, (make, teachers) = read_study(CLAIMS[name]), TEACHERS[name]
    side = StudyResults(folder / name / CONFIGURED)
    first = next(iter(study.curricula.values()))
    learner, target = first.setting("learner", first.target), first.tasks[first.target]
    total, eval_freq = side.record.total, side.record.eval_freq
    evaluation = first.setting("evaluation", first.target)
    tasks = make(target)

    def trained(changes: Mapping[str, float], chosen: Any) -> Any:
        return teach(
            tasks, target, teachers[of], replace(learner, **changes), total,
            seeds=chosen, eval_freq=eval_freq, evaluation=evaluation,
        ).greedy_return  # fmt: skip

    trials = settings(study)
    tuning = as_fair(study, TRIALS).tune.seeds
    scores = [float(np.nanmean(trained(trial, tuning))) for trial in trials]
    best = trials[int(np.argmax(scores))]
    chosen = side.seeds if seeds is None else seeds
    np.savez(
        folder / name / f"{of}.npz",
        best=[f"{key} {value:.3g}" for key, value in best.items()],
        **{CONFIGURED: trained({}, chosen), FAIR: trained(best, chosen)},
    )


def compared(folder: Path, name: str, results: StudyResults) -> Comparison:
    """Return the comparison of a side of an audit, with the teachers among its arms."""
    arms = {arm: of for arm, of in results.comparison.arms.items() if not of.control}
    at = results.comparison.scratch.curve.steps
    for teacher in TEACHERS[name].teachers:
        with np.load(folder / name / f"{teacher}.npz") as kept:
            arms[teacher] = Arm(Curve(at, kept[results.store.path.name]))
    return replace(results.comparison, arms=arms)


def rows(folder: Path, name: str) -> Iterator[tuple[str, ...]]:
    """Yield the rows of each teacher: gain over scratch as configured; over the best, fair."""
    for side in (CONFIGURED, FAIR):
        results = StudyResults(folder / name / side)
        made, way = compared(folder, name, results), way_to_optimum(name, results)
        for arm in TEACHERS[name].teachers:
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
        for teacher in TEACHERS[name].teachers:
            if not (given.folder / name / f"{teacher}.npz").exists():
                curves(given.folder, name, teacher)
        print(f"\n{name}\n\n{markdown(heads, rows(given.folder, name))}", flush=True)


if __name__ == "__main__":
    main()
