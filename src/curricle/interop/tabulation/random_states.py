"""Random generators that an environment holds: their states, read, compared and set."""

import random
from collections.abc import Sequence
from typing import Any

import numpy as np

GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
SALT = 2718
"""Begins the seeds of repeated steps, so that they are not those of the environment's resets."""


class RandomStates:
    """States to start generators from, in place; the same for the same kind and repetition."""

    def __init__(self) -> None:
        self._starts = dict[tuple[int, int, type], Any]()
        self._streams = dict[tuple[int, type], Any]()

    def restart(self, generators: Sequence[Any], repetition: int) -> None:
        """Let each generator draw other numbers than in other repetitions."""
        for place, each in enumerate(generators):
            key = place, repetition, _kind(each)
            if key not in self._starts:
                self._starts[key] = _fresh(each, place, repetition)
            _set(each, self._starts[key])

    def resume(self, generators: Sequence[Any]) -> None:
        """Let each generator go on where the generator in its place was left."""
        for place, each in enumerate(generators):
            key = place, _kind(each)
            _set(each, self._streams.get(key) or _fresh(each, place, 0))

    def leave(self, generators: Sequence[Any]) -> None:
        """Note where each generator is left."""
        for place, each in enumerate(generators):
            self._streams[place, _kind(each)] = state_of(each)


def state_of(generator: Any) -> Any:
    """Return a generator's state, to be compared.

    Examples
    --------
    >>> one, other = np.random.default_rng(0), np.random.default_rng(0)
    >>> _ = one.random()
    >>> state_of(one) == state_of(other)
    False
    """
    if isinstance(generator, np.random.Generator):
        return generator.bit_generator.state
    if isinstance(generator, np.random.RandomState):
        name, keys, *rest = generator.get_state()
        return name, tuple(np.asarray(keys).tolist()), *rest
    return generator.getstate()


def _set(generator: Any, state: Any) -> None:
    if isinstance(generator, np.random.Generator):
        generator.bit_generator.state = state
    elif isinstance(generator, np.random.RandomState):
        generator.set_state(state)
    else:
        generator.setstate(state)


def _fresh(generator: Any, place: int, repetition: int) -> Any:
    """Return the state of a new generator of the same kind."""
    seed = SALT + 1000 * place + repetition
    if isinstance(generator, np.random.Generator):
        return type(generator.bit_generator)(seed).state
    if isinstance(generator, np.random.RandomState):
        return state_of(np.random.RandomState(seed))
    return random.Random(seed).getstate()


def _kind(generator: Any) -> type:
    numpy = isinstance(generator, np.random.Generator)
    return type(generator.bit_generator) if numpy else type(generator)
