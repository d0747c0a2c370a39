"""The result of learning: curves, values and totals of K seeds, joined, saved and shown."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, FloatTable, Frozen, IntArray, frozen
from curricle.errors import CurricleError, SettingError
from curricle.files import SavedFile, read_saved, write_saved
from curricle.learning.learners import LEARNERS_BY_NAME, Learner
from curricle.learning.record import Record, Snapshots
from curricle.learning.schedules import Schedule
from curricle.learning.stopping import (
    ALL_EPISODES,
    ALL_STEPS,
    MEMORY_FULL,
    UNLEARNT,
    Budget,
    Episodes,
    StoppingKernel,
    StoppingRule,
)
from curricle.learning.storage import SparseValues
from curricle.learning.tabular_policy import (
    Arrays,
    TabularPolicy,
    all_values_of,
    arrays_of_values,
    as_saved,
    check_value_arrays,
    pairs_of,
    task_record,
)
from curricle.pictures.episode import Episode
from curricle.planning.target import possible_returns
from curricle.statistics.intervals import extremes
from curricle.tasks.mdp import Task, generative_model
from curricle.text import counted

if TYPE_CHECKING:
    import pandas


class ResultField(NamedTuple):
    """An array of a result, as it is joined, checked, saved and shown."""

    axes: str  # K a seed, T a checkpoint
    dtype: str
    unit: str = ""  # of its column in a table
    held: bool = False  # whether a curve keeps its last value after a seed's end; else it is NaN


@dataclass(frozen=True, eq=False)
class LearningResult(Frozen):
    """The result of :func:`learn`, for K seeds and T checkpoints.

    Attributes
    ----------
    task : Task
    learner : Learner
    seeds : tuple of int
        The K seeds.
    values : (K, S, A) float64 or float32
        The learnt values in the task's own rewards: Q, plus the phi or Phi(s) that shaping took off
        it; 0 in terminal states that the task knows or that were reached. Sparse tables give K
        :class:`SparseValues`; None if the :class:`Storage` saves no values.
    steps : (T,) int64
        Steps taken at each checkpoint, from 0.
    training_return : (K, T) float64
        Mean undiscounted, unshaped return of the episodes that ended since the last checkpoint;
        NaN where none did.
    source_share : (K, T) float64
        1 where the source's own policy is what is evaluated of a :class:`Portfolio`, 0 where the
        sober learner is; NaN without a portfolio.
    agreement : (K, T) float64
        1 less by how much the optimistic value of the present episode's start exceeds the learnt
        one, as a share of the range of values; NaN but for :class:`OptimisticQLearning`.
    greedy_return : (K, T) float64
        Expected return of the greedy policy (:class:`GreedyEvaluation`). Checkpoints after a seed's
        end repeat its last value.
    episodes : (K, T) int64
        Episodes ended by each checkpoint.
    steps_used, episodes_used : (K,) int64
        Totals of each seed.
    evaluation_steps : (K,) int64
        Steps of rollouts of the greedy policy, charged to no budget; 0 where evaluation is exact.
    floor_steps : (K,) int64
        Steps of the random policy's rollouts by which the floor of a :class:`StoppingRule` was
        estimated, once for all seeds that were trained together; 0 where it follows from tables.
    ended_by : (K,) str
        What ended each run: all steps used, all episodes done, memory full, or the conditions of a
        stopping rule that were met; "all steps used, not learnt" where the return stayed below the
        floor.
    level, floor : (K,) float64
        The return that the stopping rule asks for, NaN without one, and the return above which it
        may have settled, -inf without one.
    out_of_memory : (K,) bool
        Whether a run ended early, at the step for which a sparse table had no row left.
    own_rewards : (K,) bool
        Whether the values are in the task's own rewards. Values of :class:`RewardBonus` and a
        changing :class:`StateShaping` are not: no transfer takes them.
    snapshots : Snapshots or None
        Values of the first seed during learning, if :func:`learn` was asked for `snapshots`.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> learn(GridWorld("S.T"), budget=500, seeds=3).steps_used
    array([500, 500, 500])
    """

    task: Task
    learner: Learner
    seeds: tuple[int, ...]
    values: Any
    steps: Annotated[IntArray, ResultField("T", "int64", "steps in the task")]
    training_return: Annotated[
        FloatArray, ResultField("KT", "float64", "mean undiscounted return of an episode")
    ]
    greedy_return: Annotated[
        FloatArray, ResultField("KT", "float64", "return of the greedy policy", held=True)
    ]
    episodes: Annotated[IntArray, ResultField("KT", "int64", "episodes ended", held=True)]
    steps_used: Annotated[IntArray, ResultField("K", "int64")]
    episodes_used: Annotated[IntArray, ResultField("K", "int64")]
    evaluation_steps: Annotated[IntArray, ResultField("K", "int64")]
    floor_steps: Annotated[IntArray, ResultField("K", "int64")]
    ended_by: Annotated[npt.NDArray[np.str_], ResultField("K", "U64")]
    level: Annotated[FloatArray, ResultField("K", "float64")]
    floor: Annotated[FloatArray, ResultField("K", "float64")]
    out_of_memory: Annotated[BoolArray, ResultField("K", "bool")]
    source_share: Annotated[FloatArray, ResultField("KT", "float64", "0 or 1", held=True)]
    agreement: Annotated[
        FloatArray, ResultField("KT", "float64", "share of the range of values", held=True)
    ]
    own_rewards: Annotated[BoolArray, ResultField("K", "bool")]
    snapshots: Snapshots | None = None

    # -- policies, tables and files -------------------------------------------------------------

    @cached_property
    def policies(self) -> tuple[Any, ...]:
        """The :class:`TabularPolicy` of each seed, K; SettingError where values were not saved.

        It acts on `values`. In sparse tables greedy returns also follow the potential of states
        never visited.
        """
        if self.values is None:
            raise SettingError(
                "a policy needs the values that were learnt: these were not saved, see "
                "Storage(save_values=True)"
            )
        return tuple(TabularPolicy(self.task, table) for table in self.values)

    @property
    def policy(self) -> Any:
        """The policy of the seed with the best last greedy return; without any, of the first seed.

        That return overestimates the policy, as the seed was chosen by it.
        """
        last = self.greedy_return[:, -1]
        return self.policies[0 if np.isnan(last).all() else int(np.nanargmax(last))]

    def watch(self, *, seed: int = 0, max_steps: int | None = None) -> Episode:
        """Return an episode of :attr:`policy`, as :meth:`TabularPolicy.episode` does.

        Examples
        --------
        >>> from curricle import GridWorld, learn
        >>> learn(GridWorld("S.T"), budget=2000).watch()
        Episode(2 steps, return 198, terminated)
        """
        episode: Episode = self.policy.episode(seed=seed, max_steps=max_steps)
        return episode

    def frame(self) -> "pandas.DataFrame":
        """Return the curves as a pandas DataFrame, a row for each seed and checkpoint.

        Its columns are seed, checkpoint, steps, training_return, greedy_return, source_share,
        agreement and episodes, each seed up to its own end; ``frame().attrs["units"]`` has their
        units. ImportError where pandas is not installed.

        Examples
        --------
        >>> from curricle import GridWorld, learn
        >>> frame = learn(GridWorld("S.T"), budget=1000, seeds=2).frame()
        >>> len(frame), frame.attrs["units"]["greedy_return"]
        (202, 'return of the greedy policy')
        """
        return data_frame(curve_columns(arrays_of(self)))

    def save(self, path: str | Path) -> Path:
        """Write the result into an ``.npz`` file, and return its path; StoreError if it cannot.

        Equal results give equal bytes. The file does not hold the task: pass it to :meth:`load`.
        """
        return write_saved(path, type(self).__name__, *self.parts_of_file())

    def parts_of_file(self) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
        """Return the arrays and the plain JSON that :meth:`save` writes."""
        about: dict[str, Any] = {"task": task_record(self.task), "learner": None}
        if self.learner is not None:
            about["learner"] = learner_record(self.learner)
        if self.snapshots is not None:
            about["snapshot_seed"] = self.snapshots.seed
        return arrays_of(self), about

    @classmethod
    def load(cls, path: str | Path, task: Any = None) -> Self:
        """Return the result in a file that :meth:`save` wrote, bit for bit.

        Without the learnt `task` the policy plays no episodes, and no transfer takes the result.

        Raises
        ------
        StoreError
            When the file cannot be read, is damaged, or holds something else.
        SettingError
            When the task has other states or actions.

        Examples
        --------
        >>> from tempfile import mkdtemp
        >>> from curricle import GridWorld, learn
        >>> maze = GridWorld("S.T")
        >>> result = learn(maze, budget=2000, seeds=2)
        >>> again = LearningResult.load(result.save(f"{mkdtemp()}/maze"), maze)
        >>> np.array_equal(again.values, result.values), again.learner == result.learner
        (True, True)
        """
        saved = read_saved(path, cls.__name__)
        return cls.of_file(saved, saved.arrays, saved.about, task)

    @classmethod
    def of_file(cls, saved: SavedFile, arrays: Arrays, about: Any, task: Any) -> Self:
        """Return the result whose arrays and plain JSON are a file's content or a part of it."""
        with as_saved(saved):
            pairs = pairs_of(saved, about.get("task"), task)
            if not (seeds := arrays["seeds"].tolist() if "seeds" in arrays else []):
                raise ValueError("it has no seeds")
            shown: Any = pairs or (0, 0)
            if pairs is None and "snapshot_values" in arrays:
                shown = arrays["snapshot_values"].shape[1:]
            check_result_arrays(arrays, seeds, shown)
            check_value_arrays(arrays, len(seeds), pairs)
            result = cls.of_arrays(arrays, task, learner_of(about.get("learner")))
            if result.snapshots is None:
                return result
            seed = int(about["snapshot_seed"])
            return replace(result, snapshots=replace(result.snapshots, seed=seed))

    @classmethod
    def of_arrays(cls, arrays: Arrays, task: Any = None, learner: Any = None) -> Self:
        """Return the result with these arrays, as files hold them; values as they are there."""
        seeds, snapshots = tuple(arrays["seeds"].tolist()), None
        if "snapshot_steps" in arrays:
            steps, tables = (frozen(arrays[f"snapshot_{name}"]) for name in ("steps", "values"))
            snapshots = Snapshots(seeds[0], steps, tables)
        values = all_values_of(arrays, len(seeds))
        curves: dict[str, Any] = {name: frozen(arrays[name]) for name in FIELDS}
        return cls(task, learner, seeds, values, **curves, snapshots=snapshots)

    def __repr__(self) -> str:
        learner = "" if self.learner is None else f"{type(self.learner).__name__}, "
        last = int(self.steps[-1])
        at = f" at step {last:,}" if last < self.steps_used.max() else ""
        final = self.greedy_return[:, -1].mean()
        evaluated = "" if np.isnan(final) else f", final greedy return {final:.4g}{at}"
        return (
            f"{type(self).__name__}({learner}{counted(len(self.seeds), 'seed')}, "
            f"{counted(int(self.steps_used.mean()), 'step')} and "
            f"{counted(int(self.episodes_used.mean()), 'episode')} a seed{evaluated})"
        )


