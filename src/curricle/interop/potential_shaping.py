"""Potential-based shaping of any Gymnasium environment, for any algorithm.

Ng, Harada and Russell 1999 (paper E2): F = gamma Phi(s') - Phi(s), added to the reward, changes no
optimal policy, if the potential of a terminal state is 0 (Grzes 2017); an episode that is cut off
keeps Phi(s'). Phi(s, t) = w(t) g(Phi_1(s, t), ..., Phi_N(s, t)): named sources, an aggregate, a
weight and one discount.
"""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete, MultiDiscrete
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector.utils import iterate

from curricle.arrays import FloatArray
from curricle.checks import instance, number, numbers
from curricle.errors import PotentialError, SettingError
from curricle.learning.potential import PairPotential, StateActionPotential, StatePotential
from curricle.learning.schedules import CONSTANT, Schedule, schedule
from curricle.tasks.mdp import generative_model
from curricle.tasks.models import flag_of
from curricle.tasks.observation_task import stack
from curricle.tasks.spaces import Space
from curricle.transfer import aggregate as aggregation
from curricle.transfer.aggregate import Aggregate
from curricle.transfer.mapping import ValueSource
from curricle.transfer.potential import ObservationPotential

Steps = int | list[int]  # t of all observations, or of each
TaskPotential = StatePotential | PairPotential
Potential = Callable[[Any], Any] | TaskPotential | ValueSource
"""A function of an observation, a potential over a task's states, or values of observations."""
NETWORK_ROUNDING = 1e-3
"""In single precision a network's output changes with the size of the batch, by up to this share on
a graphics processor, whose products of matrices have 11 bits."""


@dataclass(frozen=True, eq=False)
class Source:
    """A potential that is read from n observations, or from the states that they show."""

    name: str
    read_from: Callable[[Any], Any]  # of an observation, or of stacked ones if `of_values`
    discount: float | None = None  # of the task of the potential, if it has one
    of_values: bool = False  # whether it is a source of values, which reads stacked observations
    # The potential over a task, if it is one: then `read_from` returns states.
    potential: TaskPotential | None = None
    n_states: int = 0
    fixed: FloatArray | None = None  # (S,) Phi where it is an array that time does not change

    @classmethod
    def of(
        cls,
        name: str,
        potential: Potential,
        space: gymnasium.Space[Any],
        encode: Callable[[Any], Any] | None,
    ) -> "Source":
        """Return the source that reads a potential from observations of a space."""
        if isinstance(potential, TaskPotential):
            if isinstance(potential, StateActionPotential):
                potential = potential.to_state()
            task, fixed = generative_model(potential.task), None
            if isinstance(potential, StatePotential) and len(potential.values) == 1:
                fixed = potential.at(0) if potential.weight.shape == CONSTANT else None
            state_of = _numbering(space, task.states) if encode is None else encode
            return cls(name, state_of, task.discount, False, potential, task.states.size, fixed)
        discount = None
        if isinstance(potential, ObservationPotential):
            discount = potential.task.discount
            if potential.task.observations != space:
                raise SettingError(
                    "a potential over observations must read those of its own task: "
                    f"{name!r} is made for {potential.task.observations} and gets {space}"
                )
        if isinstance(potential, ValueSource):
            return cls(name, potential.v, discount, of_values=True)
        if callable(potential):
            return cls(name, potential)
        raise PotentialError(
            "a potential must be a function of an observation, a potential over a task or over "
            f"observations, or a source of values: {name!r} is {potential!r}"
        )

    def read(self, rows: Sequence[Any], stacked: object, steps: Steps) -> list[float]:
        """Return Phi_i of n observations, (n,)."""
        potential = self.potential
        if self.of_values:
            values = numbers(
                f"the values of {self.name!r}", self.read_from(stacked), PotentialError
            )
            if values.shape != (len(rows),):
                raise PotentialError(
                    f"the values of {self.name!r} must have shape {(len(rows),)}: got "
                    f"{values.shape}"
                )
            return values.tolist()  # type: ignore[no-any-return]
        if potential is None:
            return [self._value(observation) for observation in rows]
        states = [self._state(observation) for observation in rows]
        if self.fixed is not None:
            return [*map(self.fixed.item, states)]
        if isinstance(potential, PairPotential):
            return potential.v(np.array(states)).tolist()  # type: ignore[no-any-return]
        frame = np.searchsorted(potential.frame_steps, steps, side="right") - 1
        weights = np.array([potential.weight(step) for step in each_step(steps, len(states))])
        phi = weights * potential.values[frame, states]
        return phi.tolist()  # type: ignore[no-any-return]

    def _value(self, observation: object) -> float:
        """Return the function's value; PotentialError unless it is a number."""
        value = self.read_from(observation)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise PotentialError(
                f"a potential must return one number: {self.name!r} returned {value!r} at "
                f"observation {observation!r}"
            ) from None

    def _state(self, observation: object) -> int:
        """Return the number of the state that an observation shows; SettingError if it is none."""
        returned = self.read_from(observation)
        try:
            state = operator.index(returned)
        except TypeError:
            raise SettingError(
                f"an observation's state must be a whole number: {self.name!r} got {returned!r} "
                f"for observation {observation!r}"
            ) from None
        if not 0 <= state < self.n_states:
            raise SettingError(
                f"an observation's state must lie in 0..{self.n_states - 1}: {self.name!r} got "
                f"{state} for observation {observation!r}"
            )
        return state


