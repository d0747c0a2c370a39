"""What training a curriculum gave: the results of its tasks, and what each hands on."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import numpy.typing as npt

from curricle.archives import SavedFile, read_saved, write_saved
from curricle.array_types import BoolArray, IntArray
from curricle.checks import one_of
from curricle.curriculum.sources import SourceValues, StoredValues, source_values
from curricle.deep.policy import DeepResult
from curricle.display import beside, block, shortened
from curricle.errors import CurricleError, CurriculumError, SettingError
from curricle.frozen_arrays import frozen
from curricle.learning.record import WarmUp
from curricle.learning.result import (
    LearningResult,
    curve_columns,
    data_frame,
    learnt_curve,
    learnt_table,
)
from curricle.learning.saved_result import (
    all_values_of,
    arrays_of,
    arrays_of_values,
    as_saved,
    check_value_arrays,
    pairs_of,
    task_record,
)
from curricle.learning.stopping import Decisions
from curricle.planning.episode import Episode
from curricle.text_tables import counted
from curricle.transfer.calibration import AnyPotential, Calibration

MOST_CURVES = 4
"""Tasks whose curves are shown beside each other, the last ones of a curriculum."""


@dataclass(frozen=True, eq=False)
class CurriculumResult:
    """What training a curriculum gave.

    Attributes
    ----------
    curriculum : Curriculum
    nodes : dict of str to LearningResult
        Of each task trained here or given.
    potentials : dict of str to list of MappedPotential or StateActionPotential
        For each task trained here, the potential of each seed (empty without sources).
    calibrations : dict of str to list of Calibration
        Of each seed, where transfers are calibrated: the first steps of the task's own budget.
    given : dict of str to SourceValues
        Of each task that was trained before.

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
    calibrations: Mapping[str, list[Calibration]] = field(default_factory=dict)
    given: Mapping[str, SourceValues] = field(default_factory=dict)

    def __repr__(self) -> str:
        seeds = len(next(iter(self.nodes.values())).seeds) if self.nodes else 0
        last = [f"{name} {one.greedy_return[:, -1].mean():.4g}" for name, one in self.nodes.items()]
        returns = f"last greedy returns: {', '.join(last)}" if last else "nothing was trained"
        return shortened(f"CurriculumResult({counted(seeds, 'seed')}; {returns})")

    def _repr_html_(self) -> str:
        shown = dict([*self.nodes.items()][-MOST_CURVES:])
        given = [name for name in self.given if name not in self.nodes]
        return block(
            f"Training of {' -> '.join(self.curriculum.order)}",
            beside({name: learnt_curve(one) for name, one in shown.items()}),
            learnt_table(self.nodes, {name: self._ended(name) for name in self.nodes}),
            given and f"learnt before: {', '.join(given)}",
            *(f"{name}: {_calibration(each)}" for name, each in self.calibrations.items()),
        )

    def _ended(self, name: str) -> str:
        """Return what ended a task's training in words; nothing where no rule did."""
        if name not in self.curriculum.tasks:
            return ""
        try:
            return self.decisions(name).in_words
        except CurricleError:  # a rule that cannot be judged any more
            return ""

    def __getitem__(self, name: str) -> LearningResult:
        one_of("a task", name, self.nodes, CurriculumError)
        return self.nodes[name]

    @cached_property
    def sources(self) -> dict[str, SourceValues]:
        """What each task hands on to those after it, whether it was trained here or before."""
        return {**{name: SourceValues.of(one) for name, one in self.nodes.items()}, **self.given}

    def source_steps(self, name: str) -> IntArray:
        """Return the steps each seed spent on a task's sources, each once, (K,) int64."""
        spent = self.curriculum._spent(name, self.sources)
        return np.zeros(len(self[name].seeds), dtype=np.int64) if spent is None else spent

    def decisions(self, name: str) -> Decisions:
        """Return what a task's stopping rule decided at each checkpoint of each seed."""
        found: Decisions = self.curriculum.node(name).decisions(self[name])
        return found

    def unlearnt(self, name: str) -> dict[str, BoolArray]:
        """Return for each source of a task which seeds its stopping rule says did not learn it."""
        sources = [one for one in self.curriculum.ancestors(name) if one in self.nodes]
        return {one: self.curriculum.node(one).unlearnt(self[one]) for one in sources}

    # -- to take away --------------------------------------------------------------------------

    @property
    def policies(self) -> tuple[Any, ...]:
        """The policy of each seed of the target, as of its :class:`LearningResult`."""
        return self[self.curriculum.target].policies

    @property
    def policy(self) -> Any:
        """The best policy of the target, as of its :class:`LearningResult`."""
        return self[self.curriculum.target].policy

    def watch(
        self, task: str | None = None, *, seed: int = 0, max_steps: int | None = None
    ) -> Episode:
        """Return an episode of a task's best policy, by default the target's.

        A notebook shows it, ``print`` prints it, and ``save`` writes a GIF. `seed` and `max_steps`
        are those of :meth:`LearningResult.watch`.
        """
        name = self.curriculum.target if task is None else task
        return self[name].watch(seed=seed, max_steps=max_steps)

    def frame(self) -> Any:
        """Return the curves of all tasks as a pandas DataFrame.

        Its columns are those of :meth:`LearningResult.frame`, the task before them, and the
        source_steps that were spent before it. ImportError where pandas is not installed.
        """
        parts = [
            curve_columns(arrays_of(node) | {"source_steps": self.source_steps(name)}, name)
            for name, node in self.nodes.items()
        ]
        return data_frame({name: np.concatenate([one[name] for one in parts]) for name in parts[0]})

    def save(self, path: str | Path) -> Path:
        """Write the results of all tasks into a file, and return its path, an ``.npz``.

        It has no pickles, and equal results give equal bytes. Tasks and transfers are not in it:
        :meth:`load` takes the curriculum again. StoreError when it cannot be written.
        """
        return write_saved(path, type(self).__name__, *to_file(self))

    @classmethod
    def load(cls, path: str | Path, curriculum: Any) -> Self:
        """Return the result in a file that :meth:`save` wrote, bit for bit.

        Parameters
        ----------
        path : path
        curriculum : Curriculum
            The one that was trained.

        Raises
        ------
        StoreError
            When the file cannot be read, is damaged, or holds something else.
        CurriculumError, SettingError
            When the curriculum has other tasks, or one of them other states or actions.

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
            return cls(curriculum, *_from_words(saved, saved.about, curriculum))


def _calibration(each: list[Calibration]) -> str:
    refused = sum(bool(one.refusal) for one in each)
    scale = np.mean([one.scale for one in each])
    words = f"calibrated to scale {scale:.3g} on average over {counted(len(each), 'seed')}"
    return f"{words}, of which {refused} could not be" if refused else words


Arrays = dict[str, npt.NDArray[Any]]
Read = TypeVar("Read")
KINDS: dict[str, type[LearningResult]] = {
    kind.__name__: kind for kind in (LearningResult, DeepResult)
}
SCALARS = tuple(one.name for one in fields(Calibration) if one.name not in ("potential", "warm_up"))


def to_file(result: CurriculumResult) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays and the words of a file; arrays are named ``part/number/name``."""
    arrays = Arrays()

    def put(part: str, names: Mapping[str, Any], of: Callable[[Any], Arrays]) -> None:
        for i, one in enumerate(names.values()):
            arrays.update({f"{part}/{i}/{name}": array for name, array in of(one).items()})

    nodes = {name: one.parts_of_file() for name, one in result.nodes.items()}
    put("nodes", nodes, lambda one: one[0])
    put("given", result.given, _arrays_given)
    put("calibrations", result.calibrations, _arrays_calibrated)
    words = {
        "tasks": {name: task_record(task) for name, task in result.curriculum.tasks.items()},
        "nodes": {name: {"kind": type(result.nodes[name]).__name__, **about}
                  for name, (_, about) in nodes.items()},
        "trained": list(result.potentials),
        "given": {name: one.own_rewards for name, one in result.given.items()},
        "calibrations": {
            name: [{scalar: getattr(one, scalar) for scalar in SCALARS} for one in each]
            for name, each in result.calibrations.items()
        },
    }  # fmt: skip
    return arrays, words


