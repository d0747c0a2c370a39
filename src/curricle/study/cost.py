"""An estimate of what a study costs, before anything is trained."""

import math
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from curricle.arrays import frozen
from curricle.curriculum.curriculum import Node
from curricle.planning.greedy import Values
from curricle.planning.policy_evaluation import LARGEST_SOLVED
from curricle.planning.rollouts import GreedyPolicy, UniformPolicy, simulate
from curricle.study.arms import Arms, units_of
from curricle.study.config import StudyConfig
from curricle.tasks.live import open_model
from curricle.tasks.mdp import generative_model, has_tables, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.text import counted

ROLLOUTS, LENGTH = 100, 200  # random rollouts that a task's speed is measured by
MOST_PAIRS = 100_000_000  # pairs for which memory is asked, of which rollouts use little
STEPS = 200  # random steps that the speed of a task seen through observations is measured by
NETWORK = 1e-3  # seconds that a small network takes to learn from a step on one processor, about
FORWARD = 2e-4  # seconds that a small network takes to choose an action, about
DISTILLING = 12.0  # seconds in which a network is fitted to exact answers, about
OUTCOME = 8e-9  # seconds of one outcome in one sweep over a task's tables, about
MOST_SWEEPS = 1000  # after so many sweeps most values no longer change
SLOWER = 3.0  # how many times as long as a random step a step of learning in a table takes, about


@dataclass(frozen=True)
class Cost:
    """The estimated cost of one task of one arm, for all seeds."""

    arm: str
    task: str
    seeds: int  # those that no earlier arm trains in the same task
    steps: int  # of learning, at most, a seed
    evaluation_steps: int  # steps of greedy evaluation, at most, a seed; 0 where it is exact
    seconds: float  # on one processor, about, without compilation
    step_seconds: float  # of a step without learning, about


def costs(study: StudyConfig, arms: Arms) -> list[Cost]:
    """Return the cost of each task of each arm; a task that arms share is counted once."""
    paces: dict[int, float] = {}
    numbers = Counter[tuple[str, str]]()
    for unit in units_of(study, arms, {}):
        numbers[unit.arm, unit.task] += len(unit.seeds)
    rows = []
    for (arm, name), seeds in numbers.items():
        node = arms.curricula[arm].node(name)
        if id(node.task) not in paces:
            paces[id(node.task)] = pace(node.task)
        acting = paces[id(node.task)] + FORWARD * node.deep
        learning = paces[id(node.task)] + NETWORK if node.deep else SLOWER * acting
        steps, evaluation = node.most_steps, node.most_evaluation_steps
        seconds = seeds * (learning * steps + acting * evaluation + _exact_seconds(node))
        rows.append(Cost(arm, name, seeds, steps, evaluation, seconds, acting))
    return rows


def pace(task: Any) -> float:
    """Return the seconds that a random step of a task takes."""
    if is_observation_task(task):
        environment = task.environment()
        environment.action_space.seed(0)
        environment.reset(seed=0)
        for n in range(STEPS + 1):
            if n == 1:  # the first step compiles
                started = time.perf_counter()
            *_, terminated, truncated, _ = environment.step(environment.action_space.sample())
            if terminated or truncated:
                environment.reset()
        taken = (time.perf_counter() - started) / STEPS
        environment.close()
        return taken
    generative = generative_model(task)
    shape = generative.states.size, generative.actions.size
    stream = np.zeros(1, np.uint64)
    # Of equal values all actions are greedy. A report's episodes need this loop too.
    policy = (
        GreedyPolicy(Values(frozen(np.zeros(shape))))
        if math.prod(shape) <= MOST_PAIRS
        else UniformPolicy(np.uint64(shape[1]))
    )
    with open_model(generative, 0) as model:
        simulate(model, policy, stream, episodes=1, limit=1)  # compiles
        started = time.perf_counter()
        steps, _ = simulate(model, policy, stream, episodes=ROLLOUTS, limit=LENGTH)
        return (time.perf_counter() - started) / max(1, len(steps.states))


def _exact_seconds(node: Node) -> float:
    """Return the seconds that a seed's exact evaluations take, at most; 0 for rollouts."""
    if node.takes_no_steps:
        return DISTILLING
    if node.deep or hasattr(node.evaluation.kernel(node.task), "episodes"):
        return 0.0
    if node.evaluation.method == "off" or not has_tables(node.task):
        return 0.0
    checkpoints = node.most_steps // node.eval_freq + 1
    return checkpoints * sweeping_seconds(node.task, node.evaluation.horizon(node.task))


def sweeping_seconds(task: Any, sweeps: float) -> float:
    """Return about how many seconds `sweeps` sweeps over a task's tables take."""
    # Large tables are not built for that: it is then the time with one outcome for each pair.
    model = generative_model(task)
    pairs = model.states.size * model.actions.size
    outcomes = pairs if pairs > LARGEST_SOLVED else tables(task).probability.size
    return float(outcomes * min(sweeps, MOST_SWEEPS) * OUTCOME)


def total_words(target: str, budget: int, total: int, eval_freq: int, *, sources: bool) -> str:
    """Return a sentence on the steps of every arm, and why they exceed the target's budget."""
    spent = f"every arm spends {counted(total, 'step')}"
    why = f"{total - budget:,} for sources, in" if sources else "rounded up to"
    return f"{spent}: {budget:,} of {target}, {why} whole checkpoints of {eval_freq:,}"


def duration(seconds: float) -> str:
    """Return a duration as text."""
    if seconds < 120:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:,.0f} min" if seconds < 7200 else f"{seconds / 3600:,.1f} h"
