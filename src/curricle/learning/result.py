"""The result of learning: curves, values and totals of K seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, frozen
from curricle.display import block, curves, table
from curricle.errors import SettingError
from curricle.files import SavedFile, read_saved, write_saved
from curricle.learning.learners import Learner
from curricle.learning.record import Snapshots
from curricle.learning.run import Outcome
from curricle.learning.saved_result import (
    CURVES,
    FIELDS,
    TOTALS,
    Arrays,
    all_values_of,
    arrays_of,
    as_saved,
    check_result_arrays,
    check_value_arrays,
    learner_of,
    learner_record,
    pairs_of,
    task_record,
)
from curricle.learning.tabular_policy import TabularPolicy
from curricle.planning.episode import Episode
from curricle.statistics.intervals import mean_interval, seed_line
from curricle.tasks.mdp import Task
from curricle.text import counted


@dataclass(frozen=True, eq=False)
class LearningResult(Frozen):
    """What :func:`learn` found, for K seeds and T checkpoints.

    Attributes
    ----------
    task : Task
    learner : Learner
    seeds : tuple of int
        K of them.
    values : (K, S, A) float64 or float32
        What each seed learnt, in the task's own rewards: Q, plus what shaping took off it (phi,
        or Phi(s)). Transfers hand these on, and policies act on them (plus what is left of a
        :class:`DecayingAdvice`). They are 0 in the ends that the task knows, or that were reached.
        From sparse tables K :class:`SparseValues`; None if the :class:`Storage` saves none.
    steps : (T,) int64
        Steps taken at each checkpoint, from 0.
    training_return : (K, T) float64
        Mean undiscounted, unshaped return of the episodes that ended since the last checkpoint;
        NaN where none did.
    guard_share : (K, T) float64
        Share of the steps that a guarded potential's learner got (:class:`Guard`); NaN without.
    greedy_return : (K, T) float64
        Expected return of the greedy policy (:class:`GreedyEvaluation`). Checkpoints after a seed's
        end repeat its last value.
    episodes : (K, T) int64
        Episodes ended by each checkpoint.
    steps_used, episodes_used : (K,) int64
        Totals of each seed.
    evaluation_steps : (K,) int64
        Steps of rollouts of the greedy policy, charged to no budget; 0 where evaluation is exact.
    out_of_memory : (K,) bool
        Whether a run ended early, at the step for which a sparse table had no row left.
    own_rewards : (K,) bool
        Whether the values are in the task's own rewards. No transfer takes others: those after
        :class:`LookBackAdvice`, :class:`RewardBonus` and a changing :class:`StateShaping`.
    snapshots : Snapshots or None
        Values of the first seed on the way, if asked for.

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
    steps: IntArray
    training_return: FloatArray
    greedy_return: FloatArray
    episodes: IntArray
    steps_used: IntArray
    episodes_used: IntArray
    evaluation_steps: IntArray
    out_of_memory: BoolArray
    guard_share: FloatArray
    own_rewards: BoolArray
    snapshots: Snapshots | None = None

    # -- to take away --------------------------------------------------------------------------

    @cached_property
    def policies(self) -> tuple[Any, ...]:
        """The :class:`TabularPolicy` of each seed, K; SettingError where values were not saved."""
        if self.values is None:
            raise SettingError(
                "a policy to take away needs the values that were learnt: these were not saved, "
                "see Storage(save_values=True)"
            )
        return tuple(TabularPolicy(self.task, table) for table in self.values)

    @property
    def policy(self) -> Any:
        """The policy of the seed whose last greedy return is best; of the first, without any.

        That return says too much of it, as it was chosen by it.
        """
        last = self.greedy_return[:, -1]
        return self.policies[0 if np.isnan(last).all() else int(np.nanargmax(last))]

    def watch(self, *, seed: int = 0, max_steps: int | None = None) -> Episode:
        """Return an episode of :attr:`policy`: a notebook shows it, ``print`` prints it.

        Parameters
        ----------
        seed, max_steps
            As in :meth:`TabularPolicy.episode`.

        Examples
        --------
        >>> from curricle import GridWorld, learn
        >>> learn(GridWorld("S.T"), budget=2000).watch()
        Episode(2 steps, return 198, terminated)
        """
        episode: Episode = self.policy.episode(seed=seed, max_steps=max_steps)
        return episode

    def frame(self) -> Any:
        """Return the curves as a pandas DataFrame, a row for each seed and checkpoint.

        Its columns are seed, checkpoint, steps, training_return, greedy_return, guard_share and
        episodes, each seed up to its own end; ``frame().attrs["units"]`` has their units.
        ImportError where pandas is not installed.

        Examples
        --------
        >>> from curricle import GridWorld, learn
        >>> frame = learn(GridWorld("S.T"), budget=1000, seeds=2).frame()
        >>> len(frame), frame.attrs["units"]["greedy_return"]
        (202, 'return of the greedy policy')
        """
        return data_frame(curve_columns(arrays_of(self)))

    def save(self, path: str | Path) -> Path:
        """Write the result into a file, without pickles, and return its path, an ``.npz``.

        Equal results give equal bytes. The task is not in it: :meth:`load` takes it again.
        StoreError when it cannot be written.
        """
        return write_saved(path, type(self).__name__, *self.parts_of_file())

    def parts_of_file(self) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
        """Return the arrays and the words that :meth:`save` writes."""
        about: dict[str, Any] = {"task": task_record(self.task), "learner": None}
        if self.learner is not None:
            about["learner"] = learner_record(self.learner)
        if self.snapshots is not None:
            about["snapshot_seed"] = self.snapshots.seed
        return arrays_of(self), about

    @classmethod
    def load(cls, path: str | Path, task: Any = None) -> Self:
        """Return the result in a file that :meth:`save` wrote, bit for bit.

        Parameters
        ----------
        path : path
        task : Task, optional
            The one that was learnt. Without it the policy plays no episodes, and no transfer takes
            the result.

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
        """Return the result whose arrays and words, of all or of a part of it, a file holds."""
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
        fields: dict[str, Any] = {name: frozen(arrays[name]) for name in FIELDS}
        return cls(
            task=task, learner=learner, seeds=seeds, values=values, snapshots=snapshots, **fields
        )

    def __repr__(self) -> str:
        learner = "" if self.learner is None else f"{type(self.learner).__name__}, "
        return (
            f"{type(self).__name__}({learner}{counted(len(self.seeds), 'seed')}, "
            f"{int(self.steps_used.mean()):,} steps and {int(self.episodes_used.mean()):,} "
            f"episodes a seed, final greedy return {self.greedy_return[:, -1].mean():.4g})"
        )

    def _repr_html_(self) -> str:
        name = "" if self.task is None else type(self.task).__name__
        return block(type(self).__name__, learnt_curve(self), learnt_table({name: self}, {}))


def learning_result(
    task: Task,
    learner: Learner,
    seeds: tuple[int, ...],
    values: Any,
    outcomes: Sequence[Outcome],
    eval_freq: int,
) -> LearningResult:
    """Put the seeds' records on one axis of checkpoints."""
    n = max(outcome.steps for outcome in outcomes) // eval_freq + 1
    curves = {
        name: np.stack([getattr(outcome.record, name)[:n] for outcome in outcomes])
        for name in CURVES
    }
    for k, outcome in enumerate(outcomes):
        end = outcome.steps // eval_freq
        for name in (name for name in CURVES if FIELDS[name].held):
            curves[name][k, end + 1 :] = curves[name][k, end]
    first, snapshots = outcomes[0], None
    if len(first.record.snapshot_at):
        taken = first.record.snapshot_at * eval_freq <= first.steps
        steps, tables = first.record.snapshot_at[taken] * eval_freq, first.record.snapshots[taken]
        last = None if values is None else values[0]
        if isinstance(last, np.ndarray) and steps[-1] < first.steps:  # the last values too
            steps = np.append(steps, first.steps)
            acting = (last + first.advice).astype(np.float32)
            tables = np.concatenate([tables, acting[None]])
        snapshots = Snapshots(seeds[0], frozen(steps), frozen(tables))
    return LearningResult(
        task=task,
        learner=learner,
        seeds=seeds,
        values=frozen(values) if isinstance(values, np.ndarray) else values,
        steps=frozen(np.arange(n) * eval_freq),
        steps_used=frozen(np.array([outcome.steps for outcome in outcomes])),
        episodes_used=frozen(np.array([outcome.episodes for outcome in outcomes])),
        evaluation_steps=frozen(np.array([outcome.evaluation_steps for outcome in outcomes])),
        out_of_memory=frozen(np.array([outcome.out_of_memory for outcome in outcomes])),
        own_rewards=frozen(np.array([outcome.own_rewards for outcome in outcomes])),
        snapshots=snapshots,
        **{name: frozen(curve) for name, curve in curves.items()},
    )