FIELDS: dict[str, ResultField] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(LearningResult, include_extras=True).items()
    if get_origin(hint) is Annotated
}
"""The arrays of a :class:`LearningResult`, in the order in which files hold them."""
CURVES = tuple(
    sorted(
        (name for name, field in FIELDS.items() if field.axes == "KT"),
        key=lambda name: FIELDS[name].dtype == "int64",
    )
)
"""In the order of a table's columns: counts come last."""
TOTALS = tuple(name for name, field in FIELDS.items() if field.axes == "K")


# -- made of the seeds' records, or of the results of groups of seeds ------------------------------


@dataclass(frozen=True)
class Outcome:
    """The result of one seed: its record, its values if saved, its totals as in LearningResult."""

    record: Record
    values: FloatTable | SparseValues | None
    steps_used: int
    episodes_used: int
    evaluation_steps: int
    ended_by: str
    level: float = math.nan  # the return that the stopping rule asks for
    floor: float = -math.inf  # the return above which it may have settled
    floor_steps: int = 0
    own_rewards: bool = True

    @property
    def out_of_memory(self) -> bool:
        """Whether a sparse table had no row left."""
        return self.ended_by == MEMORY_FULL


def ended_by(
    budget: Budget, kernel: StoppingKernel, record: Record, checkpoint: int, eval_freq: int
) -> str:
    """Return what ended a run after its last checkpoint, in a few fixed words."""
    if isinstance(budget, Episodes):
        return ALL_EPISODES
    if not isinstance(budget, StoppingRule):
        return ALL_STEPS
    curves = record.greedy_return, record.agreement
    last = budget.decision(kernel, *curves, checkpoint, checkpoint * eval_freq)
    if record.stopped[0]:
        return last.criterion
    return UNLEARNT if last.unlearnt else ALL_STEPS


