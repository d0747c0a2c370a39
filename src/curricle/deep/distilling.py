"""Distillation: a network is fitted to what is known of observations."""

import time
from dataclasses import dataclass

from curricle.checks import instance
from curricle.deep.distillation import Distillation
from curricle.deep.knowledge import Knowledge
from curricle.deep.learner import DeepLearner
from curricle.deep.networks import NetworkValues
from curricle.deep.spaces import check_spaces
from curricle.display import brief_repr
from curricle.errors import SettingError
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask


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

    __repr__ = brief_repr


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
    >>> import numpy as np
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
    instance("task of a distillation", task, ObservationTask, SettingError)
    instance("learner of a distillation", learner, DeepLearner, SettingError)
    instance("settings of a distillation", settings, Distillation, SettingError)
    check_spaces(task, learner)
    learner.algorithm_class()  # ImportError without Stable-Baselines3
    from curricle.deep.fitting import fitted

    began = time.process_time()
    small = splitmix64(stream_start(seed, "distillation")) >> 33
    policy, error, agreement = fitted(knowledge, task, learner, settings, small)
    return Distilled(NetworkValues(policy), error, agreement, time.process_time() - began)
