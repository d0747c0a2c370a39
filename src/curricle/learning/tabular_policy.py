"""The policy of a learnt table, to take away: acting, a file of its own, episodes to look at."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatTable, Frozen, adopted, frozen, refrozen
from curricle.checks import brief, numbers, whole_number
from curricle.errors import CurricleError, SettingError, StoreError
from curricle.files import SavedFile, read_saved, write_saved
from curricle.learning.storage import SparseValues
from curricle.pictures.episode import Episode, Film
from curricle.planning.greedy import Values, VisitedValues
from curricle.planning.rollouts import greedy_rollout
from curricle.tasks.live import is_live, numbering
from curricle.tasks.mdp import Task, available_actions, closed, generative_model
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_value


@dataclass(frozen=True, eq=False)
class TabularPolicy(Frozen):
    """The greedy policy of a learnt table: ``result.policy`` of a tabular learner.

    In each state it takes an action of the highest value. Of several such actions :meth:`predict`
    takes the first, and :meth:`episode` draws among them, as evaluations do. In a state that sparse
    learning never visited, all actions tie.

    Parameters
    ----------
    task : Task or None
        Without a task the policy takes only numbers of states, and plays no episodes.
    values : (S, A) float array or SparseValues
        SettingError unless they have the task's states and actions.

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
        if isinstance(values, SparseValues):
            arrays = refrozen(values.states), refrozen(values.values)
            object.__setattr__(self, "values", SparseValues(*arrays))
        else:
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

    def predict(self, observation: object) -> Any:
        """Return the action in a state, the first of the best; SettingError if it is no state.

        Parameters
        ----------
        observation : int or sequence of int
            As an environment of the task gives it (:func:`to_gymnasium`): the state's number, or
            for each component of the state the offset from its lowest value. In a live task an
            observation of its environment.
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
                f"a policy without its task takes only numbers of states: got {observation!r}"
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
            if np.isin(state, values.states):
                return values.at(state)
            unknown: FloatTable = np.zeros((1, values.values.shape[1]))
            if self.task is not None:
                _check_exists(state, generative_model(self.task).states.size)
                unknown = closed(unknown, available_actions(self.task, np.array([state])))
            return np.asarray(unknown[0])
        _check_exists(state, len(values))
        row: FloatTable = values[state]
        return row

    def episode(self, *, seed: int = 0, max_steps: int | None = None) -> Episode:
        """Return one episode of the policy, drawn at each step.

        Mazes, pursuits and tasks that say where their states lie are seen from above, others as the
        values of their components, a live task by its environment's own pictures, if any.

        Parameters
        ----------
        seed : int
            Of the start, of the task's randomness, and of the choice among equal actions.
        max_steps : int, optional
            Steps after which the episode is cut off; by default the task's time limit.

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
        view: Any = Values(self.values)
        if isinstance(self.values, SparseValues):
            view = VisitedValues(self.values.states, self.values.values)
        played, film = Film.of(task)
        return Episode.of(task, greedy_rollout(played, view, seed=seed, steps=limit), film)

    def save(self, path: str | Path) -> Path:
        """Write the values into an ``.npz`` file, and return its path; StoreError if it cannot."""
        arrays = arrays_of_values(self._of_one_seed)
        return write_saved(path, type(self).__name__, arrays, {"task": task_record(self.task)})

    @property
    def _of_one_seed(self) -> Any:
        return (self.values,) if isinstance(self.values, SparseValues) else self.values[None]

    @classmethod
    def load(cls, path: str | Path, task: Task | None = None) -> Self:
        """Return the policy in a file that :meth:`save` wrote, acting in a task.

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


def _check_exists(state: int, n_states: int) -> None:
    if state >= n_states:
        raise SettingError(f"a state must be below {n_states:,}: got {state:,}")


# -- values, and what a file says of their task ----------------------------------------------------

Arrays = Mapping[str, npt.NDArray[Any]]
FLOATS = "float64", "float32"  # of values that were learnt


def task_record(task: Any) -> dict[str, Any]:
    """Return a record by which a task fits values: its spaces as text, and their sizes."""
    if task is None:
        return {}
    if is_observation_task(task):
        return {"spaces": f"observations {task.observations}, actions {task.actions}"}
    rules = generative_model(task)
    spaces = f"states {rules.states}, actions {rules.actions}"
    return {"spaces": spaces, "pairs": [rules.states.size, rules.actions.size]}


def pairs_of(saved: SavedFile, record: object, task: object) -> tuple[int, int] | None:
    """Return the numbers of states and actions of saved values, by the task if it is known."""
    present, recorded = task_record(task), record if isinstance(record, Mapping) else {}
    if present and recorded and present["spaces"] != recorded.get("spaces"):
        raise SettingError(
            f"a result must be loaded with its own task: {saved.path} has "
            f"{recorded.get('spaces')}, the task has {present['spaces']}"
        )
    pairs = (present or recorded).get("pairs")
    return None if pairs is None else (int(pairs[0]), int(pairs[1]))


@contextmanager
def as_saved(saved: SavedFile) -> Iterator[None]:
    """Turn any error of reading a file's arrays and text into a StoreError in one line."""
    try:
        yield
    except CurricleError:
        raise
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
        why = " ".join(f"{kind}{error}".split())
        raise StoreError(f"{saved.path} is not as save() writes it: {why}") from None


