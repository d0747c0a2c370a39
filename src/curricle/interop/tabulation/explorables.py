"""What is explored: an environment's own steps, samples of them, or outcomes that are listed."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any

from curricle.checks import number
from curricle.errors import TaskError
from curricle.interop.tabulation.exploration import Reached
from curricle.interop.tabulation.state_access import Environment, Words, words_of_state
from curricle.interop.tabulation.world import Arrival, World
from curricle.tasks.outcomes import PROBABILITY_TOLERANCE

Listed = Callable[[Any, int], Sequence[tuple[float, Any, float, bool]]]
"""From a state and an action to (probability, next state, reward, terminated) of each outcome."""


class StepOutcomes:
    """The outcomes of an environment's own steps: one of each pair, or estimated from samples."""

    def __init__(self, world: World, n_actions: int, seeds: Sequence[int], samples: int | None):
        self.world, self.n_actions, self.seeds = world, n_actions, seeds
        self.name, self.samples, self.transitions = world.name, samples, 0
        self._last: Arrival | None = None

    def starts(self) -> Iterator[Reached]:
        """Yield the state after each reset."""
        for seed in self.seeds:
            yield self._reached(self.world.start(seed), 1 / len(self.seeds))

    def outcomes(self, content: Any, action: int) -> Iterator[Reached]:
        """Yield the one outcome, or those met in the samples, as often as they were met."""
        self.transitions += 1
        if self.samples is None:
            yield self._reached(self.world.step(content, action), 1.0)
            return
        for _ in range(self.samples):
            yield self._reached(self.world.sample(content, action), 1 / self.samples)

    def look(self) -> tuple[Any, Words]:
        """Return the observation and the words of the state that was yielded last."""
        assert self._last is not None, "a state has been yielded"
        return self.world.observation(self._last), self.world.describe()

    def _reached(self, arrival: Arrival, probability: float) -> Reached:
        self._last = arrival
        state, reward, terminated, truncated, _ = arrival
        return Reached(probability, *state, reward, terminated, truncated)


class ListedOutcomes:
    """Outcomes that a function or a table lists, of states that are hashable."""

    def __init__(
        self,
        env: Environment,
        listed: Listed,
        n_actions: int,
        seeds: Sequence[int],
        name: str,
        save: Callable[[Any], Hashable] | None = None,
        words: Callable[[Any], Words] | None = None,
    ):
        self.env, self.listed, self.n_actions, self.seeds = env, listed, n_actions, seeds
        self.save, self.words, self.name, self.transitions = save, words, name, 0
        self._last: Any = None

    def starts(self) -> Iterator[Reached]:
        """Yield the state after each reset."""
        for seed in self.seeds:
            observed, _ = self.env.reset(seed=seed)
            state = observed if self.save is None else self.save(self.env.unwrapped)
            yield self._reached(1 / len(self.seeds), state, 0.0, ended=False)

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
                hash(after)
            except (TypeError, ValueError) as error:
                raise TaskError(
                    "an outcome must be (probability, next state, reward, terminated) with finite "
                    f"numbers and a hashable state: action {action} in {content!r} lists "
                    f"{outcome!r}"
                ) from error
            total += chance
            if chance > 0:
                yield self._reached(chance, after, reward, ended=bool(ended))
        if abs(total - 1) > PROBABILITY_TOLERANCE:
            raise TaskError(
                f"transition probabilities must sum to 1: action {action} in {content!r} sums to "
                f"{total:.10g}"
            )

    def look(self) -> tuple[Any, Words]:
        """Return the state, if it is an observation, and its words."""
        state = self._last
        words = words_of_state(state) if self.words is None else self.words(state)
        return state if self.save is None else None, words

    def _reached(self, chance: float, state: Any, reward: float, *, ended: bool) -> Reached:
        self._last = state
        return Reached(chance, state, state, reward, ended, truncated=False)
