"""Episodes under shaping: what each step adds, and the sum that must telescope at the end."""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

from curricle.errors import SettingError
from curricle.interop.potential_sources import unstack
from curricle.interop.shaping_potential import ShapingPotential

BoolArray = npt.NDArray[np.bool_]
Finals = Callable[[int], Any]
"""The observation at which a sub-environment's episode was cut off, None if unknown."""


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
        potential.check_telescoping(residual, self.largest, place)
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
