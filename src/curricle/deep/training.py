"""Training one seed of a deep learner: its curves, when it ends, how it is resumed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from curricle.deep import checkpoint
from curricle.deep.learner import SAVES, DeepLearner
from curricle.deep.models import environments, model_for, subtracted
from curricle.deep.networks import NetworkValues, acting
from curricle.errors import SettingError
from curricle.files import Place
from curricle.learning.record import Record, WarmUp
from curricle.learning.run import Outcome
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import StoppingKernel, stops
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import nothing
from curricle.tasks.draws import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.rollouts import Environments, mean_episode_return


@dataclass(frozen=True)
class DeepRun:
    """How each seed is trained."""

    task: ObservationTask
    learner: DeepLearner
    steps: int
    episodes: int
    eval_freq: int
    longest: int
    evaluation: GreedyEvaluation
    stopping: StoppingKernel
    stream: str
    reached: Callable[[], None] = field(default=nothing, kw_only=True)  # called at each checkpoint

    def train(
        self,
        seed: int,
        shaping: Shaping | None,
        warm_up: WarmUp,
        charged: int,
        saves: Place | None,
    ) -> Outcome:
        """Return what one seed learns, resuming from and saving to the file `saves`."""
        start = stream_start(seed, self.stream)
        shaped = None if shaping is None else shaping.name
        run = f"{self.task}, {self.learner}, {shaped}, {self.steps} steps, {start:x}"
        left = self.steps - charged - warm_up.steps
        with checkpoint.isolated(self.learner.threads):
            saved = None if saves is None else checkpoint.load(saves, run)
            if saved is None:
                small = splitmix64(start) >> 33
                progress = Progress.begun(self, warm_up)
                model = model_for(self.task, self.learner, shaping, seed=small, steps=left)
            else:
                model, progress = checkpoint.restored(saved), saved.progress
            values = NetworkValues(model.policy, subtracted(shaping))
            place = None if saves is None else (saves, run)
            recorder = Recorder(self, progress, values, self.steps - charged, start, place)
            if model.env is None:  # it could not be pickled: a new episode begins
                venv = environments(self.task, self.learner, shaping)
                venv.seed(splitmix64(start ^ model.num_timesteps) >> 33)
                model.set_env(venv, force_reset=True)
            if not progress.over:
                self._learn(model, recorder, left, fresh=saved is None)
            recorder.close()
        return Outcome(
            progress.record,
            values,  # type: ignore[arg-type]
            progress.steps,
            progress.episodes,
            out_of_memory=False,
            evaluation_steps=progress.evaluation_steps,
        )

    def _learn(self, model: Any, recorder: "Recorder", left: int, *, fresh: bool) -> None:
        rollout = rollout_of(model)
        if rollout > left and hasattr(model, "rollout_buffer"):
            raise SettingError(
                f"a budget must hold a rollout of {self.learner.algorithm}, n_steps times envs: "
                f"{rollout:,} steps are more than {left:,}"
            )
        others = [] if self.learner.callbacks is None else self.learner.callbacks()
        model.learn(
            left - model.num_timesteps,
            callback=[recorder, *others],
            reset_num_timesteps=fresh,
            progress_bar=self.learner.progress_bar,
        )
        recorder.end()


def rollout_of(model: Any) -> int:
    """Return the steps of all sub-environments before each update; 0 if episodes are counted."""
    n_steps, unit = getattr(model, "train_freq", None) or (model.n_steps, None)
    return 0 if getattr(unit, "value", "") == "episode" else int(n_steps * model.n_envs)


@dataclass
class Progress:
    """What a run has recorded so far."""

    record: Record
    warm_up: int
    """Steps spent before learning."""
    steps: int
    episodes: int
    checkpoint: int
    """The next to be recorded."""
    returns: list[float] = field(default_factory=list)
    """Of the episodes ended since the last checkpoint."""
    begun_learning: bool = False
    over: bool = False
    evaluation_steps: int = 0

    @classmethod
    def begun(cls, run: DeepRun, warm_up: WarmUp) -> "Progress":
        """Return what is recorded at the start."""
        longest = run.longest + run.learner.envs - 1  # all sub-environments make a last step
        record = Record.empty(longest // run.eval_freq + 1)
        spent = warm_up.write(record, run.eval_freq)
        since = [spent.ended_return / spent.ended] * spent.ended if spent.ended else []
        first = -(-spent.steps // run.eval_freq)
        return cls(record, spent.steps, spent.steps, spent.episodes, first, since)


class Recorder(BaseCallback):
    """Records a run's curves, ends it when its budget is spent, and saves it on the way."""

    def __init__(
        self,
        run: DeepRun,
        progress: Progress,
        values: NetworkValues,
        max_steps: int,
        start: int,
        saves: tuple[Place, str] | None,  # the checkpoint's file, and the run it is of
    ):
        super().__init__()
        self.run, self.progress, self.values = run, progress, values
        self.max_steps, self.start = max_steps, start
        task, evaluation = run.task, run.evaluation
        self._environments = None
        if evaluation.method != "off":
            episodes, horizon = evaluation.rollouts(task), evaluation.horizon(task)
            self._environments = Environments(task, episodes, horizon)
        self._saves, self._saved_at = saves, progress.steps

    def _on_training_start(self) -> None:
        progress = self.progress
        if not progress.begun_learning:
            greedy = self._evaluation(0)
            progress.record.greedy_return[: progress.checkpoint] = greedy
            if progress.checkpoint == 0:
                self._record(greedy)
            progress.begun_learning = True

    def _on_rollout_start(self) -> None:
        if self.progress.steps - self._saved_at >= max(1, self.run.longest // SAVES):
            self._save()

    def _on_step(self) -> bool:
        progress = self.progress
        progress.steps = progress.warm_up + self.num_timesteps
        self._count(self.locals["infos"])
        if progress.episodes >= self.run.episodes:
            return False
        if progress.steps >= self.max_steps:
            # A whole rollout is still learnt from; `end` evaluates what was learnt.
            rollout = rollout_of(self.model)
            return rollout > 0 and self.num_timesteps % rollout == 0
        return not self._reach()

    def _reach(self) -> bool:
        """Record the checkpoints reached; return whether the stopping rule ends the run there."""
        progress = self.progress
        last = min(progress.steps // self.run.eval_freq, len(progress.record.greedy_return) - 1)
        while progress.checkpoint <= last:
            if self._record(self._evaluation(progress.checkpoint)):
                return True
        return False

    def _count(self, infos: Sequence[dict[str, Any]]) -> None:
        for info in infos:
            ended = info.get("episode")
            if ended is not None:
                self.progress.episodes += 1
                self.progress.returns.append(float(ended["r"]))

    def _evaluation(self, number: int) -> float:
        """Return the policy's mean return at a checkpoint; NaN if evaluation is off."""
        if self._environments is None:
            return float("nan")
        seed, sampled = splitmix64(self.start ^ (number + 1)), self.run.evaluation.sampled
        actor = acting(self.values.policy, self._environments.environments, sampled=sampled)
        with checkpoint.drawing(seed):
            episodes = self._environments.rollouts(actor, seed)
        self.progress.evaluation_steps += sum(len(episode.rewards) for episode in episodes)
        return mean_episode_return(episodes, self.run.evaluation.discount(self.run.task))

    def _record(self, greedy: float) -> bool:
        """Record a checkpoint and return whether the stopping rule ends the run there."""
        progress, record = self.progress, self.progress.record
        here = progress.checkpoint
        record.greedy_return[here] = greedy
        record.episodes[here] = progress.episodes
        if progress.returns:
            record.training_return[here] = np.mean(progress.returns)
            progress.returns.clear()
        progress.checkpoint += 1
        self.run.reached()
        return bool(stops(self.run.stopping, record.greedy_return, here, here * self.run.eval_freq))

    def end(self) -> None:
        """Record the last checkpoint, and mark the run as over."""
        self._reach()
        self.progress.over = True
        self._save()

    def close(self) -> None:
        """Close the environments in which the policy was evaluated."""
        if self._environments is not None:
            self._environments.close()

    def _save(self) -> None:
        if self._saves is not None:
            checkpoint.save(*self._saves, self.model, self.progress)
        self._saved_at = self.progress.steps
