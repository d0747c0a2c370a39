"""Potential-based shaping of vector environments, in all their ways of resetting."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import iterate

from curricle.errors import SettingError
from curricle.interop.shaping_terms import Potential, check_unshaped, observed_potential
from curricle.learning.schedules import Schedule
from curricle.transfer.aggregation import Aggregate

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

if TYPE_CHECKING:
    AnyVectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
else:  # not every version of Gymnasium has it take types
    AnyVectorWrapper = VectorWrapper


class VectorPotentialShaping(AnyVectorWrapper, RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of each of n sub-environments.

    It is :class:`PotentialShaping` for vector environments: the same potentials, the same rules,
    episode by episode of each sub-environment. Where ``metadata["autoreset_mode"]`` is

    - NEXT_STEP, the step that only resets a sub-environment has F = 0 and keeps its reward;
    - SAME_STEP, s' of a step that cuts an episode off is ``infos["final_obs"]``, and the
      observation returned is where the next episode begins;
    - DISABLED, an episode begins where ``reset(options={"reset_mask": ...})`` says so.

    ``infos`` holds what `PotentialShaping` tells, as (n,) float64 arrays, each with its mask under
    the name with an underscore in front, ``shaping_terms`` as a dict of such arrays. The masks
    leave out the sub-environments that only reset; those of ``telescoping_residual`` and
    ``original_return``, which are there when an episode ended, are the ended ones. ``potential`` is
    Phi(s') of the state the step arrived in, in SAME_STEP too.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
    potential, discount, weight, aggregate, encode, tolerance
        As in :class:`PotentialShaping`. The t of potentials that change with time counts the steps
        of all sub-environments together, as a budget does.
    batched : bool
        Whether potential functions return an (n,) array for the n observations as the vector
        environment stacks them, and `encode` an (n,) array of integers. They are always given all
        n; what they return for an observation that ended an episode by termination is not used.
        Otherwise they are called with one observation after another, and never with such a one.

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
        self._resets = env.metadata.get("autoreset_mode")
        if not isinstance(self._resets, AutoresetMode):
            raise SettingError(
                "a vector environment must say how it resets, in metadata['autoreset_mode']: got "
                f"{self._resets!r}"
            )
        self._potential = observed_potential(space=env.single_observation_space, **settings)
        self._steps = 0
        self._episodes = _Episodes(len(self._potential.sources), env.num_envs)

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the sub-environments, or those of ``options["reset_mask"]``."""
        options = None if options is None else dict(options)  # environments take the mask out of it
        begun = (options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_))
        observations, infos = self.env.reset(seed=seed, options=options)
        rows = self._rows(observations)
        here = self._potential.many(rows, begun, self._steps, observations)
        self._episodes.begin(begun, np.where(begun, here, self._episodes.here), rows, self._steps)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Return what the environments return, their rewards shaped and their infos told so."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        check_unshaped(infos)
        stepped, rows = self._episodes.running, self._rows(observations)
        ended = stepped & (terminated | truncated)
        at_once = self._resets is AutoresetMode.SAME_STEP
        begun = ended if at_once else ~stepped

        self._steps += int(stepped.sum())
        here = self._potential.many(rows, begun | ~terminated, self._steps, observations)
        there = np.where(terminated, 0.0, here)
        if at_once and (cut := ended & ~terminated).any():
            there[:, cut] = self._finals(cut, infos)[:, cut]
        shaping = self._episodes.go(stepped, there, rewards, self.discount)
        terms = dict(zip(self._potential.sources, shaping[1:], strict=True))
        infos = {
            **infos,
            **_told(stepped, original_reward=rewards, shaping=shaping[0], potential=there[0]),
            "shaping_terms": _told(stepped, **terms),
            "_shaping_terms": stepped,
        }
        if ended.any():
            infos |= self._end(ended)
        self._episodes.begin(begun, here, rows, self._steps)
        return observations, rewards + shaping[0], terminated, truncated, infos

    def _rows(self, observations: Any) -> list[Any]:
        return list(iterate(self.env.observation_space, observations))

    def _finals(self, cut: BoolArray, infos: dict[str, Any]) -> FloatArray:
        """Return the potentials of the states in which episodes were cut off."""
        rows = list(self._episodes.first)  # any observation does where none was cut off
        for i in np.flatnonzero(cut).tolist():
            if "final_obs" not in infos or infos["final_obs"][i] is None:
                raise SettingError(
                    "a vector environment that resets in the same step must hand over the "
                    "observation at which it cut an episode off, in infos['final_obs']: "
                    f"sub-environment {i} did not"
                )
            rows[i] = infos["final_obs"][i]
        return self._potential.many(rows, cut, self._steps)

    def _end(self, ended: BoolArray) -> dict[str, Any]:
        """Close the accounts of episodes and return what they came to."""
        episodes = self._episodes
        episodes.running = episodes.running & ~ended
        start = self._potential.many(episodes.first, ended, episodes.begun)[0]
        residual = episodes.shaped - (episodes.power * episodes.here[0] - start)
        for i in np.flatnonzero(ended).tolist():
            place = f"at the end of an episode of sub-environment {i}"
            self._potential.check_telescoping(residual[i], episodes.largest[i], place)
        return _told(ended, telescoping_residual=residual, original_return=episodes.original)


class _Episodes:
    """The accounts of n sub-environments' episodes; potentials are Phi and after it each source's.

    What is in them of a sub-environment that is in no episode means nothing.
    """

    def __init__(self, n_sources: int, n: int):
        self.running = np.zeros(n, np.bool_)
        self.first: list[Any] = [None] * n  # the observation it began with
        self.begun = np.zeros(n, np.int64)  # the step at which it began
        self.here = np.zeros((1 + n_sources, n))  # the potentials of the state it has reached
        self.largest = np.zeros(n)  # |Phi| met so far
        self.power = np.ones(n)  # gamma^t
        self.shaped = np.zeros(n)  # sum of gamma^t F_t
        self.original = np.zeros(n)  # sum of the environment's own rewards

    def begin(self, begun: BoolArray, here: FloatArray, rows: list[Any], step: int) -> None:
        """Open an account where an episode has begun; `here` are the potentials of all states."""
        self.here = here
        self.running = self.running | begun
        for i in np.flatnonzero(begun).tolist():
            self.first[i] = deepcopy(rows[i])
        self.begun[begun], self.largest[begun] = step, abs(here[0, begun])
        self.power[begun], self.shaped[begun], self.original[begun] = 1.0, 0.0, 0.0

    def go(
        self, stepped: BoolArray, there: FloatArray, rewards: FloatArray, discount: float
    ) -> FloatArray:
        """Enter a step, which went `there`, and return F, (1 + N, n); 0 where none was made."""
        shaping = np.where(stepped, discount * there - self.here, 0.0)
        self.here = there
        self.largest = np.maximum(self.largest, abs(there[0]))
        self.shaped += self.power * shaping[0]
        self.power *= discount
        self.original += rewards
        return shaping


def _told(mask: BoolArray, /, **arrays: FloatArray) -> dict[str, Any]:
    """Return arrays as Gymnasium tells them: 0 where the mask is false, which is beside each."""
    told: dict[str, Any] = {}
    for name, values in arrays.items():
        told[name], told[f"_{name}"] = np.where(mask, values, 0.0), mask
    return told
