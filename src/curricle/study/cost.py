"""An estimate of the cost of a study, before anything is trained."""

import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

from curricle.curriculum.curriculum import Node
from curricle.planning.policy_evaluation import LARGEST_SOLVED
from curricle.planning.rollouts import random_step_seconds
from curricle.study.arms import Arms, units_of
from curricle.study.config import StudyConfig
from curricle.tasks.live import is_live
from curricle.tasks.mdp import generative_model, has_tables, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.text import counted

STEPS = 200  # random steps that measure the speed of an observation task
NETWORK = 1e-3  # about the seconds in which a small network learns from a step, on one processor
FORWARD = 2e-4  # about the seconds in which a small network chooses an action
DISTILLING = 12.0  # about the seconds in which a network is fitted to exact answers
OUTCOME = 8e-9  # about the seconds of one outcome in one sweep over a task's tables
MOST_SWEEPS = 1000  # after so many sweeps most values no longer change
SLOWER = 3.0  # about the time of a step of learning in a table, in random steps of a model


@dataclass(frozen=True)
class Cost:
    """The estimated cost of one task of one arm, for all seeds."""

    arm: str
    task: str
    seeds: int  # number of seeds that no earlier arm trains with equal results
    steps: int  # most steps of learning, a seed
    evaluation_steps: int  # most steps of greedy evaluation, a seed; 0 if it is exact
    seconds: float  # about the time on one processor, without compilation
    step_seconds: float  # about the time of a step without learning


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
        learning = (1.0 if is_live(node.task) else SLOWER) * acting
        learning = paces[id(node.task)] + NETWORK if node.deep else learning
        learning = paces[id(node.task)] if node.distilled else learning
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
    return random_step_seconds(task)


def _exact_seconds(node: Node) -> float:
    """Return the most seconds that a seed's exact evaluations take; 0 for rollouts."""
    if node.distilled:
        return DISTILLING
    if node.deep or hasattr(node.evaluation.kernel(node.task), "episodes"):
        return 0.0
    if node.evaluation.method == "off" or not has_tables(node.task):
        return 0.0
    checkpoints = node.most_steps // node.eval_freq + 1
    n_actions = generative_model(node.task).actions.size  # of which the greedy action is read
    return checkpoints * sweeping_seconds(node.task, node.evaluation.horizon(node.task)) / n_actions


def sweeping_seconds(task: Any, sweeps: float) -> float:
    """Return about the seconds of `sweeps` sweeps over a task's tables."""
    # Large tables are not built for the estimate: it then assumes one outcome for each pair.
    model = generative_model(task)
    pairs = model.states.size * model.actions.size
    outcomes = pairs if pairs > LARGEST_SOLVED else tables(task).probability.size
    return float(outcomes * min(sweeps, MOST_SWEEPS) * OUTCOME)


def total_words(target: str, budget: int, total: int, eval_freq: int, *, sources: bool) -> str:
    """Return a sentence on the steps of every arm, and why they exceed the target's budget."""
    spent = f"every arm spends {counted(total, 'step')}"
    why = f"{total - budget:,} for sources, in" if sources else "rounded up to"
    return f"{spent}: {budget:,} of {target}, {why} whole checkpoints of {eval_freq:,}"
