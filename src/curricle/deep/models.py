"""Models of Stable-Baselines3: made for a learner and a shaping, trained for a seed, saved.

Checkpoints are pickles: read checkpoints of your own runs only. Results are not pickles.
"""

import io
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from copy import deepcopy
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, Self

import cloudpickle
import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import A2C, PPO
from stable_baselines3.common import noise as action_noise, vec_env
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor

from curricle.arrays import FloatArray
from curricle.deep.learner import (
    NOISE,
    NOT_ARGUMENTS,
    SAVES,
    DeepLearner,
    PolicyReuse,
    WeightTransfer,
    residual_policy,
)
from curricle.deep.networks import NetworkValues, Standardized, acting
from curricle.deep.vec_env import ShapedVecEnv, set_whole_state, whole_state
from curricle.deep.ways_in import begin_near, carry_over, kickstarted, reusing
from curricle.errors import CurricleError, LostStoreError, SettingError, StoreError, reason
from curricle.files import Place, RemotePath, opened_regular, write_whole
from curricle.interop.tabulated_task import needs_of
from curricle.learning.record import Record, WarmUp
from curricle.learning.result import Outcome
from curricle.learning.shaping import Shaping, StateShaping
from curricle.learning.stopping import StoppingKernel, stops
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import nothing
from curricle.tasks.kernel import splitmix64, stream_start
from curricle.tasks.observation_task import ObservationTask, stack
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
) -> Any:
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
    normalizes = learner.normalizes("norm_obs"), learner.normalizes("norm_reward")
    if any(normalizes):
        kwargs = dict(settings.get("policy_kwargs") or {})
        of_kind = {"features_extractor_class", "features_extractor_kwargs"}
        inner = {name.removeprefix("features_"): kwargs.pop(name) for name in of_kind & {*kwargs}}
        inner["epsilon"] = learner.normal.get("epsilon", 1e-8) if normalizes[0] else None
        kwargs |= {"features_extractor_class": Standardized, "features_extractor_kwargs": inner}
        settings["policy_kwargs"] = kwargs
    policy: Any = learner.policy
    off_policy, kl = "buffer_size" in learner.takes, getattr(shaping, "kl", 0.0)
    if off_policy and steps is not None:
        size = settings.get("buffer_size", 1_000_000)
        settings["buffer_size"] = max(min(size, steps), learner.envs)
    if shaping is not None and shaping.starts_at_potential:
        policy = residual_policy(algorithm, learner.policy)
        kwargs = settings.get("policy_kwargs") or {}
        settings["policy_kwargs"] = {**kwargs, "potential": shaping.potential}
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
    except (AssertionError, TypeError, ValueError) as error:
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
    makers = [lambda: Monitor(task.environment())] * learner.envs
    kind: Any = vec_env.SubprocVecEnv if processes else vec_env.DummyVecEnv
    phi = subtracted(shaping)
    venv = kind(makers) if phi is None else ShapedVecEnv(kind(makers), phi)
    if not learner.normalizes("norm_reward"):
        return venv
    return vec_env.VecNormalize(
        venv, **{**learner.normal, "norm_obs": False, "gamma": task.discount}
    )


def subtracted(shaping: Shaping | None) -> ObservationPotential | None:
    """Return Phi where rewards are shaped by it, so that Q is learnt as Q* - Phi; else None."""
    return shaping.potential if isinstance(shaping, StateShaping) else None


