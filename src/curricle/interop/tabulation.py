"""Any Gymnasium environment as tables, by visiting every state that can be reached.

Tabulation saves states, restores them, and steps. Deep copies do this for every environment.
Equivalent states are merged, so that counters add no states. Episodes are then played beside the
tables: they find parts of a state that were not saved.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import FrameStackObservation, TimeLimit as StepLimit

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import instance, number, whole_number
from curricle.errors import SettingError, TaskError
from curricle.interop.gymnasium import (
    Environment,
    TimeLimit,
    actions_of,
    has_table,
    maker_of,
    name_list,
    names_of,
    opened,
    outcomes_available,
    with_names,
)
from curricle.interop.minigrid import (
    MiniGridAccess,
    MiniGridState,
    fitting_state,
    named_actions,
)
from curricle.interop.search import (
    Listed,
    ListedOutcomes,
    Search,
    World,
    core_and_views,
    price,
    time_limit_of,
)
from curricle.interop.states import DeepCopy, SaveAndRestore, Words, copied, shared_draws
from curricle.interop.tabulated_task import (
    ObservationTable,
    Shown,
    TabulatedTask,
    TabulationRecord,
    parts_of,
    same_observation,
    stacked_observations,
    way_to,
)
from curricle.learning.seeds import seed_tuple
from curricle.progress import check_progress, shown
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.minigrid_view import is_minigrid
from curricle.tasks.models import number_of
from curricle.tasks.observation_task import SHARED, layers_of
from curricle.tasks.readers import Pairs
from curricle.tasks.spaces import Component, Space, values_of
from curricle.transfer.bisimulation import merged_outcomes, numbered_rows

WIDEST = 10_000  # values of a component that is numbered from its lowest to its highest value
ABSENT = "absent"  # the value of a component in states that lack it
ANY = "any"  # the value of a component that makes no difference in a state
MOST_SAMPLES = 1_000_000  # steps by which the outcomes of a pair are estimated, at most
STEPS = 1000  # steps that are compared with the tables
WALKS = 20  # times that an episode goes to a state drawn at random, before it goes on at random
CLOSE = 1e-9  # relative difference of rewards that is rounding
MOST_STATES = 1_000_000  # states of a table by default, at most
MOST_SECONDS = 3600.0  # seconds that a tabulation takes by default, at most


class Tables(NamedTuple):
    """The tables of S states and A actions; each pair has an outcome row of its own."""

    states: Space
    probability: FloatArray  # (S A, O)
    next_state: IntArray  # (S A, O)
    reward: FloatArray  # (S A, O)
    terminal: BoolArray  # (S,)
    start: FloatArray  # (S,)
    first: IntArray  # the state that each reset leads to
    observations: ObservationTable | None

    def mdp(self, actions: Space, discount: float, time_limit: int | None) -> FiniteMDP:
        """Return the task of these tables."""
        rows = np.arange(len(self.probability)).reshape(-1, actions.size)
        tables = self.probability, self.next_state, self.reward, self.terminal, self.start
        return FiniteMDP(
            self.states, actions, rows, *tables, discount, time_limit, self.tried[rows]
        )

    @property
    def tried(self) -> BoolArray:
        """Which pairs have outcomes, (S A,): others are not available, or of terminal states."""
        return np.asarray((self.probability > 0).any(axis=1))


Made = tuple[Tables, TabulationRecord]


@dataclass(frozen=True)
class Plan:
    """How an environment is tabulated."""

    seeds: Any
    state: Any = None
    outcomes: Listed | None = None
    samples: int | None = None
    max_states: int = MOST_STATES
    max_seconds: float = MOST_SECONDS
    progress: bool | Callable[[str], Any] | None = None
    action_masks: bool = False

    def __post_init__(self) -> None:
        pair = isinstance(self.state, tuple) and len(self.state) == 2
        opens = self.state is None or callable(getattr(self.state, "open", None))
        states = whole_number("max_states", self.max_states, 1, SettingError)
        object.__setattr__(self, "seeds", seed_tuple(self.seeds))
        object.__setattr__(self, "max_states", states)
        number("max_seconds", self.max_seconds, SettingError, low=0)
        if not opens and not (pair and all(map(callable, self.state))):
            raise SettingError(
                "state must be DeepCopy(...), MiniGridState(...) or two functions, (save, "
                f"restore): got {self.state!r}"
            )
        check_progress(self.progress)
        instance("action_masks", self.action_masks, bool, SettingError)
        if self.outcomes is not None and not callable(self.outcomes):
            raise SettingError(f"outcomes must be a function: got {self.outcomes!r}")
        if self.samples is not None:
            samples = whole_number("samples", self.samples, 1, SettingError)
            number("samples", samples, SettingError, high=MOST_SAMPLES)
            if self.outcomes is not None:
                raise SettingError("outcomes are listed or estimated: got outcomes and samples")

    def carried_out(
        self, env: gym.Env[Any, Any], act: Callable[[int], Any], n_actions: int, name: str
    ) -> Made:
        """Return an environment's tables and their record."""
        how = self.state  # how states are saved and restored
        if isinstance(how, MiniGridState) and not is_minigrid(env):
            raise SettingError(f"state={how!r} is for MiniGrid's environments: got {env}")
        if how is None and is_minigrid(env):
            core, _, _ = core_and_views(env, views_apart=True)
            how = fitting_state(env, core, self.seeds[0])
        elif how is None:
            how = DeepCopy()
        access: Any = SaveAndRestore(*how) if isinstance(how, tuple) else how.open()
        settings = env, act, n_actions, self.seeds, self.samples
        try:
            return self._made(World(*settings, access, name, self.action_masks))
        except TaskError:
            fast = self.state is None and isinstance(access, MiniGridAccess)
            if not fast or not access.missed(env.unwrapped):
                raise
            access.release()
            access = MiniGridState(copies=True).open()
            return self._made(World(*settings, access, name, self.action_masks))

    def _made(self, world: World) -> Made:
        source: World | ListedOutcomes = world
        env, base = world.env, world.env.unwrapped
        shared = world.n_actions, self.seeds, world.name
        if self.outcomes is not None:
            save = self.state[0] if isinstance(self.state, tuple) else None
            source = ListedOutcomes(env, self.outcomes, *shared, save)
        elif self.state is None and self.samples is None and has_table(env):
            table: Any = base
            rows = outcomes_available(table, table.P) if self.action_masks else table.P
            state_words = words_of(base, len(table.P))
            source = ListedOutcomes(env, lambda s, a: rows[s][a], *shared, parts=state_words)
        with shared_draws() as drawn:
            search = self._explored(source)
            if source is world and drawn():  # seldom, and to ask at every step would take long
                world.shared, world.transitions, world.drawing = SHARED, 0, 0
                search = self._explored(source)
            sampled, merge = self.samples is not None, world.access.copies and source is world
            tables = assembled(search, world.n_actions, sampled=sampled, merge=merge)
            world.access.end()
            checked = 0 if sampled else steps_checked(world, tables)
        record = TabulationRecord(
            environment=world.name,
            seeds=self.seeds,
            samples=self.samples,
            transitions=source.transitions,
            drawing=world.drawing,
            checked=checked,
            explored=len(search.states),
            note=world.access.note,
            cut=search.cut,
            several=search.several,
            seconds=search.seconds,
        )
        return tables, record

    def _explored(self, source: World | ListedOutcomes) -> Search:
        """Return the finished search; show its price and its progress as `progress` asks for."""
        with shown(self.progress) as bars:

            def show(sentence: str, done: int) -> None:
                bars.at(source.name, done, text=sentence)  # how many there are is not known yet
                bars.tell(sentence)

            if isinstance(source, World) and len(self.seeds) > 1 and self.samples is None:
                bars.say(price(source, self.max_states, self.max_seconds))
            search = Search(source, self.max_states, self.max_seconds, show).run()
            bars.at(source.name, len(search.states), len(search.states))
            return search


