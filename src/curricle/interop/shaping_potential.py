"""The potential of an observation, and the episodes that it shapes.

Phi(s, t) = w(t) g(Phi_1(s, t), ..., Phi_N(s, t)): named sources, an aggregate, a weight and one
discount. t counts the steps taken through the wrapper, episode after episode.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray
from curricle.checks import instance, number
from curricle.errors import PotentialError, SettingError
from curricle.interop.potential_sources import (
    Potential,
    Source,
    Steps,
    each_step,
    over_a_task,
    source,
    unstack,
    weights,
)
from curricle.learning.schedules import Schedule, schedule
from curricle.tasks.observation_task import stack
from curricle.tasks.task import generative_model
from curricle.transfer import aggregation
from curricle.transfer.aggregation import Aggregate
from curricle.transfer.potentials import ObservationPotential

Finals = Callable[[int], Any]
"""The observation at which a sub-environment's episode was cut off, None if unknown."""


@dataclass(frozen=True, eq=False)
class ShapingPotential:
    """Phi of observations, with what each of its N named sources gives."""

    space: gymnasium.Space[Any]  # of one observation
    sources: dict[str, Source]
    discount: float
    weight: Schedule  # w(t)
    aggregate: Aggregate | None  # g, called with n observations as S and A = 1; None for one source
    tolerance: float | None  # of the telescoping residual, as a share of the largest |Phi|

    @cached_property
    def _batched(self) -> bool:
        return any(each.batched for each in self.sources.values())

    def one(self, observation: Any, step: int) -> list[float]:
        """Return Phi(s, t) and, after it, w(t) Phi_i(s, t) of each source.

        Raises
        ------
        PotentialError
            When a source's value is not finite.
        """
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
            values[i] = each.many(rows, stacked, steps)
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

    @cached_property
    def allowed(self) -> float:
        """The largest residual allowed, as a share of the largest |Phi|."""
        if self.tolerance is None:
            return math.inf
        return max(self.tolerance, *(each.rounding for each in self.sources.values()))


def shaping_potential(
    potential: Potential | Mapping[str, Potential],
    space: gymnasium.Space[Any],
    *,
    discount: float | None,
    weight: float | Schedule,
    aggregate: Aggregate | None,
    encode: Callable[[Any], Any] | None,
    tolerance: float | None,
    batched: bool = False,
) -> ShapingPotential:
    """Return the potential of observations of a space.

    Raises
    ------
    PotentialError
        When there is no potential, or something that cannot be one.
    SettingError
        When the discount is not stated or differs, or when the observations are not those of a
        potential's task and do not number its states.
    """
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
    return ShapingPotential(
        space=space,
        sources={name: source(name, each, space, encode, batched) for name, each in named.items()},
        discount=_one_discount(named, discount),
        weight=schedule(weight),
        aggregate=aggregate,
        tolerance=tolerance,
    )


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
    """One episode under shaping; lists hold Phi and, after it, each source's Phi_i.

    Examples
    --------
    >>> episode = Episode(first=0, begun=0, here=[1.0])
    >>> episode.step([4.0], reward=-1.0, discount=0.5), episode.original  # 0.5 * 4 - 1
    ([1.0], -1.0)
    """

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

    Parameters
    ----------
    potential : ShapingPotential
    space : gymnasium.Space
        Of n stacked observations.
    n : int
    finals_in : str, optional
        Where the observations are at which episodes were cut off, for messages. Given if a step
        that ends an episode returns the observation with which the next one begins.
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
