"""The policy of a learnt table, to take away: acting, a file of its own, episodes to look at."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatTable, Frozen, adopted
from curricle.checks import brief, numbers, whole_number
from curricle.errors import SettingError
from curricle.files import read_saved, write_saved
from curricle.learning.saved_result import (
    all_values_of,
    arrays_of_values,
    as_saved,
    check_value_arrays,
    pairs_of,
    task_record,
)
from curricle.learning.storage import SparseValues
from curricle.planning.episode import Episode, played
from curricle.planning.greedy import Values, VisitedValues
from curricle.planning.rollouts import greedy_rollout
from curricle.tasks.live import LiveMDP, is_live, numbering
from curricle.tasks.task import Task, generative_model
from curricle.text import brief_value


@dataclass(frozen=True, eq=False)
class TabularPolicy(Frozen):
    """What a learnt table says to do: ``result.policy`` of a tabular learner's result.

    In each state it takes an action of the highest value. Where several are as high,
    :meth:`predict` takes the first of them; :meth:`episode` draws among them, as evaluations do. In
    a state that sparse learning never visited, all are.

    Parameters
    ----------
    task : Task or None
        What it acts in; without it, it reads numbers of states alone, and plays no episodes.
    values : (S, A) float array or SparseValues

    Raises
    ------
    SettingError
        When the values are not of the states and actions of the task.

    Examples
    --------
    >>> import curricle as cr
    >>> maze = cr.GridWorld(["..T", "S#."])
    >>> policy = cr.learn(maze, budget=5000).policy
    >>> environment = cr.to_gymnasium(maze)
    >>> observation, _ = environment.reset(seed=0)
    >>> maze.actions.label(policy.predict(observation))
    'move=north'
    >>> policy.episode(seed=0)
    Episode(3 steps, return 197, terminated)
    """

    task: Task | None
    values: Any

    def __post_init__(self) -> None:
        values = self.values
        if not isinstance(values, SparseValues):
            floats = isinstance(values, np.ndarray) and values.dtype in (np.float32, np.float64)
            values = values if floats else numbers("values of a policy", values, SettingError)
            object.__setattr__(self, "values", adopted(values, values.dtype))
        if self.task is None:
            return
        rules, sparse = generative_model(self.task), isinstance(values, SparseValues)
        pairs = rules.states.size, rules.actions.size
        try:
            check_value_arrays(arrays_of_values(self._of_one_seed), 1, pairs)
        except ValueError:
            raise SettingError(
                f"a policy needs {'sparse ' * sparse}values of {pairs[0]:,} states x {pairs[1]:,} "
                f"actions: got {brief(self.values)}"
            ) from None

    def predict(self, observation: Any) -> Any:
        """Return the action in a state, the first of those that are as good.

        Parameters
        ----------
        observation : int or sequence of int
            As an environment of the task gives it (:func:`to_gymnasium`): the state's number, or
            for each component of the state the offset from its lowest value. In a live task the
            environment's own observation, whose action is returned.
        """
        if self.task is not None and is_live(self.task):
            live: Any = self.task
            return live.act(int(np.argmax(self._row(numbering(live)(observation)))))
        return int(np.argmax(self._row(self._state(observation))))

    def _state(self, observation: Any) -> int:
        if np.ndim(observation) == 0:
            return whole_number("a state", observation, 0, SettingError)
        if self.task is None:
            raise SettingError(
                f"a policy without its task reads numbers of states alone: got {observation!r}"
            )
        space = generative_model(self.task).states
        lows = [part.low for part in space.components]
        offsets = np.asarray(observation)
        if offsets.shape != (len(lows),) or offsets.dtype.kind not in "iu":
            raise SettingError(
                f"a state must be a number, or one for each of {', '.join(space.names)}: got "
                f"{observation!r}"
            )
        state = space.encode_one(tuple((offsets + lows).tolist()))
        if state < 0:
            raise SettingError(f"a state must be one of {space}: got {observation!r}")
        return state

    def _row(self, state: int) -> FloatTable:
        """Return the values of a state's actions, (A,)."""
        values = self.values
        if isinstance(values, SparseValues):
            visited = np.isin(state, values.states)
            return values.at(state) if visited else np.zeros(values.values.shape[1])
        if state >= len(values):
            raise SettingError(f"a state must be below {len(values):,}: got {state:,}")
        row: FloatTable = values[state]
        return row

    def episode(self, *, seed: int = 0, max_steps: int | None = None) -> Episode:
        """Return one episode of the policy, drawn at each step.

        Mazes, pursuits and tasks that say where their states lie are seen from above, others as the
        values of their components. A live task shows its environment's own pictures, where it has
        some.

        Parameters
        ----------
        seed : int
            Of where it starts, of what is random in the task, and of the choice among actions that
            are as good.
        max_steps : int, optional
            Steps after which it is cut off; by default the task's time limit.

        Raises
        ------
        SettingError
            When there is no limit, or the policy has no task.
        """
        task = self.task
        if task is None:
            raise SettingError(
                "an episode needs the task that the policy acts in: load(path, task) takes it"
            )
        limit = generative_model(task).time_limit if max_steps is None else max_steps
        if limit is None:
            raise SettingError("an episode of a task without a time limit needs max_steps")
        limit = whole_number("max_steps of an episode", limit, 1, SettingError)
        seed = whole_number("seed", seed, 0, SettingError)
        if isinstance(task, LiveMDP):
            return self._live_episode(task, seed, limit)
        view: Any = Values(self.values)
        if isinstance(self.values, SparseValues):
            view = VisitedValues(self.values.states, self.values.values)
        return Episode.of(task, greedy_rollout(task, view, seed=seed, steps=limit))

    def _live_episode(self, task: LiveMDP, seed: int, limit: int) -> Episode:
        from curricle.tasks.scene import draws_pictures, frame_of, scene_of, with_pictures

        number, scene, rng = numbering(task), scene_of(task), np.random.default_rng(seed)

        def act(seen: Any) -> Any:
            row = self._row(number(seen))
            return task.act(int(rng.choice(np.flatnonzero(row == row.max()))))

        def picture(seen: Any) -> npt.NDArray[np.uint8]:
            return frame_of(env) if pictures else scene.image(number(seen))

        env = task.make()
        if pictures := draws_pictures(env):
            env.close()
            env = with_pictures(task.make)()
        with closing(env):
            return played(
                env,
                act,
                seed=seed,
                limit=limit,
                picture=picture,
                text=lambda seen: scene.text(number(seen)),
            )

    def save(self, path: str | Path) -> Path:
        """Write the values into a file, without pickles, and return its path, an ``.npz``.

        StoreError when it cannot be written.
        """
        arrays = arrays_of_values(self._of_one_seed)
        return write_saved(path, type(self).__name__, arrays, {"task": task_record(self.task)})

    @property
    def _of_one_seed(self) -> Any:
        return (self.values,) if isinstance(self.values, SparseValues) else self.values[None]

    @classmethod
    def load(cls, path: str | Path, task: Task | None = None) -> Self:
        """Return the policy in a file that :meth:`save` wrote.

        Parameters
        ----------
        path : path
        task : Task, optional
            The one that it acts in; the file holds none.

        Raises
        ------
        StoreError
            When the file cannot be read, is damaged, or holds something else.
        SettingError
            When the task has other states or actions.
        """
        saved = read_saved(path, cls.__name__)
        with as_saved(saved):
            check_value_arrays(saved.arrays, 1, pairs_of(saved, saved.about.get("task"), task))
            values = all_values_of(saved.arrays, 1)[0]
        return cls(task, values)

    def __repr__(self) -> str:
        return f"TabularPolicy({'no task' if self.task is None else brief_value(self.task)})"
