"""Every state that can be reached, breadth first."""

import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from curricle.errors import TaskError
from curricle.interop.tabulation.state_access import Words

INTERVAL = 0.5
"""Seconds between two reports of progress."""


@dataclass(frozen=True)
class Progress:
    """How far a tabulation is.

    Attributes
    ----------
    states : int
        Those found so far.
    expanded : int
        Those all of whose actions have been taken.
    transitions : int
        Outcomes found so far.
    seconds : float
        Since the tabulation began.
    """

    states: int
    expanded: int
    transitions: int
    seconds: float

    def in_words(self, name: str) -> str:
        """Return a line to be shown.

        Examples
        --------
        >>> Progress(1200, 300, 2100, 1.5).in_words("maze")
        'tabulating maze: 1,200 states, 300 done, 1,400 transitions a second'
        """
        speed = self.transitions / max(self.seconds, 1e-9)
        return (
            f"tabulating {name}: {self.states:,} states, {self.expanded:,} done, {speed:,.0f} "
            "transitions a second"
        )


class Reached(NamedTuple):
    """One outcome of an action: where it leads, and how likely."""

    probability: float
    key: Hashable
    content: Any
    reward: float
    terminated: bool
    truncated: bool


STAY = Reached(1.0, None, None, 0.0, terminated=False, truncated=False)
"""What every action does in a state in which episodes are only ever truncated."""


class Explorable(Protocol):
    """What a search needs of an environment.

    After `starts` and `outcomes` have yielded a state it can be looked at until the next is asked
    for.
    """

    name: str
    n_actions: int

    def starts(self) -> Iterable[Reached]:
        """Yield the states in which episodes start, each with its probability."""

    def outcomes(self, content: Any, action: int) -> Iterable[Reached]:
        """Yield the outcomes of an action in a state."""

    def look(self) -> tuple[Any, Words]:
        """Return what is observed in the state yielded last, and the state in words."""


class Budget(NamedTuple):
    """What a search may use."""

    states: int
    seconds: float
    show: Callable[[Progress], Any] | None = None


@dataclass
class Explored:
    """All states in the order in which they were found, and all outcomes.

    An outcome is a place in `pair` (state x A + action), `next_state`, `probability` and `reward`.
    """

    observations: list[Any] = field(default_factory=list)
    words: list[Words] = field(default_factory=list)
    terminal: list[bool] = field(default_factory=list)
    start: dict[int, float] = field(default_factory=dict)
    first: list[int] = field(default_factory=list)  # the state that each start leads to
    pair: list[int] = field(default_factory=list)
    next_state: list[int] = field(default_factory=list)
    probability: list[float] = field(default_factory=list)
    reward: list[float] = field(default_factory=list)
    cut: int = 0  # states from which nothing goes on, as episodes are truncated there
    seconds: float = 0.0
    observing: float = 0.0  # of them those that observations and words took


def explore(world: Explorable, budget: Budget) -> Explored:
    """Return every state that can be reached, breadth first from the start.

    Entering a state with the end of the episode, and entering it without, are two states. A state
    that is only entered by truncation is not gone on from: every action leads back to it, with
    reward 0.

    Raises
    ------
    TaskError
        When a budget does not suffice.
    """
    search = _Search(world, budget)
    search.run()
    return search.found


class _Search:
    def __init__(self, world: Explorable, budget: Budget):
        self.world, self.budget = world, budget
        self.found = Explored()
        self.numbers = dict[tuple[Hashable, bool], int]()
        self.contents = list[Any]()
        self.queued = list[bool]()
        self.queue = deque[int]()
        self.began = self.shown = time.perf_counter()
        self.expanded = 0

    def run(self) -> None:
        found, n_actions = self.found, self.world.n_actions
        for reached in self.world.starts():
            state = self._number(reached)
            found.first.append(state)
            found.start[state] = found.start.get(state, 0.0) + reached.probability
        while self.queue:
            state = self.queue.popleft()
            content, self.contents[state] = self.contents[state], None
            for action in range(n_actions):
                for reached in self.world.outcomes(content, action):
                    after = self._number(reached)
                    self._add(state * n_actions + action, after, reached)
                self._check_time()
            self.expanded += 1
        staying = [s for s, queued in enumerate(self.queued) if not (queued or found.terminal[s])]
        for state in staying:
            for action in range(n_actions):
                self._add(state * n_actions + action, state, STAY)
        found.cut = len(staying)
        found.seconds = time.perf_counter() - self.began

    def _number(self, reached: Reached) -> int:
        """Return the number of a state, a new one if it was not met before."""
        name = reached.key, reached.terminated
        state = self.numbers.get(name)
        if state is None:
            state = self.numbers[name] = len(self.contents)
            if state >= self.budget.states:
                raise self._too_many()
            before = time.perf_counter()
            observation, words = self.world.look()
            self.found.observing += time.perf_counter() - before
            self.contents.append(reached.content)
            self.queued.append(False)
            self.found.terminal.append(reached.terminated)
            self.found.observations.append(observation)
            self.found.words.append(words)
        if not (self.queued[state] or reached.terminated or reached.truncated):
            self.contents[state] = reached.content
            self.queued[state] = True
            self.queue.append(state)
        return state

    def _add(self, pair: int, after: int, reached: Reached) -> None:
        found = self.found
        found.pair.append(pair)
        found.next_state.append(after)
        found.probability.append(reached.probability)
        found.reward.append(reached.reward)

    def _check_time(self) -> None:
        now = time.perf_counter()
        if now - self.began > self.budget.seconds:
            raise TaskError(
                f"a table must be complete within max_seconds, {self.budget.seconds:g}: tabulating "
                f"{self.world.name} had found {len(self.contents):,} states by then and done "
                f"{self.expanded:,} of them"
            )
        if self.budget.show is not None and now - self.shown > INTERVAL:
            self.shown = now
            transitions = len(self.found.pair)
            self.budget.show(
                Progress(len(self.contents), self.expanded, transitions, now - self.began)
            )

    def _too_many(self) -> TaskError:
        """Return the error of a state budget, which says in what states differ most."""
        words = self.found.words
        everywhere = set(words[0]).intersection(*words)
        values = dict[str, set[Any]]()
        for each in words:
            parts = dict[str, list[int | str]]()
            for name, value in each.items():
                # Entries that some states lack are those of a list that grows.
                whole = name if name in everywhere else name.rstrip("0123456789").rstrip("_")
                parts.setdefault(whole, []).append(value)
            for name, part in parts.items():
                values.setdefault(name, set()).add(tuple(part))
        name = max(values, key=lambda one: len(values[one]), default="")
        hint = ", most of which differ in what is no whole number or word"
        if 2 * len({frozenset(each.items()) for each in words}) > len(words):
            hint = f", which differ most in {name!r}, of {len(values[name]):,} values"
        return TaskError(
            f"a table may have at most max_states, {self.budget.states:,} states: tabulating "
            f"{self.world.name} found more{hint if len(words) > 1 else ''}"
        )
