"""The potential of an observation, and the episodes that it shapes.

Phi(s, t) = w(t) g(Phi_1(s, t), ..., Phi_N(s, t)): named sources, an aggregate, a weight and one
discount. t counts the steps taken through the wrapper, episode after episode.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np

from curricle.checks import instance, number
from curricle.errors import PotentialError, SettingError
from curricle.interop.potential_sources import (
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

    def check_telescoping(self, residual: float, largest: float, place: str) -> None:
        """Raise PotentialError when an episode's shaping does not telescope."""
        if self.tolerance is None:
            return
        allowed = max(self.tolerance, *(each.rounding for each in self.sources.values()))
        if abs(residual) > allowed * largest:
            raise PotentialError(
                "an episode's shaping must come to gamma^T Phi(s_T) - Phi(s_0), as it does where "
                f"Phi depends on the observation alone: it is off by {residual:g} {place}, where "
                f"|Phi| was up to {largest:g}"
            )


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
