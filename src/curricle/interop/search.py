"""The search for every state that an environment can reach, breadth first, by steps or lists."""

import math
import re
import time
from array import array
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy, deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit

from curricle.checks import number
from curricle.errors import TaskError, note_place
from curricle.interop.states import (
    HARMLESS,
    Environment,
    Generator,
    StateAccess,
    Words,
    acts_as,
    counters_of,
    restart,
    state_of,
    words_of_state,
)
from curricle.interop.tabulated_task import same_observation
from curricle.progress import DELAY
from curricle.tasks.live import RETURNED, action_mask, seeded_reset, wrong_parts
from curricle.tasks.mdp import SINGLE_PRECISION
from curricle.tasks.models import flag_of, number_of
from curricle.tasks.observation_task import layers_of, shared_restored
from curricle.text import duration

MORE_RESETS = 8  # with other seeds, to see whether the states that they lead to differ
INTERVAL = 0.5  # seconds between two reports of progress
WARM = 1.0  # seconds after which the pace so far counts
PROBE = 5.0  # seconds in which the states of the first reset show what a search will take


class Reached(NamedTuple):
    """An outcome of an action: the next state, its probability and its reward."""

    probability: float
    key: Hashable  # equal for equal states
    content: object  # what the state is restored from
    reward: float
    terminated: bool
    truncated: bool
    available: tuple[bool, ...] | None = None  # the actions that can be taken there; None for all
    # The environment in that state, until it is stepped again, and what its step or reset returned.
    env: Any = None
    returned: Any = None


class State(NamedTuple):
    """A state, as it was when it was reached first."""

    terminal: bool
    observation: object
    components: Words


ALIKE = (
    "states must lead alike where they look alike, to be told apart by observations: in {} an "
    "action led to another state or reward when its observation was met again"
)


