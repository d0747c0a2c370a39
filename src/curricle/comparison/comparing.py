"""Comparing curricula with learning the target from scratch, and with each other.

All arms spend the same total of steps, source steps included. Seed k of every arm draws from the
same random stream in the target. Arms with different targets are refused.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.checks import fit_name, instance, number, whole_number
from curricle.comparison.arms import Arm, best_from_scratch, concatenated
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
from curricle.comparison.task_differences import differences
from curricle.comparison.verdicts import ONE_LOOK
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import OF_TARGETS, SETTINGS, Node
from curricle.curriculum.result import CurriculumResult
from curricle.errors import CurriculumError, SettingError
from curricle.learning.result import LearningResult
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import Episodes, StoppingRule, limits, spacing
from curricle.planning.target import Target
from curricle.progress import SILENT, Bars, Progress, check_progress, shown
from curricle.statistics.curves import SCRATCH, fraction_of_optimum, midpoint
from curricle.statistics.hypothesis_tests import Looks, add_seeds
from curricle.tasks.observation_task import is_observation_task
from curricle.transfer.rollouts import ObservationTarget, target_of

GivenScratch = Sequence[Any] | Mapping[str, Any]
FRACTION = 0.9
"""Of the way from the random policy's return to the optimum: the default threshold."""
STATED, OF_OPTIMUM = "stated", "nine tenths of the way to the optimum"
MIDPOINT = "midpoint of scratch's curve, without an optimum above random"
"""Where a threshold comes from."""


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
    plan = ComparisonPlan.of(arms, controls, scratch, workers)
    window = whole_number("window", window, 1, SettingError)
    if window > plan.checkpoints:
        raise SettingError(
            f"window must be at most {plan.checkpoints}, the checkpoints within the target's "
            f"budget: got {window}"
        )
    if threshold is None:  # the target is solved before any training, as that may fail
        target = plan.solved_target()
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
    check_any_left(found, failed)
    level = STATED
    if threshold is None:
        threshold, level = default_threshold(target, found[SCRATCH])
    spans = plan.budget, plan.total, threshold, window
    return Comparison(plan.target, found, *spans, failed, looks, stopped, threshold_from=level)


def check_any_left(found: Mapping[str, Arm], failed: Mapping[str, Exception]) -> None:
    """Raise the first error where all curricula failed."""
    if all(name == SCRATCH or arm.scratch for name, arm in found.items()):
        raise next(iter(failed.values()))


def default_threshold(target: Target | ObservationTarget, scratch: Arm) -> tuple[float, str]:
    """Return nine tenths of the way from the random policy's return to the optimum, and its source.

    If the optimum is unknown or not above that return, return the midpoint of the curve of scratch.
    """
    of_optimum = threshold_of_optimum(target)
    if of_optimum is None:
        return midpoint(scratch.curve), MIDPOINT
    return of_optimum, OF_OPTIMUM


def threshold_of_optimum(target: Target | ObservationTarget) -> float | None:
    """Return nine tenths of the way from the random policy's return to the optimum.

    None if the optimum is unknown or not above that return.
    """
    if target.solution is None:
        return None
    best, worst = target.optimum, target.random_return
    # Undiscounted, the policy that is optimal with the discount need not beat a random one.
    return None if best <= worst else fraction_of_optimum(best, worst, FRACTION)


LARGEST_KEPT = 50_000_000
"""Bytes of tables up to which a task's values are kept for another arm."""
_SETTINGS = ("name", "learner", "budget", "shaping", "eval_freq", "evaluation", "storage")


@dataclass(frozen=True)
class LearntAlone:
    """What was learnt without sources so far."""

    _found: list[tuple[Node, tuple[int, ...], LearningResult]] = field(default_factory=list)

    def curves(
        self, node: Node, seeds: Sequence[int], train: Callable[[Node], LearningResult]
    ) -> LearningResult:
        """Return a task's result without its values; `train` makes it where it is the first."""
        known = self._known(node, seeds)
        if known is None:
            known = replace(train(node), values=None, snapshots=None)
            self._found.append((node, tuple(seeds), known))
        return known

    def sources(self, curriculum: Curriculum, seeds: Sequence[int]) -> dict[str, LearningResult]:
        """Return the results of a curriculum's sources that are known, with their values."""
        known = {one.name: self._known(one, seeds) for one in _first_sources(curriculum)}
        return {name: one for name, one in known.items() if one and one.values is not None}

    def add_sources(
        self, curriculum: Curriculum, seeds: Sequence[int], results: Mapping[str, LearningResult]
    ) -> None:
        """Keep the results of a curriculum's sources for other arms, unless they are large."""
        for node in _first_sources(curriculum):
            values = results[node.name].values
            small = isinstance(values, np.ndarray) and values.nbytes <= LARGEST_KEPT
            if small and self._known(node, seeds) is None:
                self._found.append((node, tuple(seeds), results[node.name]))

    def _known(self, node: Node, seeds: Sequence[int]) -> LearningResult | None:
        for known, numbers, result in self._found:
            alike = all(getattr(known, which) == getattr(node, which) for which in _SETTINGS)
            if known.task is node.task and numbers == tuple(seeds) and alike:
                return result
        return None


def _first_sources(curriculum: Curriculum) -> list[Node]:
    """Return the target's sources that have no sources of their own."""
    before = curriculum.ancestors(curriculum.target)
    return [curriculum.node(name) for name in before if not curriculum.in_edges(name)]


