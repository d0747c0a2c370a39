"""The result of a deep learner: a learning result with policies to take away."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from curricle.checks import instance
from curricle.deep.learner import DeepLearner
from curricle.deep.policy import TrainedPolicy, policies_of
from curricle.errors import SettingError
from curricle.files import read_saved
from curricle.learning.result import LearningResult
from curricle.learning.shaping import Shaping


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

    @classmethod
    def load(
        cls,
        path: str | Path,
        task: Any = None,
        learner: Any = None,
        shaping: Shaping | Sequence[Shaping | None] | None = None,
    ) -> Self:
        """Return the result in a file that :meth:`save` wrote; the networks are built again.

        The file holds their parameters as plain arrays, and no pickles. :meth:`TrainedPolicy.save`
        writes a file of Stable-Baselines3.

        Parameters
        ----------
        path : path
        task : ObservationTask, optional
        learner : DeepLearner, optional
            Without task and learner the result has curves, and of the networks their parameters.
        shaping : Shaping or sequence of Shaping, optional
            What they were trained with, of each seed if it has a potential.

        Raises
        ------
        StoreError
            When the file cannot be read, is damaged, or holds something else.
        SettingError
            When task, learner or shaping are not those that the networks were trained with.
        """
        saved = read_saved(path, cls.__name__)
        found = cls.of_file(saved, saved.arrays, saved.about, task)
        if learner is not None:
            instance("learner", learner, DeepLearner, SettingError)
            found = replace(found, learner=learner)
        if task is None or learner is None or found.values is None:
            return found
        n = len(found.seeds)
        each = list(shaping) if isinstance(shaping, Sequence) else [shaping] * n
        if len(each) != n:
            raise SettingError(f"a shaping for each of {n} seeds is needed: got {len(each)}")
        learner.algorithm_class()  # raises ImportError that names what to install
        from curricle.deep.models import network_values

        try:
            values = tuple(
                network_values(task, learner, shaping, parameters)
                for shaping, parameters in zip(each, found.values, strict=True)
            )
        except (RuntimeError, KeyError) as error:
            raise SettingError(
                f"networks must be loaded with the task, learner and shaping they were trained "
                f"with: {learner} does not take these parameters, {' '.join(str(error).split())}"
            ) from None
        return replace(found, task=task, values=values)