class Search:
    """All states that can be reached and a table of all outcomes, breadth first."""

    def __init__(
        self,
        stepper: "World | ListedOutcomes",
        max_states: int,
        max_seconds: float,
        show: Callable[[str, int], object],  # a sentence, and the states done
    ):
        self.stepper, self.show = stepper, show
        self.max_states, self.max_seconds = max_states, max_seconds
        self.states = list[State]()  # in the order of meeting
        # The columns of the table of outcomes; a pair is state x A + action.
        self.pair, self.next_state = array("q"), array("q")
        self.probability, self.reward = array("d"), array("d")
        self.first = list[int]()  # the state that each start leads to
        self.several = False  # whether resets lead to different states
        self.cut = 0  # states from which nothing goes on, as episodes are truncated there
        self.seconds, self.done = 0.0, 0  # states whose actions have been taken
        self._numbers = dict[tuple[Hashable, bool], int]()
        # The states whose actions are to be taken: number, content, available actions.
        self.queue = deque[tuple[int, object, tuple[bool, ...] | None]]()
        self._queued = bytearray()  # of each state, how often it was put into the queue
        self._done = bytearray()  # of each state, whether it is done
        self._led = dict[int, tuple[int, float]]()  # where a pair led, if states are tried twice
        self._tries = 1 + stepper.witnessed  # of each state
        self._last: Any = None  # the environment in the state that was reached last

    def run(self) -> Self:
        """Search to the end and return the search; TaskError as soon as a limit will be reached."""
        stepper, n_actions, seeds = self.stepper, self.stepper.n_actions, self.stepper.seeds
        began = shown = time.perf_counter()
        for seed in seeds:
            observed = deepcopy(stepper.look(stepper.start(seed))[0])
            reached = stepper.start(seed)
            number = self._number(reached)
            if not same_observation(observed, stepper.look(reached)[0]):
                raise TaskError(
                    f"a reset must follow its seed: two resets of {stepper.name} with seed "
                    f"{seed} differ; let reset call super().reset(seed=seed), and draw from "
                    "self.np_random alone"
                )
            self.first.append(number)
        while self.queue:
            number, content, available = self.queue.popleft()
            again, self._done[number] = self._done[number], True
            for action in range(n_actions):
                if available is not None and not available[action]:
                    continue
                try:
                    for reached in stepper.outcomes(content, action):
                        pair, after = number * n_actions + action, self._number(reached)
                        led = after, reached.reward
                        if self._tries > 1 and self._led.setdefault(pair, led) != led:
                            raise TaskError(ALIKE.format(self.stepper.name))
                        if not again:
                            self._add(pair, after, reached.probability, reached.reward)
                except Exception as error:
                    parts = (f"{k} {v}" for k, v in self.states[number].components.items())
                    note_place(
                        error, f", for action {action} in state {number} ({', '.join(parts)})"
                    )
                    raise
                now, n_states = time.perf_counter(), len(self.states)
                self.seconds = now - began
                least = self.seconds * n_states / (self.done + 1) if self.seconds > WARM else 0.0
                if max(self.seconds, least) > self.max_seconds:
                    raise TaskError(
                        f"a table must be complete within max_seconds, {self.max_seconds:g}: "
                        f"tabulating {stepper.name} has found {n_states:,} states in "
                        f"{duration(self.seconds)} and done {self.done:,} of them{self.hint()}"
                    )
                if now - shown > INTERVAL:
                    shown = now
                    sentence = (
                        f"tabulating {stepper.name}: {n_states:,} states, {self.done:,} done, "
                        f"{stepper.transitions:,} steps in {duration(self.seconds)}"
                    )
                    self.show(sentence, self.done)
            self.done += not again
        for number, state in enumerate(self.states):
            if not (self._queued[number] or state.terminal):
                self.cut += 1
                for pair in range(number * n_actions, (number + 1) * n_actions):
                    self._add(pair, number, 1.0, 0.0)
        resets = (stepper.start(max(seeds) + k) for k in range(1, MORE_RESETS + 1))
        starts = (self._numbers.get((reset.key, False)) in self.first for reset in resets)
        self.several = len({*self.first}) > 1 or not all(starts)
        self.seconds = time.perf_counter() - began
        return self

    def is_near(self, start: Reached) -> bool:
        """Return whether a start, or where one of its actions leads, is found."""
        actions = np.flatnonzero(start.available or [True] * self.stepper.n_actions).tolist()
        ways = (reached for a in actions for reached in self.stepper.outcomes(start.content, a))
        return any((to.key, to.terminated) in self._numbers for to in (start, *ways))

    def _add(self, pair: int, after: int, probability: float, reward: float) -> None:
        """Add a row to the table of outcomes: a pair that leads to the state `after`."""
        self.pair.append(pair)
        self.next_state.append(after)
        self.probability.append(probability)
        self.reward.append(reward)

    def _number(self, reached: Reached) -> int:
        """Return the number of a state, which is a new number if the state is new."""
        name = reached.key, reached.terminated  # entered with the episode's end it is another
        number, self._last = self._numbers.get(name), reached.env
        if number is None:
            number = self._numbers[name] = len(self.states)
            if number >= self.max_states:
                raise TaskError(
                    f"a table may have at most max_states, {self.max_states:,} states: tabulating "
                    f"{self.stepper.name} found more{self.hint()}"
                )
            observation, components = self.stepper.look(reached)
            observation = deepcopy(observation)  # which a step may change
            components = {**components, **words_of_state(observation, "_")}
            self.states.append(State(reached.terminated, observation, components))
            self._queued.append(0)
            self._done.append(False)
        goes_on = not (reached.terminated or reached.truncated)
        if goes_on and self._queued[number] < self._tries:
            self.queue.append((number, reached.content, reached.available))
            self._queued[number] += 1
        return number

    def hint(self) -> str:
        """Return why there are many states: a part that counts steps, or that has most values."""
        of_states = [state.components for state in self.states]
        before = np.array(self.pair, np.int64) // self.stepper.n_actions
        counting = counters_of(of_states, before, np.array(self.next_state), self._last)
        if counting:
            return (
                f"; {counting[0]!r} counts steps, which state=DeepCopy(ignore={counting}) leaves "
                f"out (in a file ignore = {counting}): let time_limit end the episodes"
            )
        everywhere = set(of_states[0]).intersection(*of_states)
        values = dict[str, set[Any]]()
        for components in of_states:
            parts = dict[str, list[int | str]]()
            for name, value in components.items():
                # Entries that some states lack are those of a list that grows.
                whole = name if name in everywhere else re.sub(r"(_\d+)+$", "", name)
                parts.setdefault(whole, []).append(value)
            for name, part in parts.items():
                values.setdefault(name, set()).add(tuple(part))
        name = max(values, key=lambda name: len(values[name]), default="")
        hint = ", and most differ only in parts that are neither whole numbers nor words"
        different = {frozenset(components.items()) for components in of_states}
        if values and 2 * len(different) > len(of_states):
            hint = f", and {name!r} has the most values, {len(values[name]):,}"
        return f"{hint}; from_gymnasium plays it live" * (len(of_states) > 1)


