"""Potential-based shaping of Stable-Baselines3's vector environments, for all its algorithms."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import batch_space, iterate
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, unwrap_vec_normalize

from curricle.errors import SettingError
from curricle.interop.shaping_episodes import Episodes, Shaped
from curricle.interop.shaping_sources import Potential
from curricle.interop.shaping_terms import check_unshaped, observed_potential
from curricle.learning.schedules import Schedule
from curricle.transfer.aggregation import Aggregate

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


class ShapedVecEnv(VecEnvWrapper):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of each of n sub-environments.

    It is :class:`VectorPotentialShaping` for the vector environments of Stable-Baselines3: Phi(s')
    is 0 where an episode terminated; where it was cut off (``info["TimeLimit.truncated"]``) s' is
    ``info["terminal_observation"]``, from which the algorithms bootstrap; and the observation that
    is returned with an end is where the next episode begins. All observations of a step are read in
    one batch.

    Each sub-environment's ``info`` holds ``original_reward``, ``shaping`` (F) and ``potential``
    (Phi(s')); with several sources ``shaping_terms``, F_i of each; and at an episode's end
    ``original_return`` and ``telescoping_residual``, all as :class:`PotentialShaping` tells them.

    What stands inside sees the task's own rewards, what stands outside the shaped ones. `Monitor`,
    `VecMonitor` and wrappers that clip rewards belong inside: then ``rollout/ep_rew_mean`` is that
    of the task. `VecNormalize` belongs outside. An environment for evaluation needs no shaping.

    Parameters
    ----------
    venv : stable_baselines3.common.vec_env.VecEnv
    potential, discount, weight, aggregate, encode, tolerance, batched
        As in :class:`VectorPotentialShaping`; the discount must be the algorithm's ``gamma``.

    Raises
    ------
    PotentialError, SettingError
        As :class:`VectorPotentialShaping`; when a `VecNormalize` stands inside, whose own rewards
        off-policy algorithms would store instead of the shaped; and when an algorithm asks for
        ``compute_reward``, as hindsight replay does, for what it would get is unshaped.

    Examples
    --------
    >>> import gymnasium
    >>> from stable_baselines3.common.vec_env import DummyVecEnv
    >>> lakes = DummyVecEnv([lambda: gymnasium.make("FrozenLake-v1", is_slippery=False)] * 2)
    >>> venv = ShapedVecEnv(lakes, lambda square: square / 15, discount=0.9)
    >>> venv.reset(), venv.step(np.array([1, 2]))[1]  # to the squares 4 and 1
    (array([0, 0]), array([0.24, 0.06]))
    """

    def __init__(
        self,
        venv: VecEnv,
        potential: Potential | Mapping[str, Potential],
        *,
        discount: float | None = None,
        weight: float | Schedule = 1.0,
        aggregate: Aggregate | None = None,
        encode: Callable[[Any], Any] | None = None,
        tolerance: float | None = 1e-6,
        batched: bool = False,
    ):
        super().__init__(venv)
        if unwrap_vec_normalize(venv) is not None:
            raise SettingError(
                "VecNormalize must stand outside of the shaping: off-policy algorithms store the "
                "rewards that go into it"
            )
        self._potential = observed_potential(
            potential,
            venv.observation_space,
            discount=discount,
            weight=weight,
            aggregate=aggregate,
            encode=encode,
            tolerance=tolerance,
            batched=batched,
        )
        self._stacked_space = batch_space(venv.observation_space, venv.num_envs)
        self._episodes = Episodes(self._potential, venv.num_envs, at_once=True)

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(self) -> Any:
        """Reset all sub-environments; what they return is handed on."""
        observations = self.venv.reset()
        self._episodes.begin(np.ones(self.num_envs, np.bool_), self._rows(observations))
        return observations

    def step_wait(self) -> tuple[Any, FloatArray, BoolArray, list[dict[str, Any]]]:
        """Return what the environments return, their rewards shaped and their infos told so."""
        observations, rewards, dones, infos = self.venv.step_wait()
        finals = _finals(dones, infos)
        truncated = np.zeros(self.num_envs, np.bool_)
        truncated[list(finals)] = True
        shaped = self._episodes.step(
            self._rows(observations),
            observations,
            rewards,
            terminated=dones & ~truncated,
            truncated=truncated,
            finals=finals,
        )
        return observations, rewards + shaped.shaping[0], dones, self._told(infos, rewards, shaped)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **named: Any) -> Any:
        """Call a method of the environments; SettingError where it recomputes rewards."""
        if method_name == "compute_reward":
            raise SettingError(
                "rewards that are computed anew, as in hindsight replay, would lack the shaping; "
                "an algorithm that does so must learn from the environment itself"
            )
        return self.venv.env_method(method_name, *args, indices=indices, **named)

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        del state["class_attributes"]  # the class's members, of which some cannot be pickled
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))

    def _rows(self, observations: Any) -> list[Any]:
        return list(iterate(self._stacked_space, observations))

    def _told(
        self, infos: list[dict[str, Any]], rewards: FloatArray, shaped: Shaped
    ) -> list[dict[str, Any]]:
        """Return the infos with what was done to the rewards."""
        columns = rewards.tolist(), shaped.shaping[0].tolist(), shaped.potential.tolist()
        told = [
            {**info, "original_reward": reward, "shaping": shaping, "potential": potential}
            for info, reward, shaping, potential in zip(infos, *columns, strict=True)
        ]
        sources = self._potential.sources
        if len(sources) > 1:
            for info, terms in zip(told, shaped.shaping[1:].T.tolist(), strict=True):
                info["shaping_terms"] = dict(zip(sources, terms, strict=True))
        for i in np.flatnonzero(shaped.ended).tolist():
            told[i]["telescoping_residual"] = float(shaped.residual[i])
            told[i]["original_return"] = float(shaped.original[i])
        return told


def _finals(dones: BoolArray, infos: list[dict[str, Any]]) -> dict[int, Any]:
    """Return the observations in which episodes were cut off, by sub-environment."""
    finals = {}
    for i, (done, info) in enumerate(zip(dones.tolist(), infos, strict=True)):
        check_unshaped(info)
        if done and info.get("TimeLimit.truncated", False):
            if info.get("terminal_observation") is None:
                raise SettingError(
                    "a vector environment must hand over the observation at which it cut an "
                    "episode off, in info['terminal_observation']: sub-environment "
                    f"{i} did not"
                )
            finals[i] = info["terminal_observation"]
    return finals
