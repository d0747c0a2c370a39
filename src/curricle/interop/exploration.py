"""Breadth-first search for every state that an environment can reach."""

import math
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit

from curricle.checks import number
from curricle.errors import TaskError
from curricle.interop.states import (
    HARMLESS,
    Environment,
    StateAccess,
    Words,
    acts_as,
    kind_of,
    layers_of,
    restart,
    state_of,
    words_of_state,
)
from curricle.interop.tabulated_task import same_observation
from curricle.tasks.live import RETURNED
from curricle.tasks.mdp import SINGLE_PRECISION, number_of

MORE_RESETS = 8  # with other seeds, to see whether the states that they lead to differ
INTERVAL = 0.5  # seconds between two reports of progress


@dataclass(frozen=True)
class Progress:
    """How far a tabulation is: states found, states with all actions tried, outcomes, seconds."""

    states: int
    expanded: int
    transitions: int
    seconds: float

    def in_words(self, name: str) -> str:
        """Return the progress of the tabulation of `name`, as a line of text."""
        speed = self.transitions / max(self.seconds, 1e-9)
        return (
            f"tabulating {name}: {self.states:,} states, {self.expanded:,} done, {speed:,.0f} "
            "transitions a second"
        )


class Reached(NamedTuple):
    """An outcome of an action: the next state, its probability and its reward."""

    probability: float
    key: Hashable  # equal for equal states
    content: Any  # what the state is restored from
    reward: float
    terminated: bool
    truncated: bool


# What every action does in a state in which episodes are only ever truncated.
STAY = Reached(1.0, None, None, 0.0, terminated=False, truncated=False)


