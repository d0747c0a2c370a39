"""A vector environment of Stable-Baselines3 in which a teacher draws the task of each episode."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import brief, number, whole_number
from curricle.errors import SettingError
from curricle.frozen_arrays import frozen
from curricle.tasks.draws import stream_start
from curricle.tasks.families.family import FamilyMember
from curricle.tasks.observation_task import ObservationTask, stack
from curricle.teaching.teachers import Episode, TaskSampler, Teacher, Uniform, check_teacher
from curricle.teaching.teaching import check_names
from curricle.transfer.observation_mapping import ValueSource

try:
    from stable_baselines3.common.env_util import is_wrapped
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    VecEnv = object

Success = float | Callable[[Mapping[str, Any]], bool] | None
Indices = int | Iterable[int] | None
WINDOW = 100
"""Episodes that a task's mean return is taken over, as Stable-Baselines3 does for all."""


@dataclass
class TeachingRecord:
    """What a :class:`CurriculumVecEnv` has drawn and seen, whatever becomes of its environments."""

    sampler: TaskSampler
    steps_per_task: IntArray
    """Steps taken in each of the M tasks, (M,)."""
    returns: tuple[deque[float], ...]
    """The undiscounted returns of the last episodes in each."""

    @classmethod
    def begun(cls, teacher: Teacher, n_tasks: int, eval_freq: int | None = None) -> Self:
        """Return the record before the first episode."""
        returns = tuple(deque[float](maxlen=WINDOW) for _ in range(n_tasks))
        return cls(
            TaskSampler(teacher, n_tasks, 0, eval_freq), np.zeros(n_tasks, np.int64), returns
        )