def check_learner(
    learner: DeepLearner, shaping: Shaping | None = None, in_tables: Sequence[str] = ()
) -> None:
    """Raise SettingError unless an algorithm takes its settings, and shaping by tabular sources."""
    algorithm, known = learner.algorithm_class(), learner.takes
    for name in learner.settings:
        if name not in (*known, *NOT_ARGUMENTS):
            meant = get_close_matches(name, known, n=1)
            raise SettingError(
                f"a setting of {learner.algorithm} must be one of {', '.join(known)}: got {name!r}"
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


def generator_states() -> tuple[Any, ...]:
    """Return the states of the generators that Stable-Baselines3 draws from."""
    return random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002


def set_generators(states: tuple[Any, ...]) -> None:
    """Set the generators that Stable-Baselines3 draws from."""
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    torch.set_rng_state(states[2])


@contextmanager
def isolated(threads: int | None = None, seed: int | None = None) -> Iterator[None]:
    """Set torch's threads and seed where given; restore threads and generators afterwards."""
    before, states = torch.get_num_threads(), generator_states()
    torch.set_num_threads(threads or before)
    if seed is not None:
        torch.manual_seed(seed % 2**63)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        set_generators(states)


# -- training one seed -----------------------------------------------------------------------------


@dataclass(frozen=True)
class DeepRun:
    """A run of a deep learner in a task, the same for each seed."""

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
        self, seed: int, shaping: Shaping | None, warm_up: WarmUp, charged: int, saves: Place | None
    ) -> Outcome:
        """Train a seed and return its outcome; resume from the file `saves`, and save to it."""
        start = stream_start(seed, self.stream)
        run = self._named(start, shaping, f"{charged} charged, {warm_up.steps} before learning")
        left, processes = self.steps - charged - warm_up.steps, self.learner.processes
        with isolated(self.learner.threads):
            source = np.empty(0) if saves is None else traits(self.task, shaping)
            saved = None if saves is None else load_checkpoint(saves, run)
            if saved is None:
                progress = Progress.begun(self, warm_up)
                fresh: dict[str, Any] = {"seed": splitmix64(start) >> 33, "steps": left}
                model = model_for(self.task, self.learner, shaping, **fresh, processes=processes)
            else:
                check_source(saves, saved.progress.source, source)
                kind, attributes = saved.model
                model, progress = object.__new__(kind), saved.progress
                model.__dict__.update(attributes)
                set_generators(saved.states)
            values = NetworkValues(model.policy, subtracted(shaping))
            progress.source = source
            place = None if saves is None else (saves, run)
            recorder = Recorder(self, progress, values, self.steps - charged, start, place)
            if model.env is None:  # it could not be pickled: a new episode begins
                venv = environments(self.task, self.learner, shaping, processes=processes)
                venv.seed(splitmix64(start ^ model.num_timesteps) >> 33)
                model.set_env(venv, force_reset=True)
                if saved is not None and saved.returns is not None:
                    model.get_vec_normalize_env().ret_rms = saved.returns
            buffer: Any = getattr(model, "replay_buffer", None)
            if getattr(buffer, "env", model.env) is None:  # hindsight replay's is not pickled
                buffer.set_env(model.env)
            if saved is not None:
                recorder.resumed = Noise.of(model, saved.states)
            try:
                if not progress.over:
                    rollout = rollout_of(model)
                    if rollout > left and hasattr(model, "rollout_buffer"):
                        raise SettingError(
                            f"a budget must hold a rollout of {self.learner.algorithm}, n_steps "
                            f"times envs: {rollout:,} steps are more than {left:,}"
                        )
                    callbacks = [] if self.learner.callbacks is None else self.learner.callbacks()
                    model.learn(
                        left - model.num_timesteps,
                        callback=[recorder, *callbacks],
                        reset_num_timesteps=saved is None,
                        progress_bar=self.learner.progress_bar,
                    )
                    recorder.end()
            finally:
                model.env.close()  # its processes end
                if recorder.environments is not None:
                    recorder.environments.close()
        spent = progress.steps, progress.episodes, progress.evaluation_steps
        return Outcome(progress.record, values, *spent)  # type: ignore[arg-type]

    def _named(self, start: int, shaping: Shaping | None, spent: str) -> str:
        """Return a seed's run as text, whose checkpoints no other run takes."""
        shaped = None if shaping is None else shaping.with_potential(None)
        lengths = f"{self.steps} steps, {self.episodes} episodes, {self.eval_freq} a checkpoint"
        ends = " ".join(f"{bound:.6g}" for bound in self.stopping)
        settings = self.task, self.learner, shaped, lengths, spent, self.evaluation, ends
        return f"{', '.join(map(str, settings))}, {start:x}"


def rollout_of(model: Any) -> int:
    """Return the steps of all sub-environments before each update; 0 if episodes are counted."""
    n_steps, unit = getattr(model, "train_freq", None) or (model.n_steps, None)
    return 0 if getattr(unit, "value", "") == "episode" else int(n_steps * model.n_envs)