def price(world: "World", max_states: int, max_seconds: float) -> str:
    """Return about what a search from several resets takes, as text, or nothing if that is little.

    What is found from the first of them is as large a share of all states as of the resets.
    TaskError where that is twice what a search may take, as levels are not equally large.
    """
    first, share = copy(world), 1.0
    first.seeds = world.seeds[:1]
    probe = Search(first, max_states, min(PROBE, max_seconds / 10), lambda *_: None)
    with suppress(TaskError):  # the search itself will meet it again
        probe.run()
    with suppress(TaskError):
        share = float(np.mean([probe.is_near(first.start(seed)) for seed in world.seeds]))
    whole = (1 + len(probe.queue) / max(probe.done, 1)) / share
    states, seconds = len(probe.states) / share, probe.seconds * whole
    text = (
        f"{'more than' if probe.queue else 'about'} {states:,.0f} states, "
        f"{len(probe.pair) * whole:,.0f} steps and {duration(seconds)}"
    )
    if states > 2 * max_states or seconds > 2 * max_seconds:
        raise TaskError(
            f"a table may have max_states, {max_states:,}, and take max_seconds, {max_seconds:g}: "
            f"by the first of its resets {world.name} takes {text}{probe.hint()}; fewer take less"
        )
    return f"tabulating {world.name} takes {text}" if seconds > DELAY else ""


REPETITIONS = 8  # of a step that draws random numbers; one that draws none is taken twice
LONG_AGO = -(2**62)  # steps that the clock of a wrapper shows, so that no time limit is met


