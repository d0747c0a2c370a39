"""Comparing curricula with learning the target from scratch, and with each other.

All arms spend the same total of steps, source steps included. Seed k of every arm draws from the
same random stream in the target. Arms with different targets are refused.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import chain
from typing import Any

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import fit_name, instance, number, one_of, whole_number
from curricle.comparison.comparison import Arm, Comparison, best_from_scratch, joined_arms
from curricle.comparison.controls import CONTROLS, Control, check_fit
from curricle.comparison.plan import (
    Failures,
    Learners,
    Memory,
    Plan,
    Trained,
    check_comparable,
    from_scratch,
    scratch_curricula,
)
from curricle.comparison.verdicts import ONE_LOOK
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import CurriculumError, SettingError
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import Episodes, StoppingRule
from curricle.planning.target import Target
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.statistics.curves import SCRATCH, fraction_of_optimum, midpoint
from curricle.statistics.hypothesis_tests import Looks, add_seeds
from curricle.transfer.rollouts import ObservationTarget, target_of

FRACTION = 0.9  # of the way from the random policy's return to the optimum: the default threshold
STATED, OF_OPTIMUM = "stated", "nine tenths of the way to the optimum"
MIDPOINT = "midpoint of scratch's curve, without an optimum above random"  # sources of a threshold


def compare(
    arms: Curriculum | Mapping[str, Curriculum],
    *,
    seeds: int | Sequence[int] = 30,
    controls: Sequence[Control] = (),
    scratch: Learners = (),
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
    spends all of it in the target, every other arm the rest after its sources, seed by seed. An arm
    that fails is listed in :attr:`Comparison.failed`; an error of scratch, or of all arms, is
    raised.

    Parameters
    ----------
    arms : Curriculum or dict of str to Curriculum
        All with the same target, none named "scratch". ``curricle.compare`` also takes a study or
        its path: its arms and settings, where others are not given.
    seeds : int or sequence of int
        With `precision` or `difference`, the number of seeds to begin with.
    controls : sequence of str
        Of ``random_start``, ``pretraining``, ``placebo``, ``constant``, ``scaled`` and ``negated``,
        run for each curriculum (``curricle.comparison.controls`` explains them).
    scratch : sequence of learners, or dict of str to learner
        Learners that learn the target from scratch too, beside its own.
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
    CurriculumError, SettingError
        If arms are not comparable, or a setting is out of range, before any training.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 5000})
    >>> comparison = compare(plan, seeds=5, controls=["placebo"])
    >>> list(comparison.arms), comparison.total
    (['scratch', 'transfer', 'transfer, placebo'], 5500)
    """
    check_progress(progress)
    memory = Memory()
    plan = comparison_plan(arms, memory, controls, scratch)
    window = whole_number("window", window, 1, SettingError)
    if window > checkpoints(plan):
        raise SettingError(
            f"window must be at most {checkpoints(plan)}, the checkpoints within the target's "
            f"budget: got {window}"
        )
    if threshold is not None:
        threshold = number("threshold", threshold, SettingError)
    level = threshold_before(plan, threshold)  # solving the target may fail
    failed, looks, stopped = dict[str, Exception](), ONE_LOOK, ""
    with shown(progress) as bars:
        if precision is None and not difference:
            trained = trained_arms(plan, seed_tuple(seeds), failed, memory, workers, bars)
        else:
            batches = list[dict[str, Arm]]()
            first_arm = next(name for name, arm in plan.arms.items() if not arm.scratch)

            def gain(added: Sequence[int]) -> FloatArray:
                batches.append(trained_arms(plan, tuple(added), failed, memory, workers, bars))
                if first_arm in failed:  # no more seeds are added: the goal is about its gain
                    raise _FirstArmFailed
                # The best from scratch at the first look. Verdicts are against all that learn from
                # scratch, and hold whatever decided when to stop.
                best = best_from_scratch(batches[0], failed)
                return batches[-1][first_arm].strong_gain(batches[-1][best])

            first = whole_number("seeds to begin adding with", seeds, 2, SettingError)
            stopped = "stopped by the failure of the first arm"
            with suppress(_FirstArmFailed):
                goal: Any = {"precision": precision, "difference": difference}
                stopped = add_seeds(gain, first=first, most=most_seeds, **goal).stopped
            names = [name for name in batches[0] if all(name in batch for batch in batches)]
            trained = {name: joined_arms([batch[name] for batch in batches]) for name in names}
            looks = Looks.doubling(first, most_seeds)
    return comparison_of(plan, trained, level, window, failed, looks=looks, stopped=stopped)


class _FirstArmFailed(Exception):
    """The arm failed whose gain decides whether more seeds are added."""