def tabulate(
    environment: Environment,
    *,
    discount: float,
    seeds: object = 1,
    time_limit: TimeLimit = "own",
    names: Sequence[str] | None = None,
    sizes: Sequence[int] | None = None,
    actions: Space | Sequence[str] | None = None,
    state: object = None,
    outcomes: Listed | None = None,
    samples: int | None = None,
    max_states: int = MOST_STATES,
    max_seconds: float = MOST_SECONDS,
    progress: bool | Callable[[str], Any] | None = None,
    action_masks: bool = False,
    **make_arguments: object,
) -> TabulatedTask:
    """Return a Gymnasium environment as tables of every state that can be reached.

    Each action is taken in each state, breadth first from the states after resets. Results of
    :func:`solve`, :func:`certify` and :func:`evaluate` then hold for the environment: steps must be
    deterministic, which repeated steps check, or their outcomes must be listed or estimated; and up
    to 1,000 steps of episodes must agree with the tables.

    Parameters
    ----------
    environment : str, gymnasium.EnvSpec, gymnasium.Env or callable
        As in :func:`from_gymnasium`. A copy is stepped; the environment itself only if it cannot be
        copied and there are functions to restore it.
    discount : float
    seeds : int or sequence of int
        Seeds of the resets, which are equally likely starts; K stands for 0 .. K-1.
    time_limit : int, None or "own"
        Steps after which episodes are truncated; by default the least of the environment's own.
        Time is no part of a state, unless the environment counts it itself.
    names, sizes, actions : sequence, optional
        Names of a state's components, in their order; `sizes`, which split a state that is a single
        number, and `actions` as in :func:`from_gymnasium`.
    state : DeepCopy, MiniGridState or (save, restore), optional
        How states are saved and restored: by default :class:`DeepCopy`, in MiniGrid's environments
        :class:`MiniGridState`, where the goal's reward is 1. Two functions are faster:
        ``save(env)`` returns the state, hashable, ``restore(env, state)`` puts the environment,
        without wrappers, back into it. The fields of a named tuple name components.
    outcomes : callable, optional
        ``outcomes(state, action)`` lists (probability, next state, reward, terminated) of each
        outcome, none where the action is not available; states are observations, or what `save`
        returns. By default an environment's table
        ``P`` is used if it has one and there is no `state`.
    samples : int, optional
        Steps of each pair from which to estimate its outcomes.
    max_states, max_seconds : int, float
        Most states and seconds that the tabulation may take.
    progress : bool or callable, optional
        Bars by default, after two seconds; True shows them at once, False never; a function is
        called with a sentence on the progress from time to time.
    action_masks : bool
        Whether only available actions are taken, as in :func:`from_gymnasium`.
    **make_arguments
        Arguments of ``gymnasium.make``, or of the class or function.

    Returns
    -------
    TabulatedTask
        Its states have a component for each number or word that differs between states, taken first
        from the environment's attributes or `save`, then from private attributes and observations.

    Raises
    ------
    TaskError, SettingError
        When the environment cannot be copied, its states cannot be distinguished, frames are
        stacked, steps are random, a limit is reached, or an episode is not in the tables; when a
        setting is invalid.

    Examples
    --------
    >>> taxi = tabulate("Taxi-v4", discount=0.9, seeds=3)
    >>> taxi
    TabulatedTask(Taxi-v4: 202 states, ..., time limit 200, 3 of several resets seen)
    >>> taxi.states.label(0)
    'row=3 column=0 passenger=blue destination=yellow'
    """
    plan = Plan(seeds, state, outcomes, samples, max_states, max_seconds, progress, action_masks)
    discount = number("discount", discount, TaskError, low=0, high=1)
    if names is None and sizes is not None:
        raise TaskError(f"sizes need the names of their components: got sizes {sizes!r}")
    names = None if names is None else name_list(names)
    make = maker_of(environment, time_limit, make_arguments)
    if isinstance(environment, gym.Env):
        try:
            environment, _ = copied(environment)
        except TaskError:
            if not isinstance(state, tuple):
                raise
    with opened(environment, make) as env:
        if any(isinstance(layer, FrameStackObservation) for layer in layers_of(env)):
            raise TaskError(
                "an environment with stacked frames cannot be tabulated, as each history of frames "
                f"would be a state: tabulate it without them, got {env}"
            )
        name = str(make) if make.recipe is not None else type(env.unwrapped).__name__
        turned = any(isinstance(layer, gym.ActionWrapper) for layer in layers_of(env))
        named = names_of(env)[1] or (None if turned else named_actions(env))
        act, moves = actions_of(env.action_space, actions, named)
        tables, record = plan.carried_out(env, act, moves.size, name)
        stated = env.unwrapped.max_steps if is_minigrid(env) else None
        limit: Any = time_limit_of(env, stated) if time_limit == "own" else time_limit
    if names is not None:
        tables = tables._replace(states=with_names(tables.states, names, sizes))
    if make.recipe is not None:
        sure = bool((tables.probability[tables.tried].max(axis=1) == 1).all())
        before = ways_from(tables, tables.first, moves.size) if sure else None
        drawn = Shown(make, act, plan.seeds, before, tables.observations)
        tables = tables._replace(states=replace(tables.states, drawn=drawn))
    return TabulatedTask(tables.mdp(moves, discount, limit), tables.observations, record)


