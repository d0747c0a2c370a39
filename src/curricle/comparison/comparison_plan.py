"""The arms of a comparison, checked and trained at one total budget."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.comparison.arms import Arm, best_from_scratch, concatenated
from curricle.comparison.comparable import (
    check_comparable,
    curricula_by_name,
    most_source_steps,
)
from curricle.comparison.controls import (
    PLACEBO,
    Change,
    Control,
    changed_potentials,
    check_controls,
    check_fit,
    learn_changed,
    level_of,
    shuffled_miniatures,
    source_control,
    value_controls,
)
from curricle.comparison.learnt_alone import LearntAlone
from curricle.comparison.levels import VisitedPairs
from curricle.comparison.scratch import GivenScratch, scratch_curricula
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import Node
from curricle.curriculum.result import CurriculumResult
from curricle.errors import CurriculumError, SettingError
from curricle.learning.result import LearningResult
from curricle.learning.stopping import Episodes, StoppingRule, limits, spacing
from curricle.planning.target import Target
from curricle.progress import SILENT, Bars
from curricle.statistics.curves import SCRATCH
from curricle.statistics.sequential import add_seeds
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.observation_rollouts import ObservationTarget, target_of


@dataclass(frozen=True)
class ComparisonPlan:
    """The checked arms of a comparison and the settings that they share.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> plan = Curriculum(tasks={"maze": GridWorld("S.T")}, budget=100)
    >>> ComparisonPlan.of(plan).total
    100
    """

    arms: Mapping[str, Curriculum]
    controls: Sequence[Control]
    scratch: Mapping[str, Curriculum]
    target: str
    budget: int
    total: int
    eval_freq: int
    workers: int | None
    bars: Bars = SILENT
    alone: LearntAlone = field(default_factory=LearntAlone)

    @classmethod
    def of(
        cls,
        arms: Curriculum | Mapping[str, Curriculum],
        controls: Sequence[Control] = (),
        scratch: GivenScratch = (),
        workers: int | None = None,
    ) -> "ComparisonPlan":
        """Return the plan of :func:`compare` for arms; CurriculumError if they differ too much."""
        arms = curricula_by_name(arms)
        check_controls(controls)
        check_comparable(arms)
        first = next(iter(arms.values()))
        target = first.target
        budget = first.setting("budget", target)
        if isinstance(budget, Episodes | StoppingRule):
            raise SettingError(
                f"a comparison at one total budget needs the target's in steps: {target!r} has "
                f"{budget}"
            )
        if first.setting("evaluation", target).method == "off":
            raise SettingError(f"a comparison needs greedy evaluation: that of {target!r} is off")
        for name, arm in arms.items():
            check_fit(controls, name, arm)
        others = scratch_curricula(scratch, first)
        for name in others:
            if name in arms:
                raise CurriculumError(f"the name {name!r} is taken by a learner: rename this arm")
        eval_freq = spacing(first.setting("eval_freq", target), budget)
        most = max(most_source_steps(arm) for arm in arms.values())
        total = -(-(limits(budget)[0] + most) // eval_freq) * eval_freq
        given = dict(arms), controls, others, target, limits(budget)[0]
        return cls(*given, total, eval_freq, workers)

    @property
    def first(self) -> Curriculum:
        """The first arm, whose target's settings all arms share."""
        return next(iter(self.arms.values()))

    @property
    def checkpoints(self) -> int:
        """Checkpoints within the target's own budget."""
        return self.budget // self.eval_freq + 1

    def solved_target(self) -> Target | ObservationTarget:
        """Return the target, solved if it can be, with the evaluation that all arms share."""
        evaluation = self.first.setting("evaluation", self.target)
        return target_of(self.first.tasks[self.target], evaluation)

    def run(self, seeds: Sequence[int], failed: dict[str, Exception]) -> dict[str, Arm]:
        """Return all arms for these seeds, scratch first.

        An arm in `failed` is left out; one that raises an error is added to it, with its controls
        if it is a curriculum. Errors of the target's own learner from scratch are raised.
        """
        found = {SCRATCH: self._from_scratch(self.first, seeds, self.bars.within(SCRATCH))}
        self.bars.tell(SCRATCH)

        def add(name: str, train: Callable[[Bars], Arm]) -> None:
            if name not in failed:
                try:
                    found[name] = train(self.bars.within(name))
                except Exception as error:  # of any kind: a task may be the user's own code
                    failed[name] = error
                else:
                    self.bars.tell(name)

        for name, curriculum in self.scratch.items():
            add(name, partial(self._from_scratch, curriculum, seeds))
        for name, curriculum in self.arms.items():
            for label, train in self._with_controls(curriculum, seeds):
                add(f"{name}, {label}" if label else name, train)
                if name in failed:
                    break
        return found

    def _from_scratch(self, curriculum: Curriculum, seeds: Sequence[int], bars: Bars) -> Arm:
        """Return the target of a curriculum learnt without its sources."""
        node = curriculum.node(self.target).replace(budget=self.total, eval_freq=self.eval_freq)
        train = partial(Node.train, seeds=seeds, workers=self.workers, progress=bars)
        result = self.alone.curves(node, seeds, train)
        return self._arm(result, np.zeros(len(seeds), np.int64), scratch=True)

    def _with_controls(
        self, curriculum: Curriculum, seeds: Sequence[int]
    ) -> Iterator[tuple[str, Callable[[Bars], Arm]]]:
        """Yield the label of each arm and the function that trains it, the curriculum's first."""
        trained: list[CurriculumResult] = []

        def own(bars: Bars) -> Arm:
            known = self.alone.sources(curriculum, seeds)
            trained.append(self._trained(curriculum, seeds, bars, known))
            self.alone.add_sources(curriculum, seeds, trained[0].nodes)
            return self._arm(trained[0][self.target], trained[0].source_steps(self.target))

        yield "", own
        (result,) = trained
        spent = result.source_steps(self.target)
        pairs = VisitedPairs.of(curriculum)
        for label, change in value_controls(self.controls, pairs):
            train = partial(self._value_control, result, change, spent, label, pairs)
            yield label, train
        if PLACEBO in self.controls and is_observation_task(pairs.task):
            yield PLACEBO, partial(self._placebo, curriculum, seeds)
        for control in ("random_start", "pretraining"):
            if control in self.controls:
                train = partial(self._source_control, curriculum, control, seeds, spent)
                yield control.replace("_", " "), train

    def _value_control(
        self,
        result: CurriculumResult,
        change: Change,
        spent: IntArray,
        label: str,
        pairs: VisitedPairs,
        bars: Bars,
    ) -> Arm:
        """Return a control whose potential is changed; its level over `pairs` if it has one."""
        changed = changed_potentials(result, change)
        level = level_of(label, changed, pairs, result.curriculum)
        found = learn_changed(result, changed, self.workers, bars)
        return self._arm(found, spent, control=True, level=level)

    def _placebo(self, curriculum: Curriculum, seeds: Sequence[int], bars: Bars) -> Arm:
        """Return the control of a curriculum with miniatures: their answers, shuffled."""
        result = self._trained(shuffled_miniatures(curriculum), seeds, bars)
        return self._arm(result[self.target], result.source_steps(self.target), control=True)

    def _source_control(
        self,
        curriculum: Curriculum,
        control: Control,
        seeds: Sequence[int],
        spent: IntArray,
        bars: Bars,
    ) -> Arm:
        """Return a control with one source, for as many steps as the curriculum's took a seed."""
        parts = []
        for steps in np.unique(spent):
            rows = np.flatnonzero(spent == steps)
            other = source_control(curriculum, control, int(steps))
            result = self._trained(other, [seeds[k] for k in rows.tolist()], bars)
            parts.append(self._arm(result[self.target], spent[rows], control=True))
        # The parts hold the seeds sorted by their source steps.
        return concatenated(parts).take(np.argsort(np.argsort(spent, kind="stable")))

    def _trained(
        self,
        curriculum: Curriculum,
        seeds: Sequence[int],
        bars: Bars,
        known: Mapping[str, LearningResult] | None = None,
    ) -> CurriculumResult:
        """Return the trained curriculum, its target for the steps that its sources leave."""
        longer = curriculum.replace(self.target, budget=self.total, eval_freq=self.eval_freq)
        how: Any = {"charge": True, "workers": self.workers, "progress": bars}
        return longer.train(seeds, trained=known, **how)

    def _arm(self, result: LearningResult, spent: IntArray, **kind: Any) -> Arm:
        return Arm.of(result, spent, self.total, self.eval_freq, **kind)

    def run_until(
        self,
        first: int,
        precision: float | None,
        difference: bool,
        most: int,
        failed: dict[str, Exception],
    ) -> tuple[dict[str, Arm], str]:
        """Return all arms for as many seeds as the goal takes, and what ended their adding.

        Arms that fail at any look are left out, with their controls, as by :meth:`run`. If the
        first arm fails, no more seeds are added, since the goal is about its gain.
        """
        batches = list[dict[str, Arm]]()
        stopped = "stopped by the failure of the first arm"

        def gain(seeds: Sequence[int]) -> FloatArray:
            batches.append(self.run(tuple(seeds), failed))
            name = next(iter(self.arms))
            if name in failed:
                raise _FirstArmFailed
            # The best from scratch at the first look. Verdicts are against all that learn from
            # scratch, and hold whatever decided when to stop.
            return batches[-1][name].strong_gain(batches[-1][best_from_scratch(batches[0], failed)])

        with suppress(_FirstArmFailed):
            goal: Any = {"precision": precision, "difference": difference}
            stopped = add_seeds(gain, first=first, most=most, **goal).stopped
        names = [name for name in batches[0] if all(name in batch for batch in batches)]
        return {name: concatenated([batch[name] for batch in batches]) for name in names}, stopped


class _FirstArmFailed(Exception):
    """The arm failed whose gain decides whether more seeds are added."""