@dataclass(eq=False)
class World:
    """An environment that is stepped from saved states."""

    env: Environment  # nobody else's: it is stepped and reset
    act: Callable[[int], Any]
    n_actions: int
    seeds: Sequence[int]
    samples: int | None
    access: StateAccess
    name: str
    action_masks: bool = False  # whether the environment says which actions can be taken
    transitions: int = 0
    drawing: int = 0  # pairs whose steps draw random numbers
    shared: Sequence[Generator] = ()  # the global generators, if steps or resets draw from them
    _undrawn: list[bytes] | None = None  # the generators' states, where nobody has drawn since

    def __post_init__(self) -> None:
        parts = core_and_views(self.env, views_apart=not self.access.copies)
        self.core, self.views, self.acts = parts
        self.access.prepare(self.env)

    @property
    def witnessed(self) -> bool:
        """Whether states that are met again are tried again, as a check that they are equal."""
        return self.access.witnessed and self.samples is None

    def start(self, seed: int) -> Reached:
        """Return the state after a reset with a seed."""
        self._undrawn, env = None, self.core
        if self.access.copies:
            env, _ = self.access.restore(self.core, self.core)
        with shared_restored():  # what the reset draws from them follows its seed
            returned, info = self._returned("reset", seeded_reset(env, seed))
        _rewind_clocks(env)
        self.access.begin(env)
        return self._reached(env, returned, info, 1.0, 0.0, terminated=False, truncated=False)

    def _reached(
        self, env: Environment, returned: object, info: object, chance: float, reward: float,
        *, terminated: bool, truncated: bool,
    ) -> Reached:  # fmt: skip
        """Return where an environment is after a step or a reset."""
        available = None
        if self.action_masks and not terminated:
            available = tuple(action_mask(env, info, self.n_actions).tolist())
        key, content = self.access.save(env, returned)
        ends = terminated, truncated
        return Reached(chance, key, content, reward, *ends, available, env, returned)

    def outcomes(self, content: object, action: int) -> Iterator[Reached]:
        """Yield an action's only outcome, or the outcome of every sample."""
        if self.transitions == self.n_actions:
            self.access.check()
        self.transitions += 1
        if self.samples is None:
            yield self._step(content, action)
            return
        for sample in range(self.samples):
            env, generators = self.access.restore(self.core, content)
            restart([*generators, *self.shared], self.transitions * self.samples + sample)
            yield self._arrival(env, action)

    def look(self, reached: Reached) -> tuple[object, Words]:
        """Return the observation and the components of the state that was reached last."""
        observation = self.access.observation(reached.env, reached.returned)
        for view in self.views:
            observation = view.observation(observation)
        return observation, self.access.describe(reached.env, observation)

    def _step(self, content: object, action: int) -> Reached:
        """Return the only outcome of an action in a saved state."""
        env, generators = self.access.restore(self.core, content)
        generators = [*generators, *self.shared]
        before = self._undrawn if self._undrawn is not None else [*map(state_of, generators)]
        first = self._arrival(env, action)
        after = [*map(state_of, generators)]
        drew = after != before
        self.drawing += drew
        for repetition in range(1, REPETITIONS if drew else 2):
            again, generators = self.access.restore(self.core, content)
            if drew:
                restart([*generators, *self.shared], repetition)
            self._check_repeated(first, self._arrival(again, action), action)
        # Where all is one environment its generators are now as they were, and it is in the same
        # state; else `first` has one of its own.
        self._undrawn = None if drew or self.access.copies else after
        return first

    def _arrival(self, env: Environment, action: int) -> Reached:
        """Return where a step leads."""
        core_action = self.act(action)
        for wrapper in self.acts:
            core_action = wrapper.action(core_action)
        returned = self._returned("step", env.step(core_action))
        observed, reward, terminated, truncated, info = returned
        _rewind_clocks(env)
        earned = number_of(reward)
        if not math.isfinite(earned):
            raise TaskError(f"a reward must be a finite number: got {reward!r} from {self.name}")
        chance = 1.0 if self.samples is None else 1 / self.samples
        flags = {"terminated": terminated, "truncated": truncated}
        place = f" from {self.name} for action {action}"
        ends = {name: flag_of(flag, name, place) for name, flag in flags.items()}
        return self._reached(env, observed, info, chance, earned, **ends)

    def _returned(self, by: str, returned: object) -> tuple[Any, ...]:
        """Return the result of a reset or a step; TaskError unless it has the right parts."""
        if not isinstance(returned, tuple) or len(returned) != len(RETURNED[by]):
            raise TaskError(f"{self.name}: {wrong_parts(by, returned)}")
        return returned

    def _check_repeated(self, first: Reached, again: Reached, action: int) -> None:
        differing, results = "", slice(3, 7)  # from the reward to the available actions
        if first.key != again.key:
            differing = "state"
        elif first[results] != again[results]:
            differing = "reward, end or mask of actions"
        elif not same_observation(first.returned, again.returned):
            differing = "observation"
        if differing:
            raise TaskError(
                "steps must be deterministic to be tabulated, unless outcomes= lists what can "
                "happen or samples= says from how many steps of a pair it is estimated "
                f"(from_gymnasium plays it live){self.access.hint}: action {action}, repeated from "
                f"one state of {self.name}, led to another {differing}"
            )


def time_limit_of(env: Environment, *more: int | None) -> int | None:
    """Return the steps after which an environment truncates: the least of its and more limits."""
    limits = [layer._max_episode_steps for layer in layers_of(env) if isinstance(layer, TimeLimit)]
    return min((int(steps) for steps in (*more, *limits) if steps is not None), default=None)


