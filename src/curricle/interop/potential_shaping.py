"""Potential-based shaping of any Gymnasium environment, one or many, for any algorithm.

Ng, Harada and Russell 1999 (paper E2): F = gamma Phi(s') - Phi(s), added to the reward, changes no
optimal policy. That holds for an episode that ends only if the potential of a terminal state is 0
(Grzes 2017); an episode that is cut off has not reached a terminal state and keeps Phi(s').
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from curricle.array_types import BoolArray, FloatArray
from curricle.errors import SettingError
from curricle.interop.potential_sources import Potential
from curricle.interop.shaping_potential import Episode, Episodes, check_unshaped, shaping_potential
from curricle.learning.schedules import Schedule
from curricle.transfer.aggregation import Aggregate

if TYPE_CHECKING:
    AnyVectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
else:  # it takes types only in newer versions of Gymnasium
    AnyVectorWrapper = VectorWrapper


class PotentialShaping(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of an environment.

    Phi(s') is 0 where the step terminated and only there: truncation keeps it, and the learner must
    bootstrap from s'. Nothing else of the environment changes. Values learnt from the shaped
    rewards are Q - Phi; the greedy policy is the same.

    Each step's ``info`` holds

    - ``original_reward``: the environment's own;
    - ``shaping``: F;
    - ``shaping_terms``: F_i = w(t + 1) gamma Phi_i(s') - w(t) Phi_i(s) of each source alone. F is
      their mean under `mean` and their sum under `total`; under `maximum` and `minimum` it lies
      between the least and the largest of them;
    - ``potential``: Phi(s'), which is 0 where the step terminated;
    - at an episode's end ``original_return``, the undiscounted sum of the original rewards, and
      ``telescoping_residual``: sum_t gamma^t F_t - (gamma^T Phi(s_T) - Phi(s_0)), with Phi(s_0)
      computed anew from a copy of the observation. It is 0, but for rounding, where Phi is a
      function of the observation (and t) alone.

    A step after an episode's end is taken to be the reset of an environment that resets itself
    (`gymnasium.wrappers.Autoreset`): its reward stays as it is. Wrappers that record returns belong
    inside, where rewards are the original ones: ``PotentialShaping(RecordEpisodeStatistics(env))``.

    Parameters
    ----------
    env : gymnasium.Env
    potential : callable, potential over a task, source of values, or dict of str to these
        A function observation -> float; or a `StatePotential`, `MappedPotential` or
        `StateActionPotential`, whose Phi(s) = max_a phi(s, a), over the states that the
        observations number: as a whole (`Discrete`), or component by component (`MultiDiscrete`,
        `Tuple`); or an `ObservationPotential` or other `ValueSource`, whose Phi(s) = V(s). Several
        sources have names.
    discount : float, optional
        gamma, which must be the learner's. Needed where no potential has a task to state it.
    weight : float or Schedule
        w(t), which multiplies Phi; t counts the steps taken through this wrapper, episode after
        episode, also for a `StatePotential` that changes with time (Devlin, Kudenko 2012).
    aggregate : callable, optional
        g of Phi = w g(Phi_1, ..., Phi_N), (N, S, A) -> (S, A), called with S = A = 1; the mean
        unless given.
    encode : callable, optional
        observation -> number of the state, for potentials over a task.
    tolerance : float or None
        The largest residual allowed, as a share of the largest size of Phi in the episode; for a
        `ValueSource` at least 0.001, as networks round. None allows any, for potentials that
        change, such as a network in training. Shaping is sound for these too (Devlin, Kudenko
        2012): what is subtracted on leaving s is the number that was added on arriving there.

    Raises
    ------
    PotentialError
        When a value is not finite, naming the observation; when an episode's residual exceeds
        the tolerance.
    SettingError
        When the discount is not stated, or stated differently; when observations do not number
        the states of a task; when the environment is shaped already.

    Examples
    --------
    >>> import gymnasium
    >>> lake = gymnasium.make("FrozenLake-v1", is_slippery=False)
    >>> env = PotentialShaping(lake, lambda square: square / 15, discount=0.9)
    >>> env.reset(seed=0)[0], env.step(1)[:2]  # to square 4: 0.9 * 4 / 15 - 0
    (0, (4, 0.24))
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        potential: Potential | Mapping[str, Potential],
        *,
        discount: float | None = None,
        weight: float | Schedule = 1.0,
        aggregate: Aggregate | None = None,
        encode: Callable[[Any], Any] | None = None,
        tolerance: float | None = 1e-6,
    ):
        settings: dict[str, Any] = {
            "potential": potential, "discount": discount, "weight": weight,
            "aggregate": aggregate, "encode": encode, "tolerance": tolerance,
        }  # fmt: skip
        # Potentials are functions or frozen: a copy of a large one would only cost memory.
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **settings)
        gymnasium.Wrapper.__init__(self, env)
        self._potential = shaping_potential(space=env.observation_space, **settings)
        self._steps = 0
        self._episode: Episode | None = None

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and return what it returns."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin(observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Return what the environment returns, with the shaped reward and its parts in the info."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        check_unshaped(info)
        episode = self._episode
        if episode is None:
            here = self._begin(observation)
            shown = self._shown(reward, [0.0] * len(here), here)
            return observation, reward, terminated, truncated, {**info, **shown}
        self._steps += 1
        if terminated:
            there = [0.0] * len(episode.here)
        else:
            there = self._potential.one(observation, self._steps)
        shaping = episode.step(there, float(reward), self.discount)
        shown = self._shown(reward, shaping, there)
        if terminated or truncated:
            self._episode = None
            start = self._potential.one(episode.first, episode.begun)[0]
            place = f"after {self._steps - episode.begun} steps"
            shown |= episode.end(self._potential, start, place)
        return observation, float(reward) + shaping[0], terminated, truncated, {**info, **shown}

    def _begin(self, observation: Any) -> list[float]:
        here = self._potential.one(observation, self._steps)
        self._episode = Episode(observation, self._steps, here)
        return here

    def _shown(
        self, reward: SupportsFloat, shaping: list[float], there: list[float]
    ) -> dict[str, Any]:
        return {
            "original_reward": reward,
            "shaping": shaping[0],
            "shaping_terms": dict(zip(self._potential.sources, shaping[1:], strict=True)),
            "potential": there[0],
        }


class VectorPotentialShaping(AnyVectorWrapper, RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of each of n sub-environments.

    It is :class:`PotentialShaping` for vector environments: the same potentials, the same rules,
    episode by episode of each sub-environment. Where ``metadata["autoreset_mode"]`` is

    - NEXT_STEP, the step that only resets a sub-environment has F = 0 and keeps its reward;
    - SAME_STEP, s' of a step that cuts an episode off is ``infos["final_obs"]``, and the
      observation returned is where the next episode begins;
    - DISABLED, an episode begins where ``reset(options={"reset_mask": ...})`` says so.

    ``infos`` holds the entries of `PotentialShaping` as (n,) float64 arrays, each with its mask
    under the name with an underscore in front, ``shaping_terms`` as a dict of such arrays. The
    masks leave out the sub-environments that only reset; ``telescoping_residual`` and
    ``original_return`` are there when an episode ended, with the mask of the ended. ``potential``
    is Phi(s') of the state the step arrived in, in SAME_STEP too.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
    potential, discount, weight, aggregate, encode, tolerance
        As in :class:`PotentialShaping`. The t of potentials that change with time counts the steps
        of all sub-environments together, as a budget does.
    batched : bool
        Whether potential functions return an (m,) array for m observations, stacked as the vector
        environment does it, and `encode` an (m,) array of integers. m is n, or more where episodes
        end: then the observations at which they were cut off and began are read as well. Otherwise
        functions are called with one observation after another. Observations that ended an episode
        by termination are never read. Sources of values always read stacked observations.

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
        mode = env.metadata.get("autoreset_mode")
        if not isinstance(mode, AutoresetMode):
            raise SettingError(
                "a vector environment must say how it resets, in metadata['autoreset_mode']: got "
                f"{mode!r}"
            )
        finals_in = "infos['final_obs']" if mode is AutoresetMode.SAME_STEP else None
        self._potential = shaping_potential(space=env.single_observation_space, **settings)
        self._episodes = Episodes(self._potential, env.observation_space, env.num_envs, finals_in)

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the sub-environments, or those of ``options["reset_mask"]``."""
        options = None if options is None else dict(options)  # environments take the mask out of it
        mask = (options or {}).get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)
        self._episodes.begin(observations, mask)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Return what the environments return, with shaped rewards and their parts in the infos."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        check_unshaped(infos)
        finals = infos.get("final_obs", [None] * self.num_envs)
        done = self._episodes.step(observations, rewards, terminated, truncated, finals.__getitem__)
        shaping, stepped = np.array(done.shaping).T, np.array(done.stepped)
        potential = np.array(done.potential)
        infos = {
            **infos,
            **_shown(stepped, original_reward=rewards, shaping=shaping[0], potential=potential),
            "shaping_terms": _shown(
                stepped, **dict(zip(self._potential.sources, shaping[1:], strict=True))
            ),
            "_shaping_terms": stepped,
        }
        if done.ended:
            ended = np.zeros(self.num_envs, np.bool_)
            ended[list(done.ended)] = True
            for name in ("telescoping_residual", "original_return"):
                infos[name], infos[f"_{name}"] = np.zeros(self.num_envs), ended
                infos[name][ended] = [reported[name] for _, reported in sorted(done.ended.items())]
        return observations, rewards + shaping[0], terminated, truncated, infos


def _shown(mask: BoolArray, /, **arrays: FloatArray) -> dict[str, Any]:
    """Return arrays as Gymnasium's infos hold them: 0 where the mask is false, each with it."""
    shown: dict[str, Any] = {}
    for name, values in arrays.items():
        shown[name], shown[f"_{name}"] = np.where(mask, values, 0.0), mask
    return shown
