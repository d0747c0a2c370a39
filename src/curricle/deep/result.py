"""The result of a deep learner: a learning result with policies to take away."""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np

from curricle.deep.policy import TrainedPolicy, policies_of
from curricle.learning.result import LearningResult


@dataclass(frozen=True, eq=False, repr=False)
class DeepResult(LearningResult):
    """What :func:`learn_deep` found: a :class:`LearningResult`, and the policies that were learnt.

    Examples
    --------
    >>> from curricle import observation_task
    >>> from curricle.deep import DeepLearner, learn_deep
    >>> ppo = DeepLearner("PPO", settings={"n_steps": 64})
    >>> result = learn_deep(observation_task("CartPole-v1"), ppo, 128, seeds=2, eval_freq=64)
    >>> result.policies
    (TrainedPolicy(PPO, CartPole-v1), TrainedPolicy(PPO, CartPole-v1))
    """

    @classmethod
    def of(cls, result: LearningResult) -> Self:
        """Return the result of networks as one with policies."""
        return cls(**{field.name: getattr(result, field.name) for field in fields(result)})

    @cached_property
    def policies(self) -> tuple[TrainedPolicy, ...]:
        """The policy of each seed, K of them.

        They act, are saved as Stable-Baselines3 saves models, and play episodes to look at.
        SettingError where values were not saved.
        """
        return policies_of(self.task, self.learner, self.values, self.steps_used)

    @property
    def policy(self) -> TrainedPolicy:
        """The policy of the seed whose last greedy return is best, the first of equals.

        That return says too much of it, as it was chosen by it. Without evaluation it is the policy
        of the first seed.
        """
        last = self.greedy_return[:, -1]
        return self.policies[0 if np.isnan(last).all() else int(np.nanargmax(last))]
