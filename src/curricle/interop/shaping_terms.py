"""Potentials read from observations: what shaping one environment and shaping many share.

The potential of an observation is Phi(s, t) = w(t) g(Phi_1(s, t), ..., Phi_N(s, t)), where t counts
the steps taken through the wrapper, episode after episode.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from curricle.checks import instance, number
from curricle.errors import PotentialError, SettingError
from curricle.interop.shaping_sources import (
    Potential,
    Source,
    Steps,
    each_step,
    over_a_task,
    source,
    stack,
    weights,
)
from curricle.learning.schedules import Schedule, schedule
from curricle.tasks.task import generative_model
from curricle.transfer import aggregation
from curricle.transfer.aggregation import Aggregate
from curricle.transfer.observation_potential import ObservationPotential

FloatArray = npt.NDArray[np.float64]

ALONE = "potential"
"""The name of a potential that was given without one."""


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
    tolerance : float, optional
        How far an episode's shaping may be from telescoping, as a share of the largest size of
        Phi in it; as far as a source's rounding in any case.
    """

    space: gymnasium.Space[Any]
    sources: dict[str, Source]
    discount: float
    weight: Schedule
    aggregate: Aggregate | None
    tolerance: float | None

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

    def many(self, rows: list[Any], steps: Steps, stacked: Any = None) -> FloatArray:
        """Return the same of n observations, (1 + N, n) float64.

        `steps` is t for all of them, or one for each, (n,) int64; `stacked` are the observations as
        a vector environment hands them out, where they are at hand.
        """
        n = len(rows)
        values = np.empty((1 + len(self.sources), n))
        if n == 0:
            return values
        if self._batched and stacked is None:
            stacked = stack(self.space, rows)
        for i, each in enumerate(self.sources.values(), start=1):
            if each.batched:
                values[i] = each.many(stacked, n, steps)
            else:
                values[i] = [each.one(*row) for row in zip(rows, each_step(steps), strict=False)]
        finite = np.isfinite(values[1:])
        if np.count_nonzero(finite) < finite.size:
            i, place = np.argwhere(~finite)[0].tolist()
            raise _not_finite(list(self.sources)[i], values[1 + i, place], rows[place])
        if self.aggregate is None:
            values[0] = values[1]
        else:
            values[0] = aggregation.aggregate(self.aggregate, values[1:, :, None])[:, 0]
        values *= weights(self.weight, steps)
        return values

    def each(self, rows: list[Any], steps: Steps, stacked: Any = None) -> list[list[float]]:
        """Return what :meth:`one` returns, of n observations, read in one batch where that pays."""
        if self._batched:
            return self.many(rows, steps, stacked).T.tolist()  # type: ignore[no-any-return]
        return [self.one(*row) for row in zip(rows, each_step(steps), strict=False)]

    def check_telescoping(self, residual: float, largest: float, place: str) -> None:
        """Raise PotentialError when an episode's shaping does not come to what it must."""
        if self.tolerance is None:
            return
        allowed = max(self.tolerance, *(each.rounding for each in self.sources.values()))
        if abs(residual) > allowed * largest:
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
        When a potential is none of what can be one, or there is none.
    SettingError
        When the discount is not stated or differs, or when the observations do not number the
        states of a potential's task, or are not those of its task.

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
    if encode is not None and not any(map(over_a_task, named.values())):
        raise SettingError("encode must be left out where no potential is one over a task")
    if aggregate is None and len(named) > 1:
        aggregate = aggregation.mean
    return ObservedPotential(
        space=space,
        sources={name: source(name, each, space, encode, batched) for name, each in named.items()},
        discount=one_discount(named, discount),
        weight=schedule(weight),
        aggregate=aggregate,
        tolerance=tolerance,
    )


def one_discount(potentials: Mapping[str, Potential], discount: float | None) -> float:
    """Return the discount that the potentials' tasks and the caller state, or raise SettingError.

    Examples
    --------
    >>> from curricle import GridWorld, StatePotential
    >>> one_discount({"end": StatePotential(GridWorld("S.T"), [0, 1, 2])}, None)
    0.99
    """
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
    """Raise SettingError when a step's info says that its reward has been shaped already."""
    if "shaping" in info:
        raise SettingError(
            "an environment must be shaped once, by all its potentials in one dict: its info has "
            "'shaping' already"
        )


def _not_finite(name: str, value: float, observation: Any) -> PotentialError:
    return PotentialError(
        f"a potential must be finite: {name!r} is {value} at observation {observation!r}"
    )
