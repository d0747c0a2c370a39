"""The result of training a curriculum: results of its tasks, and the values that targets read."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, IntArray, frozen
from curricle.checks import one_of
from curricle.deep.learning import DeepResult
from curricle.errors import CurriculumError, SettingError
from curricle.files import SavedFile, read_saved, write_saved
from curricle.learning.result import (
    LearningResult,
    arrays_of,
    curve_columns,
    data_frame,
)
from curricle.learning.stopping import UNLEARNT, Decisions
from curricle.learning.tabular_policy import (
    all_values_of,
    arrays_of_values,
    as_saved,
    check_value_arrays,
    pairs_of,
    task_record,
)
from curricle.pictures.episode import Episode
from curricle.text import brief_repr, counted, shortened
from curricle.transfer.potential import AnyPotential

if TYPE_CHECKING:
    import pandas

MOST_CURVES = 4  # curves that are shown side by side: those of a curriculum's last tasks


@dataclass(frozen=True, eq=False)
class SourceValues:
    """The values that K seeds learnt in a task; later tasks need nothing else of it.

    Attributes
    ----------
    task : Task or ObservationTask
    seeds : tuple of int
        The K seeds.
    values : (K, S, A) float array or K ValueSource
        None if the values were not kept.
    steps_used : (K,) int64
        Steps of each seed in the task.
    own_rewards : bool
        Whether the values are free of shaping rewards (:class:`LearningResult`).

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> SourceValues.of(learn(GridWorld("S.T"), budget=500, seeds=3)).first(2).seeds
    (0, 1)
    """

    task: Any
    seeds: tuple[int, ...]
    values: Any
    steps_used: IntArray
    own_rewards: bool = True

    __repr__ = brief_repr

    @classmethod
    def of(cls, result: "Learnt") -> Self:
        """Return the values of a result."""
        own_rewards = bool(np.all(result.own_rewards))
        return cls(result.task, result.seeds, result.values, result.steps_used, own_rewards)

    def first(self, n: int) -> "SourceValues":
        """Return the values of the first n seeds."""
        values = None if self.values is None else self.values[:n]
        return replace(self, seeds=self.seeds[:n], values=values, steps_used=self.steps_used[:n])


Learnt = LearningResult | SourceValues


@dataclass(frozen=True, eq=False)
class CurriculumResult:
    """The result of training a curriculum.

    Attributes
    ----------
    curriculum : Curriculum
    nodes : dict of str to LearningResult
        Results of the tasks trained here, and whole results that were passed in `trained`.
    potentials : dict of str to list of MappedPotential or StateActionPotential
        Potential of each seed, for the tasks trained here; empty for a task without one.
    given : dict of str to SourceValues
        Values of the tasks that were trained before.

    Examples
    --------
    >>> from curricle import Curriculum, GridWorld
    >>> result = Curriculum(tasks={"maze": GridWorld("S.T")}, budget=1000).train(seeds=2)
    >>> result["maze"].seeds, result.source_steps("maze")
    ((0, 1), array([0, 0]))
    """

    curriculum: Any
    nodes: Mapping[str, LearningResult]
    potentials: Mapping[str, list[AnyPotential]]
    given: Mapping[str, SourceValues] = field(default_factory=dict)

    def __repr__(self) -> str:
        seeds = len(next(iter(self.nodes.values())).seeds) if self.nodes else 0
        last = {name: node.greedy_return[:, -1].mean() for name, node in self.nodes.items()}
        listed = ", ".join(f"{name} {value:.4g}" for name, value in last.items())
        returns = f"last greedy returns: {listed}" if last else "nothing was trained"
        return shortened(f"CurriculumResult({counted(seeds, 'seed')}; {returns})")

    def __getitem__(self, name: str) -> LearningResult:
        one_of("a task", name, self.nodes, CurriculumError)
        return self.nodes[name]

    @cached_property
    def sources(self) -> dict[str, SourceValues]:
        """The values of all tasks trained here or before, which later tasks can read."""
        return {**{name: SourceValues.of(node) for name, node in self.nodes.items()}, **self.given}

    def source_steps(self, name: str) -> IntArray:
        """Return the steps of each seed in all tasks on which a task builds, (K,) int64."""
        spent: IntArray = self.curriculum.spent(name, self.sources, len(self[name].seeds))
        return spent

    def decisions(self, name: str) -> Decisions:
        """Return the decisions of a task's stopping rule at the checkpoints of each seed."""
        decisions: Decisions = self.curriculum.node(name).decisions(self[name])
        return decisions

    def unlearnt(self, name: str) -> dict[str, BoolArray]:
        """Return source -> the seeds that did not learn it by its stopping rule, (K,) bool."""
        sources = [task for task in self.curriculum.ancestors(name) if task in self.nodes]
        return {task: self[task].ended_by == UNLEARNT for task in sources}

    # -- policies, curves and files ------------------------------------------------------------

    @property
    def policies(self) -> tuple[Any, ...]:
        """The policies of the target, one a seed (:attr:`LearningResult.policies`)."""
        return self[self.curriculum.target].policies

    @property
    def policy(self) -> Any:
        """The best policy of the target (:attr:`LearningResult.policy`)."""
        return self[self.curriculum.target].policy

    def watch(
        self, task: str | None = None, *, seed: int = 0, max_steps: int | None = None
    ) -> Episode:
        """Return :meth:`LearningResult.watch` of a task, by default of the target."""
        name = self.curriculum.target if task is None else task
        return self[name].watch(seed=seed, max_steps=max_steps)

    def frame(self) -> "pandas.DataFrame":
        """Return the curves of all tasks as a pandas DataFrame, ImportError without pandas.

        Its columns are the task, those of :meth:`LearningResult.frame`, and source_steps.
        """
        if not self.nodes:
            raise CurriculumError(
                "a frame needs a task that was trained here: all came by trained=; take the frame "
                "of the result that they came from"
            )
        parts = [
            curve_columns(arrays_of(node) | {"source_steps": self.source_steps(name)}, name)
            for name, node in self.nodes.items()
        ]
        return data_frame({key: np.concatenate([part[key] for part in parts]) for key in parts[0]})

    def save(self, path: str | Path) -> Path:
        """Write the results of all tasks into an ``.npz`` file without pickles; return its path.

        Equal results give equal bytes. The file holds no tasks. StoreError if it cannot be written.
        """
        return write_saved(path, type(self).__name__, *to_file(self))

    @classmethod
    def load(cls, path: str | Path, curriculum: Any) -> Self:
        """Return the result in a file that :meth:`save` wrote for the same `curriculum`.

        StoreError when the file cannot be read, is damaged, or holds something else;
        CurriculumError or SettingError when the curriculum has other tasks, states or actions.

        Examples
        --------
        >>> from tempfile import mkdtemp
        >>> from curricle import Curriculum, GridWorld
        >>> plan = Curriculum({"maze": GridWorld("S.T")}, budget=2000)
        >>> again = CurriculumResult.load(plan.train().save(f"{mkdtemp()}/plan"), plan)
        >>> again.watch()
        Episode(2 steps, return 198, terminated)
        """
        saved = read_saved(path, cls.__name__)
        if not (hasattr(curriculum, "tasks") and hasattr(curriculum, "in_edges")):
            raise CurriculumError(
                f"a result is loaded with the Curriculum that was trained: got {curriculum!r}"
            )
        with as_saved(saved):
            return cls(curriculum, *_from_file(saved, saved.about, curriculum))