def words_of(env: gym.Env[Any, Any], n_states: int) -> Callable[[int], Words] | None:
    """Return the function from a state of a known environment to its components, if known."""
    states = names_of(env)[0]
    if states is None or states.size != n_states:
        return None

    def components(state: int) -> Words:
        values = zip(states.components, values_of(states, int(state)).values(), strict=True)
        return {part.name: part.label(value) if part.labels else value for part, value in values}

    return components


# -- tables of explored states --------------------------------------------------------------------

Part = tuple[Component, IntArray]  # a component, and its value in each state


def assembled(search: Search, n_actions: int, *, sampled: bool, merge: bool) -> Tables:
    """Return the tables of explored states; states that are alike are merged."""
    table, observations = None, [state.observation for state in search.states]
    terminal = np.array([state.terminal for state in search.states])
    if all(observation is not None for observation in observations):
        table = stacked_observations(observations, terminal)
    start, n_states = np.zeros(len(terminal)), len(terminal)
    np.add.at(start, search.first, 1 / len(search.first))
    space, rows = Space([Component("state", n_states)]), _outcome_rows(search, n_actions, sampled)
    tables = Tables(space, *rows, terminal, start, np.array(search.first), table)
    blocks = np.arange(n_states)
    if merge and table is not None:
        blocks = alike(tables, table, n_actions)
        first = np.unique(blocks, return_index=True)[1]  # it stands for its block
        pairs = (first[:, None] * n_actions + np.arange(n_actions)).ravel()
        parts = {name: part[first] for name, part in table.parts.items()}
        tables = tables._replace(
            probability=tables.probability[pairs],
            next_state=blocks[tables.next_state[pairs]],
            reward=tables.reward[pairs],
            terminal=terminal[first],
            start=np.asarray(np.bincount(blocks, weights=start), dtype=np.float64),
            first=blocks[tables.first],
            observations=ObservationTable(parts, table.terminal[first]),
        )
    components, vague = words_of_blocks([state.components for state in search.states], blocks)
    return tables._replace(states=named_states(components, tables.terminal, vague))


