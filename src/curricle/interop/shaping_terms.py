"""Potentials read from observations: what shaping one environment and shaping many share.

The potential of an observation is Phi(s, t) = w(t) g(Phi_1(s, t), ..., Phi_N(s, t)), where t counts
the steps taken through the wrapper, episode after episode.
"""

import math
import operator
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeGuard

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import concatenate, create_empty_array

from curricle.checks import instance, number, numbers
from curricle.errors import PotentialError, SettingError
from curricle.learning.potential import MappedPotential, StateActionPotential, StatePotential
from curricle.learning.schedules import CONSTANT, Schedule, schedule
from curricle.tasks.spaces import Space, whole
from curricle.tasks.task import dynamics
from curricle.transfer import aggregation
from curricle.transfer.aggregation import Aggregate

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Steps = int | npt.NDArray[np.int64]

TaskPotential = StatePotential | StateActionPotential | MappedPotential
Potential = Callable[[Any], Any] | TaskPotential
"""A function of an observation, or a potential over the states of a task."""

ALONE = "potential"
"""The name of a potential that was given without one."""


class Source(Protocol):
    """One potential, read from observations."""

    def one(self, observation: Any, step: int) -> float:
        """Return Phi_i(s, t)."""

    def many(self, observations: Any, wanted: BoolArray, steps: Steps) -> FloatArray:
        """Return Phi_i of stacked observations, (n,) float64; anything where it is not wanted."""


@dataclass(frozen=True, eq=False)
class FunctionSource:
    """A potential that is a function of an observation, or of n stacked ones."""

    name: str
    function: Callable[[Any], Any]

    def one(self, observation: Any, step: int) -> float:
        """Return Phi_i(s)."""
        value = self.function(observation)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise PotentialError(
                f"a potential must return one number: {self.name!r} returned {value!r} at "
                f"observation {observation!r}"
            ) from None

    def many(self, observations: Any, wanted: BoolArray, steps: Steps) -> FloatArray:
        """Return Phi_i of stacked observations, (n,) float64."""
        what = f"what a batched potential, {self.name!r}, returns"
        values = numbers(what, self.function(observations), PotentialError)
        if values.shape != wanted.shape:
            raise PotentialError(f"{what} must have shape {wanted.shape}: got {values.shape}")
        return values


@dataclass(frozen=True, eq=False)
class StateSource:
    """A potential over the states of a task, whose numbers are read off the observations."""

    name: str
    potential: StatePotential | MappedPotential
    state_of: Callable[[Any], Any]
    n_states: int
    fixed: FloatArray | None  # (S,) Phi where it is an array that time does not change

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
            return float(self.fixed[state])
        return float(_values(self.potential, np.array([state]), step)[0])

    def many(self, observations: Any, wanted: BoolArray, steps: Steps) -> FloatArray:
        """Return Phi_i of stacked observations, (n,) float64; anything where it is not wanted."""
        states = whole(self.state_of(observations), "the states of observations")
        if states.shape != wanted.shape:
            raise SettingError(
                f"a batch of observations has states of shape {wanted.shape}: {self.name!r} got "
                f"{states.shape}"
            )
        outside = wanted & ((states < 0) | (states >= self.n_states))
        if outside.any():
            place = int(np.flatnonzero(outside)[0])
            raise self._no_state(int(states[place]), f"sub-environment {place}")
        states = np.where(wanted, states, 0)
        return _values(self.potential, states, steps) if self.fixed is None else self.fixed[states]

    def _no_state(self, state: int, place: str) -> SettingError:
        return SettingError(
            f"an observation's state must lie in 0..{self.n_states - 1}: {self.name!r} got {state} "
            f"for {place}"
        )