def arrays_of_values(values: Any) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of K seeds' values: a dense table, sparse tables, networks, or None."""
    if values is None:
        return {}
    if isinstance(values, np.ndarray):
        return {"values": values}
    arrays = dict[str, npt.NDArray[Any]]()
    for k, table in enumerate(values):
        if isinstance(table, SparseValues):
            arrays |= {f"states_{k}": table.states, f"values_{k}": table.values}
        else:
            named = table if isinstance(table, Mapping) else table.parameters()
            arrays |= {f"values_{k}/{name}": array for name, array in named.items()}
    return arrays


def all_values_of(arrays: Arrays, n_seeds: int) -> Any:
    """Return the values that :func:`arrays_of_values` took; networks are dicts of parameters."""
    if "values" in arrays:
        return frozen(arrays["values"])
    if "states_0" in arrays:
        return tuple(
            SparseValues(frozen(arrays[f"states_{k}"]), frozen(arrays[f"values_{k}"]))
            for k in range(n_seeds)
        )
    networks = tuple(values_of(arrays, k) for k in range(n_seeds))
    return None if networks[0] is None else networks


def values_of(arrays: Arrays, k: int) -> Any:
    """Return the k-th seed's table, or its network's parameters; None where neither is there."""
    if "values" in arrays:
        return arrays["values"][k]
    prefix = f"values_{k}/"
    return {
        name.removeprefix(prefix): v for name, v in arrays.items() if name.startswith(prefix)
    } or None


def check_value_arrays(arrays: Arrays, n_seeds: int, pairs: tuple[int, int] | None) -> None:
    """Raise ValueError unless arrays have the values of so many seeds."""
    # `pairs` are the states and actions of their task, None where that is not known; compiled loops
    # read tables without looking whether a state lies in them.
    size = "one value for each state and action"
    if pairs is not None:
        size = f"{pairs[0]:,} states x {pairs[1]:,} actions"
    table = arrays.get("values")
    if table is not None:
        fits = pairs is None or table.shape[-2:] == pairs
        if table.dtype not in FLOATS or table.ndim != 3 or len(table) != n_seeds or not fits:
            raise ValueError(f"values must be a table for each seed ({n_seeds}), {size}")
    for k in range(n_seeds if "states_0" in arrays else 0):
        states, values = (arrays.get(f"{name}_{k}") for name in ("states", "values"))
        if states is None or values is None or states.ndim != 1 or values.ndim != 2:
            raise ValueError(f"states_{k} and values_{k} must be a sparse table")
        ascend = states.dtype == "int64" and (np.diff(states, prepend=-1) > 0).all()
        within = pairs is None or (not len(states) or states[-1] < pairs[0])
        wide = len(values) == len(states) and (pairs is None or values.shape[1] == pairs[1])
        if not (ascend and within and wide and values.dtype in FLOATS):
            raise ValueError(f"states_{k} and values_{k} must be a sparse table, {size}")