def unstack(space: gymnasium.Space[Any], stacked: object) -> list[Any]:
    """Return stacked observations as a list; `space` is the space of the stack."""
    if isinstance(stacked, np.ndarray):
        return list(stacked)  # as `iterate` does, and quicker
    return list(iterate(space, stacked))


def each_step(steps: Steps, n: int) -> list[int]:
    """Return the step of each of n observations."""
    return [steps] * n if isinstance(steps, int) else steps


def _numbering(space: gymnasium.Space[Any], states: Space) -> Callable[[Any], Any]:
    """Return the function from an observation to the number of its state."""
    if isinstance(space, Discrete) and space.n == states.size:
        return partial(operator.add, -int(space.start))
    sizes: tuple[int, ...] = ()
    starts = list[int]()
    if isinstance(space, MultiDiscrete):
        sizes, starts = tuple(space.nvec.tolist()), space.start.tolist()
    elif isinstance(space, gymnasium.spaces.Tuple) and all(isinstance(x, Discrete) for x in space):
        parts: Any = space.spaces
        sizes = tuple(int(part.n) for part in parts)
        starts = [int(part.start) for part in parts]
    if sizes == states.shape:
        lows = [part.low - start for part, start in zip(states.components, starts, strict=True)]
        return lambda observation: states.encode_one(tuple(map(operator.add, observation, lows)))
    raise SettingError(
        f"observations must number the task's {states.size} states, as a whole or component by "
        f"component, or encode= must number them: got {space}"
    )


class ShapingPotential:
    """Phi of observations of a space, and Phi_i of each of its N named sources."""

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
    ):
        named = potential if isinstance(potential, Mapping) else {"potential": potential}
        if not named:
            raise PotentialError("shaping needs a potential: got none")
        for name in named:
            instance("a potential's name", name, str, SettingError)
        if tolerance is not None:
            number("tolerance", tolerance, SettingError, 0)
        if aggregate is None and len(named) > 1:
            aggregate = aggregation.mean
        self.space = space
        self.sources = {
            name: Source.of(name, potential, space, encode) for name, potential in named.items()
        }
        if encode is not None and all(s.potential is None for s in self.sources.values()):
            raise SettingError("encode must be left out where no potential is over a task's states")
        stated = {
            f"the task of {name!r}": source.discount
            for name, source in self.sources.items()
            if source.discount is not None
        }
        if discount is not None:
            stated["the argument"] = number("discount", discount, SettingError, 0, 1)
        if not stated:
            raise SettingError(
                "a discount must be given where no potential has a task that states it"
            )
        if len(set(stated.values())) > 1:
            discounts = ", ".join(f"{value:g} by {name}" for name, value in stated.items())
            raise SettingError(f"there must be one discount: got {discounts}")
        self.discount = next(iter(stated.values()))
        self.weight = schedule(weight)  # w(t)
        self._constant = self.weight.first if self.weight.shape == CONSTANT else None
        self.aggregate = aggregate  # g, called with n observations as S and A = 1
        # The largest telescoping residual allowed, as a share of the largest |Phi|.
        self.allowed = math.inf
        self._stacks = any(source.of_values for source in self.sources.values())
        if tolerance is not None:
            self.allowed = max(tolerance, NETWORK_ROUNDING if self._stacks else 0.0)

    def read(self, rows: list[Any], steps: Steps, stacked: object = None) -> list[list[float]]:
        """Return Phi(s, t) and, after it, w(t) Phi_i(s, t) of each source, of n observations."""
        if not rows:
            return []
        if self._stacks and stacked is None:
            stacked = stack(self.space, rows)
        columns = []
        for name, source in self.sources.items():
            column = source.read(rows, stacked, steps)
            if not all(map(math.isfinite, column)):
                place = [*map(math.isfinite, column)].index(False)
                raise PotentialError(
                    f"a potential must be finite: {name!r} is {column[place]} at observation "
                    f"{rows[place]!r}"
                )
            columns.append(column)
        if self.aggregate is None and self._constant == 1.0:  # the quickest, for one environment
            return [[phi, phi] for phi in columns[0]]
        g, together = self.aggregate, columns[0]
        if g is not None and self._stacks:
            together = aggregation.aggregate(g, np.array(columns)[:, :, None])[:, 0].tolist()
        elif g is not None:
            together = [aggregation.aggregate_numbers(g, values) for values in zip(*columns)]  # noqa: B905 - all are n
        values_of_rows = [*map(list, zip(together, *columns))]  # noqa: B905
        if self._constant == 1.0:
            return values_of_rows
        weights = [self.weight(step) for step in each_step(steps, len(rows))]
        pairs = zip(weights, values_of_rows, strict=True)
        return [[w * phi for phi in values] for w, values in pairs]


