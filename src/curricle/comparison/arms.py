"""Comparing curricula with learning the target directly, and with each other, fairly.

All arms spend the same total of steps, source steps included; seed k of every arm draws from the
same random stream in the target; and arms whose targets are not one problem are refused.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance, number, whole_number
from curricle.comparison.comparison import SCRATCH, Arm, Comparison, joined
from curricle.comparison.controls import (
    Control,
    check_controls,
    check_fit,
    learn_changed,
    source_control,
    value_controls,
)
from curricle.comparison.task_differences import differences
from curricle.curriculum.curriculum import Curriculum, CurriculumResult
from curricle.errors import CurriculumError, SettingError
from curricle.learning.budget import Episodes, limits, seed_tuple, spacing
from curricle.learning.result import LearningResult
from curricle.learning.stopping import StoppingRule
from curricle.planning.target import Target
from curricle.statistics.sequential import add_seeds
from curricle.statistics.thresholds import fraction_of_optimum, midpoint
from curricle.transfer.observation_target import ObservationTarget, target_of

FRACTION = 0.9
"""How far from untaught to optimal the default threshold lies."""


def compare(
    arms: Curriculum | Mapping[str, Curriculum],
    *,
    seeds: int | Sequence[int] = 30,
    controls: Sequence[Control] = (),
    threshold: float | None = None,
    window: int = 5,
    precision: float | None = None,
    difference: bool = False,
    most_seeds: int = 100,
    workers: int | None = None,
    progress: Callable[[str], Any] | None = None,
) -> Comparison:
    """Return how curricula do against learning their target directly, at the same total budget.

    The target's budget, in steps, is what every arm would have without sources; the direct learner
    gets as many steps more as the most expensive arm spends on its sources (or can spend at most,
    where a source's budget is in episodes), and the other arms what is left of that total, seed by
    seed.

    Parameters
    ----------
    arms : Curriculum or dict of str to Curriculum
        All with the same target; the name "scratch" is taken.
    seeds : int or sequence of int
        Or, with `precision` or `difference`, the number of seeds to begin with.
    controls : sequence of str
        Of ``random_start``, ``pretraining``, ``placebo``, ``scaled`` and ``negated``; run for each
        curriculum (``controls.py`` says what they show).
    threshold : float, optional
        Return that counts as learnt. By default nine tenths of the way from an untaught to an
        optimal policy; midway through the direct learner's curve where that tells nothing.
    window : int
        Checkpoints over which curves are smoothed before they reach the threshold.
    precision : float, optional
        Add seeds until the first arm's gain is known to plus or minus so much return.
    difference : bool
        Add seeds until the first arm's gain is known to differ from 0.
    most_seeds : int
        When to stop adding.
    workers : int, optional
        Threads over seeds.
    progress : callable, optional
        Called with a few words for each arm done.

    Returns
    -------
    Comparison

    Raises
    ------
    CurriculumError
        When arms are not comparable; the message names what their targets differ in.
    SettingError
        When a setting makes no sense; nothing has been trained then.

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
    plan = _Plan.of(arms, controls, workers, progress)
    window = whole_number("window", window, 1, SettingError)
    if window > plan.budget // plan.eval_freq + 1:
        raise SettingError(
            f"window must be at most {plan.budget // plan.eval_freq + 1}, the checkpoints within the "
            f"target's budget: got {window}"
        )
    if threshold is None:
        place = plan.place()
    else:
        number("threshold", threshold, SettingError)
    if precision is None and not difference:
        found = plan.run(seed_tuple(seeds))
    else:
        found = plan.run_until(seeds, precision, difference, most_seeds)
    if threshold is None:
        threshold = default_threshold(place, found[SCRATCH])
    return Comparison(plan.target, found, plan.budget, plan.total, float(threshold), window)


@dataclass(frozen=True)
class _Plan:
    """The arms, checked, and what they share."""

    arms: Mapping[str, Curriculum]
    controls: Sequence[Control]
    target: str
    budget: int
    total: int
    eval_freq: int
    workers: int | None
    progress: Callable[[str], Any]

    @classmethod
    def of(
        cls,
        given: Curriculum | Mapping[str, Curriculum],
        controls: Sequence[Control],
        workers: int | None,
        progress: Callable[[str], Any] | None,
    ) -> "_Plan":
        arms = {"transfer": given} if isinstance(given, Curriculum) else given
        instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
        if not arms:
            raise CurriculumError("a comparison needs at least one curriculum: got none")
        for name, arm in arms.items():
            instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
            if name == SCRATCH:
                raise CurriculumError(f"an arm {SCRATCH!r} is always there: name yours otherwise")
        check_controls(controls)
        first = next(iter(arms.values()))
        check_comparable(arms)
        target = first.target
        budget = first.setting("budget", target)
        if isinstance(budget, Episodes | StoppingRule):
            raise SettingError(
                f"a comparison at one total budget needs the target's in steps: {target!r} has "
                f"{budget}"
            )
        if first.setting("evaluation", target).method == "off":
            raise SettingError(
                f"a comparison rests on greedy evaluation: that of {target!r} is off"
            )
        for name, arm in arms.items():
            check_fit(controls, name, arm)
        eval_freq = spacing(first.setting("eval_freq", target), budget)
        most = max(most_source_steps(arm) for arm in arms.values())
        total = -(-(limits(budget)[0] + most) // eval_freq) * eval_freq
        tick = progress or (lambda words: None)
        return cls(dict(arms), controls, target, limits(budget)[0], total, eval_freq, workers, tick)

    def run(self, seeds: Sequence[int]) -> dict[str, Arm]:
        """Return all arms for these seeds, the direct learner first."""
        first = next(iter(self.arms.values()))
        node = first.node(self.target).replace(budget=self.total, eval_freq=self.eval_freq)
        scratch = node.train(seeds, workers=self.workers)
        self.progress(SCRATCH)
        found = {SCRATCH: self._arm(scratch, np.zeros(len(seeds), np.int64))}
        for name, curriculum in self.arms.items():
            for label, arm in self._with_controls(curriculum, seeds):
                called = f"{name}, {label}" if label else name
                found[called] = arm
                self.progress(called)
        return found

    def _with_controls(
        self, curriculum: Curriculum, seeds: Sequence[int]
    ) -> Iterator[tuple[str, Arm]]:
        result = self._trained(curriculum, seeds)
        spent = result.source_steps(self.target)
        yield "", self._arm(result[self.target], spent)
        for label, change in value_controls(self.controls):
            changed = learn_changed(result, change, self.workers)
            yield label, self._arm(changed, spent, control=True)
        for control in ("random_start", "pretraining"):
            if control in self.controls:
                arm = self._from_itself(curriculum, control, seeds, spent)
                yield control.replace("_", " "), arm

    def _from_itself(
        self,
        curriculum: Curriculum,
        control: Control,
        seeds: Sequence[int],
        spent: npt.NDArray[np.int64],
    ) -> Arm:
        """Return a control whose source takes each seed as long as the curriculum's sources did."""
        parts, places = list[dict[str, Arm]](), []
        for steps in np.unique(spent):
            place = np.flatnonzero(spent == steps)
            other = source_control(curriculum, control, int(steps))
            again = self._trained(other, [seeds[k] for k in place.tolist()])
            parts.append({control: self._arm(again[self.target], spent[place], control=True)})
            places.append(place)
        return joined(parts)[control].taken(np.argsort(np.concatenate(places)))

    def _trained(self, curriculum: Curriculum, seeds: Sequence[int]) -> CurriculumResult:
        """Return a curriculum trained, its target for what its sources leave of the total."""
        longer = curriculum.replace(self.target, budget=self.total, eval_freq=self.eval_freq)
        return longer.train(seeds, charge=True, workers=self.workers)

    def _arm(
        self, result: LearningResult, spent: npt.NDArray[np.int64], *, control: bool = False
    ) -> Arm:
        return Arm.of(result, spent, self.total, self.eval_freq, control=control)

    def run_until(
        self, first: Any, precision: float | None, difference: bool, most: int
    ) -> dict[str, Arm]:
        """Return all arms for as many seeds as it takes."""
        batches = list[dict[str, Arm]]()
        first = whole_number("seeds to begin adding with", first, 2, SettingError)

        def gain(seeds: Sequence[int]) -> npt.NDArray[np.float64]:
            batches.append(self.run(tuple(seeds)))
            scratch, arm = (batches[-1][name] for name in (SCRATCH, next(iter(self.arms))))
            return arm.gain(scratch)

        add_seeds(gain, first=first, most=most, precision=precision, difference=difference)
        return joined(batches)

    def place(self) -> Target | ObservationTarget:
        """Return the target, solved if it can be."""
        first = next(iter(self.arms.values()))
        return target_of(first.tasks[self.target], first.setting("evaluation", self.target))


def default_threshold(place: Target | ObservationTarget, scratch: Arm) -> float:
    """Return nine tenths of the way from untaught to optimal; midway where that says nothing."""
    if place.solution is None:
        return midpoint(scratch.curve)
    best, worst = place.optimum, place.random_return
    # Judged without discount, what is optimal with it need not be better than acting at random.
    return midpoint(scratch.curve) if best <= worst else fraction_of_optimum(best, worst, FRACTION)


def most_source_steps(curriculum: Curriculum) -> int:
    """Return a bound of the steps that a curriculum's sources take."""
    most = 0
    for name in curriculum.ancestors(curriculum.target):
        back, sources = (
            curriculum.setting("back", name),
            {t.source for t in curriculum.in_edges(name)},
        )
        most += curriculum.node(name).most_steps
        most += 0 if back is None else back.most * back.again * len(sources)
    return most


def check_comparable(arms: Mapping[str, Curriculum]) -> None:
    """Raise CurriculumError unless all arms have one target, learnt and judged alike."""
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
            if mine != yours:
                raise CurriculumError(
                    f"arms must share their target's {which}: {pair} have {mine} and {yours}"
                )
