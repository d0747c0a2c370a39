"""Models of Stable-Baselines3: made for a learner and a shaping, trained for a seed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Dict
from gymnasium.wrappers import FilterObservation
from stable_baselines3 import A2C, PPO
from stable_baselines3.common import noise as action_noise, vec_env
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import NatureCNN

from curricle.deep.learner import (
    NOISE,
    NOT_ARGUMENTS,
    DeepLearner,
    PolicyReuse,
    WeightTransfer,
    residual_policy,
)
from curricle.deep.networks import NetworkValues, Standardized, acting
from curricle.deep.vec_env import ShapedVecEnv
from curricle.deep.ways_in import begin_near, carry_over, kickstarted, reusing
from curricle.errors import CurricleError, SettingError
from curricle.interop.tabulated_task import needs_of
from curricle.learning.record import Checkpoint, Record, note
from curricle.learning.result import Outcome, ended_by
from curricle.learning.shaping import Shaping, StateShaping
from curricle.learning.stopping import Budget, StoppingKernel, limits
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import nothing
from curricle.tasks.kernel import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask, shared_restored
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.rollouts import Environments, mean_episode_return


def model_for(
    task: ObservationTask,
    learner: DeepLearner,
    shaping: Shaping | None = None,
    *,
    seed: int = 0,
    steps: int | None = None,
    processes: bool = False,
) -> BaseAlgorithm:
    """Return a model with its shaping that is ready to learn; `seed` is below 2^32."""
    if shaping is not None and shaping.potential is None:
        shaping = None  # nothing is added
    check_learner(learner, shaping)
    algorithm, settings = learner.algorithm_class(), dict(learner.settings)
    if "noise_std" in settings:
        noise = getattr(action_noise, NOISE[settings.get("noise_type", "normal")])
        mean = np.zeros(task.actions.shape or ())
        settings["action_noise"] = noise(mean, mean + settings["noise_std"])
    for name in NOT_ARGUMENTS:
        settings.pop(name, None)
    kwargs = dict(settings.get("policy_kwargs") or {})  # a copy, which algorithms may change
    normalizes = learner.normalizes("norm_obs"), learner.normalizes("norm_reward")
    if any(normalizes):
        of_kind = {"features_extractor_class", "features_extractor_kwargs"}
        inner = {name.removeprefix("features_"): kwargs.pop(name) for name in of_kind & {*kwargs}}
        if learner.policy.startswith("Cnn"):
            inner.setdefault("extractor_class", NatureCNN)
        inner["epsilon"] = learner.normal.get("epsilon", 1e-8) if normalizes[0] else None
        kwargs |= {"features_extractor_class": Standardized, "features_extractor_kwargs": inner}
    policy: str | type = learner.policy
    off_policy, kl = "buffer_size" in learner.takes, getattr(shaping, "kl", 0.0)
    if off_policy and steps is not None:
        size = settings.get("buffer_size", 1_000_000)
        settings["buffer_size"] = max(min(size, steps), learner.envs)
    if shaping is not None and shaping.starts_at_potential:
        policy = residual_policy(algorithm, learner.policy)
        kwargs["potential"] = shaping.potential
    if kwargs or "policy_kwargs" in settings:
        settings["policy_kwargs"] = kwargs
    guide = None  # the action values that an off-policy learner acts on at first
    if isinstance(shaping, PolicyReuse) and off_policy and shaping.potential.of_actions:
        guide, algorithm = shaping.potential, reusing(algorithm)
    if kl > 0:
        algorithm, policy = kickstarted(algorithm, policy)
    venv = environments(task, learner, shaping, processes=processes)
    try:
        model = algorithm(policy, venv, gamma=task.discount, seed=seed, **settings)
    except CurricleError:
        raise
    except (AssertionError, TypeError, ValueError, RuntimeError, MemoryError) as error:
        # Its spaces, the name of its policy and some of its settings are only checked there.
        said = " ".join(str(error).split())
        raise SettingError(
            f"{learner.algorithm} must take its task and its settings: with {task} "
            f"Stable-Baselines3 says {said!r}"
        ) from error
    if needs_of(model) == "masks of actions" and not venv.has_attr("action_masks"):
        raise SettingError(
            f"{learner.algorithm} needs environments with a method action_masks, which "
            f"sb3_contrib.common.wrappers.ActionMasker adds as encode=: {task} has none"
        )
    if guide is not None:
        model.guide = guide
    elif isinstance(shaping, PolicyReuse | WeightTransfer):
        carry_over(model, shaping, actor_alone=isinstance(shaping, PolicyReuse))
        if kl > 0:
            begin_near(model, kl)
    return model


def environments(
    task: ObservationTask, learner: DeepLearner, shaping: Shaping | None, *, processes: bool = False
) -> vec_env.VecEnv:
    """Return new sub-environments, with their rewards shaped where the shaping does so."""
    makers = [lambda: _monitored(task)] * learner.envs
    kind: type[vec_env.VecEnv] = vec_env.SubprocVecEnv if processes else vec_env.DummyVecEnv
    phi = subtracted(shaping)
    venv = kind(makers) if phi is None else ShapedVecEnv(kind(makers), phi)
    if not learner.normalizes("norm_reward"):
        return venv
    settings: Any = {**learner.normal, "norm_obs": False, "gamma": task.discount}
    return vec_env.VecNormalize(venv, **settings)


def _monitored(task: ObservationTask) -> Monitor:
    """Return a new environment whose observations have the parts of their space and no others."""
    environment = task.environment()
    if isinstance(space := environment.observation_space, Dict):
        # PPO looks up the space of each part of an observation at which an episode is cut off.
        environment = FilterObservation(environment, [*space])
    return Monitor(environment)


def subtracted(shaping: Shaping | None) -> ObservationPotential | None:
    """Return Phi where rewards are shaped by it, so that Q is learnt as Q* - Phi; else None."""
    return shaping.potential if isinstance(shaping, StateShaping) else None


def check_learner(
    learner: DeepLearner, shaping: Shaping | None = None, in_tables: Sequence[str] = ()
) -> None:
    """Raise SettingError unless an algorithm takes its settings, and shaping by tabular sources."""
    algorithm, takes = learner.algorithm_class(), learner.takes
    for name in learner.settings:
        if name not in (*takes, *NOT_ARGUMENTS):
            meant = get_close_matches(name, takes, n=1)
            raise SettingError(
                f"a setting of {learner.algorithm} must be one of {', '.join(takes)}: got {name!r}"
                + (f", did you mean {meant[0]!r}?" if meant else "")
            )
    if shaping is None:
        return
    if isinstance(shaping, WeightTransfer) and in_tables:
        raise SettingError(
            f"sources of WeightTransfer must be networks: {in_tables[0]} is learnt in a table"
        )
    if shaping.starts_at_potential:
        residual_policy(algorithm, learner.policy)
    carries_values = shaping.starts_at_potential or isinstance(shaping, WeightTransfer)
    if carries_values and learner.normalizes("norm_reward"):
        raise SettingError(
            f"{shaping.name} needs rewards as they are, in which its source's values are: got "
            "normalize; normalize = { norm_reward = false } standardises observations alone"
        )
    if getattr(shaping, "kl", 0.0) > 0 and not issubclass(algorithm, (PPO, A2C)):
        raise SettingError(
            "kl above 0 needs an actor-critic that learns on-policy, PPO or A2C: got "
            f"{learner.algorithm}"
        )


def network_values(
    task: ObservationTask,
    learner: DeepLearner,
    shaping: Shaping | None,
    parameters: Mapping[str, npt.NDArray[Any]],
) -> NetworkValues:
    """Return the values of a trained network, from :meth:`NetworkValues.parameters`."""
    read = shaping if shaping is not None and shaping.reads_values else None
    with isolated(learner.threads):
        model = model_for(task, learner, read, steps=1)
    model.env.close()
    values = NetworkValues(model.policy, subtracted(read))
    values.load(parameters)
    return values


# -- the random numbers and threads of Stable-Baselines3 -------------------------------------------


@contextmanager
def isolated(threads: int | None = None, seed: int | None = None) -> Iterator[None]:
    """Set torch's threads and seed where given; restore threads and generators afterwards."""
    threads_before, torch_before = torch.get_num_threads(), torch.get_rng_state()
    torch.set_num_threads(threads or threads_before)
    if seed is not None:
        torch.manual_seed(seed % 2**63)
    try:
        with shared_restored():
            yield
    finally:
        torch.set_num_threads(threads_before)
        torch.set_rng_state(torch_before)


