"""Any Gymnasium environment as tables, by visiting every state that can be reached."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import FrameStackObservation

from curricle.arrays import IntArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError, TaskError
from curricle.files import saved_path
from curricle.interop.gymnasium import (
    Environment,
    TimeLimit,
    actions_of,
    checked_environment,
    maker_of,
    refusals_of_make,
)
from curricle.interop.spaces import name_list, with_names
from curricle.interop.tabulation.exploration import (
    Explored,
    Listed,
    ListedOutcomes,
    Progress,
    Search,
    World,
    core_and_views,
    time_limit_of,
)
from curricle.interop.tabulation.minigrid import (
    MiniGridAccess,
    MiniGridState,
    fitting_state,
    is_minigrid,
    named_actions,
)
from curricle.interop.tabulation.states import (
    SHARED,
    DeepCopy,
    SaveAndRestore,
    Words,
    copied,
    layers_of,
    shared_draws,
)
from curricle.interop.tabulation.tables import Tables, assembled, made_of, read_tables, write_tables
from curricle.interop.tabulation.tabulated_task import (
    TabulatedTask,
    TabulationRecord,
    parts_of,
    same_observation,
)
from curricle.interop.toy_text import has_table, names_of
from curricle.learning.seeds import seed_tuple
from curricle.progress import check_progress, shown
from curricle.tasks.outcomes import number_of
from curricle.tasks.spaces import Space, values_of

STEPS = 1000
"""Steps that are compared with the tables."""
WALKS = 20
"""Times that an episode goes to a state drawn at random, before it goes on at random."""
CLOSE = 1e-9
"""Relative difference of rewards that is rounding."""


class Checker:
    """Plays episodes and follows them in the tables.

    What saves and restores a state may miss a part of it; then the tables and the environment
    differ sooner or later.
    """

    def __init__(self, world: World, tables: Tables):
        self.env, self.act, self.name = world.env, world.act, world.name
        self.tables, self.n_actions = tables, world.n_actions
        self.rng = np.random.default_rng(0)
        self.steps = 0

    def check(self, seeds: Sequence[int]) -> int:
        """Return how many steps were compared; TaskError where one is not in the tables."""
        for walk in range(WALKS):
            k = walk % len(seeds)
            first = int(self.tables.first[k])
            self._play(seeds[k], first, self._way(first))
            if self.steps >= STEPS:
                break
        return self.steps

    def _play(self, seed: int, first: int, way: Sequence[int]) -> None:
        """Play one episode: along a way, then at random."""
        observed, _ = self.env.reset(seed=seed)
        possible, truncated, taken = {first}, False, 0
        self._compare(possible, observed, f"a reset with seed {seed}")
        most = len(way) + STEPS // WALKS
        while not truncated and taken < most and not self.tables.terminal[list(possible)].any():
            action = way[taken] if taken < len(way) else int(self.rng.integers(self.n_actions))
            observed, reward, ended, truncated, _ = self.env.step(self.act(action))
            taken += 1
            self.steps += 1
            possible = {
                after
                for state in possible
                for after in self._successors(state, action, number_of(reward), bool(ended))
            }
            where = f"step {taken} after a reset with seed {seed}, action {action}"
            possible = self._compare(possible, observed, where)

    def _successors(self, state: int, action: int, reward: float, ended: bool) -> list[int]:
        """Return the states that the tables give for what a step returned."""
        tables, pair = self.tables, state * self.n_actions + action
        fits = (
            (tables.probability[pair] > 0)
            & np.isclose(tables.reward[pair], reward, rtol=CLOSE, atol=CLOSE)
            & (tables.terminal[tables.next_state[pair]] == ended)
        )
        return tables.next_state[pair][fits].tolist()  # type: ignore[no-any-return]

    def _compare(self, possible: set[int], observed: Any, where: str) -> set[int]:
        """Return the possible states that look like what was observed, at least one."""
        seen = self.tables.observations
        if seen is not None:
            parts = parts_of(observed)
            possible = {
                state
                for state in possible
                if same_observation({n: a[state] for n, a in seen.parts.items()}, parts)
            }
        if not possible:
            raise TaskError(
                "tables must say what the environment does, so that all that matters of a state "
                f"must be saved and compared: {where} led elsewhere in {self.name}"
            )
        return possible

    def _way(self, first: int) -> list[int]:
        """Return actions that lead to a state drawn at random if their most likely outcomes do."""
        tables = self.tables
        likely = tables.next_state[np.arange(len(tables.next_state)), tables.probability.argmax(1)]
        after = likely.reshape(-1, self.n_actions)
        parent = _breadth_first(after, tables.terminal, first)
        met = np.flatnonzero(parent[:, 0] >= 0)
        state, way = int(self.rng.choice(met)), list[int]()
        while state != first:
            before, action = parent[state].tolist()
            way.append(action)
            state = before
        return way[::-1]


def _breadth_first(after: IntArray, terminal: Any, first: int) -> IntArray:
    """Return the state and action from which each state is first reached, (S, 2); -1 where not."""
    parent = np.full((len(after), 2), -1)
    parent[first] = first, 0
    front = np.array([first])
    while front.size:
        front = front[~terminal[front]]
        new = after[front]
        state, action = np.nonzero(parent[new, 0] < 0)
        found, which = np.unique(new[state, action], return_index=True)
        parent[found, 0], parent[found, 1] = front[state[which]], action[which]
        front = found
    return parent


MOST_SAMPLES = 1_000_000
"""Steps by which the outcomes of a pair are estimated, at most."""


@dataclass(frozen=True)
class Plan:
    """How an environment is tabulated."""

    seeds: tuple[int, ...]
    state: Any
    outcomes: Listed | None
    samples: int | None
    max_states: int
    max_seconds: float
    progress: bool | Callable[[Progress], Any] | None
    cache: Path | None = None

    def check(self) -> None:
        """Raise SettingError if settings are invalid or contradict each other."""
        pair = isinstance(self.state, tuple) and len(self.state) == 2
        known = self.state is None or callable(getattr(self.state, "open", None))
        if not known and not (pair and all(map(callable, self.state))):
            raise SettingError(
                "state must be DeepCopy(...), MiniGridState(...) or two functions, (save, "
                f"restore): got {self.state!r}"
            )
        check_progress(self.progress)
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
        """Return an environment's tables, and how they came about; from the cache if there."""
        how = self._how(env)
        if self.cache is None:
            return self._made(env, act, n_actions, name, how)
        ways = [*how] if isinstance(how, tuple) else [how]
        ways += [self.outcomes, self.samples, self.state is None]
        origin = made_of(env, name, self.seeds, ways)
        tables = read_tables(self.cache, origin)
        if tables is None:
            tables = self._made(env, act, n_actions, name, how)
            write_tables(self.cache, origin, *tables)
        return tables

    def _made(
        self, env: Any, act: Callable[[int], Any], n_actions: int, name: str, how: Any
    ) -> tuple[Tables, TabulationRecord]:
        """Return an environment's tables, made anew."""

        def world(access: Any) -> World:
            return World(env, act, n_actions, self.seeds, self.samples, access, name)

        if self.state is None and isinstance(how, MiniGridState) and not how.copies:
            fast = MiniGridAccess(own_reward=False)
            try:
                return self._tables(world(fast))
            except TaskError:
                if not fast.missed(env.unwrapped):
                    raise
                fast.release()
                how = MiniGridState(copies=True)
        access = SaveAndRestore(*how) if isinstance(how, tuple) else how.open()
        return self._tables(world(access))

    def _tables(self, world: World) -> tuple[Tables, TabulationRecord]:
        """Return the tables of a world, and how they came about."""
        source = self._source(world)
        with shared_draws() as drawn:
            found = self._explored(source)
            if source is world and drawn():  # seldom, and to ask at every step would take long
                world.shared, world.transitions, world.drawing = SHARED, 0, 0
                found = self._explored(source)
            sampled, merge = self.samples is not None, world.access.copies and source is world
            tables = assembled(found, world.n_actions, sampled=sampled, merge=merge)
            world.access.end()
            checked = 0 if sampled else Checker(world, tables).check(self.seeds)
        record = TabulationRecord(
            environment=world.name,
            seeds=self.seeds,
            samples=self.samples,
            transitions=source.transitions,
            drawing=world.drawing,
            checked=checked,
            cut=found.cut,
            several=found.several,
            explored=len(found.terminal),
            seconds=found.seconds,
            observing=found.observing,
            note=world.access.note,
        )
        return tables, record

    def _how(self, env: Any) -> Any:
        """Return how states are saved and restored."""
        if isinstance(self.state, MiniGridState) and not is_minigrid(env):
            raise SettingError(f"state={self.state!r} is for MiniGrid's environments: got {env}")
        if self.state is not None:
            return self.state
        if is_minigrid(env):
            core, _, _ = core_and_views(env, views_apart=True)
            return fitting_state(env, core, self.seeds[0])
        return DeepCopy()

    def _source(self, world: World) -> World | ListedOutcomes:
        """Return what is explored: listed outcomes where there are any, else steps."""
        env, base = world.env, world.env.unwrapped
        known = world.n_actions, self.seeds, world.name
        if self.outcomes is not None:
            save = self.state[0] if isinstance(self.state, tuple) else None
            return ListedOutcomes(env, self.outcomes, *known, save)
        if self.state is None and self.samples is None and has_table(env):
            table: Any = base
            return ListedOutcomes(env, lambda s, a: table.P[s][a], *known, words=words_of(base))
        return world

    def _explored(self, source: Any) -> Explored:
        """Return all states, and show the progress if asked to."""
        words = f"tabulating {source.name}"
        with shown(self.progress, lambda: words) as bars:

            def show(now: Progress) -> None:
                nonlocal words
                words = now.in_words(source.name)
                bars.at(source.name, now.expanded, now.states)
                bars.tell(now)

            return Search(source, self.max_states, self.max_seconds, show).run()


