"""A vector environment of Stable-Baselines3 with shaped rewards: :class:`ShapedVecEnv`."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium.vector.utils import batch_space

from curricle.arrays import BoolArray, FloatArray
from curricle.checks import instance
from curricle.errors import SettingError
from curricle.interop.potential_shaping import (
    Episodes,
    Potential,
    Shaped,
    ShapingPotential,
    check_unshaped,
    unstack,
)
from curricle.learning.schedules import Schedule
from curricle.tasks.observation_task import Observations
from curricle.transfer.aggregate import Aggregate

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, unwrap_vec_normalize
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    VecEnv = VecEnvWrapper = object


class ShapedVecEnv(Shaped, VecEnvWrapper):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of each of n sub-environments.

    It is :class:`PotentialShaping` for Stable-Baselines3, with the entries of its ``info``;
    ``shaping_terms`` only if there are several sources. Where an episode was cut off
    (``info["TimeLimit.truncated"]``) s' is ``info["terminal_observation"]``, from which the
    algorithms bootstrap; what the step returns is where the next episode begins.

    `Monitor`, `VecMonitor` and wrappers that clip rewards belong inside, so that
    ``rollout/ep_rew_mean`` is the task's; `VecNormalize` belongs outside.

    Parameters
    ----------
    venv : stable_baselines3.common.vec_env.VecEnv
    potential, discount, weight, aggregate, encode, tolerance
        As in :class:`PotentialShaping`; the discount must be the algorithm's ``gamma``, t counts
        the steps of all sub-environments together.

    Raises
    ------
    PotentialError, SettingError
        As in :class:`PotentialShaping`; when an environment hands over no terminal observation;
        when a `VecNormalize` is inside, because off-policy algorithms would store its unshaped
        rewards; and when an algorithm such as hindsight replay calls ``compute_reward``, whose
        rewards would be unshaped too.

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
    ):
        if VecEnv is object:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        instance("the environments of ShapedVecEnv", venv, VecEnv, SettingError)
        super().__init__(venv)
        if unwrap_vec_normalize(venv) is not None:
            raise SettingError(
                "VecNormalize must be outside of the shaping: off-policy algorithms store the "
                "rewards that go into it"
            )
        settings: dict[str, Any] = {
            "discount": discount, "weight": weight, "aggregate": aggregate, "encode": encode,
            "tolerance": tolerance,
        }  # fmt: skip
        space = venv.observation_space
        self._potential = ShapingPotential(potential, space, **settings)
        self._stacked_space = batch_space(space, venv.num_envs)
        self._episodes = Episodes(self._potential, venv.num_envs)

    def reset(self) -> Observations:
        """Reset all sub-environments and return what they return."""
        observations: Observations = self.venv.reset()
        self._episodes.begin(unstack(self._stacked_space, observations), observations)
        return observations

    def step_wait(self) -> tuple[Observations, FloatArray, BoolArray, list[dict[str, Any]]]:
        """Return what the environments return, with shaped rewards and their parts in the infos."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for info in infos:
            check_unshaped(info)
        truncated = np.array([info.get("TimeLimit.truncated", False) for info in infos]) & dones
        begun = unstack(self._stacked_space, observations)
        rows = begun.copy() if truncated.any() else begun
        for i in np.flatnonzero(truncated).tolist():
            if (final := infos[i].get("terminal_observation")) is None:
                raise SettingError(
                    "a vector environment must return the observation at which it cut an episode "
                    f"off, in info['terminal_observation']: sub-environment {i} did not"
                )
            rows[i] = final
        ends = (dones & ~truncated).tolist(), truncated.tolist()
        done = self._episodes.step(rows, rewards.tolist(), *ends, begun, observations)
        sources, shaped_infos = self._potential.sources, []
        parts = zip(infos, rewards.tolist(), done.shaping, done.phi, strict=True)
        for i, (info, reward, (shaping, *terms), potentials) in enumerate(parts):
            shown = {"original_reward": reward, "shaping": shaping, "potential": potentials[0]}
            if len(sources) > 1:
                shown["shaping_terms"] = dict(zip(sources, terms, strict=True))
            shaped_infos.append({**info, **shown, **done.ended.get(i, {})})
        shaped = np.array([shaping[0] for shaping in done.shaping]) + rewards
        return observations, shaped, dones, shaped_infos

    def env_method(
        self, method_name: str, *args: object, indices: object = None, **named: object
    ) -> list[Any]:
        """Call a method of the environments; SettingError where it recomputes rewards."""
        if method_name == "compute_reward":
            raise SettingError(
                "rewards computed anew, as in hindsight replay, would lack the shaping: such an "
                "algorithm must learn from the unshaped environment"
            )
        returned: list[Any] = self.venv.env_method(method_name, *args, indices=indices, **named)
        return returned