class Search:
    """All states that can be reached and all outcomes, breadth first, in the order of meeting."""

    def __init__(
        self,
        world: "World | ListedOutcomes",
        max_states: int,
        max_seconds: float,
        show: Callable[[Progress], Any],
    ):
        self.world, self.show = world, show
        self.max_states, self.max_seconds = max_states, max_seconds
        self.observations, self.components, self.terminal = list[Any](), list[Words](), list[bool]()
        self.start = dict[int, float]()  # the probability of each start
        self.first = list[int]()  # the state that each start leads to
        # An outcome is a place in each of four lists; a pair is state x A + action.
        self.pair, self.next_state = list[int](), list[int]()
        self.probability, self.reward = list[float](), list[float]()
        self.several = False  # whether resets lead to different states
        self.cut = 0  # states from which nothing goes on, as episodes are truncated there
        self.seconds = self.observing = 0.0  # in all, and for observations and words
        self._numbers = dict[tuple[Hashable, bool], int]()
        self._contents, self._queued, self._queue = list[Any](), list[bool](), deque[int]()

    def run(self) -> Self:
        """Search to the end and return the search; TaskError when a limit is reached before."""
        n_actions, seeds, expanded = self.world.n_actions, self.world.seeds, 0
        began = shown = time.perf_counter()
        for seed in seeds:
            state = self._number(self.world.start(seed))
            self.first.append(state)
            self.start[state] = self.start.get(state, 0.0) + 1 / len(seeds)
        while self._queue:
            state = self._queue.popleft()
            content, self._contents[state] = self._contents[state], None
            for action in range(n_actions):
                for reached in self.world.outcomes(content, action):
                    self._add(state * n_actions + action, self._number(reached), reached)
                now, n_states = time.perf_counter(), len(self._contents)
                if now - began > self.max_seconds:
                    raise TaskError(
                        f"a table must be complete within max_seconds, {self.max_seconds:g}: "
                        f"tabulating {self.world.name} had found {n_states:,} states by then and "
                        f"done {expanded:,} of them"
                    )
                if now - shown > INTERVAL:
                    shown = now
                    self.show(Progress(n_states, expanded, len(self.pair), now - began))
            expanded += 1
        staying = [s for s, queued in enumerate(self._queued) if not (queued or self.terminal[s])]
        for state in staying:
            for pair in range(state * n_actions, (state + 1) * n_actions):
                self._add(pair, state, STAY)
        self.cut = len(staying)
        resets = (self.world.start(max(seeds) + k) for k in range(1, MORE_RESETS + 1))
        known = (self._numbers.get((other.key, False)) in self.start for other in resets)
        self.several = len(self.start) > 1 or not all(known)
        self.seconds = time.perf_counter() - began
        return self

    def _number(self, reached: Reached) -> int:
        """Return the number of a state, which is a new number if the state is new."""
        name = reached.key, reached.terminated  # entered with the episode's end it is another
        state = self._numbers.get(name)
        if state is None:
            state = self._numbers[name] = len(self._contents)
            if state >= self.max_states:
                raise self._too_many()
            before = time.perf_counter()
            observation, components = self.world.look()
            self.observing += time.perf_counter() - before
            self._contents.append(reached.content)
            self._queued.append(False)
            self.terminal.append(reached.terminated)
            self.observations.append(deepcopy(observation))  # which a step may change
            self.components.append({**components, **words_of_state(observation, "_")})
        if not (self._queued[state] or reached.terminated or reached.truncated):
            self._contents[state] = reached.content
            self._queued[state] = True
            self._queue.append(state)
        return state

    def _add(self, pair: int, after: int, reached: Reached) -> None:
        self.pair.append(pair)
        self.next_state.append(after)
        self.probability.append(reached.probability)
        self.reward.append(reached.reward)

    def _too_many(self) -> TaskError:
        """Return the error of too many states, which names the component with most values."""
        everywhere = set(self.components[0]).intersection(*self.components)
        values = dict[str, set[Any]]()
        for components in self.components:
            parts = dict[str, list[int | str]]()
            for name, value in components.items():
                # Entries that some states lack are those of a list that grows.
                whole = name if name in everywhere else name.rstrip("0123456789").rstrip("_")
                parts.setdefault(whole, []).append(value)
            for name, part in parts.items():
                values.setdefault(name, set()).add(tuple(part))
        name = max(values, key=lambda name: len(values[name]), default="")
        hint = ", and most differ only in parts that are neither whole numbers nor words"
        different = {frozenset(components.items()) for components in self.components}
        if 2 * len(different) > len(self.components):
            hint = f", and {name!r} has the most values, {len(values[name]):,}"
        return TaskError(
            f"a table may have at most max_states, {self.max_states:,} states: tabulating "
            f"{self.world.name} found more{hint if len(self.components) > 1 else ''}"
        )


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
    transitions: int = 0
    drawing: int = 0  # pairs whose steps draw random numbers
    shared: Sequence[Any] = ()  # the global generators, if steps or resets draw from them
    # The generators' states, where nobody has drawn since; where they were left after a sample.
    _known: list[Any] | None = None
    _left: dict[tuple[int, type], Any] = field(default_factory=dict)
    _observed: Any = None  # what the last step or reset returned

    def __post_init__(self) -> None:
        apart = not self.access.copies
        self.core, self.views, self.acts = core_and_views(self.env, views_apart=apart)
        self.now = self.core
        self.access.prepare(self.env)

    def start(self, seed: int) -> Reached:
        """Return the state after a reset with a seed."""
        self._known = None
        if self.access.copies:
            self.now, _ = self.access.restore(self.core, (self.core, []))
        self._observed, _ = self._returned("reset", self.now.reset(seed=seed))
        _rewind_clocks(self.now)
        self.access.begin(self.now)
        return Reached(1.0, *self.access.save(self.now), 0.0, terminated=False, truncated=False)

    def outcomes(self, content: Any, action: int) -> Iterator[Reached]:
        """Yield an action's only outcome, or the outcome of every sample."""
        if self.transitions == self.n_actions:
            self.access.check()
        self.transitions += 1
        if self.samples is None:
            yield self._step(content, action)
            return
        for _ in range(self.samples):
            env, generators = self.access.restore(self.core, content)
            generators = [*generators, *self.shared]
            restart(generators, 0, self._left)  # with random numbers not used before
            self.now = env
            reached, self._observed = self._arrival(env, action)
            self._left |= {(k, kind_of(g)): state_of(g) for k, g in enumerate(generators)}
            yield reached

    def look(self) -> tuple[Any, Words]:
        """Return the observation and the components of the state that was yielded last."""
        seen = self.access.observation(self.now, self._observed)
        for view in self.views:
            seen = view.observation(seen)
        return seen, self.access.describe(self.now)

    def _step(self, content: Any, action: int) -> Reached:
        """Return the only outcome of an action in a saved state."""
        env, generators = self.access.restore(self.core, content)
        generators = [*generators, *self.shared]
        before = self._known if self._known is not None else [*map(state_of, generators)]
        first = self._arrival(env, action)
        after = [*map(state_of, generators)]
        drew = after != before
        self.drawing += drew
        for repetition in range(1, REPETITIONS if drew else 2):
            again, generators = self.access.restore(self.core, content)
            if drew:
                restart([*generators, *self.shared], repetition, {})
            self._check_repeated(first, self._arrival(again, action), action)
        # Where all is one environment its generators are now as they were.
        self._known = None if drew or self.access.copies else after
        # Where all is one environment it is in the same state now; else `env` is kept as the state.
        self.now = env
        reached, self._observed = first
        return reached

    def _arrival(self, env: Environment, action: int) -> tuple[Reached, Any]:
        """Return where a step leads, and the observation as the step returned it."""
        core_action = self.act(action)
        for wrapper in self.acts:
            core_action = wrapper.action(core_action)
        returned = self._returned("step", env.step(core_action))
        observed, reward, terminated, truncated, _ = returned
        _rewind_clocks(env)
        earned = number_of(reward)
        if not math.isfinite(earned):
            raise TaskError(f"a reward must be a finite number: got {reward!r} from {self.name}")
        chance = 1.0 if self.samples is None else 1 / self.samples
        saved = self.access.save(env)
        return Reached(chance, *saved, earned, bool(terminated), bool(truncated)), observed

    def _returned(self, by: str, returned: Any) -> tuple[Any, ...]:
        """Return the result of a reset or a step; TaskError unless it has the right parts."""
        if not isinstance(returned, tuple) or len(returned) != len(RETURNED[by]):
            parts = ", ".join(RETURNED[by])
            raise TaskError(f"a {by} must return ({parts}): got {returned!r} from {self.name}")
        return returned

    def _check_repeated(
        self, first: tuple[Reached, Any], again: tuple[Reached, Any], action: int
    ) -> None:
        (reached, observed), (repeated, observed_again) = first, again
        differing = ""
        if reached.key != repeated.key:
            differing = "state"
        elif reached[3:] != repeated[3:]:
            differing = "reward or end"
        elif not same_observation(observed, observed_again):
            differing = "observation"
        if differing:
            raise TaskError(
                "steps must be deterministic to be tabulated, unless outcomes are listed "
                f"(outcomes=) or estimated (samples=){self.access.hint}: action {action}, repeated "
                f"from one state of {self.name}, led to another {differing}"
            )


