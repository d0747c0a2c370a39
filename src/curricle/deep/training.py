"""Training one seed of a deep learner: its curves, when it ends, its checkpoints (pickles)."""

import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cloudpickle
import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from curricle.deep.learner import SAVES, DeepLearner
from curricle.deep.models import (
    drawing,
    environments,
    generator_states,
    isolated,
    model_for,
    set_generators,
    subtracted,
)
from curricle.deep.networks import NetworkValues, acting
from curricle.errors import LostStoreError, SettingError, StoreError, reason
from curricle.files import Place, RemotePath, opened_regular, write_whole
from curricle.learning.record import Record, WarmUp
from curricle.learning.run import Outcome
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import StoppingKernel, stops
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import nothing
from curricle.tasks.kernel import splitmix64, stream_start
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
        with isolated(self.learner.threads):
            saved = None if saves is None else load_checkpoint(saves, run)
            if saved is None:
                small = splitmix64(start) >> 33
                progress = Progress.begun(self, warm_up)
                model = model_for(self.task, self.learner, shaping, seed=small, steps=left)
            else:
                kind, held = saved.model
                model, progress = object.__new__(kind), saved.progress
                model.__dict__.update(held)
                set_generators(saved.states)
            values = NetworkValues(model.policy, subtracted(shaping))
            place = None if saves is None else (saves, run)
            recorder = Recorder(self, progress, values, self.steps - charged, start, place)
            if model.env is None:  # it could not be pickled: a new episode begins
                venv = environments(self.task, self.learner, shaping)
                venv.seed(splitmix64(start ^ model.num_timesteps) >> 33)
                model.set_env(venv, force_reset=True)
            if not progress.over:
                rollout = rollout_of(model)
                if rollout > left and hasattr(model, "rollout_buffer"):
                    raise SettingError(
                        f"a budget must hold a rollout of {self.learner.algorithm}, n_steps times "
                        f"envs: {rollout:,} steps are more than {left:,}"
                    )
                others = [] if self.learner.callbacks is None else self.learner.callbacks()
                model.learn(
                    left - model.num_timesteps,
                    callback=[recorder, *others],
                    reset_num_timesteps=saved is None,
                    progress_bar=self.learner.progress_bar,
                )
                recorder.end()
            if recorder.environments is not None:
                recorder.environments.close()
        return Outcome(
            progress.record,
            values,  # type: ignore[arg-type]
            progress.steps,
            progress.episodes,
            out_of_memory=False,
            evaluation_steps=progress.evaluation_steps,
        )


def rollout_of(model: Any) -> int:
    """Return the steps of all sub-environments before each update; 0 if episodes are counted."""
    n_steps, unit = getattr(model, "train_freq", None) or (model.n_steps, None)
    return 0 if getattr(unit, "value", "") == "episode" else int(n_steps * model.n_envs)


@dataclass
class Progress:
    """What a run has recorded so far."""

    record: Record
    warm_up: int  # steps spent before learning
    steps: int
    episodes: int
    checkpoint: int  # the next to be recorded
    returns: list[float] = field(default_factory=list)  # of episodes since the last checkpoint
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
        self.environments = None  # in which the policy is evaluated
        if evaluation.method != "off":
            episodes, horizon = evaluation.rollouts(task), evaluation.horizon(task)
            self.environments = Environments(task, episodes, horizon)
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
        for info in self.locals["infos"]:
            if "episode" in info:  # as Monitor reports the end of one
                progress.episodes += 1
                progress.returns.append(float(info["episode"]["r"]))
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

    def _evaluation(self, number: int) -> float:
        """Return the policy's mean return at a checkpoint; NaN if evaluation is off."""
        if self.environments is None:
            return float("nan")
        seed, sampled = splitmix64(self.start ^ (number + 1)), self.run.evaluation.sampled
        actor = acting(self.values.policy, self.environments.environments, sampled=sampled)
        with drawing(seed):
            episodes = self.environments.rollouts(actor, seed)
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

    def _save(self) -> None:
        if self._saves is not None:
            save_checkpoint(*self._saves, self.model, self.progress)
        self._saved_at = self.progress.steps


# -- checkpoints: all that a run needs to resume with the same result ------------------------------

LEFT_OUT = ("_logger",)  # attributes of a model that hold open files, and are created again


class Saved(NamedTuple):
    """A checkpoint."""

    run: str  # what is trained: a checkpoint of something else is refused
    model: tuple[type, dict[str, Any]]  # an algorithm's class, and its attributes
    progress: Progress
    states: tuple[Any, ...]  # of the random number generators


class _Packing(cloudpickle.Pickler):
    """Leaves out the zeros that end a large array, and writes small whole numbers as bytes."""

    def reducer_override(self, obj: Any) -> Any:
        if not isinstance(obj, np.ndarray) or obj.nbytes < 2**20 or obj.dtype.kind not in "biuf":
            return super().reducer_override(obj)
        rows = np.ascontiguousarray(obj).reshape(len(obj), -1)
        filled = np.flatnonzero(rows.view(np.uint8).any(axis=1))
        used = rows[: filled[-1] + 1 if filled.size else 0]
        with np.errstate(invalid="ignore"):  # what is no byte is compared below
            small = used.astype(np.uint8)
        if np.array_equal(small, used) and not (used.dtype.kind == "f" and np.signbit(used).any()):
            used = small
        return _unpacked, (obj.shape, obj.dtype, used.dtype, used.tobytes())


def _unpacked(shape: tuple[int, ...], dtype: Any, packed: Any, content: bytes) -> Any:
    array, used = np.zeros(shape, dtype), np.frombuffer(content, packed)
    array.reshape(-1)[: used.size] = used
    return array


def save_checkpoint(path: Place, run: str, model: Any, progress: Progress) -> None:
    """Write a checkpoint, whole or not at all."""
    held = {name: value for name, value in vars(model).items() if name not in LEFT_OUT}

    def pickled(**changed: Any) -> bytes:
        file = io.BytesIO()
        saved = Saved(run, (type(model), held | changed), progress, generator_states())
        _Packing(file).dump(saved)
        return file.getvalue()

    try:
        content = pickled()
    except Exception:  # whatever an environment's own code raises: a new episode begins instead
        content = pickled(env=None, _last_obs=None)
    try:
        if isinstance(path, Path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise LostStoreError(
            f"a checkpoint cannot be written to {path} ({reason(error)}): a run with --resume goes "
            "on from the last one"
        ) from error


def load_checkpoint(path: Place, run: str) -> Saved | None:
    """Return a checkpoint, None if there is none; StoreError when damaged or of another run."""
    try:
        with opened_regular(path) as (file, _):
            content = file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise LostStoreError(f"a checkpoint cannot be read: {path} ({reason(error)})") from error
    saved: Any = None
    with suppress(Exception):  # whatever unpickling damaged bytes raises
        saved = cloudpickle.loads(content)
    if not isinstance(saved, Saved):
        if isinstance(path, RemotePath):  # there nothing moves it into place when it is whole
            return None
        raise StoreError(f"a checkpoint must be one that curricle wrote, here: {path} is not")
    if saved.run != run:
        raise StoreError(
            f"a checkpoint belongs to one run: {path} is of {saved.run}, this is {run}"
        )
    return saved
