"""The accounts of episodes: what shaping adds to each step, and what it comes to at the end."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from curricle.interop.shaping_sources import unstack
from curricle.interop.shaping_terms import ObservedPotential

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass
class Episode:
    """The account of one episode; the potentials are Phi and after it each source's.

    Examples
    --------
    >>> episode = Episode(first=0, begun=0, here=[1.0])
    >>> episode.go([4.0], reward=-1.0, discount=0.5), episode.original  # 0.5 * 4 - 1
    ([1.0], -1.0)
    >>> episode.residual(start=1.0)
    0.0
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

    def go(self, there: list[float], reward: float, discount: float) -> list[float]:
        """Enter a step, which went `there`, and return F = gamma Phi(s') - Phi(s) of each."""
        shaping = [
            discount * after - before for after, before in zip(there, self.here, strict=True)
        ]
        self.here = there
        self.largest = max(self.largest, abs(there[0]))
        self.shaped += self.power * shaping[0]
        self.power *= discount
        self.original += reward
        return shaping

    def residual(self, start: float) -> float:
        """Return sum_t gamma^t F_t - (gamma^T Phi(s_T) - Phi(s_0)), given Phi(s_0) read anew."""
        return self.shaped - (self.power * self.here[0] - start)


@dataclass(frozen=True)
class Shaped:
    """What shaping makes of a step of n sub-environments.

    Attributes
    ----------
    stepped : (n,) bool
        Those that made a step of an episode; the others only reset.
    shaping : (1 + N, n) float64
        F and after it each source's F_i; 0 where none was made.
    potential : (n,) float64
        Phi(s').
    ended : (n,) bool
        Those whose episode ended.
    residual, original : (n,) float64
        Of the ended: how far the discounted sum of F is from what theory says, and the sum of the
        environment's own rewards. They mean nothing elsewhere.
    """

    stepped: BoolArray
    shaping: FloatArray
    potential: FloatArray
    ended: BoolArray
    residual: FloatArray
    original: FloatArray


class Episodes:
    """The accounts of n sub-environments' episodes; potentials are Phi and after it each source's.

    What is in them of a sub-environment that is in no episode means nothing.

    Parameters
    ----------
    potential : ObservedPotential
    space : gymnasium.Space
        Of n stacked observations.
    n : int
    at_once : bool
        Whether a step that ends an episode returns the observation with which the next one begins.

    Examples
    --------
    >>> from gymnasium.spaces import Discrete, MultiDiscrete
    >>> from curricle.interop.shaping_terms import observed_potential
    >>> phi = observed_potential(float, Discrete(9), discount=0.5, weight=1.0, aggregate=None,
    ...                          encode=None, tolerance=1e-6)
    >>> episodes = Episodes(phi, MultiDiscrete([9, 9]), 2, at_once=True)
    >>> no = np.zeros(2, bool)
    >>> episodes.begin(~no, np.array([1, 2]))
    >>> episodes.step(np.array([4, 8]), np.zeros(2), no, no, {}).shaping[0]  # 4 / 2 - 1, 8 / 2 - 2
    array([1., 2.])
    """

    def __init__(
        self, potential: ObservedPotential, space: gymnasium.Space[Any], n: int, *, at_once: bool
    ):
        self._potential, self._space, self._at_once = potential, space, at_once
        self._steps = 0  # of all sub-environments together
        self._running = np.zeros(n, np.bool_)
        self._first: list[Any] = [None] * n  # the observation it began with
        self._begun = np.zeros(n, np.int64)  # the step at which it began
        self._here = np.zeros((1 + len(potential.sources), n))  # those of the state it has reached
        self._largest = np.zeros(n)  # |Phi| met so far
        self._power = np.ones(n)  # gamma^t
        self._shaped = np.zeros(n)  # sum of gamma^t F_t
        self._original = np.zeros(n)  # sum of the environment's own rewards

    def begin(self, begun: BoolArray, observations: Any) -> None:
        """Open accounts where episodes have begun, given the observations of all, stacked."""
        rows, here = unstack(self._space, observations), self._here.copy()
        here[:, begun] = self._potential.many([rows[i] for i in _places(begun)], self._steps)
        self._open(begun, here, rows)

    def step(
        self,
        observations: Any,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
        finals: Mapping[int, Any],
    ) -> Shaped:
        """Enter a step of all sub-environments and return what shaping makes of it.

        `observations` are the stacked ones that it returned; `finals`, by sub-environment, those in
        which an episode was cut off where others were returned.
        """
        discount, rows = self._potential.discount, unstack(self._space, observations)
        stepped, ended = self._running, self._running & (terminated | truncated)
        n_stepped = int(np.count_nonzero(stepped))  # the quickest way to ask for any or all
        self._steps += n_stepped
        if np.count_nonzero(ended):
            here, there, start = self._read(rows, terminated, ended, finals)
        else:
            here = there = self._potential.many(rows, self._steps, observations)
            start = here[0]
        shaping = discount * there - self._here
        if n_stepped < len(rows):
            shaping = np.where(stepped, shaping, 0.0)
        self._largest = np.maximum(self._largest, abs(there[0]))
        self._shaped += self._power * shaping[0]
        self._power *= discount
        self._original += rewards
        residual = self._shaped - (self._power * there[0] - start)
        shaped = Shaped(stepped, shaping, there[0], ended, residual, self._original.copy())
        self._close(shaped)
        self._open(ended if self._at_once else ~stepped, here, rows)
        return shaped

    def _read(
        self, rows: list[Any], terminated: BoolArray, ended: BoolArray, finals: Mapping[int, Any]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the potentials of what was returned, those of s', and Phi of where it all began.

        They are read at once, as many observations in one go are cheaper for a network. Ends by
        termination are not read.
        """
        returned = ~terminated | (ended & self._at_once)
        places, beginnings = _places(returned), _places(ended)
        asked = [
            *(rows[i] for i in places),
            *finals.values(),
            *(self._first[i] for i in beginnings),
        ]
        steps = np.full(len(asked), self._steps)
        steps[len(asked) - len(beginnings) :] = self._begun[ended]
        values = self._potential.many(asked, steps)
        here, start = np.zeros_like(self._here), np.zeros(len(rows))
        here[:, places] = values[:, : len(places)]
        there = np.where(terminated, 0.0, here)
        there[:, list(finals)] = values[:, len(places) : len(asked) - len(beginnings)]
        start[beginnings] = values[0, len(asked) - len(beginnings) :]
        return here, there, start

    def _close(self, shaped: Shaped) -> None:
        """Close the accounts of the episodes that have ended, which must have telescoped."""
        if not np.count_nonzero(shaped.ended):
            return
        self._running = self._running & ~shaped.ended
        for i in _places(shaped.ended):
            place = f"at the end of an episode of sub-environment {i}"
            self._potential.check_telescoping(shaped.residual[i], self._largest[i], place)

    def _open(self, begun: BoolArray, here: FloatArray, rows: list[Any]) -> None:
        """Open accounts where episodes have begun; `here` are the potentials of all."""
        self._here = here
        if not np.count_nonzero(begun):
            return
        self._running = self._running | begun
        for i in _places(begun):
            self._first[i] = deepcopy(rows[i])  # environments may write over what they returned
        self._begun[begun], self._largest[begun] = self._steps, abs(here[0, begun])
        self._power[begun], self._shaped[begun], self._original[begun] = 1.0, 0.0, 0.0


def _places(mask: BoolArray) -> list[int]:
    return np.flatnonzero(mask).tolist()
