"""Training one seed of a deep learner in several tasks, of which a teacher draws each episode's."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from curricle.deep.curriculum_callback import CurriculumCallback, curriculum_in
from curricle.deep.curriculum_vec_env import CurriculumVecEnv, Success, TeachingRecord
from curricle.deep.models import subtracted
from curricle.deep.networks import NetworkValues
from curricle.deep.training import DeepRun, Progress
from curricle.deep.vec_env import ShapedVecEnv
from curricle.learning.shaping import Shaping
from curricle.tasks.observation_task import ObservationTask
from curricle.teaching.teachers import Teacher


@dataclass(frozen=True)
class TaughtDeepRun(DeepRun):
    """A :class:`DeepRun` in several tasks; ``task`` is the target.

    `records` get what the teacher drew and saw, by the number of the seed.
    """

    tasks: Mapping[str, ObservationTask]
    teacher: Teacher
    target: str
    success: Success
    records: dict[int, TeachingRecord]

    @property
    def described(self) -> str:
        """The tasks and the teacher, the same in every process."""
        kind = type(self.teacher)
        shown = kind.__qualname__ if kind.__repr__ is object.__repr__ else repr(self.teacher)
        return f"{dict(self.tasks)} for {self.target!r} by {shown}"

    def model(self, shaping: Shaping | None, seed: int, steps: int, progress: Progress) -> Any:
        """Return a new model, in the environments of all tasks."""
        model = super().model(shaping, seed, steps, progress)
        model.env.close()
        venv = self.environments(shaping, progress)
        venv.seed(seed)
        model.set_env(venv)
        return model

    def environments(self, shaping: Shaping | None, progress: Progress) -> VecEnv:
        """Return new sub-environments, to go on from the teacher's record."""
        venv = CurriculumVecEnv(
            self.tasks,
            self.teacher,
            target=self.target,
            envs=self.learner.envs,
            success=self.success,
        )
        if progress.taught is None:
            progress.taught = TeachingRecord.begun(self.teacher, len(self.tasks), self.eval_freq)
        venv.record = progress.taught
        phi = subtracted(shaping)
        return venv if phi is None else ShapedVecEnv(venv, phi)

    def begins(self, seed: int, model: Any, values: NetworkValues) -> None:
        """Give the teacher the network's values, and keep its record."""
        venv = curriculum_in(model.env)
        venv.values, self.records[seed] = values, venv.record

    def callbacks(self) -> list[BaseCallback]:
        """Return those of the learner and the log of tasks."""
        return [CurriculumCallback(), *super().callbacks()]
