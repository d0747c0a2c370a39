"""Comparing curricula with learning the target from scratch, and with each other.

All arms spend the same total of steps, source steps included. Seed k of every arm draws from the
same random stream in the target. Arms with different targets are refused.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.checks import number, whole_number
from curricle.comparison.arms import Arm, best_from_scratch, concatenated
from curricle.comparison.comparable import (
    check_comparable,
    curricula_by_name,
    most_source_steps,
)
from curricle.comparison.comparison import Comparison
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
from curricle.comparison.levels import VisitedPairs
from curricle.comparison.scratch import GivenScratch, scratch_curricula
from curricle.comparison.verdicts import ONE_LOOK
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import CurriculumResult
from curricle.errors import CurriculumError, SettingError
from curricle.learning.budget import Episodes, limits, spacing
from curricle.learning.result import LearningResult
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import StoppingRule
from curricle.planning.target import Target
from curricle.progress import SILENT, Bars, Progress, check_progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.statistics.sequential import Looks, add_seeds
from curricle.statistics.thresholds import fraction_of_optimum, midpoint
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.observation_rollouts import ObservationTarget, target_of

FRACTION = 0.9
"""Of the way from the random policy's return to the optimum: the default threshold."""


def compare(
    arms: Curriculum | Mapping[str, Curriculum],
    *,
    seeds: int | Sequence[int] = 30,
    controls: Sequence[Control] = (),
    scratch: GivenScratch = (),
    threshold: float | None = None,
    window: int = 5,
    precision: float | None = None,
    difference: bool = False,
    most_seeds: int = 100,
    workers: int | None = None,
    progress: Progress = None,
) -> Comparison:
    """Return a comparison of curricula with learning their target from scratch.

    All have one total budget: the target's plus the steps that the most expensive arm spends on its
    sources (or can spend at most, if a source's budget is in episodes). The learner from scratch
    spends all of it in the target, every other arm the rest after its sources, seed by seed.

    Whether a curriculum pays is asked against learning from scratch, against the best of them where
    there are several. Why it pays, by what it knows or by its optimism alone, is asked against the
    controls that know nothing: ``placebo`` and ``constant``.

    An arm that raises an error is listed in :attr:`Comparison.failed`, and the others stand. An
    error of scratch, or of all arms, is raised.

    Parameters
    ----------
    arms : Curriculum or dict of str to Curriculum
        All with the same target; the name "scratch" is reserved. ``curricle.compare`` also takes a
        study or the path of its file: its arms, seeds, threshold, window and learners from scratch,
        where others are not given.
    seeds : int or sequence of int
        With `precision` or `difference`, the number of seeds to begin with.
    controls : sequence of str
        Of ``random_start``, ``pretraining``, ``placebo``, ``constant``, ``scaled`` and ``negated``,
        run for each curriculum (``curricle.comparison.controls`` explains them).
    scratch : sequence of learners, or dict of str to learner
        Learners that learn the target from scratch too, beside its own, each an arm with the same
        total. A dict names them, else their settings do.
    threshold : float, optional
        Return that counts as learnt. By default nine tenths of the way from the random policy's
        return to the optimum; midway up the curve of scratch if there is no such optimum.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold.
    precision : float, optional
        Add seeds until the half-width of the first arm's strong gain is at most this return.
    difference : bool
        Add seeds until the first arm's strong gain differs from 0.
    most_seeds : int
        Seeds at which to stop adding.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task of each arm; a function is called with the name of each arm
        when it is done.

    Raises
    ------
    CurriculumError
        If arms are not comparable; the message names the differences of their targets.
    SettingError
        If a setting is out of range, before any training.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 5000})
    >>> found = compare(plan, seeds=5, controls=["placebo"])
    >>> list(found.arms), found.total
    (['scratch', 'transfer', 'transfer, placebo'], 5500)
    """
    check_progress(progress)
    plan = _Plan.of(arms, controls, scratch, workers)
    window = whole_number("window", window, 1, SettingError)
    most = plan.budget // plan.eval_freq + 1
    if window > most:
        raise SettingError(
            f"window must be at most {most}, the checkpoints within the target's budget: "
            f"got {window}"
        )
    if threshold is None:  # the target is solved before any training, as that may fail
        evaluation = plan.first.setting("evaluation", plan.target)
        target = target_of(plan.first.tasks[plan.target], evaluation)
    else:
        threshold = number("threshold", threshold, SettingError)
    failed: dict[str, Exception] = {}
    looks, stopped = ONE_LOOK, ""
    with shown(progress) as bars:
        plan = replace(plan, bars=bars)
        if precision is None and not difference:
            found = plan.run(seed_tuple(seeds), failed)
        else:
            first = whole_number("seeds to begin adding with", seeds, 2, SettingError)
            found, stopped = plan.run_until(first, precision, difference, most_seeds, failed)
            looks = Looks.doubling(first, most_seeds)
    if all(name == SCRATCH or arm.scratch for name, arm in found.items()):
        raise next(iter(failed.values()))
    if threshold is None:
        threshold = default_threshold(target, found[SCRATCH])
    return Comparison(
        plan.target, found, plan.budget, plan.total, threshold, window, failed, looks, stopped
    )


@dataclass(frozen=True)
class _Plan:
    """The checked arms, and the settings that they share."""

    arms: Mapping[str, Curriculum]
    controls: Sequence[Control]
    scratch: Mapping[str, Curriculum]
    target: str
    budget: int
    total: int
    eval_freq: int
    workers: int | None
    bars: Bars = SILENT

    @classmethod
    def of(
        cls,
        arms: Curriculum | Mapping[str, Curriculum],
        controls: Sequence[Control],
        scratch: GivenScratch,
        workers: int | None,
    ) -> "_Plan":
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
        result = node.train(seeds, workers=self.workers, progress=bars)
        return self._arm(result, np.zeros(len(seeds), np.int64), scratch=True)

    def _with_controls(
        self, curriculum: Curriculum, seeds: Sequence[int]
    ) -> Iterator[tuple[str, Callable[[Bars], Arm]]]:
        """Yield the label of each arm and the function that trains it, the curriculum's first."""
        trained: list[CurriculumResult] = []

        def own(bars: Bars) -> Arm:
            trained.append(self._trained(curriculum, seeds, bars))
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
        self, curriculum: Curriculum, seeds: Sequence[int], bars: Bars
    ) -> CurriculumResult:
        """Return the trained curriculum, its target for the steps that its sources leave."""
        longer = curriculum.replace(self.target, budget=self.total, eval_freq=self.eval_freq)
        return longer.train(seeds, charge=True, workers=self.workers, progress=bars)

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


def default_threshold(target: Target | ObservationTarget, scratch: Arm) -> float:
    """Return nine tenths of the way from the random policy's return to the optimum.

    If the optimum is unknown or not above that return, return the midpoint of the curve of scratch.
    """
    of_optimum = threshold_of_optimum(target)
    return midpoint(scratch.curve) if of_optimum is None else of_optimum


def threshold_of_optimum(target: Target | ObservationTarget) -> float | None:
    """Return nine tenths of the way from the random policy's return to the optimum.

    None if the optimum is unknown or not above that return.
    """
    if target.solution is None:
        return None
    best, worst = target.optimum, target.random_return
    # Undiscounted, the policy that is optimal with the discount need not beat a random one.
    return None if best <= worst else fraction_of_optimum(best, worst, FRACTION)
