"""What a teacher's tasks return and how often they are played, in Stable-Baselines3's logs."""

from typing import Any

from curricle.deep.curriculum_vec_env import CurriculumVecEnv
from curricle.errors import SettingError

try:
    from stable_baselines3.common.callbacks import BaseCallback
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    BaseCallback = object


class CurriculumCallback(BaseCallback):
    """Logs the tasks of a :class:`CurriculumVecEnv`, whatever wrappers are around it.

    Once an episode has ended in a task, ``curriculum/<task>/ep_rew_mean`` is the mean return of its
    last 100 episodes, unshaped and undiscounted, and for each task ``curriculum/<task>/share`` its
    share of all steps so far.

    Raises
    ------
    ImportError
        When Stable-Baselines3 is not installed.
    SettingError
        When training starts, if there is no :class:`CurriculumVecEnv`.

    Examples
    --------
    >>> from stable_baselines3 import A2C
    >>> from curricle import observation_task
    >>> tasks = {f"{g}": observation_task("Pendulum-v1", g=g, time_limit=20) for g in (2, 10)}
    >>> model = A2C("MlpPolicy", CurriculumVecEnv(tasks, target="10"), seed=0)
    >>> _ = model.learn(60, callback=CurriculumCallback(), log_interval=100)
    >>> sorted(name for name in model.logger.name_to_value if name.startswith("curriculum"))[:2]
    ['curriculum/10/ep_rew_mean', 'curriculum/10/share']
    """

    def __init__(self) -> None:
        if BaseCallback is object:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        super().__init__()

    def _on_training_start(self) -> None:
        self._curriculum = curriculum_in(self.training_env)

    def _on_step(self) -> bool:
        if self.locals["dones"].any():  # before off-policy algorithms write their logs
            venv = self._curriculum
            shares = venv.steps_per_task / venv.steps_per_task.sum()
            for name, value, share in zip(venv.tasks, venv.mean_returns, shares, strict=True):
                self.logger.record(f"curriculum/{name}/share", float(share))
                if value == value:
                    self.logger.record(f"curriculum/{name}/ep_rew_mean", float(value))
        return True


def curriculum_in(venv: Any) -> CurriculumVecEnv:
    """Return the CurriculumVecEnv inside of wrappers; SettingError if there is none."""
    inside = venv
    while not isinstance(inside, CurriculumVecEnv):
        if not hasattr(inside, "venv"):
            raise SettingError(
                f"a CurriculumVecEnv must be inside of what is learnt from: got {venv!r}"
            )
        inside = inside.venv
    return inside