def check_unshaped(info: Mapping[str, Any]) -> None:
    """Raise SettingError when a step's reward has been shaped already."""
    if "shaping" in info:
        raise SettingError(
            "an environment must be shaped once, by all its potentials in one dict: its info has "
            "'shaping' already"
        )


@dataclass(eq=False)
class Episode:
    """An episode under shaping; lists hold Phi and, after it, each source's Phi_i."""

    first: Any  # the observation it began with
    begun: int  # the step at which it began
    phi: list[float]  # the potentials of the state it has reached
    largest: float = 0.0  # |Phi| met so far
    power: float = 1.0  # gamma^t
    shaped: float = 0.0  # sum of gamma^t F_t
    original: float = 0.0  # sum of the environment's own rewards

    def __post_init__(self) -> None:
        self.first = deepcopy(self.first)  # environments may write over what they returned
        self.largest = abs(self.phi[0])

    def step(self, phi: list[float], reward: float, discount: float) -> list[float]:
        """Step to a state of potentials `phi`; return F = gamma Phi(s') - Phi(s) of each."""
        shaping = [discount * after - before for after, before in zip(phi, self.phi)]  # noqa: B905
        self.phi = phi
        self.largest = max(self.largest, abs(phi[0]))
        self.shaped += self.power * shaping[0]
        self.power *= discount
        self.original += reward
        return shaping

    def end(self, potential: ShapingPotential, start: float, place: str) -> dict[str, float]:
        """Return the report of an ended episode, whose Phi(s_0), computed anew, is `start`."""
        residual = self.shaped - (self.power * self.phi[0] - start)
        if abs(residual) > potential.allowed * self.largest:
            raise PotentialError(
                "an episode's shaping must come to gamma^T Phi(s_T) - Phi(s_0), as it does where "
                f"Phi depends on the observation alone: it is off by {residual:g} {place}, where "
                f"|Phi| was up to {self.largest:g}"
            )
        return {"telescoping_residual": residual, "original_return": self.original}


class ShapedStep(NamedTuple):
    """A step of n environments with shaped rewards."""

    shaping: list[list[float]]  # (n, 1 + N): F and after it each source's F_i; 0 of a reset
    phi: list[list[float]]  # (n, 1 + N): Phi(s') and after it w Phi_i(s') of each source
    ended: dict[int, dict[str, float]]  # what :meth:`Episode.end` returns, where episodes ended


class Episodes:
    """The episodes of n environments that step together; n = 1 for a single environment."""

    def __init__(self, potential: ShapingPotential, n: int):
        self._potential = potential
        self._steps = 0  # of all environments together
        self._running: list[Episode | None] = [None] * n

    def begin(self, rows: list[Any], stacked: object = None) -> None:
        """Begin episodes at the n observations."""
        phi_of_rows = self._potential.read(rows, self._steps, stacked)
        starts = zip(rows, phi_of_rows, strict=True)
        self._running = [Episode(row, self._steps, phi) for row, phi in starts]

    def step(
        self,
        rows: list[Any],
        rewards: Sequence[float],
        terminated: Sequence[bool],
        truncated: Sequence[bool],
        begun: Sequence[Any] | None = None,  # n observations: where episodes begin after an end
        stacked: object = None,  # `rows`, where no episode ends
    ) -> ShapedStep:
        """Return the shaped step to the observations `rows`, each s' of its environment's step."""
        running, potential = self._running, self._potential
        shaping = list[list[float]]()
        steps: Any
        if not (None in running or True in terminated or True in truncated):
            # Most steps, which must be quick.
            self._steps += len(rows)
            phi_after = potential.read(rows, self._steps, stacked)
            steps = zip(running, phi_after, rewards)  # noqa: B905 - all are n
            for episode, phi, reward in steps:
                shaping.append(episode.step(phi, reward, potential.discount))
            return ShapedStep(shaping, phi_after, {})
        running = running.copy()
        self._steps += sum(episode is not None for episode in running)
        over = [i for i in range(len(rows)) if terminated[i] or truncated[i]]
        ended = {i: episode for i in over if (episode := running[i]) is not None}
        starts = {} if begun is None else {i: begun[i] for i in over}
        # Phi of s', of the starts, and of where the ended episodes began: in one batch, as a
        # network costs as much for one observation as for many.
        read = [i for i in range(len(rows)) if not terminated[i]]
        asked = [rows[i] for i in read] + [*starts.values()] + [e.first for e in ended.values()]
        at = [self._steps] * (len(read) + len(starts)) + [e.begun for e in ended.values()]
        values = iter(potential.read(asked, at))
        of_end = [0.0] * (1 + len(potential.sources))
        phi_after = [of_end] * len(rows)
        for i in read:
            phi_after[i] = next(values)
        steps = enumerate(zip(running, phi_after, rewards, strict=True))
        for i, (episode, phi, reward) in steps:
            if episode is None:  # this step only reset the environment
                shaping.append(of_end)
                self._running[i] = Episode(rows[i], self._steps, phi)
            else:
                shaping.append(episode.step(phi, reward, potential.discount))
        self._running = [None if i in ended else e for i, e in enumerate(self._running)]
        for i, observation in starts.items():
            self._running[i] = Episode(observation, self._steps, next(values))
        reported = {}
        for i, episode in ended.items():
            place = f"at the end of an episode of sub-environment {i}"
            if len(running) == 1:
                place = f"after {self._steps - episode.begun} steps"
            reported[i] = episode.end(potential, next(values)[0], place)
        return ShapedStep(shaping, phi_after, reported)


