"""Potential-based shaping of any Gymnasium environment, for any algorithm.

Ng, Harada and Russell 1999 (paper E2): F = gamma Phi(s') - Phi(s), added to the reward, changes no
optimal policy. That holds for an episode that ends only if the potential of a terminal state is 0
(Grzes 2017), and one that is merely cut off has not reached a terminal state: it keeps Phi(s').
"""

from collections.abc import Callable, Mapping
from typing import Any, SupportsFloat

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from curricle.interop.shaping_episodes import Episode
from curricle.interop.shaping_sources import Potential
from curricle.interop.shaping_terms import check_unshaped, observed_potential
from curricle.learning.schedules import Schedule
from curricle.transfer.aggregation import Aggregate


class PotentialShaping(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of an environment.

    Phi(s') is 0 where the step terminated and only there: truncation keeps it, and so must the
    learner, which bootstraps from s'. Nothing else of the environment changes. Values learnt from
    the shaped rewards are Q - Phi; the greedy policy is the same.

    A step's ``info`` says what was done to its reward:

    - ``original_reward``: the environment's own;
    - ``shaping``: F;
    - ``shaping_terms``: for each source, F_i = w(t + 1) gamma Phi_i(s') - w(t) Phi_i(s), what it
      would pay if it were the only one. Under a linear aggregate F is the same of them: their mean
      under `mean`, their sum under `total`. Other aggregates have no shares to tell: under
      `maximum` and `minimum` F may follow one source at s and another at s', and all that is sure
      is that it lies between the least and the largest F_i;
    - ``potential``: Phi(s'), which is 0 where the step terminated;
    - at an episode's end ``original_return``, the undiscounted sum of the original rewards, and
      ``telescoping_residual``: sum_t gamma^t F_t - (gamma^T Phi(s_T) - Phi(s_0)), with Phi(s_0)
      computed anew from a copy of the observation. Rounding aside it is 0 for a function of the
      observation alone, and not for one that looks at something else or changes.

    A step after an episode's end is taken to be the reset of an environment that resets itself
    (`gymnasium.wrappers.Autoreset`): its reward stays as it is.

    Wrappers that record returns belong inside, where they see the original rewards:
    ``PotentialShaping(RecordEpisodeStatistics(env), ...)``, or ``Monitor`` of Stable-Baselines3.

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
        w(t), t the steps taken through this wrapper, episode after episode. It multiplies Phi, as
        do frames and weight of a `StatePotential`, which go by the same t (Devlin, Kudenko 2012).
    aggregate : callable, optional
        g of Phi = w g(Phi_1, ..., Phi_N), (N, S, A) -> (S, A) as everywhere, called with S = A = 1;
        the mean unless given.
    encode : callable, optional
        observation -> number of the state, for potentials over a task.
    tolerance : float or None
        How large the residual may be, as a share of the largest size of Phi in the episode; up to
        0.001 in any case for a `ValueSource`, which may be a network that rounds. None raises no
        error, for potentials that change on purpose, such as a network in training.
        Shaping is sound for these too (Devlin, Kudenko 2012): what is taken back on leaving s is
        the number that was paid on arriving there.

    Raises
    ------
    PotentialError
        When a value is no finite number, naming the observation; when an episode's residual is
        beyond the tolerance.
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
        self._potential = observed_potential(space=env.observation_space, **settings)
        self._steps = 0
        self._episode: Episode | None = None

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; what it returns is handed on."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin(observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Return what the environment returns, its reward shaped and its info told so."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        check_unshaped(info)
        if self._episode is None:
            here = self._begin(observation)
            told = self._told(reward, [0.0] * len(here), here)
            return observation, reward, terminated, truncated, {**info, **told}
        self._steps += 1
        if terminated:
            there = [0.0] * len(self._episode.here)
        else:
            there = self._potential.one(observation, self._steps)
        shaping = self._episode.go(there, float(reward), self.discount)
        told = self._told(reward, shaping, there)
        if terminated or truncated:
            told |= self._end(self._episode)
        return observation, float(reward) + shaping[0], terminated, truncated, {**info, **told}

    def _begin(self, observation: Any) -> list[float]:
        here = self._potential.one(observation, self._steps)
        self._episode = Episode(observation, self._steps, here)
        return here

    def _told(
        self, reward: SupportsFloat, shaping: list[float], there: list[float]
    ) -> dict[str, Any]:
        return {
            "original_reward": reward,
            "shaping": shaping[0],
            "shaping_terms": dict(zip(self._potential.sources, shaping[1:], strict=True)),
            "potential": there[0],
        }

    def _end(self, episode: Episode) -> dict[str, float]:
        self._episode = None
        start = self._potential.one(episode.first, episode.begun)[0]
        residual, steps = episode.residual(start), self._steps - episode.begun
        self._potential.check_telescoping(residual, episode.largest, f"after {steps} steps")
        return {"telescoping_residual": residual, "original_return": episode.original}