@dataclass(frozen=True, eq=False)
class ObservedPotential:
    """N named potentials of an observation, what they come to together, and their discount.

    Parameters
    ----------
    space : gymnasium.Space
        Of one observation.
    sources : dict of str to Source
    discount : float
    weight : Schedule
        w(t).
    aggregate : callable, optional
        g, (N, S, A) -> (S, A), called with n observations as S and with A = 1; None where the
        only source is the whole.
    batched : bool
        Whether :meth:`many` reads stacked observations, or each on its own.
    tolerance : float, optional
        How far an episode's shaping may be from telescoping, as a share of the largest size of
        Phi in it.
    """

    space: gymnasium.Space[Any]
    sources: dict[str, Source]
    discount: float
    weight: Schedule
    aggregate: Aggregate | None
    batched: bool
    tolerance: float | None

    def one(self, observation: Any, step: int) -> list[float]:
        """Return Phi(s, t) and, after it, w(t) Phi_i(s, t) of each source.

        Raises
        ------
        PotentialError
            When a source's value is not finite.
        """
        values = [source.one(observation, step) for source in self.sources.values()]
        for name, value in zip(self.sources, values, strict=True):
            if not math.isfinite(value):
                raise _not_finite(name, value, observation)
        together = values[0]
        if self.aggregate is not None:
            column = np.array(values).reshape(-1, 1, 1)
            together = float(aggregation.aggregate(self.aggregate, column)[0, 0])
        weight = _weights(self.weight, step)
        return [weight * together, *(weight * value for value in values)]

    def many(
        self, rows: list[Any], wanted: BoolArray, steps: Steps, stacked: Any = None
    ) -> FloatArray:
        """Return the same of n observations, (1 + N, n) float64; 0 where it is not wanted.

        `steps` is t for all of them, or one for each, (n,) int64; `stacked` are the observations as
        a vector environment hands them out, where they are at hand.
        """
        if self.batched and stacked is None:
            room: Any = create_empty_array(self.space, len(rows))
            stacked = concatenate(self.space, rows, room)
        values = np.zeros((len(self.sources), len(rows)))
        for row, source in zip(values, self.sources.values(), strict=True):
            if self.batched:
                row[wanted] = source.many(stacked, wanted, steps)[wanted]
            else:
                for i in np.flatnonzero(wanted).tolist():
                    row[i] = source.one(rows[i], steps if isinstance(steps, int) else int(steps[i]))
        if not np.isfinite(values).all():
            source, i = np.argwhere(~np.isfinite(values))[0].tolist()
            raise _not_finite(list(self.sources)[source], values[source, i], rows[i])
        together = values[0]
        if self.aggregate is not None:
            together = np.zeros(len(rows))
            some = aggregation.aggregate(self.aggregate, values[:, wanted, None])
            together[wanted] = some[:, 0]
        return np.asarray(_weights(self.weight, steps) * np.vstack([together, values]))

    def check_telescoping(self, residual: float, largest: float, place: str) -> None:
        """Raise PotentialError when an episode's shaping does not come to what it must."""
        if self.tolerance is not None and abs(residual) > self.tolerance * largest:
            raise PotentialError(
                "an episode's shaping must come to gamma^T Phi(s_T) - Phi(s_0), as it does where "
                f"Phi depends on the observation alone: it is off by {residual:g} {place}, where "
                f"the size of Phi was up to {largest:g}"
            )


def observed_potential(
    potential: Potential | Mapping[str, Potential],
    space: gymnasium.Space[Any],
    *,
    discount: float | None,
    weight: float | Schedule,
    aggregate: Aggregate | None,
    encode: Callable[[Any], Any] | None,
    tolerance: float | None,
    batched: bool = False,
) -> ObservedPotential:
    """Return potentials as they are read from observations of a space.

    Raises
    ------
    PotentialError
        When a potential is neither a function nor one over a task, or there is none.
    SettingError
        When the discount is not stated or differs, or when the observations do not number the
        states of a potential's task.

    Examples
    --------
    >>> from gymnasium.spaces import Box
    >>> height = observed_potential(lambda x: x[0], Box(-1, 1), discount=0.9, weight=2.0,
    ...                             aggregate=None, encode=None, tolerance=1e-6)
    >>> height.one(np.array([0.5]), step=0)
    [1.0, 1.0]
    """
    named = potential if isinstance(potential, Mapping) else {ALONE: potential}
    if not named:
        raise PotentialError("shaping needs a potential: got none")
    for name in named:
        instance("a potential's name", name, str, SettingError)
    if tolerance is not None:
        number("tolerance", tolerance, SettingError, 0)
    if encode is not None and not any(map(_over_a_task, named.values())):
        raise SettingError("encode must be left out where no potential is one over a task")
    if aggregate is None and len(named) > 1:
        aggregate = aggregation.mean
    return ObservedPotential(
        space=space,
        sources={name: _source(name, each, space, encode) for name, each in named.items()},
        discount=one_discount(named, discount),
        weight=schedule(weight),
        aggregate=aggregate,
        batched=batched,
        tolerance=tolerance,
    )