def time_limit_of(env: Environment) -> int | None:
    """Return the steps after which an environment truncates: the least limit of its wrappers."""
    limits = [layer._max_episode_steps for layer in layers_of(env) if isinstance(layer, TimeLimit)]
    return min(limits, default=None)


def _rewind_clocks(env: Environment) -> None:
    """Set back the clocks of time limits: time is no part of a state."""
    for layer in layers_of(env):
        if isinstance(layer, TimeLimit):
            layer._elapsed_steps = LONG_AGO  # type: ignore[assignment]


def core_and_views(
    env: Environment, *, views_apart: bool
) -> tuple[Environment, list[Any], list[Any]]:
    """Return the part of an environment that is stepped, and the wrappers apart from it."""
    views, acts = list[Any](), list[Any]()  # from the innermost; from the outermost
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
    _state: Any = None  # the last that was reached

    def start(self, seed: int) -> Reached:
        """Return the state after a reset."""
        observed, _ = self.env.reset(seed=seed)
        state = deepcopy(observed) if self.save is None else self.save(self.env.unwrapped)
        return self._reached(1.0, state, 0.0, ended=False)

    def outcomes(self, content: Any, action: int) -> Iterable[Reached]:
        """Yield the outcomes that are possible."""
        self.transitions += 1
        total = 0.0
        listed = self.listed(content, action)
        for outcome in listed if isinstance(listed, Iterable) else [listed]:
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
                yield self._reached(chance, after, reward, ended=bool(ended))
        if abs(total - 1) > SINGLE_PRECISION:
            raise TaskError(
                f"transition probabilities must sum to 1: action {action} in {content!r} sums to "
                f"{total:.10g}"
            )

    def look(self) -> tuple[Any, Words]:
        """Return the state, if it is an observation, and its components."""
        state = self._state
        components = words_of_state(state) if self.parts is None else self.parts(state)
        return state if self.save is None else None, components

    def _reached(self, chance: float, state: Any, reward: float, *, ended: bool) -> Reached:
        self._state = state
        return Reached(chance, _key(state), state, reward, ended, truncated=False)


def _key(state: Any) -> Any:
    """Return a hashable key, equal for equal states: arrays and lists become tuples."""
    if isinstance(state, np.ndarray):
        state = state.tolist()
    if isinstance(state, Mapping):
        return frozenset((key, _key(part)) for key, part in state.items())
    return tuple(map(_key, state)) if isinstance(state, list | tuple) else state