def joined_results(parts: Sequence[LearningResult]) -> LearningResult:
    """Return the results of several groups of seeds as one, seeds ascending."""
    longest = max(parts, key=lambda part: len(part.steps))
    place = {seed: k for k, seed in enumerate(chain.from_iterable(part.seeds for part in parts))}
    seeds = sorted(place)
    order = np.array([place[seed] for seed in seeds])

    def joined(arrays: Sequence[npt.NDArray[Any]]) -> Any:
        return frozen(np.concatenate(arrays)[order])

    def lengthened(name: str) -> Any:
        """Return the curves of all seeds, those of seeds that have ended held, or else NaN."""
        after = {"mode": "edge"} if FIELDS[name].held else {"constant_values": np.nan}
        more = [len(longest.steps) - len(part.steps) for part in parts]
        curves = [getattr(part, name) for part in parts]
        pad: Any = np.pad
        return joined(
            [pad(x, ((0, 0), (0, n)), **after) for x, n in zip(curves, more, strict=True)]
        )

    values: Any = [part.values for part in parts]
    if any(value is None for value in values):
        values = None
    elif all(isinstance(value, np.ndarray) for value in values):
        values = joined(values)
    else:
        flat = list(chain.from_iterable(values))
        values = tuple(flat[k] for k in order)
    snapshots = [part.snapshots for part in parts if part.snapshots is not None]
    return replace(
        longest,
        seeds=tuple(seeds),
        values=values,
        snapshots=min(snapshots, key=lambda snapshots: snapshots.seed, default=None),
        **{name: lengthened(name) for name in CURVES},
        **{name: joined([getattr(part, name) for part in parts]) for name in TOTALS},
    )


