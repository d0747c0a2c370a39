"""What the potential of an observation comes from: a function, a table, or a network's values."""

import operator
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import Any, ClassVar, TypeGuard

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete, MultiDiscrete
from gymnasium.vector.utils import iterate

from curricle.array_types import FloatArray, IntArray
from curricle.checks import numbers
from curricle.errors import PotentialError, SettingError
from curricle.learning.potential import MappedPotential, StateActionPotential, StatePotential
from curricle.learning.schedules import CONSTANT, Schedule
from curricle.tasks.observation_task import stack
from curricle.tasks.spaces import Space, whole
from curricle.tasks.task import generative_model
from curricle.transfer.observation_mapping import ValueSource
from curricle.transfer.potentials import ObservationPotential

Steps = int | IntArray

TaskPotential = StatePotential | StateActionPotential | MappedPotential
Potential = Callable[[Any], Any] | TaskPotential | ValueSource
"""A function of an observation, a potential over a task's states, or values of observations."""
NETWORK_ROUNDING = 1e-3
"""In single precision a network's output changes with the size of the batch, by up to this share on
a graphics processor, whose products of matrices have 11 bits."""


@dataclass(frozen=True, eq=False)
class FunctionSource:
    """A potential that is a function of an observation."""

    batched: ClassVar[bool] = False
    rounding: ClassVar[float] = 0.0  # relative difference allowed between two readings

    name: str
    function: Callable[[Any], Any]

    def one(self, observation: Any, step: int) -> float:
        """Return Phi_i(s, t)."""
        value = self.function(observation)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise PotentialError(
                f"a potential must return one number: {self.name!r} returned {value!r} at "
                f"observation {observation!r}"
            ) from None

    def many(self, rows: list[Any], stacked: Any, steps: Steps) -> Sequence[float] | FloatArray:
        """Return Phi_i of n observations, given one by one and, if any source needs it, stacked."""
        return [self.one(row, 0) for row in rows]


@dataclass(frozen=True, eq=False)
class BatchSource:
    """A potential that a function or a network computes for n stacked observations at once."""

    batched: ClassVar[bool] = True

    who: str
    function: Callable[[Any], Any]
    space: gymnasium.Space[Any]  # of one observation
    rounding: float = 0.0

    def one(self, observation: Any, step: int) -> float:
        """Return Phi_i(s, t)."""
        return float(self.many([observation], stack(self.space, [observation]), step)[0])

    def many(self, rows: list[Any], stacked: Any, steps: Steps) -> FloatArray:
        """Return Phi_i of n observations, (n,) float64."""
        values = numbers(f"what {self.who} returns", self.function(stacked), PotentialError)
        if values.shape != (len(rows),):
            raise PotentialError(
                f"what {self.who} returns must have shape {(len(rows),)}: got {values.shape}"
            )
        return values


@dataclass(frozen=True, eq=False)
class StateSource:
    """A potential over the states of a task; observations give the states' numbers."""

    rounding: ClassVar[float] = 0.0

    name: str
    potential: StatePotential | MappedPotential
    state_of: Callable[[Any], Any]
    n_states: int
    fixed: FloatArray | None  # (S,) Phi where it is an array that time does not change
    batched: bool

    def one(self, observation: Any, step: int) -> float:
        """Return Phi_i(s, t)."""
        given = self.state_of(observation)
        try:
            state = operator.index(given)
        except TypeError:
            raise SettingError(
                f"an observation's state must be a whole number: {self.name!r} got {given!r} for "
                f"observation {observation!r}"
            ) from None
        if not 0 <= state < self.n_states:
            raise self._no_state(state, f"observation {observation!r}")
        if self.fixed is not None:
            return self.fixed.item(state)
        return float(_values(self.potential, np.array([state]), step)[0])

    def many(self, rows: list[Any], stacked: Any, steps: Steps) -> Sequence[float] | FloatArray:
        """Return Phi_i of n observations, (n,) float64."""
        if not self.batched:
            return [self.one(*row) for row in zip(rows, each_step(steps), strict=False)]
        n = len(rows)
        states = whole(self.state_of(stacked), "the states of observations")
        if states.shape != (n,):
            raise SettingError(
                f"a batch of observations must have states of shape {(n,)}: {self.name!r} got "
                f"{states.shape}"
            )
        outside = (states < 0) | (states >= self.n_states)
        if np.count_nonzero(outside):
            place = int(np.flatnonzero(outside)[0])
            raise self._no_state(int(states[place]), f"observation {place} of {n} stacked")
        return _values(self.potential, states, steps) if self.fixed is None else self.fixed[states]

    def _no_state(self, state: int, place: str) -> SettingError:
        return SettingError(
            f"an observation's state must lie in 0..{self.n_states - 1}: {self.name!r} got {state} "
            f"for {place}"
        )


