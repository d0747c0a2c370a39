"""Distillation: a network is fitted to what is known of observations."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from curricle.array_types import IntArray
from curricle.checks import instance, number, whole_number
from curricle.deep.knowledge import Knowledge
from curricle.deep.learner import DeepLearner
from curricle.deep.networks import NetworkValues
from curricle.errors import SettingError
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask


@dataclass(frozen=True)
class Distillation:
    """How a network is fitted.

    Parameters
    ----------
    updates : int
        Steps of Adam.
    batch_size : int
        Observations of each.
    learning_rate : float
    smoothing : float
        Share of each policy that is spread over all actions (label smoothing, Szegedy et al. 2016).
        An actor that is sure where it was not taught neither explores nor unlearns. Chosen on
        SimpleCrossing of one wall to two, LavaGap of sides 5 and 6 to 7, and DoorKey of side 5 to
        6: with 0.1 what is drawn from the actor returns .53, .25 and .38 there, with 0 .42, .09 and
        .09.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Distillation(updates=200).batch_size
    512
    """

    updates: int = 1_000
    batch_size: int = 512
    learning_rate: float = 1e-3
    smoothing: float = 0.1

    def __post_init__(self) -> None:
        for name in ("updates", "batch_size"):
            whole_number(f"{name} of a distillation", getattr(self, name), 1, SettingError)
        number("learning_rate of a distillation", self.learning_rate, SettingError, low=0)
        number("smoothing of a distillation", self.smoothing, SettingError, low=0, high=1)

    def batches(self, n: int, seed: int) -> Iterator[IntArray]:
        """Yield the rows of each update: all n in a new order, over and over."""
        rng = np.random.default_rng(seed)
        order = rng.permutation(n)
        for _ in range(self.updates):
            if len(order) < min(self.batch_size, n):
                order = np.concatenate([order, rng.permutation(n)])
            yield order[: self.batch_size]
            order = order[self.batch_size :]


@dataclass(frozen=True, eq=False)
class Distilled:
    """A network that was fitted.

    Attributes
    ----------
    values : NetworkValues
        As those of a network that learnt by steps: values, and the policy of an actor-critic.
    value_error : float
        Root mean squared error of V, or of Q for DQN, over the states it was fitted to.
    agreement : float
        Share of those states in which the action it thinks best is one of the best that are known.
    seconds : float
        Processor time of the fit.
    """

    values: NetworkValues
    value_error: float
    agreement: float
    seconds: float


def distil(
    knowledge: Knowledge,
    task: ObservationTask,
    learner: DeepLearner | None = None,
    settings: Distillation | None = None,
    *,
    seed: int = 0,
) -> Distilled:
    """Return a network of a learner's kind, fitted to what is known of observations.

    - An actor-critic's (PPO, A2C) critic by squared error to V, its actor by cross-entropy to the
      policy. Without a policy the critic alone.
    - DQN's and QR-DQN's network by squared error to Q.

    Errors of values are in units of their spread. No step of any environment is taken.

    Parameters
    ----------
    knowledge : Knowledge
    task : ObservationTask
        Whose spaces the network has.
    learner : DeepLearner, optional
        By default PPO.
    settings : Distillation, optional
    seed : int
        Of the first weights and of the batches.

    Raises
    ------
    SettingError
        When a number is out of range, the learner's networks are of another kind, or what is known
        is of other observations or actions than the task's.

    Examples
    --------
    >>> import curricle as cr
    >>> task = cr.observation_task("CartPole-v1")
    >>> carts = np.random.default_rng(0).normal(size=(100, 4)).astype(np.float32)
    >>> upright = Knowledge.of(carts, np.stack([-carts[:, 2], carts[:, 2]], axis=1))
    >>> distilled = distil(upright, task, settings=Distillation(updates=300, batch_size=50))
    >>> distilled.agreement > 0.9
    True
    """
    learner = DeepLearner("PPO") if learner is None else learner
    settings = Distillation() if settings is None else settings
    instance("knowledge to distil", knowledge, Knowledge, SettingError)
    learner.algorithm_class()  # ImportError without Stable-Baselines3
    from curricle.deep.fitting import fitted

    began = time.process_time()
    small = splitmix64(stream_start(seed, "distillation")) >> 33
    policy, error, agreement = fitted(knowledge, task, learner, settings, small)
    return Distilled(NetworkValues(policy), error, agreement, time.process_time() - began)