# -- curves as rows --------------------------------------------------------------------------------


def curve_columns(arrays: Arrays, task: str | None = None) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a result's curves, each seed up to its own end."""
    steps = arrays["steps"]
    reached = steps[None, :] <= arrays["steps_used"][:, None]
    seed, checkpoint = np.nonzero(reached)
    columns = {} if task is None else {"task": np.array([task] * len(seed), dtype=object)}
    columns |= {
        "seed": arrays["seeds"][seed],
        "checkpoint": checkpoint,
        "steps": steps[checkpoint],
    }
    if "source_steps" in arrays:
        columns["source_steps"] = arrays["source_steps"][seed]
    return columns | {name: arrays[name][reached] for name in CURVES}


def data_frame(columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    """Return columns as a pandas DataFrame, whose ``attrs["units"]`` are those of each column."""
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise ImportError("a DataFrame needs pandas: pip install pandas") from None
    frame = pd.DataFrame(dict(columns))
    units = {name: field.unit for name, field in FIELDS.items()}
    units["source_steps"] = "steps in all sources"
    frame.attrs["units"] = {name: units[name] for name in columns if units.get(name)}
    return frame


# -- as a table ------------------------------------------------------------------------------------


def learnt_table(results: Mapping[str, Any], ended: Mapping[str, str]) -> Markup:
    """Return a row for each task's LearningResult, and in words what ended its learning."""
    rows = []
    for name, result in results.items():
        learner = "" if result.learner is None else type(result.learner).__name__
        steps, episodes = f"{result.steps_used.mean():,.0f}", f"{result.episodes_used.mean():,.0f}"
        curve = result.greedy_return
        first, last = (str(mean_interval(curve[:, i])).rsplit(",", 1)[0] for i in (0, -1))
        seeds = len(result.seeds)
        rows.append((name, learner, seeds, steps, episodes, first, last, ended.get(name, "")))
    words = ["ended by"] * any(ended.values())
    shown = [row if words else row[:-1] for row in rows]
    head = ["task", "learner", "seeds", "steps a seed", "episodes a seed"]
    return table([*head, "first return", "last return", *words], shown, wide=words)


def shown_returns(result: Any) -> tuple[str, FloatArray]:
    """Return the name and the returns, (K, T), of what is shown: without evaluation of training."""
    if np.isnan(result.greedy_return).all():
        return "training return", result.training_return
    return "greedy return", result.greedy_return


def learnt_curve(result: Any) -> Markup:
    """Return the greedy return over steps, mean over seeds; without evaluation that of training."""
    named, values = shown_returns(result)
    return curves([seed_line("", result.steps, values)], "steps", named)
