"""Teachers that only tables allow: by exact values of the policy that is greedy at the time.

No step is charged for these values, as none is taken: they need a model of the tasks.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from curricle.array_types import FloatArray
from curricle.checks import number, whole_number
from curricle.errors import SettingError
from curricle.teaching.episode import Episode
from curricle.teaching.teachers import mixed


class Weights(NamedTuple):
    """What the exact teachers remember."""

    weight: FloatArray  # (M,) >= 0; tasks are drawn in proportion to it
    values: FloatArray | None  # (M,) V^pi when last computed
    episodes: int


@dataclass(frozen=True)
class _Exact:
    """Draws tasks in proportion to a weight that is computed anew every `interval` episodes."""

    interval: int = 10
    epsilon: float = 0.1

    def __post_init__(self) -> None:
        kind = type(self).__name__
        whole_number(f"interval of {kind}", self.interval, 1, SettingError)
        number(f"epsilon of {kind}", self.epsilon, SettingError, 0.0, 1.0)

    def start(self, n_tasks: int) -> Weights:
        """Return equal weights."""
        return Weights(np.zeros(n_tasks), None, 0)

    def update(self, memory: Weights, episode: Episode) -> Weights:
        """Return the memory with new weights, if they are due."""
        now = memory.episodes + 1
        if now % self.interval:
            return memory._replace(episodes=now)
        values = episode.greedy_returns()
        return Weights(self._weight(values, memory.values, episode), values, now)

    def _weight(
        self, values: FloatArray, before: FloatArray | None, episode: Episode
    ) -> FloatArray:
        raise NotImplementedError

    def probabilities(self, memory: Weights) -> FloatArray:
        """Return epsilon / M for each task, and the rest in proportion to the weights."""
        total = memory.weight.sum()
        n_tasks = len(memory.weight)
        share = memory.weight / total if total > 0 else np.full(n_tasks, 1 / n_tasks)
        return mixed(share, self.epsilon)


@dataclass(frozen=True)
class TrueRegret(_Exact):
    """Tasks in proportion to their regret: w_i = max(0, V*_i - V^pi_i), exact, at task i's start.

    The quantity that regret-based curricula estimate (PAIRED; Dennis et al. 2020), without the
    estimate. pi is the greedy policy of the table, the values are discounted. V^pi counts rewards
    up to the time limit, V* does not know it.

    Parameters
    ----------
    interval : int
        Episodes between two computations.
    epsilon : float
        Probability of a uniform draw instead.

    Examples
    --------
    >>> teacher = TrueRegret(epsilon=0.0)
    >>> teacher.probabilities(Weights(np.array([1.0, 3.0]), None, 10))
    array([0.25, 0.75])
    """

    def _weight(
        self, values: FloatArray, before: FloatArray | None, episode: Episode
    ) -> FloatArray:
        return np.maximum(episode.optimal_returns() - values, 0.0)


@dataclass(frozen=True)
class TrueLearningProgress(_Exact):
    """Tasks in proportion to learning progress, the size of the change of V^pi.

    w_i is the distance of V^pi_i from what it was `interval` episodes before: what :class:`TSCL`
    estimates from single returns, without the noise. pi is the greedy policy of the table, the
    values are discounted, exact, and at task i's start.

    Parameters
    ----------
    interval : int
        Episodes between two computations.
    epsilon : float
        Probability of a uniform draw instead.

    Examples
    --------
    >>> teacher = TrueLearningProgress(epsilon=0.0)
    >>> teacher.probabilities(Weights(np.zeros(2), None, 10))
    array([0.5, 0.5])
    """

    def _weight(
        self, values: FloatArray, before: FloatArray | None, episode: Episode
    ) -> FloatArray:
        return np.zeros(len(values)) if before is None else np.abs(values - before)
