"""Estimates of the time that a plan takes, before anything is trained."""

import time
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from curricle.comparison.plan import Plan, Unit
from curricle.curriculum.curriculum import Curriculum, Node
from curricle.errors import SettingError
from curricle.planning.policy_evaluation import ExactEvaluation
from curricle.planning.rollouts import random_step_seconds
from curricle.planning.target import LARGEST_SOLVED, ROLLOUTS
from curricle.tasks.live import is_live
from curricle.tasks.mdp import Task, generative_model, has_tables, tables
from curricle.tasks.observation_task import ObservationTask, check_observation, is_observation_task
from curricle.text import duration
from curricle.transfer.rollouts import OBSERVATION_ROLLOUTS

STEPS = 200  # random steps that measure the speed of an observation task
NETWORK = 1e-3  # about the seconds in which a small network learns from a step, on one processor
FORWARD = 2e-4  # about the seconds in which a small network chooses an action
DISTILLING = 12.0  # about the seconds in which a network is fitted to exact answers
OUTCOME = 8e-9  # about the seconds of one outcome in one sweep over a task's tables
MOST_SWEEPS = 1000  # after so many sweeps most values no longer change
SLOWER = 3.0  # about the time of a step of learning in a table, in random steps of a model


class Pace(NamedTuple):
    """Seconds of a step in which a task is learnt, and of a step of a rollout."""

    learning: float
    acting: float


NOMINAL = Pace(25e-9, 25e-9)
"""About that of any task with a model: whether there is a trial must not depend on the machine."""


@dataclass(frozen=True)
class Cost:
    """The estimated cost of one task of one arm, for all seeds."""

    arm: str
    task: str
    seeds: int  # number of seeds that no earlier arm trains with equal results
    steps: int  # most steps of learning, a seed
    seconds: float  # about the time on one processor, without compilation
    step_seconds: float  # about the time of a step without learning


def costs(plan: Plan, units: Iterable[Unit]) -> list[Cost]:
    """Return the cost of each task that the units of a plan train."""
    paces, numbers = dict[int, float](), Counter[tuple[str, str]]()
    for unit in units:
        numbers[unit.arm, unit.task] += len(unit.seeds)
    rows = []
    for (arm, name), seeds in numbers.items():
        node = plan.curricula[arm].node(name)
        if id(node.task) not in paces:
            paces[id(node.task)] = random_pace(node.task)
        pace = pace_of(node, paces[id(node.task)])
        seconds = seeds * node_seconds(node, pace, node.most_steps)
        rows.append(Cost(arm, name, seeds, node.most_steps, seconds, pace.acting))
    return rows


def live_words(plan: Plan, seeds: Collection[int]) -> str:
    """Return how long steps in live tasks will take, as text; empty without live tasks."""
    tasks = {arm: curriculum.tasks for arm, curriculum in plan.curricula.items()}
    units = [unit for unit in plan.units(seeds, {}) if is_live(tasks[unit.arm][unit.task])]
    seconds = sum(cost.seconds for cost in costs(plan, units))
    sentence = f"steps in live environments will take at most about {duration(seconds)}"
    return sentence if units else ""


def pace_of(node: Node, step: float) -> Pace:
    """Return the pace of a task whose random step takes so many seconds."""
    acting = step + FORWARD * node.deep
    if node.distilled:
        return Pace(step, acting)
    if node.deep:
        return Pace(step + NETWORK, acting)
    # A table's update takes no time beside a step of an environment in Python.
    return Pace(step * (1.0 if is_live(node.task) else SLOWER), acting)


def random_pace(task: Task | ObservationTask) -> float:
    """Return the seconds that a random step of a task takes, by a few random steps."""
    if not isinstance(task, ObservationTask):
        return random_step_seconds(task)
    environment = task.environment()
    environment.action_space.seed(0)
    check_observation(task.observations, environment.reset(seed=0)[0])
    for n in range(STEPS + 1):
        if n == 1:  # the first step compiles
            started = time.perf_counter()
        *_, terminated, truncated, _ = environment.step(environment.action_space.sample())
        if terminated or truncated:
            environment.reset()
    taken = (time.perf_counter() - started) / STEPS
    environment.close()
    return taken


def node_seconds(node: Node, pace: Pace, steps: int) -> float:
    """Return the most seconds in which a seed learns a task for so many steps and is evaluated."""
    seconds, checkpoints = pace.learning * steps, steps // node.eval_freq + 1
    if node.distilled:
        return seconds + DISTILLING
    if node.evaluation.method == "off":
        return seconds
    kernel = None if node.deep else node.evaluation.kernel(node.task)
    if isinstance(kernel, ExactEvaluation):
        # At most all states are evaluated, each with the outcomes of its greedy action.
        outcomes: int = len(kernel.tables.outcome_row) * kernel.tables.probability.shape[1]
        return seconds + checkpoints * outcomes * min(kernel.horizon, MOST_SWEEPS) * OUTCOME
    longest = min(node.evaluation.horizon(node.task), steps)
    rolled_out: int = checkpoints * node.evaluation.rollouts(node.task) * longest
    return seconds + rolled_out * pace.acting


def examining_seconds(curriculum: Curriculum, acting: float) -> float:
    """Return the most seconds in which a forecast examines a seed's sources and a live target."""
    node = curriculum.node(curriculum.target)
    try:
        horizon = node.evaluation.horizon(node.task)
    except SettingError:  # which the forecast will say
        return 0.0
    if node.deep:
        return OBSERVATION_ROLLOUTS * horizon * acting
    sources = [
        curriculum.tasks[name]
        for name in {edge.source for edge in curriculum.in_edges(curriculum.target)}
        if not is_observation_task(curriculum.tasks[name])
    ]
    rolled_out = sum(map(is_live, (node.task, *sources))) * ROLLOUTS * horizon * acting
    return rolled_out + sum(solving_seconds(task) for task in sources if has_tables(task))


def solving_seconds(task: object) -> float:
    """Return about the most seconds in which a task is solved by sweeps over its tables."""
    # Large tables are not built for the estimate: it then assumes one outcome for each pair.
    model = generative_model(task)
    pairs = model.states.size * model.actions.size
    outcomes = pairs if pairs > LARGEST_SOLVED else tables(task).probability.size
    return float(outcomes * min(model.states.size, MOST_SWEEPS) * OUTCOME)