class CurriculumVecEnv(VecEnv):
    """Sub-environments, each of whose episodes is played in the task that a teacher draws.

    One model learns in all of them. Any algorithm of Stable-Baselines3 takes it, and
    :class:`ShapedVecEnv` and other wrappers go around it. Episodes end and the next ones begin as
    in ``DummyVecEnv``; with a teacher that always draws the target it is one, bit for bit.

    Each info has the name of its task as ``"task"``, and at the end of an episode what `Monitor`
    records (``"episode"``); the first info of an episode is in ``reset_infos``.
    :class:`CurriculumCallback` logs returns and shares of tasks. Rewards that are shaped outside
    do not reach the teacher. Evaluate in an environment of the target, ``tasks[target]``, alone.

    ``seed`` seeds the environments and the draws of the teacher at the next ``reset``; what the
    teacher has seen stays. An environment is made when its task is first drawn for the
    sub-environment, that of the target at once. Attributes and methods are those of the environment
    whose episode is going on, before the first one those of the target.

    Parameters
    ----------
    tasks : dict from str to ObservationTask or FamilyMember
        Two or more, M of them, with the same spaces and discount. :class:`ReverseCurriculum` reads
        their order as that from the goal outwards, which nothing checks: give tasks whose episodes
        start ever further from the goal, or ever harder members of a family.
    teacher : Teacher
        Default :class:`Uniform`; any but those that need tables. A
        :class:`PrioritizedLevelReplay` goes by returns unless there are `values`.
    target : str
        The name of the task to be learnt; the teacher may draw it too.
    envs : int
        Sub-environments, n.
    success : float or callable, optional
        When an episode is a success: when its undiscounted return is at least this number, or when
        a function of its last info says so. By default ``info["is_success"]``.

    Attributes
    ----------
    tasks : dict from str to ObservationTask
    teacher : Teacher
    target : str
    values : ValueSource or None
        By which `Episode.td_errors` are computed at the end of an episode, for teachers that read
        them: ``venv.values = NetworkValues(model.policy)``. None at first.
    record : TeachingRecord
        What was drawn and seen so far.

    Raises
    ------
    SettingError
        When an argument is invalid; when an environment does not tell successes that the teacher
        needs.
    ImportError
        When Stable-Baselines3 is not installed.

    Examples
    --------
    >>> from curricle import observation_task
    >>> tasks = {f"{g}": observation_task("Pendulum-v1", g=g, time_limit=20) for g in (2, 10)}
    >>> venv = CurriculumVecEnv(tasks, target="10", envs=3)
    >>> _ = venv.seed(0), venv.reset()
    >>> for _ in range(40):
    ...     seen, rewards, ended, infos = venv.step(np.zeros((3, 1)))
    >>> [info["task"] for info in infos], venv.steps_per_task, venv.counts
    (['10', '10', '2'], array([40, 80]), array([2, 7]))
    """

    def __init__(
        self,
        tasks: Mapping[str, ObservationTask | FamilyMember],
        teacher: Teacher | None = None,
        *,
        target: str,
        envs: int = 1,
        success: Success = None,
    ):
        if VecEnv is object:
            raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')
        self.teacher = Uniform() if teacher is None else teacher
        self.tasks = taught_tasks(tasks, self.teacher, target, success)
        self.target = target
        self.values: ValueSource | None = None
        self._names, self._success = tuple(self.tasks), success
        n = whole_number("envs", envs, 1, SettingError)
        self.record = TeachingRecord.begun(self.teacher, len(self._names))
        self._made: list[dict[int, Any]] = [{} for _ in range(n)]
        self._drawn = [self._names.index(target)] * n
        self._first_seeds: list[int] | None = None
        self._unseeded: list[set[int]] = [set() for _ in range(n)]
        self._observations: list[Any] = [None] * n
        self._rewards: list[list[float]] = [[] for _ in range(n)]
        self._seen: list[list[Any]] = [[] for _ in range(n)]
        task = self.tasks[target]
        super().__init__(n, task.observations, task.actions)

    @property
    def steps_per_task(self) -> IntArray:
        """Steps taken in each task by all sub-environments, (M,) int64."""
        return self.record.steps_per_task.copy()

    @property
    def counts(self) -> IntArray:
        """Episodes begun in each task, (M,) int64."""
        found: IntArray = np.bincount(self.record.sampler.tasks, minlength=len(self._names))
        return found

    @property
    def probabilities(self) -> FloatArray:
        """The probability of each task at the last draw, (M,) float64."""
        return self.record.sampler.probabilities

    @property
    def mean_returns(self) -> FloatArray:
        """Mean undiscounted return of the last 100 episodes in each task, (M,); NaN before."""
        each = self.record.returns
        return np.array([np.mean(one) if one else np.nan for one in each])

    def reset(self) -> Any:
        """Begin an episode in each sub-environment; those going on are dropped, unseen."""
        if self._seeds[0] is not None or self._first_seeds is None:
            if self._seeds[0] is None:
                self.seed()
            self._first_seeds = [*self._seeds]
            self._unseeded = [set(range(len(self._names))) for _ in self._made]
            self.record.sampler.counter = stream_start(self._first_seeds[0], "teacher")
        for i in range(self.num_envs):
            options = {"options": self._options[i]} if self._options[i] else {}
            self._begin(i, **options)
        self._reset_seeds()
        self._reset_options()
        return stack(self.observation_space, self._observations)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take the actions, one for each sub-environment."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], BoolArray, list[dict[str, Any]]]:
        """Act; return observations, rewards (n,), whether episodes are over (n,) and infos.

        The teacher sees all episodes that ended in this step before it draws the next ones.
        """
        n = self.num_envs
        rewards, dones = np.zeros(n, np.float32), np.zeros(n, np.bool_)
        infos = list[dict[str, Any]]()
        for i, action in enumerate(self._actions):
            seen, reward, terminated, truncated, info = self._environment(i).step(action)
            rewards[i], dones[i] = reward, terminated or truncated
            info = {
                **info,
                "TimeLimit.truncated": truncated and not terminated,
                "task": self._names[self._drawn[i]],
            }
            self.record.steps_per_task[self._drawn[i]] += 1
            self._note(i, seen, float(reward))
            if dones[i]:
                info["terminal_observation"] = seen
            infos.append(deepcopy(info))
            if dones[i]:
                self._end(i, terminated=bool(terminated), info=infos[i])
        for i in np.flatnonzero(dones).tolist():
            self._begin(i)
        return stack(self.observation_space, self._observations), rewards, dones, infos

    def close(self) -> None:
        """Close all environments that were made."""
        for made in self._made:
            for environment in made.values():
                environment.close()
            made.clear()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """Return a picture of each sub-environment."""
        return [self._environment(i).render() for i in range(self.num_envs)]

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the environments whose episodes are going on."""
        return [each.get_wrapper_attr(attr_name) for each in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environments whose episodes are going on."""
        for each in self._chosen(indices):
            setattr(each, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environments whose episodes are going on."""
        chosen = self._chosen(indices)
        return [
            each.get_wrapper_attr(method_name)(*method_args, **method_kwargs) for each in chosen
        ]

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Return whether the environments whose episodes are going on have a wrapper."""
        return [is_wrapped(each, wrapper_class) for each in self._chosen(indices)]

    # -- episodes ------------------------------------------------------------------------------

    def _begin(self, i: int, **options: Any) -> None:
        """Draw the next task of a sub-environment and begin an episode in it."""
        task = self.record.sampler.draw(int(self.record.steps_per_task.sum()))
        self._drawn[i] = task
        if task in self._unseeded[i]:
            self._unseeded[i].remove(task)
            options["seed"] = self._seed_of(i, self._names[task])
        seen, info = self._environment(i).reset(**options)
        self._observations[i] = seen
        self.reset_infos[i] = {**info, "task": self._names[task]}
        self._rewards[i] = []
        self._seen[i] = [deepcopy(seen)] if self._reads_values else []

    def _seed_of(self, i: int, task: str) -> int:
        """Return the seed of an environment; the target has that of ``DummyVecEnv``."""
        assert self._first_seeds is not None
        first = self._first_seeds[i]
        return first if task == self.target else stream_start(first, f"task {task}") >> 33

    def _note(self, i: int, seen: Any, reward: float) -> None:
        """Keep what the teacher reads of a step."""
        self._observations[i] = seen
        self._rewards[i].append(reward)
        if self._reads_values:
            self._seen[i].append(deepcopy(seen))

    def _end(self, i: int, *, terminated: bool, info: Mapping[str, Any]) -> None:
        """Let the teacher see the episode that has ended."""
        task, rewards = self._drawn[i], np.array(self._rewards[i])
        self.record.returns[task].append(float(rewards.sum()))
        episode = Episode(
            task,
            frozen(rewards),
            self._td_errors(i, rewards, terminated=terminated),
            self._succeeded(info, float(rewards.sum())),
            self.tasks[self.target].discount,
        )
        self.record.sampler.ended(episode)

    def _td_errors(self, i: int, rewards: FloatArray, *, terminated: bool) -> FloatArray | None:
        """Return r + gamma V(s') - V(s), 0 for V(s') where the episode terminated; or None."""
        seen = self._seen[i]
        if self.values is None or len(seen) != len(rewards) + 1:  # given since the episode began
            return None
        values = np.asarray(self.values.v(stack(self.observation_space, seen)), np.float64)
        ahead = values[1:].copy()
        if terminated:
            ahead[-1] = 0.0
        return frozen(rewards + self.tasks[self.target].discount * ahead - values[:-1])

    def _succeeded(self, info: Mapping[str, Any], total: float) -> bool:
        if callable(self._success):
            return bool(self._success(info))
        if self._success is not None:
            return total >= self._success
        if "is_success" not in info and getattr(self.teacher, "uses_goal", False):
            raise SettingError(
                f"{self.teacher!r} needs successes, by info['is_success'] at the end of an episode "
                f"or by success=: {info['task']!r} ended one without"
            )
        return bool(info.get("is_success", False))

    # -- environments ----------------------------------------------------------------------------

    @property
    def _reads_values(self) -> bool:
        return self.values is not None and bool(getattr(self.teacher, "uses_td_errors", False))

    def _environment(self, i: int) -> Any:
        """Return the environment in which a sub-environment's episode is going on."""
        task, made = self._drawn[i], self._made[i]
        if task not in made:
            environment = self.tasks[self._names[task]].environment()
            kept = is_wrapped(environment, Monitor)
            made[task] = environment if kept else Monitor(environment)
        return made[task]

    def _chosen(self, indices: Indices) -> list[Any]:
        return [self._environment(i) for i in self._get_indices(indices)]


def taught_tasks(tasks: Any, teacher: Any, target: Any, success: Any) -> dict[str, ObservationTask]:
    """Return the tasks by name, or raise SettingError unless a teacher can draw them."""
    check_names(tasks, target)
    if len(tasks) < 2:
        raise SettingError(f"a teacher draws from two tasks or more: got {target!r} alone")
    check_teacher(teacher)
    if getattr(teacher, "uses_tables", False):
        raise SettingError(
            "a teacher of tasks seen through observations must do without exact values, which need "
            f"tables: got {teacher!r}"
        )
    if success is not None and not callable(success):
        number("success", success, SettingError)
    found = {
        name: task.task if isinstance(task, FamilyMember) else task for name, task in tasks.items()
    }
    for name, task in found.items():
        if not isinstance(task, ObservationTask):
            raise SettingError(
                f"tasks of a vector environment must be seen through observations: {name!r} is "
                f"{task!r}"
            )
    for name, task in found.items():
        for what in ("observations", "actions", "discount"):
            own, wanted = getattr(task, what), getattr(found[target], what)
            if own != wanted:
                raise SettingError(
                    f"tasks of a teacher must share their {what}: {name!r} has {brief(own)} and "
                    f"{target!r} has {brief(wanted)}"
                )
    return found
