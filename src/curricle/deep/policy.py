"""A trained policy to take away: acting, files of Stable-Baselines3, and episodes to look at."""

import io
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from curricle.arrays import IntArray
from curricle.checks import instance, whole_number
from curricle.deep.knowledge import actor_of
from curricle.deep.learner import DeepLearner
from curricle.errors import CurricleError, SettingError, StoreError, reason
from curricle.files import local_file, write_whole
from curricle.interop.tabulation.tabulated_task import check_sight
from curricle.planning.episode import Episode, played
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask, space_text
from curricle.tasks.scene import frame_of, with_pictures
from curricle.transfer.observation_rollouts import (
    Environments,
    ObservationTarget,
    mean_episode_return,
)

TOO_LARGE_SEED = 2**32
"""The first seed that NumPy's generator, which Stable-Baselines3 seeds, does not take."""


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """What a deep learner does in a task it has learnt: ``result.policy`` of its result.

    Parameters
    ----------
    task : ObservationTask
    model : stable_baselines3.common.base_class.BaseAlgorithm
        The algorithm with the trained network.

    Examples
    --------
    >>> from curricle import observation_task
    >>> import numpy as np
    >>> from curricle.deep import learn_deep
    >>> pole = observation_task("CartPole-v1")
    >>> ppo = DeepLearner("PPO", settings={"n_steps": 64})
    >>> policy = learn_deep(pole, ppo, 128, eval_freq=64).policy
    >>> policy
    TrainedPolicy(PPO, CartPole-v1)
    >>> policy.predict(np.zeros((3, 4), dtype=np.float32)).shape
    (3,)
    """

    task: ObservationTask
    model: Any

    def predict(self, observation: Any, *, deterministic: bool = True) -> Any:
        """Return the action in an observation, or those in n stacked ones.

        Parameters
        ----------
        observation : array or dict of arrays
            Of the task's space, (...) or (n, ...); an encoder's where the task has one.
        deterministic : bool
            Whether to take the likeliest action, as evaluations do; else it is sampled, which
            DQN does not do. SettingError where the policy needs memory or masks of actions too.
        """
        check_sight(self.model)
        try:
            actions, _ = self.model.predict(observation, deterministic=deterministic)
        except CurricleError:
            raise
        except ValueError as error:
            space = space_text(self.task.observations)
            raise SettingError(f"a policy takes observations of {space}: {error}") from error
        return actions[()]  # a number where it is one: tables look up no arrays

    def save(self, path: str | Path) -> Path:
        """Write the model as Stable-Baselines3 does, and return the file's path, a ``.zip``.

        ``PPO.load(path)`` reads it, as does :meth:`load`. It holds pickles, as all its files do:
        load your own alone. StoreError when it cannot be written.
        """
        file = local_file(path)
        if not file.name.endswith(".zip"):
            file = file.with_name(f"{file.name}.zip")
        content = io.BytesIO()
        self.model.save(content)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, content.getvalue())
        except OSError as error:
            raise StoreError(f"a policy cannot be written to {file}: {reason(error)}") from None
        return file

    @classmethod
    def load(cls, path: str | Path, task: ObservationTask, learner: DeepLearner) -> Self:
        """Return the policy in a file of Stable-Baselines3.

        Parameters
        ----------
        path : path
        task : ObservationTask
            What it acts in.
        learner : DeepLearner
            Whose algorithm is that of the file.

        Raises
        ------
        SettingError
            When the file is none of the algorithm's, or of other spaces than the task's.
        """
        instance("task of a policy", task, ObservationTask, SettingError)
        instance("learner of a policy", learner, DeepLearner, SettingError)
        algorithm = learner.algorithm_class()
        try:
            model = algorithm.load(path)
        except Exception as error:  # of the file system, of zip files, or of another algorithm
            raise SettingError(
                f"a policy must be in a file that {learner.algorithm} saved: {path} failed with "
                f"{type(error).__name__}: {error}"
            ) from error
        for which, wanted in {"observation": task.observations, "action": task.actions}.items():
            found = getattr(model, f"{which}_space")
            # Pictures with channels last are kept with channels first.
            if found != wanted and sorted(found.shape or ()) != sorted(wanted.shape or ()):
                raise SettingError(
                    f"a policy must have its task's {which}s, {space_text(wanted)}: that in "
                    f"{path} has {space_text(found)}"
                )
        return cls(task, model)

    def episode(
        self, *, seed: int = 0, deterministic: bool = True, max_steps: int | None = None
    ) -> Episode:
        """Return one episode of the policy, with a picture of each step.

        Parameters
        ----------
        seed : int
            Of the reset, and of actions that are sampled.
        deterministic : bool
            As in :meth:`predict`.
        max_steps : int, optional
            Steps after which it is cut off; by default the task's own limit.

        Raises
        ------
        SettingError
            When there is no limit, or the environment draws no pictures: one of an id is made
            with ``render_mode="rgb_array"``, one's own function must do so, or have that argument.
        """
        limit = self.task.longest if max_steps is None else max_steps
        if limit is None:
            raise SettingError("an episode of a task without a time limit needs max_steps")
        whole_number("max_steps of an episode", limit, 1, SettingError)
        if whole_number("seed", seed, 0, SettingError) >= TOO_LARGE_SEED:
            raise SettingError(f"the seed of a network's episode must be below 2^32: got {seed}")
        import torch
        from stable_baselines3.common.utils import set_random_seed

        from curricle.deep.checkpoint import isolated
        from curricle.deep.networks import acting

        drawn = replace(self.task, make=with_pictures(self.task.make))
        with closing(drawn.environment()) as env, isolated(torch.get_num_threads()):
            set_random_seed(seed)
            act = acting(self.model, [env], sampled=not deterministic)
            return played(
                env,
                lambda seen: act(seen, [0])[0][()],  # a number where it is one
                seed=seed,
                limit=limit,
                picture=lambda _: frame_of(env),
            )

    def __repr__(self) -> str:
        return f"TrainedPolicy({type(self.model).__name__}, {self.task.make})"