Source = FunctionSource | BatchSource | StateSource


def source(
    name: str,
    potential: Potential,
    space: gymnasium.Space[Any],
    encode: Callable[[Any], Any] | None,
    batched: bool,
) -> Source:
    """Return a potential, to be read from observations of a space.

    `encode` gives the state of an observation, for potentials over a task; `batched` is whether it
    and functions take stacked observations. Sources of values always take stacked ones.
    """
    if over_a_task(potential):
        if isinstance(potential, StateActionPotential):
            potential = potential.to_state()
        states = generative_model(potential.task).states
        state_of = _numbering(space, states) if encode is None else encode
        return StateSource(name, potential, state_of, states.size, _fixed(potential), batched)
    if isinstance(potential, ObservationPotential) and potential.task.observations != space:
        raise SettingError(
            f"a potential over observations must be read from those of its task: {name!r} is one "
            f"of {potential.task.observations} and gets {space}"
        )
    if isinstance(potential, ValueSource):
        return BatchSource(f"the values of {name!r}", potential.v, space, NETWORK_ROUNDING)
    if callable(potential) and batched:
        return BatchSource(f"a batched potential, {name!r},", potential, space)
    if callable(potential):
        return FunctionSource(name, potential)
    raise PotentialError(
        "a potential must be a function of an observation, a potential over a task or over "
        f"observations, or a source of values: {name!r} is {potential!r}"
    )


def over_a_task(potential: Any) -> TypeGuard[TaskPotential]:
    """Return whether a potential is over the states of a task."""
    return isinstance(potential, StatePotential | StateActionPotential | MappedPotential)


def unstack(space: gymnasium.Space[Any], stacked: Any) -> list[Any]:
    """Return stacked observations one by one; `space` is that of the n stacked."""
    if isinstance(stacked, np.ndarray):
        return list(stacked)  # as `iterate` does, and quicker
    return list(iterate(space, stacked))


def weights(weight: Schedule, steps: Steps) -> Any:
    """Return w(t) for all observations, or for each."""
    if weight.shape == CONSTANT:
        return weight.first
    if isinstance(steps, int):
        return weight(steps)
    return np.array([weight(step) for step in steps.tolist()])


def each_step(steps: Steps) -> Iterable[int]:
    """Return the step of each of many observations, endlessly where it is the same for all."""
    return repeat(steps) if isinstance(steps, int) else steps.tolist()


def _numbering(space: gymnasium.Space[Any], states: Space) -> Callable[[Any], Any]:
    """Return the function from an observation, or stacked ones, to numbers of a task's states."""
    if isinstance(space, Discrete) and space.n == states.size:
        return partial(_counted_from, int(space.start))
    if isinstance(space, MultiDiscrete) and tuple(space.nvec.tolist()) == states.shape:
        return partial(_components, states, space.start.tolist())
    if isinstance(space, gymnasium.spaces.Tuple) and all(isinstance(x, Discrete) for x in space):
        parts: Any = space.spaces
        if tuple(int(part.n) for part in parts) == states.shape:
            return partial(_components, states, [int(part.start) for part in parts])
    raise SettingError(
        f"observations must number the task's {states.size} states, as a whole or component by "
        f"component, or encode= must say how: got {space}"
    )


def _counted_from(start: int, observation: Any) -> Any:
    return observation - start


def _components(states: Space, starts: list[int], observation: Any) -> Any:
    """Return the states whose components an observation lists, each counted from its start."""
    parts = observation if isinstance(observation, tuple) else np.asarray(observation).T
    offsets = [np.asarray(part) - start for part, start in zip(parts, starts, strict=True)]
    if states.is_box:
        with suppress(ValueError):  # outside the box: encode says so
            return np.ravel_multi_index(tuple(offsets), states.shape)
    components = zip(states.components, offsets, strict=True)
    return states.encode(**{each.name: offset + each.low for each, offset in components})


def _fixed(potential: StatePotential | MappedPotential) -> FloatArray | None:
    if isinstance(potential, MappedPotential):
        return None
    alone = len(potential.values) == 1 and potential.weight.shape == CONSTANT
    return potential.at(0) if alone else None


def _values(
    potential: StatePotential | MappedPotential, states: IntArray, steps: Steps
) -> FloatArray:
    """Return Phi(s, t) of n states, (n,) float64."""
    if isinstance(potential, MappedPotential):
        phi = potential.rows(states).max(axis=1)
        terminal = generative_model(potential.task).terminal
        return phi if terminal is None else np.where(terminal[states], 0.0, phi)
    frame = np.searchsorted(potential.frame_steps, steps, side="right") - 1
    return np.asarray(weights(potential.weight, steps) * potential.values[frame, states])
