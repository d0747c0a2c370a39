"""What a study will cost, before anything is trained."""

import time
from dataclasses import dataclass

from curricle.learning.wandering import wander
from curricle.node import Node
from curricle.study.runner.arms import Arms
from curricle.study.runner.unit import units_of
from curricle.tasks.task import Task

WALKS, LENGTH = 100, 200
"""Random walks that a task's speed is taken from."""
SLOWER = 3.0
"""Time of a learning step in times of a random one, about."""


@dataclass(frozen=True)
class Cost:
    """What one task of one arm costs for all seeds.

    Attributes
    ----------
    arm, node : str
    seeds : int
        Still to be trained, and not shared with an arm before.
    steps : int
        Of learning, at most, a seed.
    judged : int
        Steps of greedy evaluation, at most, a seed; 0 where it is exact.
    seconds : float
        On one processor, about, compilation aside.
    table_bytes : int
        Of the values kept, all seeds.
    """

    arm: str
    node: str
    seeds: int
    steps: int
    judged: int
    seconds: float
    table_bytes: int


def costs(arms: Arms, seeds: tuple[int, ...], block: int) -> list[Cost]:
    """Return the cost of each task of each arm, those shared by arms once.

    The speed of a task is taken from random walks in it.
    """
    paces: dict[int, float] = {}
    found: dict[tuple[str, str], list[int]] = {}
    for unit in units_of(arms, seeds, block, {}):
        found.setdefault((unit.arm, unit.node), []).extend(unit.seeds)
    each = []
    for (arm, name), members in found.items():
        node = arms.curricula[arm].node(name)
        if id(node.task) not in paces:
            paces[id(node.task)] = pace(node.task)
        steps, judged = node.most_steps, _judged(node)
        seconds = len(members) * (SLOWER * steps + judged) * paces[id(node.task)]
        each.append(Cost(arm, name, len(members), steps, judged, seconds, _bytes(node, members)))
    return each


def pace(task: Task) -> float:
    """Return the seconds that a random step of a task takes."""
    wander(task, walks=1, length=1)  # compiles
    started = time.perf_counter()
    taken = wander(task, walks=WALKS, length=LENGTH)
    return (time.perf_counter() - started) / max(1, int(taken.length.sum()))


def _judged(node: Node) -> int:
    """Return a bound of the steps that a seed's greedy evaluations take."""
    settings = node.evaluation.settings(node.task)
    checkpoints = node.most_steps // node.every + 1
    episodes = getattr(settings, "episodes", 0)
    return int(checkpoints * episodes * min(node.evaluation.horizon(node.task), node.most_steps))


def _bytes(node: Node, seeds: list[int]) -> int:
    n_states, n_actions = node.task.states.size, node.task.actions.size
    return len(seeds) * node.storage.dense_bytes(n_states, n_actions, 1) * node.storage.keep