def _outcome_rows(
    search: Search, n_actions: int, sampled: bool
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return probabilities, successors and rewards, (S A, O) each; a terminal state has none."""
    columns = search.pair, search.next_state, search.probability, search.reward
    pair, after, chance, reward = map(np.array, columns)
    if sampled:
        key, which = np.unique(np.stack([pair, after]), axis=1, return_inverse=True)
        pair, after = key
        earned = np.bincount(which, weights=chance * reward)
        chance = np.bincount(which, weights=chance)
        reward = earned / chance
    order, shape = np.argsort(pair, kind="stable"), (len(search.states), n_actions)
    pairs = np.divmod(np.arange(shape[0] * n_actions), n_actions)
    counts = np.bincount(pair, minlength=shape[0] * n_actions)
    return Pairs(shape, *pairs, counts, chance[order], after[order], reward[order]).tables()[2]


def alike(tables: Tables, observations: ObservationTable, n_actions: int) -> IntArray:
    """Return each state's block in the coarsest bisimulation (Givan, Dean, Greig 2003), (S,)."""
    parts = [part.reshape(len(part), -1) for part in observations.parts.values()]
    looks = [np.unique(part, axis=0, return_inverse=True)[1].reshape(-1, 1) for part in parts]
    blocks = numbered_rows(np.column_stack([*looks, tables.terminal]))
    different, rewards = np.unique(tables.reward, return_inverse=True)
    while True:
        outcomes = blocks[tables.next_state] * len(different) + rewards.reshape(tables.reward.shape)
        after, chance = merged_outcomes(outcomes, tables.probability)
        bits = chance.round(12).view(np.int64)  # equal where the rounded chances are
        pairs = numbered_rows(np.column_stack([after, bits])).reshape(-1, n_actions)
        finer = numbered_rows(np.column_stack([blocks, pairs]))
        if finer.max() == blocks.max():
            first = np.unique(finer, return_index=True)[1]
            return np.argsort(np.argsort(first))[finer]  # in the order in which they appear
        blocks = finer


# -- names ----------------------------------------------------------------------------------------


def words_of_blocks(of_states: Sequence[Words], blocks: IntArray) -> tuple[list[Words], set[str]]:
    """Return the components of each block, `ANY` where its states differ, and their names then."""
    words_of_block = dict[int, dict[str, int | str]]()
    vague = set[str]()
    for components, block in zip(of_states, blocks.tolist(), strict=True):
        shared = words_of_block.setdefault(block, dict(components))
        for name in {**shared, **components}:
            if shared.get(name) != components.get(name):
                shared[name] = ANY
                vague.add(name)
    return [words_of_block[block] for block in sorted(words_of_block)], vague


def named_states(of_states: Sequence[Words], terminal: BoolArray, vague: Collection[str]) -> Space:
    """Return the space of the components that differ between states."""
    names = dict.fromkeys(name for components in of_states for name in components)
    parts = list[Part]()
    # Public names first, then those with an underscore, then vague ones; at last a number.
    for name in sorted(names, key=lambda name: 2 if name in vague else name.startswith("_")):
        public = name not in vague and not name.startswith("_")
        if not public and _count(parts) == len(of_states):
            break
        values = [components.get(name, ABSENT) for components in of_states]
        part = _component(_free(name.lstrip("_") or name, parts), values)
        # Of the rest only what tells states apart that are alike so far.
        if part[0].size > 1 and (public or _count([*parts, part]) > _count(parts)):
            parts.append(part)
    if not parts:
        return Space([Component("state", len(of_states), arbitrary=True)])
    if _copy_numbers(parts).any() and terminal.any() and not terminal.all():
        ended = Component(_free("ended", parts), 2, labels=("no", "yes"))
        parts.append((ended, terminal.astype(np.int64)))
    copies = _copy_numbers(parts)
    if copies.any():
        size = int(copies.max()) + 1
        parts.append((Component(_free("variant", parts), size, arbitrary=True), copies))
    points = np.stack([values for _, values in parts], axis=1)
    return Space([component for component, _ in parts], points)


def _component(name: str, values: Sequence[int | str]) -> Part:
    """Return the component of these values, (S,), and the number of each value in it."""
    if not any(isinstance(value, str) for value in values):
        array = np.array(values, dtype=np.int64)
        low, size = int(array.min()), int(array.max()) - int(array.min()) + 1
        if size <= WIDEST:
            return Component(name, size, low), array
    number = {label: i for i, label in enumerate(dict.fromkeys(map(str, values)))}
    numbers = np.array([number[str(value)] for value in values], dtype=np.int64)
    return Component(name, len(number), labels=tuple(number)), numbers


def _count(parts: Sequence[Part]) -> int:
    return int((_copy_numbers(parts) == 0).sum()) if parts else 1


def _copy_numbers(parts: Sequence[Part]) -> IntArray:
    """Return for each state how many states before it have the same values, (S,)."""
    which = numbered_rows(np.stack([values for _, values in parts], axis=1))
    order = np.argsort(which, kind="stable")
    counts = np.bincount(which)
    copies = np.empty_like(which)
    copies[order] = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    return copies


def _free(name: str, parts: Sequence[Part]) -> str:
    """Return a name that no component has yet."""
    return _free(f"{name}_", parts) if name in [part.name for part, _ in parts] else name


# -- comparing tables with the environment --------------------------------------------------------


def steps_checked(world: World, tables: Tables) -> int:
    """Return how many steps of episodes agree with the tables; TaskError where a step does not."""
    rng, steps, n_actions = np.random.default_rng(0), 0, world.n_actions
    clocks: Any = [layer for layer in layers_of(world.env) if isinstance(layer, StepLimit)]
    for walk in range(WALKS):
        k = walk % len(world.seeds)
        # An episode: on the way to some state, then at random.
        seed, first = world.seeds[k], int(tables.first[k])
        before = ways_from(tables, np.array([first]), n_actions)
        _, way = way_to(before, int(rng.choice(np.flatnonzero(before[:, 0] > NO_WAY))))
        observed, _ = world.env.reset(seed=seed)
        possible, truncated, taken = {first}, False, 0
        _looking_like(observed, possible, tables, f"a reset with seed {seed}", world)
        most = len(way) + STEPS // WALKS
        while not truncated and taken < most and not tables.terminal[list(possible)].any():
            pairs = min(possible) * n_actions + np.arange(n_actions)
            allowed = np.flatnonzero(tables.tried[pairs])
            action = way[taken] if taken < len(way) else int(allowed[rng.integers(len(allowed))])
            observed, reward, ended, truncated, _ = world.env.step(world.act(action))
            taken += 1
            if any(clock._elapsed_steps != taken for clock in clocks):
                raise TaskError(
                    "a time limit must count the steps of an episode, so that TimeLimit belongs "
                    "around wrappers that repeat steps (and max_episode_steps=-1 in make): after "
                    f"step {taken} that of {world.name} has counted "
                    f"{max(clock._elapsed_steps for clock in clocks)}"
                )
            reached = set[int]()
            for state in possible:
                pair = state * n_actions + action
                fits = (
                    (tables.probability[pair] > 0)
                    & np.isclose(tables.reward[pair], number_of(reward), rtol=CLOSE, atol=CLOSE)
                    & (tables.terminal[tables.next_state[pair]] == bool(ended))
                )
                reached.update(tables.next_state[pair][fits].tolist())
            where = f"step {taken} after a reset with seed {seed}, action {action}"
            possible = _looking_like(observed, reached, tables, where, world)
        steps += taken
        if steps >= STEPS:
            break
    return steps


def _looking_like(
    observed: object, possible: set[int], tables: Tables, where: str, world: World
) -> set[int]:
    """Return the possible states with this observation; TaskError if there are none."""
    if tables.observations is not None:
        of_states, parts = tables.observations.parts, parts_of(observed)
        possible = {
            state
            for state in possible
            if same_observation({n: a[state] for n, a in of_states.items()}, parts)
        }
    if not possible:
        raise TaskError(
            "tables must agree with the environment, so every part of a state that matters must "
            f"be saved and compared{world.access.hint}: {where} led elsewhere in {world.name}"
        )
    return possible


NO_WAY = -2


def ways_from(tables: Tables, first: IntArray, n_actions: int) -> IntArray:
    """Return what leads from the states `first` to each by the most likely outcomes, (S, 2).

    It is as :func:`way_to` reads it, of shortest ways; `NO_WAY` where there is none.
    """
    likely = tables.next_state[np.arange(len(tables.next_state)), tables.probability.argmax(1)]
    staying = np.arange(len(likely)) // n_actions
    likely = np.where(tables.tried, likely, staying).reshape(-1, n_actions)
    parent = np.full((len(likely), 2), NO_WAY)
    parent[first, 0], parent[first, 1] = -1, np.arange(len(first))
    front = np.unique(first)
    while front.size:
        front = front[~tables.terminal[front]]
        new = likely[front]
        row, move = np.nonzero(parent[new, 0] == NO_WAY)
        reached, which = np.unique(new[row, move], return_index=True)
        parent[reached, 0], parent[reached, 1] = front[row[which]], move[which]
        front = reached
    return parent