# -- files -----------------------------------------------------------------------------------------

Arrays = dict[str, npt.NDArray[Any]]
KINDS: dict[str, type[LearningResult]] = {
    kind.__name__: kind for kind in (LearningResult, DeepResult)
}


def to_file(result: CurriculumResult) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays and the JSON of a file; arrays are named ``part/number/name``."""
    arrays, nodes = Arrays(), dict[str, Any]()
    for i, (name, node) in enumerate(result.nodes.items()):
        of_node, about = node.parts_of_file()
        nodes[name] = {"kind": type(node).__name__, **about}
        arrays |= {f"nodes/{i}/{key}": array for key, array in of_node.items()}
    for i, source in enumerate(result.given.values()):
        of_source = {"seeds": np.array(source.seeds, np.int64), "steps_used": source.steps_used}
        of_source |= arrays_of_values(source.values)
        arrays |= {f"given/{i}/{key}": array for key, array in of_source.items()}
    return arrays, {
        "tasks": {name: task_record(task) for name, task in result.curriculum.tasks.items()},
        "nodes": nodes,
        "trained": list(result.potentials),
        "given": {name: source.own_rewards for name, source in result.given.items()},
    }


def _from_file(saved: SavedFile, about: Mapping[str, Any], curriculum: Any) -> tuple[Any, ...]:
    """Return the fields of a result except its curriculum."""
    if (stored := {*about["tasks"]}) != {*curriculum.tasks}:
        raise CurriculumError(
            f"a result must be loaded with its own curriculum: {saved.path} has the tasks "
            f"{', '.join(sorted(stored))}, the curriculum {', '.join(sorted(curriculum.tasks))}"
        )

    def parts(part: str) -> Iterator[tuple[str, Any, Arrays]]:
        for i, (name, said) in enumerate(about[part].items()):
            start, items = f"{part}/{i}/", saved.arrays.items()
            named = {key.removeprefix(start): x for key, x in items if key.startswith(start)}
            yield name, said, named

    nodes, earlier = dict[str, LearningResult](), dict[str, Learnt]()
    for name, said, arrays in parts("nodes"):
        node = KINDS[said["kind"]].of_file(saved, arrays, said, curriculum.tasks[name])
        nodes[name] = replace(node, learner=node.learner or curriculum.setting("learner", name))
    for name, own_rewards, arrays in parts("given"):
        task, seeds = curriculum.tasks[name], tuple(arrays["seeds"].tolist())
        check_value_arrays(arrays, len(seeds), pairs_of(saved, about["tasks"][name], task))
        values, steps = all_values_of(arrays, len(seeds)), frozen(arrays["steps_used"])
        earlier[name] = SourceValues(task, seeds, values, steps, bool(own_rewards))
    learnt = {name: SourceValues.of(result) for name, result in (nodes | earlier).items()}
    try:
        sources = source_values(curriculum, learnt)  # networks instead of their parameters
    except RuntimeError as error:  # of PyTorch
        raise SettingError(
            "networks must be loaded with the learners they were trained with: "
            f"{' '.join(str(error).split())}"
        ) from None
    # Potentials are computed from the sources' values, as in training.
    potentials = {
        name: curriculum.potentials(name, sources, seeds=len(nodes[name].seeds))
        for name in about["trained"]
    }
    nodes = {name: replace(node, values=sources[name].values) for name, node in nodes.items()}
    return nodes, potentials, {name: sources[name] for name in earlier}


# -- stored values, as plain data ------------------------------------------------------------------


def sources_read(curriculum: Any, name: str) -> set[str]:
    """Return the tasks whose values training a task reads: its sources, and those of networks."""
    read, waiting = set[str](), [name]
    while waiting:
        for edge in curriculum.in_edges(waiting.pop()):
            # A network that learnt on top of a potential can be rebuilt only with that potential.
            if edge.source not in read and curriculum.node(edge.source).deep:
                waiting.append(edge.source)
            read.add(edge.source)
    return read


def source_values(curriculum: Any, sources: Mapping[str, SourceValues]) -> dict[str, SourceValues]:
    """Return stored values as :meth:`Curriculum.train` takes them.

    Their tasks are the curriculum's, and parameters of networks become networks.
    """
    learnt: dict[str, SourceValues] = {}
    for name in (name for name in curriculum.order if name in sources):
        node, stored = curriculum.node(name), sources[name]
        values = stored.values
        if node.deep and values is not None:
            potentials: list[Any] = curriculum.potentials(name, learnt, seeds=len(stored.seeds))
            node.learner.algorithm_class()  # raises an ImportError that names what to install
            from curricle.deep.models import network_values  # needs PyTorch

            shapings = map(node.shaping.with_potential, potentials or [None] * len(stored.seeds))
            values = tuple(map(partial(network_values, node.task, node.learner), shapings, values))
        learnt[name] = replace(stored, task=node.task, values=values)
    return learnt