def _from_words(saved: SavedFile, words: Mapping[str, Any], curriculum: Any) -> tuple[Any, ...]:
    """Return the fields of a result but its curriculum; its potentials are computed again.

    They follow from the sources' values, as they did in training.
    """
    if (stored := {*words["tasks"]}) != {*curriculum.tasks}:
        raise CurriculumError(
            f"a result must be loaded with its own curriculum: {saved.path} has the tasks "
            f"{', '.join(sorted(stored))}, the curriculum {', '.join(sorted(curriculum.tasks))}"
        )

    def read(part: str, of: Callable[[str, Arrays, Any], Read]) -> dict[str, Read]:
        found = {}
        for i, (name, about) in enumerate(words[part].items()):
            own, arrays = f"{part}/{i}/", saved.arrays
            mine = {key.removeprefix(own): one for key, one in arrays.items() if
                    key.startswith(own)}  # fmt: skip
            found[name] = of(name, mine, about)
        return found

    def node(name: str, arrays: Arrays, about: Any) -> LearningResult:
        kind, task = KINDS[about["kind"]], curriculum.tasks[name]
        found = kind.of_file(saved, arrays, about, task)
        learner = found.learner or curriculum.setting("learner", name)
        return replace(found, learner=learner)

    def source(name: str, arrays: Arrays, own_rewards: bool) -> SourceValues:
        task, seeds = curriculum.tasks[name], tuple(arrays["seeds"].tolist())
        check_value_arrays(arrays, len(seeds), pairs_of(saved, words["tasks"][name], task))
        values = all_values_of(arrays, len(seeds))
        return SourceValues(task, seeds, values, frozen(arrays["steps_used"]), bool(own_rewards))

    nodes, given = read("nodes", node), read("given", source)
    fitted = read("calibrations", _calibrations)
    nodes, given = _with_networks(curriculum, nodes, given, fitted)
    sources = {**{name: SourceValues.of(one) for name, one in nodes.items()}, **given}
    potentials = {name: curriculum.potentials(name, sources) for name in words["trained"]}
    calibrations = {}
    for name, each in fitted.items():
        pairs = zip(each, potentials[name], strict=True)
        calibrations[name] = [
            replace(one, potential=phi if one.refusal else phi.rescaled(one.scale))
            for one, phi in pairs
        ]
        potentials[name] = [one.potential for one in calibrations[name]]
    return nodes, potentials, calibrations, given


