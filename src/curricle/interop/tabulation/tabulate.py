"""Any Gymnasium environment as tables, by visiting every state that can be reached."""

from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
from rich.console import Console

from curricle.checks import number, whole_number
from curricle.errors import SettingError, TaskError
from curricle.interop.gymnasium import (
    Environment,
    TimeLimit,
    actions_of,
    maker_of,
    refusals_of_make,
)
from curricle.interop.tabulation.assembling import Tables, assembled
from curricle.interop.tabulation.explorables import Listed, ListedOutcomes, StepOutcomes
from curricle.interop.tabulation.exploration import Budget, Explored, Progress, explore
from curricle.interop.tabulation.playing import Checker
from curricle.interop.tabulation.state_access import (
    DeepCopy,
    SaveAndRestore,
    StateAccess,
    Words,
    copied,
)
from curricle.interop.tabulation.tabulated_task import TabulatedTask, TabulationRecord
from curricle.interop.tabulation.world import World, time_limit_of
from curricle.interop.toy_text import has_table, names_of
from curricle.learning.seeds import seed_tuple
from curricle.tasks.labels import values_of

MOST_STATES = 1_000_000
"""States of a table by default, at most."""
MOST_SECONDS = 3600.0
"""Seconds that a tabulation takes by default, at most."""
MOST_SAMPLES = 1_000_000
"""Steps by which the outcomes of a pair are estimated, at most."""


def tabulate(
    environment: Environment,
    *,
    discount: float,
    seeds: Any = 1,
    time_limit: TimeLimit = "own",
    state: Any = None,
    outcomes: Listed | None = None,
    samples: int | None = None,
    max_states: int = MOST_STATES,
    max_seconds: float = MOST_SECONDS,
    progress: bool | Callable[[Progress], Any] = False,
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
        As in :func:`from_gymnasium`. An environment is copied, and not itself stepped.
    discount : float
    seeds : int or sequence of int
        Of the resets that starts are taken from, each as likely; K stands for 0 .. K-1.
    time_limit : int, None or "own"
        Steps after which episodes are truncated; by default the least of the environment's own.
        Time is no part of a state, unless the environment counts it itself.
    state : DeepCopy or (save, restore), optional
        How states are saved and restored. By default :class:`DeepCopy`, which fits everywhere. Two
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
    progress : bool or callable
        Whether to show how far it is, or a function that is called with a :class:`Progress`.
    **make_arguments
        Arguments of ``gymnasium.make`` or the callable.

    Returns
    -------
    TabulatedTask
        States have a component for each number or word that differs between them, among the
        environment's attributes or in what `save` returns.

    Raises
    ------
    TaskError
        When the environment cannot be copied or its states not be told apart, steps are random,
        a budget does not suffice, or an episode in the environment is not in the tables.
    SettingError
        When a setting makes no sense.

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
        state=_checked_state(state),
        outcomes=outcomes,
        samples=samples,
        budget=Budget(
            whole_number("max_states", max_states, 1, SettingError),
            number("max_seconds", max_seconds, SettingError, low=0),
        ),
        progress=progress,
    )
    plan.check()
    discount = number("discount", discount, TaskError, low=0, high=1)
    make = maker_of(environment, time_limit, make_arguments)
    with _opened(environment, make, plan) as env:
        name = str(make) if make.what is not None else type(env.unwrapped).__name__
        act, actions = actions_of(env.action_space, None, names_of(env.unwrapped)[1])
        limit: Any = time_limit_of(env) if time_limit == "own" else time_limit
        tables, record = plan.carried_out(env, act, actions.size, name)
    return TabulatedTask(tables.mdp(actions, discount, limit), tables.observations, record)


@dataclass(frozen=True)
class Plan:
    """How an environment is tabulated."""

    seeds: tuple[int, ...]
    state: Any
    outcomes: Listed | None
    samples: int | None
    budget: Budget
    progress: bool | Callable[[Progress], Any]

    def check(self) -> None:
        """Raise SettingError if settings are invalid or contradict each other."""
        if self.outcomes is not None and not callable(self.outcomes):
            raise SettingError(f"outcomes must be a function: got {self.outcomes!r}")
        if self.samples is not None:
            samples = whole_number("samples", self.samples, 1, SettingError)
            number("samples", samples, SettingError, high=MOST_SAMPLES)
            if self.outcomes is not None:
                raise SettingError("outcomes are listed or estimated: got outcomes and samples")

    def carried_out(
        self, env: Any, act: Callable[[int], Any], n_actions: int, name: str
    ) -> tuple[Tables, TabulationRecord]:
        """Return an environment's tables, and how they came about."""
        access = self._access()
        world = World(env, act, access, name)
        source = self._source(world, n_actions)
        found = self._explored(source)
        by_steps = isinstance(source, StepOutcomes)
        sampled = self.samples is not None
        tables = assembled(found, n_actions, sampled=sampled, merge=access.copies and by_steps)
        access.end()
        checked = 0 if sampled else Checker(world, tables, n_actions).check(self.seeds)
        record = TabulationRecord(
            environment=name,
            seeds=self.seeds,
            samples=self.samples,
            transitions=source.transitions,
            drawing=world.drawing,
            checked=checked,
            cut=found.cut,
            explored=len(found.terminal),
            seconds=found.seconds,
        )
        return tables, record

    def _access(self) -> StateAccess:
        if isinstance(self.state, tuple):
            return SaveAndRestore(*self.state)
        access: StateAccess = (self.state or DeepCopy()).open()
        return access

    def _source(self, world: World, n_actions: int) -> StepOutcomes | ListedOutcomes:
        """Return what is explored: listed outcomes where there are any, else steps."""
        env, base = world.env, world.env.unwrapped
        if self.outcomes is not None:
            save = self.state[0] if isinstance(self.state, tuple) else None
            return ListedOutcomes(env, self.outcomes, n_actions, self.seeds, world.name, save)
        if self.state is None and self.samples is None and has_table(env):
            table: Any = base
            return ListedOutcomes(
                env,
                lambda s, a: table.P[s][a],
                n_actions,
                self.seeds,
                world.name,
                words=words_of(base),
            )
        return StepOutcomes(world, n_actions, self.seeds, self.samples)

    def _explored(self, source: Any) -> Explored:
        """Return all states, and show the progress if asked to."""
        if self.progress is not True:
            show = self.progress if callable(self.progress) else None
            return explore(source, self.budget._replace(show=show))
        with Console(stderr=True).status(f"tabulating {source.name}") as status:
            return explore(
                source,
                self.budget._replace(show=lambda now: status.update(now.in_words(source.name))),
            )


def words_of(world: Any) -> Callable[[Any], Words] | None:
    """Return the function from a state of a known environment to its components, if known."""
    states = names_of(world)[0]
    if states is None:
        return None

    def words(state: Any) -> Words:
        values = values_of(states, int(state)).items()
        return {
            name: value if states.component(name).labels is None
            else states.component(name).label(value)
            for name, value in values
        }  # fmt: skip

    return words


def _checked_state(state: Any) -> Any:
    """Return how states are saved, or raise SettingError."""
    pair = isinstance(state, tuple) and len(state) == 2 and all(map(callable, state))
    if state is None or pair or callable(getattr(state, "open", None)):
        return state
    raise SettingError(
        f"state must be DeepCopy(...) or two functions, (save, restore): got {state!r}"
    )


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
    if not isinstance(env, gym.Env):
        raise TaskError(f"an environment must be a gymnasium.Env: {environment!r} made {env!r}")
    return closing(env)
