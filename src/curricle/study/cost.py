"""An estimate of what a study costs, before anything is trained."""

import time
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from curricle.curriculum.node import Node
from curricle.planning.rollouts import random_rollouts
from curricle.study.arms import Arms
from curricle.study.units import units_of
from curricle.tasks.observation_task import ObservationTask, is_observation_task

ROLLOUTS, LENGTH = 100, 200
"""Random rollouts that a task's speed is measured by."""
STEPS = 200
"""Random steps that the speed of a task seen through observations is measured by."""
NETWORK = 1e-3
"""Seconds that a small network takes to learn from a step on one processor, about."""
FORWARD = 2e-4
"""Seconds that a small network takes to choose an action, about."""
SLOWER = 3.0
"""How many times as long as a random step a step of learning in a table takes, about."""


@dataclass(frozen=True)
class Cost:
    """The estimated cost of one task of one arm, for all seeds.

    Attributes
    ----------
    arm, task : str
    seeds : int
        Still to be trained, and not shared with an earlier arm.
    steps : int
        Of learning, at most, a seed.
    evaluation_steps : int
        Steps of greedy evaluation, at most, a seed; 0 where it is exact.
    seconds : float
        On one processor, about, compilation aside.
    table_bytes : int
        Of the values kept, all seeds; 0 where a network learns.
    """

    arm: str
    task: str
    seeds: int
    steps: int
    evaluation_steps: int
    seconds: float
    table_bytes: int


def costs(arms: Arms, seeds: tuple[int, ...], seeds_per_unit: int) -> list[Cost]:
    """Return the cost of each task of each arm, those shared by arms once.

    The speed of a task is measured by random rollouts; that of networks is a guess.
    """
    paces: dict[int, float] = {}
    found: dict[tuple[str, str], list[int]] = {}
    for unit in units_of(arms, seeds, seeds_per_unit, {}):
        found.setdefault((unit.arm, unit.task), []).extend(unit.seeds)
    each = []
    for (arm, name), members in found.items():
        node = arms.curricula[arm].node(name)
        if id(node.task) not in paces:
            paces[id(node.task)] = pace(node.task)
        steps, evaluation = node.most_steps, _evaluation_steps(node)
        learning, acting = _of_a_step(node, paces[id(node.task)])
        seconds = len(members) * (learning * steps + acting * evaluation)
        each.append(
            Cost(arm, name, len(members), steps, evaluation, seconds, _bytes(node, members))
        )
    return each


def _of_a_step(node: Node, pace: float) -> tuple[float, float]:
    """Return the seconds that a step of learning takes, and one of greedy evaluation."""
    return (pace + NETWORK, pace + FORWARD) if node.deep else (SLOWER * pace, pace)


def pace(task: Any) -> float:
    """Return the seconds that a random step of a task takes."""
    if is_observation_task(task):
        return _observed_pace(task)
    random_rollouts(task, episodes=1, length=1)  # compiles
    started = time.perf_counter()
    taken = random_rollouts(task, episodes=ROLLOUTS, length=LENGTH)
    return (time.perf_counter() - started) / max(1, int(taken.length.sum()))


def _observed_pace(task: ObservationTask) -> float:
    environment = task.environment()
    environment.action_space.seed(0)
    environment.reset(seed=0)
    _random_steps(environment, 1)  # compiles
    started = time.perf_counter()
    _random_steps(environment, STEPS)
    taken = (time.perf_counter() - started) / STEPS
    environment.close()
    return taken


def _random_steps(environment: gym.Env[Any, Any], steps: int) -> None:
    """Take random steps in an environment that was reset."""
    for _ in range(steps):
        *_, terminated, truncated, _ = environment.step(environment.action_space.sample())
        if terminated or truncated:
            environment.reset()


def _evaluation_steps(node: Node) -> int:
    """Return a bound on the steps that a seed's greedy evaluations take."""
    checkpoints = node.most_steps // node.eval_freq + 1
    if node.deep:
        off = node.evaluation.method == "off"
        episodes = 0 if off else node.evaluation.rollouts(node.task)
    else:
        episodes = getattr(node.evaluation.kernel(node.task), "episodes", 0)
    horizon = node.evaluation.horizon(node.task)
    return int(checkpoints * episodes * min(horizon, node.most_steps))


def _bytes(node: Node, seeds: list[int]) -> int:
    if node.deep:
        return 0
    n_states, n_actions = node.task.states.size, node.task.actions.size
    return len(seeds) * node.storage.dense_bytes(n_states, n_actions, 1) * node.storage.save_values
