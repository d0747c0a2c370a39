"""What training a curriculum gave: the results of its tasks, and what each hands on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from curricle.archives.saved_file import read_saved, write_saved
from curricle.array_types import IntArray
from curricle.checks import one_of
from curricle.curriculum.curriculum_table import result_html, result_in_brief
from curricle.curriculum.retraining import RetrainedResult
from curricle.curriculum.saved_curriculum import Parts, from_file, to_file
from curricle.curriculum.sources import SourceValues
from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult, curve_columns, data_frame
from curricle.learning.saved_result import arrays_of
from curricle.learning.stopping import Decisions
from curricle.planning.episode import Episode
from curricle.transfer.calibration import AnyPotential, Calibration


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
    retrained : dict of str to RetrainedResult
        What retraining took of each task that has it.
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
    retrained: Mapping[str, RetrainedResult] = field(default_factory=dict)
    given: Mapping[str, SourceValues] = field(default_factory=dict)

    def __repr__(self) -> str:
        return result_in_brief(self)

    def _repr_html_(self) -> str:
        return result_html(self)

    def __getitem__(self, name: str) -> LearningResult:
        one_of("a task", name, self.nodes, CurriculumError)
        return self.nodes[name]

    @cached_property
    def sources(self) -> dict[str, SourceValues]:
        """What each task hands on to those after it, whether it was trained here or before."""
        extra = {name: one.extra for name, one in self.retrained.items()}
        own = {name: SourceValues.of(one, extra.get(name, 0)) for name, one in self.nodes.items()}
        return {**own, **self.given}

    def source_steps(self, name: str) -> IntArray:
        """Return the steps each seed spent on a task's sources, each once, (K,) int64.

        Those of retraining them for `name` included.
        """
        spent = self.curriculum._spent(name, self.sources)
        total = np.zeros(len(self[name].seeds), dtype=np.int64) if spent is None else spent
        return total + self.retrained[name].extra if name in self.retrained else total

    def decisions(self, name: str) -> Decisions:
        """Return what a task's stopping rule decided at each checkpoint of each seed."""
        if name in self.retrained:
            return Decisions(self.retrained[name].decisions, self[name].seeds)
        found: Decisions = self.curriculum.node(name).decisions(self[name])
        return found

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
        parts = Parts(self.nodes, self.potentials, self.calibrations, self.retrained, self.given)
        return write_saved(path, type(self).__name__, *to_file(self.curriculum, parts))

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
        return cls(curriculum, **from_file(saved, curriculum)._asdict())