def policies_of(
    task: Any, learner: Any, values: Any, steps_used: IntArray
) -> tuple[TrainedPolicy, ...]:
    """Return the policies of K :class:`NetworkValues`; SettingError where there are none."""
    if values is None or not all(hasattr(one, "policy") for one in values):
        raise SettingError(
            "a policy to take away needs the values of networks: these "
            f"{'were not saved' if values is None else 'are their parameters alone, see load'}"
        )
    pairs = zip(values, steps_used.tolist(), strict=True)
    return tuple(_policy_of(task, learner, one, steps) for one, steps in pairs)


def _policy_of(
    task: ObservationTask, learner: DeepLearner, values: Any, steps: int
) -> TrainedPolicy:
    """Return the policy of :class:`NetworkValues`, learnt in so many steps."""
    from curricle.deep.checkpoint import isolated
    from curricle.deep.models import model_for
    from curricle.learning.shaping import QInitialisation

    potential = getattr(values.policy, "potential", None)
    shaping = None if potential is None else QInitialisation(potential)
    with isolated(learner.threads):
        model = model_for(task, learner, shaping, steps=max(steps, 1))
    model.env.close()
    model.env = None
    model.policy.load_state_dict(values.policy.state_dict())
    model.policy.set_training_mode(False)
    model.num_timesteps = steps
    return TrainedPolicy(task, model)


def policy_return(potential: Any, target: ObservationTarget, *, seed: int = 0) -> float:
    """Return the mean return of a potential's one source, a network with an actor, in a target.

    Actions are sampled, and rewards summed or discounted, as the target's evaluation has it. NaN
    where there are several sources, a mapping changes what they read, or the source has no actor.
    """
    source = actor_of(potential)
    if source is None:
        return float("nan")
    from curricle.deep.checkpoint import drawing  # needs torch, as what follows
    from curricle.deep.networks import acting

    start = splitmix64(stream_start(seed, "policy_return"))
    horizon = target.evaluation.horizon(target.task)
    environments = Environments(target.task, target.episodes, horizon)
    actor = acting(source.policy, environments.environments, sampled=target.evaluation.sampled)
    with closing(environments), drawing(start):
        episodes = environments.rollouts(actor, start)
    return mean_episode_return(episodes, target.evaluation.discount(target.task))