class Shaped:
    """An environment with a potential."""

    _potential: ShapingPotential

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount


class PotentialShaping(Shaped, gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of an environment.

    Phi(s') is 0 where the step terminated and only there: truncation keeps it, and the learner must
    bootstrap from s'. Values learnt from the shaped rewards are Q - Phi; the greedy policy is the
    same. Each step's ``info`` holds

    - ``original_reward``: the environment's own;
    - ``shaping``: F;
    - ``shaping_terms``: F_i = w(t + 1) gamma Phi_i(s') - w(t) Phi_i(s) of each source alone; F is
      their mean under `mean`, their sum under `total`, between them under `maximum` and `minimum`;
    - ``potential``: Phi(s');
    - at an episode's end ``original_return``, the undiscounted sum of the original rewards, and
      ``telescoping_residual``: sum_t gamma^t F_t - (gamma^T Phi(s_T) - Phi(s_0)), with Phi(s_0)
      computed anew. It is 0, but for rounding, where Phi depends on the observation and t alone.

    A step after an episode's end counts as the reset of `gymnasium.wrappers.Autoreset`: its reward
    stays as it is. Put wrappers that record returns inside. ``gymnasium.make_vec(wrappers=[...])``
    shapes every sub-environment of a vector environment.

    Parameters
    ----------
    env : gymnasium.Env
    potential : callable, potential over a task, source of values, or dict of str to these
        A function observation -> float; or a `StatePotential`, `MappedPotential` or
        `StateActionPotential`, Phi(s) = max_a phi(s, a), of the states that observations number,
        whole (`Discrete`) or by component (`MultiDiscrete`, `Tuple`); or an `ObservationPotential`
        or other `ValueSource`, Phi(s) = V(s).
    discount : float, optional
        gamma, which must be the learner's. Needed where no potential has a task to state it.
    weight : float or Schedule
        w(t), which multiplies Phi; t counts the steps taken through this wrapper, also for a
        `StatePotential` that changes with time.
    aggregate : callable, optional
        g of Phi = w g(Phi_1, ..., Phi_N), (N, S, A) -> (S, A), with A = 1; by default the mean.
    encode : callable, optional
        observation -> number of the state, for potentials over a task.
    tolerance : float or None
        The largest residual allowed, as a share of the largest abs(Phi) in the episode; at least
        0.001 for a `ValueSource`, because networks round. None allows any residual, for potentials
        that change: shaping is sound for these too (Devlin, Kudenko 2012).

    Raises
    ------
    PotentialError, SettingError
        When a value is not finite or a residual exceeds the tolerance; when there is not exactly
        one discount, observations do not number a task's states, or `env` is shaped already.

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
        self._episodes = Episodes(self._potential, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and return what it returns."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._episodes.begin([observation])
        return observation, info

    def step(self, action: object) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Return what the environment returns, with the shaped reward and its parts in the info."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        reward = np.asarray(reward).item()  # some environments return arrays of shape (1,)
        check_unshaped(info)
        flag_of(terminated, "terminated"), flag_of(truncated, "truncated")  # refuses others
        done = self._episodes.step([observation], [reward], [terminated], [truncated])
        shaping, *terms = done.shaping[0]
        shown = {
            "original_reward": reward,
            "shaping": shaping,
            "shaping_terms": dict(zip(self._potential.sources, terms, strict=True)),
            "potential": done.phi[0][0],
            **done.ended.get(0, {}),
        }
        return observation, reward + shaping, terminated, truncated, {**info, **shown}