@dataclass
class Progress:
    """The records of a run so far."""

    record: Record
    warm_up: int  # steps spent before learning
    steps: int
    episodes: int
    checkpoint: int  # the next to be recorded
    returns: list[float] = field(default_factory=list)  # of episodes since the last checkpoint
    begun_learning: bool = False
    over: bool = False
    evaluation_steps: int = 0
    source: FloatArray = field(default_factory=lambda: np.empty(0))  # its :func:`traits`

    @classmethod
    def begun(cls, run: DeepRun, warm_up: WarmUp) -> "Progress":
        """Return the records at the start, after the warm-up."""
        longest = run.longest + run.learner.envs - 1  # all sub-environments make a last step
        record = Record.empty(longest // run.eval_freq + 1)
        spent = warm_up.write(record, run.eval_freq)
        since = [spent.ended_return / spent.ended] * spent.ended if spent.ended else []
        first = -(-spent.steps // run.eval_freq)
        return cls(record, spent.steps, spent.steps, spent.episodes, first, since)


class Noise(NamedTuple):
    """A saved run's noise, which Stable-Baselines3 resets or draws anew before its next step."""

    states: tuple[Any, ...]  # of the generators
    of_actions: Any
    distribution: Any  # of actions
    of_states: dict[str, Any]  # what the distribution had drawn, with gSDE

    @classmethod
    def of(cls, model: Any, states: tuple[Any, ...]) -> Self:
        """Return the noise of a model as it was saved."""
        actor = getattr(model, "actor", None) or model.policy
        distribution = getattr(actor, "action_dist", SimpleNamespace())
        of_actions = deepcopy(getattr(model, "action_noise", None))
        return cls(states, of_actions, distribution, {**vars(distribution)})


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
        self.environments = None  # in which the policy is evaluated
        if run.evaluation.method != "off":
            episodes, horizon = run.evaluation.rollouts(run.task), run.evaluation.horizon(run.task)
            self.environments = Environments(run.task, episodes, horizon)
        self._saves, self._saved_at = saves, progress.steps
        self.resumed: Noise | None = None  # to be put back

    def _on_training_start(self) -> None:
        progress = self.progress
        self._standardized = [*Standardized.of(self.model.policy)]
        if self.run.steps > self.run.longest:  # the budget is in episodes
            self.model._update_current_progress_remaining = self._count_episodes
        if not progress.begun_learning:
            greedy = self._evaluation(0)
            progress.record.greedy_return[: progress.checkpoint] = greedy
            if progress.checkpoint == 0:
                self._record(greedy)
            progress.begun_learning = True
        elif self.resumed is not None and self.resumed.of_actions is not None:
            self.model.action_noise = self.resumed.of_actions

    def _count_episodes(self, *_: int) -> None:
        """Set the share of the budget that is left, which schedules follow."""
        self.model._current_progress_remaining = 1 - self.progress.episodes / self.run.episodes

    def _on_rollout_start(self) -> None:
        if self.resumed is not None:
            vars(self.resumed.distribution).update(self.resumed.of_states)
            set_generators(self.resumed.states)
            self.resumed = None
        if self.progress.steps - self._saved_at >= max(1, self.run.longest // SAVES):
            self._save()

    def _on_step(self) -> bool:
        progress = self.progress
        progress.steps = progress.warm_up + self.num_timesteps
        for part in self._standardized:
            part.see(self.model.policy, self.locals["new_obs"], self.training_env)
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
        if (played := self.environments) is None:
            return float("nan")
        seed, evaluation = splitmix64(self.start ^ (number + 1)), self.run.evaluation
        actor = acting(self.values.policy, played.environments, sampled=evaluation.sampled)
        with isolated(seed=seed):
            episodes = played.rollouts(actor, seed)
        self.progress.evaluation_steps += sum(len(episode.rewards) for episode in episodes)
        return mean_episode_return(episodes, evaluation.discount(self.run.task))

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

# Attributes of a model that are set again: one holds open files, one this run's progress.
LEFT_OUT = "_logger", "_update_current_progress_remaining"


class Saved(NamedTuple):
    """A checkpoint."""

    run: str  # what is trained: a checkpoint of something else is refused
    model: tuple[type, dict[str, Any]]  # an algorithm's class, and its attributes
    progress: Progress
    states: tuple[Any, ...]  # of the random number generators
    returns: Any = None  # the statistics by which rewards are normalised, if they are


class _Packing(cloudpickle.Pickler):
    """Leaves out zeros that end a large array, and writes small whole numbers as bytes."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, vec_env.VecEnvWrapper):  # with its environments
            made = object.__new__, (type(obj),)
            return *made, whole_state(obj), None, None, set_whole_state
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
    attributes = {name: value for name, value in vars(model).items() if name not in LEFT_OUT}
    returns = getattr(attributes.get("_vec_normalize_env"), "ret_rms", None)

    def pickled(**changed: Any) -> bytes:
        file = io.BytesIO()
        packed = type(model), attributes | changed
        saved = Saved(run, packed, progress, generator_states(), returns)
        _Packing(file).dump(saved)
        return file.getvalue()

    try:
        content = pickled()
    except Exception:  # whatever an environment's own code raises: a new episode begins instead
        content = pickled(env=None, _last_obs=None, _vec_normalize_env=None)
    try:
        if isinstance(path, Path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise LostStoreError(
            f"a checkpoint cannot be written to {path} ({reason(error)}): a run with --resume goes "
            "on from the last one"
        ) from error


def traits(task: ObservationTask, shaping: Shaping | None) -> FloatArray:
    """Return numbers by which a shaping's source is recognised; empty without a source."""
    if shaping is None or (potential := shaping.potential) is None:
        return np.empty(0)
    network = potential.values[0]
    if not shaping.reads_values and isinstance(network, NetworkValues):
        return np.array([np.abs(x).sum(dtype=float) for x in network.parameters().values()])
    with closing(task.environment()) as environment:
        seen = [environment.reset(seed=k)[0] for k in range(8)]
    return np.asarray(potential.v(stack(task.observations, seen)))


def check_source(path: Place | None, saved: FloatArray, source: FloatArray) -> None:
    """Raise StoreError if the traits of a checkpoint's source are not those of a run's source."""
    # Machines differ in the last bits of a network's values.
    if saved.shape != source.shape or not np.allclose(saved, source, rtol=1e-3, equal_nan=True):
        raise StoreError(
            f"a checkpoint belongs to one source: {path} is of another than this run's; name "
            "another folder, or remove the file"
        )


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
        raise StoreError(f"a checkpoint must be written by curricle, here: {path} is not")
    if saved.run != run:
        raise StoreError(
            f"a checkpoint belongs to one run: {path} is of {saved.run}, this is {run}; name "
            "another folder, or remove the file"
        )
    return saved
