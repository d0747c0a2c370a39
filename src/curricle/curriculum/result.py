"""What training a curriculum gave: the results of its tasks, and what each hands on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.checks import one_of
from curricle.curriculum.curriculum_table import result_html, result_in_brief
from curricle.curriculum.retraining import RetrainedResult
from curricle.curriculum.sources import SourceValues
from curricle.deep.policy import TrainedPolicy
from curricle.deep.result import DeepResult
from curricle.errors import CurriculumError
from curricle.learning.decisions import Decisions
from curricle.learning.result import LearningResult
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

    @property
    def policies(self) -> tuple[TrainedPolicy, ...]:
        """The policy of each seed of the target, as of :class:`DeepResult`."""
        return self._of_networks().policies

    @property
    def policy(self) -> TrainedPolicy:
        """The best policy of the target, as of :class:`DeepResult`."""
        return self._of_networks().policy

    def _of_networks(self) -> DeepResult:
        """Return the target's result; CurriculumError unless a network learnt it."""
        found = self[self.curriculum.target]
        if not isinstance(found, DeepResult):
            raise CurriculumError(
                "a policy to take away is that of a network: the target "
                f"{self.curriculum.target!r} is learnt in a table"
            )
        return found

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