def words_of(world: Any) -> Callable[[Any], Words] | None:
    """Return the function from a state of a known environment to its components, if known."""
    states = names_of(world)[0]
    if states is None or states.size != len(world.P):
        return None

    def words(state: Any) -> Words:
        values = values_of(states, int(state))
        return {
            part.name: part.label(values[part.name]) if part.labels else values[part.name]
            for part in states.components
        }

    return words


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
        environment's attributes or in what `save` returns; where these do not tell them apart, in
        attributes with an underscore and observations.

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
    TabulatedTask(Taxi-v4: 202 states, ..., time limit 200, 3 of several resets seen)
    >>> taxi.states.label(0)
    'row=3 column=0 passenger=blue destination=yellow'
    """
    plan = Plan(
        seeds=seed_tuple(seeds),
        state=state,
        outcomes=outcomes,
        samples=samples,
        max_states=whole_number("max_states", max_states, 1, SettingError),
        max_seconds=number("max_seconds", max_seconds, SettingError, low=0),
        progress=progress,
        cache=None if cache is None else saved_path(cache),
    )
    plan.check()
    discount = number("discount", discount, TaskError, low=0, high=1)
    names = None if names is None else name_list(names)
    make = maker_of(environment, time_limit, make_arguments)
    with _opened(environment, make, plan) as env:
        if any(isinstance(layer, FrameStackObservation) for layer in layers_of(env)):
            raise TaskError(
                "an environment with stacked frames cannot be tabulated, as each history of frames "
                f"would be a state: tabulate it without them, got {env}"
            )
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
    limits = [time_limit_of(env), int(env.unwrapped.max_steps) if is_minigrid(env) else None]
    return min((limit for limit in limits if limit is not None), default=None)


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