def _rewind_clocks(env: Environment) -> None:
    """Set back the clocks of time limits: time is no part of a state."""
    for layer in layers_of(env):
        if isinstance(layer, TimeLimit):
            layer._elapsed_steps = LONG_AGO  # type: ignore[assignment]


def core_and_views(
    env: Environment, *, views_apart: bool
) -> tuple[Environment, list[Any], list[Any]]:
    """Return the part of an environment that is stepped, and the wrappers apart from it.

    These are the wrappers of observations, from the innermost, and of actions, from the outermost.
    """
    views, acts = list[Any](), list[Any]()
    while isinstance(env, gym.Wrapper):
        if views_apart and acts_as(env, gym.ObservationWrapper):
            views.insert(0, env)
        elif views_apart and acts_as(env, gym.ActionWrapper):
            acts.append(env)
        elif not acts_as(env, *HARMLESS):
            break
        env = env.env
    return env, views, acts


Listed = Callable[[Any, int], Sequence[tuple[float, Any, float, bool]]]
"""From a state and an action to (probability, next state, reward, terminated) of each outcome."""


@dataclass(eq=False)
class ListedOutcomes:
    """Outcomes that a function or a table lists, of states or observations."""

    env: Environment
    listed: Listed
    n_actions: int
    seeds: Sequence[int]
    name: str
    save: Callable[[Any], Hashable] | None = None
    parts: Callable[[Any], Words] | None = None
    transitions: int = 0
    witnessed = False

    def start(self, seed: int) -> Reached:
        """Return the state after a reset."""
        observed, _ = seeded_reset(self.env, seed)
        state = deepcopy(observed) if self.save is None else self.save(self.env.unwrapped)
        return self._reached(1.0, state, 0.0, ended=False)

    def outcomes(self, content: object, action: int) -> Iterable[Reached]:
        """Yield the outcomes that are possible."""
        self.transitions += 1
        total = 0.0
        listed = self.listed(content, action)
        outcomes = [*listed] if isinstance(listed, Iterable) else [listed]
        for outcome in outcomes:
            try:
                chance, after, reward, ended = outcome
                chance = number("a probability", chance, TaskError, 0, 1)
                reward = number("a reward", reward, TaskError)
                # As an array or named tuple where the environment's own states are these.
                if isinstance(content, np.ndarray):
                    after = np.asarray(after, content.dtype)
                elif isinstance(content, tuple) and isinstance(after, np.ndarray | list | tuple):
                    after = getattr(content, "_make", tuple)(after)
                hash(_key(after))
            except (TypeError, ValueError) as error:
                raise TaskError(
                    "an outcome must be (probability, next state, reward, terminated) with finite "
                    f"numbers and a hashable state: action {action} in {content!r} lists "
                    f"{outcome!r}"
                ) from error
            total += chance
            if chance > 0:
                # A text of the state for every outcome would cost more than the rest.
                place = "" if type(ended) is bool else f": action {action} in {content!r}"
                ended = flag_of(ended, "terminated", place)
                yield self._reached(chance, after, reward, ended=ended)
        if outcomes and abs(total - 1) > SINGLE_PRECISION:
            raise TaskError(
                f"transition probabilities must sum to 1: action {action} in {content!r} sums to "
                f"{total:.10g}"
            )

    def look(self, reached: Reached) -> tuple[object, Words]:
        """Return the state, if it is an observation, and its components."""
        state = reached.content
        components = words_of_state(state) if self.parts is None else self.parts(state)
        return state if self.save is None else None, components

    def _reached(self, chance: float, state: object, reward: float, *, ended: bool) -> Reached:
        return Reached(chance, _key(state), state, reward, ended, truncated=False, env=self.env)


def _key(state: object) -> Hashable:
    """Return a hashable key, equal for equal states: arrays and lists become tuples."""
    if isinstance(state, np.ndarray):
        state = state.tolist()
    if isinstance(state, Mapping):
        return frozenset((key, _key(part)) for key, part in state.items())
    return tuple(map(_key, state)) if isinstance(state, list | tuple) else state