def learning_result(
    task: Task,
    learner: Learner,
    seeds: tuple[int, ...],
    values: Any,
    outcomes: Sequence[Outcome],
    eval_freq: int,
) -> LearningResult:
    """Put the seeds' records on one axis of checkpoints."""
    n = max(outcome.steps_used for outcome in outcomes) // eval_freq + 1
    arrays = {
        name: np.array([getattr(outcome, name) for outcome in outcomes], FIELDS[name].dtype)
        for name in TOTALS
    }
    for name in CURVES:
        curve = np.stack([getattr(outcome.record, name)[:n] for outcome in outcomes])
        for k, end in enumerate(arrays["steps_used"] // eval_freq if FIELDS[name].held else ()):
            curve[k, end + 1 :] = curve[k, end]
        arrays[name] = curve
    first, snapshots = outcomes[0], None
    if len(first.record.snapshot_at):
        taken = first.record.snapshot_at * eval_freq <= first.steps_used
        steps, tables = first.record.snapshot_at[taken] * eval_freq, first.record.snapshots[taken]
        last = None if values is None else values[0]
        if isinstance(last, np.ndarray) and steps[-1] < first.steps_used:  # the last values too
            steps = np.append(steps, first.steps_used)
            tables = np.concatenate([tables, last[None].astype(np.float32)])
        snapshots = Snapshots(seeds[0], frozen(steps), frozen(tables))
    values = frozen(values) if isinstance(values, np.ndarray) else values
    curves: dict[str, Any] = {name: frozen(array) for name, array in arrays.items()}
    axis = frozen(np.arange(n) * eval_freq)
    return LearningResult(task, learner, seeds, values, axis, **curves, snapshots=snapshots)


def joined_results(parts: Sequence[LearningResult]) -> LearningResult:
    """Return the results of several groups of seeds as one, seeds ascending."""
    longest = max(parts, key=lambda part: len(part.steps))
    place = {seed: k for k, seed in enumerate(chain.from_iterable(part.seeds for part in parts))}
    seeds = sorted(place)
    order = np.array([place[seed] for seed in seeds])

    def joined(name: str) -> Any:
        """Return an array of all seeds; curves of seeds that have ended are held, or else NaN."""
        arrays, n = [getattr(part, name) for part in parts], len(longest.steps)
        if name in CURVES:
            after: Any = {"mode": "edge"} if FIELDS[name].held else {"constant_values": np.nan}
            pad: Any = partial(np.pad, **after)
            arrays = [pad(curve, ((0, 0), (0, n - curve.shape[1]))) for curve in arrays]
        return frozen(np.concatenate(arrays)[order])

    values: Any = [part.values for part in parts]
    if any(value is None for value in values):
        values = None
    elif all(isinstance(value, np.ndarray) for value in values):
        values = joined("values")
    else:
        flat = list(chain.from_iterable(values))
        values = tuple(flat[k] for k in order)
    snapshots = [part.snapshots for part in parts if part.snapshots is not None]
    return replace(
        longest,
        seeds=tuple(seeds),
        values=values,
        snapshots=min(snapshots, key=lambda snapshots: snapshots.seed, default=None),
        **{name: joined(name) for name in (*CURVES, *TOTALS)},
    )


# -- as arrays and plain JSON ----------------------------------------------------------------------

MOST_STEPS = 2**53  # steps that a number of double precision counts


def learner_record(learner: Any) -> dict[str, Any]:
    """Return a learner as JSON holds it: its class, and the settings of Curricle's own."""
    kind = type(learner)
    if LEARNERS_BY_NAME.get(kind.__name__) is not kind:
        return {"type": kind.__name__}
    settings = {name: getattr(learner, name) for name in kind.__match_args__}
    return {
        "type": kind.__name__,
        "settings": {
            name: {"schedule": list(value)} if isinstance(value, Schedule) else value
            for name, value in settings.items()
        },
    }


def learner_of(record: Any) -> Learner | None:
    """Return the learner of a record; None where it is none of Curricle's. ValueError if wrong."""
    if not isinstance(record, Mapping) or "settings" not in record:
        return None
    kind = LEARNERS_BY_NAME.get(record.get("type", ""))
    if kind is None or not isinstance(record["settings"], Mapping):
        raise ValueError(f"a learner must be one of {', '.join(LEARNERS_BY_NAME)}: got {record}")
    try:
        settings = dict[str, Any]()
        for name, value in record["settings"].items():
            if isinstance(value, Mapping):
                shape, *numbers = value.get("schedule", ())
                value = Schedule(int(shape), *map(float, numbers))
            settings[name] = tuple(value) if isinstance(value, list) else value
        return kind(**settings)
    except (TypeError, CurricleError) as error:
        raise ValueError(f"a learner must have valid settings: {error}") from None


def arrays_of(result: LearningResult) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a :class:`LearningResult` by name, its values included."""
    arrays = {name: getattr(result, name) for name in FIELDS}
    arrays["seeds"] = np.array(result.seeds, dtype=np.int64)
    arrays |= arrays_of_values(result.values)
    if result.snapshots is not None:
        arrays["snapshot_steps"] = result.snapshots.steps
        arrays["snapshot_values"] = result.snapshots.values
    return arrays


def check_result_arrays(
    arrays: Arrays,
    seeds: Sequence[int],
    pairs: tuple[int, int],
    counts: Sequence[str] = ("steps_used",),
) -> None:
    """Raise ValueError unless a result can have these arrays."""
    if "steps" not in arrays:
        raise ValueError("it has no steps")
    n, of_seeds = arrays["steps"].size, (len(seeds),)
    shapes: dict[str, tuple[int, ...]] = {"T": (n,), "K": of_seeds, "KT": (*of_seeds, n)}
    expected = {name: (shapes[field.axes], field.dtype) for name, field in FIELDS.items()}
    expected |= dict.fromkeys(("seeds", *counts), (of_seeds, "int64"))
    if "initial_values" in arrays:
        expected["initial_values"] = of_seeds, "float64"
    if "snapshot_steps" in arrays:
        moments = arrays["snapshot_steps"].size
        expected["snapshot_steps"] = (moments,), "int64"
        expected["snapshot_values"] = (moments, *pairs), "float32"
    for name, (shape, dtype) in expected.items():
        array = arrays.get(name)
        if array is None or array.shape != shape or not n:
            raise ValueError(f"{name} must be an array of shape {shape}")
        if array.dtype != dtype:
            raise ValueError(f"{name} must be an array of {dtype}: got {array.dtype}")
    if (np.diff(arrays["steps"], prepend=-1) <= 0).any():
        raise ValueError("steps must ascend from 0")
    if arrays["seeds"].tolist() != list(seeds):
        raise ValueError("seeds must be the seeds of its unit")
    for name in counts:
        if not 0 <= arrays[name].min() <= arrays[name].max() <= MOST_STEPS:
            raise ValueError(f"{name} must be from 0 to {MOST_STEPS:,}")
    for name in expected.keys() & {*CURVES, "snapshot_values"}:
        finite = arrays[name]
        if name == "snapshot_values":  # -inf where an action is not available
            finite = finite.max(axis=-1, initial=-np.inf)
        if np.isinf(finite).any():
            raise ValueError(f"{name} must have finite numbers")


# -- curves as rows --------------------------------------------------------------------------------


def curve_columns(arrays: Arrays, task: str | None = None) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a result's curves, each seed up to its own end."""
    steps = arrays["steps"]
    reached = steps[None, :] <= arrays["steps_used"][:, None]
    seed, checkpoint = np.nonzero(reached)
    columns = {} if task is None else {"task": np.array([task] * len(seed), dtype=object)}
    columns |= {"seed": arrays["seeds"][seed], "checkpoint": checkpoint, "steps": steps[checkpoint]}
    if "source_steps" in arrays:
        columns["source_steps"] = arrays["source_steps"][seed]
    return columns | {name: arrays[name][reached] for name in CURVES}


def data_frame(columns: Mapping[str, npt.NDArray[Any]]) -> "pandas.DataFrame":
    """Return columns as a pandas DataFrame, with the unit of each in ``attrs["units"]``."""
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise ImportError("a DataFrame needs pandas: pip install pandas") from None
    frame = pd.DataFrame(dict(columns))
    units = {name: field.unit for name, field in FIELDS.items()}
    units["source_steps"] = "steps in all sources"
    frame.attrs["units"] = {name: units[name] for name in columns if units.get(name)}
    return frame


GREEDY_RETURN = "mean return of greedy episodes"
"""On axes; a return has the unit of the task's rewards."""


def shown_returns(result: LearningResult) -> tuple[str, FloatArray]:
    """Return the name and values, (K, T), of the greedy return; without any, of the training's."""
    if np.isnan(result.greedy_return).all():
        return "mean return of training episodes", result.training_return
    return GREEDY_RETURN, result.greedy_return


def ends_of(result: LearningResult) -> tuple[float, float]:
    """Return the lowest and the highest return in a result's task, or else in the result."""
    # Of a discounted evaluation or another: a result does not know which its own was.
    pairs = [possible_returns(result.task, 1.0)]
    if pairs[0] is not None:
        pairs.append(possible_returns(result.task, generative_model(result.task).discount))
    ends = [end for pair in pairs if pair is not None for end in pair]
    return (min(ends), max(ends)) if None not in pairs else extremes([shown_returns(result)[1]])
