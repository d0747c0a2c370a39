"""The tasks of a teacher: checked to share one space, with their tables, starts and goals."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from curricle.array_types import BoolArray, FloatArray, FloatTable
from curricle.errors import SettingError, TaskError
from curricle.planning.greedy import Values
from curricle.planning.policy_evaluation import ExactEvaluation, GreedyEvaluation
from curricle.planning.solution import solve
from curricle.tasks.draws import uniform
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.overloads import compiled
from curricle.tasks.start_states import Goal, goal_states
from curricle.tasks.task import tables
from curricle.teaching.taught_model import SharedTables, start_return


class TaskSet:
    """M tasks of one space, of which `target` is one.

    Raises
    ------
    SettingError
        Unless the tasks are a mapping from names, at least one, that contains the target; when
        they do not share states, actions, discount and a time limit.
    TaskError
        When one has no tables, or a goal is needed and there is none.
    """

    def __init__(self, tasks: Any, target: str, goal: Goal = None, *, needs_goal: bool = False):
        _check_names(tasks, target)
        self.names = tuple(tasks)
        self.place = self.names.index(target)
        for name, task in tasks.items():
            if is_observation_task(task):
                raise TaskError(
                    f"a task seen through observations has no tables: got {task!r} as {name!r}"
                )
        self.mdps = tuple(tables(task) for task in tasks.values())
        self.target = self.mdps[self.place]
        for name, mdp in zip(self.names, self.mdps, strict=True):
            _check_shared(name, mdp, target, self.target)
        if self.target.time_limit is None:
            raise SettingError(f"tasks of a teacher need a time limit: {target!r} has none")
        self.limit = self.target.time_limit
        self.goals = self._goals(goal, needs_goal)
        self.shared = SharedTables.of(self.mdps, self.place)

    def _goals(self, goal: Goal, needed: bool) -> BoolArray:
        """Return the states of each task that are its goal, (M, S); none where there is no goal."""
        found = np.zeros((len(self.mdps), self.target.states.size), np.bool_)
        for i, mdp in enumerate(self.mdps):
            try:
                found[i] = goal_states(mdp, goal)
            except TaskError as error:
                if needed or goal is not None:
                    raise TaskError(f"{error} (task {self.names[i]!r})") from error
        return found

    def start_state(self, task: int, bits: int) -> int:
        """Return the state in which an episode of a task starts, drawn as compiled loops do."""
        mdp = self.mdps[task]
        place = np.searchsorted(mdp.start_cumulative, uniform(bits), side="right")
        return int(mdp.start_states[place])

    @cached_property
    def optimal_returns(self) -> FloatArray:
        """V* at the start of each task, (M,)."""
        return np.array([solve(mdp).start_value for mdp in self.mdps])

    @cached_property
    def _evaluations(self) -> list[ExactEvaluation]:
        evaluation = GreedyEvaluation(method="exact")
        kernels = [evaluation.kernel(mdp) for mdp in self.mdps]
        return [one for one in kernels if isinstance(one, ExactEvaluation)]

    def greedy_returns(self, q: FloatTable) -> FloatArray:
        """Return V^pi at the start of each task, (M,), of the policy greedy on the mean of tables.

        `q` are the learner's tables, (n, S, A). Seeds may ask at once: each call has its own work
        space.
        """
        view, evaluate = Values(q.mean(axis=0)), compiled(start_return, False)
        each = (evaluation.for_run(0) for evaluation in self._evaluations)
        return np.array([evaluate(one, one.tables, view) for one in each])


def _check_names(tasks: Any, target: Any) -> None:
    """Raise SettingError unless tasks are a mapping from names, at least one, with the target."""
    if not isinstance(tasks, Mapping) or not tasks:
        raise SettingError(f"tasks must be a dict from names to tasks, not empty: got {tasks!r}")
    for name in tasks:
        if not isinstance(name, str):
            raise SettingError(f"the name of a task must be text: got {name!r}")
    if target not in tasks:
        raise SettingError(f"target must be one of {', '.join(tasks)}: got {target!r}")


def _check_shared(name: str, mdp: FiniteMDP, target: str, other: FiniteMDP) -> None:
    """Raise SettingError unless a task shares with the target what one table needs."""
    for what in ("states", "actions"):
        own, wanted = getattr(mdp, what), getattr(other, what)
        if own != wanted:
            raise SettingError(
                f"tasks of a teacher must share their {what}, with equal components: {name!r} has "
                f"{own!r} and {target!r} has {wanted!r}"
            )
    for what in ("discount", "time_limit"):
        own, wanted = getattr(mdp, what), getattr(other, what)
        if own != wanted:
            raise SettingError(
                f"tasks of a teacher must share their {what}: {name!r} has {own} and {target!r} "
                f"has {wanted}"
            )