# -- training one seed -----------------------------------------------------------------------------


@dataclass(frozen=True)
class DeepRun:
    """A run of a deep learner in a task, the same for each seed."""

    task: ObservationTask
    learner: DeepLearner
    budget: Budget
    eval_freq: int
    longest: int
    evaluation: GreedyEvaluation
    stopping: StoppingKernel
    floor_steps: int  # that it took to estimate the floor of the stopping rule
    stream: str
    reached: Callable[[], None] = field(default=nothing, kw_only=True)  # called at each checkpoint

    def train(self, seed: int, shaping: Shaping | None, charged: int) -> Outcome:
        """Train a seed and return its outcome."""
        start, learner = stream_start(seed, self.stream), self.learner
        steps, model_seed = self.limits[0] - charged, splitmix64(start) >> 33
        with isolated(learner.threads):
            made: Any = {"seed": model_seed, "steps": steps, "processes": learner.processes}
            model = model_for(self.task, learner, shaping, **made)
            values = NetworkValues(model.policy, subtracted(shaping))
            recorder = Recorder(self, values, steps, start)
            try:
                rollout = rollout_of(model)
                if rollout > steps and hasattr(model, "rollout_buffer"):
                    raise SettingError(
                        f"a budget must hold a rollout of {learner.algorithm}, n_steps times envs: "
                        f"{rollout:,} steps are more than {steps:,}"
                    )
                callbacks = [recorder, *(learner.callbacks() if learner.callbacks else ())]
                model.learn(steps, callback=callbacks, progress_bar=learner.progress_bar)
                recorder.reach()
            finally:
                model.env.close()  # its processes end
                if recorder.environments is not None:
                    recorder.environments.close()
        last, record = recorder.checkpoint - 1, recorder.record
        ending = ended_by(self.budget, self.stopping, record, last, self.eval_freq)
        totals = recorder.steps, recorder.episodes, recorder.evaluation_steps
        # a network's values are a ValueSource
        bounds = self.stopping.level, self.stopping.floor
        return Outcome(record, values, *totals, ending, *bounds, self.floor_steps)  # type: ignore[arg-type]

    @cached_property
    def limits(self) -> tuple[int, int]:
        """The most steps and episodes."""
        return limits(self.budget)