@dataclass(frozen=True)
class ComparisonPlan:
    """The checked arms of a comparison and the settings that they share."""

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
        node = curriculum.node(self.target)
        node = replace(node, budget=self.total, eval_freq=self.eval_freq)
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
            result = trained[0]
            arm = self._arm(result[self.target], result.source_steps(self.target))
            return replace(arm, unlearnt=result.unlearnt(self.target))

        yield "", own
        (result,) = trained
        spent = result.source_steps(self.target)
        pairs = VisitedPairs.of(curriculum)
        for label, change in value_controls(self.controls, pairs):
            yield label, partial(self._value_control, result, change, label, pairs)
        if PLACEBO in self.controls and is_observation_task(pairs.task):
            yield PLACEBO, partial(self._placebo, curriculum, seeds)
        for control in ("random_start", "pretraining"):
            if control in self.controls:
                train = partial(self._source_control, curriculum, control, seeds, spent)
                yield control.replace("_", " "), train

    def _value_control(
        self, result: CurriculumResult, change: Change, label: str, pairs: VisitedPairs, bars: Bars
    ) -> Arm:
        """Return a control whose potential is changed; its level over `pairs` if it has one."""
        changed = changed_potentials(result, change)
        level = level_of(label, changed, pairs, result.curriculum)
        found = learn_changed(result, changed, self.workers, bars)
        return self._arm(found, result.source_steps(self.target), control=True, level=level)

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


def curricula_by_name(arms: Curriculum | Mapping[str, Curriculum]) -> Mapping[str, Curriculum]:
    """Return arms by name, or raise CurriculumError unless they are curricula."""
    if isinstance(arms, Curriculum):
        return {"transfer": arms}
    instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
    if not arms:
        raise CurriculumError("a comparison needs at least one curriculum: got none")
    for name, arm in arms.items():
        fit_name("an arm", name, CurriculumError)
        instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
        if name == SCRATCH:
            raise CurriculumError(f"the name {SCRATCH!r} is taken by the baseline: rename this arm")
    return arms


def most_source_steps(curriculum: Curriculum) -> int:
    """Return an upper bound of the steps that a curriculum's sources take."""
    return sum(curriculum.node(name).most_steps for name in curriculum.ancestors(curriculum.target))


def check_comparable(arms: Mapping[str, Curriculum], learners: Collection[Any] | None = ()) -> None:
    """Raise CurriculumError unless all arms have one target with the same settings.

    Instead of the first arm's learner of the target one may have another of `learners`, which learn
    it from scratch too; any where that is None.
    """
    (name, first), *others = arms.items()
    target = first.target
    for other_name, other in others:
        pair = f"{name!r} and {other_name!r}"
        if other.target != target:
            raise CurriculumError(
                f"arms must share their target: {pair} have {target!r} and {other.target!r}"
            )
        apart = differences(first.tasks[target], other.tasks[target])
        if apart:
            raise CurriculumError(
                f"arms must share their target: those of {pair} differ in {'; '.join(apart)}"
            )
        for which in ("evaluation", "budget", "learner", "eval_freq"):
            mine, yours = first.setting(which, target), other.setting(which, target)
            fair = which == "learner" and (learners is None or yours in learners)
            if mine != yours and not fair:
                raise CurriculumError(
                    f"arms must share their target's {which}: {pair} have {mine} and {yours}"
                )


def from_scratch(curriculum: Curriculum, learner: Any = None) -> Curriculum:
    """Return a curriculum's target without its sources, with another learner if one is given.

    What applies to targets alone, such as the shaping, is left out.
    """
    target = curriculum.target
    settings: dict[str, Any] = {
        which: {target: curriculum.setting(which, target)}
        for which in SETTINGS
        if which not in OF_TARGETS
    }
    if learner is not None:
        settings["learner"] = {target: learner}
    return Curriculum({target: curriculum.tasks[target]}, **settings)


def scratch_curricula(given: GivenScratch, first: Curriculum) -> dict[str, Curriculum]:
    """Return the arms of further learners from scratch by name, ``scratch, NAME``."""
    if not isinstance(given, Mapping):
        instance("scratch, unless it names learners in a dict,", given, Sequence, SettingError)
    named = given.items() if isinstance(given, Mapping) else [(_name(one), one) for one in given]
    own, found = first.setting("learner", first.target), dict[str, Curriculum]()
    for name, learner in named:
        fit_name("a learner from scratch", name, SettingError)
        label = f"{SCRATCH}, {name}"
        if label in found:
            raise SettingError(f"learners from scratch must differ: {name} is there twice")
        if learner == own:
            raise SettingError(
                f"a further learner from scratch must differ from the target's own: {name} is "
                f"{own}, which learns from scratch anyway"
            )
        try:
            found[label] = from_scratch(first, learner)
        except (CurriculumError, SettingError) as error:
            raise SettingError(f"learner {name} from scratch: {error}") from None
    return found


def _name(learner: Any) -> str:
    """Return a learner as text, with the settings that are not the defaults of its class."""
    parts = []
    for one in fields(learner) if hasattr(learner, "__dataclass_fields__") else ():
        default = one.default_factory() if one.default_factory is not MISSING else one.default
        value = getattr(learner, one.name)
        if value != default:
            parts.append(f"{one.name}={value}")
    return type(learner).__name__ + f"({', '.join(parts)})" * bool(parts)
