"""A node of a curriculum: a task with all settings of its training, and their defaults."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from curricle.arrays import BoolArray, IntArray
from curricle.checks import instance, number
from curricle.deep.learner import DeepLearner, check_spaces
from curricle.deep.learning import check_evaluation, learn_deep
from curricle.deep.miniature import Miniatures
from curricle.errors import CurriculumError, SettingError
from curricle.files import Place
from curricle.learning.learners import Learner, QLearning
from curricle.learning.record import WarmUp
from curricle.learning.result import LearningResult
from curricle.learning.run import learn
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import (
    SETTLED,
    Budget,
    Decision,
    Decisions,
    Episodes,
    StoppingRule,
    levels,
    limits,
    longest_run,
    recent_return,
    spacing,
)
from curricle.learning.storage import Storage
from curricle.planning.policy_evaluation import GreedyEvaluation, RolloutEvaluation
from curricle.progress import Progress
from curricle.tasks.mdp import generative_model
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr, counted
from curricle.transfer.aggregate import Aggregate, mean
from curricle.transfer.calibration import AnyPotential, Calibration, fit_calibration
from curricle.transfer.rollouts import target_of
from curricle.transfer.transfer import Calibrate

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
"""Settings that are a value for all tasks or a dict from task to value, and their defaults."""
OF_TARGETS = ("aggregate", "unknown_value", "shaping")  # not of tasks without sources
DEFAULT_STEPS = 100_000  # the budget of a task that no other builds on
SOURCES_SHARE = 0.1
"""Of the target's steps, for all sources without a budget. Fitted on the development families of
benchmarks/pairs: more gains more on average, and loses more than a tenth more often."""
PULL = 0.1
"""Weight of the pull that keeps an actor-critic near a network distilled from miniatures. The
strongest of 0, .1, .3 and 1 that costs less than .03 of the area under the curve on the grid worlds
among the development targets of benchmarks/networks/miniatures.py."""
ACTOR_CRITICS = ("PPO", "A2C")  # algorithms that a pull is known to fit
MOST_SHARED = 10_000_000  # state-action pairs of a portfolio's task: 350 MB of tables a seed


@dataclass(frozen=True, eq=False)
class Node:
    """A task of a curriculum and how it is trained; made by :meth:`Curriculum.node`."""

    name: str  # of the random stream too: a result does not depend on the other tasks
    task: Any
    aggregate: Aggregate
    unknown_value: float
    learner: Any
    budget: Budget
    shaping: Shaping
    eval_freq: int
    evaluation: GreedyEvaluation
    storage: Storage

    __repr__ = brief_repr

    @classmethod
    def of(cls, name: str, task: Any, *, eval_freq: int | None, **settings: Any) -> Self:
        """Return a node, checked; `eval_freq` None means a hundredth of the budget."""
        distilled = isinstance(task, Miniatures)
        eval_freq = 1 if distilled else spacing(eval_freq, settings["budget"])
        learner = DeepLearner if is_observation_task(task) else Learner
        kinds = {"learner": learner, "shaping": Shaping}
        for which, kind in (kinds | {"evaluation": GreedyEvaluation, "storage": Storage}).items():
            instance(f"{which} of {name}", settings[which], kind, SettingError)
        if learner is DeepLearner:
            check_spaces(task, settings["learner"])
            check_evaluation(settings["evaluation"])
        if settings["shaping"].potential is not None:
            raise CurriculumError(
                "the shaping of a curriculum's task must have no potential of its own, because "
                f"sources give it: that of {name} has a potential"
            )
        if not callable(settings["aggregate"]):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): {name} has "
                f"{settings['aggregate']!r}"
            )
        number(f"unknown_value of {name}", settings["unknown_value"], CurriculumError)
        return cls(name, task, eval_freq=eval_freq, **settings)

    @property
    def most_steps(self) -> int:
        """The most steps that training takes."""
        if self.takes_no_steps:
            return 0
        limit = self.task.longest if self.deep else generative_model(self.task).time_limit
        return longest_run(limit, self.budget, self.eval_freq)

    @property
    def most_evaluation_steps(self) -> int:
        """The most steps that a seed's greedy evaluations take; 0 where they take none."""
        if self.evaluation.method == "off" or self.takes_no_steps:
            return 0
        if not (self.deep or isinstance(self.evaluation.kernel(self.task), RolloutEvaluation)):
            return 0
        episodes = (self.most_steps // self.eval_freq + 1) * self.evaluation.rollouts(self.task)
        return episodes * self.evaluation.horizon(self.task)

    @property
    def sizes(self) -> tuple[str, str]:
        """The numbers of states and actions of the task, as text."""
        model = generative_model(self.task)
        return counted(model.states.size, "state"), counted(model.actions.size, "action")

    @property
    def budget_text(self) -> str:
        """The budget as text."""
        return counted(self.budget, "step") if isinstance(self.budget, int) else str(self.budget)

    @property
    def deep(self) -> bool:
        """Whether the task is seen through observations, and learnt by a network."""
        return is_observation_task(self.task)

    @property
    def takes_no_steps(self) -> bool:
        """Whether a network learns the task from exact answers, and not by steps."""
        return isinstance(self.task, Miniatures)

    def check_network(self, *, shaped: bool, tables: Sequence[str] = ()) -> None:
        """Check a network's learner with Stable-Baselines3; ImportError where that is missing."""
        self.learner.algorithm_class()
        from curricle.deep.models import check_learner  # with torch, an extra

        check_learner(self.learner, self.shaping if shaped else None, tables)

    def train(
        self,
        seeds: Sequence[int],
        potentials: Sequence[AnyPotential] = (),
        *,
        warm_ups: Sequence[WarmUp] = (),
        charged: Sequence[int] | IntArray | None = None,
        snapshots: int = 0,
        workers: int | None = None,
        saves: Place | None = None,
        progress: Progress = None,
    ) -> LearningResult:
        """Return the task learnt by K seeds, with K potentials and warm-ups or none."""
        if self.takes_no_steps:
            self.learner.algorithm_class()  # ImportError without Stable-Baselines3
            from curricle.deep.distillation import learn_miniatures

            how: Any = {"eval_freq": self.eval_freq, "progress": progress}
            return learn_miniatures(self.task, self.learner, seeds, potentials, **how)
        common: dict[str, Any] = {
            "shaping": [self.shaping.with_potential(phi) for phi in potentials] or None,
            "seeds": seeds,
            "eval_freq": self.eval_freq,
            "evaluation": self.evaluation,
            "stream": self.name,
            "warm_up": list(warm_ups) or None,
            "charged": charged,
            "progress": progress,
        }
        if self.deep:
            result = learn_deep(self.task, self.learner, self.budget, saves=saves, **common)
            return result if self.storage.save_values else replace(result, values=None)
        common |= {"storage": self.storage, "snapshots": snapshots, "workers": workers}
        return learn(self.task, self.learner, self.budget, **common)

    def unlearnt(self, result: LearningResult) -> BoolArray:
        """Return which seeds' last return is too low to have converged, (K,) bool."""
        if not isinstance(self.budget, StoppingRule) or self.takes_no_steps:
            return np.zeros(len(result.seeds), np.bool_)
        _, floor = levels(self.budget, self.task, self.evaluation, target_of)
        last = (result.steps_used // self.eval_freq).tolist()
        recent = list(map(recent_return, result.greedy_return, last))
        return np.array(recent) <= floor

    def decisions(self, result: LearningResult) -> Decisions:
        """Return the stopping rule's decisions at each seed's checkpoints, if there is a rule."""
        if not isinstance(self.budget, StoppingRule) or self.takes_no_steps:
            return Decisions([[] for _ in result.seeds], result.seeds)
        level, floor = levels(self.budget, self.task, self.evaluation, target_of)
        totals = result.steps_used.tolist(), result.evaluation_steps.tolist()
        of_seeds, judge = list[list[Decision]](), self.budget.decisions
        for greedy, used, spent in zip(result.greedy_return, *totals, strict=True):
            *rest, last = judge(result.steps, greedy, level=level, floor=floor, used=used)
            of_seeds.append([*rest, replace(last, evaluation_steps=spent)])
        return Decisions(of_seeds, result.seeds)


def calibrated(
    node: Node,
    potentials: Sequence[AnyPotential],
    settings: Calibrate,
    seeds: Sequence[int],
    charged: IntArray | None = None,
) -> list[Calibration]:
    """Return the calibrations of a task's potentials within its budget, less (K,) charged steps."""
    steps, episodes = limits(node.budget)
    left = [steps] * len(seeds) if charged is None else (steps - charged).tolist()
    return [
        fit_calibration(
            potential, settings.within(most, episodes), seed=k, stream=f"{node.name}/calibration"
        )
        for potential, k, most in zip(potentials, seeds, left, strict=True)
    ]


def capped(budget: Budget) -> Budget:
    """Return the budget of a source: a number of steps becomes a cap, others do not change."""
    if isinstance(budget, Episodes | StoppingRule):
        return budget
    return StoppingRule(limits(budget)[0], settled=SETTLED)