def rollout_of(model: BaseAlgorithm) -> int:
    """Return the steps of all sub-environments before each update; 0 if episodes are counted."""
    n_steps, unit = getattr(model, "train_freq", None) or (model.n_steps, None)
    return 0 if getattr(unit, "value", "") == "episode" else int(n_steps * model.n_envs)


class Recorder(BaseCallback):
    """Records a run's curves, and ends it when its budget is spent."""

    def __init__(self, run: DeepRun, values: NetworkValues, max_steps: int, start: int):
        super().__init__()
        self.run, self.values, self.max_steps, self.start = run, values, max_steps, start
        longest = run.longest + run.learner.envs - 1  # all sub-environments make a last step
        self.record = Record.empty(longest // run.eval_freq + 1)
        self.steps, self.episodes, self.evaluation_steps = 0, 0, 0
        self.checkpoint = 0  # the next to be recorded
        self.returns: list[float] = []  # of episodes since the last checkpoint
        self.environments = None  # in which the policy is evaluated
        if run.evaluation.method != "off":
            episodes, horizon = run.evaluation.rollouts(run.task), run.evaluation.horizon(run.task)
            self.environments = Environments(run.task, episodes, horizon)

    def _on_training_start(self) -> None:
        self._standardized = [*Standardized.of(self.model.policy)]
        if self.run.limits[0] > self.run.longest:  # the budget is in episodes
            self.model._update_current_progress_remaining = self._count_episodes
        self.reach()

    def _count_episodes(self, *_: int) -> None:
        """Set the share of the budget that is left, which schedules follow."""
        self.model._current_progress_remaining = 1 - self.episodes / self.run.limits[1]

    def _on_step(self) -> bool:
        self.steps = self.num_timesteps
        for part in self._standardized:
            part.see(self.model.policy, self.locals["new_obs"], self.training_env)
        for info in self.locals["infos"]:
            if "episode" in info:  # as Monitor reports the end of one
                self.episodes += 1
                self.returns.append(float(info["episode"]["r"]))
        if self.episodes >= self.run.limits[1]:
            return False
        if self.steps >= self.max_steps:
            # A whole rollout is still learnt from; `reach` evaluates what was learnt.
            rollout = rollout_of(self.model)
            return rollout > 0 and self.num_timesteps % rollout == 0
        return not self.reach()

    def reach(self) -> bool:
        """Record the checkpoints reached; return whether the stopping rule ends the run there."""
        last = min(self.steps // self.run.eval_freq, len(self.record.greedy_return) - 1)
        while self.checkpoint <= last:
            if self._record():
                return True
        return False

    def _evaluation(self) -> float:
        """Return the policy's mean return at the checkpoint; NaN if evaluation is off."""
        if (played := self.environments) is None:
            return float("nan")
        seed, evaluation = splitmix64(self.start ^ (self.checkpoint + 1)), self.run.evaluation
        actor = acting(self.values.policy, played.environments, sampled=evaluation.sampled)
        with isolated(seed=seed):
            episodes = played.rollouts(actor, seed)
        self.evaluation_steps += sum(len(episode.rewards) for episode in episodes)
        return mean_episode_return(episodes, evaluation.discount(self.run.task))

    def _record(self) -> bool:
        """Record the checkpoint and return whether the stopping rule ends the run there."""
        step, greedy = self.checkpoint * self.run.eval_freq, self._evaluation()
        ended = len(self.returns), float(np.sum(self.returns))
        reached = Checkpoint(self.checkpoint, step, self.episodes, *ended, greedy, np.nan, np.nan)
        self.returns.clear()
        self.checkpoint += 1
        self.run.reached()
        noted = self.record, self.run.stopping, reached, None, None  # without snapshots
        return bool(note(*noted))  # type: ignore[no-untyped-call]
