"""Potential-based shaping of any Gymnasium environment, one or many, for any algorithm.

Ng, Harada and Russell 1999 (paper E2): F = gamma Phi(s') - Phi(s), added to the reward, changes no
optimal policy. That holds for an episode that ends only if the potential of a terminal state is 0
(Grzes 2017); an episode that is cut off has not reached a terminal state and keeps Phi(s').

Phi(s, t) = w(t) g(Phi_1(s, t), ..., Phi_N(s, t)): named sources, an aggregate, a weight and one
discount. t counts the steps taken through the wrapper, episode after episode.
"""

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, SupportsFloat, TypeGuard

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete, MultiDiscrete
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import iterate

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import instance, number, numbers
from curricle.errors import PotentialError, SettingError
from curricle.learning.potential import MappedPotential, StateActionPotential, StatePotential
from curricle.learning.schedules import CONSTANT, Schedule, schedule
from curricle.tasks.observation_task import stack
from curricle.tasks.spaces import Space, whole
from curricle.tasks.task import generative_model
from curricle.transfer import aggregation
from curricle.transfer.aggregation import Aggregate
from curricle.transfer.observation_mapping import ValueSource
from curricle.transfer.potentials import ObservationPotential

if TYPE_CHECKING:
    AnyVectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
else:  # it takes types only in newer versions of Gymnasium
    AnyVectorWrapper = VectorWrapper


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
        return float(self.many(1, stack(self.space, [observation]), step)[0])

    def many(self, n: int, stacked: Any, steps: Steps) -> FloatArray:
        """Return Phi_i of n observations, (n,) float64."""
        values = numbers(f"what {self.who} returns", self.function(stacked), PotentialError)
        if values.shape != (n,):
            raise PotentialError(
                f"what {self.who} returns must have shape {(n,)}: got {values.shape}"
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

    def many(self, n: int, stacked: Any, steps: Steps) -> FloatArray:
        """Return Phi_i of n observations, (n,) float64."""
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


Finals = Callable[[int], Any]
"""The observation at which a sub-environment's episode was cut off, None if unknown."""


def _one_discount(potentials: Mapping[str, Potential], discount: float | None) -> float:
    """Return the one discount that the potentials' tasks and the caller state."""
    stated = {}
    for name, each in potentials.items():
        if over_a_task(each):
            stated[f"the task of {name!r}"] = generative_model(each.task).discount
        elif isinstance(each, ObservationPotential):
            stated[f"the task of {name!r}"] = each.task.discount
    if discount is not None:
        stated["the argument"] = number("discount", discount, SettingError, 0, 1)
    if not stated:
        raise SettingError("a discount must be given where no potential has a task that states it")
    if len(set(stated.values())) > 1:
        each_one = ", ".join(f"{value:g} by {name}" for name, value in stated.items())
        raise SettingError(f"there must be one discount: got {each_one}")
    return next(iter(stated.values()))


class ShapingPotential:
    """Phi of observations of a space, with what each of its N named sources gives."""

    def __init__(
        self,
        potential: Potential | Mapping[str, Potential],
        space: gymnasium.Space[Any],  # of one observation
        *,
        discount: float | None,
        weight: float | Schedule,
        aggregate: Aggregate | None,
        encode: Callable[[Any], Any] | None,
        tolerance: float | None,
        batched: bool = False,
    ):
        named = potential if isinstance(potential, Mapping) else {"potential": potential}
        if not named:
            raise PotentialError("shaping needs a potential: got none")
        for name in named:
            instance("a potential's name", name, str, SettingError)
        if tolerance is not None:
            number("tolerance", tolerance, SettingError, 0)
        if encode is not None and not any(map(over_a_task, named.values())):
            raise SettingError("encode must be left out where no potential is one over a task")
        if aggregate is None and len(named) > 1:
            aggregate = aggregation.mean
        self.space = space
        self.sources = {
            name: source(name, each, space, encode, batched) for name, each in named.items()
        }
        self.discount = _one_discount(named, discount)
        self.weight = schedule(weight)  # w(t)
        self.aggregate = aggregate  # g, called with n observations as S and A = 1
        # The largest telescoping residual allowed, as a share of the largest |Phi|.
        self.allowed = math.inf
        if tolerance is not None:
            self.allowed = max(tolerance, *(each.rounding for each in self.sources.values()))
        self._batched = any(each.batched for each in self.sources.values())

    def one(self, observation: Any, step: int) -> list[float]:
        """Return Phi(s, t) and, after it, w(t) Phi_i(s, t) of each source, all finite."""
        values = []
        for name, each in self.sources.items():
            value = each.one(observation, step)
            if not math.isfinite(value):
                raise _not_finite(name, value, observation)
            values.append(value)
        together = values[0]
        if self.aggregate is not None:
            together = aggregation.aggregate_numbers(self.aggregate, values)
        weight = weights(self.weight, step)
        return [weight * together, *[weight * value for value in values]]

    def each(self, rows: list[Any], steps: Steps, stacked: Any = None) -> list[list[float]]:
        """Return :meth:`one` of each of n observations, in one batch if some source is batched.

        `steps` is t of all, or of each, (n,) int64; `stacked` are the observations as a vector
        environment stacks them, if at hand.
        """
        if not self._batched or not rows:
            return [self.one(*row) for row in zip(rows, each_step(steps), strict=False)]
        n = len(rows)
        stacked = stack(self.space, rows) if stacked is None else stacked
        values = np.empty((1 + len(self.sources), n))
        for i, (name, each) in enumerate(self.sources.items(), start=1):
            if isinstance(each, FunctionSource) or not each.batched:
                values[i] = [each.one(*row) for row in zip(rows, each_step(steps), strict=False)]
            else:
                values[i] = each.many(n, stacked, steps)
            finite = np.isfinite(values[i])
            if np.count_nonzero(finite) < n:
                place = int(finite.argmin())
                raise _not_finite(name, values[i, place], rows[place])
        if self.aggregate is None:
            values[0] = values[1]
        else:
            values[0] = aggregation.aggregate(self.aggregate, values[1:, :, None])[:, 0]
        values *= weights(self.weight, steps)
        return values.T.tolist()


def check_unshaped(info: Mapping[str, Any]) -> None:
    """Raise SettingError when a step's reward has been shaped already."""
    if "shaping" in info:
        raise SettingError(
            "an environment must be shaped once, by all its potentials in one dict: its info has "
            "'shaping' already"
        )


def _not_finite(name: str, value: float, observation: Any) -> PotentialError:
    return PotentialError(
        f"a potential must be finite: {name!r} is {value} at observation {observation!r}"
    )


@dataclass
class Episode:
    """One episode under shaping; lists hold Phi and, after it, each source's Phi_i."""

    first: Any  # the observation it began with
    begun: int  # the step at which it began
    here: list[float]  # the potentials of the state it has reached
    largest: float = 0.0  # |Phi| met so far
    power: float = 1.0  # gamma^t
    shaped: float = 0.0  # sum of gamma^t F_t
    original: float = 0.0  # sum of the environment's own rewards

    def __post_init__(self) -> None:
        self.first = deepcopy(self.first)  # environments may write over what they returned
        self.largest = abs(self.here[0])

    def step(self, there: list[float], reward: float, discount: float) -> list[float]:
        """Step to a state of potentials `there`; return F = gamma Phi(s') - Phi(s) of each."""
        shaping = [
            discount * after - before for after, before in zip(there, self.here, strict=True)
        ]
        self.here = there
        self.largest = max(self.largest, abs(there[0]))
        self.shaped += self.power * shaping[0]
        self.power *= discount
        self.original += reward
        return shaping

    def end(self, potential: ShapingPotential, start: float, place: str) -> dict[str, float]:
        """Return what is reported of an ended episode, given Phi(s_0) computed anew.

        The residual is sum_t gamma^t F_t - (gamma^T Phi(s_T) - Phi(s_0)); PotentialError where it
        exceeds the tolerance.
        """
        residual = self.shaped - (self.power * self.here[0] - start)
        if abs(residual) > potential.allowed * self.largest:
            raise PotentialError(
                "an episode's shaping must come to gamma^T Phi(s_T) - Phi(s_0), as it does where "
                f"Phi depends on the observation alone: it is off by {residual:g} {place}, where "
                f"|Phi| was up to {self.largest:g}"
            )
        return {"telescoping_residual": residual, "original_return": self.original}


class ShapedStep(NamedTuple):
    """What shaping makes of one step of n sub-environments."""

    stepped: list[bool]
    """Which made a step of an episode; the others only reset."""
    shaping: list[list[float]]
    """(n, 1 + N): F and after it each source's F_i; 0 where the sub-environment only reset."""
    potential: list[float]
    """(n,): Phi(s')."""
    ended: dict[int, dict[str, float]]
    """Of each sub-environment whose episode ended, what :meth:`Episode.end` returns."""


class Episodes:
    """The episodes of n sub-environments.

    `finals_in` says, for messages, where the observations are at which episodes were cut off. It
    is given if a step that ends an episode returns the observation with which the next one begins.
    """

    def __init__(
        self,
        potential: ShapingPotential,
        space: gymnasium.Space[Any],
        n: int,
        finals_in: str | None = None,
    ):
        self._potential, self._space, self._finals_in = potential, space, finals_in
        self._steps = 0  # of all sub-environments together
        self._running: list[Episode | None] = [None] * n

    def begin(self, observations: Any, mask: Sequence[bool] | BoolArray | None = None) -> None:
        """Begin episodes, everywhere or where `mask` is true, given all observations, stacked."""
        rows = unstack(self._space, observations)
        begun = [i for i in range(len(rows)) if mask is None or mask[i]]
        stacked = observations if mask is None else None
        here = self._potential.each([rows[i] for i in begun], self._steps, stacked)
        for i, phi in zip(begun, here, strict=True):
            self._running[i] = Episode(rows[i], self._steps, phi)

    def step(
        self,
        observations: Any,
        rewards: npt.NDArray[Any],
        terminated: BoolArray,
        truncated: BoolArray,
        final: Finals,
    ) -> ShapedStep:
        """Return what shaping makes of a step; the arguments are as the step returned them."""
        rows = unstack(self._space, observations)
        running, same_step = self._running.copy(), self._finals_in is not None
        self._steps += sum(episode is not None for episode in running)
        over = np.flatnonzero(terminated | truncated).tolist()
        ended = {i: episode for i in over if (episode := running[i]) is not None}
        finals = self._finals(truncated & ~terminated, final) if same_step and over else {}
        here, there, starts = self._read(rows, observations, terminated, ended, finals)
        discount, nothing = self._potential.discount, [0.0] * len(here[0])
        steps = zip(running, there, rewards.tolist(), strict=True)
        shaping = [
            nothing if episode is None else episode.step(phi, reward, discount)
            for episode, phi, reward in steps
        ]
        for i, episode in enumerate(running):
            if episode is None or (i in ended and same_step):
                self._running[i] = Episode(rows[i], self._steps, here[i])
            elif i in ended:
                self._running[i] = None
        place = "at the end of an episode of sub-environment"
        reported = {
            i: episode.end(self._potential, starts[i], f"{place} {i}")
            for i, episode in ended.items()
        }
        stepped = [episode is not None for episode in running]
        return ShapedStep(stepped, shaping, [phi[0] for phi in there], reported)

    def _finals(self, cut_off: BoolArray, final: Finals) -> dict[int, Any]:
        """Return the observations at which episodes were cut off, by sub-environment."""
        finals = {i: final(i) for i in np.flatnonzero(cut_off).tolist()}
        for i, observation in finals.items():
            if observation is None:
                raise SettingError(
                    "a vector environment that resets in the same step must return the "
                    f"observation at which it cut an episode off, in {self._finals_in}: "
                    f"sub-environment {i} did not"
                )
        return finals

    def _read(
        self,
        rows: list[Any],
        stacked: Any,
        terminated: BoolArray,
        ended: Mapping[int, Episode],
        finals: Mapping[int, Any],
    ) -> tuple[list[list[float]], list[list[float]], dict[int, float]]:
        """Return the potentials of what was returned, those of s', and Phi where the ended began.

        All are read in one batch, as a network costs as much for one observation as for many.
        Observations that ended an episode by termination are not read: their potential is 0.
        """
        if not ended:
            here = self._potential.each(rows, self._steps, stacked)
            return here, here, {}
        same_step = self._finals_in is not None
        read = [i for i in range(len(rows)) if same_step or not terminated[i]]
        asked = [rows[i] for i in read] + [*finals.values()] + [e.first for e in ended.values()]
        now = [self._steps] * (len(read) + len(finals))
        steps = np.array([*now, *(episode.begun for episode in ended.values())])
        values = iter(self._potential.each(asked, steps))
        nothing = [0.0] * (1 + len(self._potential.sources))
        here = [nothing] * len(rows)
        for i in read:
            here[i] = next(values)
        there = [nothing if end else phi for end, phi in zip(terminated, here, strict=True)]
        for i in finals:
            there[i] = next(values)
        return here, there, {i: phi[0] for i, phi in zip(ended, values, strict=True)}


class PotentialShaping(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of an environment.

    Phi(s') is 0 where the step terminated and only there: truncation keeps it, and the learner must
    bootstrap from s'. Nothing else of the environment changes. Values learnt from the shaped
    rewards are Q - Phi; the greedy policy is the same.

    Each step's ``info`` holds

    - ``original_reward``: the environment's own;
    - ``shaping``: F;
    - ``shaping_terms``: F_i = w(t + 1) gamma Phi_i(s') - w(t) Phi_i(s) of each source alone. F is
      their mean under `mean` and their sum under `total`; under `maximum` and `minimum` it lies
      between the least and the largest of them;
    - ``potential``: Phi(s'), which is 0 where the step terminated;
    - at an episode's end ``original_return``, the undiscounted sum of the original rewards, and
      ``telescoping_residual``: sum_t gamma^t F_t - (gamma^T Phi(s_T) - Phi(s_0)), with Phi(s_0)
      computed anew from a copy of the observation. It is 0, but for rounding, where Phi is a
      function of the observation (and t) alone.

    A step after an episode's end is taken to be the reset of an environment that resets itself
    (`gymnasium.wrappers.Autoreset`): its reward stays as it is. Wrappers that record returns belong
    inside, where rewards are the original ones: ``PotentialShaping(RecordEpisodeStatistics(env))``.

    Parameters
    ----------
    env : gymnasium.Env
    potential : callable, potential over a task, source of values, or dict of str to these
        A function observation -> float; or a `StatePotential`, `MappedPotential` or
        `StateActionPotential`, whose Phi(s) = max_a phi(s, a), over the states that the
        observations number: as a whole (`Discrete`), or component by component (`MultiDiscrete`,
        `Tuple`); or an `ObservationPotential` or other `ValueSource`, whose Phi(s) = V(s). Several
        sources have names.
    discount : float, optional
        gamma, which must be the learner's. Needed where no potential has a task to state it.
    weight : float or Schedule
        w(t), which multiplies Phi; t counts the steps taken through this wrapper, episode after
        episode, also for a `StatePotential` that changes with time (Devlin, Kudenko 2012).
    aggregate : callable, optional
        g of Phi = w g(Phi_1, ..., Phi_N), (N, S, A) -> (S, A), called with S = A = 1; the mean
        unless given.
    encode : callable, optional
        observation -> number of the state, for potentials over a task.
    tolerance : float or None
        The largest residual allowed, as a share of the largest size of Phi in the episode; for a
        `ValueSource` at least 0.001, as networks round. None allows any, for potentials that
        change, such as a network in training. Shaping is sound for these too (Devlin, Kudenko
        2012): what is subtracted on leaving s is the number that was added on arriving there.

    Raises
    ------
    PotentialError
        When a value is not finite, naming the observation; when an episode's residual exceeds
        the tolerance.
    SettingError
        When the discount is not stated, or stated differently; when observations do not number
        the states of a task; when the environment is shaped already.

    Examples
    --------
    >>> import gymnasium
    >>> lake = gymnasium.make("FrozenLake-v1", is_slippery=False)
    >>> env = PotentialShaping(lake, lambda square: square / 15, discount=0.9)
    >>> env.reset(seed=0)[0], env.step(1)[:2]  # to square 4: 0.9 * 4 / 15 - 0
    (0, (4, 0.24))
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        potential: Potential | Mapping[str, Potential],
        *,
        discount: float | None = None,
        weight: float | Schedule = 1.0,
        aggregate: Aggregate | None = None,
        encode: Callable[[Any], Any] | None = None,
        tolerance: float | None = 1e-6,
    ):
        settings: dict[str, Any] = {
            "potential": potential, "discount": discount, "weight": weight,
            "aggregate": aggregate, "encode": encode, "tolerance": tolerance,
        }  # fmt: skip
        # Potentials are functions or frozen: a copy of a large one would only cost memory.
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **settings)
        gymnasium.Wrapper.__init__(self, env)
        self._potential = ShapingPotential(space=env.observation_space, **settings)
        self._steps = 0
        self._episode: Episode | None = None

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and return what it returns."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin(observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Return what the environment returns, with the shaped reward and its parts in the info."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        reward = np.asarray(reward).item()  # some environments return arrays of shape (1,)
        check_unshaped(info)
        episode = self._episode
        if episode is None:
            here = self._begin(observation)
            shown = self._shown(reward, [0.0] * len(here), here)
            return observation, reward, terminated, truncated, {**info, **shown}
        self._steps += 1
        if terminated:
            there = [0.0] * len(episode.here)
        else:
            there = self._potential.one(observation, self._steps)
        shaping = episode.step(there, float(reward), self.discount)
        shown = self._shown(reward, shaping, there)
        if terminated or truncated:
            self._episode = None
            start = self._potential.one(episode.first, episode.begun)[0]
            place = f"after {self._steps - episode.begun} steps"
            shown |= episode.end(self._potential, start, place)
        return observation, float(reward) + shaping[0], terminated, truncated, {**info, **shown}

    def _begin(self, observation: Any) -> list[float]:
        here = self._potential.one(observation, self._steps)
        self._episode = Episode(observation, self._steps, here)
        return here

    def _shown(
        self, reward: SupportsFloat, shaping: list[float], there: list[float]
    ) -> dict[str, Any]:
        return {
            "original_reward": reward,
            "shaping": shaping[0],
            "shaping_terms": dict(zip(self._potential.sources, shaping[1:], strict=True)),
            "potential": there[0],
        }


class VectorPotentialShaping(AnyVectorWrapper, RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of each of n sub-environments.

    It is :class:`PotentialShaping` for vector environments: the same potentials, the same rules,
    episode by episode of each sub-environment. Where ``metadata["autoreset_mode"]`` is

    - NEXT_STEP, the step that only resets a sub-environment has F = 0 and keeps its reward;
    - SAME_STEP, s' of a step that cuts an episode off is ``infos["final_obs"]``, and the
      observation returned is where the next episode begins;
    - DISABLED, an episode begins where ``reset(options={"reset_mask": ...})`` says so.

    ``infos`` holds the entries of `PotentialShaping` as (n,) float64 arrays, each with its mask
    under the name with an underscore in front, ``shaping_terms`` as a dict of such arrays. The
    masks leave out the sub-environments that only reset; ``telescoping_residual`` and
    ``original_return`` are there when an episode ended, with the mask of the ended. ``potential``
    is Phi(s') of the state the step arrived in, in SAME_STEP too.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
    potential, discount, weight, aggregate, encode, tolerance
        As in :class:`PotentialShaping`. The t of potentials that change with time counts the steps
        of all sub-environments together, as a budget does.
    batched : bool
        Whether potential functions return an (m,) array for m observations, stacked as the vector
        environment does it, and `encode` an (m,) array of integers. m is n, or more where episodes
        end: then the observations at which they were cut off and began are read as well. Otherwise
        functions are called with one observation after another. Observations that ended an episode
        by termination are never read. Sources of values always read stacked observations.

    Raises
    ------
    PotentialError, SettingError
        As :class:`PotentialShaping`, and when the vector environment does not say how it resets.

    Examples
    --------
    >>> import gymnasium
    >>> lakes = gymnasium.make_vec("FrozenLake-v1", num_envs=2, is_slippery=False)
    >>> envs = VectorPotentialShaping(lakes, lambda s: s / 15, discount=0.9, batched=True)
    >>> envs.reset(seed=0)[0], envs.step(np.array([1, 2]))[1]  # to the squares 4 and 1
    (array([0, 0]), array([0.24, 0.06]))
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        potential: Potential | Mapping[str, Potential],
        *,
        discount: float | None = None,
        weight: float | Schedule = 1.0,
        aggregate: Aggregate | None = None,
        encode: Callable[[Any], Any] | None = None,
        tolerance: float | None = 1e-6,
        batched: bool = False,
    ):
        settings: dict[str, Any] = {
            "potential": potential, "discount": discount, "weight": weight, "aggregate": aggregate,
            "encode": encode, "tolerance": tolerance, "batched": batched,
        }  # fmt: skip
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **settings)
        VectorWrapper.__init__(self, env)
        mode = env.metadata.get("autoreset_mode")
        if not isinstance(mode, AutoresetMode):
            raise SettingError(
                "a vector environment must say how it resets, in metadata['autoreset_mode']: got "
                f"{mode!r}"
            )
        finals_in = "infos['final_obs']" if mode is AutoresetMode.SAME_STEP else None
        self._potential = ShapingPotential(space=env.single_observation_space, **settings)
        self._episodes = Episodes(self._potential, env.observation_space, env.num_envs, finals_in)

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the sub-environments, or those of ``options["reset_mask"]``."""
        options = None if options is None else dict(options)  # environments take the mask out of it
        mask = (options or {}).get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)
        self._episodes.begin(observations, mask)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Return what the environments return, with shaped rewards and their parts in the infos."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        check_unshaped(infos)
        finals = infos.get("final_obs", [None] * self.num_envs)
        done = self._episodes.step(observations, rewards, terminated, truncated, finals.__getitem__)
        shaping, stepped = np.array(done.shaping).T, np.array(done.stepped)
        potential = np.array(done.potential)
        infos = {
            **infos,
            **_shown(stepped, original_reward=rewards, shaping=shaping[0], potential=potential),
            "shaping_terms": _shown(
                stepped, **dict(zip(self._potential.sources, shaping[1:], strict=True))
            ),
            "_shaping_terms": stepped,
        }
        if done.ended:
            ended = np.zeros(self.num_envs, np.bool_)
            ended[list(done.ended)] = True
            for name in ("telescoping_residual", "original_return"):
                infos[name], infos[f"_{name}"] = np.zeros(self.num_envs), ended
                infos[name][ended] = [reported[name] for _, reported in sorted(done.ended.items())]
        return observations, rewards + shaping[0], terminated, truncated, infos


def _shown(mask: BoolArray, /, **arrays: FloatArray) -> dict[str, Any]:
    """Return arrays as Gymnasium's infos hold them: 0 where the mask is false, each with it."""
    shown: dict[str, Any] = {}
    for name, values in arrays.items():
        shown[name], shown[f"_{name}"] = np.where(mask, values, 0.0), mask
    return shown
