"""Exact evaluation of a network's policy, by tables of the environment that it learns in."""

from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from typing import Any

from curricle.errors import CurricleError, SettingError
from curricle.interop.tabulation.minigrid import fitting_state, is_minigrid
from curricle.interop.tabulation.tabulate import tabulate
from curricle.interop.tabulation.tabulated_task import TabulatedTask
from curricle.interop.tabulation.world import core_and_views
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.solution import expected_return
from curricle.tasks.observation_task import ObservationTask

MOST_STATES = 100_000
"""A network answers for each state at each checkpoint: beyond this, rollouts are cheaper."""
TABLES_HELD = 4
"""Tables that a process holds."""


def evaluation_table(task: ObservationTask, evaluation: GreedyEvaluation) -> TabulatedTask | None:
    """Return the tables of an exact evaluation, made once per process; None of another.

    Episodes start as in so many resets as the evaluation has episodes, seeds 0, 1, ...

    Raises
    ------
    SettingError
        When the task cannot be tabulated.

    Examples
    --------
    >>> from curricle import observation_task
    >>> lake = observation_task("FrozenLake-v1")
    >>> evaluation_table(lake, GreedyEvaluation("exact", episodes=2)).states.size
    16
    """
    if evaluation.method != "exact":
        return None
    try:
        return _tabulated(task, evaluation.rollouts(task))
    except CurricleError as error:
        raise SettingError(
            f"an exact evaluation needs tables, which {task} has none of; evaluate it by "
            f"GreedyEvaluation('rollouts'): {error}"
        ) from error


@lru_cache(maxsize=TABLES_HELD)
def _tabulated(task: ObservationTask, resets: int) -> TabulatedTask:
    if task.n_actions is None:
        raise SettingError(f"actions must be numbered from 0: got {task.actions}")
    state = None
    with closing(task.environment()) as env:
        if is_minigrid(env):  # by default its tables pay 1 at the goal, whatever the time
            core = core_and_views(env, views_apart=True).core
            state = replace(fitting_state(env, core, seed=0), own_reward=True)
    return tabulate(
        task.environment,
        discount=task.discount,
        seeds=resets,
        state=state,
        max_states=MOST_STATES,
    )


def exact_return(
    table: TabulatedTask, values: Any, evaluation: GreedyEvaluation, task: ObservationTask
) -> float:
    """Return the expected return of a network's policy; `values` are its :class:`NetworkValues`.

    A network without probabilities of actions is greedy, as in rollouts.
    """
    sampled = evaluation.sampled and values.kind == "value_net"
    policy = table.policy(values if sampled else values.policy, deterministic=not sampled)
    discount, horizon = evaluation.discount(task), evaluation.horizon(task)
    return expected_return(table, policy, discount=discount, horizon=horizon)