def one_discount(potentials: Mapping[str, Potential], discount: float | None) -> float:
    """Return the discount that the potentials' tasks and the caller state, or raise SettingError.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> one_discount({"end": StatePotential(GridWorld("S.T"), [0, 1, 2])}, None)
    0.99
    """
    stated = {
        f"the task of {name!r}": dynamics(each.task).discount
        for name, each in potentials.items()
        if _over_a_task(each)
    }
    if discount is not None:
        stated["the argument"] = number("discount", discount, SettingError, 0, 1)
    if not stated:
        raise SettingError("a discount must be given where no potential has a task that states it")
    if len(set(stated.values())) > 1:
        each = ", ".join(f"{value:g} by {name}" for name, value in stated.items())
        raise SettingError(f"there must be one discount: got {each}")
    return next(iter(stated.values()))


def check_unshaped(info: Mapping[str, Any]) -> None:
    """Raise SettingError when a step's info says that its reward has been shaped already."""
    if "shaping" in info:
        raise SettingError(
            "an environment must be shaped once, by all its potentials in one dict: its info has "
            "'shaping' already"
        )


def _source(
    name: str,
    potential: Potential,
    space: gymnasium.Space[Any],
    encode: Callable[[Any], Any] | None,
) -> Source:
    if _over_a_task(potential):
        if isinstance(potential, StateActionPotential):
            potential = potential.to_state()
        states = dynamics(potential.task).states
        state_of = _numbering(space, states) if encode is None else encode
        return StateSource(name, potential, state_of, states.size, _fixed(potential))
    if not callable(potential):
        raise PotentialError(
            "a potential must be a function of an observation or a potential over a task: "
            f"{name!r} is {potential!r}"
        )
    return FunctionSource(name, potential)


def _over_a_task(potential: Potential) -> TypeGuard[TaskPotential]:
    return isinstance(potential, StatePotential | StateActionPotential | MappedPotential)


def _numbering(space: gymnasium.Space[Any], states: Space) -> Callable[[Any], Any]:
    """Return how an observation, or a stack of them, numbers the states of a task."""
    spaces = gymnasium.spaces
    if isinstance(space, spaces.Discrete) and space.n == states.size:
        return partial(_counted_from, space.start)
    if isinstance(space, spaces.MultiDiscrete) and tuple(space.nvec.tolist()) == states.shape:
        return partial(_components, states, space.start.tolist())
    if isinstance(space, spaces.Tuple) and all(isinstance(x, spaces.Discrete) for x in space):
        parts: Any = space.spaces
        if tuple(int(part.n) for part in parts) == states.shape:
            return partial(_components, states, [int(part.start) for part in parts])
    raise SettingError(
        f"observations must number the task's {states.size} states, as a whole or component by "
        f"component, or encode= must say how: got {space}"
    )


def _counted_from(start: Any, observation: Any) -> Any:
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
    potential: StatePotential | MappedPotential, states: npt.NDArray[np.int64], steps: Steps
) -> FloatArray:
    """Return Phi(s, t) of n states, (n,) float64."""
    if isinstance(potential, MappedPotential):
        phi, terminal = potential.rows(states).max(axis=1), dynamics(potential.task).terminal
        return phi if terminal is None else np.where(terminal[states], 0.0, phi)
    frame = np.searchsorted(potential.frame_steps, steps, side="right") - 1
    return np.asarray(_weights(potential.weight, steps) * potential.values[frame, states])


def _weights(weight: Schedule, steps: Steps) -> Any:
    """Return w(t) for all observations, or for each."""
    if weight.shape == CONSTANT:
        return weight.first
    if isinstance(steps, int):
        return weight(steps)
    return np.array([weight(int(step)) for step in steps])


def _not_finite(name: str, value: float, observation: Any) -> PotentialError:
    return PotentialError(
        f"a potential must be finite: {name!r} is {value} at observation {observation!r}"
    )
