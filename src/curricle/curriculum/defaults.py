"""What the tasks of a curriculum are learnt with where nothing is said of it."""

from typing import Any

from curricle.deep.learner import DeepLearner
from curricle.deep.shaping import WeightTransfer
from curricle.learning.guard import Guard
from curricle.learning.learners import Learner, OptimisticQLearning, QLearning
from curricle.learning.shaping import QInitialisation, Shaping
from curricle.learning.stopping import SETTLED, Budget, Episodes, StoppingRule, limits
from curricle.learning.storage import Storage
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.tasks.task import generative_model
from curricle.transfer.aggregation import mean

SETTINGS: dict[str, Any] = {
    "aggregate": mean,
    "unknown_value": 0.0,
    "learner": QLearning(),
    "budget": None,
    "shaping": None,
    "eval_freq": None,
    "evaluation": GreedyEvaluation(),
    "storage": Storage(),
}
"""What may be one value for all tasks or a dict from task to value, and its default."""
OF_TARGETS = ("aggregate", "unknown_value", "shaping")
"""Settings that do not apply to a task without sources."""
DEFAULT_STEPS = 100_000
"""The budget of a task that no other builds on."""
SOURCES_SHARE = 0.1
"""Of the target's steps, for all sources that are given no budget. Fitted on the development
families of benchmarks/pairs: more gains more on average, and loses more than a tenth more often."""

PULL = 0.1
"""Weight of the pull that keeps an actor-critic near a network distilled from miniatures. The
strongest of 0, .1, .3 and 1 that costs less than .03 of the area under the curve on the grid worlds
among the development targets of benchmarks/deep_miniatures.py."""
ACTOR_CRITICS = ("PPO", "A2C")
"""Algorithms that a pull is known to fit."""
MOST_GUARDED = 10_000_000
"""State-action pairs up to which a task is guarded: its tables take some 300 MB a seed."""


def capped(budget: Budget) -> Budget:
    """Return the budget of a source: a number of steps is a cap, the rest is as it is."""
    if isinstance(budget, Episodes | StoppingRule):
        return budget
    return StoppingRule(limits(budget)[0], settled=SETTLED)


def source_budget(target_steps: int, sources: int) -> Budget:
    """Return the budget of each of so many sources of a target, if they are given none."""
    return capped(max(1, int(SOURCES_SHARE * target_steps) // sources))


def default_shaping(
    task: Any,
    learner: Any,
    storage: Storage,
    *,
    distilled: bool = False,
    budget: Budget | None = None,
) -> Shaping:
    """Return how potentials enter learning: as the start of Q, guarded where that is possible.

    An actor-critic whose one source is `distilled` from miniatures starts as that network and is
    kept near it, unless its budget is in episodes, of which no half is known. A guard needs dense
    tables, whatever the machine's memory, and a learner without a bonus.
    """
    if distilled and isinstance(learner, DeepLearner) and learner.algorithm in ACTOR_CRITICS:
        return WeightTransfer(kl=0.0 if isinstance(budget, Episodes) else PULL)
    possible = isinstance(learner, Learner) and not isinstance(learner, OptimisticQLearning)
    if possible and storage.kind != "sparse":
        generative = generative_model(task)
        if generative.states.size * generative.actions.size <= MOST_GUARDED:
            return QInitialisation(guard=Guard())
    return QInitialisation()
