"""Any Gymnasium environment as tables, by visiting every state that can be reached."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import Any

import gymnasium as gym

from curricle.archives.saved_file import saved_path
from curricle.checks import number, whole_number
from curricle.errors import SettingError, TaskError
from curricle.interop.gymnasium import (
    Environment,
    TimeLimit,
    actions_of,
    checked_environment,
    maker_of,
    refusals_of_make,
)
from curricle.interop.spaces import name_list, with_names
from curricle.interop.tabulation.explorables import Listed
from curricle.interop.tabulation.exploration import Budget, Progress
from curricle.interop.tabulation.minigrid import max_steps_of, named_actions
from curricle.interop.tabulation.plan import Plan
from curricle.interop.tabulation.state_access import copied
from curricle.interop.tabulation.tabulated_task import TabulatedTask
from curricle.interop.tabulation.world import refuse_stacked_frames, time_limit_of
from curricle.interop.toy_text import names_of
from curricle.learning.seeds import seed_tuple
from curricle.tasks.spaces import Space

MOST_STATES = 1_000_000
"""States of a table by default, at most."""
MOST_SECONDS = 3600.0
"""Seconds that a tabulation takes by default, at most."""


def tabulate(
    environment: Environment,
    *,
    discount: float,
    seeds: Any = 1,
    time_limit: TimeLimit = "own",
    names: Sequence[str] | None = None,
    actions: Space | Sequence[str] | None = None,
    state: Any = None,
    outcomes: Listed | None = None,
    samples: int | None = None,
    max_states: int = MOST_STATES,
    max_seconds: float = MOST_SECONDS,
    progress: bool | Callable[[Progress], Any] | None = False,
    cache: str | Path | None = None,
    **make_arguments: Any,
) -> TabulatedTask:
    """Return a Gymnasium environment as tables of every state that can be reached.

    States are visited breadth first from those that resets lead to: each action is taken in each
    state, which is saved and restored. The tables are the environment's own, so what :func:`solve`,
    :func:`certify` and :func:`evaluate` prove of them holds for it.

    Steps must be deterministic, which is checked: each is taken twice, and 8 times if it draws
    random numbers, each time with others. At the end up to 1,000 steps are played in the
    environment and must be in the tables. Where steps are random their outcomes must be listed, or
    estimated if asked for; the table says then that it is estimated.

    Parameters
    ----------
    environment : str, gymnasium.EnvSpec, gymnasium.Env or callable
        As in :func:`from_gymnasium`. An environment is copied, and itself stepped only if it cannot
        be copied and there are functions to restore it.
    discount : float
    seeds : int or sequence of int
        Of the resets that starts are taken from, each as likely; K stands for 0 .. K-1.
    time_limit : int, None or "own"
        Steps after which episodes are truncated; by default the least of the environment's own.
        Time is no part of a state, unless the environment counts it itself.
    names : sequence of str, optional
        Other names for the components of a state, in their order.
    actions : sequence of str or Space, optional
        As in :func:`from_gymnasium`.
    state : DeepCopy, MiniGridState or (save, restore), optional
        How states are saved and restored. By default :class:`DeepCopy`, which fits everywhere, and
        in MiniGrid's environments :class:`MiniGridState`, where the goal's reward is 1. Two
        functions are faster: ``save(env)`` returns the state, hashable and different for different
        states, ``restore(env, state)`` puts the environment, without wrappers, back into it. The
        fields of a named tuple are the names of components.
    outcomes : callable, optional
        ``outcomes(state, action)`` lists (probability, next state, reward, terminated) of each
        outcome of an environment that is random. States are observations, or what `save` returns.
        An environment's own table ``P`` is used unless `state` is given.
    samples : int, optional
        Estimate outcomes from so many steps of each pair.
    max_states, max_seconds : int, float
        What the tabulation may need at most.
    progress : bool or callable, optional
        True shows how far it is; a function is called with a :class:`Progress`.
    cache : str or Path, optional
        A file that the tables are read from, and written to when it is not there. It notes the
        environment's name, classes and content after each reset, the settings above, and the
        versions of packages; a file of others is refused. The code of your environment is not
        compared: name another file when you change it.
    **make_arguments
        Arguments of ``gymnasium.make``, or of the class or function.

    Returns
    -------
    TabulatedTask
        States have a component for each number or word that differs between them, among the
        environment's attributes or in what `save` returns.

    Raises
    ------
    TaskError
        When the environment cannot be copied or its states not be told apart, frames are stacked,
        steps are random, a budget does not suffice, or an episode in the environment is not in the
        tables.
    SettingError
        When a setting makes no sense.
    StoreError
        When the cache holds other tables, is damaged or cannot be written to.

    Examples
    --------
    >>> import curricle as cr
    >>> taxi = tabulate("Taxi-v4", discount=0.9, seeds=3)
    >>> taxi
    TabulatedTask(Taxi-v4: 202 states, 6 actions, 2 terminal, discount 0.9, time limit 200, exact)
    >>> taxi.states.label(0)
    'row=3 column=0 passenger=blue destination=yellow'
    """
    plan = Plan(
        seeds=seed_tuple(seeds),
        state=state,
        outcomes=outcomes,
        samples=samples,
        budget=Budget(
            whole_number("max_states", max_states, 1, SettingError),
            number("max_seconds", max_seconds, SettingError, low=0),
        ),
        progress=progress,
        cache=None if cache is None else saved_path(cache),
    )
    plan.check()
    discount = number("discount", discount, TaskError, low=0, high=1)
    names = None if names is None else name_list(names)
    make = maker_of(environment, time_limit, make_arguments)
    with _opened(environment, make, plan) as env:
        refuse_stacked_frames(env)
        name = str(make) if make.what is not None else type(env.unwrapped).__name__
        named = names_of(env.unwrapped)[1] or named_actions(env)
        act, moves = actions_of(env.action_space, actions, named)
        tables, record = plan.carried_out(env, act, moves.size, name)
        limit: Any = own_time_limit(env) if time_limit == "own" else time_limit
    if names is not None:
        tables = tables._replace(states=with_names(tables.states, names))
    return TabulatedTask(tables.mdp(moves, discount, limit), tables.observations, record)


def own_time_limit(env: Any) -> int | None:
    """Return the steps after which an environment truncates: the least of its limits."""
    limits = [limit for limit in (time_limit_of(env), max_steps_of(env)) if limit is not None]
    return min(limits, default=None)


def _opened(environment: Any, make: Any, plan: Plan) -> AbstractContextManager[Any]:
    """Return a context with an environment that is nobody else's."""
    if isinstance(environment, gym.Env):
        try:
            return nullcontext(copied(environment)[0])
        except TaskError:
            if not isinstance(plan.state, tuple):
                raise
            return nullcontext(environment)
    with refusals_of_make(environment):
        env = make()
    return closing(checked_environment(environment, env))
