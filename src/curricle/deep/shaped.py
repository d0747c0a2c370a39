"""Potential-based shaping of Stable-Baselines3's vector environments, for all its algorithms."""

import inspect
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import batch_space

from curricle.errors import SettingError
from curricle.interop.shaping_episodes import Episode
from curricle.interop.shaping_sources import Potential, unstack
from curricle.interop.shaping_terms import check_unshaped, observed_potential
from curricle.learning.schedules import Schedule
from curricle.transfer.aggregation import Aggregate

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, unwrap_vec_normalize
except ModuleNotFoundError:  # the extra is not installed; making one says so
    VecEnv = VecEnvWrapper = object

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
        if VecEnv is object:
            raise ImportError("Stable-Baselines3 is not installed: pip install curricle[deep]")
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
        self._steps = 0  # of all sub-environments together
        self._episodes: list[Episode] = []

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(self) -> Any:
        """Reset all sub-environments; what they return is handed on."""
        observations = self.venv.reset()
        rows = unstack(self._stacked_space, observations)
        here = self._potential.each(rows, self._steps, observations)
        self._episodes = [
            Episode(first, self._steps, phi) for first, phi in zip(rows, here, strict=True)
        ]
        return observations

    def step_wait(self) -> tuple[Any, FloatArray, BoolArray, list[dict[str, Any]]]:
        """Return what the environments return, their rewards shaped and their infos told so."""
        observations, rewards, dones, infos = self.venv.step_wait()
        self._steps += self.num_envs
        rows = unstack(self._stacked_space, observations)
        ended = [i for i, done in enumerate(dones.tolist()) if done]
        here, there, starts = self._read(rows, observations, ended, _finals(ended, infos))
        shaped, told = [], []
        steps = zip(self._episodes, there, rewards.tolist(), infos, strict=True)
        sources, discount = self._potential.sources, self.discount
        for episode, phi, reward, info in steps:
            check_unshaped(info)
            shaping = episode.go(phi, reward, discount)
            shaped.append(reward + shaping[0])
            own = {"original_reward": reward, "shaping": shaping[0], "potential": phi[0]}
            if len(sources) > 1:
                own["shaping_terms"] = dict(zip(sources, shaping[1:], strict=True))
            told.append(info | own)
        for i, start in starts.items():
            told[i] |= self._close(i, start)
            self._episodes[i] = Episode(rows[i], self._steps, here[i])
        return observations, np.array(shaped), dones, told

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

    def _read(
        self, rows: list[Any], stacked: Any, ended: list[int], finals: dict[int, Any]
    ) -> tuple[list[list[float]], list[list[float]], dict[int, float]]:
        """Return the potentials of what was returned, those of s', and Phi where the ended began.

        They are read at once: a network costs as much for one as for many.
        """
        if not ended:
            here = self._potential.each(rows, self._steps, stacked)
            return here, here, {}
        over = [self._episodes[i] for i in ended]
        asked = [*rows, *finals.values(), *(episode.first for episode in over)]
        now = [self._steps] * (len(rows) + len(finals))
        steps = np.array([*now, *(episode.begun for episode in over)])
        read = iter(self._potential.each(asked, steps))
        here = list(islice(read, len(rows)))
        there = here.copy()
        for i in ended:
            there[i] = next(read) if i in finals else [0.0] * len(here[i])
        return here, there, {i: phi[0] for i, phi in zip(ended, read, strict=True)}

    def _close(self, i: int, start: float) -> dict[str, float]:
        """Return what an episode that has ended came to, checked."""
        episode = self._episodes[i]
        residual = episode.residual(start)
        place = f"at the end of an episode of sub-environment {i}"
        self._potential.check_telescoping(residual, episode.largest, place)
        return {"telescoping_residual": residual, "original_return": episode.original}


def _finals(ended: list[int], infos: list[dict[str, Any]]) -> dict[int, Any]:
    """Return the observations in which episodes were cut off, by sub-environment."""
    finals = {}
    for i in ended:
        if infos[i].get("TimeLimit.truncated", False):
            finals[i] = infos[i].get("terminal_observation")
            if finals[i] is None:
                raise SettingError(
                    "a vector environment must hand over the observation at which it cut an "
                    f"episode off, in info['terminal_observation']: sub-environment {i} did not"
                )
    return finals
