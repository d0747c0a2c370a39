"""The maze experiments shared by several figures: a corner as source, the maze as target."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from curricle import (
    Curriculum,
    Episodes,
    GridWorld,
    QInitialisation,
    Transfer,
    learn,
    same_position,
)
from curricle.curriculum import CurriculumResult
from curricle.learning import LearningResult
from curricle.paper.settings import EPSILON, LEARNER, LEARNING_RATE, SUMMED, stacked
from curricle.statistics import Curve, Times, midpoint, time_to_threshold

SOURCE_BUDGET = Episodes(250)
TARGET_BUDGET = Episodes(800)
EVERY = 100
WINDOW = 10
SETTLED = 2_000
"""Steps before which the lowest value is ignored: an untrained agent that breaks ties at random
falls into pits; with the paper's first-index ties it never did."""

SETTINGS = {
    "learner": f"Q-learning, learning rate {LEARNING_RATE}, epsilon {EPSILON}, Q0 = 0",
    "maze": "10x10, discount 0.99, episodes truncated at 200 steps",
    "budget": "250 source and 800 target episodes",
    "evaluation": "greedy return (sum of rewards), exact, every 100 steps, mean of 10 checkpoints",
    "threshold": "midway between the lowest (after 2,000 steps) and highest value of scratch",
    "shaping": "Q of the target starts as the source's (Wiewiora 2003)",
}


@dataclass(frozen=True)
class Scratch:
    """The target learnt from scratch."""

    maze: GridWorld
    curve: Curve
    threshold: float  # return midway between the lowest and highest of the curve
    times: Times  # steps to the threshold


def scratch(maze: GridWorld, seeds: int, workers: int | None) -> Scratch:
    """Return the maze learnt from scratch, and the threshold that this sets."""
    curve = Curve.of(learnt_alone(maze, TARGET_BUDGET, seeds, workers))
    threshold = midpoint(curve, window=WINDOW, after=SETTLED)
    times = time_to_threshold(curve, threshold, window=WINDOW)
    return Scratch(maze, curve, threshold, times)


def learnt_alone(
    maze: GridWorld, budget: int | Episodes, seeds: int, workers: int | None
) -> LearningResult:
    """Return the training of the maze without sources."""
    how: Any = {"eval_freq": EVERY, "evaluation": SUMMED, "stream": "target"}
    return learn(maze, LEARNER, budget, seeds=seeds, workers=workers, **how)


def corner(maze: GridWorld, size: int, start: Literal["map", "uniform"] = "uniform") -> GridWorld:
    """Return the top-right `size` x `size` cells of the 10x10 maze."""
    return maze.crop(rows=(0, size), columns=(10 - size, 10), start=start)


def plan(maze: GridWorld, source: GridWorld, budget: int | Episodes, name: str) -> Curriculum:
    """Return the curriculum in which the Q of the target starts as that of the source, `name`."""
    return Curriculum(
        tasks={name: source, "target": maze},
        transfers=[Transfer(name, "target", same_position(maze, source))],
        learner=LEARNER,
        shaping=QInitialisation(),
        budget={name: SOURCE_BUDGET, "target": budget},
        eval_freq={name: 100 * EVERY, "target": EVERY},  # the curve of the source is not drawn
        evaluation=SUMMED,
    )


def transferred(
    maze: GridWorld,
    source: GridWorld,
    seeds: int,
    workers: int | None,
    *,
    budget: int | Episodes = TARGET_BUDGET,
) -> tuple[Curve, CurriculumResult]:
    """Return the curve of a target whose Q starts as the source's, and the whole training."""
    result = plan(maze, source, budget, "source").train(seeds, workers=workers)
    return Curve.of(result["target"], result.source_steps("target")), result


def curve_table(arms: dict[str, Curve]) -> dict[str, npt.NDArray[Any]]:
    """Return learning curves as a tidy table: arm, seed, steps, source_steps, greedy_return."""
    return stacked(
        {
            "arm": arm,
            "seed": np.arange(len(curve.values))[:, None],
            "steps": curve.steps,
            "source_steps": np.broadcast_to(curve.source_steps, len(curve.values))[:, None],
            "greedy_return": curve.values,
        }
        for arm, curve in arms.items()
    )