def comparison_plan(
    arms: Curriculum | Mapping[str, Curriculum],
    memory: Memory,
    controls: Sequence[Control] = (),
    scratch: Learners = (),
) -> Plan:
    """Return the plan of :func:`compare` for arms; CurriculumError if they differ too much."""
    if isinstance(arms, Curriculum):
        arms = {"transfer": arms}
    instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
    if not arms:
        raise CurriculumError("a comparison needs at least one curriculum: got none")
    for name, arm in arms.items():
        fit_name("an arm", name, CurriculumError)
        instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
        if name == SCRATCH:
            raise CurriculumError(f"the name {SCRATCH!r} is taken by the baseline: rename this arm")
    if isinstance(controls, str):
        raise SettingError(f"controls must be a list of names: got {controls!r}")
    for control in controls:
        one_of("a control", control, CONTROLS, SettingError)
    check_comparable(arms)
    first = next(iter(arms.values()))
    target, node = first.target, first.node(first.target)
    if isinstance(node.budget, Episodes | StoppingRule):
        raise SettingError(
            "a comparison at one total budget needs the target's in steps: "
            f"{target!r} has {node.budget}"
        )
    if node.evaluation.method == "off":
        raise SettingError(f"a comparison needs greedy evaluation: that of {target!r} is off")
    for name, arm in arms.items():
        check_fit(controls, name, arm)
    scratches = {SCRATCH: from_scratch(first), **scratch_curricula(scratch, first)}
    for name in scratches:
        if name in arms:
            raise CurriculumError(f"the name {name!r} is taken by a learner: rename this arm")
    return Plan.made(arms, scratches, memory.keys_of, controls=controls)


def checkpoints(plan: Plan) -> int:
    """Return the checkpoints within the target's own budget."""
    return plan.steps[0] // plan.eval_freq + 1


def threshold_before(plan: Plan, stated: float | None) -> tuple[float | None, str]:
    """Return a threshold that is stated or else the target's, and where it comes from."""
    # None before any training where it is the midpoint of scratch's curve.
    if stated is not None:
        return stated, STATED
    node = next(iter(plan.curricula.values())).node(plan.target)
    threshold = threshold_of_optimum(target_of(node.task, node.evaluation))
    return threshold, MIDPOINT if threshold is None else OF_OPTIMUM


def trained_arms(
    plan: Plan,
    seeds: tuple[int, ...],
    failed: dict[str, Exception],
    memory: Memory,
    workers: int | None,
    bars: Bars,
) -> dict[str, Arm]:
    """Return all arms for these seeds, scratch first."""
    # An arm that raises an error is added to `failed`, and left out with its controls.
    plan, failures, arms = plan.without(failed), Failures(plan.needs), dict[str, Arm]()
    in_order = tuple(sorted(seeds))
    for _ in chain(memory.train(plan, in_order, failures, workers, bars), [None]):
        for unit, error in failures.errors:
            for name, arm in plan.arms.items():
                if unit.key in arm.keys.values() and not failed.keys() & {name, arm.of}:
                    assert isinstance(error, Exception)
                    failed[name] = error
        if SCRATCH in failed:
            raise failed[SCRATCH]
        for name, arm in plan.arms.items():
            if failed.keys() & {name, arm.of} or name in arms:
                continue
            if not all((key, in_order) in memory.trained for key in arm.keys.values()):
                break  # `bars` are told of the arms in their order
            try:
                arms[name] = _arm(plan, name, memory, seeds)
            except Exception as error:  # as its training may
                failed[name] = error
            else:
                bars.tell(name)
    if all(arm.scratch for arm in arms.values()):
        raise next(iter(failed.values()))
    return {name: arms[name] for name in plan.arms if name in arms}


def _arm(plan: Plan, name: str, memory: Memory, seeds: tuple[int, ...]) -> Arm:
    """Return an arm whose units were trained, its seeds in the order in which they were given."""
    planned, in_order = plan.arms[name], tuple(sorted(seeds))
    results = {task: memory.trained[key, in_order] for task, key in planned.keys.items()}
    last: Trained = results[plan.target]
    sources = [task for task in planned.curriculum.order if task != plan.target]
    arm = Arm.of(
        last.result,
        last.source_steps,
        plan.steps[1],
        plan.eval_freq,
        control=bool(planned.control),
        scratch=planned.scratch,
        level=last.level,
        unlearnt={
            source: planned.curriculum.node(source).unlearnt(results[source].result)
            for source in (sources if not planned.control else ())
        },
    )
    return arm.take(np.searchsorted(in_order, seeds))


def comparison_of(
    plan: Plan,
    arms: Mapping[str, Arm],
    level: tuple[float | None, str],
    window: int,
    failed: Mapping[str, Exception],
    **adding: Any,
) -> Comparison:
    """Return the comparison of trained arms, with :func:`threshold_before` as its `level`."""
    threshold = midpoint(arms[SCRATCH].curve) if level[0] is None else level[0]
    spans = *plan.steps, threshold, window
    return Comparison(plan.target, arms, *spans, failed, threshold_from=level[1], **adding)


def threshold_of_optimum(target: Target | ObservationTarget) -> float | None:
    """Return nine tenths of the way from the random policy's return to the optimum."""
    if target.solution is None:
        return None
    best, worst = target.optimum, target.random_return
    # Undiscounted, the policy that is optimal with the discount need not beat a random one.
    return None if best <= worst else fraction_of_optimum(best, worst, FRACTION)
