"""Potential-based shaping of vector environments, in all their ways of resetting."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from curricle.errors import SettingError
from curricle.interop.shaping_episodes import Episodes
from curricle.interop.shaping_sources import Potential
from curricle.interop.shaping_terms import check_unshaped, observed_potential
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
        Whether potential functions return an (m,) array for m observations, stacked as the vector
        environment does it, and `encode` an (m,) array of integers. m is n but where episodes end:
        there the observations at which they were cut off and began come in as well. Otherwise
        they are called with one observation after another. In neither case is there one among them
        that ended an episode by termination. Sources of values always read stacked observations.

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
        self._episodes = Episodes(
            self._potential,
            env.observation_space,
            env.num_envs,
            at_once=self._resets is AutoresetMode.SAME_STEP,
        )

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
        self._episodes.begin(begun, observations)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Return what the environments return, their rewards shaped and their infos told so."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        check_unshaped(infos)
        finals = self._finals(truncated & ~terminated, infos)
        shaped = self._episodes.step(observations, rewards, terminated, truncated, finals)
        stepped, shaping = shaped.stepped, shaped.shaping
        terms = dict(zip(self._potential.sources, shaping[1:], strict=True))
        told = {"original_reward": rewards, "shaping": shaping[0], "potential": shaped.potential}
        infos = {
            **infos,
            **_told(stepped, **told),
            "shaping_terms": _told(stepped, **terms),
            "_shaping_terms": stepped,
        }
        if shaped.ended.any():
            told = {"telescoping_residual": shaped.residual, "original_return": shaped.original}
            infos |= _told(shaped.ended, **told)
        return observations, rewards + shaping[0], terminated, truncated, infos

    def _finals(self, cut: BoolArray, infos: dict[str, Any]) -> dict[int, Any]:
        """Return the observations in which episodes were cut off, where others were returned."""
        if self._resets is not AutoresetMode.SAME_STEP:
            return {}
        places = np.flatnonzero(cut).tolist()
        for i in places:
            if "final_obs" not in infos or infos["final_obs"][i] is None:
                raise SettingError(
                    "a vector environment that resets in the same step must hand over the "
                    "observation at which it cut an episode off, in infos['final_obs']: "
                    f"sub-environment {i} did not"
                )
        return {i: infos["final_obs"][i] for i in places}


def _told(mask: BoolArray, /, **arrays: FloatArray) -> dict[str, Any]:
    """Return arrays as Gymnasium tells them: 0 where the mask is false, which is beside each."""
    told: dict[str, Any] = {}
    for name, values in arrays.items():
        told[name], told[f"_{name}"] = np.where(mask, values, 0.0), mask
    return told