# -- sources trained before ----------------------------------------------------------------------


def _arrays_given(one: SourceValues) -> Arrays:
    found = {"seeds": np.array(one.seeds, dtype=np.int64), "steps_used": one.steps_used}
    return found | arrays_of_values(one.values)


def _with_networks(
    curriculum: Any,
    nodes: dict[str, LearningResult],
    given: dict[str, SourceValues],
    fitted: Mapping[str, list[Calibration]],
) -> tuple[dict[str, LearningResult], dict[str, SourceValues]]:
    """Return the same with networks built from their parameters, sources first."""
    learnt: dict[str, Any] = {**given, **nodes}
    if not any(curriculum.node(name).deep for name in learnt):
        return nodes, given
    stored = {
        name: StoredValues(one.values, one.steps_used, [one.scale for one in fitted.get(name, ())])
        for name, one in learnt.items()
    }
    seeds = next(iter(learnt.values())).seeds
    try:
        built = source_values(curriculum, seeds, stored)
    except RuntimeError as error:  # of PyTorch
        raise SettingError(
            "networks must be loaded with the learners they were trained with: "
            f"{' '.join(str(error).split())}"
        ) from None
    for name, one in built.items():
        if name in nodes:
            nodes[name] = replace(nodes[name], values=one.values)
        if name in given:
            given[name] = replace(given[name], values=one.values)
    return nodes, given


# -- calibrations --------------------------------------------------------------------------------


def _arrays_calibrated(each: list[Calibration]) -> Arrays:
    found = Arrays()
    for k, one in enumerate(each):
        found |= {f"lengths_{k}": one.warm_up.lengths, f"returns_{k}": one.warm_up.returns}
    return found


def _calibrations(_: str, arrays: Arrays, about: Any) -> list[Calibration]:
    """Return calibrations whose potentials are not there yet."""
    found = []
    for k, one in enumerate(about):
        warm_up = WarmUp(frozen(arrays[f"lengths_{k}"]), frozen(arrays[f"returns_{k}"]))
        found.append(Calibration(None, warm_up=warm_up, **{name: one[name] for name in SCALARS}))
    return found
